"""Re-scoring of the boxes that the networks find, by two detectors that see only these boxes.

OpenCV's HOG people detector, a linear SVM on histograms of oriented gradients [1]_, recognises
standing people. MediaPipe's object detector, a MobileNet [2]_ trained on Open Images, compares
people with animals and furniture.

References
----------
.. [1] N. Dalal, B. Triggs, "Histograms of oriented gradients for human detection", CVPR 2005.
.. [2] M. Sandler et al., "MobileNetV2: Inverted Residuals and Linear Bottlenecks", CVPR 2018.
"""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.networks.tflite import TfliteNetwork
from app.vision.geometry import Box, PersonWindow, resize, sample_window

PERSON_PX = 96
"""Height of a person in the windows on which the detector was trained."""

_WINDOW_PX = (64, 128)
_STRIDE_PX = 8
# Windows in which a box is scored, relative to the box.
_BOX_SCALE = 1.06
# Lower margins are raised to this.
_MIN_MARGIN = -5.0
# The score of a box is that of the best window within a stride around it.
_SCORED_PX = tuple(side + 2 * _STRIDE_PX for side in _WINDOW_PX)


def _people_classifier() -> cv2.HOGDescriptor:
    hog = cv2.HOGDescriptor()
    hog.setSVMDetector(cv2.HOGDescriptor_getDefaultPeopleDetector())  # type: ignore[attr-defined]
    return hog


# Shared by all threads: `detect` only reads the weights.
_HOG = _people_classifier()


def hog_margin(frame: NDArray[np.uint8], box: Box) -> float:
    """Signed distance from the decision boundary: how much a box looks like a person."""
    scale = _BOX_SCALE * box.height / PERSON_PX
    width, height = (max(1, round(side * scale)) for side in _SCORED_PX)
    left = round(box.x + 0.5 + (box.width - width) / 2)
    top = round(box.y + 0.5 + (box.height - height) / 2)
    # At whole pixels; the frame's border is repeated beyond the frame, so that no edge is added.
    around = cv2.getRectSubPix(
        frame, (width, height), (left + (width - 1) / 2, top + (height - 1) / 2)
    ).astype(np.uint8, copy=False)
    _, margins = _HOG.detect(resize(around, *_SCORED_PX), -10.0, (_STRIDE_PX, _STRIDE_PX), (0, 0))
    return max(_MIN_MARGIN, float(np.max(margins)))


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


class ObjectNetwork:
    """Distinguishes people from other objects; thread-safe.

    Parameters and errors are those of :class:`app.networks.tflite.TfliteNetwork`.
    """

    def __init__(self, path: Path, *, threads: int = 1, copies: int = 1) -> None:
        self._network = TfliteNetwork(
            path,
            [(_OBJECTS_PX, _OBJECTS_PX, 3)],
            [(cells, cells, anchors * len(_CLASSES)) for cells, anchors, _ in _GRIDS],
            threads=threads,
            copies=copies,
        )

    def log_odds(self, frame: NDArray[np.uint8], window: PersonWindow) -> tuple[float, float]:
        """Log odds of a person, and of the likeliest other object, in the middle of a window.

        Anchors fit objects about half as wide as the window; the largest log odds count. The frame
        is BGR, ``(H, W, 3)``.
        """
        seen = cv2.cvtColor(sample_window(frame, window.on_grid(), _OBJECTS_PX), cv2.COLOR_BGR2RGB)
        maps = self._network.run(seen / np.float32(127.5) - 1)
        anchors = [
            grid[cells, cells].reshape(-1, len(_CLASSES))
            for grid, (_, _, cells) in zip(maps, _GRIDS, strict=True)
        ]
        best = np.concatenate(anchors).max(axis=0)
        return float(best[_PERSON]), float(best[_OTHERS].max())
