"""People who lie: what the network saw lying there, searched for joints with either end up.

Gradients know people who stand, and boxes of presence count only where they are upright. What is
left over, wide and in one piece, may be somebody who lies: a car, a bench and a group have no
joints where a body has them, whichever end is up.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from app.vision.box_arrays import suppress
from app.vision.detect import probability
from app.vision.joints import JointReader
from app.vision.networks import PersonNetwork
from app.vision.people import Box, Detection, Silhouette, silhouette_from_mask
from app.vision.presence import SUITED, WIDE, Piece, Presence, PresenceMap
from app.vision.resampling import cut, resize, resize_mask
from app.vision.segment import Segmenter
from app.vision.turning import turned_box, turned_silhouette
from app.vision.views import view_of, with_grey_surroundings

MOST = 2
"""Parts of a frame that are searched, the most likely first."""

# A body that lies is at most so many times as wide as high, fills so much of its box, and is mostly
# no part of people who are found already.
_WIDEST = 4.5
_LEAST_FILL = 0.25
_MOST_FOUND = 0.3
# Turned upright and seen close, all of it must be this likely: what is nobody seldom is.
_SEEN_UPRIGHT = 0.5
# Overlap from which two parts are one.
_SAME = 0.3

# Fitted to real/pennfudan, upright and turned, by `python -m scripts.evaluate real --fit-detector`.
_CLARITY, _OFFSET = 4.63, 2.61


def find_lying(
    network: PersonNetwork,
    reader: JointReader,
    frame: NDArray[np.uint8],
    presence: Presence,
    found: Sequence[Box],
    min_score: float,
) -> list[Detection]:
    """Find people who lie.

    Parameters
    ----------
    network : PersonNetwork
    reader : JointReader
    frame : (H, W, 3) uint8 array
        BGR.
    presence : Presence
        Of the frame.
    found : sequence of Box
        People who are found already.
    min_score : float
        Least probability reported.
    """
    detections = []
    for part in seen_upright(network, frame, lying_parts(presence, found, frame.shape)):
        clarity, turns = which_way_up(reader, frame, part, (1, 3))
        score = float(probability(np.array(_CLARITY * clarity + _OFFSET)))
        if score >= min_score:
            detections.append(Detection(part.box, score, turns))
    return detections


def lying_parts(
    presence: Presence, found: Sequence[Box], shape: tuple[int, ...]
) -> list[Silhouette]:
    """Wide parts of the presence in one piece, in pixels of a frame, the most likely first."""
    people: NDArray[np.bool_] = np.zeros(presence.maps[0].probability.shape, bool)
    for box in found:
        left, top, right, bottom = (max(0, edge) for edge in box.scaled(presence.factor).pixels())
        people[top:bottom, left:right] = True
    parts, boxes, ranks = [], [], []
    for one in presence.maps:
        for piece in one.pieces:
            if not (_may_lie(piece, 0.8 * presence.min_person_px) and _suits(one, piece)):
                continue
            own = piece.mask()
            taken = np.count_nonzero(own & people[piece.place]) > _MOST_FOUND * piece.area
            if not taken:
                parts.append(piece)
                boxes.append(piece.window)
                ranks.append(one.probability[piece.place][own].sum() / np.sqrt(own.size))
    chosen = suppress(np.array(boxes, float).reshape(-1, 4), np.array(ranks), _SAME)[:MOST]
    enlarged = [_enlarged(parts[i], presence.factor, shape) for i in chosen]
    return [part for part in enlarged if part is not None]


def _may_lie(piece: Piece, least_px: float) -> bool:
    _, _, width, height = piece.window
    return (
        WIDE * height <= width <= _WIDEST * height
        and width >= least_px
        and piece.area >= _LEAST_FILL * width * height
    )


def _suits(presence: PresenceMap, piece: Piece) -> bool:
    return SUITED[0] <= piece.window[2] / presence.side <= SUITED[1]


def _enlarged(piece: Piece, factor: float, shape: tuple[int, ...]) -> Silhouette | None:
    left, top, width, height = piece.window
    box = Box(left - 0.5, top - 0.5, width, height).scaled(1 / factor).clip(shape[1], shape[0])
    if box is None:
        return None
    left, top, right, bottom = box.pixels()
    mask = resize_mask(piece.mask(), right - left, bottom - top)
    return silhouette_from_mask(mask, left=left, top=top, segmenter="network", truncated=False)


def seen_upright(
    network: PersonNetwork, frame: NDArray[np.uint8], parts: Sequence[Silhouette]
) -> list[Silhouette]:
    """Those parts that the network still takes for somebody when they are turned upright."""
    turned = [
        (np.rot90(frame, turns), turned_silhouette(part, frame.shape, turns))
        for part in parts
        for turns in (1, 3)
    ]
    views = [view_of(upright, part.box) for upright, part in turned]
    answers = network.of_images([with_grey_surroundings(view) for view in views])
    means = []
    for (_, part), view, answer in zip(turned, views, answers, strict=True):
        left, top, width, height = view.window
        within = (left - part.left, top - part.top, width, height)
        own = resize(cut(part.crop.astype(np.uint8), within), *answer.shape) > 0
        means.append(float(answer[own].mean()) if own.any() else 0.0)
    likelier = np.array(means).reshape(-1, 2).max(axis=1)
    return [part for part, mean in zip(parts, likelier, strict=True) if mean >= _SEEN_UPRIGHT]


def is_wide(box: Box) -> bool:
    """Whether somebody in a box may lie."""
    return box.width >= WIDE * box.height


def which_way_up(
    reader: JointReader,
    frame: NDArray[np.uint8],
    silhouette: Silhouette,
    ways: Sequence[int] = (0, 1, 3),
) -> tuple[float, int]:
    """How clearly joints show in a wide silhouette, and the turns that set it upright.

    See :meth:`index.joint_maps.JointMaps.clarity` and :class:`app.vision.people.Detection`.
    """
    return max((_clarity(reader, frame, silhouette, turns), turns) for turns in ways)


def _clarity(
    reader: JointReader, frame: NDArray[np.uint8], silhouette: Silhouette, turns: int
) -> float:
    upright = turned_silhouette(silhouette, frame.shape, turns)
    return reader.clarity(np.rot90(frame, turns), upright)


def segment_people(
    segmenter: Segmenter, frame: NDArray[np.uint8], detections: Sequence[Detection]
) -> list[Silhouette | None]:
    """Cut out people, those who lie in a frame turned so that they are upright."""
    upright = iter(segmenter.segment(frame, [one.box for one in detections if not one.turns]))
    return [
        _segment_turned(segmenter, frame, one.box, one.turns) if one.turns else next(upright)
        for one in detections
    ]


def segment_either_way(
    segmenter: Segmenter,
    reader: JointReader,
    frame: NDArray[np.uint8],
    box: Box,
    upright: Silhouette | None,
) -> tuple[Silhouette | None, int]:
    """Cut somebody out of a wide box as joints show most clearly, upright or lying.

    Parameters
    ----------
    segmenter : Segmenter
    reader : JointReader
    frame : (H, W, 3) uint8 array
        BGR.
    box : Box
    upright : Silhouette or None
        As if the person were upright.

    Returns
    -------
    silhouette : Silhouette or None
        None where nobody is seen either way.
    turns : int
        That set the person upright.
    """
    turned = [(_segment_turned(segmenter, frame, box, turns), turns) for turns in (1, 3)]
    seen = [(one, turns) for one, turns in [(upright, 0), *turned] if one is not None]
    return max(seen, key=lambda way: _clarity(reader, frame, *way), default=(None, 0))


def _segment_turned(
    segmenter: Segmenter, frame: NDArray[np.uint8], box: Box, turns: int
) -> Silhouette | None:
    upright = np.ascontiguousarray(np.rot90(frame, turns))
    (found,) = segmenter.segment(upright, [turned_box(box, frame.shape, turns)])
    return None if found is None else turned_silhouette(found, upright.shape, -turns)
