"""Silhouettes of the people in given boxes, and of a caller's own mask."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from app.vision.decoding.decode import LabelImage
from app.vision.people import Box, SegmenterName, Silhouette, silhouette_from_mask
from app.vision.resampling import Window
from app.vision.segmentation.body_network import BodyNetwork, body_window, resampled
from app.vision.segmentation.mask_cleaning import fill_small_holes, keep_components
from app.vision.segmentation.truncation import with_truncation


class Segmenter(Protocol):
    """Boxes to silhouettes; implementations are safe under several threads."""

    name: SegmenterName

    def segment(self, frame: NDArray[np.uint8], boxes: Sequence[Box]) -> list[Silhouette | None]:
        """Cut out the person in each box.

        Parameters
        ----------
        frame : (H, W, 3) uint8 array
            BGR.
        boxes : sequence of Box
            Of all people known in the frame: each one's pixels are kept out of the others'.

        Returns
        -------
        list of Silhouette or None
            One for each box, in order; None where nobody could be made out.
        """
        ...


# Probability from which a pixel is the person's; chosen on even-numbered photographs.
_THRESHOLD = 0.5
# Masks are drawn at no more than this height before they are cleaned.
_ROWS = 384
# Share of a pixel that the mask as drawn covers, from which the pixel is the person's.
_HALF_COVERED = 0.5
# Boxes of people cut by the frame may end this far short of its edge. The network sees better than
# the detector whether the body goes on.
_NEAR_EDGE_PX = 5.0
# Less than this share of the box, and the network did not see the person.
_LEAST_FILL = 0.12


class NetworkSegmenter:
    """Cut people out with the body network; a pixel that several claim is the surest one's.

    Parameters
    ----------
    network : BodyNetwork
    """

    name: SegmenterName = "network"

    def __init__(self, network: BodyNetwork) -> None:
        self._network = network

    def segment(self, frame: NDArray[np.uint8], boxes: Sequence[Box]) -> list[Silhouette | None]:
        """Cut out the person in each box; see :class:`Segmenter`."""
        height, width = frame.shape[:2]
        visible = [
            (i, _up_to_edges(box, width, height))
            for i, whole in enumerate(boxes)
            if (box := whole.clip(width, height)) and _holds_a_pixel(box, width, height)
        ]
        windows = [body_window(box, height) for _, box in visible]
        maps = [self._network.probability(frame, window) for window in windows]
        found: list[Silhouette | None] = [None] * len(boxes)
        for own, (i, box) in enumerate(visible):
            others = [
                other
                for other, (_, theirs) in enumerate(visible)
                if other != own and box.intersection(theirs) > 0
            ]
            found[i] = _silhouette(
                box, windows[own], maps[own], [(windows[other], maps[other]) for other in others]
            )
        return with_truncation(found, boxes, frame.shape)


def _holds_a_pixel(box: Box, width: int, height: int) -> bool:
    """Whether the pixels of a box begin inside the frame; those of a sliver at its edge do not."""
    left, top, _, _ = box.pixels()
    return left < width and top < height


def _up_to_edges(box: Box, width: int, height: int) -> Box:
    """A box with the sides that end near the frame's edge moved out to it."""
    sides = np.array([box.x, box.y, box.right, box.bottom])
    edges = np.array([-0.5, -0.5, width - 0.5, height - 0.5])
    near = np.abs(sides - edges) <= _NEAR_EDGE_PX
    left, top, right, bottom = np.where(near, edges, sides).tolist()
    return Box(left, top, right - left, bottom - top)


def _silhouette(
    box: Box,
    window: Window,
    probability: NDArray[np.float32],
    others: Sequence[tuple[Window, NDArray[np.float32]]],
) -> Silhouette | None:
    """One person's silhouette, cut to the box; None if it is next to empty."""
    _, _, width, height = window
    scale = min(1.0, _ROWS / height)
    size = max(1, round(width * scale)), max(1, round(height * scale))
    own = resampled(probability, window, window, *size)
    mask = own >= _THRESHOLD
    for theirs, other in others:
        mask &= own >= resampled(other, theirs, window, *size)
    mask = fill_small_holes(keep_components(mask, 0.1), 0.01)
    # The window may be far larger than the frame; the box is not.
    x0, y0, x1, y1 = box.pixels()
    within = x0, y0, x1 - x0, y1 - y0
    inside = resampled(mask.astype(np.float32), window, within, *within[2:]) >= _HALF_COVERED
    if np.count_nonzero(inside) < _LEAST_FILL * inside.size:
        return None
    return silhouette_from_mask(inside, left=x0, top=y0, segmenter="network", truncated=False)


def silhouettes_from_labels(image: LabelImage) -> list[Silhouette]:
    """Silhouettes of a caller's mask, ordered left to right by the centre of their boxes."""
    place = {"left": image.left, "top": image.top}
    people = [
        silhouette_from_mask(image.part == label, **place, segmenter="mask", truncated=False)
        for label in image.present
    ]
    found = [person for person in people if person is not None]
    flagged = with_truncation(found, [person.box for person in found], image.labels.shape)
    return sorted(
        (person for person in flagged if person is not None),
        key=lambda person: person.box.x + person.box.width / 2,
    )
