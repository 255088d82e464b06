"""What vision finds: boxes, detections and silhouettes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

SegmenterName = Literal["network", "background", "mask"]

COCO_NAMES = (
    "nose", "left_eye", "right_eye", "left_ear", "right_ear",
    "left_shoulder", "right_shoulder", "left_elbow", "right_elbow",
    "left_wrist", "right_wrist", "left_hip", "right_hip",
    "left_knee", "right_knee", "left_ankle", "right_ankle",
)  # fmt: skip
"""The 17 COCO keypoints, in their order; left and right are the person's own."""


@dataclass(frozen=True)
class Box:
    """An upright rectangle in pixels.

    The origin lies at the centre of the top-left pixel, so the box of that single pixel is
    ``Box(-0.5, -0.5, 1, 1)``.

    Parameters
    ----------
    x, y : float
        Left and top edge.
    width, height : float
        Positive.
    """

    x: float
    y: float
    width: float
    height: float

    def __post_init__(self) -> None:
        finite = np.isfinite([self.x, self.y, self.width, self.height]).all()
        if not (finite and self.width > 0 and self.height > 0):
            raise ValueError(f"expected a box of positive finite size, got {self}")

    @property
    def right(self) -> float:
        """Right edge, in pixels."""
        return self.x + self.width

    @property
    def bottom(self) -> float:
        """Bottom edge, in pixels."""
        return self.y + self.height

    @property
    def area(self) -> float:
        """Width times height, in square pixels."""
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

    def iou(self, other: Box) -> float:
        """Intersection over union with another box, 0 to 1."""
        shared = self.intersection(other)
        return shared / (self.area + other.area - shared)

    def clip(self, width: int, height: int) -> Box | None:
        """Return the part inside a frame of ``width`` x ``height`` pixels, None if there is none.

        The frame's own box is ``Box(-0.5, -0.5, width, height)``.
        """
        left, top = max(self.x, -0.5), max(self.y, -0.5)
        right, bottom = min(self.right, width - 0.5), min(self.bottom, height - 0.5)
        if right <= left or bottom <= top:
            return None
        return Box(left, top, right - left, bottom - top)

    def scaled(self, factor: float) -> Box:
        """Return the same box in a frame resized by ``factor``."""
        x, y = (self.x + 0.5) * factor - 0.5, (self.y + 0.5) * factor - 0.5
        return Box(x, y, self.width * factor, self.height * factor)

    def pixels(self) -> tuple[int, int, int, int]:
        """Return the whole pixels nearest the edges: first column and row, then one past the last.

        At least one pixel each way; they may lie outside the frame.
        """
        left, top = round(self.x + 0.5), round(self.y + 0.5)
        return (
            left,
            top,
            max(left + 1, round(self.right + 0.5)),
            max(top + 1, round(self.bottom + 0.5)),
        )


@dataclass(frozen=True)
class ObservedKeypoints:
    """Where a photograph shows a person's keypoints.

    Parameters
    ----------
    positions : (17, 2) float64 array
        Pixels, x before y; rows are :data:`COCO_NAMES`.
    scores : (17,) float64 array
        Confidence of each, 0 to 1.
    """

    positions: NDArray[np.float64]
    scores: NDArray[np.float64]

    def __post_init__(self) -> None:
        count = len(COCO_NAMES)
        if self.positions.shape != (count, 2) or self.scores.shape != (count,):
            raise ValueError(
                f"expected positions of shape ({count}, 2) and scores of shape ({count},), "
                f"got {self.positions.shape} and {self.scores.shape}"
            )

    def scaled(self, factor: float) -> ObservedKeypoints:
        """Return the same keypoints in a picture resized by ``factor``."""
        return ObservedKeypoints((self.positions + 0.5) * factor - 0.5, self.scores)

    def moved(self, x: float, y: float) -> ObservedKeypoints:
        """Return the same keypoints farther right and down."""
        return ObservedKeypoints(self.positions + np.array([x, y]), self.scores)


LANDMARK_NAMES = (
    "nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye",
    "right_eye_outer", "left_ear", "right_ear", "mouth_left", "mouth_right",
    "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
    "left_pinky", "right_pinky", "left_index", "right_index", "left_thumb", "right_thumb",
    "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
    "left_heel", "right_heel", "left_foot_index", "right_foot_index",
)  # fmt: skip
"""The 33 landmarks of BlazePose, in their order; left and right are the person's own."""

COCO_ROWS = [LANDMARK_NAMES.index(name) for name in COCO_NAMES]


@dataclass(frozen=True)
class Landmarks:
    """Where a photograph shows a person's landmarks, and how far away they are.

    Parameters
    ----------
    positions : (33, 2) float64 array
        Pixels, x before y; rows are :data:`LANDMARK_NAMES`.
    visibility : (33,) float64 array
        Probability that each is inside the frame and not hidden, 0 to 1.
    metres : (33, 3) float64 array
        About the middle of the hips, axes of the camera: x right, y down, z forward.
    """

    positions: NDArray[np.float64]
    visibility: NDArray[np.float64]
    metres: NDArray[np.float64]

    def __post_init__(self) -> None:
        count = len(LANDMARK_NAMES)
        shapes = (self.positions.shape, self.visibility.shape, self.metres.shape)
        expected = ((count, 2), (count,), (count, 3))
        if shapes != expected:
            raise ValueError(f"expected arrays of shapes {expected}, got {shapes}")

    def box(self) -> Box:
        """The box about all landmarks, seen or not."""
        (left, top), (right, bottom) = self.positions.min(axis=0), self.positions.max(axis=0)
        return Box(
            float(left), float(top), max(1.0, float(right - left)), max(1.0, float(bottom - top))
        )

    def keypoints(self) -> ObservedKeypoints:
        """The 17 of COCO among them."""
        return ObservedKeypoints(self.positions[COCO_ROWS], self.visibility[COCO_ROWS])


@dataclass(frozen=True)
class PersonWindow:
    """A square of a frame about a person, turned so that the trunk stands.

    Parameters
    ----------
    x, y : float
        Centre, in pixels of the frame.
    side : float
        Positive, in pixels of the frame.
    roll_deg : float
        Clockwise rotation of the square in the frame: the direction in which the person's head
        is, 0 where it is up, 90 where it is on the right.
    """

    x: float
    y: float
    side: float
    roll_deg: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite([self.x, self.y, self.side, self.roll_deg]).all() and self.side > 0):
            raise ValueError(f"expected a window of positive finite size, got {self}")


@dataclass(frozen=True)
class Detection:
    """A person found in a frame.

    Parameters
    ----------
    box : Box
        Tight around the visible person.
    score : float
        Probability that the box holds a person, 0 to 1.
    keypoints : ObservedKeypoints or None
        In pixels of the frame; None where the detector reads none.
    windows : tuple of PersonWindow
        Where the detector sees the whole body, the likeliest first; may be empty.
    """

    box: Box
    score: float
    keypoints: ObservedKeypoints | None = None
    windows: tuple[PersonWindow, ...] = ()

    def __post_init__(self) -> None:
        if not 0 <= self.score <= 1:
            raise ValueError(f"expected a score from 0 to 1, got {self.score}")


@dataclass(frozen=True)
class Silhouette:
    """The pixels of one person, as a crop of the frame.

    Parameters
    ----------
    crop : (h, w) bool array
        True on the person; its border rows and columns all hold at least one True pixel.
    left, top : int
        Column and row of the crop's first pixel in the frame.
    segmenter : str
        What made it: ``network``, ``background`` or ``mask``.
    truncated : bool
        Whether the frame's border or another person cuts the body.
    """

    crop: NDArray[np.bool_]
    left: int
    top: int
    segmenter: SegmenterName
    truncated: bool

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
        """Number of pixels on the person."""
        return int(np.count_nonzero(self.crop))

    @property
    def centroid(self) -> NDArray[np.float64]:
        """Mean place ``(2,)`` of the pixels on the person, in the frame."""
        moments = cv2.moments(self.crop.view(np.uint8), binaryImage=True)
        first = np.array([self.left, self.top])
        return np.asarray(first + np.array([moments["m10"], moments["m01"]]) / moments["m00"])

    @property
    def box(self) -> Box:
        """The tight box around the silhouette."""
        height, width = self.crop.shape
        return Box(self.left - 0.5, self.top - 0.5, float(width), float(height))

    def mask(self, frame_shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """Paste the crop into an empty mask of the frame's size.

        Parameters
        ----------
        frame_shape : tuple of int
            Height and width first, as ``frame.shape``.

        Returns
        -------
        (H, W) bool array
        """
        mask = np.zeros(frame_shape[:2], bool)
        height, width = self.crop.shape
        mask[self.top : self.top + height, self.left : self.left + width] = self.crop
        return mask


def silhouette_from_mask(
    mask: NDArray[np.bool_],
    *,
    left: int = 0,
    top: int = 0,
    segmenter: SegmenterName,
    truncated: bool,
) -> Silhouette | None:
    """Cut a mask, or a part of one that starts at ``left``, ``top``, to its tight crop.

    None if no pixel is set.
    """
    x, y, width, height = cv2.boundingRect(np.ascontiguousarray(mask).view(np.uint8))
    if width == 0:
        return None
    crop = mask[y : y + height, x : x + width].copy()
    return Silhouette(crop, left + x, top + y, segmenter, truncated)
