"""The keypoints of one person, read in a window about them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.vision.keypoints.movenet import MoveNet, PersonInPicture
from app.vision.people import Box, ObservedKeypoints
from app.vision.resampling import Window, cut_resized

LONG_PX, SHORT_PX = 256, 160
"""Sides of the network's input: the long one along the person."""

ROOM = 1.25
"""Size of the window, as a multiple of the person's box."""

MIN_OVERLAP = 0.2
"""Least overlap (IoU) with the box of a person found in the window."""


class KeypointReader:
    """Reads keypoints; thread-safe.

    Parameters
    ----------
    network : MoveNet
    """

    def __init__(self, network: MoveNet) -> None:
        self._network = network

    def read(self, frame: NDArray[np.uint8], box: Box) -> ObservedKeypoints | None:
        """Read the keypoints of the person in a box.

        Parameters
        ----------
        frame : (H, W, 3) uint8 array
            BGR.
        box : Box
            Tight around the visible person.

        Returns
        -------
        ObservedKeypoints or None
            Pixels of the frame; None if the network finds nobody in the box.
        """
        window, columns, rows = keypoint_window(box)
        seen = self._network.people(cut_resized(frame, window, columns, rows))
        scale = window[2] / columns
        inside = Box(box.x - window[0], box.y - window[1], box.width, box.height).scaled(1 / scale)
        person = _best_match(seen, inside)
        if person is None:
            return None
        return person.keypoints.scaled(scale).moved(window[0], window[1])


def keypoint_window(box: Box) -> tuple[Window, int, int]:
    """Window about a box in whole pixels, and the columns and rows it is resized to."""
    columns, rows = (LONG_PX, SHORT_PX) if box.width > box.height else (SHORT_PX, LONG_PX)
    scale = ROOM * max(box.width / columns, box.height / rows)
    width, height = max(1, round(scale * columns)), max(1, round(scale * rows))
    left = round(box.x + 0.5 + (box.width - width) / 2)
    top = round(box.y + 0.5 + (box.height - height) / 2)
    return (left, top, width, height), columns, rows


def _best_match(people: list[PersonInPicture], box: Box) -> PersonInPicture | None:
    """The person whom a box is about; the window may show neighbours as well."""
    # A blank wall can have a centre but no keypoints: its score is 0.
    near = [person for person in people if person.score > 0 and box.iou(person.box) >= MIN_OVERLAP]
    return max(near, key=lambda p: box.iou(p.box) * p.centre_score**0.5, default=None)
