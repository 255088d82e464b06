"""Videos and expensive pictures, decoded in processes of their own. Imports vision and below."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

MIN_STEP_S = 1e-3
"""Seconds from one frame to the next; closer ones have no order that a camera could have seen."""


class Frame(NamedTuple):
    """A frame of a video: its number from 0, skipped ones included, and the upright picture.

    The picture is ``(H, W, 3)``, BGR; a pixel is ``pixel_aspect`` times as wide as high.
    ``timestamp`` is in seconds since the first frame, and ascends. A frame is damaged if data is
    missing or wrong, in it or in one that it builds on.
    """

    number: int
    timestamp: float
    pixels: NDArray[np.uint8]
    pixel_aspect: float = 1.0
    damaged: bool = False
