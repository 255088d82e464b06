"""Frames decoded at half their size.

Networks see a person in 160 to 256 pixels, and the whole frame in 640. From the coefficients of a
JPEG, half its size is decoded in half the time of all its pixels, and is what large people and the
frame are sampled from. Whatever is found is in pixels of the whole frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

HALF = 0.5


@dataclass(frozen=True, eq=False)
class HalvedFrame:
    """A frame of a ``shape`` ``(H, W, 3)``, of which half the size is decoded.

    The pixels of ``half``, BGR, are means of two by two of the frame's; an odd side is rounded up.
    """

    shape: tuple[int, ...]
    half: NDArray[np.uint8]
    decode: Callable[[], NDArray[np.uint8]]

    @cached_property
    def whole(self) -> NDArray[np.uint8]:
        """All pixels ``(H, W, 3)``; decoded when they are first asked for."""
        return self.decode()


Frame = NDArray[np.uint8] | HalvedFrame
"""Pixels ``(H, W, 3)``, BGR, or half of them."""


def seen_at(frame: Frame, scale: float) -> tuple[NDArray[np.uint8], float]:
    """Pixels that show a frame at a scale or finer, and their own scale: 1, or a half.

    ``scale`` is that of the picture to be sampled, relative to the frame. Which pixels these are
    depends on nothing else, so that readings may take place in any order.
    """
    if not isinstance(frame, HalvedFrame):
        return frame, 1.0
    return (frame.half, HALF) if scale <= HALF else (frame.whole, 1.0)


def whole(frame: Frame) -> NDArray[np.uint8]:
    return seen_at(frame, 1.0)[0]
