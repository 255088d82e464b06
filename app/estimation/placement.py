"""Skeletons placed in front of the camera, in perspective.

The index stores skeletons in line-of-sight axes, as if each person stood in the middle of the
frame, at the size of its own avatars. Here each joint of a hypothesis is put on the line of sight
of its pixel, at the depth that the hypothesis and the landmarks give it. The result is in the
camera's axes and has the person's size.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.estimation.parameters import PLACEMENT, PlacementParameters
from app.vision.people import LANDMARK_NAMES, Landmarks
from app.vision.sight import PinholeCamera, place_on_sight_lines, to_line_of_sight
from index.skeleton import OTHER_SIDE, POINT_NAMES, side_rows

# The eyes and ears of the index are in other places than those of the landmark network.
_POINT_OF = {
    name: name
    for name in LANDMARK_NAMES
    if name in POINT_NAMES and not name.endswith(("eye", "ear"))
} | {f"{side}_foot_index": f"{side}_toe" for side in ("left", "right")}
_LANDMARKS = [LANDMARK_NAMES.index(name) for name in _POINT_OF]
_POINTS = np.array([POINT_NAMES.index(name) for name in _POINT_OF.values()])
_HIPS = side_rows("hip")
_LANDMARK_HIPS = side_rows("hip", among=LANDMARK_NAMES)
_PELVIS = POINT_NAMES.index("pelvis")


@dataclass(frozen=True)
class PlacedSkeletons:
    """Skeletons in front of a camera.

    Parameters
    ----------
    points_3d : (M, 24, 3) float64 array
        Metres, camera axes, relative to the pelvis.
    points_2d : (M, 24, 2) float64 array
        Their projections, pixels of the frame.
    pelvis : (M, 3) float64 array
        Metres from the camera, in its axes.
    """

    points_3d: NDArray[np.float64]
    points_2d: NDArray[np.float64]
    pelvis: NDArray[np.float64]


def place_skeletons(
    points_3d: NDArray[np.float64],
    points_2d: NDArray[np.float64],
    landmarks: Landmarks | None,
    camera: PinholeCamera,
    parameters: PlacementParameters = PLACEMENT,
) -> PlacedSkeletons:
    """Place the hypotheses of a person in front of a camera.

    The first is moved towards the landmarks' depths, less so where these are uncertain. The others
    keep their own depths: they are other interpretations of the image. Without landmarks, skeletons
    stay in the axes of the line of sight unless the field of view is known.

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
        # A mask may be a crop: nothing shows where the optical axis is, unless the caller says so.
        return placed if camera.given else replace(placed, points_3d=points_3d)
    visibility = landmarks.visibility[_LANDMARKS]
    visible = np.where(visibility > parameters.min_visibility, visibility, 0.0)
    weights = np.maximum(visible, 1e-3)
    seen = landmarks.positions[_LANDMARKS]
    line = to_line_of_sight(camera.rays(landmarks.positions[_LANDMARK_HIPS].mean(axis=0)))
    metres = landmarks.metres[_LANDMARKS]
    origin = place_on_sight_lines(metres, camera.rays(seen), line, weights).origin
    depth = float((line @ origin)[2])
    rows = _rows_shown(points_2d, seen)
    each = np.arange(len(rows))[:, None]
    about_hips = points_3d - points_3d[:, _HIPS].mean(axis=1, keepdims=True)
    shown = about_hips[each, rows]
    size = (weights[:, None] * metres * shown).sum(axis=(1, 2)) / (weights[:, None] * shown**2).sum(
        axis=(1, 2)
    )
    depths = np.clip(size, *parameters.sizes)[:, None] * about_hips[..., 2]
    reliability = visible / (1 + (landmarks.depth_sd[_LANDMARKS] / parameters.half_way_sd_m) ** 2)
    depths[0, _POINTS] += reliability * (metres[:, 2] - depths[0, _POINTS])
    pixels = points_2d.copy()
    pixels[each, rows] += visible[:, None] * (seen - pixels[each, rows])
    lines = camera.rays(pixels) @ line.T
    lines = lines / np.maximum(lines[..., 2:], parameters.min_forward)
    return _about_pelvis(
        lines * np.maximum(depth + depths, parameters.min_distance_m)[..., None] @ line, pixels
    )


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
    other = OTHER_SIDE[_POINTS]
    same, exchanged = (
        np.linalg.norm(own_2d[:, rows] - seen, axis=-1).mean(axis=1) for rows in (_POINTS, other)
    )
    rows = np.where((exchanged < same)[:, None], other, _POINTS)
    rows[0] = _POINTS
    return rows


def _about_pelvis(points: NDArray[np.float64], pixels: NDArray[np.float64]) -> PlacedSkeletons:
    pelvis = points[:, _PELVIS]
    return PlacedSkeletons(points - pelvis[:, None], pixels, pelvis)
