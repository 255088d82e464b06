"""A person turned upright for matching, and the way back to the frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.vision.people import ObservedKeypoints, Silhouette
from app.vision.turning import (
    turned_keypoints,
    turned_points,
    turned_shape,
    turned_silhouette,
)
from descriptor.silhouette import Placement, normalise
from index.keypoints import Keypoints
from index.matching import Hypothesis, leaning_further
from index.skeleton import COCO17, LIMBS

_LEAN_DEG = (0.0, 90.0, 180.0, -90.0)

# The limbs and the nose: the index has its eyes and ears in other places than COCO.
_COMPARED = [i for i, name in enumerate(COCO17.names) if name in (*LIMBS, "nose")]
_LEAST_SCORE = 0.05
_FEWEST = 4


@dataclass(frozen=True)
class UprightPerson:
    """A person's normalised silhouette and keypoints, upright.

    Parameters
    ----------
    turns : int
        Quarter turns counterclockwise that set the person upright.
    frame_shape : tuple of int
        Rows and columns of the original frame.
    silhouette : Silhouette
        In the turned frame.
    normalised : (128, 48) uint8 array
    placement : Placement
        From the silhouette's crop to the normalised frame.
    observed : ObservedKeypoints or None
        In the turned frame; None if nothing was read.
    """

    turns: int
    frame_shape: tuple[int, ...]
    silhouette: Silhouette
    normalised: NDArray[np.uint8]
    placement: Placement
    observed: ObservedKeypoints | None

    @classmethod
    def of(
        cls,
        silhouette: Silhouette,
        turns: int,
        frame_shape: tuple[int, ...],
        observed: ObservedKeypoints | None,
    ) -> UprightPerson:
        """Turn a person upright; silhouette and keypoints are given in the original frame."""
        if turns:
            silhouette = turned_silhouette(silhouette, frame_shape, turns)
            observed = observed and turned_keypoints(observed, frame_shape, turns)
        return cls(turns, frame_shape[:2], silhouette, *normalise(silhouette.crop), observed)

    def keypoints(self) -> Keypoints | None:
        """The keypoints in the normalised frame, for an index; None if too few."""
        if self.observed is None:
            return None
        used = [i for i in _COMPARED if self.observed.scores[i] > _LEAST_SCORE]
        if len(used) < _FEWEST:
            return None
        within = self.observed.positions[used] - (self.silhouette.left, self.silhouette.top)
        offset = (self.placement.offset_x, self.placement.offset_y)
        return Keypoints(
            tuple(COCO17.indices[i] for i in used),
            within * self.placement.scale + offset,
            self.observed.scores[used],
        )

    def points_in_frame(self, points_normalised: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points ``(..., 2)`` of the normalised frame in pixels of the original frame."""
        points = self.placement.to_image(points_normalised)
        points = points + np.array([self.silhouette.left, self.silhouette.top])
        return turned_points(points, turned_shape(self.frame_shape, self.turns), -self.turns)

    def in_frame(self, hypothesis: Hypothesis) -> Hypothesis:
        """A hypothesis with its skeleton oriented as in the original frame."""
        return leaning_further(hypothesis, _LEAN_DEG[self.turns]) if self.turns else hypothesis
