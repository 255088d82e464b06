"""Skeletons placed before the camera, in perspective.

An index knows skeletons in the axes of the line of sight, as if each person stood in the middle of
the frame, and in the size of its own bodies. Here each joint of a hypothesis is put on the line of
sight of its pixel, at the depth that the hypothesis and the landmarks give it: in the camera's
axes, and in the person's own size.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.estimation.parameters import PLACEMENT, PlacementParameters
from app.vision.people import LANDMARK_NAMES, Landmarks
from app.vision.sight import PinholeCamera, place_on_sight_lines, to_line_of_sight
from index.skeleton import OTHER_SIDE, POINT_NAMES, side_rows

# The index has its eyes and ears in other places than the landmark network.
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
    """Skeletons before a camera.

    Parameters
    ----------
    points_3d : (M, 24, 3) float64 array
        Metres, camera axes, relative to the pelvis.
    points_2d : (M, 24, 2) float64 array
        Their projections, pixels of the frame.
    pelvis : (M, 3) float64 array
        Metres from the camera, its axes.
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
    """Place the hypotheses of a person before a camera.

    The first follows the landmarks in depth, the less the less certain they are. The others keep
    their own depths: they are other ways to read the image. Without landmarks, skeletons stay in
    the axes of the line of sight unless the field of view is known.

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
        placed = [_as_it_is(*pair, camera) for pair in zip(points_3d, points_2d, strict=True)]
        stacked = _stacked(placed, list(points_2d))
        # A mask may be a crop: nothing shows where the optical axis is, unless the caller says so.
        return stacked if camera.given else replace(stacked, points_3d=points_3d)
    visibility = landmarks.visibility[_LANDMARKS]
    visible = np.where(visibility > parameters.min_visibility, visibility, 0.0)
    weights = np.maximum(visible, 1e-3)
    seen = landmarks.positions[_LANDMARKS]
    line = to_line_of_sight(camera.rays(landmarks.positions[_LANDMARK_HIPS].mean(axis=0)))
    metres = landmarks.metres[_LANDMARKS]
    origin = place_on_sight_lines(metres, camera.rays(seen), line, weights).origin
    depth = float((line @ origin)[2])
    reliability = visible / (1 + (landmarks.depth_sd[_LANDMARKS] / parameters.half_way_sd_m) ** 2)
    placed, shown = [], []
    for rank, (own_3d, own_2d) in enumerate(zip(points_3d, points_2d, strict=True)):
        rows = _POINTS if rank == 0 else _rows_shown(own_2d, seen)
        about_hips = own_3d - own_3d[_HIPS].mean(axis=0)
        size = (weights[:, None] * metres * about_hips[rows]).sum() / (
            weights[:, None] * about_hips[rows] ** 2
        ).sum()
        depths = np.clip(size, *parameters.sizes) * about_hips[:, 2]
        if rank == 0:
            depths[rows] += reliability * (metres[:, 2] - depths[rows])
        pixels = own_2d.copy()
        pixels[rows] += visible[:, None] * (seen - pixels[rows])
        lines = camera.rays(pixels) @ line.T
        lines = lines / np.maximum(lines[:, 2:], parameters.min_forward)
        placed.append(lines * np.maximum(depth + depths, parameters.min_distance_m)[:, None] @ line)
        shown.append(pixels)
    return _stacked(placed, shown)


def _as_it_is(
    own_3d: NDArray[np.float64], own_2d: NDArray[np.float64], camera: PinholeCamera
) -> NDArray[np.float64]:
    """A skeleton turned to its line of sight, where it looks as large as in the image."""
    rays = camera.rays(own_2d)
    line = to_line_of_sight(rays[_PELVIS])
    origin = place_on_sight_lines(own_3d, rays, line, np.ones(len(rays))).origin
    return np.asarray(own_3d @ line + origin)


def _rows_shown(own_2d: NDArray[np.float64], seen: NDArray[np.float64]) -> NDArray[np.integer]:
    """Points of a skeleton that landmarks show: the same side's, or the other's if nearer."""
    other = OTHER_SIDE[_POINTS]
    same, exchanged = (
        np.linalg.norm(own_2d[rows] - seen, axis=1).mean() for rows in (_POINTS, other)
    )
    return _POINTS if same <= exchanged else other


def _stacked(
    placed: list[NDArray[np.float64]], shown: list[NDArray[np.float64]]
) -> PlacedSkeletons:
    points = np.array(placed)
    pelvis = points[:, _PELVIS]
    return PlacedSkeletons(points - pelvis[:, None], np.array(shown), pelvis)
