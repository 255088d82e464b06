"""MoveNet MultiPose: all people of a picture in one pass, each with a box and 17 keypoints.

The network [1]_ is a CenterNet [2]_: a heatmap of people's centres, and at each centre the size of
the box and a first guess of the keypoints, which the heatmaps of the keypoints then make precise.
Its published graph decodes six people; decoding here, there may be any number.

References
----------
.. [1] Google, "MoveNet.MultiPose", model card, 2021.
.. [2] X. Zhou, D. Wang, P. Krähenbühl, "Objects as Points", 2019.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import Box, ObservedKeypoints
from app.vision.tflite import TfliteNetwork
from app.vision.windows import Window, cut_resized

CELL_PX = 4
"""Pixels of the picture per heatmap cell, each way."""

MULTIPLE_PX = 32
"""The sides of the network's input are multiples of this."""

KEYPOINTS = 17

LEAST_KEYPOINT_SCORE = 0.127
"""Keypoints below do not count for the score of a person, as in the published graph."""

_MOST_PEOPLE = 60
# Width of the Gaussian that weights a heatmap about the first guess, as a share of the heatmap's
# shorter side; from the published graph.
_GUESS_SPREAD = 0.3


@dataclass(frozen=True)
class MoveNetDetection:
    """A person as the network detects them.

    Parameters
    ----------
    box : Box
        Pixels of the picture.
    score : float
        0 to 1: of the centre, times the mean of the visible keypoints. It is not a probability,
        and is low for small and covered people.
    centre_score : float
        Of the centre alone.
    keypoints : ObservedKeypoints
    """

    box: Box
    score: float
    centre_score: float
    keypoints: ObservedKeypoints


class MoveNet:
    """The network; thread-safe.

    Parameters
    ----------
    path : Path
        ``movenet_multipose.tflite``.
    threads : int
        That share the work of one call.
    copies : int
        Number of calls served at once.

    Raises
    ------
    NetworkError
        If the file cannot be read or is another network.
    """

    def __init__(self, path: Path, *, threads: int = 1, copies: int = 1) -> None:
        heads = [(None, None, channels) for channels in (1, 2, 2, 34, 17, 34)]
        self._network = TfliteNetwork(path, (None, None, 3), heads, threads=threads, copies=copies)

    def people(
        self, picture: NDArray[np.uint8], least_centre_score: float = 0.03
    ) -> list[MoveNetDetection]:
        """Find the people of a picture.

        Parameters
        ----------
        picture : (H, W, 3) uint8 array
            BGR; taken at its full size, which memory and time must allow.
        least_centre_score : float
            People below are left out.

        Returns
        -------
        list of MoveNetDetection
            Highest centre score first.
        """
        height, width = picture.shape[:2]
        rows, columns = (-(-side // MULTIPLE_PX) * MULTIPLE_PX for side in (height, width))
        shown: NDArray[np.float32] = np.zeros((rows, columns, 3), np.float32)
        shown[:height, :width] = picture[..., ::-1]
        return decode(self._network.run(shown), least_centre_score)


def decode(
    heads: Sequence[NDArray[np.float32]], least_centre_score: float
) -> list[MoveNetDetection]:
    """Decode the network's heads into people.

    Parameters
    ----------
    heads : sequence of (h, w, C) float32 arrays
        Centres (1 channel), sizes of boxes (2), centres of boxes (2), first guesses of keypoints
        from a centre (34), heatmaps of keypoints (17), and where in its cell each keypoint lies
        (34); rows before columns, in cells.
    least_centre_score : float
    """
    centres = heads[0][..., 0]
    highest = cv2.dilate(centres, np.ones((3, 3), np.uint8))
    rows, columns = np.nonzero((centres >= highest - 1e-6) & (centres >= least_centre_score))
    order = np.argsort(-centres[rows, columns], kind="stable")[:_MOST_PEOPLE]
    found = (_decode_one(heads, int(rows[i]), int(columns[i])) for i in order)
    return [person for person in found if person is not None]


def _decode_one(
    heads: Sequence[NDArray[np.float32]], row: int, column: int
) -> MoveNetDetection | None:
    """The person whose centre lies in a cell; None where the box is empty."""
    centres, sizes, offsets, guesses, heatmaps, places = heads
    cells = np.array(centres.shape[:2])
    middle = np.array([row, column]) + offsets[row, column]
    half = np.maximum(sizes[row, column], 0) / 2
    low, high = np.clip(middle - half, 0, cells), np.clip(middle + half, 0, cells)
    if (high - low < 0.25).any():
        return None
    first = np.minimum(np.ceil(low).astype(int), cells - 1)
    last = np.maximum(np.ceil(high).astype(int), first + 1)
    inside = heatmaps[first[0] : last[0], first[1] : last[1]]
    guess = guesses[row, column].reshape(KEYPOINTS, 2) + np.array([row, column])
    down = np.arange(first[0], last[0])[:, None] - guess[:, 0]
    across = np.arange(first[1], last[1])[:, None] - guess[:, 1]
    spread = _GUESS_SPREAD * cells.min()
    near = np.exp(-(down**2) / spread)[:, None] * np.exp(-(across**2) / spread)[None]
    weighted = (inside * near).reshape(-1, KEYPOINTS)
    best, which = weighted.argmax(axis=0), np.arange(KEYPOINTS)
    scores = np.clip(weighted[best, which], 0, 1).astype(np.float64)
    at = np.stack([first[0] + best // inside.shape[1], first[1] + best % inside.shape[1]], axis=-1)
    precise = at + places[at[:, 0], at[:, 1]].reshape(KEYPOINTS, KEYPOINTS, 2)[which, which]
    seen = scores > LEAST_KEYPOINT_SCORE
    mean = float(scores[seen].mean()) if seen.any() else 0.0
    centre = float(centres[row, column, 0])
    top, left, bottom, right = (float(CELL_PX * edge - 0.5) for edge in (*low, *high))
    return MoveNetDetection(
        Box(left, top, right - left, bottom - top),
        centre * mean,
        centre,
        ObservedKeypoints(CELL_PX * precise[:, ::-1].astype(np.float64) - 0.5, scores),
    )


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


def _best_match(people: list[MoveNetDetection], box: Box) -> MoveNetDetection | None:
    """The person whom a box is about; the window may show neighbours as well."""
    # A blank wall can have a centre but no keypoints: its score is 0.
    near = [person for person in people if person.score > 0 and box.iou(person.box) >= MIN_OVERLAP]
    return max(near, key=lambda p: box.iou(p.box) * p.centre_score**0.5, default=None)
