"""The landmark network: mask, landmarks and depth of the person in a window, in one pass.

It is MediaPipe's pose network [1]_.

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

from app.vision.odds import sigmoid
from app.vision.people import LANDMARK_NAMES, Landmarks, ObservedKeypoints, PersonWindow
from app.vision.person.window import (
    cut_window,
    window_drift,
    window_of_circle,
    window_to_frame,
)
from app.vision.tflite import TfliteNetwork

PIXELS = 256
"""Side of the network's input and mask."""

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
            (PIXELS, PIXELS, 3),
            [(5 * _POINTS,), (1,), (PIXELS, PIXELS, 1), (3 * _POINTS,)],
            threads=threads,
            copies=copies,
        )

    def read(self, frame: NDArray[np.uint8], window: PersonWindow) -> Reading:
        """Read the person in a window of a frame ``(H, W, 3)``, BGR."""
        picture = cv2.cvtColor(cut_window(frame, window, PIXELS), cv2.COLOR_BGR2RGB)
        image, presence, log_odds, world = self._network.run(picture * np.float32(1 / 255))
        points = image.reshape(_POINTS, 5).astype(np.float64)
        to_frame = window_to_frame(window, PIXELS)
        # The network counts from the corner of the first pixel.
        places = (points[:, :2] - 0.5) @ to_frame[:, :2].T + to_frame[:, 2]
        visibility = sigmoid(points[:_LANDMARKS, 3])
        metres = world.reshape(_POINTS, 3)[:_LANDMARKS].astype(np.float64)
        turn = to_frame[:, :2] / (window.side / PIXELS)
        metres = np.hstack([metres[:, :2] @ turn.T, metres[:, 2:]])
        return Reading(
            window,
            Landmarks(places[:_LANDMARKS], visibility, metres),
            float(presence[0]),
            sigmoid(log_odds[..., 0]),
            window_of_circle(places[_CENTRE], places[_CIRCLE]),
        )
