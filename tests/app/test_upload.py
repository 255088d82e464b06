"""Uploads that cannot be used; what else is refused stands in test_errors."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from fastapi.testclient import TestClient

from app.estimation.estimator import Estimator
from app.estimation.upload import Upload, UploadError
from app.main import create_app
from app.settings import Settings
from app.vision.people import Box


def test_more_people_than_allowed(settings: Settings, estimator: Estimator) -> None:
    few = Estimator(
        estimator.index,
        estimator.detector,
        estimator.finder.reader,
        min_person_px=50,
        max_pixels=10**6,
        max_persons=2,
    )
    labels = np.zeros((90, 90), np.uint8)
    for person in range(3):
        labels[10:80, 10 + 20 * person : 20 + 20 * person] = person + 1
    mask = cv2.imencode(".png", labels)[1].tobytes()
    frame = cv2.imencode(".png", np.zeros((90, 90, 3), np.uint8))[1].tobytes()
    with TestClient(create_app(settings, few)) as client:
        response = client.post("/pose", files={"frame": frame, "mask": mask})
        assert response.status_code == 422
        assert response.json()["field"] == "mask"


def test_without_frame_and_mask_there_is_nothing_to_answer() -> None:
    for rest in ({}, {"background": b"?"}, {"boxes": (Box(1, 2, 30, 40),)}):
        with pytest.raises(UploadError, match="frame: expected an image file, got none"):
            Upload(**rest)  # type: ignore[arg-type]


def figures(*lefts: int, height: int = 70, width: int = 20) -> bytes:
    """A mask of one label with figures side by side."""
    labels = np.zeros((90, 200), np.uint8)
    for left in lefts:
        labels[10 : 10 + height, left : left + width] = 255
    return cv2.imencode(".png", labels)[1].tobytes()


def test_people_apart_need_labels_of_their_own(client: TestClient) -> None:
    response = client.post("/pose", files={"mask": figures(10, 60, 150)})
    assert response.status_code == 422
    assert response.json()["field"] == "mask"
    assert "3 figures apart with the same label" in response.json()["detail"]


@pytest.mark.parametrize(
    "mask",
    [figures(60), figures(60, 85), figures(10, 150, height=30), figures(10, 40, 70, width=30)],
)
def test_parts_of_one_person_are_one(client: TestClient, mask: bytes) -> None:
    response = client.post("/pose", files={"mask": mask})
    assert len(response.json()["persons"]) == 1
