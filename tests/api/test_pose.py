"""POST /pose and its pictures, over the tiny index of stick figures."""

import json
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from app.api.pictures import LEGEND
from app.api.schemas import PoseResponse
from tests.conftest import WALKERS, Photo, png
from tests.golden.pictures import decode


def ask(client: TestClient, photo: Photo, **params: Any) -> dict[str, Any]:
    """Ask by the silhouette alone by default: keypoints read from stick figures are wrong."""
    return post(client, photo.files, **{"evidence": "silhouette", **params})


def post(client: TestClient, files: dict[str, bytes], **params: Any) -> dict[str, Any]:
    response = client.post("/pose", files=files, params=params)
    assert response.status_code == 200, response.text
    PoseResponse.model_validate_json(response.content)
    return response.json()


def points(joints: list[dict[str, float]]) -> np.ndarray:
    return np.array([list(joint.values()) for joint in joints])


def test_a_photographed_entry_is_its_own_nearest(client: TestClient, photo: Photo) -> None:
    person = ask(client, photo)["persons"][0]
    best = person["hypotheses"][0]
    assert best["entry"] == photo.entry
    assert best["distance"] == pytest.approx(0, abs=1e-3)
    assert best["reprojection_error_px"] == 0
    assert person["box"] == tight_box(photo)
    assert person["silhouette"]["area_px"] == photo.mask.sum()
    # The crop's width is odd where the normalised one is even: half a pixel at most.
    assert np.abs(points(best["joints_2d"]) - photo.joints_2d).max() <= 0.51


def tight_box(photo: Photo) -> dict[str, float]:
    rows, columns = np.nonzero(photo.mask)
    # Edges lie half a pixel outside the centres of the outermost pixels.
    return {
        "x": columns.min() - 0.5,
        "y": rows.min() - 0.5,
        "width": np.ptp(columns) + 1.0,
        "height": np.ptp(rows) + 1.0,
    }


STREET = WALKERS.read_bytes()
BOXES = json.dumps([[135, 162, 40, 105]])


def test_a_returned_silhouette_works_as_a_mask(client: TestClient) -> None:
    frame = {"frame": STREET}
    (found,) = client.post("/pose", files=frame, data={"boxes": BOXES}).json()["persons"]
    labels = client.post("/silhouette", files=frame, data={"boxes": BOXES}).content
    (again,) = client.post("/pose", files={**frame, "mask": labels}).json()["persons"]
    assert found["source"] == "boxes" and not found["window_empty"]
    assert again["source"] == "mask"
    assert again["silhouette"]["area_px"] == found["silhouette"]["area_px"]
    # The keypoints are nearly the same, and so are the poses.
    best, same = found["hypotheses"][0], again["hypotheses"][0]
    assert again["facing"]["evidence"] == found["facing"]["evidence"] == "image"
    apart = points(best["joints_2d"]) - points(same["joints_2d"])
    assert np.linalg.norm(apart, axis=1).mean() < 8


COLUMNS = np.arange(320)
WALLS = {
    "blank": np.full((240, 320, 3), 200, np.uint8),
    "noise": np.random.default_rng(0).integers(0, 256, (240, 320, 3), np.uint8),
    "ramp": np.tile(np.uint8(COLUMNS * 0.8)[None, :, None], (240, 1, 3)),
    "stripes": np.tile(np.uint8(COLUMNS // 8 % 2 * 200)[None, :, None], (240, 1, 3)),
}
"""Pictures without people."""


@pytest.mark.parametrize("box", [[100, 40, 60, 160], [10, 150, 200, 60]])
@pytest.mark.parametrize("wall", WALLS)
def test_a_box_without_a_person_gets_low_confidence(
    client: TestClient, wall: str, box: list[float]
) -> None:
    response = client.post(
        "/pose", files={"frame": png(WALLS[wall])}, data={"boxes": json.dumps([box])}
    )
    assert response.status_code == 200
    (person,) = PoseResponse.model_validate_json(response.content).persons
    assert person.source == "boxes"
    assert person.hypotheses
    assert person.posture is not None
    assert person.posture.label == "unclear"
    assert person.posture.probability < 0.5
    assert all(hypothesis.confidence < 0.1 for hypothesis in person.hypotheses)


def test_a_mask_without_a_person_gets_low_confidence(client: TestClient, photo: Photo) -> None:
    files = {"frame": png(WALLS["blank"]), "mask": photo.mask_png}
    person = post(client, files)["persons"][0]
    assert client.post("/pose/overlay", files=files).status_code == 200
    assert person["posture"]["label"] == "unclear"
    assert all(hypothesis["confidence"] < 0.1 for hypothesis in person["hypotheses"])
    # On a photograph of a person, the same mask has a higher confidence in the same entry.
    seen = post(client, photo.files)["persons"][0]
    assert seen["posture"]["label"] == "standing"
    first, *others = seen["hypotheses"]
    assert first["entry"] == photo.entry
    assert first["confidence"] > 0.3
    for one in others:
        same = one["joints_2d"] == first["joints_2d"]
        assert (one["alternative"] == "depth") == same
        assert not same or one["confidence"] < first["confidence"]


def overlay(client: TestClient, frame: np.ndarray, mask: np.ndarray) -> np.ndarray:
    files = {"frame": png(frame), "mask": png(mask)}
    response = client.post("/pose/overlay", files=files, params={"evidence": "silhouette"})
    assert response.headers["content-type"] == "image/png"
    return decode(response.content)


def test_the_overlay_explains_its_colours_below_the_frame(client: TestClient, photo: Photo) -> None:
    picture = overlay(client, photo.frame, photo.mask)
    changed = (picture[:240] != photo.frame).any(axis=2)
    assert changed[photo.mask == 1].mean() > 0.2
    assert not changed[:, :100].any()
    assert len(picture) >= 260
    for _, colour, _ in LEGEND:
        assert (picture[240:] == colour).all(axis=2).any()
