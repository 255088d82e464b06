"""Detection of upright people with HOG alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from app.vision import DetectorName
from app.vision.detector import MAX_FINE_SIDE_PX, best_first, check_limits, smallest_person_px
from app.vision.geometry import Box, Boxes, resize
from app.vision.hog import hog_people
from app.vision.models import fitted_constants
from app.vision.odds import sigmoid
from app.vision.people import Detection

_MIN_SCORE = 0.2  # Probability from which a detection is reported.
_SEARCH_PERSON_PX = 50.0  # Frames are reduced until the smallest person has this height.
# Smaller people are not searched for: in a frame of a few rows, a share of the height is next to
# nothing.
_MIN_PERSON_PX = 16.0


class HogDetector:
    """Find upright people with HOG alone, without a network.

    Limits are those of :class:`app.vision.detector.NetworkDetector`.
    """

    name: DetectorName = "hog"

    def __init__(
        self,
        *,
        min_person_px: float | None = None,
        min_score: float | None = None,
    ) -> None:
        self._min_score = _MIN_SCORE if min_score is None else min_score
        self._min_person_px = min_person_px
        check_limits(min_person_px, self._min_score)

    def detect(
        self, frame: NDArray[np.uint8], expected_boxes: Sequence[Box] = ()
    ) -> list[Detection]:
        """Find the people of a frame, best first; ``expected_boxes`` is ignored."""
        height, width = frame.shape[:2]
        boxes, margins = self.people(frame)
        constants = fitted_constants("detection")
        scores = sigmoid(constants["hog_alone"] * margins + constants["hog_alone_offset"])
        detections = [
            Detection(inside, float(score))
            for box, score in zip(boxes, scores, strict=True)
            if (inside := Box(*box.tolist()).clip(width, height)) is not None
        ]
        return best_first(detections, self._min_score)

    def people(self, frame: NDArray[np.uint8]) -> tuple[Boxes, NDArray[np.float64]]:
        """One box for each person, and its margin; see :func:`app.vision.hog.hog_people`."""
        height, width = frame.shape[:2]
        wanted_px = smallest_person_px(frame.shape, self._min_person_px)
        wanted_px = max(_MIN_PERSON_PX, wanted_px)
        factor = min(1.0, _SEARCH_PERSON_PX / wanted_px, MAX_FINE_SIDE_PX / max(height, width))
        small = resize(frame, max(1, round(width * factor)), max(1, round(height * factor)))
        min_px = max(min(_SEARCH_PERSON_PX, wanted_px), _SEARCH_PERSON_PX * factor)
        boxes, margins = hog_people(small, min_px)
        boxes[:, :2] = (boxes[:, :2] + 0.5) / factor - 0.5
        boxes[:, 2:] /= factor
        return boxes, margins
