"""Whether two detections show the same person, within a frame or in two frames.

Two detections or readings of a frame are compared by the best that both have: their points, a
window and a box, or two boxes. A small network compares a person of an earlier frame with the
people of a later one, by place, size, shape, time and clothes
(``python -m scripts train-identity``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.networks.dense import shipped_network
from app.networks.probabilities import sigmoid
from app.vision.blazepose import PoseReading
from app.vision.geometry import Box, PersonWindow
from app.vision.halved import HALF, Frame, seen_at
from app.vision.people import Detection, Silhouette

# Overlap from which two boxes of a frame show one person; two people side by side reach 0.3.
_SAME_BOX_IOU = 0.4


def tell_apart(found: Sequence[Detection]) -> tuple[list[Detection], list[Detection]]:
    """People, one detection each, and other detections in their boxes with different keypoints.

    Of several detections of one person, the first is kept.
    """
    people, beside = list[Detection](), list[Detection]()
    for one in found:
        if all(one.box.iou(other.box) < _SAME_BOX_IOU for other in people):
            people.append(one)
    for one in found:
        known = (*people, *beside)
        if not any(one is other or _same_keypoints(one, other) for other in known):
            beside.append(one)
    return people, beside


def _same_keypoints(one: Detection, other: Detection) -> bool:
    first, second = one.keypoints, other.keypoints
    if one.box.intersection(other.box) == 0 or first is None or second is None:
        return False
    compared = np.minimum(first.scores, second.scores) > 0.1
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
    """Whether two readings show the same body; landmarks hidden in both hardly count."""
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
    """Whether points ``(N, 2)`` with most of the weight ``(N,)`` lie in the same places."""
    close = np.linalg.norm(first - second, axis=1) < 0.12 * size
    return bool(weights @ close >= 0.5 * weights.sum())


def shows(one: Detection, person: Detection) -> bool:
    if not one.windows:
        return one.box.iou(person.box) >= _SAME_BOX_IOU
    window, box = one.windows[0], person.box
    inside = box.x <= window.x <= box.right and box.y <= window.y <= box.bottom
    # Size of a body's window relative to the one about a box, if both show one person.
    low, high = (0.4, 2.5)
    return inside and low < window.side / PersonWindow.about_box(box).side < high


def is_expected(box: Box, expected: Box) -> bool:
    # Overlap from which a box shows the person expected in another box.
    return box.iou(expected) >= 0.3


def may_be_reached(box: Box, expected: Box) -> bool:
    """Whether a box may hold an expected person, standing there or on the ground nearby."""
    x, y, width, height = expected.x, expected.y, expected.width, expected.height
    margin = max(width, height) / 2
    reach = Box(x - margin, y, width + 2 * margin, height + margin / 2)
    # Share of a box within reach of an expected person, who may have fallen.
    return box.intersection(reach) >= 0.5 * box.area


_HUES, _SATURATIONS, _GREYS = 8, 4, 8


def colours_of(frame: Frame, silhouette: Silhouette) -> NDArray[np.float32]:
    """Colours ``(2 * 40,)`` of the upper and lower half of a person in a frame, BGR.

    They are histograms of hue by saturation, and of brightness, for each half; they sum to 1.
    """
    pixels, scale = seen_at(frame, HALF)
    per_pixel = round(1 / scale)
    # If the longer side is less than twice this, every row and column is read, otherwise every
    # second one, and so on; the colours stay the same.
    stride = max(1, max(silhouette.crop.shape) // (per_pixel * 200))
    mask = silhouette.crop[:: stride * per_pixel, :: stride * per_pixel].astype(np.uint8)
    rows, columns = (
        slice(first // per_pixel, first // per_pixel + stride * count, stride)
        for first, count in zip((silhouette.top, silhouette.left), mask.shape, strict=True)
    )
    crop = cv2.cvtColor(pixels[rows, columns], cv2.COLOR_BGR2HSV)
    parts, middle = [], len(mask) / 2
    for half in (np.s_[: math.ceil(middle)], np.s_[math.floor(middle) :]):
        part, inside = crop[half], mask[half]
        colour = cv2.calcHist([part], [0, 1], inside, [_HUES, _SATURATIONS], [0, 180, 0, 256])
        grey = cv2.calcHist([part], [2], inside, [_GREYS], [0, 256])
        parts += [colour.ravel(), grey.ravel()]
    histogram = np.concatenate(parts)
    return np.asarray(histogram / max(1.0, float(histogram.sum())), np.float32)


def colour_distance(first: NDArray[np.float32], second: NDArray[np.float32]) -> float:
    """Hellinger distance of two histograms, 0 to 1."""
    return math.sqrt(max(0.0, 1.0 - float(np.sqrt(first * second).sum())))


FEATURES = 13
"""Numbers that compare a known person with one of a frame; see :meth:`KnownPerson.features`."""

_FAR = 4.0  # Distances beyond so many body sizes say no more.


@dataclass(frozen=True)
class KnownPerson:
    """A person of earlier frames, and the place expected in this frame.

    Boxes are as predicted and as last seen, ``elapsed_s`` seconds ago. The colours ``(80,)`` are
    None if they are unknown.
    """

    predicted: Box
    seen: Box
    elapsed_s: float
    colours: NDArray[np.float32] | None

    def may_be(self, box: Box) -> bool:
        """Whether a box is within reach of the place where the person is expected."""
        size = max(_size(self.predicted), _size(box))
        return _distance(self.predicted, box) <= _FAR * size

    def features(
        self, box: Box, colours: NDArray[np.float32] | None, *, in_window: bool
    ) -> NDArray[np.float64]:
        """Features ``(13,)`` that compare the known person with a person of this frame.

        For the predicted and the seen box each: the distance in body sizes, the overlap and the
        change of size. Then: the motion of the lower edge, the change of shape, the share of the
        smaller box in the other, the elapsed time, the distance of the colours, whether colours are
        unknown, and whether the person was read in the window of the known one (``in_window``).
        """
        size, parts = _size(box), list[float]()
        for known in (self.predicted, self.seen):
            away = _distance(known, box) / max(_size(known), size)
            parts += [min(away, _FAR), known.iou(box), abs(math.log(size / _size(known)))]
        largest = max(_size(self.seen), size)
        apart, unknown = 0.0, 1.0
        if self.colours is not None and colours is not None:
            apart, unknown = colour_distance(self.colours, colours), 0.0
        return np.array(
            [
                *parts,
                min(abs(box.bottom - self.seen.bottom) / largest, _FAR),
                abs(math.log(box.width / box.height * self.seen.height / self.seen.width)),
                self.seen.intersection(box) / min(self.seen.area, box.area),
                min(self.elapsed_s, 3.0),
                apart,
                unknown,
                float(in_window),
            ]
        )


def same_probabilities(features: NDArray[np.float64]) -> NDArray[np.float64]:
    """Probability ``(N,)`` that two people of different frames are the same, from features."""
    return sigmoid(shipped_network("identity")(features)[:, 0].astype(np.float64))


def _size(box: Box) -> float:
    """Length of a body. Unlike the height, it stays the same in a fall."""
    return max(box.width, box.height)


def _distance(first: Box, second: Box) -> float:
    """Pixels between the centres of two boxes."""
    return math.hypot(
        first.x + first.width / 2 - second.x - second.width / 2,
        first.y + first.height / 2 - second.y - second.height / 2,
    )
