"""The keypoints of one person, read in a window about them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.vision.keypoints.movenet import MoveNet, PersonInPicture
from app.vision.people import Box, ObservedKeypoints
from app.vision.resampling import Window, cut_resized

LONG_PX, SHORT_PX = 256, 160
"""Sides of the window as the network sees it: the long one along the person."""

ROOM = 1.25
"""How much wider and higher than the person's box the window is."""

LEAST_OVERLAP = 0.2
"""Overlap (IoU) with the box from which somebody seen in the window may be the person."""


class KeypointReader:
    """Reads keypoints; safe under several threads.

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
            Pixels of the frame; None where the network sees nobody in the box.
        """
        window, columns, rows = keypoint_window(box)
        seen = self._network.people(cut_resized(frame, window, columns, rows))
        scale = window[2] / columns
        inside = Box(box.x - window[0], box.y - window[1], box.width, box.height).scaled(1 / scale)
        person = _the_one_in(seen, inside)
        if person is None:
            return None
        return person.keypoints.scaled(scale).moved(window[0], window[1])


def keypoint_window(box: Box) -> tuple[Window, int, int]:
    """Window about a box in whole pixels, and the columns and rows that it is shown at."""
    columns, rows = (LONG_PX, SHORT_PX) if box.width > box.height else (SHORT_PX, LONG_PX)
    scale = ROOM * max(box.width / columns, box.height / rows)
    width, height = max(1, round(scale * columns)), max(1, round(scale * rows))
    left = round(box.x + 0.5 + (box.width - width) / 2)
    top = round(box.y + 0.5 + (box.height - height) / 2)
    return (left, top, width, height), columns, rows


def _the_one_in(people: list[PersonInPicture], box: Box) -> PersonInPicture | None:
    """Whom a box is about: neighbours are in the window as well."""
    # On a blank wall a centre may show, but no keypoint: its score is 0.
    fits = [(box.iou(one.box), one) for one in people if one.score > 0]
    near = [(iou * one.centre_score**0.5, one) for iou, one in fits if iou >= LEAST_OVERLAP]
    return max(near, key=lambda pair: pair[0])[1] if near else None
