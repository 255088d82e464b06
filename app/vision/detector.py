"""The interface of detectors, which find people in a frame, and what they share.

There are two: :mod:`app.vision.network_detector` and :mod:`app.vision.hog_detector`. Both drop
overlapping detections with :func:`app.vision.geometry.non_max_suppression`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from app.vision import DetectorName
from app.vision.geometry import Box
from app.vision.people import Detection


class Detector(Protocol):
    """Finds the people in a frame; implementations are thread-safe."""

    name: DetectorName

    def detect(
        self, frame: NDArray[np.uint8], expected_boxes: Sequence[Box] = ()
    ) -> list[Detection]:
        """Find the people of a frame ``(H, W, 3)``, BGR; best first.

        ``expected_boxes`` surround people who were there a moment ago and were not seen to leave.
        """
        ...


def best_first(detections: Iterable[Detection], min_score: float) -> list[Detection]:
    """Return the detections that reach ``min_score``, best first."""
    kept = [detection for detection in detections if detection.score >= min_score]
    return sorted(kept, key=lambda detection: -detection.score)


def check_limits(min_person_px: float | None, min_score: float) -> None:
    """Raise a ValueError for limits that no person can satisfy."""
    if min_person_px is not None and not min_person_px > 0:
        raise ValueError(f"expected a positive min_person_px, got {min_person_px}")
    if not 0 <= min_score <= 1:
        raise ValueError(f"expected a min_score from 0 to 1, got {min_score}")
