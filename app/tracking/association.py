"""Match the sightings of a frame to tracks, by box, distance and appearance."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import lap
import numpy as np
from numpy.typing import NDArray

from app.tracking.parameters import DEFAULTS, MatchingParameters
from app.tracking.track import Sighting, Track
from app.vision.geometry import Box
from app.vision.people import Silhouette

_HUES, _SATURATIONS, _GREYS = 8, 4, 8


def appearance_histogram(frame: NDArray[np.uint8], silhouette: Silhouette) -> NDArray[np.float32]:
    """Colours of the upper and lower half of a person.

    Parameters
    ----------
    frame : (H, W, 3) uint8 array
        BGR.
    silhouette : Silhouette
        Of the person, in the frame.

    Returns
    -------
    (2 * 40,) float32 array
        Histograms of hue by saturation, and of brightness, for each half; they sum to 1.
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


def associate(
    tracks: Sequence[Track],
    sightings: Sequence[Sighting],
    timestamp: float,
    parameters: MatchingParameters = DEFAULTS.matching,
) -> list[int | None]:
    """Assign each sighting to a track so that the sum of the costs is minimal.

    Parameters
    ----------
    tracks, sightings : sequences of Track and Sighting
    timestamp : float
        Time of the sightings, seconds.

    Returns
    -------
    list of int or None
        For each sighting, the position of its track; None for a new person.
    """
    if not tracks or not sightings:
        return [None] * len(sightings)
    costs = _costs(tracks, sightings, timestamp, parameters)
    _, _, assigned = lap.lapjv(costs, extend_cost=True, cost_limit=parameters.max_cost)
    return [int(row) if row >= 0 else None for row in assigned]


def _costs(
    tracks: Sequence[Track],
    sightings: Sequence[Sighting],
    timestamp: float,
    parameters: MatchingParameters,
) -> NDArray[np.float64]:
    """Costs ``(T, S)`` of all pairs, above the maximum if both cannot be the same person."""
    costs = np.full((len(tracks), len(sightings)), 10 * parameters.max_cost)
    for row, track in enumerate(tracks):
        predicted, last = track.box_filter.predict(timestamp), track.box_filter.seen
        elapsed = timestamp - track.seen_at
        reach = min(parameters.far, parameters.near + parameters.near_per_s * elapsed)
        max_growth = math.log(parameters.max_growth) * (1 + elapsed)
        for column, sighting in enumerate(sightings):
            box = sighting.observed.box
            away = _distance(predicted, box) / max(_size(predicted), _size(box))
            # When a person bends quickly, the box shrinks faster than the predicted size, which is
            # averaged over frames; the last observed box is then closer in size.
            growth = min(_growth(predicted, box), _growth(last, box)) / max_growth
            in_window = sighting.track is track
            if not in_window and (away > reach or growth > 1):
                continue
            appearance = parameters.unknown_appearance
            if track.appearance is not None and sighting.appearance is not None:
                appearance = appearance_distance(track.appearance, sighting.appearance)
            cost = (
                parameters.place_weight * min(1.0, away / reach)
                + parameters.overlap_weight * (1 - predicted.iou(box))
                + parameters.size_weight * min(1.0, growth)
                + parameters.appearance_weight * appearance
            )
            costs[row, column] = parameters.window_factor * cost if in_window else cost
    return costs


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
