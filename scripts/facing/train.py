"""Train the network that reads which way a person faces, on simulated people only.

    python -m scripts.refinement.backgrounds /tmp/backgrounds
    python -m scripts.facing.train --backgrounds /tmp/backgrounds

writes ``app/vision/facing.onnx`` in about an hour and a half on one core. It needs the extras build
and train, and the segmentation network (``scripts/fetch_model.py``). No photograph of
``../shared/real`` is seen but the empty street of ``vtest``.
"""

from __future__ import annotations

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from app.vision.facing_evidence import CHANNELS, SIZE, WEIGHTS_PATH
from app.vision.network import PersonNetwork
from app.vision.resampling import resize
from app.vision.segment import make_segmenter
from scripts.facing.model import CELL, FacingReader
from scripts.facing.samples import Samples, make_samples
from scripts.joints.maps import loss_of as loss_of_maps
from scripts.joints.maps import wanted_maps
from scripts.joints.samples import OTHER_SIDE
from scripts.refinement.backgrounds import read_backgrounds
from scripts.refinement.lessons import descend, read_options
from scripts.refinement.model import export
from scripts.refinement.samples import spoil
from scripts.refinement.scenes import make_scenes
from scripts.refinement.sprites import Casting

STEPS, RATE, BATCH = 10000, 3e-3, 32

MAPS_SHARE = 0.5
"""What finding the joints counts for beside the azimuth."""

TRUE_SHARE, SEVERITY = 0.5, 0.5
"""How often the silhouette shown is the true one, and how badly that is spoilt at most."""

TURN_DEG, SCALE, SHIFT_PX = 6.0, 0.07, 2.0
"""Standard deviations of what a window is turned, enlarged (logarithm) and moved by."""

MOST_BLURRED = 1.6
"""How much smaller some people are than the window of the head shows them."""


def vary(
    samples: Samples, row: int, generator: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.float32], float]:
    """One sample, varied: input ``(8, 64, 64)`` in 0..1, points ``(16, 2)``, degrees of azimuth."""
    planes = samples.seen[row].copy()
    if generator.random() < TRUE_SHARE:
        for number, cover in enumerate(samples.covers[row]):
            spoilt = spoil(cover, generator, generator.uniform(0, SEVERITY))
            planes[4 * number + 3] = np.where(spoilt > 127, np.uint8(255), np.uint8(0))
    smaller = np.exp(generator.uniform(0, np.log(MOST_BLURRED)))
    gain = np.exp(generator.normal(0, 0.12, 3) + generator.normal(0, 0.2))
    shift, contrast = generator.normal(0, 15), np.exp(generator.normal(0, 0.2))
    grey = generator.random() < 0.15
    seen = np.empty((CHANNELS, SIZE, SIZE), np.float32)
    for first in (0, 4):
        matrix = _movement(generator)
        stacked = np.ascontiguousarray(planes[first : first + 4].transpose(1, 2, 0))
        moved: NDArray[np.uint8] = np.asarray(
            cv2.warpAffine(stacked, matrix, (SIZE, SIZE), borderMode=cv2.BORDER_REPLICATE), np.uint8
        )
        small = max(8, round(SIZE / smaller)) if first == 0 else SIZE
        colour = resize(resize(moved[..., :3], small, small), SIZE, SIZE)
        light = (128 + contrast * (colour.astype(np.float32) - 128)) * gain + shift
        if grey:
            light[:] = light.mean(axis=2, keepdims=True)
        seen[first : first + 3] = np.clip(light, 0, 255).transpose(2, 0, 1)
        seen[first + 3] = moved[..., 3]
    seen /= 255
    # The second window is the last one moved.
    points: NDArray[np.floating] = samples.points[row] @ matrix[:, :2].T + matrix[:, 2]
    azimuth = float(samples.azimuth_deg[row])
    if generator.random() < 0.5:
        seen, azimuth = seen[..., ::-1], -azimuth
        points = points[OTHER_SIDE] * (-1, 1) + (SIZE - 1, 0)
    return seen, points.astype(np.float32), azimuth


def _movement(generator: np.random.Generator) -> NDArray[np.float64]:
    """Matrix ``(2, 3)`` that turns, enlarges and moves a window."""
    angle, scale = generator.normal(0, TURN_DEG), np.exp(generator.normal(0, SCALE))
    matrix = np.array(cv2.getRotationMatrix2D(((SIZE - 1) / 2,) * 2, angle, scale), np.float64)
    matrix[:, 2] += generator.normal(0, SHIFT_PX, 2)
    return matrix


def loss_of(answers: Tensor, azimuth: Tensor) -> Tensor:
    """How unlikely azimuths ``(N,)`` in radians are under the distributions answered."""
    kappa = torch.hypot(answers[:, 0], answers[:, 1])
    towards = answers[:, 0] * torch.cos(azimuth) + answers[:, 1] * torch.sin(azimuth)
    return (torch.log(torch.special.i0e(kappa)) + kappa - towards).mean()


def train(model: FacingReader, samples: Samples, generator: np.random.Generator) -> None:
    """Give a facing reader its lesson."""
    cells = (SIZE // CELL, SIZE // CELL)

    def loss() -> Tensor:
        rows = generator.choice(len(samples.seen), BATCH, replace=False)
        varied = [vary(samples, row, generator) for row in rows]
        seen = torch.from_numpy(np.stack([one[0] for one in varied]))
        maps, inside = wanted_maps(np.stack([one[1] for one in varied]), cells, CELL)
        azimuth = torch.from_numpy(np.deg2rad([one[2] for one in varied]).astype(np.float32))
        odds, belief = model.odds_and_belief(seen.to(memory_format=torch.channels_last))
        joints = loss_of_maps(odds, torch.from_numpy(maps), torch.from_numpy(inside))
        return loss_of(belief, azimuth) + MAPS_SHARE * joints

    descend(model, loss, steps=STEPS, rate=RATE, weight_decay=5e-2, warm_up=0.15)


def main() -> None:
    """Command line."""
    options = read_options(__doc__, samples=20000, out=WEIGHTS_PATH)
    photographs = read_backgrounds(options.backgrounds, options.shared / "real")
    generator = np.random.default_rng(options.seed)
    scenes = make_scenes(Casting(options.shared, photographs), photographs, generator)
    segmenter = make_segmenter(PersonNetwork(options.model))
    samples = make_samples(scenes, segmenter, options.samples)
    torch.manual_seed(options.seed)
    model = FacingReader()
    model.to(memory_format=torch.channels_last)
    train(model, samples, generator)
    export(model, options.out, (CHANNELS, SIZE, SIZE), "belief")


if __name__ == "__main__":
    main()
