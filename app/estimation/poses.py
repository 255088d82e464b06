"""A person on the way to the index and back: normalised for matching, then placed in space.

The index stores skeletons in line-of-sight axes, as if each person stood in the middle of the
frame, at the size of its own avatars. So each joint of a hypothesis is put on the line of sight of
its pixel, at the depth that the hypothesis and the landmarks give it: in the camera's axes and the
person's size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import transform_points
from app.vision.optics import PinholeCamera, place_on_sight_lines, to_line_of_sight
from app.vision.people import (
    LANDMARK_NAMES,
    Landmarks,
    Silhouette,
    landmark_rows,
)
from descriptor.silhouette import is_wide, normalise, principal_axis_deg, rotate_silhouette
from index.landmarks import SIZE_RANGE, NormalisedLandmarks
from index.skeleton import LIMBS, OTHER_SIDE, POINT_NAMES, SIDES, rotate_clockwise, rows, side_rows

# Points of the index and their landmarks. Eyes and ears are left out, since the index places them
# differently.
_LANDMARK_OF = {name: name for name in (*LIMBS, "nose")} | {
    f"{side}_toe": f"{side}_foot_index" for side in SIDES
}
_POINTS, _LANDMARKS = rows(*_LANDMARK_OF), rows(*_LANDMARK_OF.values(), among=LANDMARK_NAMES)
_LIMBS = rows(*LIMBS, among=LANDMARK_NAMES)
_ANKLES = landmark_rows("ankle")
_HEAD = rows("nose", "left_ear", "right_ear", among=LANDMARK_NAMES)


@dataclass(frozen=True)
class NormalisedPerson:
    """A person's normalised silhouette and landmarks; wide silhouettes are rotated upright."""

    silhouette: NDArray[np.uint8]  # (128, 48)
    # Clockwise rotation of the silhouette, as if the camera had been rolled; 0 unless the
    # silhouette is wide.
    roll_deg: float
    # (2, 3): affine transform from pixels of ``silhouette`` to pixels of the frame.
    to_frame: NDArray[np.float64]
    landmarks: Landmarks | None  # in pixels of the frame; None if they were not read

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
    def feet_visible(self) -> bool:
        """Whether the photograph shows a foot; true without landmarks."""
        return self._shows(_ANKLES, 0.35)

    @property
    def whole(self) -> bool:
        """Whether the photograph shows the person from head to feet; true without landmarks."""
        return self.feet_visible and self._shows(_HEAD, 0.2)

    def _shows(self, rows: Sequence[int], min_visibility: float) -> bool:
        """Whether the photograph shows one of these landmarks; true without any."""
        landmarks = self.landmarks
        return landmarks is None or bool(landmarks.visibility[rows].max() >= min_visibility)

    def normalised_landmarks(self) -> NormalisedLandmarks | None:
        """The landmarks in the normalised frame, for matching; None if too few are visible."""
        if self.landmarks is None:
            return None
        scores = self.landmarks.visibility[_LANDMARKS]
        used = np.flatnonzero(scores > 0.05)
        # With fewer landmarks, a person is matched by the silhouette alone.
        if len(used) < 4:
            return None
        to_normalised = np.asarray(cv2.invertAffineTransform(self.to_frame), np.float64)
        positions = self.landmarks.positions[_LANDMARKS][used]
        return NormalisedLandmarks(
            tuple(_POINTS[i] for i in used),
            transform_points(to_normalised, positions),
            np.minimum(scores[used], 1.0),
            rotate_clockwise(self.landmarks.metres[_LIMBS], self.roll_deg),
            self.landmarks.visibility[_LIMBS],
            self.landmarks.depth_covariance[np.ix_(_LIMBS, _LIMBS)],
            self.whole,
        )

    def points_in_frame(self, points_normalised: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points ``(..., 2)`` of the normalised frame in pixels of the frame."""
        return transform_points(self.to_frame, points_normalised)


# The same points, in the order of the landmarks.
_SEEN_LANDMARKS, _SEEN_POINTS = np.array(sorted(zip(_LANDMARKS, _POINTS, strict=True))).T
_HIPS = side_rows("hip")
_LANDMARK_HIPS = landmark_rows("hip")
_PELVIS = POINT_NAMES.index("pelvis")


@dataclass(frozen=True)
class PlacedSkeletons:
    """Skeletons in front of a camera: metres, relative to the pelvis, in its axes.

    ``points_3d`` are ``(M, 24, 3)``, their projections ``points_2d`` ``(M, 24, 2)`` pixels of the
    frame, and ``pelvis`` ``(M, 3)`` metres from the camera.
    """

    points_3d: NDArray[np.float64]
    points_2d: NDArray[np.float64]
    pelvis: NDArray[np.float64]


def place_skeletons(
    points_3d: NDArray[np.float64],
    points_2d: NDArray[np.float64],
    landmarks: Landmarks | None,
    camera: PinholeCamera,
) -> PlacedSkeletons:
    """Place the hypotheses of a person in front of a camera.

    The first hypothesis is moved towards the landmarks' depths, less so where these are uncertain.
    Hypotheses that differ from it in depth alone are moved by as much. All others keep their own
    depths: they are other interpretations of the image. Without landmarks, skeletons stay in the
    axes of the line of sight unless the field of view is known.

    Parameters
    ----------
    points_3d : (M, 24, 3) float64 array
        Best hypothesis first: metres, axes of the line of sight.
    points_2d : (M, 24, 2) float64 array
        The same, fitted to the image: pixels of the frame.
    landmarks : Landmarks or None
        Pixels of the frame, and metres in the axes of the line of sight to the hips.
    """
    if landmarks is None:
        placed = _as_they_are(points_3d, points_2d, camera)
        # A mask may be a crop: its optical axis is unknown unless the caller describes the camera.
        return placed if camera.given else replace(placed, points_3d=points_3d)
    visibility = landmarks.visibility[_SEEN_LANDMARKS]
    # Visibility below which a landmark does not move a joint.
    visible = np.where(visibility > 0.05, visibility, 0.0)
    weights = np.maximum(visible, 1e-3)
    seen = landmarks.positions[_SEEN_LANDMARKS]
    line = to_line_of_sight(camera.rays(landmarks.positions[_LANDMARK_HIPS].mean(axis=0)))
    metres = landmarks.metres[_SEEN_LANDMARKS]
    origin = place_on_sight_lines(metres, camera.rays(seen), line, weights).origin
    depth = float((line @ origin)[2])
    rows = _rows_shown(points_2d, seen)
    each = np.arange(len(rows))[:, None]
    about_hips = points_3d - points_3d[:, _HIPS].mean(axis=1, keepdims=True)
    shown = about_hips[each, rows]
    size = (weights[:, None] * metres * shown).sum(axis=(1, 2)) / (weights[:, None] * shown**2).sum(
        axis=(1, 2)
    )
    like_first = (points_2d == points_2d[0]).all(axis=(1, 2))
    size[like_first] = size[0]
    depths = np.clip(size, *SIZE_RANGE)[:, None] * about_hips[..., 2]
    # Standard deviation of a landmark's depth at which the first hypothesis moves half way to it:
    # the hypothesis has been fitted to the landmarks, so it adds little information.
    reliability = visible / (1 + (landmarks.depth_sd[_SEEN_LANDMARKS] / 0.24) ** 2)
    moves = np.zeros_like(depths[0])
    moves[_SEEN_POINTS] = reliability * (metres[:, 2] - depths[0, _SEEN_POINTS])
    depths[like_first] += moves
    pixels = points_2d.copy()
    pixels[each, rows] += visible[:, None] * (seen - pixels[each, rows])
    lines = camera.rays(pixels) @ line.T
    lines = lines / np.maximum(lines[..., 2:], 0.05)
    return _about_pelvis(lines * np.maximum(depth + depths, 0.1)[..., None] @ line, pixels)


def _as_they_are(
    own_3d: NDArray[np.float64], own_2d: NDArray[np.float64], camera: PinholeCamera
) -> PlacedSkeletons:
    """Skeletons on their lines of sight, at the distance where they appear as in the image."""
    rays = camera.rays(own_2d)
    lines = to_line_of_sight(rays[:, _PELVIS])
    origin = place_on_sight_lines(own_3d, rays, lines, np.ones(rays.shape[1])).origin
    return _about_pelvis(own_3d @ lines + origin[:, None], own_2d)


def _rows_shown(own_2d: NDArray[np.float64], seen: NDArray[np.float64]) -> NDArray[np.integer]:
    """Rows ``(M, P)`` of the points of skeletons that the landmarks show.

    Left and right are exchanged if the points are then nearer, except for the first skeleton.
    """
    other = OTHER_SIDE[_SEEN_POINTS]
    same, exchanged = (
        np.linalg.norm(own_2d[:, rows] - seen, axis=-1).mean(axis=1)
        for rows in (_SEEN_POINTS, other)
    )
    rows = np.where((exchanged < same)[:, None], other, _SEEN_POINTS)
    rows[0] = _SEEN_POINTS
    return rows


def _about_pelvis(points: NDArray[np.float64], pixels: NDArray[np.float64]) -> PlacedSkeletons:
    pelvis = points[:, _PELVIS]
    return PlacedSkeletons(points - pelvis[:, None], pixels, pelvis)
