"""Keypoints, landmarks, detections and silhouettes as values."""

from typing import Any

import numpy as np
import pytest

from app.vision.geometry import Box
from app.vision.people import (
    COCO_LANDMARKS,
    COCO_NAMES,
    LANDMARK_NAMES,
    Detection,
    Landmarks,
    ObservedKeypoints,
    Silhouette,
    silhouette_from_mask,
)
from index.skeleton import COCO17

MASK = np.zeros((4, 6), bool)
MASK[1, 2:4] = MASK[2, 2] = True


def test_silhouette_is_a_tight_crop() -> None:
    one = silhouette_from_mask(MASK, segmenter="mask")
    assert one is not None
    assert (one.left, one.top, one.area_px) == (2, 1, 3)
    rows, columns = np.nonzero(one.crop)
    np.testing.assert_allclose(one.centroid, [columns.mean() + 2, rows.mean() + 1])
    assert one.box == Box(1.5, 0.5, 2, 2)
    assert (one.mask(MASK.shape) == MASK).all()
    assert silhouette_from_mask(MASK & False, segmenter="mask") is None


def test_coco_keypoints_are_the_landmarks_of_their_names() -> None:
    assert tuple(LANDMARK_NAMES[row] for row in COCO_LANDMARKS) == COCO_NAMES
    assert COCO17.names == COCO_NAMES


@pytest.mark.parametrize(
    ("make", "arguments", "message"),
    [
        (Silhouette, (MASK, 0, 0, "mask", False), "tight crop"),
        (Silhouette, (MASK.astype(np.uint8), 0, 0, "mask", False), "dtype bool"),
        (Silhouette, (MASK[1:2, 2:4], -1, 0, "mask", False), "inside the frame"),
        (Detection, (Box(0, 0, 1, 1), 1.5), "0 to 1"),
        *((ObservedKeypoints, (np.zeros((rows, 2)), np.zeros(scores)), "positions of shape")
          for rows, scores in ((16, 17), (17, 16), (0, 0))),
        *((Landmarks, (np.zeros((rows, 2)), np.zeros(scores), np.zeros((depths, 3))),
           "expected arrays of shapes")
          for rows, scores, depths in ((32, 33, 33), (33, 32, 33), (33, 33, 32))),
    ],
)  # fmt: skip
def test_invalid_values_are_refused(make: type, arguments: tuple[Any, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make(*arguments)
