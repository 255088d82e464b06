"""Rectification of frames before all other steps: square pixels, and an upright camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import Box, transform_points
from app.vision.optics import Optics, PinholeCamera
from app.vision.people import Silhouette, silhouette_from_mask

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
