"""Silhouettes from a caller's labels."""

from __future__ import annotations

import numpy as np

from app.vision.images import LabelImage
from app.vision.silhouettes import silhouettes_from_labels


def test_labels_become_silhouettes_from_left_to_right() -> None:
    labels = np.zeros((20, 30), np.uint16)
    labels[3:9, 20:25] = 1
    labels[2:9, 3:8] = 7
    people = silhouettes_from_labels(LabelImage.of(labels))
    assert [one.left for one in people] == [3, 20]
    assert [one.segmenter for one in people] == ["mask", "mask"]
    for one, label in zip(people, (7, 1), strict=True):
        assert (one.mask(labels.shape) == (labels == label)).all()
    assert silhouettes_from_labels(LabelImage.of(labels * 0)) == []
