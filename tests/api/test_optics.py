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


def squeezed(photo: Photo) -> dict[str, bytes]:
    """The mask in half the width."""
    height, width = photo.mask.shape
    size = width // 2, height
    mask = cv2.resize(photo.mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    return {"mask": png(mask)}


def test_a_squeezed_picture_answers_like_the_unsqueezed_one(
    client: TestClient, photo: Photo
) -> None:
    whole = ask(client, {"mask": photo.mask_png})
    half = ask(client, squeezed(photo), pixel_aspect=2, silhouettes="rle")
    assert half["image"]["width"] == photo.mask.shape[1] // 2
    places = joints(whole, "joints_2d")
    places[:, 0] = (places[:, 0] + 0.5) / 2 - 0.5
    assert np.abs(joints(half, "joints_2d") - places).mean() < 2
    person, other = half["persons"][0], whole["persons"][0]
    assert person["box"]["width"] == pytest.approx(other["box"]["width"] / 2, abs=2)
    assert person["box"]["height"] == pytest.approx(other["box"]["height"], abs=1)
    assert person["silhouette"]["rle"]["size"] == [photo.mask.shape[0], photo.mask.shape[1] // 2]
    assert person["silhouette"]["area_px"] == pytest.approx(photo.mask.sum() / 2, rel=0.1)


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
