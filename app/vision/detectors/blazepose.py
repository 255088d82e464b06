"""BlazePose's detector [1]_ of large people in any pose and orientation.

It finds a circle about each body. The network has anchors at the centres of the cells of three
grids. It gives each anchor a score and the offsets of a box and of four points: the first is the
middle of the hips, the second lies on the circle, in the direction of the head.

References
----------
.. [1] V. Bazarevsky et al., "BlazePose: On-device Real-time Body Pose tracking", 2020.
"""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.networks.probabilities import sigmoid
from app.networks.tflite import TfliteNetwork
from app.vision.detectors.tiles import Picture
from app.vision.geometry import PersonWindow, non_max_suppression, resize
from app.vision.halved import whole
from app.vision.people import Detection

DETECTOR_PX = 224
"""Side of the detector's input."""

ANCHOR_GRIDS = ((8, 2), (16, 2), (32, 6))
"""Stride of each grid in pixels, and anchors per cell."""

_ANCHORS = 2254


class BlazePoseDetector(TfliteNetwork):
    """BlazePose's person detector."""

    def __init__(self, path: Path, **share: int) -> None:
        outputs = [(_ANCHORS, 12), (_ANCHORS, 1)]
        super().__init__(path, [(DETECTOR_PX, DETECTOR_PX, 3)], outputs, **share)

    def detect(self, picture: Picture) -> list[Detection]:
        """Detect bodies, best first: the window about each, and the box about its circle.

        The network sees the whole frame, so it finds only large people.
        """
        overview = picture.tiles[0]
        # An enlarged overview shows no more than the frame.
        image, factor = picture.overview, overview.factor
        if factor > 1:
            image, factor = whole(picture.frame), 1.0
        found = []
        for circle, score in self._circles(image):
            window = PersonWindow.about_circle(*circle).scaled(1 / factor)
            found.append(Detection(window.circle_box(), score, None, (window,)))
        return found

    def _circles(self, image: NDArray[np.uint8]) -> list[tuple[NDArray[np.float64], float]]:
        """Centre and top ``(2, 2)`` of the circle about each body of an image, and its score."""
        height, width = image.shape[:2]
        factor = DETECTOR_PX / max(height, width)
        columns, rows = max(1, round(width * factor)), max(1, round(height * factor))
        left, top = (DETECTOR_PX - columns) // 2, (DETECTOR_PX - rows) // 2
        padded: NDArray[np.float32] = np.full((DETECTOR_PX, DETECTOR_PX, 3), -1, np.float32)
        small = cv2.cvtColor(resize(image, columns, rows), cv2.COLOR_BGR2RGB)
        padded[top : top + rows, left : left + columns] = small / np.float32(127.5) - 1
        values, log_odds = self.run(padded)
        scores = sigmoid(log_odds[:, 0].astype(np.float64))
        used = np.flatnonzero(scores >= 0.3)
        boxes, points = decode_anchors(values, used)
        # Two boxes that overlap by this belong to one body.
        kept = non_max_suppression(boxes, scores[used], 0.3)
        # The scale leads from pixel centres of the network's input to those of the image.
        scale = np.array([width / columns, height / rows])
        points = (points - [left, top]) * scale - 0.5
        return [(points[i, :2], float(scores[used[i]])) for i in kept]


def decode_anchors(
    values: NDArray[np.float32], used: NDArray[np.integer]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Boxes ``(K, 4)`` and points ``(K, 4, 2)`` of the anchors in rows ``used`` ``(K,)``.

    They are in pixels of the network's input, from the corner of the first pixel.
    """
    raw = values[used].astype(np.float64)
    anchors = _ANCHOR_CENTRES[used]
    size = raw[:, 2:4]
    boxes = np.hstack([raw[:, :2] + anchors - size / 2, size])
    return boxes, raw[:, 4:].reshape(-1, 4, 2) + anchors[:, None]


def _anchor_centres() -> NDArray[np.float64]:
    """Centres ``(2254, 2)`` of all anchors, x before y."""
    grids = []
    for stride, count in ANCHOR_GRIDS:
        centres = (np.arange(DETECTOR_PX // stride) + 0.5) * stride
        x, y = np.meshgrid(centres, centres)
        grids.append(np.repeat(np.stack([x.ravel(), y.ravel()], axis=-1), count, axis=0))
    return np.concatenate(grids)


_ANCHOR_CENTRES = _anchor_centres()
