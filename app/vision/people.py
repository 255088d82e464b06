"""The results of vision for a person: keypoints, landmarks, detections and silhouettes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import Box, PersonWindow

SegmenterName = Literal["network", "background", "mask", "grabcut"]

COCO_NAMES = (
    "nose", "left_eye", "right_eye", "left_ear", "right_ear",
    "left_shoulder", "right_shoulder", "left_elbow", "right_elbow",
    "left_wrist", "right_wrist", "left_hip", "right_hip",
    "left_knee", "right_knee", "left_ankle", "right_ankle",
)  # fmt: skip
"""The 17 COCO keypoints, in their order; left and right are the person's own."""

LANDMARK_NAMES = (
    "nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye",
    "right_eye_outer", "left_ear", "right_ear", "mouth_left", "mouth_right",
    "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
    "left_pinky", "right_pinky", "left_index", "right_index", "left_thumb", "right_thumb",
    "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
    "left_heel", "right_heel", "left_foot_index", "right_foot_index",
)  # fmt: skip
"""The 33 landmarks of BlazePose, in their order; left and right are the person's own."""

COCO_LANDMARKS = [LANDMARK_NAMES.index(name) for name in COCO_NAMES]
"""Row of the landmark for each COCO keypoint."""


def landmark_rows(*parts: str) -> list[int]:
    """Rows of paired landmarks, part by part, left before right.

    Examples
    --------
    >>> landmark_rows("shoulder", "hip")
    [11, 12, 23, 24]
    """
    return [LANDMARK_NAMES.index(f"{side}_{part}") for part in parts for side in ("left", "right")]


def coco_rows(*parts: str) -> list[int]:
    """Rows of the COCO keypoints on both sides whose names end in one of ``parts``."""
    return [row for row, name in enumerate(COCO_NAMES) if name.endswith(parts)]


@dataclass(frozen=True)
class ObservedKeypoints:
    """Where a photograph shows a person's keypoints."""

    positions: NDArray[np.float64]  # (17, 2): pixels, x before y; rows are :data:`COCO_NAMES`
    scores: NDArray[np.float64]  # (17,): confidence of each, 0 to 1

    def __post_init__(self) -> None:
        count = len(COCO_NAMES)
        if self.positions.shape != (count, 2) or self.scores.shape != (count,):
            raise ValueError(
                f"expected positions of shape ({count}, 2) and scores of shape ({count},), "
                f"got {self.positions.shape} and {self.scores.shape}"
            )

    def scaled(self, factor: float) -> ObservedKeypoints:
        return ObservedKeypoints(factor * self.positions + (factor - 1) / 2, self.scores)

    def moved(self, x: float, y: float) -> ObservedKeypoints:
        return ObservedKeypoints(self.positions + np.array([x, y]), self.scores)


NETWORK_DEPTH_SD_M = 0.15
"""Standard deviation of the landmark network's depths."""


@dataclass(frozen=True)
class Landmarks:
    """Where a photograph shows a person's landmarks, and their positions in space."""

    positions: NDArray[np.float64]  # (33, 2): pixels, x before y; rows are :data:`LANDMARK_NAMES`
    # (33,): probability that each is inside the frame and not hidden, 0 to 1.
    visibility: NDArray[np.float64]
    # (33, 3): relative to the middle of the hips, axes of the line of sight to them: x right, y
    # down, z away from the camera.
    metres: NDArray[np.float64]
    # (33, 33): covariance of the errors of the depths, square metres.
    depth_covariance: NDArray[np.float64] = field(
        default_factory=lambda: NETWORK_DEPTH_SD_M**2 * np.eye(len(LANDMARK_NAMES))
    )

    def __post_init__(self) -> None:
        count = len(LANDMARK_NAMES)
        arrays = self.positions, self.visibility, self.metres, self.depth_covariance
        shapes = tuple(array.shape for array in arrays)
        expected = ((count, 2), (count,), (count, 3), (count, count))
        if shapes != expected:
            raise ValueError(f"expected arrays of shapes {expected}, got {shapes}")

    @property
    def depth_sd(self) -> NDArray[np.float64]:
        """Standard deviations ``(33,)`` of the errors of the depths, metres."""
        return np.sqrt(np.diag(self.depth_covariance))

    def box(self) -> Box:
        """The box about all landmarks, visible or not; at least a pixel each way."""
        left, top = self.positions.min(axis=0).tolist()
        width, height = np.maximum(1.0, np.ptp(self.positions, axis=0)).tolist()
        return Box(left, top, width, height)


@dataclass(frozen=True)
class Detection:
    """A person found in a frame."""

    box: Box  # tight around the visible person
    score: float  # probability that the box holds a person, 0 to 1
    # Keypoints in pixels of the frame; None if the detector finds none.
    keypoints: ObservedKeypoints | None = None
    # Windows in which the detector sees the whole body, the likeliest first; may be empty.
    windows: tuple[PersonWindow, ...] = ()

    def __post_init__(self) -> None:
        if not 0 <= self.score <= 1:
            raise ValueError(f"expected a score from 0 to 1, got {self.score}")


@dataclass(frozen=True)
class Silhouette:
    """The pixels of one person, as a crop of the frame."""

    # (h, w): True on the person; each border row and column holds at least one True pixel.
    crop: NDArray[np.bool_]
    # Column and row of the crop's first pixel in the frame.
    left: int
    top: int
    # The source of the silhouette.
    segmenter: SegmenterName
    truncated: bool  # whether the frame's border or another person cuts the body

    def __post_init__(self) -> None:
        if self.crop.ndim != 2 or self.crop.dtype != np.bool_ or self.crop.size == 0:
            raise ValueError(
                "expected a crop of shape (h, w) and dtype bool, "
                f"got {self.crop.shape} and {self.crop.dtype}"
            )
        edges = (self.crop[0], self.crop[-1], self.crop[:, 0], self.crop[:, -1])
        if not all(edge.any() for edge in edges):
            raise ValueError("expected a tight crop, got one with an empty border row or column")
        if self.left < 0 or self.top < 0:
            raise ValueError(f"expected a crop inside the frame, got {self.left}, {self.top}")

    @property
    def area_px(self) -> int:
        return int(np.count_nonzero(self.crop))

    @property
    def centroid(self) -> NDArray[np.float64]:
        """Mean position ``(2,)`` of the pixels on the person, in the frame."""
        moments = cv2.moments(self.crop.view(np.uint8), binaryImage=True)
        first = np.array([self.left, self.top])
        return first + np.array([moments["m10"], moments["m01"]]) / moments["m00"]

    @property
    def box(self) -> Box:
        height, width = self.crop.shape
        return Box(self.left - 0.5, self.top - 0.5, float(width), float(height))

    def outlines(self, method: int) -> Sequence[NDArray[np.int32]]:
        """Outlines ``(P, 1, 2)`` of the parts, frame pixels, by OpenCV's ``CHAIN_APPROX_...``."""
        outlines, _ = cv2.findContours(
            self.crop.astype(np.uint8), cv2.RETR_EXTERNAL, method, offset=(self.left, self.top)
        )
        return cast(Sequence[NDArray[np.int32]], outlines)

    def mask(self, frame_shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """The silhouette as a mask ``(H, W)`` of a frame of this shape, ``(H, W, ...)``."""
        mask = np.zeros(frame_shape[:2], bool)
        self.paint(mask, 1)
        return mask

    def paint(self, image: NDArray[Any], value: int) -> None:
        """Set the pixels of the silhouette in an image ``(H, W)`` of the frame's size."""
        height, width = self.crop.shape
        image[self.top : self.top + height, self.left : self.left + width][self.crop] = value


def silhouette_from_mask(
    mask: NDArray[np.bool_],
    *,
    left: int = 0,
    top: int = 0,
    segmenter: SegmenterName,
    truncated: bool = False,
) -> Silhouette | None:
    """Crop a mask, or the part of one from ``left`` and ``top`` on; None if no pixel is set."""
    x, y, width, height = cv2.boundingRect(np.ascontiguousarray(mask).view(np.uint8))
    if width == 0:
        return None
    crop = mask[y : y + height, x : x + width].copy()
    return Silhouette(crop, left + x, top + y, segmenter, truncated)
