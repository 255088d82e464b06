"""Reads one person: the best of the landmark network's readings, fused with MoveNet's keypoints.

The landmark network is reliable if its window is right: about the body, with the trunk upright.
Windows come from the detectors. MoveNet's keypoints need no window. They show which reading is
right, and make its landmarks a little more precise where both networks agree.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, product

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.blazepose import LandmarkNetwork, MaskNetwork, PoseReading
from app.vision.geometry import Box, PersonWindow
from app.vision.halved import Frame, whole
from app.vision.movenet import KeypointReader
from app.vision.people import (
    COCO_LANDMARKS,
    COCO_NAMES,
    LANDMARK_NAMES,
    ObservedKeypoints,
    coco_rows,
)
from app.vision.truncation import MIN_VISIBLE_SCORE, ends_at_border

# If the trunk leans by an angle between these, an upright window is tried as well: in windows
# turned to a leaning trunk, the network sometimes exchanges left and right.
_MIN_LEAN_DEG = 15.0
_MAX_LEAN_DEG = 60.0
_GOOD_QUALITY = 0.85  # From this quality on, no further window is tried.
# Below this quality, the window that the best reading points to is read.
_DOUBTFUL_QUALITY = 0.6

MIN_PRESENCE = 0.5
"""Presence from which the landmark network recognises a person."""

# A window has lost its person if the next window is farther away than this share of its side.
_MAX_DRIFT = 0.35
MOVENET_FROM_PX = 200.0
"""Size of a body from which MoveNet also reads keypoints in a track's window. That takes as long as
the reading itself; poses of smaller people are averaged over more frames instead."""


@dataclass(frozen=True)
class PersonReader:
    """Reads people; thread-safe."""

    network: LandmarkNetwork
    mask_network: MaskNetwork
    keypoint_reader: KeypointReader

    def read(
        self,
        frame: Frame,
        box: Box,
        keypoints: ObservedKeypoints | None = None,
        windows: Sequence[PersonWindow] = (),
        expected: PersonWindow | PoseReading | None = None,
    ) -> PoseReading:
        """Read the person in a box.

        Parameters
        ----------
        frame : (H, W, 3) uint8 array
            BGR.
        box : Box
            Tight around the visible person.
        keypoints : ObservedKeypoints, optional
            MoveNet's keypoints, in pixels of the frame; by default they are read in the box.
        windows : sequence of PersonWindow
            Windows to try besides the one about the box, the likeliest first.
        expected : PersonWindow or PoseReading, optional
            Window in which a track expects the person, or the reading in it; if that is good, no
            other window is read.

        Returns
        -------
        PoseReading
            The best reading, its landmarks fused with the keypoints that agree with them; without
            the mask.
        """
        if keypoints is None:
            keypoints = self.keypoint_reader.read(frame, box)
        beyond = window_beyond_border(keypoints, box, frame.shape)
        roll_deg = trunk_roll_deg(keypoints) or 0.0
        about = [PersonWindow.about_box(box, roll_deg)]
        if _MIN_LEAN_DEG < abs(roll_deg) < _MAX_LEAN_DEG:
            about.append(PersonWindow.about_box(box))
        best = self._best_reading(frame, (*beyond, *windows, *about), keypoints, expected)
        if keypoints is None or best.keypoints is not None:
            return best
        return fuse(best, keypoints)

    def follow(self, frame: Frame, window: PersonWindow) -> PoseReading | None:
        """Read a person in the window that their last landmarks point to.

        Returns
        -------
        PoseReading or None
            None if the window no longer shows the person.
        """
        reading = self.network.read(frame, window)
        if reading.presence < MIN_PRESENCE or reading.drift > _MAX_DRIFT:
            return None
        if reading.body_px < MOVENET_FROM_PX:
            return reading
        box = reading.landmarks.box()
        keypoints = self.keypoint_reader.read(frame, box)
        if keypoints is None:
            return reading
        if sides_exchanged(reading, keypoints):
            # The window may have misled the network.
            return self.read(frame, box, keypoints)
        return fuse(reading, keypoints)

    def read_beside(
        self,
        frame: Frame,
        box: Box,
        keypoints: ObservedKeypoints,
        others: Sequence[PoseReading],
    ) -> PoseReading | None:
        """Read a person close to others, with the others painted over so that none is read twice.

        None if the reading shows no person beside them.
        """
        alone = without_bodies(frame, box, keypoints, others)
        window = PersonWindow.about_box(box, trunk_roll_deg(keypoints) or 0.0)
        first = self.network.read(alone, window)
        if reading_quality(first, keypoints) < _HOPELESS_QUALITY:
            return None
        reading = self.read(alone, box, keypoints, expected=first)
        is_seen = reading.presence >= MIN_PRESENCE
        fits = reading_quality(reading, keypoints) >= _MIN_QUALITY_BESIDE
        return reading if is_seen and fits else None

    def with_mask(self, reading: PoseReading) -> PoseReading:
        """The same reading with its mask."""
        return self.mask_network.read(reading)

    def _best_reading(
        self,
        frame: Frame,
        windows: Iterable[PersonWindow],
        keypoints: ObservedKeypoints | None,
        expected: PersonWindow | PoseReading | None,
    ) -> PoseReading:
        """The first good reading, else the best; if it is doubtful, its next window is tried."""

        def quality_of(reading: PoseReading) -> float:
            return reading_quality(reading, keypoints)

        readings: list[PoseReading] = []
        for known in windows if expected is None else chain([expected], windows):
            if isinstance(known, PoseReading):
                reading = known
            elif any(known.on_grid() == earlier.window for earlier in readings):
                continue  # An expected reading is of this window.
            else:
                reading = self.network.read(frame, known)
            if quality_of(reading) >= _GOOD_QUALITY:
                return reading
            readings.append(reading)
        best = max(readings, key=quality_of)
        if quality_of(best) >= _DOUBTFUL_QUALITY:
            return best
        return max(best, self.network.read(frame, best.next_window), key=quality_of)


# Least quality of a reading beside others, and quality of a first reading below which no other
# window shows a person; chosen on rendered groups.
_MIN_QUALITY_BESIDE, _HOPELESS_QUALITY = 0.5, 0.2
# Limbs of each side, by the parts at their ends.
_LIMBS = (
    ("shoulder", "elbow"), ("elbow", "wrist"), ("shoulder", "hip"), ("hip", "knee"),
    ("knee", "ankle"),
)  # fmt: skip
# The same and the lines between the sides, by the rows of the keypoints at their ends.
_LIMB_ENDS = [
    *product(coco_rows("nose"), coco_rows("shoulder")),
    *map(coco_rows, ("shoulder", "hip")),
    *(ends for limb in _LIMBS for ends in zip(*map(coco_rows, limb), strict=True)),
]
# Distance from the limbs up to which a body reaches, in sizes of the body.
_FLESH = 0.2
# Longer side of the picture in which distances to limbs are measured.
_LIMBS_PX = 512
# Visibility and score from which landmarks and keypoints are ends of limbs here.
_MIN_LANDMARK_VISIBILITY, _MIN_KEYPOINT_SCORE = 0.3, 0.15


def without_bodies(
    frame: Frame,
    box: Box,
    keypoints: ObservedKeypoints,
    others: Iterable[PoseReading],
) -> NDArray[np.uint8]:
    """A frame with the bodies of others painted grey about a person's box.

    A pixel close to the limbs of both stays if the person's keypoints are nearer.
    """
    result = whole(frame).copy()
    region = box.grown(1.0).clip(result.shape[1], result.shape[0])
    assert region is not None
    left, top, right, bottom = region.pixels()
    part = result[top:bottom, left:right]
    scale = min(1.0, _LIMBS_PX / max(part.shape[:2]))
    size = max(1, round(scale * part.shape[1])), max(1, round(scale * part.shape[0]))

    def distances(positions: NDArray[np.float64], seen: NDArray[np.bool_]) -> NDArray[np.float32]:
        return _distance_to_limbs(size, scale * (positions - np.array([left, top])), seen)

    own = distances(keypoints.positions, keypoints.scores > _MIN_KEYPOINT_SCORE)
    hidden = np.zeros(size[::-1], bool)
    for other in others:
        seen = other.landmarks.visibility[COCO_LANDMARKS] > _MIN_LANDMARK_VISIBILITY
        theirs = distances(other.landmarks.positions[COCO_LANDMARKS], seen)
        hidden |= (theirs <= own) & (theirs <= _FLESH * scale * other.body_px)
    shown = part.shape[1::-1]
    enlarged = cv2.resize(hidden.view(np.uint8), shown, interpolation=cv2.INTER_NEAREST)
    cv2.copyTo(np.full_like(part, 127), enlarged, part)
    return result


def _distance_to_limbs(
    size: tuple[int, int], positions: NDArray[np.float64], seen: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Distance of each pixel ``(H, W)`` of a picture to the nearest limb with visible ends."""
    off_limb = np.full(size[::-1], 255, np.uint8)
    ends = np.clip(positions, -(2**14), 2**14).round().astype(int).tolist()
    for first, last in _LIMB_ENDS:
        if seen[first] and seen[last]:
            cv2.line(off_limb, ends[first], ends[last], 0, 1)
    for row in np.flatnonzero(seen):
        cv2.circle(off_limb, ends[row], 2, 0, -1)
    return np.asarray(cv2.distanceTransform(off_limb, cv2.DIST_L2, 3), np.float32)


_HIPS_TO_FEET = 1.7  # Distance from hips to feet, relative to the trunk.


def window_beyond_border(
    keypoints: ObservedKeypoints | None,
    box: Box,
    frame_shape: tuple[int, ...],
) -> list[PersonWindow]:
    """Window about the whole body if the border cuts off its head or its feet; else none.

    In a window about the visible part alone, the network would see a small whole body.
    """
    if keypoints is None or not ends_at_border(box, frame_shape):
        return []
    nose, shoulders, hips, ankles = (
        _mean_position(keypoints, part, MIN_VISIBLE_SCORE)
        for part in ("nose", "shoulder", "hip", "ankle")
    )
    if hips is None or (nose is None) == (ankles is None):
        return []
    if ankles is not None:
        return [PersonWindow.about_circle(hips, hips + (hips - ankles))]
    top = nose if shoulders is None else shoulders
    assert top is not None
    return [PersonWindow.about_circle(hips, hips + _HIPS_TO_FEET * (top - hips))]


_MIN_TRUNK_SCORE = 0.15  # Score from which hips and shoulders show the direction of the trunk.


def trunk_roll_deg(keypoints: ObservedKeypoints | None) -> float | None:
    """Direction from hips to shoulders, clockwise from up; None if either is not visible."""
    if keypoints is None:
        return None
    hips, shoulders = (
        _mean_position(keypoints, part, _MIN_TRUNK_SCORE) for part in ("hip", "shoulder")
    )
    if hips is None or shoulders is None:
        return None
    right, down = shoulders - hips
    return float(np.rad2deg(np.arctan2(right, -down)))


def _mean_position(
    keypoints: ObservedKeypoints, part: str, min_score: float
) -> NDArray[np.float64] | None:
    """Mean position ``(2,)`` of a part on both sides, by score; None if neither is visible."""
    rows = coco_rows(part)
    scores = keypoints.scores[rows]
    if scores.max() < min_score:
        return None
    return scores @ keypoints.positions[rows] / scores.sum()


# Weights in the quality, beside the agreement with MoveNet.
_PRESENCE_WEIGHT = 0.3
_DRIFT_WEIGHT = 1.0
AGREEMENT_DISTANCE = 0.15
"""Distance, in sizes of the body, up to which a keypoint and its landmark agree."""

_UNKNOWN_AGREEMENT = 0.6  # Agreement assumed if MoveNet finds no person.


def reading_quality(reading: PoseReading, keypoints: ObservedKeypoints | None) -> float:
    """Quality of a reading: agreement with MoveNet, presence, and a window that stays in place."""
    agreement = _UNKNOWN_AGREEMENT
    if keypoints is not None:
        agreement = _agreement(reading, keypoints)
    return agreement + _PRESENCE_WEIGHT * reading.presence - _DRIFT_WEIGHT * reading.drift


# Only the nose represents the face.
_COMPARED = [row for row in range(len(COCO_NAMES)) if row not in coco_rows("eye", "ear")]


def _agreement(reading: PoseReading, keypoints: ObservedKeypoints) -> float:
    """Share of MoveNet's keypoints, weighted by score, that the landmarks match, 0 to 1."""
    scores = keypoints.scores[_COMPARED]
    distances = _distances(reading, keypoints)[_COMPARED]
    agrees = np.exp(-((distances / AGREEMENT_DISTANCE) ** 2))
    total = float(scores.sum())
    # Few keypoints are little evidence.
    known = min(1.0, total)
    share = float((scores * agrees).sum() / max(total, 1e-9))
    return known * share + (1 - known) * _UNKNOWN_AGREEMENT


def _distances(reading: PoseReading, keypoints: ObservedKeypoints) -> NDArray[np.float64]:
    """Distances ``(17,)`` of keypoints from the landmarks of their names, in sizes of the body."""
    offsets = keypoints.positions - reading.landmarks.positions[COCO_LANDMARKS]
    return np.linalg.norm(offsets, axis=1) / reading.body_px


_OTHER_SIDE_LANDMARKS = [
    LANDMARK_NAMES.index(
        name.replace("left", "right") if name.startswith("left") else name.replace("right", "left")
    )
    for name in COCO_NAMES
]


def sides_exchanged(reading: PoseReading, keypoints: ObservedKeypoints) -> bool:
    """Whether MoveNet's keypoints lie nearer to the landmarks of the other side."""
    offsets = keypoints.positions - reading.landmarks.positions[_OTHER_SIDE_LANDMARKS]
    exchanged = np.linalg.norm(offsets, axis=1) / reading.body_px
    scores = keypoints.scores[_COMPARED]
    return bool(scores @ exchanged[_COMPARED] < scores @ _distances(reading, keypoints)[_COMPARED])


# Weight of a keypoint of score 1, relative to the landmark with which it agrees.
_KEYPOINT_WEIGHT = 2.0


def fuse(reading: PoseReading, keypoints: ObservedKeypoints) -> PoseReading:
    """Move landmarks towards the keypoints of MoveNet that agree with them."""
    agrees = _distances(reading, keypoints) < AGREEMENT_DISTANCE
    weights = _KEYPOINT_WEIGHT * keypoints.scores * agrees
    positions = reading.landmarks.positions.copy()
    shares = (weights / (1 + weights))[:, None]
    positions[COCO_LANDMARKS] += shares * (keypoints.positions - positions[COCO_LANDMARKS])
    landmarks = replace(reading.landmarks, positions=positions)
    return replace(reading, landmarks=landmarks, keypoints=keypoints)
