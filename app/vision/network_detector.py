"""Detection of people with both networks and, beside them, HOG.

MoveNet sees the whole frame once. If the smallest wanted person would be too small in it, MoveNet
sees the frame again at a higher resolution, in tiles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.vision import DetectorName
from app.vision.blazepose import BlazePoseDetection, BlazePoseDetector, LandmarkNetwork
from app.vision.crops import crop, resize
from app.vision.detector import best_first, check_limits
from app.vision.geometry import Box, PersonWindow, box_array, non_max_suppression
from app.vision.hog import hog_margin
from app.vision.models import fitted_constants
from app.vision.movenet import MoveNet
from app.vision.odds import logit, sigmoid
from app.vision.parameters import DEFAULTS, DetectorParameters, VisionParameters
from app.vision.people import Detection
from app.vision.tiles import tiles_of


class NetworkDetector:
    """Find people with MoveNet and BlazePose's detector.

    MoveNet finds people of any size, BlazePose's detector large people in any pose and orientation.
    HOG may raise a score but never lowers it, since it recognises only standing people.

    Parameters
    ----------
    movenet : MoveNet
    body_detector : BlazePoseDetector
    landmarks : LandmarkNetwork
        Confirms people that MoveNet misses.
    min_person_px : float, optional
        Height of the smallest person wanted, in pixels; by default a share of the frame's height.
    min_score : float, optional
        Probability from which a person is reported.
    """

    name: DetectorName = "network"

    def __init__(
        self,
        movenet: MoveNet,
        body_detector: BlazePoseDetector,
        landmarks: LandmarkNetwork,
        *,
        min_person_px: float | None = None,
        min_score: float | None = None,
        parameters: VisionParameters = DEFAULTS,
    ) -> None:
        self._movenet = movenet
        self._body_detector = body_detector
        self._landmarks = landmarks
        self._parameters = parameters.detector
        self._tiling = parameters.tiling
        self._hog = parameters.hog
        self._min_score = self._parameters.min_score if min_score is None else min_score
        self._min_person_px = min_person_px
        check_limits(min_person_px, self._min_score)

    def detect(
        self, frame: NDArray[np.uint8], expected_boxes: Sequence[Box] = ()
    ) -> list[Detection]:
        """Find the people; see :class:`Detector`."""
        detections, scores = self.candidates(frame)
        odds = detection_odds(scores, self._parameters)
        for box in expected_boxes:
            near = [i for i, one in enumerate(detections) if self._may_be(one.box, box)]
            if near:
                odds[max(near, key=lambda i: odds[i])] += self._parameters.expected_log_odds
        found = (
            replace(detection, score=probability)
            for detection, probability in zip(detections, sigmoid(odds).tolist(), strict=True)
        )
        return best_first(found, self._min_score)

    def candidates(self, frame: NDArray[np.uint8]) -> tuple[list[Detection], NDArray[np.float64]]:
        """Find all candidates of both networks, however low their score.

        Returns
        -------
        detections : list of Detection
            One for each person, with MoveNet's score and the windows of BlazePose's detector.
        scores : (N, 3) float64 array
            MoveNet's score, HOG's margin, and the score of BlazePose's detector; 0 where a network
            detects nobody.
        """
        found = self._movenet_people(frame)
        windows: list[list[PersonWindow]] = [[] for _ in found]
        scores = [[one.score, hog_margin(frame, one.box, self._hog), 0.0] for one in found]
        alone: list[Detection] = []
        for body in self._body_detector.detect(frame, self._parameters.min_body_score):
            same = [i for i, one in enumerate(found) if self._is_same(body.window, one.box)]
            if same:
                best = max(same, key=lambda i: found[i].score)
                windows[best].append(body.window)
                scores[best][2] = max(scores[best][2], body.score)
            elif (person := self._confirmed(frame, body)) is not None:
                alone.append(person)
                scores.append([0.0, 0.0, body.score])
        both = [replace(one, windows=tuple(own)) for one, own in zip(found, windows, strict=True)]
        return [*both, *alone], np.array(scores, np.float64).reshape(-1, 3)

    def _movenet_people(self, frame: NDArray[np.uint8]) -> list[Detection]:
        """MoveNet's detections in the overview and tiles, one for each person, best first."""
        height, width = frame.shape[:2]
        tiles = tiles_of(width, height, self._min_person_px, self._tiling)
        found: list[Detection] = []
        ranks: list[float] = []
        for number, tile in enumerate(tiles):
            for person in self._movenet.detect(resize(crop(frame, tile.rect), *tile.size)):
                box = tile.to_frame(person.box, width, height, self._parameters.seam_px)
                if box is None or person.score < self._parameters.min_movenet_score:
                    continue
                score = min(1.0, person.score)
                keypoints = person.keypoints.scaled(1 / tile.factor).moved(*tile.rect[:2])
                found.append(Detection(box, score, keypoints))
                overview_px = max(box.width, box.height) * tiles[0].factor
                is_large = overview_px >= self._parameters.large_person_px
                # A box from the more suitable resolution comes before all others.
                ranks.append(score + (len(tiles) == 1 or is_large == (number == 0)))
        boxes = box_array(one.box for one in found)
        kept = non_max_suppression(boxes, np.array(ranks), self._parameters.nms_iou)
        return [found[i] for i in kept]

    def _confirmed(self, frame: NDArray[np.uint8], body: BlazePoseDetection) -> Detection | None:
        """A body that MoveNet misses, if the landmark network sees a person there."""
        reading = self._landmarks.read(frame, body.window)
        box = reading.landmarks.box().clip(frame.shape[1], frame.shape[0])
        if box is None or reading.presence < self._parameters.min_presence:
            return None
        return Detection(box, 0.0, None, (body.window,))

    def _is_same(self, window: PersonWindow, box: Box) -> bool:
        """Whether a body's window and a box belong to the same person."""
        inside = box.x <= window.x <= box.right and box.y <= window.y <= box.bottom
        low, high = self._parameters.same_size
        return inside and low < window.side / PersonWindow.about_box(box).side < high

    def _may_be(self, box: Box, expected: Box) -> bool:
        """Whether a box may hold an expected person, standing there or on the ground nearby."""
        x, y, width, height = expected.x, expected.y, expected.width, expected.height
        margin = max(width, height) / 2
        reach = Box(x - margin, y, width + 2 * margin, height + margin / 2)
        return box.intersection(reach) >= self._parameters.min_expected_share * box.area


def detection_odds(
    scores: NDArray[np.float64], parameters: DetectorParameters = DEFAULTS.detector
) -> NDArray[np.float64]:
    """Log odds ``(N,)`` that candidates are people, from their scores ``(N, 3)``."""
    constants = fitted_constants("detection")
    weights = np.array([constants[name] for name in ("movenet", "hog", "pose_detection")])
    return np.asarray(detection_features(scores, parameters) @ weights + constants["offset"])


def detection_features(
    scores: NDArray[np.float64], parameters: DetectorParameters = DEFAULTS.detector
) -> NDArray[np.float64]:
    """Features ``(N, 3)`` of the fitted probability, from :meth:`NetworkDetector.candidates`.

    They are MoveNet's log odds, HOG's margin if positive, and the score of BlazePose's detector.
    """
    movenet, margin, body = scores.T
    odds = logit(np.maximum(movenet, parameters.min_movenet_score), parameters.min_probability)
    return np.stack([odds, np.maximum(0.0, margin), body], axis=1)
