"""People who lie: what the network saw lying there, searched for joints with either end up.

Gradients know people who stand, and boxes of presence count only where they are upright. What is
left over, wide and in one piece, may be somebody who lies: a car, a bench and a group have no
joints where a body has them, whichever end is up.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.box_arrays import suppress
from app.vision.detect import probability
from app.vision.joints import JointReader
from app.vision.people import Box, Detection, Silhouette, silhouette_from_mask
from app.vision.presence import Presence, PresenceMap
from app.vision.resampling import resize_mask
from app.vision.segment import Segmenter
from app.vision.turning import turned_box, turned_silhouette
from descriptor.silhouette import normalise

MOST = 2
"""Parts of a frame that are searched, the most likely first."""

# A body that lies is so many times as wide as high, fills so much of its box, and is mostly no
# part of people who are found already.
_WIDE = (1.2, 4.5)
_LEAST_FILL = 0.25
_MOST_FOUND = 0.3
# A presence map tells of people of these shares of its windows' side.
_SUITED = (0.2, 1.0)
_LEVELS = (0.3, 0.6, 0.9)
# Overlap from which two parts are one.
_SAME = 0.3

# Fitted to real/pennfudan, upright and turned, by `python -m scripts.evaluate real --fit-detector`.
_CLARITY, _OFFSET = 4.83, 3.40


def find_lying(
    reader: JointReader,
    frame: NDArray[np.uint8],
    presence: Presence,
    found: Sequence[Box],
    min_score: float,
) -> list[Detection]:
    """Find people who lie.

    Parameters
    ----------
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
    for part in lying_parts(presence, found):
        clarity, turns = which_way_up(reader, frame, part, (1, 3))
        score = float(probability(np.array(_CLARITY * clarity + _OFFSET)))
        if score >= min_score:
            detections.append(Detection(part.box, score, turns))
    return detections


def lying_parts(presence: Presence, found: Sequence[Box]) -> list[Silhouette]:
    """Wide parts of the presence in one piece, in pixels of the frame, the most likely first."""
    people: NDArray[np.bool_] = np.zeros(presence.maps[0].probability.shape, bool)
    for box in found:
        left, top, right, bottom = (max(0, edge) for edge in box.scaled(presence.factor).pixels())
        people[top:bottom, left:right] = True
    parts, boxes, ranks = [], [], []
    for one in presence.maps:
        for (x, y, width, height), own in _wide_pieces(one, 0.8 * presence.min_person_px):
            area = np.s_[y : y + height, x : x + width]
            if np.count_nonzero(own & people[area]) <= _MOST_FOUND * np.count_nonzero(own):
                parts.append((own, x, y))
                boxes.append((x, y, width, height))
                ranks.append(one.probability[area][own].sum() / np.sqrt(width * height))
    chosen = suppress(np.array(boxes, float).reshape(-1, 4), np.array(ranks), _SAME)[:MOST]
    enlarged = [_enlarged(*parts[i], presence.factor) for i in chosen]
    return [part for part in enlarged if part is not None]


def _wide_pieces(
    presence: PresenceMap, least_px: float
) -> Iterator[tuple[tuple[int, int, int, int], NDArray[np.bool_]]]:
    """Column, row, width and height of what may lie, and its pixels there."""
    for level in _LEVELS:
        region = (presence.probability > level).astype(np.uint8)
        _, labels, stats, _ = cv2.connectedComponentsWithStats(region)
        width, height, area = stats[:, 2:].T
        wide = (width >= _WIDE[0] * height) & (width <= _WIDE[1] * height) & (width >= least_px)
        share = width / presence.side
        suited = (share >= _SUITED[0]) & (share <= _SUITED[1])
        filled = area >= _LEAST_FILL * width * height
        # The first is what lies about all others.
        for label in np.flatnonzero((wide & suited & filled)[1:]) + 1:
            left, top, columns, rows = stats[label, :4].tolist()
            yield (
                (left, top, columns, rows),
                labels[top : top + rows, left : left + columns] == label,
            )


def _enlarged(own: NDArray[np.bool_], x: int, y: int, factor: float) -> Silhouette | None:
    rows, columns = own.shape
    mask = resize_mask(own, max(1, round(columns / factor)), max(1, round(rows / factor)))
    place = {"left": round(x / factor), "top": round(y / factor)}
    return silhouette_from_mask(mask, **place, segmenter="network", truncated=False)


def is_wide(box: Box) -> bool:
    """Whether somebody in a box may lie."""
    return box.width >= _WIDE[0] * box.height


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
    _, placement = normalise(upright.crop)
    return reader.read(np.rot90(frame, turns), upright, placement).clarity()


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
    segmenter: Segmenter, reader: JointReader, frame: NDArray[np.uint8], box: Box
) -> tuple[Silhouette | None, int]:
    """Cut somebody out of a wide box, upright or lying as joints show more clearly.

    Returns
    -------
    silhouette : Silhouette or None
    turns : int
        That set the person upright.
    """
    looks: list[tuple[float, int, Silhouette]] = []
    for turns in (0, 1, 3):
        silhouette = _segment_turned(segmenter, frame, box, turns)
        if silhouette is not None:
            looks.append((_clarity(reader, frame, silhouette, turns), turns, silhouette))
    if not looks:
        return None, 0
    _, turns, silhouette = max(looks, key=lambda look: look[0])
    return silhouette, turns


def _segment_turned(
    segmenter: Segmenter, frame: NDArray[np.uint8], box: Box, turns: int
) -> Silhouette | None:
    upright = np.ascontiguousarray(np.rot90(frame, turns))
    (found,) = segmenter.segment(upright, [turned_box(box, frame.shape, turns)])
    return None if found is None else turned_silhouette(found, upright.shape, -turns)
