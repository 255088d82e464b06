"""What moves before a fixed camera: a background model that learns from every frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.executor import Map, map_serially
from app.vision.people import Box, Silhouette, silhouette_from_mask
from app.vision.resampling import resize
from app.vision.segmentation.mask_cleaning import fill_small_holes, keep_components

LARGEST_PX = 480_000
"""Larger frames are reduced by a whole factor; street people keep an IoU of 0.84 with the network's
silhouettes at half their size, 0.87 at full size."""

MEMORY_S = 50.0
"""What stays where it is for this long becomes background."""

READY_FRAMES, READY_S = 5, 1.0
"""Frames and seconds before a new model tells what moves."""

MOST_CHANGED = 0.4
"""Where more of the frame changes, the camera shook or the light was switched: it starts anew."""

_SAMPLES = 4  # Seven, OpenCV's default, give the same silhouettes and take 84 bytes a pixel.
_DISTANCE = 400.0  # Squared, in grey levels.
_BYTES_PER_PIXEL = 3 * _SAMPLES * 4 + 6
_FOREGROUND = 255  # Shadows are 127.
# Room about an expected box, as a share of it, in which the person's pixels lie.
_ROOM = 0.15
# A component of which less lies in the room is more than this person ...
_INSIDE = 0.8
# ... one of which this much lies in the room of each of two people may be both of them, ...
_SHARED = 0.35
# ... and either makes the person unclear if it has this share of the foreground in the room.
_FOREIGN = 0.15
# Height and width of a clear person, as ratios to the expected ones.
_HEIGHTS, _WIDTHS = (0.8, 1.25), (0.55, 1.8)
_LEAST_FILL = 0.2


class BackgroundModel:
    """Learns the scene of a fixed camera; one frame at a time.

    OpenCV's nearest-neighbour model: its silhouettes on ``vtest`` overlap with the network's by
    0.87, those of the mixture of Gaussians by 0.84.

    Parameters
    ----------
    map_parts : callable
        Works on the upper and the lower half of a frame; see :class:`app.executor.Map`.
    """

    def __init__(self, map_parts: Map = map_serially) -> None:
        self._map = map_parts
        self._began = self._last = 0.0
        self.memory_bytes = 0
        self._restart()

    def update(self, frame: NDArray[np.uint8], timestamp: float) -> MovingRegions | None:
        """Learn from a frame and return what moves in it.

        Parameters
        ----------
        frame : (H, W, 3) uint8 array
            BGR, of the size of the frames before.
        timestamp : float
            Seconds, later than the last.

        Returns
        -------
        MovingRegions or None
            None while the scene is not known yet, and where most of it has changed.
        """
        factor = reduction(frame.shape)
        height, width = (max(1, side // factor) for side in frame.shape[:2])
        small = resize(frame, width, height)
        elapsed = timestamp - self._last if self._frames else 0.0
        self._began = timestamp if self._frames == 0 else self._began
        self._last = timestamp
        self._frames += 1
        rate = max(1 / (2 * self._frames), min(1.0, elapsed / MEMORY_S))
        halves = zip(self._models, np.array_split(small, len(self._models)), strict=True)
        mask = np.vstack(self._map(lambda half: half[0].apply(half[1], None, rate), halves))
        mask = mask == _FOREGROUND
        self.memory_bytes = _BYTES_PER_PIXEL * mask.size
        if self._frames < READY_FRAMES or timestamp - self._began < READY_S:
            return None
        if mask.mean() > MOST_CHANGED:
            self._restart()
            return None
        return MovingRegions.of(mask, factor, frame.shape)

    def _restart(self) -> None:
        self._models = [cv2.createBackgroundSubtractorKNN(500, _DISTANCE, True) for _ in range(2)]
        for model in self._models:
            model.setNSamples(_SAMPLES)
        self._frames = 0


def reduction(frame_shape: tuple[int, ...]) -> int:
    """Whole factor by which frames are reduced for the background model."""
    height, width = frame_shape[:2]
    factor = 1
    while (height // factor) * (width // factor) > LARGEST_PX:
        factor += 1
    return factor


@dataclass(frozen=True)
class MovingRegions:
    """Connected regions of a frame that differ from the background, shadows left out.

    Parameters
    ----------
    labels : (h, w) int32 array
        Of the reduced frame: 0 background, k = region k.
    boxes : (K + 1, 4) float64 array
        x, y, width and height of each region in pixels of the reduced frame; row 0 is the
        background.
    areas : (K + 1,) int64 array
        Pixels of the reduced frame.
    factor : int
        By which the frame was reduced.
    frame_shape : tuple of int
        Of the whole frame, height and width first.
    """

    labels: NDArray[np.int32]
    boxes: NDArray[np.float64]
    areas: NDArray[np.int64]
    factor: int
    frame_shape: tuple[int, ...]

    @classmethod
    def of(
        cls, mask: NDArray[np.bool_], factor: int, frame_shape: tuple[int, ...]
    ) -> MovingRegions:
        """Find the connected regions of a reduced mask ``(h, w)``."""
        _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.view(np.uint8))
        boxes = stats[:, :4].astype(np.float64)
        boxes[:, :2] -= 0.5
        areas = stats[:, cv2.CC_STAT_AREA].astype(np.int64)
        return cls(labels.astype(np.int32, copy=False), boxes, areas, factor, frame_shape)

    def silhouettes(self, expected: Sequence[Box]) -> list[Silhouette | None]:
        """Cut out the people expected in boxes, each of whom must be clear of the others.

        Parameters
        ----------
        expected : sequence of Box
            Pixels of the frame; of all people known, so that nobody gets another's region.

        Returns
        -------
        list of Silhouette or None
            None where the regions are shared, reach beyond the person, or have another size.
        """
        inside = np.array([self._pixels_in(box) for box in expected], np.int64)
        inside = inside.reshape(len(expected), len(self.areas))
        # Whose box holds most of a region, nobody else's a good part of it, owns it.
        held = inside >= _INSIDE * self.areas
        shared = (inside >= _SHARED * self.areas).sum(axis=0) > 1
        owned = held.any(axis=0) & ~shared
        found: list[Silhouette | None] = []
        for box, pixels, own in zip(expected, inside, held, strict=True):
            about = np.where(owned & ~own, 0, pixels)
            matters = (about > 0) & (about >= _FOREIGN * about.sum())
            clear = matters.any() and not (matters & (shared | ~own)).any()
            found.append(self._cut(box, own & ~shared) if clear else None)
        return found

    def moving_share(self, box: Box) -> float:
        """Share of a box that moves, 0 to 1."""
        rows, columns = self._window(box, 0.0)
        part = self.labels[rows, columns]
        return float((part > 0).mean()) if part.size else 0.0

    def unexplained(self, known: Sequence[Box], least_height: float) -> list[Box]:
        """Boxes of regions at least ``least_height`` high that lie outside all known people.

        Parameters
        ----------
        known : sequence of Box
        least_height : float
            Pixels of the frame. Regions above one another within a sixth of it are joined.

        Returns
        -------
        list of Box
            Pixels of the frame, the largest first.
        """
        free = self.labels > 0
        for box in known:
            rows, columns = self._window(box, _ROOM)
            free[rows, columns] = False
        if np.count_nonzero(free) < 0.1 * (least_height / self.factor) ** 2:
            return []
        reach = max(1, round(least_height / (6 * self.factor)))
        kernel: NDArray[np.uint8] = np.ones((reach, 3), np.uint8)
        joined = cv2.morphologyEx(free.view(np.uint8), cv2.MORPH_CLOSE, kernel)
        _, _, stats, _ = cv2.connectedComponentsWithStats(joined)
        tall = stats[1:][stats[1:, cv2.CC_STAT_HEIGHT] * self.factor >= least_height]
        tall = tall[np.argsort(-tall[:, cv2.CC_STAT_AREA], kind="stable")]
        return [Box(*(self.factor * np.array(row[:4]) - [0.5, 0.5, 0, 0]).tolist()) for row in tall]

    def _pixels_in(self, box: Box) -> NDArray[np.int64]:
        """Pixels ``(K + 1,)`` of each region that lie in a box with some room about it."""
        rows, columns = self._window(box, _ROOM)
        counts = np.bincount(self.labels[rows, columns].ravel(), minlength=len(self.areas))
        counts[0] = 0
        return counts

    def _cut(self, box: Box, regions: NDArray[np.bool_]) -> Silhouette | None:
        """The silhouette of one person's regions; None unless it is the size of the box."""
        rows, columns = self._window(box, _ROOM)
        mask = regions[self.labels[rows, columns]]
        mask = fill_small_holes(keep_components(mask, 0.1), 0.05)
        height, width = self.frame_shape[:2]
        top, left = rows.start * self.factor, columns.start * self.factor
        if self.factor > 1:
            size = mask.shape[1] * self.factor, mask.shape[0] * self.factor
            mask = cv2.resize(255 * mask.view(np.uint8), size) > 127
            mask = mask[: height - top, : width - left]
        silhouette = silhouette_from_mask(
            mask, left=left, top=top, segmenter="background", truncated=False
        )
        if silhouette is None:
            return None
        rows_ratio = silhouette.box.height / box.height
        columns_ratio = silhouette.box.width / box.width
        solid = silhouette.area_px >= _LEAST_FILL * silhouette.box.area
        alike = _HEIGHTS[0] <= rows_ratio <= _HEIGHTS[1] and (
            _WIDTHS[0] <= columns_ratio <= _WIDTHS[1]
        )
        return silhouette if solid and alike else None

    def _window(self, box: Box, room: float) -> tuple[slice, slice]:
        """Rows and columns of the reduced frame about a box."""
        height, width = self.labels.shape
        aside, above = room * box.width, room * box.height
        left, top = (box.x - aside + 0.5) / self.factor, (box.y - above + 0.5) / self.factor
        right = (box.right + aside + 0.5) / self.factor
        bottom = (box.bottom + above + 0.5) / self.factor
        return (
            slice(min(height, max(0, round(top))), max(0, min(height, round(bottom)))),
            slice(min(width, max(0, round(left))), max(0, min(width, round(right)))),
        )
