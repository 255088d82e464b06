"""Lines of sight: from pixels to directions, and bodies placed on the lines of their landmarks.

Camera axes: x right, y down, z forward. The axes of a line of sight are the camera's, turned by the
smallest rotation that brings z onto the line. The landmark network's metres are in the axes of the
line of sight to the window's middle, up to the window's roll.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import PersonWindow

ASSUMED_FOV_DEG = 60.0
"""Field of view along the longer side of a frame with no known camera settings."""

NEAREST_M = 0.3
"""Least distance from the camera at which a person is placed."""


@dataclass(frozen=True)
class Optics:
    """A caller's description of a camera; None for what is not given.

    The fields are the horizontal field of view of the frame as sent, the width over the height of a
    pixel, and the camera's clockwise rotation about its line of sight.
    """

    fov_deg: float | None = None
    pixel_aspect: float | None = None
    roll_deg: float | None = None

    def or_else(self, other: Optics) -> Optics:
        """The same, with missing values filled in from another."""
        return Optics(
            *(
                theirs if own is None else own
                for own, theirs in zip(vars(self).values(), vars(other).values(), strict=True)
            )
        )


UNKNOWN_OPTICS = Optics()


@dataclass(frozen=True)
class PinholeCamera:
    """A camera without distortion, its axis through the middle of the frame."""

    # (2,): focal lengths across and down, pixels; alike where pixels are square.
    focal: NDArray[np.float64]
    centre: NDArray[np.float64]  # (2,): principal point, pixels
    given: bool = False  # whether the field of view was given rather than assumed

    def __post_init__(self) -> None:
        finite = np.isfinite(self.focal).all() and np.isfinite(self.centre).all()
        if self.focal.shape != (2,) or self.centre.shape != (2,) or not finite:
            raise ValueError(
                f"expected finite focal lengths and a principal point of shape (2,), "
                f"got {self.focal} and {self.centre}"
            )
        if not (self.focal > 0).all():
            raise ValueError(f"expected focal lengths above 0, got {self.focal}")

    @classmethod
    def of_frame(cls, frame_shape: tuple[int, ...], fov_deg: float | None = None) -> PinholeCamera:
        """The camera of a frame.

        Parameters
        ----------
        frame_shape : tuple of int
            Height and width first.
        fov_deg : float, optional
            Horizontal field of view, above 0 and below 180;
            :data:`ASSUMED_FOV_DEG` along the longer side where it is not given.

        Raises
        ------
        ValueError
            If the field of view is out of range.
        """
        height, width = frame_shape[:2]
        if fov_deg is None:
            side, angle = max(height, width), ASSUMED_FOV_DEG
        else:
            side, angle = width, fov_deg
        if not 0 < angle < 180:
            raise ValueError(f"expected a field of view between 0 and 180 degrees, got {angle}")
        focal = side / 2 / np.tan(np.deg2rad(angle) / 2)
        centre = np.array([width - 1, height - 1]) / 2
        return cls(np.array([focal, focal]), centre, given=fov_deg is not None)

    def centred(self, frame_shape: tuple[int, ...]) -> PinholeCamera:
        """The same camera with its axis through the middle of another frame."""
        height, width = frame_shape[:2]
        return replace(self, centre=np.array([width - 1, height - 1]) / 2)

    @property
    def fov_deg(self) -> float:
        """Horizontal field of view."""
        return float(2 * np.rad2deg(np.arctan((self.centre[0] + 0.5) / self.focal[0])))

    def rays(self, places: NDArray[np.floating]) -> NDArray[np.float64]:
        """Directions ``(..., 3)`` of places ``(..., 2)`` in pixels, of depth 1."""
        aside = (np.asarray(places, np.float64) - self.centre) / self.focal
        return np.concatenate([aside, np.ones((*aside.shape[:-1], 1))], axis=-1)


def to_line_of_sight(rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotations ``(..., 3, 3)`` from camera axes to those of lines of sight ``(..., 3)``.

    They apply as ``line @ camera``, and follow from Rodrigues' formula for the smallest rotation
    that brings z onto the ray.
    """
    x, y, z = np.moveaxis(rays / np.linalg.norm(rays, axis=-1, keepdims=True), -1, 0)
    rest = 1 / (1 + z)
    across = -x * y * rest
    return _matrices((1 - x * x * rest, across, -x), (across, 1 - y * y * rest, -y), (x, y, z))


def _matrices(*rows: Sequence[NDArray[np.float64] | float]) -> NDArray[np.float64]:
    """Matrices ``(..., 3, 3)`` of their elements ``(...)``, in a third of the time of stacking."""
    result = np.empty((*np.shape(rows[0][0]), 3, 3))
    for row, elements in enumerate(rows):
        for column, one in enumerate(elements):
            result[..., row, column] = one
    return result


def roll_rotation(roll_deg: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Rotations ``(..., 3, 3)`` from axes of a line of sight to those of a rolled window."""
    angle = np.deg2rad(np.asarray(roll_deg, np.float64))
    cosine, sine = np.cos(angle), np.sin(angle)
    return _matrices((cosine, sine, 0.0), (-sine, cosine, 0.0), (0.0, 0.0, 1.0))


def window_axes(camera: PinholeCamera, window: PersonWindow) -> NDArray[np.float64]:
    """Rotation ``(3, 3)`` from camera axes to those of a window: z along its line of sight."""
    line = to_line_of_sight(camera.rays(np.array([window.x, window.y])))
    return roll_rotation(window.roll_deg) @ line


@dataclass(frozen=True)
class PlacedBody:
    """Bodies on the lines of sight of their landmarks."""

    points: NDArray[np.float64]  # (..., P, 3): metres from the camera, in its axes
    origin: NDArray[np.float64]  # (..., 3): position of the origin of the depths, likewise


def place_on_sight_lines(
    metres: NDArray[np.float64],
    rays: NDArray[np.float64],
    axes: NDArray[np.float64],
    weights: NDArray[np.float64],
) -> PlacedBody:
    """Place points on the lines of sight of their landmarks.

    The body's size determines how far away it is: the origin is moved so that the points are as
    near to their lines as possible, across the line of sight. Then each point is put onto its line,
    at its depth.

    Parameters
    ----------
    metres : (..., P, 3) float64 array
        Points about any origin, in the axes of a line of sight; their depths are not changed.
    rays : (..., P, 3) float64 array
        Directions of the landmarks, camera axes.
    axes : (..., 3, 3) float64 array
        Camera axes to those of the line of sight.
    weights : (P,) float64 array
        Weight of each point; not negative, not all zero.

    Returns
    -------
    PlacedBody
    """
    lines = rays @ axes.swapaxes(-1, -2)
    lines = lines / np.maximum(lines[..., 2:], 0.05)
    x, y, depths = lines[..., 0], lines[..., 1], metres[..., 2]
    # Least squares for the origin (a, b, c): metres_x + a = x * (metres_z + c), likewise y.
    gap_x, gap_y = x * depths - metres[..., 0], y * depths - metres[..., 1]
    terms = (x, y, x * x + y * y, gap_x, gap_y, x * gap_x + y * gap_y)
    sum_x, sum_y, sum_squares, sum_gap_x, sum_gap_y, sum_gaps = (term @ weights for term in terms)
    total = weights.sum()
    normal = np.zeros((*sum_x.shape, 3, 3))
    normal[..., 0, 0] = normal[..., 1, 1] = total
    normal[..., 0, 2] = normal[..., 2, 0] = -sum_x
    normal[..., 1, 2] = normal[..., 2, 1] = -sum_y
    normal[..., 2, 2] = sum_squares
    right = np.stack([sum_gap_x, sum_gap_y, -sum_gaps], axis=-1)
    origin = np.linalg.solve(normal + 1e-9 * total * np.eye(3), right[..., None])[..., 0]
    origin[..., 2] = np.maximum(origin[..., 2], NEAREST_M - depths.min(axis=-1))
    depths = depths + origin[..., 2:]
    return PlacedBody(lines * depths[..., None] @ axes, (origin[..., None, :] @ axes)[..., 0, :])
