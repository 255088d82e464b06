"""Reads one person: the first trusted reading of several windows, fused with MoveNet's keypoints.

The landmark network is reliable if its window is right: about the body, with the trunk upright.
Windows come from the detectors and from tracks. Trust, the probability that a reading is right,
says when no further one is needed. MoveNet's keypoints need no window; they make the landmarks more
precise where both networks agree, and show whose they are among people close together.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.blazepose import LANDMARK_PX, LandmarkNetwork, MaskNetwork, PoseReading
from app.vision.geometry import Box, PersonWindow, transform_points
from app.vision.halved import Frame, whole
from app.vision.judgement import JudgedReading, PhotographModels
from app.vision.movenet import KeypointReader
from app.vision.optics import PinholeCamera
from app.vision.people import (
    COCO_LANDMARKS,
    COCO_NAMES,
    LANDMARK_NAMES,
    Detection,
    ObservedKeypoints,
    coco_rows,
)
from app.vision.truncation import MIN_SEEN, MIN_VISIBLE_SCORE, ends_at_border

MIN_PRESENCE = 0.5
"""Presence from which the landmark network recognises a person."""


@dataclass(frozen=True)
class PersonReader:
    """Reads people; thread-safe."""

    network: LandmarkNetwork
    mask_network: MaskNetwork
    keypoint_reader: KeypointReader
    judgement: PhotographModels

    def read(
        self,
        frame: Frame,
        camera: PinholeCamera,
        found: Detection,
        expected: PersonWindow | PoseReading | None = None,
    ) -> JudgedReading:
        """Read a person: the first reading that is good enough, else the best.

        The better one is a reading with which most keypoints agree, or has more of trust and
        agreement together. It is good enough if most agree, and the two add up to 1.

        Parameters
        ----------
        frame : (H, W, 3) uint8 array
            BGR.
        camera : PinholeCamera
        found : Detection
            The box is tight around the visible person. Without keypoints, MoveNet reads them there.
        expected : PersonWindow or PoseReading, optional
            Window in which a track expects the person, or the reading in it; it comes first.

        Returns
        -------
        JudgedReading
            Its landmarks are fused with the keypoints that agree with them; without the mask.
        """
        keypoints = found.keypoints or self.keypoint_reader.read(frame, found.box)
        about = PersonWindow.about_box(found.box, trunk_roll_deg(keypoints) or 0.0)
        readings = list[JudgedReading]()

        def rank(reading: JudgedReading) -> tuple[bool, float]:
            share = agreement(reading, keypoints)
            return agrees(reading, keypoints), reading.trust.right + share

        def windows() -> Iterator[PersonWindow | PoseReading]:
            if expected is not None:
                yield expected
            yield from window_beyond_border(keypoints, found.box, frame.shape)
            yield from found.windows
            yield about
            yield replace(about, roll_deg=0.0)  # A person who leans may be read better.
            yield max(readings, key=rank).next_window
            yield replace(about, roll_deg=about.roll_deg + 180)

        for window in windows():
            if isinstance(window, PoseReading):
                reading = self._with_keypoints(window, camera, keypoints)
            elif any(window.on_grid() == earlier.window for earlier in readings):
                continue
            else:
                reading = self.judged(frame, camera, window, keypoints)
            if rank(reading) >= (True, 1.0):
                return reading
            readings.append(reading)
        return max(readings, key=rank)

    def follow(
        self,
        frame: Frame,
        camera: PinholeCamera,
        found: Detection,
        window: PersonWindow,
        least_trust: float,
        seen: Seen | None = None,
    ) -> JudgedReading | None:
        """Read a person in the window that their last landmarks point to.

        Parameters
        ----------
        found : Detection
            The box in which the person is expected.
        least_trust : float
            If the reading is trusted less, other windows are read as well.
        seen : Seen, optional
            What MoveNet saw when it looked last; it moves along with the landmarks, unless these
            have exchanged their sides. By default, MoveNet looks now, and other windows are read
            if it disagrees.

        Returns
        -------
        JudgedReading or None
            None if the window no longer shows the person.
        """
        alone = self.network.read(frame, window)
        if seen is None or sides_exchanged(alone, seen.before):
            looked = self.keypoint_reader.read(frame, alone.landmarks.box())
            found = replace(found, keypoints=looked)
            reading = self._with_keypoints(alone, camera, looked)
            is_doubtful = not agrees(reading, looked)
        else:
            reading = self._with_keypoints(alone, camera, seen.on_landmarks(alone))
            is_doubtful = False
        if is_doubtful or reading.trust.right < least_trust:
            reading = self.read(frame, camera, found, alone)
        return reading if reading.presence >= MIN_PRESENCE else None

    def read_beside(
        self,
        frame: Frame,
        camera: PinholeCamera,
        found: Detection,
        others: Sequence[PoseReading],
    ) -> JudgedReading | None:
        """Read a person close to others, with the others painted over so that none is read twice.

        The person's keypoints are known. None if the reading shows no person beside them.
        """
        keypoints = found.keypoints
        assert keypoints is not None
        alone = without_bodies(frame, found.box, keypoints, others)
        about = PersonWindow.about_box(found.box, trunk_roll_deg(keypoints) or 0.0)
        first = self.network.read(alone, about)
        if not agreement(first, keypoints):
            return None
        reading = self.read(alone, camera, Detection(found.box, found.score, keypoints), first)
        return reading if reading.trust.is_person and agrees(reading, keypoints) else None

    def judged(
        self,
        frame: Frame,
        camera: PinholeCamera,
        window: PersonWindow,
        keypoints: ObservedKeypoints | None = None,
    ) -> JudgedReading:
        """The reading of a window, fused with the person's keypoints if they are known."""
        return self._with_keypoints(self.network.read(frame, window), camera, keypoints)

    def _with_keypoints(
        self, reading: PoseReading, camera: PinholeCamera, keypoints: ObservedKeypoints | None
    ) -> JudgedReading:
        """The reading judged, and fused with keypoints if that has not been done."""
        is_fused = keypoints is None or reading.keypoints is not None
        if isinstance(reading, JudgedReading) and is_fused:
            return reading
        return self.judgement.judge(fuse(reading, keypoints) if keypoints else reading, camera)

    def with_mask(self, reading: JudgedReading) -> JudgedReading:
        """The same reading with its mask."""
        return self.mask_network.read(reading)


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
    scale = min(1.0, 2 * LANDMARK_PX / max(part.shape[:2]))
    size = max(1, round(scale * part.shape[1])), max(1, round(scale * part.shape[0]))

    def distances(positions: NDArray[np.float64], seen: NDArray[np.bool_]) -> NDArray[np.float32]:
        return _distance_to_limbs(size, scale * (positions - np.array([left, top])), seen)

    own = distances(keypoints.positions, keypoints.scores > _MIN_SCORE)
    hidden = np.zeros(size[::-1], bool)
    for other in others:
        seen = other.landmarks.visibility[COCO_LANDMARKS] > MIN_SEEN
        theirs = distances(other.landmarks.positions[COCO_LANDMARKS], seen)
        # Distance from the limbs up to which a body reaches, in sizes of the body.
        hidden |= (theirs <= own) & (theirs <= 0.2 * scale * other.body_px)
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
    # Distance from hips to feet, relative to the trunk.
    return [PersonWindow.about_circle(hips, hips + 1.7 * (top - hips))]


_MIN_SCORE = 0.15  # Score from which keypoints show the direction of the trunk, and limbs.


def trunk_roll_deg(keypoints: ObservedKeypoints | None) -> float | None:
    """Direction from hips to shoulders, clockwise from up; None if either is not visible."""
    if keypoints is None:
        return None
    hips, shoulders = (_mean_position(keypoints, part, _MIN_SCORE) for part in ("hip", "shoulder"))
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


AGREEMENT_DISTANCE = 0.15
"""Distance, in sizes of the body, up to which a keypoint and its landmark agree."""


# Only the nose represents the face.
_COMPARED = [row for row in range(len(COCO_NAMES)) if row not in coco_rows("eye", "ear")]


def agreement(reading: PoseReading, keypoints: ObservedKeypoints | None) -> float:
    """Share of MoveNet's keypoints, weighted by score, that the landmarks match; 0.5 if unknown."""
    if keypoints is None:
        return 0.5
    scores = keypoints.scores[_COMPARED]
    near = _distances(reading, keypoints)[_COMPARED] < AGREEMENT_DISTANCE
    return float(scores @ near / max(float(scores.sum()), 1e-9))


def agrees(reading: PoseReading, keypoints: ObservedKeypoints | None) -> bool:
    """Whether most keypoints agree: they do not if the reading is of another person's body.

    Nor do they if they lie nearer to the landmarks of the other side.
    """
    is_same_body = agreement(reading, keypoints) >= 0.5
    return is_same_body and not (keypoints and sides_exchanged(reading, keypoints))


_OTHER_SIDE_LANDMARKS = [
    LANDMARK_NAMES.index(
        name.replace("left", "right") if name.startswith("left") else name.replace("right", "left")
    )
    for name in COCO_NAMES
]


def sides_exchanged(reading: PoseReading, keypoints: ObservedKeypoints) -> bool:
    """Whether keypoints lie nearer to the landmarks of the other side."""
    apart = keypoints.positions - reading.landmarks.positions[_OTHER_SIDE_LANDMARKS]
    exchanged = np.linalg.norm(apart, axis=1) / reading.body_px
    scores = keypoints.scores[_COMPARED]
    return bool(scores @ exchanged[_COMPARED] < scores @ _distances(reading, keypoints)[_COMPARED])


def _distances(reading: PoseReading, keypoints: ObservedKeypoints) -> NDArray[np.float64]:
    """Distances ``(17,)`` of keypoints from the landmarks of their names, in sizes of the body."""
    offsets = keypoints.positions - reading.landmarks.positions[COCO_LANDMARKS]
    return np.linalg.norm(offsets, axis=1) / reading.body_px


@dataclass(frozen=True)
class Seen:
    """What MoveNet saw of a person when it looked last, beside the landmarks of a later reading."""

    apart: NDArray[np.float64]  # (17, 2): keypoints relative to landmarks, in sizes of the body
    before: ObservedKeypoints  # these landmarks, pixels, with the keypoints' scores

    @classmethod
    def of(cls, reading: JudgedReading) -> Self | None:
        """A reading's keypoints beside the network's own landmarks.

        None without keypoints, or unless the reading is trusted and nearly all of them agree: then
        MoveNet has to look at the next frame as well, or left and right may be exchanged.
        """
        keypoints = reading.keypoints
        if keypoints is None or not reading.trust.is_right:
            return None
        # Agreement from which MoveNet need not look at the next frame.
        if agreement(reading, keypoints) < 0.9:
            return None
        to_frame = reading.window.to_frame(LANDMARK_PX)
        points = reading.network_pass.points[COCO_LANDMARKS, :2].astype(np.float64)
        landmarks = transform_points(to_frame, points - 0.5)
        apart = (keypoints.positions - landmarks) / reading.body_px
        return cls(apart, replace(keypoints, positions=landmarks))

    def on_landmarks(self, reading: PoseReading) -> ObservedKeypoints:
        """The keypoints, moved along with the landmarks of a later reading."""
        positions = reading.landmarks.positions[COCO_LANDMARKS]
        return replace(self.before, positions=positions + reading.body_px * self.apart)


def fuse(reading: PoseReading, keypoints: ObservedKeypoints) -> PoseReading:
    """Move landmarks towards the keypoints of MoveNet that agree with them."""
    agrees = _distances(reading, keypoints) < AGREEMENT_DISTANCE
    # Weight of a keypoint of score 1, relative to the landmark with which it agrees.
    weights = 2.0 * keypoints.scores * agrees
    positions = reading.landmarks.positions.copy()
    shares = (weights / (1 + weights))[:, None]
    positions[COCO_LANDMARKS] += shares * (keypoints.positions - positions[COCO_LANDMARKS])
    landmarks = replace(reading.landmarks, positions=positions)
    return replace(reading, landmarks=landmarks, keypoints=keypoints)
