"""Silhouettes of the people in given boxes, and of a caller's own mask."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from app.vision.decode import LabelImage
from app.vision.grabcut import GrabCutSegmenter
from app.vision.mask_cleaning import fill_small_holes, guided_filter, keep_components
from app.vision.networks import Networks, body_window
from app.vision.people import Box, SegmenterName, Silhouette, silhouette_from_mask
from app.vision.refine import PROBABILITY, Refiner, moved, refiner_input, refiner_window
from app.vision.resampling import Window, resize, resize_mask
from app.vision.truncation import with_truncation
from app.vision.views import view_of, with_grey_surroundings
from app.vision.workers import Workers


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


def make_segmenter(networks: Networks | None, workers: Workers | None = None) -> Segmenter:
    """The networks' segmenter if there are networks, else GrabCut."""
    if networks is None:
        return GrabCutSegmenter()
    return NetworkSegmenter(networks, Refiner(), workers)


# How much the refiner's answer counts beside the first networks', which know real people better:
# less where it takes away than where it adds, for that is how lost limbs come back.
_TAKEN_SHARE, _ADDED_SHARE = 0.6, 0.8
# Window of the guided filter, in the refiner's pixels.
_REFINED_RADIUS = 3
# Masks that the refiner draws are enlarged to no more than this height before they are cleaned.
_REFINED_ROWS = 384
# Less than this share of the box, and the networks did not see the person.
_LEAST_FILL = 0.12


class NetworkSegmenter:
    """Cut people out with the segmentation networks.

    Two mark the person, each in its own way; the refiner redraws what they marked. Where nobody
    is seen (people under some 30 px), GrabCut takes over.

    Parameters
    ----------
    networks : Networks
    refiner : Refiner
    workers : Workers, optional
        Who cuts out several people; by default the caller's thread, one after the other.
    """

    name: SegmenterName = "network"

    def __init__(
        self,
        networks: Networks,
        refiner: Refiner,
        workers: Workers | None = None,
    ) -> None:
        self._networks = networks
        self._refiner = refiner
        self._workers = workers or Workers()
        self._fallback = GrabCutSegmenter()

    def segment(
        self, frame: NDArray[np.uint8], boxes: Sequence[Box], beside: Sequence[Box] = ()
    ) -> list[Silhouette | None]:
        """Cut out the person in each box; see :class:`Segmenter`.

        Pixels of people in the boxes ``beside`` are kept out as well.
        """
        height, width = frame.shape[:2]
        visible = [(i, box) for i, whole in enumerate(boxes) if (box := whole.clip(width, height))]

        def drawn(position: int) -> Silhouette | None:
            others = [box for other, (_, box) in enumerate(visible) if other != position]
            return self._drawn(frame, visible[position][1], [*others, *beside])

        found: list[Silhouette | None] = [None] * len(boxes)
        silhouettes = self._workers.map(drawn, range(len(visible)))
        for (i, _), silhouette in zip(visible, silhouettes, strict=True):
            found[i] = silhouette
        missing = [i for i, _ in visible if found[i] is None]
        if missing:
            others = self._fallback.segment(frame, boxes)
            for i in missing:
                found[i] = others[i]
        return with_truncation(found, boxes, frame.shape)

    def _drawn(
        self, frame: NDArray[np.uint8], box: Box, others: Sequence[Box]
    ) -> Silhouette | None:
        """One person's silhouette; None if next to nothing was seen."""
        window = refiner_window(box)
        seen = two_looks(self._networks, frame, box, window)
        planes = refiner_input(frame, window, box, others, seen)
        first = planes[PROBABILITY] / np.float32(255)
        change = self._refiner.probability(planes) - first
        soft = first + np.float32(_ADDED_SHARE) * np.maximum(change, 0)
        soft += np.float32(_TAKEN_SHARE) * np.minimum(change, 0)
        soft = guided_filter(planes[:3].transpose(1, 2, 0), soft, _REFINED_RADIUS)
        _, _, width, height = window
        scale = min(1.0, _REFINED_ROWS / height)
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        return _silhouette(resize(soft, *size) >= 0.5, window, box)


def two_looks(
    networks: Networks, frame: NDArray[np.uint8], box: Box, window: Window
) -> NDArray[np.float32]:
    """What both networks see of a person, on average, in the refiner's window; ``(192, 128)``.

    Where one takes a sheet behind a person for the head, or loses an arm, the other seldom does.
    """
    view = view_of(frame, box)
    anybody = networks.person.of_image(with_grey_surroundings(view))
    about = body_window(box, len(frame))
    body = networks.body.probability(frame, about)
    both = moved(anybody, view.window, window) + moved(body, about, window)
    return np.asarray(both / 2)


def _silhouette(mask: NDArray[np.bool_], window: Window, box: Box) -> Silhouette | None:
    """Clean a mask of a window of the frame and cut it to the box; None if it is next to empty."""
    left, top, width, height = window
    mask = fill_small_holes(keep_components(mask, 0.1), 0.01)
    mask = resize_mask(mask, width, height)
    x0, y0, x1, y1 = box.pixels()
    inside = mask[max(0, y0 - top) : y1 - top, max(0, x0 - left) : x1 - left]
    if np.count_nonzero(inside) < _LEAST_FILL * inside.size:
        return None
    place = {"left": max(x0, left), "top": max(y0, top)}
    return silhouette_from_mask(inside, **place, segmenter="network", truncated=False)


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
