"""Detection of people: one detection a person, with its probability, from all detectors.

The detectors are in :mod:`app.vision.detectors`. HOG scores the boxes of the first one again. For a
doubtful person, an object detector compares the person with animals and furniture.

References
----------
.. [1] M. Sandler et al., "MobileNetV2: Inverted Residuals and Linear Bottlenecks", CVPR 2018.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.networks.probabilities import logit, sigmoid
from app.networks.shipped import constants_of
from app.networks.tflite import TfliteNetwork
from app.vision.blazepose import LandmarkNetwork
from app.vision.detectors import Detector
from app.vision.detectors.hog import PERSON_PX, hog_margin
from app.vision.detectors.tiles import Picture
from app.vision.geometry import Box, PersonWindow, sample_window
from app.vision.halved import Frame, seen_at
from app.vision.movenet import MIN_MOVENET_SCORE
from app.vision.people import Detection
from app.vision.person_reader import MIN_PRESENCE, trunk_roll_deg
from app.vision.same_person import is_expected, may_be_reached, shows, tell_apart

MIN_DETECTION_SCORE = 0.3
"""Probability from which a detection is reported."""

DOUBTFUL = (0.2, 0.8)
"""Probabilities between which a detection is compared with other objects."""

_CLASSES = (
    "background", "bicycle", "boot", "laptop", "person", "chair", "cattle", "desk", "cat", "mouse",
    "monitor", "box", "mug", "coffee cup", "stationary bicycle", "table", "bottle", "high heels",
    "vehicle", "footwear", "dog", "book", "camera", "car",
)  # fmt: skip
_PERSON = _CLASSES.index("person")
# Clothes and other things that people wear do not count as other objects.
_WORN = ("boot", "high heels", "footwear")
_OTHERS = [row for row, name in enumerate(_CLASSES) if name not in ("background", "person", *_WORN)]
_OBJECTS_PX = 192
# Grids of anchors: cells a side, anchors of a cell, and the cells in the middle of the window.
_GRIDS = ((12, 3, slice(4, 8)), (6, 6, slice(2, 4)))


class ObjectNetwork(TfliteNetwork):
    """MediaPipe's object detector, a MobileNet [1]_ trained on Open Images, on given windows."""

    def __init__(self, path: Path, **share: int) -> None:
        outputs = [(cells, cells, anchors * len(_CLASSES)) for cells, anchors, _ in _GRIDS]
        super().__init__(path, [(_OBJECTS_PX, _OBJECTS_PX, 3)], outputs, **share)

    def log_odds(self, frame: Frame, window: PersonWindow) -> tuple[float, float]:
        """Log odds of a person, and of the likeliest other object, in the middle of a window.

        Anchors fit objects about half as wide as the window; the largest log odds count.
        """
        seen = cv2.cvtColor(sample_window(frame, window.on_grid(), _OBJECTS_PX), cv2.COLOR_BGR2RGB)
        maps = self.run(seen / np.float32(127.5) - 1)
        anchors = [
            grid[cells, cells].reshape(-1, len(_CLASSES))
            for grid, (_, _, cells) in zip(maps, _GRIDS, strict=True)
        ]
        best = np.concatenate(anchors).max(axis=0)
        return float(best[_PERSON]), float(best[_OTHERS].max())


class NetworkDetector:
    """Finds people with several detectors; thread-safe.

    HOG may raise a score but never lowers it, since it recognises only standing people.

    Parameters
    ----------
    detectors : sequence of Detector
        The first finds people of any size. The others add scores to these people, and find people
        that the first misses. Each has a weight, see :func:`detection_odds`.
    landmarks : LandmarkNetwork
        Confirms people that the first detector misses.
    objects : ObjectNetwork
        Compares doubtful people with other objects.
    """

    def __init__(
        self,
        detectors: Sequence[Detector],
        landmarks: LandmarkNetwork,
        objects: ObjectNetwork,
    ) -> None:
        self._first, *self._others = detectors
        self._landmarks = landmarks
        self._objects = objects

    def detect(
        self,
        frame: Frame,
        expected_boxes: Sequence[Box] = (),
        known_boxes: Sequence[Box] = (),
        min_person_px: float | None = None,
    ) -> tuple[list[Detection], list[Detection]]:
        """Find the people of a frame, and possible people beside them, best first.

        ``expected_boxes`` surround people who were visible a moment ago and have not left the
        frame; ``known_boxes`` surround tracked people, who are expected as well and need no
        comparison with other objects. The smallest person wanted is ``min_person_px`` high, by
        default a share of the frame's height.

        Returns
        -------
        people : list of Detection
            Best first.
        perhaps_beside : list of Detection
            Detections that overlap these people, best first. They count as parts of these people
            unless a reading beside these shows another body.
        """
        people, scores, others = self.candidates(frame, min_person_px)
        odds = detection_odds(scores)
        self._compare_with_objects(frame, people, odds, known_boxes)
        _raise_expected(people, odds, (*expected_boxes, *known_boxes))
        judged = [
            replace(one, score=score)
            for one, score in zip(people, sigmoid(odds).tolist(), strict=True)
        ]
        certain = [one for one in judged if one.score >= MIN_DETECTION_SCORE]
        doubtful = [one for one in judged if one.score < MIN_DETECTION_SCORE]
        # Probability from which a detection close to others may be a person partly hidden by them.
        close = [
            one
            for one in (*others, *doubtful)
            if one.score >= 0.15 and any(one.box.intersection(other.box) > 0 for other in certain)
        ]
        return sorted(certain, key=_by_score), sorted(close, key=_by_score)

    def _compare_with_objects(
        self,
        frame: Frame,
        people: Sequence[Detection],
        odds: NDArray[np.float64],
        known_boxes: Sequence[Box],
    ) -> None:
        """Change the log odds ``(N,)`` of doubtful people by those of the object detector."""
        for row, (one, probability) in enumerate(zip(people, sigmoid(odds), strict=True)):
            is_doubtful = DOUBTFUL[0] <= probability < DOUBTFUL[1]
            if not is_doubtful or any(is_expected(one.box, known) for known in known_boxes):
                continue
            gain = object_odds(*self.object_log_odds(frame, one))
            # People hardly visible beside others look like part of them.
            odds[row] += gain if probability >= MIN_DETECTION_SCORE else max(0.0, gain)

    def object_log_odds(self, frame: Frame, one: Detection) -> tuple[float, float]:
        """As :meth:`ObjectNetwork.log_odds`, with the window upright or turned with the trunk."""
        roll = one.windows[0].roll_deg if one.windows else trunk_roll_deg(one.keypoints)
        # The network hardly recognises lying people.
        rolls = [0.0] if roll is None or abs(roll) < 45.0 else [0.0, roll]
        side = 1.8 * max(one.box.width, one.box.height)
        windows = [replace(PersonWindow.about_box(one.box, roll), side=side) for roll in rolls]
        return max(self._objects.log_odds(frame, window) for window in windows)

    def candidates(
        self, frame: Frame, min_person_px: float | None = None
    ) -> tuple[list[Detection], NDArray[np.float64], list[Detection]]:
        """Find all candidates of all detectors, however low their score.

        Returns
        -------
        people : list of Detection
            One for each person, with the first detector's score and the windows of the others.
        scores : (N, 3) float64 array
            MoveNet's score, HOG's margin, and the score of BlazePose's detector; 0 where a detector
            finds no person.
        others : list of Detection
            Other people in the boxes of these, with their probabilities.
        """
        picture = Picture.of(frame, min_person_px)
        columns = 2 + len(self._others)
        if not picture.tiles:
            return [], np.zeros((0, columns)), []
        people, beside = tell_apart(self._first.detect(picture))
        scores = np.zeros((len(people) + len(beside), columns))
        for row, one in enumerate((*people, *beside)):
            scores[row, :2] = one.score, _margin(picture, one.box)
        scores, hidden = np.split(scores, [len(people)])
        for column, detector in enumerate(self._others, start=2):
            people, scores = self._with_found(picture, people, scores, column, detector)
        chances = sigmoid(detection_odds(hidden)).tolist()
        others = [replace(one, score=score) for one, score in zip(beside, chances, strict=True)]
        return people, scores, others

    def _with_found(
        self,
        picture: Picture,
        people: Sequence[Detection],
        scores: NDArray[np.float64],
        column: int,
        detector: Detector,
    ) -> tuple[list[Detection], NDArray[np.float64]]:
        people, known, rows = list(people), range(len(people)), list(scores)
        for seen in detector.detect(picture):
            same = [row for row in known if shows(seen, people[row])]
            if same:
                best = max(same, key=lambda row: people[row].score)
                windows = (*people[best].windows, *seen.windows)
                people[best] = replace(people[best], windows=windows)
                rows[best][column] = max(rows[best][column], seen.score)
            elif (person := self._confirmed(picture.frame, seen)) is not None:
                people.append(person)
                rows.append(np.where(np.arange(scores.shape[1]) == column, seen.score, 0.0))
        return people, np.reshape(rows, (len(people), scores.shape[1]))

    def _confirmed(self, frame: Frame, seen: Detection) -> Detection | None:
        """A person that the first detector misses, if the landmark network confirms it."""
        window = seen.windows[0] if seen.windows else PersonWindow.about_box(seen.box)
        reading = self._landmarks.read(frame, window)
        box = reading.landmarks.box().clip(frame.shape[1], frame.shape[0])
        if box is None or reading.presence < MIN_PRESENCE:
            return None
        return Detection(box, 0.0, None, (window,))


def _raise_expected(
    people: Sequence[Detection], odds: NDArray[np.float64], boxes: Sequence[Box]
) -> None:
    """Raise the log odds ``(N,)`` of the likeliest person in reach of each expected box."""
    for box in boxes:
        near = [row for row, one in enumerate(people) if may_be_reached(one.box, box)]
        if near:
            # People do not vanish, but a falling person is blurred, and then lies in a pose that
            # detectors rarely recognise.
            odds[max(near, key=lambda row: odds[row])] += 1.0


def _by_score(one: Detection) -> float:
    return -one.score


def _margin(picture: Picture, box: Box) -> float:
    """HOG's margin on a box, from the overview if the box is large enough in it."""
    seen = box.scaled(picture.tiles[0].factor)
    if seen.height >= PERSON_PX:
        return hog_margin(picture.overview, seen)
    pixels, scale = seen_at(picture.frame, PERSON_PX / box.height)
    return hog_margin(pixels, box.scaled(scale))


# The columns of the scores: the first detector, HOG, and the other detectors.
_SCORES = ("movenet", "hog", "pose_detection")


def detection_odds(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Log odds ``(N,)`` that candidates are people, from their scores ``(N, 3)``."""
    fitted = constants_of("detection")
    weights = np.array([fitted[name] for name in _SCORES])
    return detection_features(scores) @ weights + fitted["offset"]


def object_odds(person: float, other: float) -> float:
    fitted, excess = constants_of("objects"), max(0.0, other - person)
    return float(fitted["person"] * person + fitted["excess"] * excess + fitted["offset"])


def detection_features(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Features ``(N, 3)`` of the fitted probability, from :meth:`NetworkDetector.candidates`.

    They are MoveNet's log odds, HOG's margin if positive, and the score of BlazePose's detector.
    """
    movenet, margin, *others = scores.T
    odds = logit(np.maximum(movenet, MIN_MOVENET_SCORE), 1e-4)
    return np.stack([odds, np.maximum(0.0, margin), *others], axis=1)
