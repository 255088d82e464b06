"""Training samples: what the facing reader sees of simulated scenes, and what there is to know."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.vision.facing_evidence import (
    CHANNELS,
    LEAST_PX,
    SIZE,
    facing_input,
    head_window,
    person_window,
)
from app.vision.joints import READ_ROWS
from app.vision.resampling import cut, resize
from app.vision.segment import Segmenter
from scripts.refinement.scenes import Scene, counted


@dataclass(frozen=True)
class Samples:
    """What is learnt from.

    Parameters
    ----------
    seen : (N, 8, 64, 64) uint8 array
        What the network is shown, with the silhouette that the service finds.
    covers : (N, 2, 64, 64) uint8 array
        The true silhouettes in both windows, 255 where sure.
    points : (N, 16, 2) float32 array
        The points that the joint reader reads, in pixels of the second window; they may lie
        outside.
    azimuth_deg : (N,) float32 array
    """

    seen: NDArray[np.uint8]
    covers: NDArray[np.uint8]
    points: NDArray[np.float32]
    azimuth_deg: NDArray[np.float32]


def samples_of(
    scene: Scene, segmenter: Segmenter
) -> Iterator[tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.float32], float]]:
    """Yield input, true silhouettes, points and azimuth of everybody whom the service sees."""
    silhouettes = segmenter.segment(scene.frame, scene.boxes)
    for number, silhouette in enumerate(silhouettes):
        if silhouette is None or len(silhouette.crop) < LEAST_PX:
            continue
        windows = (head_window(silhouette), person_window(silhouette))
        covers = [resize(cut(scene.covers[number], window), SIZE, SIZE) for window in windows]
        left, top, width, height = windows[1]
        scale = SIZE / np.array([width, height])
        points = (scene.points[number][list(READ_ROWS)] + 0.5 - (left, top)) * scale - 0.5
        yield (
            facing_input(scene.frame, silhouette),
            np.rint(255 * np.stack(covers)).astype(np.uint8),
            points.astype(np.float32),
            float(scene.azimuth_deg[number]),
        )


def make_samples(scenes: Iterable[Scene], segmenter: Segmenter, count: int) -> Samples:
    """Make ``count`` samples of scenes."""
    samples = Samples(
        np.empty((count, CHANNELS, SIZE, SIZE), np.uint8),
        np.empty((count, 2, SIZE, SIZE), np.uint8),
        np.empty((count, len(READ_ROWS), 2), np.float32),
        np.empty(count, np.float32),
    )
    found = (one for scene in scenes for one in samples_of(scene, segmenter))
    for row, (seen, covers, points, azimuth_deg) in enumerate(counted(found, count)):
        samples.seen[row], samples.covers[row] = seen, covers
        samples.points[row], samples.azimuth_deg[row] = points, azimuth_deg
    return samples
