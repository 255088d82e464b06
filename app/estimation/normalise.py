"""A person normalised for matching, and the way back to the frame."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import transform_points
from app.vision.people import LANDMARK_NAMES, Landmarks, Silhouette
from descriptor.silhouette import is_wide, normalise, principal_axis_deg
from index.keypoints import Keypoints
from index.rotations import rotate_silhouette
from index.search import rotate_clockwise
from index.skeleton import LIMBS, POINT_NAMES

# The limbs, the nose and the toes: the index has its eyes and ears in other places.
_LANDMARK_OF = {name: name for name in (*LIMBS, "nose")} | {
    f"{side}_toe": f"{side}_foot_index" for side in ("left", "right")
}
_COMPARED = [LANDMARK_NAMES.index(name) for name in _LANDMARK_OF.values()]
_ROWS = [POINT_NAMES.index(name) for name in _LANDMARK_OF]
_LIMBS = [LANDMARK_NAMES.index(name) for name in LIMBS]
_ANKLES = [LANDMARK_NAMES.index(f"{side}_ankle") for side in ("left", "right")]
_FACE = [LANDMARK_NAMES.index(name) for name in ("nose", "left_ear", "right_ear")]
_LEAST_SCORE = 0.05
_FEWEST = 4
# Visibility of the surer ankle, and of the surest point of the head, of somebody seen whole.
_FEET_SEEN, _HEAD_SEEN = 0.35, 0.2


@dataclass(frozen=True)
class NormalisedPerson:
    """A person's normalised silhouette and keypoints; wide silhouettes are rotated to stand.

    Parameters
    ----------
    silhouette : (128, 48) uint8 array
    roll_deg : float
        How far it was rotated clockwise, as if the camera had been rolled; 0 unless it is wide.
    to_frame : (2, 3) float64 array
        Affine transform from pixels of ``silhouette`` to pixels of the frame.
    landmarks : Landmarks or None
        Pixels of the frame; None if nothing was read.
    """

    silhouette: NDArray[np.uint8]
    roll_deg: float
    to_frame: NDArray[np.float64]
    landmarks: Landmarks | None

    @classmethod
    def of(cls, silhouette: Silhouette, landmarks: Landmarks | None) -> NormalisedPerson:
        """Normalise a person; silhouette and landmarks are given in the frame."""
        corner = np.array([silhouette.left, silhouette.top], np.float64)
        if is_wide(silhouette.crop):
            roll_deg = -principal_axis_deg(silhouette.crop)
            normalised, to_frame = rotate_silhouette(silhouette.crop, roll_deg)
            to_frame = to_frame.copy()
            to_frame[:, 2] += corner
            return cls(normalised, roll_deg, to_frame, landmarks)
        normalised, placement = normalise(silhouette.crop)
        offset = np.array([placement.offset_x, placement.offset_y])
        scale = 1 / placement.scale
        to_frame = np.column_stack([scale * np.eye(2), corner - scale * offset])
        return cls(normalised, 0.0, to_frame, landmarks)

    @property
    def whole(self) -> bool:
        """Whether the photograph shows the person from head to feet, as far as is known."""
        if self.landmarks is None:
            return True
        visibility = self.landmarks.visibility
        return bool(
            visibility[_ANKLES].max() >= _FEET_SEEN and visibility[_FACE].max() >= _HEAD_SEEN
        )

    def keypoints(self) -> Keypoints | None:
        """The landmarks in the normalised frame, for an index; None if too few are seen."""
        if self.landmarks is None:
            return None
        scores = self.landmarks.visibility[_COMPARED]
        used = np.flatnonzero(scores > _LEAST_SCORE)
        if len(used) < _FEWEST:
            return None
        to_normalised = np.asarray(cv2.invertAffineTransform(self.to_frame), np.float64)
        positions = self.landmarks.positions[_COMPARED][used]
        return Keypoints(
            tuple(_ROWS[i] for i in used),
            transform_points(to_normalised, positions),
            np.minimum(scores[used], 1.0),
            rotate_clockwise(self.landmarks.metres[_LIMBS], self.roll_deg),
            self.landmarks.visibility[_LIMBS],
        )

    def points_in_frame(self, points_normalised: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points ``(..., 2)`` of the normalised frame in pixels of the frame."""
        return transform_points(self.to_frame, points_normalised)
