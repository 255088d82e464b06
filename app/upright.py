"""A person normalised for matching, and the way back to the frame."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.people import ObservedKeypoints, Silhouette
from descriptor.silhouette import is_wide, normalise, principal_axis_deg
from index.keypoints import Keypoints
from index.rotations import rotate_silhouette
from index.skeleton import COCO17, LIMBS

# The limbs and the nose: the index has its eyes and ears in other places than COCO.
_COMPARED = [i for i, name in enumerate(COCO17.names) if name in (*LIMBS, "nose")]
_LEAST_SCORE = 0.05
_FEWEST = 4


@dataclass(frozen=True)
class UprightPerson:
    """A person's normalised silhouette and keypoints; wide silhouettes are rotated to stand.

    Parameters
    ----------
    normalised : (128, 48) uint8 array
    roll_deg : float
        How far it was rotated clockwise, as if the camera had been rolled; 0 unless it is wide.
    to_frame : (2, 3) float64 array
        Affine transform from pixels of ``normalised`` to pixels of the frame.
    observed : ObservedKeypoints or None
        Pixels of the frame; None if nothing was read.
    """

    normalised: NDArray[np.uint8]
    roll_deg: float
    to_frame: NDArray[np.float64]
    observed: ObservedKeypoints | None

    @classmethod
    def of(cls, silhouette: Silhouette, observed: ObservedKeypoints | None) -> UprightPerson:
        """Normalise a person; silhouette and keypoints are given in the frame."""
        corner = np.array([silhouette.left, silhouette.top], np.float64)
        if is_wide(silhouette.crop):
            roll_deg = -principal_axis_deg(silhouette.crop)
            normalised, to_frame = rotate_silhouette(silhouette.crop, roll_deg)
            to_frame = to_frame.copy()
            to_frame[:, 2] += corner
            return cls(normalised, roll_deg, to_frame, observed)
        normalised, placement = normalise(silhouette.crop)
        offset = np.array([placement.offset_x, placement.offset_y])
        scale = 1 / placement.scale
        to_frame = np.column_stack([scale * np.eye(2), corner - scale * offset])
        return cls(normalised, 0.0, to_frame, observed)

    def keypoints(self) -> Keypoints | None:
        """The keypoints in the normalised frame, for an index; None if too few."""
        if self.observed is None:
            return None
        used = [i for i in _COMPARED if self.observed.scores[i] > _LEAST_SCORE]
        if len(used) < _FEWEST:
            return None
        to_normalised = np.asarray(cv2.invertAffineTransform(self.to_frame), np.float64)
        return Keypoints(
            tuple(COCO17.indices[i] for i in used),
            _transformed(self.observed.positions[used], to_normalised),
            self.observed.scores[used],
        )

    def points_in_frame(self, points_normalised: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points ``(..., 2)`` of the normalised frame in pixels of the frame."""
        return _transformed(points_normalised, self.to_frame)


def _transformed(
    points: NDArray[np.floating], transform: NDArray[np.float64]
) -> NDArray[np.float64]:
    return np.asarray(points @ transform[:, :2].T + transform[:, 2])
