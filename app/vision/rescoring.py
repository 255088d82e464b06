"""Re-scoring of the boxes that the detectors find, by an object detector that sees only these.

MediaPipe's object detector, a MobileNet [1]_ trained on Open Images, compares people with animals
and furniture.

References
----------
.. [1] M. Sandler et al., "MobileNetV2: Inverted Residuals and Linear Bottlenecks", CVPR 2018.
"""

from pathlib import Path

import cv2
import numpy as np

from app.networks.tflite import TfliteNetwork
from app.vision.geometry import PersonWindow, sample_window
from app.vision.halved import Frame

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

    def log_odds(self, frame: Frame, window: PersonWindow) -> tuple[float, float]:
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
