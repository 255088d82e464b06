"""Detection of upright people with HOG alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from app.vision import DetectorName
from app.vision.detector import best_first, check_limits, smallest_person_px
from app.vision.geometry import Box, Boxes, resize
from app.vision.hog import hog_people
from app.vision.models import fitted_constants
from app.vision.odds import sigmoid
from app.vision.parameters import DEFAULTS, VisionParameters
from app.vision.people import Detection


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
        parameters: VisionParameters = DEFAULTS,
    ) -> None:
        self._parameters = parameters.hog
        self._tiling = parameters.tiling
        self._min_score = self._parameters.min_score if min_score is None else min_score
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
        wanted_px = smallest_person_px(frame.shape, self._min_person_px, self._tiling)
        wanted_px = max(self._parameters.min_person_px, wanted_px)
        search_px = self._parameters.search_person_px
        factor = min(1.0, search_px / wanted_px, self._tiling.max_fine_side_px / max(height, width))
        small = resize(frame, max(1, round(width * factor)), max(1, round(height * factor)))
        min_px = max(min(search_px, wanted_px), search_px * factor)
        boxes, margins = hog_people(small, min_px, self._parameters)
        boxes[:, :2] = (boxes[:, :2] + 0.5) / factor - 0.5
        boxes[:, 2:] /= factor
        return boxes, margins
