"""Virtual cameras on a hemisphere about the body."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

ELEVATIONS_DEG = (-5.0, 60.0)
"""From a little below the pelvis to a steep surveillance view."""

GROUND_ELEVATIONS_DEG = (5.0, 70.0)
"""For bodies that lie or crawl."""

DISTANCES_M = (3.0, 20.0)
"""From a room to a car park."""

ROLL_STD_DEG = 2.0
"""Cameras are rolled a little."""

VIEW_DTYPE = np.dtype(
    [("azimuth_deg", "<f4"), ("elevation_deg", "<f4"), ("roll_deg", "<f4"), ("distance", "<f4")]
)


def sample_views(
    count: int,
    generator: np.random.Generator,
    elevations_deg: tuple[float, float] = ELEVATIONS_DEG,
) -> NDArray[np.void]:
    """Cameras spread over the hemisphere, each a little off its place.

    Azimuths are stratified, so that ``count`` views of one pose surround it. Elevations crowd
    towards eye level, where most cameras are, with a third above 25 degrees. Distances are
    uniform in their logarithm.

    Returns
    -------
    (count,) array of VIEW_DTYPE
    """
    views = np.zeros(count, VIEW_DTYPE)
    strata = (np.arange(count) + generator.random(count)) / count
    views["azimuth_deg"] = (360.0 * (strata + generator.random())) % 360.0
    low, high = elevations_deg
    # Stratified as well, in an order of its own; the power crowds them towards eye level.
    heights = generator.permutation((np.arange(count) + generator.random(count)) / count)
    views["elevation_deg"] = low + (high - low) * heights**1.8
    views["roll_deg"] = generator.normal(0.0, ROLL_STD_DEG, count)
    nearest, farthest = np.log(DISTANCES_M)
    views["distance"] = np.exp(generator.uniform(nearest, farthest, count))
    return views
