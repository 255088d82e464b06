"""Train the network that reads joints, on simulated people only.

    python -m scripts.refinement.backgrounds /tmp/backgrounds
    python -m scripts.joints.train --backgrounds /tmp/backgrounds

writes ``app/vision/joints.onnx`` in about five hours on one core. It needs the extras
build and train, and the segmentation networks (``scripts/fetch_models.py``). No photograph of
``../shared/real`` is seen but the empty street of ``vtest``.
"""

from __future__ import annotations

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from app.vision.joints import CELL, CHANNELS, COLUMNS, OTHER_SIDE, ROWS, WEIGHTS_PATH
from app.vision.networks import Networks
from app.vision.segment import make_segmenter
from scripts.joints.model import JointReader
from scripts.joints.samples import Samples, make_samples
from scripts.refinement.backgrounds import read_backgrounds
from scripts.refinement.lessons import BATCH, descend, read_options
from scripts.refinement.model import export
from scripts.refinement.samples import spoil
from scripts.refinement.scenes import make_scenes
from scripts.refinement.sprites import Casting

LESSONS = ((7500, 3e-3), (8000, 2e-3), (16000, 2e-3), (14000, 2e-3))
"""Batches, and the largest learning rate, which rises and falls once in each."""

TRUE_SHARE = 0.6
"""How often the silhouette shown is the true one, spoilt, for real ones are better than those of
simulated people."""

TURN_DEG, SCALE, SHIFT = 12.0, 0.1, 0.04
"""Standard deviations of what a window is turned, enlarged (logarithm) and moved (of its height)
by."""

SPREAD_CELLS = 0.8
"""How far about its place a point counts as found."""


def vary(
    samples: Samples, row: int, generator: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """One sample, varied: input ``(4, 144, 96)`` in 0..1 and points ``(16, 2)``."""
    planes = samples.seen[row].copy()
    if generator.random() < TRUE_SHARE:
        planes[3] = spoil(samples.covers[row], generator, generator.uniform(0, 0.6))
        planes[3] = np.where(planes[3] > 127, np.uint8(255), np.uint8(0))
    angle, scale = generator.normal(0, TURN_DEG), np.exp(generator.normal(0, SCALE))
    middle = ((COLUMNS - 1) / 2, (ROWS - 1) / 2)
    matrix = np.array(cv2.getRotationMatrix2D(middle, angle, scale), np.float64)
    matrix[:, 2] += generator.normal(0, SHIFT * ROWS, 2)
    stacked = np.ascontiguousarray(planes.transpose(1, 2, 0))
    moved = cv2.warpAffine(stacked, matrix, (COLUMNS, ROWS), flags=cv2.INTER_LINEAR)
    points: NDArray[np.floating] = samples.points[row] @ matrix[:, :2].T + matrix[:, 2]
    seen: NDArray[np.float32] = moved.transpose(2, 0, 1).astype(np.float32) / np.float32(255)
    gain = np.exp(generator.normal(0, 0.12, 3) + generator.normal(0, 0.2))
    seen[:3] *= gain.astype(np.float32)[:, None, None]
    seen[:3] += np.float32(generator.normal(0, 0.06))
    if generator.random() < 0.15:
        seen[:3] = seen[:3].mean(axis=0)
    np.clip(seen[:3], 0, 1, out=seen[:3])
    if generator.random() < 0.5:
        seen = seen[..., ::-1]
        points = points[OTHER_SIDE] * (-1, 1) + (COLUMNS - 1, 0)
    return seen, points.astype(np.float32)


def maps_of(points: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Points ``(N, P, 2)`` in pixels to wanted maps ``(N, P, 36, 24)``, and which lie inside."""
    cells = (points + 0.5) / CELL - 0.5
    x = np.exp(-((cells[..., :1] - np.arange(COLUMNS // CELL)) ** 2) / (2 * SPREAD_CELLS**2))
    y = np.exp(-((cells[..., 1:] - np.arange(ROWS // CELL)) ** 2) / (2 * SPREAD_CELLS**2))
    maps = y[..., :, None] * x[..., None, :]
    inside = np.asarray(((points >= 0) & (points <= (COLUMNS - 1, ROWS - 1))).all(axis=-1))
    sums = np.maximum(maps.sum(axis=(2, 3), keepdims=True), 1e-9)
    return (maps / sums).astype(np.float32), inside


def loss_of(odds: Tensor, wanted: Tensor, inside: Tensor) -> Tensor:
    """Cross entropy of each map, over the points that lie in the window."""
    logs = torch.log_softmax(odds.flatten(2), dim=2)
    crossed = -(wanted.flatten(2) * logs).sum(dim=2)
    return (crossed * inside).sum() / inside.sum()


def train(
    model: JointReader, samples: Samples, steps: int, rate: float, generator: np.random.Generator
) -> None:
    """Give a joint reader one lesson."""

    def loss() -> Tensor:
        rows = generator.choice(len(samples.points), BATCH, replace=False)
        varied = [vary(samples, row, generator) for row in rows]
        seen = torch.from_numpy(np.stack([one[0] for one in varied]))
        wanted, inside = maps_of(np.stack([one[1] for one in varied]))
        odds = model.odds(seen.to(memory_format=torch.channels_last))
        return loss_of(odds, torch.from_numpy(wanted), torch.from_numpy(inside))

    descend(model, loss, steps=steps, rate=rate, weight_decay=2e-2, warm_up=0.1)


def main() -> None:
    """Command line."""
    options = read_options(__doc__, samples=50000, out=WEIGHTS_PATH)
    photographs = read_backgrounds(options.backgrounds, options.shared / "real")
    generator = np.random.default_rng(options.seed)
    scenes = make_scenes(Casting(options.shared, photographs), photographs, generator)
    segmenter = make_segmenter(Networks.load(options.models))
    samples = make_samples(scenes, segmenter, options.samples)
    torch.manual_seed(options.seed)
    model = JointReader()
    model.to(memory_format=torch.channels_last)
    for steps, rate in LESSONS:
        train(model, samples, steps, rate, generator)
    export(model, options.out, (CHANNELS, ROWS, COLUMNS), "maps")


if __name__ == "__main__":
    main()
