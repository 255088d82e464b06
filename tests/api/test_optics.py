"""Field of view, pixel aspect and roll of a camera, over HTTP."""

from typing import Any

import cv2
import numpy as np
import pytest
from fastapi.testclient import TestClient

from app.api.tracking_schemas import CameraState
from tests.conftest import Photo, png


def ask(client: TestClient, files: dict[str, bytes], path: str = "/pose", **params: Any) -> Any:
    response = client.post(path, files=files, params={"evidence": "silhouette", **params})
    assert response.status_code == 200, response.text
    return response.json()


def joints(answer: Any, name: str = "joints_3d") -> np.ndarray:
    best = answer["persons"][0]["hypotheses"][0]
    return np.array([list(joint.values()) for joint in best[name]])


@pytest.mark.parametrize("quarters", [1, 2])
def test_a_turned_camera_answers_like_an_upright_one(
    client: TestClient, photo: Photo, quarters: int
) -> None:
    """Positions and axes turn with the frame; what is said of the person stays."""
    height, width = photo.mask.shape
    side = max(height, width) + 100
    square = np.zeros((side, side), np.uint8)
    square[50 : 50 + height, 50 : 50 + width] = photo.mask
    turned = np.rot90(square, quarters)
    asked = {"fov_deg": 70, "silhouettes": "rle", "observed": "blazepose33"}
    upright = ask(client, {"mask": png(square)}, **asked)
    rolled = ask(client, {"mask": png(turned)}, roll_deg=90 * quarters, **asked)
    assert rolled["image"] == upright["image"]
    # Counterclockwise, of x to the right and y down.
    turn, middle = np.linalg.matrix_power([[0, 1], [-1, 0]], quarters % 4), (side - 1) / 2
    places = (joints(upright, "joints_2d") - middle) @ turn.T + middle
    assert np.abs(joints(rolled, "joints_2d") - places).mean() < 0.1
    there = joints(upright)
    there[:, :2] = there[:, :2] @ turn.T
    assert np.abs(joints(rolled) - there).mean() < 1e-3
    (left, top, columns, rows), box = cv2.boundingRect(turned), rolled["persons"][0]["box"]
    assert list(box.values()) == pytest.approx([left - 0.5, top - 0.5, columns, rows], abs=0.1)
    person, other = rolled["persons"][0], upright["persons"][0]
    assert person["silhouette"]["area_px"] == other["silhouette"]["area_px"]
    assert person["posture"] == other["posture"]
    rolls = [one["hypotheses"][0]["camera"]["roll_deg"] for one in (person, other)]
    assert (rolls[1] - rolls[0] - 90 * quarters + 1) % 360 == pytest.approx(1, abs=0.02)


def test_a_frame_wins_over_its_camera(client: TestClient, photo: Photo) -> None:
    configuration = {"zones": [], "fov_deg": 100, "pixel_aspect": 2, "roll_deg": 90}
    state = client.put("/cameras/lens", json=configuration)
    shown = CameraState.model_validate_json(state.content)
    assert (shown.fov_deg, shown.pixel_aspect, shown.roll_deg) == (100, 2, 90)
    path, files = "/cameras/lens/frames", {"mask": photo.mask_png}
    assert ask(client, files, path, pixel_aspect=1)["image"]["fov_deg"] == 100
    own = ask(client, files, path, pixel_aspect=1, fov_deg=50, roll_deg=0)
    assert own["image"]["fov_deg"] == 50
    assert own["reset"] == "roll_deg was 90 before, it is 0 now"
    assert client.delete("/cameras/lens").status_code == 204
