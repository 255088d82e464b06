"""What a photograph shows of one person: the best reading of a few windows, and its keypoints.

The landmark network reads well where its window is right: about the body, the trunk upright. The
windows come from the detectors. MoveNet's keypoints, read without any window, say which of the
readings is right, and place joints a little more finely where they agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.vision.blazepose import LandmarkNetwork, Reading
from app.vision.geometry import (
    COCO_NAMES,
    COCO_ROWS,
    LANDMARK_NAMES,
    Box,
    Landmarks,
    ObservedKeypoints,
    PersonWindow,
)
from app.vision.movenet import KeypointReader
from app.vision.truncation import ends_at_border
from app.vision.windows import window_about, window_of_circle

SURE = 0.85
"""Quality from which a reading is taken without trying another window."""

PRESENCE_WEIGHT, DRIFT_WEIGHT = 0.3, 1.0
"""Weights of the network's presence and of the window's drift beside the agreement with MoveNet."""

AGREES_WITHIN = 0.15
"""Distance, as a share of the body's size, within which keypoints of both networks are fused."""

KEYPOINT_WEIGHT = 2.0
"""Weight of a MoveNet keypoint of score 1 against the landmark it agrees with."""

NEAR_BORDER = 0.3
"""Distance from the frame's border, as a share of the body's size, within which landmarks are
visible only as far as MoveNet's keypoints are."""

SEEN_SCORE = 0.25
"""Score of a MoveNet keypoint from which it is seen."""

UNKNOWN_AGREEMENT = 0.6
"""Agreement where MoveNet reads nothing to agree with."""

_COMPARED = [
    i for i, name in enumerate(COCO_NAMES) if name == "nose" or not name.endswith(("eye", "ear"))
]
_LEAST_SCORE = 0.15
# From the hips to the feet, as a multiple of the trunk.
_BODY_OF_TRUNK = 1.7


def _keypoint_of(landmark: str) -> int:
    """Position in ``COCO_NAMES`` of the keypoint of the same part of the body."""
    if landmark.startswith("mouth"):
        return COCO_NAMES.index("nose")
    side, _, part = landmark.partition("_")
    if part.startswith("eye"):
        part = "eye"
    elif part in ("pinky", "index", "thumb"):
        part = "wrist"
    elif part in ("heel", "foot_index"):
        part = "ankle"
    return COCO_NAMES.index(f"{side}_{part}" if part else side)


_KEYPOINT_OF_LANDMARK = [_keypoint_of(name) for name in LANDMARK_NAMES]


@dataclass(frozen=True)
class PersonReader:
    """Reads people; thread-safe.

    Parameters
    ----------
    network : LandmarkNetwork
    keypoint_reader : KeypointReader
        Reads the keypoints of people for whom none are known.
    """

    network: LandmarkNetwork
    keypoint_reader: KeypointReader

    def read(
        self,
        frame: NDArray[np.uint8],
        box: Box,
        keypoints: ObservedKeypoints | None = None,
        windows: Sequence[PersonWindow] = (),
    ) -> Reading:
        """Read the person in a box.

        Parameters
        ----------
        frame : (H, W, 3) uint8 array
            BGR.
        box : Box
            Tight around the visible person.
        keypoints : ObservedKeypoints, optional
            MoveNet's, in pixels of the frame; read in the box where they are not given.
        windows : sequence of PersonWindow
            Where else the person may be, the likeliest first.

        Returns
        -------
        Reading
            Its landmarks fused with the keypoints that agree.
        """
        if keypoints is None:
            keypoints = self.keypoint_reader.read(frame, box)
        best = None
        beyond = window_beyond_border(keypoints, box, frame.shape)
        about = window_about(box, trunk_roll_deg(keypoints) or 0.0)
        for window in (*beyond, *windows, about):
            best = self._better(best, frame, window, keypoints)
            if quality(best, keypoints) >= SURE:
                break
        else:
            assert best is not None
            best = self._better(best, frame, best.next_window, keypoints)
        return best if keypoints is None else fuse(best, keypoints)

    def _better(
        self,
        best: Reading | None,
        frame: NDArray[np.uint8],
        window: PersonWindow,
        keypoints: ObservedKeypoints | None,
    ) -> Reading:
        """The better of a reading and that of another window."""
        other = self.network.read(frame, window)
        if best is None or quality(other, keypoints) > quality(best, keypoints):
            return other
        return best


def window_beyond_border(
    keypoints: ObservedKeypoints | None, box: Box, frame_shape: tuple[int, ...]
) -> list[PersonWindow]:
    """Window about the whole of a body whose head or feet the border cuts off, if it is one.

    The other windows hold what is seen of it, in which the network reads a small whole body.
    """
    if keypoints is None or not ends_at_border(box, frame_shape):
        return []
    head, shoulders, hips, ankles = (
        _middle(keypoints, part, SEEN_SCORE) for part in ("nose", "shoulder", "hip", "ankle")
    )
    if hips is None or (head is None) == (ankles is None):
        return []
    if head is None:
        assert ankles is not None
        towards_head = hips - ankles
    else:
        towards_head = _BODY_OF_TRUNK * ((head if shoulders is None else shoulders) - hips)
    return [window_of_circle(hips, hips + towards_head)]


def quality(reading: Reading, keypoints: ObservedKeypoints | None) -> float:
    """How far to trust a reading: agreement with MoveNet, presence, and a window that stays."""
    agreement = UNKNOWN_AGREEMENT if keypoints is None else _agreement(reading, keypoints)
    return agreement + PRESENCE_WEIGHT * reading.presence - DRIFT_WEIGHT * reading.drift


def _agreement(reading: Reading, keypoints: ObservedKeypoints) -> float:
    """Share of MoveNet's keypoints, by score, at which the reading's lie, 0 to 1."""
    scores = keypoints.scores[_COMPARED]
    apart = _apart(reading, keypoints)[_COMPARED]
    agrees = np.exp(-((apart / AGREES_WITHIN) ** 2))
    total = float(scores.sum())
    # Few keypoints say little.
    known = min(1.0, total)
    share = float((scores * agrees).sum() / max(total, 1e-9))
    return known * share + (1 - known) * UNKNOWN_AGREEMENT


def _apart(reading: Reading, keypoints: ObservedKeypoints) -> NDArray[np.float64]:
    """Distances ``(17,)`` between both networks' keypoints, in sizes of the body."""
    size = reading.body_px
    offsets = keypoints.positions - reading.landmarks.positions[COCO_ROWS]
    return np.asarray(np.linalg.norm(offsets, axis=1) / size)


def fuse(reading: Reading, keypoints: ObservedKeypoints) -> Reading:
    """Move landmarks towards the keypoints of MoveNet that agree with them."""
    weights = KEYPOINT_WEIGHT * keypoints.scores * (_apart(reading, keypoints) < AGREES_WITHIN)
    landmarks = reading.landmarks
    positions = landmarks.positions.copy()
    shares = (weights / (1 + weights))[:, None]
    positions[COCO_ROWS] += shares * (keypoints.positions - positions[COCO_ROWS])
    landmarks = replace(landmarks, positions=positions)
    return replace(reading, landmarks=landmarks, keypoints=keypoints)


def attenuate_visibility_at_border(reading: Reading, frame_shape: tuple[int, ...]) -> Landmarks:
    """Landmarks of a reading, near the frame's border no more visible than MoveNet's keypoints.

    The landmark network squeezes a body that the border cuts into what is left of it, and says that
    all of it is visible. MoveNet gives what it does not see a low score.
    """
    landmarks = reading.landmarks
    if reading.keypoints is None:
        return landmarks
    reach = NEAR_BORDER * reading.body_px
    end = np.array([frame_shape[1], frame_shape[0]]) - 1
    near = ((landmarks.positions < reach) | (landmarks.positions > end - reach)).any(axis=1)
    seen = np.minimum(1.0, reading.keypoints.scores[_KEYPOINT_OF_LANDMARK] / SEEN_SCORE)
    visibility = np.where(near, seen * landmarks.visibility, landmarks.visibility)
    return replace(landmarks, visibility=visibility)


def trunk_roll_deg(keypoints: ObservedKeypoints | None) -> float | None:
    """Direction from the hips to the shoulders, clockwise from up; None where either is unseen."""
    if keypoints is None:
        return None
    hips, shoulders = (_middle(keypoints, part) for part in ("hip", "shoulder"))
    if hips is None or shoulders is None:
        return None
    right, down = shoulders - hips
    return float(np.rad2deg(np.arctan2(right, -down)))


def _middle(
    keypoints: ObservedKeypoints, part: str, least_score: float = _LEAST_SCORE
) -> NDArray[np.float64] | None:
    rows = [i for i, name in enumerate(COCO_NAMES) if name.endswith(part)]
    scores = keypoints.scores[rows]
    if scores.max() < least_score:
        return None
    return np.asarray(scores @ keypoints.positions[rows] / scores.sum())
