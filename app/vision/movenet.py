"""MoveNet MultiPose [1]_: all people of an image in one pass, each with a box and 17 keypoints.

The network is a CenterNet [2]_: a heatmap of people's centres, at each centre the size of the box
and a first guess of the keypoints, and heatmaps that refine the keypoints. Google's graph decodes
six people; decoding here gives any number.

References
----------
.. [1] Google, "MoveNet.MultiPose", model card, 2021.
.. [2] X. Zhou, D. Wang, P. Krähenbühl, "Objects as Points", 2019.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.networks.tflite import TfliteNetwork
from app.vision.detectors.tiles import Picture, Tile
from app.vision.geometry import Box, PixelRect, crop_and_resize
from app.vision.halved import Frame, seen_at
from app.vision.people import COCO_NAMES, Detection, ObservedKeypoints

_KEYPOINTS = len(COCO_NAMES)


@dataclass(frozen=True)
class MoveNetDetection:
    """A person that MoveNet finds."""

    # Box and keypoints are in pixels of the image.
    box: Box
    # Score of the centre times the mean score of the visible keypoints, 0 to 1. It is not a
    # probability, and is low for small and covered people.
    score: float
    centre_score: float  # score of the centre alone
    keypoints: ObservedKeypoints


# The sides of the input are multiples of this.
_INPUT_MULTIPLE_PX = 32
# Channels of the network's heads, in the order of `decode_heads`.
_CHANNELS = (1, 2, 2, 2 * _KEYPOINTS, _KEYPOINTS, 2 * _KEYPOINTS)


class MoveNet(TfliteNetwork):
    """The network: the people of one image."""

    def __init__(self, path: Path, **share: int) -> None:
        heads = [(None, None, channels) for channels in _CHANNELS]
        super().__init__(path, [(None, None, 3)], heads, **share)

    def detect(self, image: NDArray[np.uint8]) -> list[MoveNetDetection]:
        """Find the people of an image ``(H, W, 3)``, BGR, highest centre score first.

        The network sees the image at its full size, which determines memory and time.
        """
        height, width = image.shape[:2]
        rows, columns = (
            -(-side // _INPUT_MULTIPLE_PX) * _INPUT_MULTIPLE_PX for side in (height, width)
        )
        padded: NDArray[np.float32] = np.zeros((rows, columns, 3), np.float32)
        padded[:height, :width] = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
        return decode_heads(self.run(padded))


_MIN_IOU = 0.2  # Overlap with the person's box from which a detection may be theirs.


class KeypointReader:
    """Reads the keypoints of one person in a box; thread-safe."""

    def __init__(self, network: MoveNet) -> None:
        self._network = network

    def read(self, frame: Frame, box: Box) -> ObservedKeypoints | None:
        """Keypoints of the person in a tight box of a frame, pixels; None if there is nobody."""
        pixels, seen = seen_at(frame, _ENOUGH_PX / max(keypoint_window(box)[0][2:]))
        keypoints = self._read(pixels, box.scaled(seen))
        return keypoints and keypoints.scaled(1 / seen)

    def _read(self, frame: NDArray[np.uint8], box: Box) -> ObservedKeypoints | None:
        rect, columns, rows = keypoint_window(box)
        people = self._network.detect(crop_and_resize(frame, rect, columns, rows))
        scale = rect[2] / columns
        inside = Box(box.x - rect[0], box.y - rect[1], box.width, box.height).scaled(1 / scale)
        person = self._best_match(people, inside)
        if person is None:
            return None
        return person.keypoints.scaled(scale).moved(rect[0], rect[1])

    def _best_match(self, people: list[MoveNetDetection], box: Box) -> MoveNetDetection | None:
        """The detection that fits a box best; the window around it may show neighbours as well."""
        # A blank wall can have a centre but no keypoints; its score is then 0.
        near = [one for one in people if one.score > 0 and box.iou(one.box) >= _MIN_IOU]
        return max(near, key=lambda p: box.iou(p.box) * p.centre_score**0.5, default=None)


MIN_MOVENET_SCORE = 0.02
"""Least score of MoveNet that counts."""


@dataclass(frozen=True)
class MoveNetDetector:
    """Detects people with keypoints, in the overview and the tiles of a picture; thread-safe.

    ``small`` is another copy of the network for small pictures, since one that is given pictures of
    other sizes in turn takes a tenth more time.
    """

    network: MoveNet
    small: MoveNet

    def detect(self, picture: Picture) -> list[Detection]:
        """Detect people; detections in the tile that suits their size come first, by score.

        A person may be detected more than once.
        """
        found: list[tuple[float, Detection]] = []
        for number, tile in enumerate(picture.tiles):
            for one in _seen_in(self.network, picture, tile):
                # Longer side of a box, in the overview, from which people are taken from the
                # overview. Smaller people are taken from the tiles, which separate two people side
                # by side.
                is_large = _longer_side(one, picture) >= 96.0
                suits = len(picture.tiles) == 1 or is_large == (number == 0)
                found.append((one.score + suits, one))
        # Score of a person from which the frame is not searched at that size.
        if all(one.score < 0.3 for _, one in found):
            whole = picture.tiles[0]
            # Longer side of a small picture of the frame, a tenth of the overview's area, that is
            # searched for people who fill the frame: the network recognises them at this size, and
            # hardly in the overview.
            glance = Tile(whole.rect, whole.factor * min(1.0, 192.0 / max(whole.size)))
            # Share of the frame's longer side from which a person fills it.
            found += [
                (one.score + 1, one)
                for one in _seen_in(self.small, picture, glance)
                if _longer_side(one, picture) >= 0.5 * max(whole.size)
            ]
        return [one for _, one in sorted(found, key=lambda pair: -pair[0])]


def _seen_in(network: MoveNet, picture: Picture, tile: Tile) -> list[Detection]:
    """People that the network finds in a tile, in pixels of the frame."""
    seen = []
    for person in network.detect(picture.seen_in(tile)):
        box = tile.to_frame(person.box, picture.frame.shape)
        if box is not None and person.score >= MIN_MOVENET_SCORE:
            keypoints = person.keypoints.scaled(1 / tile.factor).moved(*tile.rect[:2])
            seen.append(Detection(box, min(1.0, person.score), keypoints))
    return seen


def _longer_side(one: Detection, picture: Picture) -> float:
    return max(one.box.width, one.box.height) * picture.tiles[0].factor


KEYPOINT_WINDOW_PX = (256, 160)
"""Sides of MoveNet's input for the window of one person; the longer one is along the person."""

# Size of a person's window in the frame from which it may be enlarged for the network: input of
# this size gives poses as good as any larger one does, to 1 mm of 107 (Pose2Sim's cameras).
_ENOUGH_PX = 160

KEYPOINT_WINDOW_SCALE = 1.25
"""Size of that window relative to the person's box."""


def keypoint_window(box: Box) -> tuple[PixelRect, int, int]:
    """Window about a box in whole pixels, and the columns and rows of MoveNet's input for it."""
    long_px, short_px = KEYPOINT_WINDOW_PX
    columns, rows = (long_px, short_px) if box.width > box.height else (short_px, long_px)
    scale = KEYPOINT_WINDOW_SCALE * max(box.width / columns, box.height / rows)
    width, height = max(1, round(scale * columns)), max(1, round(scale * rows))
    left = round(box.x + 0.5 + (box.width - width) / 2)
    top = round(box.y + 0.5 + (box.height - height) / 2)
    return (left, top, width, height), columns, rows


CELL_PX = 4
"""Pixels of the input per heatmap cell, each way."""


def decode_heads(heads: Sequence[NDArray[np.float32]]) -> list[MoveNetDetection]:
    """Decode the network's heads into people, highest centre score first.

    Parameters
    ----------
    heads : sequence of (h, w, C) float32 arrays
        Centres (1 channel), sizes of boxes (2), centres of boxes (2), first guesses of keypoints
        from a centre (34), heatmaps of keypoints (17), and the position of each keypoint in its
        cell (34); rows before columns, in cells.
    """
    centres = heads[0][..., 0]
    highest = cv2.dilate(centres, np.ones((3, 3), np.uint8))
    is_peak = (centres >= highest - 1e-6) & (centres >= 0.03)
    rows, columns = np.nonzero(is_peak)
    # Most people found in one pass of the network.
    order = np.argsort(-centres[rows, columns], kind="stable")[:60]
    found = (_decode_person(heads, int(rows[i]), int(columns[i])) for i in order)
    return [person for person in found if person is not None]


def _decode_person(
    heads: Sequence[NDArray[np.float32]], row: int, column: int
) -> MoveNetDetection | None:
    """Decode the person whose centre lies in a cell; None if the box is empty."""
    centres, sizes, offsets, guesses, heatmaps, refinements = heads
    cells = np.array(centres.shape[:2])
    middle = np.array([row, column]) + offsets[row, column]
    half = np.maximum(sizes[row, column], 0) / 2
    low, high = np.clip(middle - half, 0, cells), np.clip(middle + half, 0, cells)
    # Sides of a box in heatmap cells; smaller ones are empty.
    if (high - low < 0.25).any():
        return None
    first = np.minimum(np.ceil(low).astype(int), cells - 1)
    last = np.maximum(np.ceil(high).astype(int), first + 1)
    guess = guesses[row, column].reshape(_KEYPOINTS, 2) + np.array([row, column])
    inside = heatmaps[first[0] : last[0], first[1] : last[1]]
    # Variance of the Gaussian that weights a heatmap about the first guess, relative to the
    # heatmap's shorter side; from Google's graph.
    at, scores = _heatmap_peaks(inside, first, guess, 0.3 * cells.min())
    which = np.arange(_KEYPOINTS)
    refined = at + refinements[at[:, 0], at[:, 1]].reshape(_KEYPOINTS, _KEYPOINTS, 2)[which, which]
    # Score below which keypoints are left out of a person's score, as in Google's graph.
    visible = scores > 0.127
    mean = float(scores[visible].mean()) if visible.any() else 0.0
    centre = float(centres[row, column, 0])
    top, left, bottom, right = (float(CELL_PX * edge - 0.5) for edge in (*low, *high))
    return MoveNetDetection(
        Box.from_edges(left, top, right, bottom),
        centre * mean,
        centre,
        ObservedKeypoints(CELL_PX * refined[:, ::-1].astype(np.float64) - 0.5, scores),
    )


def _heatmap_peaks(
    heatmaps: NDArray[np.float32],
    first: NDArray[np.int_],
    guess: NDArray[np.float32],
    variance: float,
) -> tuple[NDArray[np.int_], NDArray[np.float64]]:
    """Cells ``(17, 2)`` and scores ``(17,)`` of the keypoints in a part of the heatmaps.

    ``first`` is the part's first cell. Heatmaps are weighted about the guesses ``(17, 2)``.
    """
    rows, columns = heatmaps.shape[:2]
    down = np.arange(first[0], first[0] + rows)[:, None] - guess[:, 0]
    across = np.arange(first[1], first[1] + columns)[:, None] - guess[:, 1]
    near = np.exp(-(down**2) / variance)[:, None] * np.exp(-(across**2) / variance)[None]
    weighted = (heatmaps * near).reshape(-1, _KEYPOINTS)
    best = weighted.argmax(axis=0)
    scores = np.clip(weighted[best, np.arange(_KEYPOINTS)], 0, 1).astype(np.float64)
    return np.stack([first[0] + best // columns, first[1] + best % columns], axis=-1), scores
