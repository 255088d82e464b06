"""BlazePose's person detector: large people in any orientation, with the circle about each body.

Anchors lie at the centres of the cells of strides 8 (two a cell), 16 (two) and 32 (six). The
network gives each a score and the offsets of a box and of four points, of which the first is the
middle of the hips and the second lies on the circle about the whole body, towards the head [1]_.

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
from app.vision.odds import sigmoid
from app.vision.people import PersonWindow
from app.vision.person.window import window_of_circle
from app.vision.resampling import resize
from app.vision.tflite import TfliteNetwork

PIXELS = 224
"""Side of the network's input."""

CELLS = ((8, 2), (16, 2), (32, 6))
"""Strides, and anchors a cell."""

_ANCHORS, _VALUES = 2254, 12
_OVERLAP = 0.3


@dataclass(frozen=True)
class BodyCircle:
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
            (PIXELS, PIXELS, 3),
            [(_ANCHORS, _VALUES), (_ANCHORS, 1)],
            threads=threads,
            copies=copies,
        )

    def bodies(self, frame: NDArray[np.uint8], least_score: float) -> list[BodyCircle]:
        """Find bodies, best first.

        Parameters
        ----------
        frame : (H, W, 3) uint8 array
            BGR; shown whole, so that only large people are found.
        least_score : float
        """
        height, width = frame.shape[:2]
        factor = PIXELS / max(height, width)
        columns, rows = max(1, round(width * factor)), max(1, round(height * factor))
        left, top = (PIXELS - columns) // 2, (PIXELS - rows) // 2
        picture: NDArray[np.float32] = np.full((PIXELS, PIXELS, 3), -1, np.float32)
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
        return [BodyCircle(window_of_circle(*points[i, :2]), float(scores[used[i]])) for i in kept]


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
        places = (np.arange(PIXELS // stride) + 0.5) * stride
        x, y = np.meshgrid(places, places)
        layers.append(np.repeat(np.stack([x.ravel(), y.ravel()], axis=-1), count, axis=0))
    return np.concatenate(layers)


_CENTRES = _anchor_centres()
