"""Training samples: what the joint reader sees of simulated scenes, and where the joints are."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.vision.joints import CHANNELS, COLUMNS, READ_ROWS, ROWS, joints_input, joints_window
from app.vision.resampling import cut, resize
from app.vision.segment import Segmenter
from scripts.refinement.scenes import Scene, counted


@dataclass(frozen=True)
class Samples:
    """What is learnt from.

    Parameters
    ----------
    seen : (N, 4, 144, 96) uint8 array
        What the network is shown, with the silhouette that the service finds.
    covers : (N, 144, 96) uint8 array
        The true silhouettes, 255 where sure.
    points : (N, 16, 2) float32 array
        The points to be read, in pixels of the window; they may lie outside.
    """

    seen: NDArray[np.uint8]
    covers: NDArray[np.uint8]
    points: NDArray[np.float32]


def samples_of(
    scene: Scene, segmenter: Segmenter
) -> Iterator[tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.float32]]]:
    """Yield input, true silhouette and points of everybody in a scene whom the service sees."""
    silhouettes = segmenter.segment(scene.frame, scene.boxes)
    for silhouette, cover, points in zip(silhouettes, scene.covers, scene.points, strict=True):
        if silhouette is None:
            continue
        window = joints_window(silhouette.box)
        true = resize(cut(cover, window), COLUMNS, ROWS)
        left, top, width, height = window
        scale = np.array([COLUMNS / width, ROWS / height])
        places = (points[list(READ_ROWS)] + 0.5 - (left, top)) * scale - 0.5
        yield (
            joints_input(scene.frame, silhouette, window),
            np.rint(255 * true).astype(np.uint8),
            places.astype(np.float32),
        )


def make_samples(scenes: Iterable[Scene], segmenter: Segmenter, count: int) -> Samples:
    """Make ``count`` samples of scenes."""
    seen = np.empty((count, CHANNELS, ROWS, COLUMNS), np.uint8)
    covers = np.empty((count, ROWS, COLUMNS), np.uint8)
    points = np.empty((count, len(READ_ROWS), 2), np.float32)
    found = (one for scene in scenes for one in samples_of(scene, segmenter))
    for row, one in enumerate(counted(found, count)):
        seen[row], covers[row], points[row] = one
    return Samples(seen, covers, points)
