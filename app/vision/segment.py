"""Silhouettes of the people in given boxes, and of a caller's own mask."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.decode import labels_in
from app.vision.grabcut import GrabCutSegmenter
from app.vision.mask_cleaning import fill_small_holes, guided_filter, keep_components
from app.vision.neighbours import own_part
from app.vision.network import PersonNetwork
from app.vision.people import Box, SegmenterName, Silhouette, silhouette_from_mask
from app.vision.resampling import Window, cut, resize, resize_mask
from app.vision.truncation import with_truncation


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


def make_segmenter(network: PersonNetwork | None) -> Segmenter:
    """The network's segmenter if there is a network, else GrabCut."""
    return GrabCutSegmenter() if network is None else NetworkSegmenter(network)


# The network sees a window of the box's height and 0.8 times as wide, stretched to its
# square: of the windows tried, the one with the best overlap.
_WINDOW_ASPECT = 0.8
# Beyond the box by this share of its height the window is greyed: the network likes to join
# people, and what it does not see it does not join.
_SURROUNDINGS = 0.1
_GREY = 127
# Masks are drawn at no more than this height: finer than the network's own 256 rows.
_ROWS = 320
_NEIGHBOUR_ROWS = 96
# Less than this share of the box, and the network did not see the person.
_LEAST_FILL = 0.12


class NetworkSegmenter:
    """Cut people out with the segmentation network.

    The network marks whoever is in its window; the person's own part is told by the box and
    the photograph's edges. Where it sees nobody (people under some 30 px), GrabCut takes over.

    Parameters
    ----------
    network : PersonNetwork
    """

    name: SegmenterName = "network"

    def __init__(self, network: PersonNetwork) -> None:
        self._network = network
        self._fallback = GrabCutSegmenter()

    def segment(self, frame: NDArray[np.uint8], boxes: Sequence[Box]) -> list[Silhouette | None]:
        """Cut out the person in each box; see :class:`Segmenter`."""
        height, width = frame.shape[:2]
        visible = [(i, box) for i, whole in enumerate(boxes) if (box := whole.clip(width, height))]
        views = [_view(frame, box, [b for j, b in visible if j != i]) for i, box in visible]
        answers = self._network.of_images([_with_grey_surroundings(view) for view in views])
        found: list[Silhouette | None] = [None] * len(boxes)
        for (i, _), view, answer in zip(visible, views, answers, strict=True):
            found[i] = _drawn(view, answer)
        missing = [i for i, _ in visible if found[i] is None]
        if missing:
            drawn = self._fallback.segment(frame, boxes)
            for i in missing:
                found[i] = drawn[i]
        return with_truncation(found, boxes, frame.shape)


@dataclass(frozen=True)
class _View:
    """The window around one person, at the resolution at which the mask is drawn.

    ``image`` is (h, w, 3) uint8; ``box`` and ``others`` are in its pixels, ``whole`` (the
    person's box) and ``window`` in the frame's.
    """

    image: NDArray[np.uint8]
    box: Box
    others: list[Box]
    whole: Box
    window: Window


def _view(frame: NDArray[np.uint8], box: Box, others: Sequence[Box]) -> _View:
    left, top, right, bottom = box.pixels()
    height = max(bottom - top, round((right - left) / 1.6))
    width = max(round(_WINDOW_ASPECT * height), right - left)
    window = ((left + right - width) // 2, (top + bottom - height) // 2, width, height)
    scale = min(1.0, _ROWS / height)
    image = resize(cut(frame, window), max(1, round(width * scale)), max(1, round(height * scale)))

    def local(one: Box) -> Box:
        return Box(one.x - window[0], one.y - window[1], one.width, one.height).scaled(scale)

    return _View(image, local(box), [local(other) for other in others], box, window)


def _with_grey_surroundings(view: _View) -> NDArray[np.uint8]:
    """View with everything but the box hidden, softly: a new edge must not look like a body's."""
    reach = _SURROUNDINGS * view.box.height
    left, top = view.box.x - reach, view.box.y - reach
    near = Box(left, top, view.box.width + 2 * reach, view.box.height + 2 * reach)
    x0, y0, x1, y1 = near.pixels()
    rows, columns = view.image.shape[:2]
    shown: NDArray[np.float32] = np.zeros((rows, columns, 1), np.float32)
    shown[max(0, y0) : max(0, y1), max(0, x0) : max(0, x1)] = 1
    blur = 2 * max(1, round(0.05 * rows)) + 1
    shown = cv2.blur(shown, (blur, blur)).astype(np.float32)[..., None]
    return (view.image * shown + _GREY * (1 - shown)).astype(np.uint8)


def _own_part(view: _View, soft: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Pixels of a view that are not a neighbour's."""
    height, width = soft.shape
    scale = min(1.0, _NEIGHBOUR_ROWS / height)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    region = resize(soft, *size) > 0.4
    others = [other.scaled(scale) for other in view.others]
    own = own_part(resize(view.image, *size), region, view.box.scaled(scale), others)
    # What is foreign is taken away, rather than the rest kept: thin limbs that vanish at the
    # small size stay.
    return ~resize_mask(region & ~own, width, height)


def _drawn(view: _View, answer: NDArray[np.float32]) -> Silhouette | None:
    """One person's silhouette in the frame; None if next to nothing was seen."""
    rows, columns = view.image.shape[:2]
    soft = guided_filter(view.image, resize(answer, columns, rows), radius=max(2, round(rows / 70)))
    mask = keep_components((soft >= 0.5) & _own_part(view, soft), 0.1)
    mask = fill_small_holes(mask, 0.01)
    left, top, width, height = view.window
    mask = resize_mask(mask, width, height)
    x0, y0, x1, y1 = view.whole.pixels()
    inside = mask[y0 - top : y1 - top, x0 - left : x1 - left]
    if np.count_nonzero(inside) < _LEAST_FILL * inside.size:
        return None
    return silhouette_from_mask(inside, left=x0, top=y0, segmenter="network", truncated=False)


def silhouettes_from_labels(labels: NDArray[np.uint16]) -> list[Silhouette]:
    """Silhouettes of a caller's mask, ordered left to right by the centre of their boxes.

    Parameters
    ----------
    labels : (H, W) uint16 array
        0 background, k = person k, as :func:`app.vision.decode.decode_mask` returns it.

    Returns
    -------
    list of Silhouette

    Raises
    ------
    ValueError
        If the array is not two-dimensional.
    """
    if labels.ndim != 2:
        raise ValueError(f"expected labels of shape (H, W), got {labels.shape}")
    people = [
        silhouette_from_mask(labels == label, segmenter="mask", truncated=False)
        for label in labels_in(labels)
    ]
    found = [person for person in people if person is not None]
    flagged = with_truncation(found, [person.box for person in found], labels.shape)
    return sorted(
        (person for person in flagged if person is not None),
        key=lambda person: person.box.x + person.box.width / 2,
    )
