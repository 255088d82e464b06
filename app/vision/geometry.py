"""Boxes, the rotated windows in which landmarks are read, and the pixels of both."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.halved import Frame, seen_at

Boxes = NDArray[np.float64]
"""Array of boxes ``(N, 4)``: x, y, width, height."""


@dataclass(frozen=True)
class Box:
    """An upright rectangle in pixels.

    The origin is the centre of the top-left pixel, whose own box is ``Box(-0.5, -0.5, 1, 1)``.
    """

    # Left and top edge.
    x: float
    y: float
    # Both positive.
    width: float
    height: float

    def __post_init__(self) -> None:
        finite = np.isfinite([self.x, self.y, self.width, self.height]).all()
        if not (finite and self.width > 0 and self.height > 0):
            raise ValueError(f"expected a box of positive finite size, got {self}")

    @classmethod
    def from_edges(cls, left: float, top: float, right: float, bottom: float) -> Box:
        return cls(left, top, right - left, bottom - top)

    @property
    def right(self) -> float:
        return self.x + self.width

    @property
    def bottom(self) -> float:
        return self.y + self.height

    @property
    def area(self) -> float:
        return self.width * self.height

    @property
    def foot(self) -> NDArray[np.float64]:
        """Middle of the lower edge ``(2,)``, where a person stands."""
        return np.array([self.x + self.width / 2, self.bottom])

    def intersection(self, other: Box) -> float:
        """Area shared with another box, in square pixels."""
        width = min(self.right, other.right) - max(self.x, other.x)
        height = min(self.bottom, other.bottom) - max(self.y, other.y)
        return max(0.0, width) * max(0.0, height)

    def joined(self, other: Box) -> Box:
        return Box.from_edges(
            min(self.x, other.x), min(self.y, other.y),
            max(self.right, other.right), max(self.bottom, other.bottom),
        )  # fmt: skip

    def grown(self, margin: float) -> Box:
        """The box with a margin on every side, a share of its longer side."""
        reach = margin * max(self.width, self.height)
        return Box(self.x - reach, self.y - reach, self.width + 2 * reach, self.height + 2 * reach)

    def iou(self, other: Box) -> float:
        """Intersection over union with another box, 0 to 1."""
        shared = self.intersection(other)
        return shared / (self.area + other.area - shared)

    def clip(self, width: int, height: int) -> Box | None:
        """The part inside a frame of ``width`` x ``height`` pixels; None if there is none."""
        left, top = max(self.x, -0.5), max(self.y, -0.5)
        right, bottom = min(self.right, width - 0.5), min(self.bottom, height - 0.5)
        if right <= left or bottom <= top:
            return None
        return Box.from_edges(left, top, right, bottom)

    def scaled(self, factor: float) -> Box:
        """The same box in a frame resized by ``factor``."""
        x, y = (factor * at + (factor - 1) / 2 for at in (self.x, self.y))  # Exact for 1.
        return Box(x, y, self.width * factor, self.height * factor)

    def pixels(self) -> tuple[int, int, int, int]:
        """First column and row, then one past the last, nearest the edges; one at least."""
        left, top = round(self.x + 0.5), round(self.y + 0.5)
        right, bottom = round(self.right + 0.5), round(self.bottom + 0.5)
        return left, top, max(left + 1, right), max(top + 1, bottom)


def iou_matrix(first: Boxes, second: Boxes) -> NDArray[np.float64]:
    """Intersection over union ``(N, M)`` of every pair of boxes ``(N, 4)`` and ``(M, 4)``."""
    low = np.maximum(first[:, None, :2], second[None, :, :2])
    high = np.minimum(
        first[:, None, :2] + first[:, None, 2:], second[None, :, :2] + second[None, :, 2:]
    )
    shared = np.clip(high - low, 0, None).prod(axis=2)
    areas = (first[:, 2] * first[:, 3])[:, None] + (second[:, 2] * second[:, 3])[None, :]
    return shared / (areas - shared)


def non_max_suppression(boxes: Boxes, scores: NDArray[np.float64], max_iou: float) -> list[int]:
    """Rows of boxes ``(N, 4)`` that are kept, best first: the best of overlapping ones.

    ``max_iou`` is the intersection over union from which the box of the lower score ``(N,)`` is
    dropped. Unlike OpenCV's function, this one keeps the first of boxes with equal scores.
    """
    overlaps = iou_matrix(boxes, boxes)
    is_open = np.ones(len(boxes), bool)
    kept = []
    for row in np.argsort(-scores, kind="stable"):
        if is_open[row]:
            kept.append(int(row))
            is_open &= overlaps[row] < max_iou
    return kept


WINDOW_SCALE = 1.25
"""Side of a person's window relative to the circle about the body or the longer side of its box, as
BlazePose was trained."""

_MIN_RADIUS_PX = 1e-3


@dataclass(frozen=True)
class PersonWindow:
    """A square part of a frame about a person, rotated so that the trunk is upright in it."""

    # Centre, in pixels of the frame.
    x: float
    y: float
    side: float  # positive, in pixels of the frame
    roll_deg: float = 0.0  # direction of the head in the frame, clockwise: 0 is up, 90 right

    def __post_init__(self) -> None:
        if not (np.isfinite([self.x, self.y, self.side, self.roll_deg]).all() and self.side > 0):
            raise ValueError(f"expected a window of positive finite size, got {self}")

    @classmethod
    def about_box(cls, box: Box, roll_deg: float = 0.0) -> PersonWindow:
        side = WINDOW_SCALE * max(box.width, box.height)
        return cls(box.x + box.width / 2, box.y + box.height / 2, side, roll_deg)

    @classmethod
    def about_circle(cls, centre: NDArray[np.floating], top: NDArray[np.floating]) -> PersonWindow:
        """Make the window about the circle around a body.

        Both points ``(2,)``, in pixels of the frame: the middle of the hips, and the point of the
        circle in the direction of the head.
        """
        right, down = (np.asarray(top, np.float64) - centre).tolist()
        radius = max(math.hypot(right, down), _MIN_RADIUS_PX)
        roll_deg = math.degrees(math.atan2(right, -down))
        return cls(float(centre[0]), float(centre[1]), 2 * WINDOW_SCALE * radius, roll_deg)

    @property
    def body_px(self) -> float:
        """Size of the body, the radius of its circle, in pixels of the frame."""
        return self.side / (2 * WINDOW_SCALE)

    def circle_box(self) -> Box:
        """The upright box about the circle around the body."""
        radius = self.body_px
        return Box(self.x - radius, self.y - radius, 2 * radius, 2 * radius)

    def to_frame(self, pixels: int) -> NDArray[np.float64]:
        """Affine transform ``(2, 3)`` to the frame from the window at ``pixels`` a side."""
        angle = math.radians(self.roll_deg)
        scale = self.side / pixels
        cosine, sine = scale * math.cos(angle), scale * math.sin(angle)
        linear = np.array([[cosine, -sine], [sine, cosine]])
        middle = (pixels - 1) / 2
        offset = np.array([self.x, self.y]) - linear @ np.array([middle, middle])
        return np.column_stack([linear, offset])

    def corners(self) -> NDArray[np.float64]:
        """Corners ``(4, 2)`` in the frame, clockwise from the top left one of the window."""
        corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * 2 - 0.5
        return transform_points(self.to_frame(2), corners)

    def scaled(self, factor: float) -> PersonWindow:
        x, y = (factor * at + (factor - 1) / 2 for at in (self.x, self.y))
        return PersonWindow(x, y, self.side * factor, self.roll_deg)

    def on_grid(self) -> PersonWindow:
        """The nearest window on a grid of 1/64 of a pixel and of a degree.

        Windows that differ only in the last digits, between processors, are then the same.
        """
        x, y, roll_deg = (round(64 * value) / 64 for value in (self.x, self.y, self.roll_deg))
        return PersonWindow(x, y, max(1, round(64 * self.side)) / 64, roll_deg)


def transform_points(
    matrix: NDArray[np.float64], points: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Points ``(..., 2)``, x before y, after an affine transform ``(2, 3)``."""
    return points @ matrix[:, :2].T + matrix[:, 2]


def sample_window(frame: Frame, window: PersonWindow, pixels: int) -> NDArray[np.uint8]:
    """Sample a window of a frame as ``(pixels, pixels, 3)``; beyond the frame it is black."""
    frame, scale = seen_at(frame, pixels / window.side)
    window = window.scaled(scale)
    size = np.array([frame.shape[1], frame.shape[0]])
    centre = np.array([window.x, window.y])
    # Only the part about the window is averaged.
    reach = window.side * math.sqrt(0.5) + 1
    low = np.clip(centre - reach, 0, size).astype(int)
    high = np.clip(centre + reach + 2, 0, size).astype(int)
    if (high <= low).any():
        return np.zeros((pixels, pixels, 3), np.uint8)
    part = frame[low[1] : high[1], low[0] : high[0]]
    matrix = window.to_frame(pixels)
    matrix[:, 2] -= low
    covered = window.side / pixels
    # A frame is halved until a pixel of a window covers fewer of its pixels than this each way.
    while covered >= 2.25:
        # Means of two by two pixels take a fifth of the time of others.
        sides = np.array(part.shape[1::-1])
        factors = np.minimum(2, sides)
        halves = sides // factors
        width, height = (factors * halves).tolist()
        part = resize(part[:height, :width], *halves.tolist())
        # The matrix now leads to pixels of the averaged part, with the origin at the centre of the
        # first one.
        matrix /= factors[:, None]
        matrix[:, 2] += 0.5 / factors - 0.5
        covered /= 2
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(part, matrix, (pixels, pixels), flags=flags), np.uint8)


PixelRect = tuple[int, int, int, int]
"""First column and row, width and height in whole pixels; may reach beyond the image."""


def crop(image: NDArray[np.uint8], rect: PixelRect) -> NDArray[np.uint8]:
    """Crop an image ``(H, W)`` or ``(H, W, C)``; pixels beyond it are zero. A view if none are."""
    left, top, width, height = rect
    rows, columns = image.shape[:2]
    inside = image[
        min(max(top, 0), rows) : max(0, min(top + height, rows)),
        min(max(left, 0), columns) : max(0, min(left + width, columns)),
    ]
    if inside.shape[:2] == (height, width):
        return inside
    result = np.zeros((height, width, *image.shape[2:]), image.dtype)
    y, x = max(-top, 0), max(-left, 0)
    result[y : y + inside.shape[0], x : x + inside.shape[1]] = inside
    return result


def crop_and_resize(
    image: NDArray[np.uint8], rect: PixelRect, width: int, height: int, max_crop_px: int = 2**22
) -> NDArray[np.uint8]:
    """Crop an image as :func:`crop` does and resize the crop to ``width`` x ``height``.

    A rectangle with a person's proportions about a flat box may be many times as large as the
    image. If it has more than ``max_crop_px`` pixels, only the part inside the image is resized, to
    a pixel.
    """
    left, top, columns, rows = rect
    if columns * rows <= max_crop_px:
        return resize(crop(image, rect), width, height)
    result = np.zeros((height, width, *image.shape[2:]), image.dtype)
    x0, x1 = (min(max(x, 0), image.shape[1]) for x in (left, left + columns))
    y0, y1 = (min(max(y, 0), image.shape[0]) for y in (top, top + rows))
    first, last = (round((x - left) * width / columns) for x in (x0, x1))
    upper, lower = (round((y - top) * height / rows) for y in (y0, y1))
    if last > first and lower > upper:
        inside = image[y0:y1, x0:x1]
        result[upper:lower, first:last] = resize(inside, last - first, lower - upper)
    return result


def resize(image: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """Resize an image, by means over areas where it shrinks and bilinearly where it grows."""
    rows, columns = image.shape[:2]
    shrinks = width < columns or height < rows
    kind = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return cv2.resize(image, (width, height), interpolation=kind).astype(np.uint8, copy=False)


def shrink_quickly(image: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """Resize an image bilinearly, by halves first where it shrinks.

    For whole frames, this takes a tenth of the time of means over areas, and detections are equally
    good. Readings of one person, above all the landmarks, are a little worse.
    """
    while (size := image.shape[1::-1]) != (width, height):
        step = tuple(
            max(wanted, now // 2) for now, wanted in zip(size, (width, height), strict=True)
        )
        image = cv2.resize(image, step, interpolation=cv2.INTER_LINEAR).astype(np.uint8, copy=False)
    return image
