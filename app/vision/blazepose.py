"""BlazePose: its person detector, and its landmark network.

The detector finds large people in any orientation, with the circle about each body. Anchors lie at
the centres of the cells of strides 8 (two a cell), 16 (two) and 32 (six). The network gives each a
score and the offsets of a box and of four points, of which the first is the middle of the hips and
the second lies on the circle about the whole body, towards the head [1]_.

The landmark network reads the mask, landmarks and depth of the person in a window in one pass.

References
----------
.. [1] V. Bazarevsky et al., "BlazePose: On-device Real-time Body Pose tracking", 2020.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.boxes import suppress
from app.vision.geometry import LANDMARK_NAMES, Landmarks, ObservedKeypoints, PersonWindow
from app.vision.odds import sigmoid
from app.vision.tflite import TfliteNetwork
from app.vision.windows import (
    cut_window,
    resize,
    window_drift,
    window_of_circle,
    window_to_frame,
)

LANDMARK_PX = 256
"""Side of the network's input and mask."""

DETECTION_PX = 224
"""Side of the network's input."""

CELLS = ((8, 2), (16, 2), (32, 6))
"""Strides, and anchors a cell."""

_ANCHORS, _VALUES = 2254, 12
_OVERLAP = 0.3

WINDOW_SIZES = 2.5
"""Side of a window in sizes of the body."""

_POINTS = 39
_LANDMARKS = len(LANDMARK_NAMES)
# Points beyond the landmarks: the centre of the circle about the body, and its point towards the
# head.
_CENTRE, _CIRCLE = 33, 34


@dataclass(frozen=True)
class Reading:
    """What the network reads in a window.

    Parameters
    ----------
    window : PersonWindow
    landmarks : Landmarks
        In pixels of the frame, and metres.
    presence : float
        Probability that a person is in the window, as the network gives it.
    probability : (256, 256) float32 array
        That each pixel of the window shows the person.
    next_window : PersonWindow
        Where the network would look next.
    keypoints : ObservedKeypoints or None
        What MoveNet reads of the same person, in pixels of the frame.
    """

    window: PersonWindow
    landmarks: Landmarks
    presence: float
    probability: NDArray[np.float32]
    next_window: PersonWindow
    keypoints: ObservedKeypoints | None = None

    @property
    def body_px(self) -> float:
        """Size of the body, in pixels of the frame."""
        return self.next_window.side / WINDOW_SIZES

    @property
    def drift(self) -> float:
        """How far the window is from the next; a wrong one drifts."""
        return window_drift(self.window, self.next_window)


class LandmarkNetwork:
    """The network; thread-safe.

    Parameters
    ----------
    path : Path
        ``pose_landmarks.tflite``.
    threads, copies : int
        As in :class:`app.vision.tflite.TfliteNetwork`.

    Raises
    ------
    NetworkError
        If the file cannot be read or is another network.
    """

    def __init__(self, path: Path, *, threads: int = 1, copies: int = 1) -> None:
        self._network = TfliteNetwork(
            path,
            (LANDMARK_PX, LANDMARK_PX, 3),
            [(5 * _POINTS,), (1,), (LANDMARK_PX, LANDMARK_PX, 1), (3 * _POINTS,)],
            threads=threads,
            copies=copies,
        )

    def read(self, frame: NDArray[np.uint8], window: PersonWindow) -> Reading:
        """Read the person in a window of a frame ``(H, W, 3)``, BGR."""
        picture = cv2.cvtColor(cut_window(frame, window, LANDMARK_PX), cv2.COLOR_BGR2RGB)
        image, presence, log_odds, world = self._network.run(picture * np.float32(1 / 255))
        points = image.reshape(_POINTS, 5).astype(np.float64)
        to_frame = window_to_frame(window, LANDMARK_PX)
        # The network counts from the corner of the first pixel.
        places = (points[:, :2] - 0.5) @ to_frame[:, :2].T + to_frame[:, 2]
        visibility = sigmoid(points[:_LANDMARKS, 3])
        metres = world.reshape(_POINTS, 3)[:_LANDMARKS].astype(np.float64)
        turn = to_frame[:, :2] / (window.side / LANDMARK_PX)
        metres = np.hstack([metres[:, :2] @ turn.T, metres[:, 2:]])
        return Reading(
            window,
            Landmarks(places[:_LANDMARKS], visibility, metres),
            float(presence[0]),
            sigmoid(log_odds[..., 0]),
            window_of_circle(places[_CENTRE], places[_CIRCLE]),
        )


@dataclass(frozen=True)
class BlazePoseDetection:
    """A body as the network detects it.

    Parameters
    ----------
    window : PersonWindow
        About the circle around the body, the trunk upright.
    score : float
        0 to 1; not a probability.
    """

    window: PersonWindow
    score: float


class PoseDetection:
    """The network; thread-safe.

    Parameters
    ----------
    path : Path
        ``pose_detection.tflite``.
    threads, copies : int
        As in :class:`app.vision.tflite.TfliteNetwork`.

    Raises
    ------
    NetworkError
        If the file cannot be read or is another network.
    """

    def __init__(self, path: Path, *, threads: int = 1, copies: int = 1) -> None:
        self._network = TfliteNetwork(
            path,
            (DETECTION_PX, DETECTION_PX, 3),
            [(_ANCHORS, _VALUES), (_ANCHORS, 1)],
            threads=threads,
            copies=copies,
        )

    def bodies(self, frame: NDArray[np.uint8], least_score: float) -> list[BlazePoseDetection]:
        """Find bodies, best first.

        Parameters
        ----------
        frame : (H, W, 3) uint8 array
            BGR; shown whole, so that only large people are found.
        least_score : float
        """
        height, width = frame.shape[:2]
        factor = DETECTION_PX / max(height, width)
        columns, rows = max(1, round(width * factor)), max(1, round(height * factor))
        left, top = (DETECTION_PX - columns) // 2, (DETECTION_PX - rows) // 2
        picture: NDArray[np.float32] = np.full((DETECTION_PX, DETECTION_PX, 3), -1, np.float32)
        shown = cv2.cvtColor(resize(frame, columns, rows), cv2.COLOR_BGR2RGB)
        picture[top : top + rows, left : left + columns] = shown / np.float32(127.5) - 1
        values, log_odds = self._network.run(picture)
        scores = sigmoid(log_odds[:, 0].astype(np.float64))
        used = np.flatnonzero(scores >= least_score)
        boxes, points = decode(values, used)
        kept = suppress(boxes, scores[used], _OVERLAP)
        # Pixel centres of the picture to those of the frame.
        scale = np.array([width / columns, height / rows])
        points = (points - [left, top]) * scale - 0.5
        return [
            BlazePoseDetection(window_of_circle(*points[i, :2]), float(scores[used[i]]))
            for i in kept
        ]


def decode(
    values: NDArray[np.float32], used: NDArray[np.integer]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Boxes ``(K, 4)`` and points ``(K, 4, 2)`` of anchors, from the corner of the picture."""
    raw = values[used].astype(np.float64)
    anchors = _CENTRES[used]
    size = raw[:, 2:4]
    boxes = np.hstack([raw[:, :2] + anchors - size / 2, size])
    return boxes, raw[:, 4:].reshape(-1, 4, 2) + anchors[:, None]


def _anchor_centres() -> NDArray[np.float64]:
    layers = []
    for stride, count in CELLS:
        places = (np.arange(DETECTION_PX // stride) + 0.5) * stride
        x, y = np.meshgrid(places, places)
        layers.append(np.repeat(np.stack([x.ravel(), y.ravel()], axis=-1), count, axis=0))
    return np.concatenate(layers)


_CENTRES = _anchor_centres()
