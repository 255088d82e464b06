"""A photograph alone may be the body itself, as cameras and ``curl --data-binary`` send it."""

from __future__ import annotations

import pytest
from fastapi.testclient import TestClient

from tests.conftest import ROOT

FRAME = (ROOT / "tests" / "data" / "walkers.jpg").read_bytes()


@pytest.mark.parametrize("content_type", ["image/jpeg", "IMAGE/JPEG", "image/png"])
def test_it_counts_as_the_frame(client: TestClient, content_type: str) -> None:
    headers = {"content-type": content_type}
    raw = client.post("/pose?n=1", content=FRAME, headers=headers).json()
    form = client.post("/pose?n=1", files={"frame": FRAME}).json()
    assert raw["persons"]
    assert raw["persons"] == form["persons"]
    assert raw["image"] == form["image"]


@pytest.mark.parametrize("path", ["/pose/overlay", "/silhouette"])
def test_pictures_are_drawn_of_it(client: TestClient, path: str) -> None:
    raw = client.post(path, content=FRAME, headers={"content-type": "image/jpeg"})
    assert raw.status_code == 200
    assert raw.content == client.post(path, files={"frame": FRAME}).content
