"""Whether two finds are the same person: each case, and its limits.

Two finds are compared by the best that both have: their points, a window and a box, or two boxes. A
person of an earlier frame is compared with those of a later one by costs, which add up what place,
size and clothes say.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.vision.appearance import colour_distance
from app.vision.blazepose import PoseReading
from app.vision.geometry import Box, PersonWindow, box_array, non_max_suppression
from app.vision.people import Detection

# Overlap from which two boxes of a frame show one person; two people side by side reach 0.3.
_SAME_BOX_IOU = 0.4
# Overlap from which a box shows the person who is expected in another one.
_EXPECTED_IOU = 0.3
# Size of a body's window relative to the one about a box, if both show one person.
_WINDOW_SIZES = (0.4, 2.5)
# Share of a box within reach of a person who is expected and may have fallen.
_MIN_SHARE_IN_REACH = 0.5
# Points of one person are in the same place within this distance, in sizes of the body, for most of
# their weight. Keypoints of lower scores are not compared.
_SAME_PLACE, _MIN_COMPARED_SCORE = 0.12, 0.1


def tell_apart(found: Sequence[Detection]) -> tuple[list[Detection], list[Detection]]:
    """People, one detection each, and others in their boxes whose keypoints differ from theirs.

    Of detections of one person, the first is kept.
    """
    ranks = -np.arange(float(len(found)))
    kept = non_max_suppression(box_array(one.box for one in found), ranks, _SAME_BOX_IOU)
    people, beside = [found[row] for row in kept], list[Detection]()
    for one in found:
        known = (*people, *beside)
        if not any(one is other or _same_keypoints(one, other) for other in known):
            beside.append(one)
    return people, beside


def _same_keypoints(one: Detection, other: Detection) -> bool:
    """Whether the keypoints of two detections show the same person."""
    first, second = one.keypoints, other.keypoints
    if one.box.intersection(other.box) == 0 or first is None or second is None:
        return False
    compared = np.minimum(first.scores, second.scores) > _MIN_COMPARED_SCORE
    weights = np.sqrt(first.scores * second.scores) * compared
    size = math.sqrt(min(one.box.area, other.box.area))
    return _same_points(first.positions, second.positions, weights, size)


def first_of_body(readings: Sequence[PoseReading]) -> list[int]:
    """For each reading, the first one that shows the same body: its own row if none does."""
    first: list[int] = []
    for row, reading in enumerate(readings):
        same = (
            other for other in dict.fromkeys(first) if _same_landmarks(reading, readings[other])
        )
        first.append(next(same, row))
    return first


def _same_landmarks(first: PoseReading, second: PoseReading) -> bool:
    """Whether two readings show the same body; what neither sees hardly counts."""
    one, other = first.landmarks, second.landmarks
    weights = one.visibility * other.visibility + 1e-3
    size = min(first.body_px, second.body_px)
    return _same_points(one.positions, other.positions, weights, size)


def _same_points(
    first: NDArray[np.float64],
    second: NDArray[np.float64],
    weights: NDArray[np.float64],
    size: float,
) -> bool:
    """Whether most of the weight ``(N,)`` is of points ``(N, 2)`` that lie in the same place."""
    close = np.linalg.norm(first - second, axis=1) < _SAME_PLACE * size
    return bool(weights @ close >= 0.5 * weights.sum())


def shows(one: Detection, person: Detection) -> bool:
    """Whether another detector shows a person: by its window or, without one, by its box."""
    if not one.windows:
        return one.box.iou(person.box) >= _SAME_BOX_IOU
    window, box = one.windows[0], person.box
    inside = box.x <= window.x <= box.right and box.y <= window.y <= box.bottom
    low, high = _WINDOW_SIZES
    return inside and low < window.side / PersonWindow.about_box(box).side < high


def is_expected(box: Box, expected: Box) -> bool:
    """Whether a box shows the person who is expected in another one."""
    return box.iou(expected) >= _EXPECTED_IOU


def may_be_reached(box: Box, expected: Box) -> bool:
    """Whether a box may hold an expected person, standing there or on the ground nearby."""
    x, y, width, height = expected.x, expected.y, expected.width, expected.height
    margin = max(width, height) / 2
    reach = Box(x - margin, y, width + 2 * margin, height + margin / 2)
    return box.intersection(reach) >= _MIN_SHARE_IN_REACH * box.area


# Distances are in sizes of the person.
# Largest distance of a person from the predicted place: at once, its growth for each second since
# the person was seen, and its limit.
_NEAR, _NEAR_PER_S, _FAR = 0.3, 1.0, 2.0
# Largest ratio of two sizes of one person at once; it applies once more for each second since the
# person was seen. A person's box shrinks within half a second in a fall towards the camera.
_MAX_GROWTH = 1.6
# Weights of the costs of a pair, each 0 to 1 within the limits above.
_PLACE_WEIGHT, _OVERLAP_WEIGHT, _SIZE_WEIGHT, _COLOUR_WEIGHT = 0.4, 0.3, 0.2, 0.6
# Cost of the colours if either are unknown.
_UNKNOWN_COLOURS = 0.3
# Factor of the cost of the person who was read in the window in which the known one is expected.
_WINDOW_FACTOR = 0.5

MAX_COST = 1.1
"""At a higher cost, two people of different frames are not the same."""


@dataclass(frozen=True)
class KnownPerson:
    """A person of earlier frames, and where they are expected in this one.

    Boxes are as predicted and as last seen, ``elapsed_s`` seconds ago. The colours ``(80,)`` are
    None if they are unknown.
    """

    predicted: Box
    seen: Box
    elapsed_s: float
    colours: NDArray[np.float32] | None

    def cost(self, box: Box, colours: NDArray[np.float32] | None, *, in_window: bool) -> float:
        """Cost of taking a person of this frame for the known one; infinite if that cannot be.

        ``in_window`` says that the person was read where the known one is expected.
        """
        reach = min(_FAR, _NEAR + _NEAR_PER_S * self.elapsed_s)
        away = _distance(self.predicted, box) / max(_size(self.predicted), _size(box))
        # When a person bends quickly, the box shrinks faster than the predicted size, which is
        # averaged over frames; the last observed box is then closer in size.
        growth = min(_growth(self.predicted, box), _growth(self.seen, box))
        growth /= math.log(_MAX_GROWTH) * (1 + self.elapsed_s)
        if not in_window and (away > reach or growth > 1):
            return math.inf
        clothes = _UNKNOWN_COLOURS
        if self.colours is not None and colours is not None:
            clothes = colour_distance(self.colours, colours)
        cost = (
            _PLACE_WEIGHT * min(1.0, away / reach)
            + _OVERLAP_WEIGHT * (1 - self.predicted.iou(box))
            + _SIZE_WEIGHT * min(1.0, growth)
            + _COLOUR_WEIGHT * clothes
        )
        return _WINDOW_FACTOR * cost if in_window else cost


def _growth(before: Box, after: Box) -> float:
    """Absolute log ratio of the sizes of two boxes."""
    return abs(math.log(_size(after) / _size(before)))


def _size(box: Box) -> float:
    """Length of a body. Unlike the height, it stays the same in a fall."""
    return max(box.width, box.height)


def _distance(first: Box, second: Box) -> float:
    """Pixels between the centres of two boxes."""
    return math.hypot(
        first.x + first.width / 2 - second.x - second.width / 2,
        first.y + first.height / 2 - second.y - second.height / 2,
    )
