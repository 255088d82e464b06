"""Keypoints, landmarks, detections and silhouettes as values."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from app.vision.geometry import Box
from app.vision.people import (
    COCO_LANDMARKS,
    COCO_NAMES,
    LANDMARK_NAMES,
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
    ("crop", "left", "message"),
    [
        (MASK, 0, "tight crop"),
        (MASK.astype(np.uint8), 0, "dtype bool"),
        (MASK[1:2, 2:4], -1, "inside the frame"),
    ],
)
def test_a_crop_that_is_none_is_refused(crop: NDArray[Any], left: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Silhouette(crop, left, 0, "mask", False)
