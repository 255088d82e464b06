"""GET /index and its entries."""

from __future__ import annotations

import cv2
import numpy as np
from fastapi.testclient import TestClient

from index.store import PoseIndex


def test_the_index_describes_itself(client: TestClient, tiny_index: PoseIndex) -> None:
    answer = client.get("/index").json()
    assert answer["version"] == tiny_index.version
    assert answer["entries"] == 96
    assert answer["descriptor"] == {"name": "krawtchouk-diagonal", "dimension": 48}
    assert answer["actions"] == ["walk", "jump"]
    assert answer["attribution"] == "Drawn for tests."
    assert answer["parameters"]["seed"] == 1
    assert answer["service"]["detector"] == "network"
    assert len(answer["joints"]) == 19
    assert {bone["child"] for bone in answer["bones"]} == set(range(1, 19))


def test_an_entry_and_its_silhouette(client: TestClient, tiny_index: PoseIndex) -> None:
    answer = client.get("/index/entries/5").json()
    entry = tiny_index.entry(5)
    assert "action" not in answer
    assert answer["source"]["action"] == "jump"
    assert answer["source"]["frame"] == entry.frame == 1
    assert answer["camera"]["azimuth_deg"] == 110
    points = [[p["x"], p["y"], p["z"]] for p in answer["joints_3d"]]
    assert np.allclose(points, entry.points_3d[:19], atol=1e-4)
    picture = client.get("/index/entries/5/silhouette.png")
    pixels = cv2.imdecode(np.frombuffer(picture.content, np.uint8), cv2.IMREAD_UNCHANGED)
    assert np.array_equal(pixels, tiny_index.silhouette(5) * 255)
