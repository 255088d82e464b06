"""Whether a person's face is seen from the front.

A network that has seen no real face knows none. OpenCV brings along a cascade [1]_ that was trained
on thousands, and takes hardly anything else for one.

References
----------
.. [1] P. Viola, M. Jones, "Rapid Object Detection using a Boosted Cascade of Simple Features",
   CVPR 2001.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.copies import Copies
from app.vision.resampling import Window, cut, resize

CASCADE_PATH = Path(cv2.__file__).parent / "data" / "haarcascade_frontalface_alt2.xml"

SIZE = 64
"""Pixels, each way, at which a head is looked at."""

# Faces are looked for that take so many of these pixels.
_LEAST, _MOST = 20, 44
_STEP = 1.15
# So many of the windows about a face must hold one.
_AGREEING = 1


class FaceError(RuntimeError):
    """OpenCV lacks its cascade."""


class FaceFinder:
    """The cascade; safe under several threads.

    Parameters
    ----------
    path : Path
        A cascade as OpenCV stores it.

    Raises
    ------
    FaceError
        If the file is missing or is no cascade.
    """

    def __init__(self, path: Path = CASCADE_PATH) -> None:
        self._path = path
        # A cascade keeps the picture inside, so each serves one call at a time.
        self._copies = Copies(self._read)
        with self._copies.one():
            pass  # A broken file is told now.

    def _read(self) -> cv2.CascadeClassifier:
        try:
            cascade = cv2.CascadeClassifier(str(self._path))
        except (cv2.error, SystemError) as error:
            raise FaceError(f"{self._path} is not a cascade OpenCV can run") from error
        if cascade.empty():
            raise FaceError(f"{self._path} is missing or is not a cascade OpenCV can run")
        return cascade

    def finds(self, frame: NDArray[np.uint8], head: Window) -> bool:
        """Whether a window of a frame shows a face from the front.

        Parameters
        ----------
        frame : (H, W, 3) uint8 array
            BGR.
        head : (left, top, side, side)
            A square twice to three times as wide as a face.
        """
        colour = resize(cut(frame, head), SIZE, SIZE)
        grey = cv2.equalizeHist(cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY))
        with self._copies.one() as cascade:
            found = cascade.detectMultiScale(
                grey, _STEP, _AGREEING, minSize=(_LEAST, _LEAST), maxSize=(_MOST, _MOST)
            )
        return len(found) > 0
