"""Sightings of a frame are matched to tracks, by box, distance and colours."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import lap
import numpy as np
from numpy.typing import NDArray

from app.tracking.track import Sighting, Track
from app.vision.geometry import Box
from app.vision.people import Silhouette

_HUES, _SATURATIONS, _GREYS = 8, 4, 8


def appearance_histogram(frame: NDArray[np.uint8], silhouette: Silhouette) -> NDArray[np.float32]:
    """Colours of a person's upper and lower half.

    Parameters
    ----------
    frame : (H, W, 3) uint8 array
        BGR.
    silhouette : Silhouette

    Returns
    -------
    (2 * 40,) float32 array
        Hue by saturation, and brightness, of each half; sums to 1.
    """
    rows, columns = silhouette.crop.shape
    left, top = silhouette.left, silhouette.top
    crop = cv2.cvtColor(frame[top : top + rows, left : left + columns], cv2.COLOR_BGR2HSV)
    mask = silhouette.crop.view(np.uint8)
    parts = []
    for half in (np.s_[: (rows + 1) // 2], np.s_[rows // 2 :]):
        pixels, inside = crop[half], mask[half]
        colour = cv2.calcHist([pixels], [0, 1], inside, [_HUES, _SATURATIONS], [0, 180, 0, 256])
        grey = cv2.calcHist([pixels], [2], inside, [_GREYS], [0, 256])
        parts += [colour.ravel(), grey.ravel()]
    histogram = np.concatenate(parts)
    return np.asarray(histogram / max(1.0, float(histogram.sum())), np.float32)


def appearance_distance(first: NDArray[np.float32], second: NDArray[np.float32]) -> float:
    """Hellinger distance of two histograms, 0 to 1."""
    return math.sqrt(max(0.0, 1.0 - float(np.sqrt(first * second).sum())))


# How far from the predicted place somebody may be seen, in heights of the person: at once, for
# each second since the last sighting, and at most.
_NEAR, _NEAR_PER_S, _FAR = 0.3, 1.0, 2.0
# Largest ratio of two sizes of one person at once, and once more for each second since the last
# sighting: who falls towards the camera, or away from it, shrinks within half a second.
_GROWTH = 1.6
# Weights of what speaks against a pair, each 0 to 1 within the gates.
_PLACE, _OVERLAP, _SIZE, _APPEARANCE = 0.4, 0.3, 0.2, 0.6
# Share of these that counts against the track in whose window somebody was read.
_FOLLOWED = 0.5
_LARGEST_COST = 1.1


def associate(
    tracks: Sequence[Track], sightings: Sequence[Sighting], timestamp: float
) -> list[int | None]:
    """Assign each sighting to a track so that the sum of what speaks against it is least.

    Parameters
    ----------
    tracks : sequence of Track
    sightings : sequence of Sighting
    timestamp : float
        Seconds, of the sightings.

    Returns
    -------
    list of int or None
        For each sighting the position of its track, None for a newcomer.
    """
    if not tracks or not sightings:
        return [None] * len(sightings)
    costs = association_costs(tracks, sightings, timestamp)
    _, _, assigned = lap.lapjv(costs, extend_cost=True, cost_limit=_LARGEST_COST)
    return [int(row) if row >= 0 else None for row in assigned]


def association_costs(
    tracks: Sequence[Track], sightings: Sequence[Sighting], timestamp: float
) -> NDArray[np.float64]:
    """What speaks against each pair.

    Returns
    -------
    (T, S) float64 array
        Above the largest allowed cost where the two cannot be the same person.
    """
    costs = np.full((len(tracks), len(sightings)), 10 * _LARGEST_COST)
    for row, track in enumerate(tracks):
        predicted = track.motion.predict(timestamp)
        elapsed = timestamp - track.seen_at
        reach = min(_FAR, _NEAR + _NEAR_PER_S * elapsed)
        for column, sighting in enumerate(sightings):
            box = sighting.observed.box
            away = _distance(predicted, box) / max(_size(predicted), _size(box))
            # Who bends fast is smaller than predicted, but not much smaller than just before.
            growth = min(_growth(predicted, box), _growth(track.motion.seen, box)) / (1 + elapsed)
            followed = sighting.followed is track
            if not followed and (away > reach or growth > 1):
                continue
            appearance = (
                0.3
                if track.appearance is None or sighting.appearance is None
                else appearance_distance(track.appearance, sighting.appearance)
            )
            cost = (
                _PLACE * min(1.0, away / reach)
                + _OVERLAP * (1 - predicted.iou(box))
                + _SIZE * min(1.0, growth)
                + _APPEARANCE * appearance
            )
            costs[row, column] = _FOLLOWED * cost if followed else cost
    return costs


def _growth(before: Box, after: Box) -> float:
    """How far two boxes differ in size; 1 is the most that one person's may."""
    return abs(math.log(_size(after) / _size(before))) / math.log(_GROWTH)


def _size(box: Box) -> float:
    """Length of a body: who falls keeps it, though not the height."""
    return max(box.width, box.height)


def _distance(first: Box, second: Box) -> float:
    """Pixels between the middles of two boxes."""
    return math.hypot(
        first.x + first.width / 2 - second.x - second.width / 2,
        first.y + first.height / 2 - second.y - second.height / 2,
    )
