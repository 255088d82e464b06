"""The output of one pass of the landmark network, in coordinates of the window.

It is the input of the models trained on rendered people (depth, posture, doubt).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from app.vision.landmark_features import sample_map

POINTS = 39
"""33 landmarks, and 6 points of the circle about the body."""

MAP_SHAPES = ((8, 8, 144), (2, 2, 288))
"""Rows, columns and channels of the feature maps: middle and last."""


@dataclass(frozen=True)
class NetworkPass:
    """The output of one pass.

    Parameters
    ----------
    points : (39, 5) float32 array
        x and y in pixels of the window from the corner of its first pixel, depth in the same
        pixels, log odds of visibility and of presence.
    world : (39, 3) float32 array
        Metres about the middle of the hips: x and y along the window's sides, z along its line
        of sight.
    presence : float
        The network's probability that a person is in the window.
    middle : (8, 8, 144) float32 array
        Feature map.
    last : (2, 2, 288) float32 array
        Feature map.
    """

    points: NDArray[np.float32]
    world: NDArray[np.float32]
    presence: float
    middle: NDArray[np.float32]
    last: NDArray[np.float32]

    def __post_init__(self) -> None:
        shapes = (self.points.shape, self.world.shape)
        maps = (self.middle.shape, self.last.shape)
        if shapes != ((POINTS, 5), (POINTS, 3)) or maps != MAP_SHAPES:
            raise ValueError(
                f"expected points (39, 5), world (39, 3) and maps {MAP_SHAPES}, "
                f"got {shapes} and {maps}"
            )

    @cached_property
    def sampled(self) -> NDArray[np.float32]:
        """The middle map at the landmarks ``(33, 144)``."""
        return np.asarray(sample_map(self.middle[None], self.points[None])[0])
