"""Stick figures: random poses, their silhouettes from any side."""

import cv2
import numpy as np
from numpy.typing import NDArray

from descriptor.silhouette import is_wide, normalise, principal_axis_deg
from index.skeleton import NATIVE, POINT_NAMES, camera_rotation, project, rows, wrap_degrees

PIXELS_PER_METRE = 100.0
CANVAS = 256
CAMERA_DISTANCE_M = 4.0

Limbs = tuple[float, float, float, float, float]
"""Of one side, radians: arm ahead, elbow bent, leg ahead, knee bent, arm aside."""


def stick_figure(rng: np.random.Generator) -> NDArray[np.float64]:
    """A random pose ``(24, 3)`` in body axes: a standing person who swings arms and legs."""
    return posed_figure(
        *(
            (*rng.uniform((-1.2, 0, -0.8, 0), (1.2, 1.4, 0.8, 1.0)), rng.uniform(0.1, 1.5))
            for _ in range(2)
        )
    )


def posed_figure(left: Limbs, right: Limbs) -> NDArray[np.float64]:
    """A standing person ``(24, 3)`` in body axes."""
    points = dict.fromkeys(POINT_NAMES, np.zeros(3))
    points["spine"], points["chest"] = np.array([0, 0.12, 0]), np.array([0, 0.3, 0])
    points["neck"], points["head"] = np.array([0, 0.52, 0]), np.array([0, 0.66, 0.03])
    for side, sign, limbs in (("left", 1.0, left), ("right", -1.0, right)):
        arm, elbow, leg, knee, spread = limbs
        points[f"{side}_shoulder"] = np.array([0.18 * sign, 0.46, 0])
        points[f"{side}_elbow"] = points[f"{side}_shoulder"] + 0.28 * _swing(arm, spread * sign)
        points[f"{side}_wrist"] = points[f"{side}_elbow"] + 0.26 * _swing(
            arm + elbow, spread * sign
        )
        points[f"{side}_hip"] = np.array([0.1 * sign, -0.04, 0])
        points[f"{side}_knee"] = points[f"{side}_hip"] + 0.42 * _swing(leg, 0.1 * sign)
        points[f"{side}_ankle"] = points[f"{side}_knee"] + 0.42 * _swing(leg - knee, 0.1 * sign)
        points[f"{side}_toe"] = points[f"{side}_ankle"] + np.array([0, -0.03, 0.16])
        points[f"{side}_eye"] = points["head"] + np.array([0.03 * sign, 0.03, 0.09])
        points[f"{side}_ear"] = points["head"] + np.array([0.07 * sign, 0.0, 0.01])
    points["nose"] = points["head"] + np.array([0, 0, 0.11])
    return np.array([points[name] for name in POINT_NAMES])


def _swing(forward: float, aside: float) -> NDArray[np.float64]:
    """Unit vector of a limb that hangs, swung forward and aside by angles in radians."""
    return np.array(
        [np.sin(aside) * np.cos(forward), -np.cos(aside) * np.cos(forward), np.sin(forward)]
    )


def draw_figure(plane: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Silhouette ``(256, 256)`` of 0 and 1 of a figure given in metres ``(24, 2)``."""
    pixels = np.round(plane * PIXELS_PER_METRE + CANVAS / 2).astype(int)
    canvas = np.zeros((CANVAS, CANVAS), np.uint8)
    for parent, child in NATIVE.bones:
        cv2.line(canvas, pixels[parent].tolist(), pixels[child].tolist(), 1, 11)
    torso = [POINT_NAMES.index(f"{s}_{j}") for j in ("shoulder", "hip") for s in ("left", "right")]
    cv2.fillConvexPoly(canvas, cv2.convexHull(pixels[torso]), 1)
    cv2.circle(canvas, pixels[POINT_NAMES.index("head")].tolist(), 11, 1, -1)
    return canvas


def draw_view(
    skeleton: NDArray[np.float64], azimuth_deg: float, elevation_deg: float, roll_deg: float = 0.0
) -> tuple[NDArray[np.uint8], dict[str, float]]:
    """The normalised silhouette of a figure ``(24, 3)``, and its camera and placement."""
    points = skeleton @ camera_rotation(azimuth_deg, elevation_deg, roll_deg).T
    silhouette, placement = normalise(draw_figure(project(points, CAMERA_DISTANCE_M)))
    offset_x, offset_y = placement.to_normalised([CANVAS / 2, CANVAS / 2])
    return silhouette, {
        "azimuth_deg": azimuth_deg,
        "elevation_deg": elevation_deg,
        "roll_deg": roll_deg,
        "distance": CAMERA_DISTANCE_M,
        "scale": placement.scale * PIXELS_PER_METRE,
        "offset_x": offset_x,
        "offset_y": offset_y,
    }


VIEWS = 12


def movement(figures: int, extent: float = 1.0) -> NDArray[np.float64]:
    """Figures ``(figures, 24, 3)`` that move from one random pose to the next in four steps."""
    generator = np.random.default_rng(6)
    keys = extent * generator.uniform(
        (-1.0, 0.0, -0.7, 0.0, 0.1), (1.2, 1.4, 0.8, 1.0, 2.0), (figures // 4 + 2, 2, 5)
    )
    times = np.arange(figures) / 4
    before, share = times.astype(int), (times % 1)[:, None, None]
    sides = (1 - share) * keys[before] + share * keys[before + 1]
    return np.array([posed_figure(*both) for both in sides])


def drawn(
    skeleton: NDArray[np.float64], generator: np.random.Generator, views: int = VIEWS
) -> list[tuple[NDArray[np.uint8], dict[str, float]]]:
    """Views all around a figure, rolled to stand where it is wider than high."""
    found = []
    for azimuth_deg in 360 * (np.arange(views) + generator.uniform(size=2).sum()) / views:
        camera = (float(azimuth_deg) % 360, float(generator.uniform(-5, 40)))
        roll_deg = float(generator.normal(0, 2))
        silhouette, placed = draw_view(skeleton, *camera, roll_deg)
        if is_wide(silhouette):
            upright = roll_deg - principal_axis_deg(silhouette)
            head, pelvis = (skeleton @ camera_rotation(*camera, upright).T)[rows("head", "pelvis")]
            upright += 0 if head[1] < pelvis[1] else 180
            silhouette, placed = draw_view(skeleton, *camera, float(wrap_degrees(upright)))
        found.append((silhouette, placed))
    return found
