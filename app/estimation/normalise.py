"""A person normalised for matching, and the transform back to the frame."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.estimation.parameters import NORMALISATION
from app.vision.geometry import transform_points
from app.vision.people import LANDMARK_NAMES, Landmarks, Silhouette
from descriptor.silhouette import is_wide, normalise, principal_axis_deg
from index.keypoints import Keypoints
from index.rotations import rotate_silhouette
from index.skeleton import LIMBS, SIDES, rotate_clockwise, rows, side_rows

# Points of the index and their landmarks. The eyes and ears of the index are in other places, so
# they are left out.
_LANDMARK_OF = {name: name for name in (*LIMBS, "nose")} | {
    f"{side}_toe": f"{side}_foot_index" for side in SIDES
}
_POINTS, _LANDMARKS = rows(*_LANDMARK_OF), rows(*_LANDMARK_OF.values(), among=LANDMARK_NAMES)
_LIMBS = rows(*LIMBS, among=LANDMARK_NAMES)
_ANKLES = side_rows("ankle", among=LANDMARK_NAMES)
_HEAD = rows("nose", "left_ear", "right_ear", among=LANDMARK_NAMES)


@dataclass(frozen=True)
class NormalisedPerson:
    """A person's normalised silhouette and keypoints; wide silhouettes are rotated upright.

    Parameters
    ----------
    silhouette : (128, 48) uint8 array
    roll_deg : float
        Clockwise rotation of the silhouette, as if the camera had been rolled; 0 unless the
        silhouette is wide.
    to_frame : (2, 3) float64 array
        Affine transform from pixels of ``silhouette`` to pixels of the frame.
    landmarks : Landmarks or None
        Landmarks in pixels of the frame; None if they were not read.
    """

    silhouette: NDArray[np.uint8]
    roll_deg: float
    to_frame: NDArray[np.float64]
    landmarks: Landmarks | None

    @classmethod
    def of(cls, silhouette: Silhouette, landmarks: Landmarks | None) -> NormalisedPerson:
        """Normalise a person's silhouette and landmarks, both given in the frame."""
        corner = np.array([silhouette.left, silhouette.top], np.float64)
        if is_wide(silhouette.crop):
            roll_deg = -principal_axis_deg(silhouette.crop)
            normalised, to_frame = rotate_silhouette(silhouette.crop, roll_deg)
            to_frame = np.column_stack([to_frame[:, :2], to_frame[:, 2] + corner])
            return cls(normalised, roll_deg, to_frame, landmarks)
        normalised, placement = normalise(silhouette.crop)
        offset = np.array([placement.offset_x, placement.offset_y])
        scale = 1 / placement.scale
        to_frame = np.column_stack([scale * np.eye(2), corner - scale * offset])
        return cls(normalised, 0.0, to_frame, landmarks)

    @property
    def whole(self) -> bool:
        """Whether the photograph shows the person from head to feet; true without landmarks."""
        if self.landmarks is None:
            return True
        visibility = self.landmarks.visibility
        feet_visible = visibility[_ANKLES].max() >= NORMALISATION.min_feet_visibility
        return bool(feet_visible and visibility[_HEAD].max() >= NORMALISATION.min_head_visibility)

    def keypoints(self) -> Keypoints | None:
        """The landmarks in the normalised frame, for matching; None if too few are visible."""
        if self.landmarks is None:
            return None
        scores = self.landmarks.visibility[_LANDMARKS]
        used = np.flatnonzero(scores > NORMALISATION.min_score)
        if len(used) < NORMALISATION.min_keypoints:
            return None
        to_normalised = np.asarray(cv2.invertAffineTransform(self.to_frame), np.float64)
        positions = self.landmarks.positions[_LANDMARKS][used]
        return Keypoints(
            tuple(_POINTS[i] for i in used),
            transform_points(to_normalised, positions),
            np.minimum(scores[used], 1.0),
            rotate_clockwise(self.landmarks.metres[_LIMBS], self.roll_deg),
            self.landmarks.visibility[_LIMBS],
        )

    def points_in_frame(self, points_normalised: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points ``(..., 2)`` of the normalised frame in pixels of the frame."""
        return transform_points(self.to_frame, points_normalised)
