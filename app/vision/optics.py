"""A camera: frames made square and upright, and the lines of sight of its pixels.

Camera axes: x right, y down, z forward. The axes of a line of sight are the camera's, turned by the
smallest rotation that brings z onto the line. The landmark network's metres are in the axes of the
line of sight to the window's middle, up to the window's roll.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import Box, PersonWindow, transform_points
from app.vision.people import Silhouette, silhouette_from_mask

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


Pixels = TypeVar("Pixels", bound=NDArray[Any])


@dataclass(frozen=True)
class Rectification:
    """How a frame was rectified: its pixels made square, then turned clockwise by quarters.

    ``sent`` and ``square`` are height and width of the frame as sent, and with square pixels.
    """

    sent: tuple[int, int]
    square: tuple[int, int]
    quarters: int

    @classmethod
    def of_frame(cls, frame_shape: tuple[int, ...], optics: Optics) -> Rectification:
        """Widen or heighten a frame, so that no detail is lost, and undo the camera's roll.

        Examples
        --------
        >>> Rectification.of_frame((1080, 960), Optics(pixel_aspect=2.0, roll_deg=90)).upright
        (1920, 1080)
        """
        height, width = frame_shape[:2]
        aspect, quarters = optics.pixel_aspect or 1.0, round((optics.roll_deg or 0.0) / 90) % 4
        square = round(height * max(1.0, 1 / aspect)), round(width * max(1.0, aspect))
        return cls((height, width), square, quarters)

    @property
    def upright(self) -> tuple[int, int]:
        """Height and width of the rectified frame."""
        return self.square[::-1] if self.quarters % 2 else self.square

    @property
    def roll_deg(self) -> int:
        """The camera's clockwise rotation, from 0 to 270."""
        return 90 * self.quarters

    @property
    def changes(self) -> bool:
        return self.sent != self.square or self.quarters != 0

    def rectify(self, image: Pixels, interpolation: int = cv2.INTER_LINEAR) -> Pixels:
        """Rectify an image ``(H, W, ...)`` of the frame as sent."""
        if not self.changes:
            return image
        resized = cv2.resize(image, self.square[::-1], interpolation=interpolation)
        return cast(Pixels, _turned(resized, self.quarters))

    def points(self, sent: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points ``(..., 2)`` of the frame as sent, in the rectified one."""
        return transform_points(self._matrix, sent) if self.changes else sent

    def points_sent(self, rectified: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points ``(..., 2)`` of the rectified frame, in the one that was sent."""
        return transform_points(self._matrix_sent, rectified) if self.changes else rectified

    def axes_sent(self, rectified: NDArray[np.float64]) -> NDArray[np.float64]:
        """Vectors ``(..., 3)`` in axes of the upright camera, in those of the real one."""
        across_and_down = rectified[..., :2] @ self._turn
        return np.concatenate([across_and_down, rectified[..., 2:]], axis=-1)

    def boxes(self, sent: Sequence[Box]) -> list[Box]:
        """Boxes of the frame as sent, in the rectified one."""
        return [_about(self.points(_corners(box))) for box in sent] if self.changes else [*sent]

    def box_sent(self, rectified: Box) -> Box:
        """A box of the rectified frame, in the one that was sent."""
        return _about(self.points_sent(_corners(rectified))) if self.changes else rectified

    def camera_sent(self, camera: PinholeCamera) -> PinholeCamera:
        """The camera of the rectified frame, before it was turned upright."""
        return camera.centred(self.square)

    def silhouette_sent(self, silhouette: Silhouette) -> Silhouette | None:
        """A silhouette of the rectified frame, in the one that was sent."""
        turned = _turned(silhouette.mask(self.upright).view(np.uint8), -self.quarters)
        sent = cv2.resize(turned, self.sent[::-1], interpolation=cv2.INTER_NEAREST) > 0
        if not sent.any():
            # The silhouette is narrower than a pixel of the frame as sent.
            column, row = self.points_sent(silhouette.centroid).round().astype(int).tolist()
            sent[min(max(row, 0), self.sent[0] - 1), min(max(column, 0), self.sent[1] - 1)] = True
        return silhouette_from_mask(
            sent, segmenter=silhouette.segmenter, truncated=silhouette.truncated
        )

    @property
    def _turn(self) -> NDArray[np.int64]:
        """Clockwise rotation ``(2, 2)`` from the frame as sent to the rectified one."""
        return np.linalg.matrix_power(np.array([[0, -1], [1, 0]]), self.quarters)

    @cached_property
    def _matrix(self) -> NDArray[np.float64]:
        """Affine transform ``(2, 3)`` from the frame as sent to the rectified one."""
        sent, square, upright = (np.array(s[::-1]) for s in (self.sent, self.square, self.upright))
        linear = self._turn * (square / sent)
        return np.column_stack([linear, (upright - 1) / 2 - linear @ ((sent - 1) / 2)])

    @cached_property
    def _matrix_sent(self) -> NDArray[np.float64]:
        return np.asarray(cv2.invertAffineTransform(self._matrix), np.float64)


_TURNS = (None, cv2.ROTATE_90_CLOCKWISE, cv2.ROTATE_180, cv2.ROTATE_90_COUNTERCLOCKWISE)


def _turned(image: NDArray[Any], quarters: int) -> NDArray[Any]:
    """Turn an image ``(H, W, ...)`` clockwise."""
    turn = _TURNS[quarters % 4]
    return image if turn is None else cv2.rotate(image, turn)


def _corners(box: Box) -> NDArray[np.float64]:
    return np.array([[x, y] for x in (box.x, box.right) for y in (box.y, box.bottom)])


def _about(points: NDArray[np.float64]) -> Box:
    return Box.from_edges(*points.min(axis=0).tolist(), *points.max(axis=0).tolist())
