"""POST /pose and its pictures, over the tiny index of stick figures."""

from __future__ import annotations

import json
import math
from typing import Any

import cv2
import numpy as np
import pytest
from fastapi.testclient import TestClient

from index.skeleton import COCO17, NATIVE
from index.store import PoseIndex
from tests.conftest import Photo, photograph, png


def ask(client: TestClient, photo: Photo, **params: Any) -> dict[str, Any]:
    files = {"frame": photo.frame_png, "mask": photo.mask_png}
    response = client.post("/pose", files=files, params=params)
    assert response.status_code == 200, response.text
    return response.json()


def test_a_photographed_entry_is_its_own_nearest(client: TestClient, photo: Photo) -> None:
    person = ask(client, photo)["persons"][0]
    best = person["hypotheses"][0]
    assert best["entry"] == photo.entry
    assert best["distance"] == pytest.approx(0, abs=1e-3)
    assert best["reprojection_error_px"] == 0
    assert person["box"] == tight_box(photo)
    assert person["silhouette"]["area_px"] == photo.mask.sum()


def tight_box(photo: Photo) -> dict[str, float]:
    rows, columns = np.nonzero(photo.mask)
    # Edges lie half a pixel outside the centres of the outermost pixels.
    return {
        "x": columns.min() - 0.5,
        "y": rows.min() - 0.5,
        "width": np.ptp(columns) + 1.0,
        "height": np.ptp(rows) + 1.0,
    }


def test_joints_lie_where_the_photograph_has_them(client: TestClient, photo: Photo) -> None:
    best = ask(client, photo)["persons"][0]["hypotheses"][0]
    joints = np.array([[joint["x"], joint["y"]] for joint in best["joints_2d"]])
    # The crop's width is odd where the normalised one is even: half a pixel at most.
    assert np.abs(joints - photo.joints_2d).max() <= 0.51


def test_joints_follow_scale_and_shift(client: TestClient, tiny_index: PoseIndex) -> None:
    photo = photograph(tiny_index, 12, left=10, top=5)
    large = Photo(
        12,
        cv2.resize(photo.frame, None, fx=3, fy=3, interpolation=cv2.INTER_NEAREST),
        cv2.resize(photo.mask, None, fx=3, fy=3, interpolation=cv2.INTER_NEAREST),
        (photo.joints_2d + 0.5) * 3 - 0.5,
    )
    best = ask(client, large)["persons"][0]["hypotheses"][0]
    assert best["entry"] == 12
    joints = np.array([[joint["x"], joint["y"]] for joint in best["joints_2d"]])
    assert np.abs(joints - large.joints_2d).max() <= 2


@pytest.mark.parametrize("n", [1, 7, 50])
def test_hypotheses_are_ranked_distinct_and_finite(
    client: TestClient, photo: Photo, n: int
) -> None:
    hypotheses = ask(client, photo, n=n)["persons"][0]["hypotheses"]
    assert len(hypotheses) == n
    assert [h["rank"] for h in hypotheses] == list(range(1, n + 1))
    assert len({(h["entry"], h["source"]["mirrored"]) for h in hypotheses}) == n
    distances = [h["distance"] for h in hypotheses]
    assert distances == sorted(distances)
    for hypothesis in hypotheses:
        assert 0 <= hypothesis["confidence"] <= 1
        assert len(hypothesis["joints_3d"]) == len(hypothesis["joints_2d"]) == 19
        for point in hypothesis["joints_3d"] + hypothesis["joints_2d"]:
            assert all(math.isfinite(value) for value in point.values())


def test_keypoint_sets_select_the_same_points(client: TestClient, photo: Photo) -> None:
    native, coco = (ask(client, photo, keypoints=name) for name in ("native", "coco17"))
    assert native["keypoints"]["names"] == list(NATIVE.names)
    assert coco["keypoints"]["names"] == list(COCO17.names)
    for name in set(NATIVE.names) & set(COCO17.names):
        points = [
            answer["persons"][0]["hypotheses"][0]["joints_3d"][
                answer["keypoints"]["names"].index(name)
            ]
            for answer in (native, coco)
        ]
        assert points[0] == points[1]


def test_people_come_left_to_right(client: TestClient, tiny_index: PoseIndex) -> None:
    mask = np.zeros((240, 320), np.uint8)
    for label, left in ((1, 200), (2, 20), (3, 110)):
        mask |= photograph(tiny_index, label, left).mask * label
    files = {"frame": png(np.zeros((240, 320, 3), np.uint8)), "mask": png(mask)}
    persons = client.post("/pose", files=files).json()["persons"]
    for person, (number, left) in zip(persons, ((2, 20), (3, 110), (1, 200)), strict=True):
        best = person["hypotheses"][0]
        joints = np.array([[joint["x"], joint["y"]] for joint in best["joints_2d"]])
        expected = photograph(tiny_index, number, left).joints_2d
        # Its pose, up to interpolation with near neighbours; the persons are 90 px apart.
        assert np.linalg.norm(joints - expected, axis=1).mean() < 3
    labels = client.post("/silhouette", files=files)
    picture = cv2.imdecode(np.frombuffer(labels.content, np.uint8), cv2.IMREAD_UNCHANGED)
    assert np.array_equal(picture, np.array([0, 3, 1, 2], np.uint8)[mask])


def test_a_silhouette_sent_back_as_mask_is_the_same(client: TestClient, photo: Photo) -> None:
    """Its pose may be another: the joints of a caller's mask are not read."""
    boxes = {"boxes": json.dumps([[145, 35, 60, 140]])}
    frame = {"frame": photo.frame_png}
    found = client.post("/pose", files=frame, data=boxes).json()["persons"][0]
    labels = client.post("/silhouette", files=frame, data=boxes).content
    again = client.post("/pose", files={**frame, "mask": labels}).json()["persons"][0]
    assert found["source"] == "boxes"
    assert again["source"] == "mask"
    assert again["silhouette"]["area_px"] == found["silhouette"]["area_px"]


def test_what_differs_from_the_background_is_a_person(client: TestClient, photo: Photo) -> None:
    rng = np.random.default_rng(photo.entry)
    empty = rng.integers(170, 230, photo.frame.shape, np.uint8)
    frame = np.where(photo.mask[..., None] == 1, photo.frame, empty)
    files = {"frame": png(frame), "background": png(empty)}
    (person,) = client.post("/pose", files=files).json()["persons"]
    assert person["source"] == "background"
    assert 0 <= person["detection_score"] <= 1
    box = tight_box(photo)
    assert all(abs(person["box"][side] - box[side]) < 12 for side in box)
    given = {"boxes": json.dumps([[100, 20, 150, 200]])}
    (boxed,) = client.post("/pose", files=files, data=given).json()["persons"]
    assert boxed["source"] == "boxes"
    assert boxed["silhouette"]["segmenter"] == "background"


def test_an_empty_street_has_no_persons(client: TestClient) -> None:
    frame = png(np.full((240, 320, 3), 200, np.uint8))
    assert client.post("/pose", files={"frame": frame}).json()["persons"] == []
    empty = png(np.zeros((240, 320), np.uint8))
    answer = client.post("/pose", files={"frame": frame, "mask": empty}).json()
    assert answer["persons"] == []
    assert answer["image"] == {"width": 320, "height": 240}


def test_distances_are_the_silhouettes_where_the_photograph_tells_nothing(
    client: TestClient, photo: Photo
) -> None:
    files = {"frame": png(np.full_like(photo.frame, 120)), "mask": photo.mask_png}
    person = client.post("/pose", files=files).json()["persons"][0]
    distances = [h["distance"] for h in person["hypotheses"]]
    assert distances == sorted(distances)
    assert distances == [h["silhouette_distance"] for h in person["hypotheses"]]
    weights = np.array([h["confidence"] for h in person["hypotheses"]])
    front = np.cos(np.deg2rad([h["camera"]["azimuth_deg"] for h in person["hypotheses"]])) > 0
    assert person["facing"]["evidence"] == "none"
    assert person["facing"]["front_probability"] == pytest.approx(
        (weights * front).sum() / weights.sum(), abs=1e-3
    )


def test_the_overlay_draws_on_the_frame(client: TestClient, photo: Photo) -> None:
    files = {"frame": photo.frame_png, "mask": photo.mask_png}
    response = client.post("/pose/overlay", files=files)
    assert response.headers["content-type"] == "image/png"
    picture = cv2.imdecode(np.frombuffer(response.content, np.uint8), cv2.IMREAD_COLOR)
    changed = (picture != photo.frame).any(axis=2)
    assert changed[photo.mask == 1].mean() > 0.2
    assert not changed[:, :100].any()


def test_timings_add_up(client: TestClient, photo: Photo) -> None:
    timings = ask(client, photo)["timings_ms"]
    total = timings.pop("total")
    assert 0 < sum(timings.values()) <= total + 0.01
