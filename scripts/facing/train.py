"""Train the network that reads which way a person faces, on simulated people only.

    python -m scripts.refinement.backgrounds /tmp/backgrounds
    python -m scripts.facing.train --backgrounds /tmp/backgrounds

writes ``app/vision/facing.onnx`` in about half an hour on one core. It needs the extras build and
train. No photograph of ``../shared/real`` is seen but the empty street of ``vtest``.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from app.vision.facing_evidence import CHANNELS, SIZE, WEIGHTS_PATH
from app.vision.resampling import resize
from scripts.facing.model import FacingReader
from scripts.facing.samples import ROWS, Samples, make_samples
from scripts.refinement.backgrounds import read_backgrounds
from scripts.refinement.lessons import descend, read_options
from scripts.refinement.model import export
from scripts.refinement.scenes import patch
from scripts.refinement.sprites import Casting

STEPS, RATE, BATCH = 8000, 3e-3, 32

TURN_DEG, SCALE, SHIFT_PX = 6.0, 0.07, 2.0
"""Standard deviations of what a window is turned, enlarged (logarithm) and moved by."""

NEIGHBOUR_SHARE, MATCHED_SHARE = 0.3, 0.3
"""How often somebody stands behind, and how often colours are brought nearer to those behind."""

PATCHES = 4000
"""Pieces of photographs to stand before."""

MOST_BLURRED = 2.5
"""How much smaller the smallest people are than the window of the head shows them."""


def vary(
    samples: Samples,
    row: int,
    patches: Sequence[NDArray[np.uint8]],
    generator: np.random.Generator,
) -> tuple[NDArray[np.float32], float]:
    """One sample before some photograph: input ``(8, 64, 64)`` in 0..1, and degrees of azimuth."""
    neighbour = int(generator.integers(len(samples.views)))
    crowded = generator.random() < NEIGHBOUR_SHARE
    smaller = np.exp(generator.uniform(0, np.log(MOST_BLURRED)))
    matched = generator.uniform(0.2, 0.8) if generator.random() < MATCHED_SHARE else 0.0
    gain = np.exp(generator.normal(0, 0.12, 3) + generator.normal(0, 0.2))
    shift, contrast = generator.normal(0, 15), np.exp(generator.normal(0, 0.2))
    noise, grey = generator.uniform(0, 8), generator.random() < 0.15
    planes = np.empty((CHANNELS, SIZE, SIZE), np.float32)
    for number, view in enumerate(samples.views[row]):
        scene = patches[int(generator.integers(len(patches)))].astype(np.float32)
        if crowded:
            _put(scene, samples.views[neighbour, number], generator.uniform(14, 40), generator)
        moved = _moved(view, generator)
        cover = moved[..., 3:4] / np.float32(255)
        colour = moved[..., :3].astype(np.float32)
        colour += np.float32(matched) * (scene.mean(axis=(0, 1)) - colour.mean(axis=(0, 1)))
        frame: NDArray[np.float32] = (scene * (1 - cover) + colour * cover).astype(np.float32)
        sharpest = smaller if number == 0 else max(1.0, smaller / 2.6)
        small = max(8, round(SIZE / sharpest))
        frame = resize(resize(frame, small, small), SIZE, SIZE)
        light = (128 + contrast * (frame - 128)) * gain + shift
        light += generator.normal(0, noise, light.shape)
        if grey:
            light[:] = light.mean(axis=2, keepdims=True)
        planes[4 * number : 4 * number + 3] = np.clip(light, 0, 255).transpose(2, 0, 1)
        planes[4 * number + 3] = moved[..., 4]
    planes /= 255
    azimuth = float(samples.azimuth_deg[row])
    return (planes[..., ::-1], -azimuth) if generator.random() < 0.5 else (planes, azimuth)


def _moved(view: NDArray[np.uint8], generator: np.random.Generator) -> NDArray[np.uint8]:
    """Turn, enlarge and move a view; ``(64, 64, 5)``."""
    angle, scale = generator.normal(0, TURN_DEG), np.exp(generator.normal(0, SCALE))
    matrix = np.array(cv2.getRotationMatrix2D(((SIZE - 1) / 2,) * 2, angle, scale), np.float64)
    matrix[:, 2] += generator.normal(0, SHIFT_PX, 2)
    stacked = view.transpose(1, 2, 0)
    # Colours run on beyond the person, and with them beyond the window.
    size, edge = (SIZE, SIZE), cv2.BORDER_REPLICATE
    plain, masks = np.ascontiguousarray(stacked[..., :3]), np.ascontiguousarray(stacked[..., 3:])
    colour = cv2.warpAffine(plain, matrix, size, borderMode=edge)
    moved = np.concatenate([colour, cv2.warpAffine(masks, matrix, size)], axis=2)
    return np.asarray(moved, np.uint8)


def _put(
    scene: NDArray[np.float32],
    view: NDArray[np.uint8],
    aside_px: float,
    generator: np.random.Generator,
) -> None:
    """Draw somebody else into a scene, aside."""
    step = round(aside_px) * (1 if generator.random() < 0.5 else -1)
    placed = np.zeros((SIZE, SIZE, 4), np.float32)
    stacked = view[:4].transpose(1, 2, 0)
    if step > 0:
        placed[:, step:] = stacked[:, :-step]
    else:
        placed[:, :step] = stacked[:, -step:]
    cover = placed[..., 3:] / 255
    scene[:] = scene * (1 - cover) + placed[..., :3] * cover


def loss_of(answers: Tensor, azimuth: Tensor) -> Tensor:
    """How unlikely azimuths ``(N,)`` in radians are under the distributions answered."""
    kappa = torch.hypot(answers[:, 0], answers[:, 1])
    towards = answers[:, 0] * torch.cos(azimuth) + answers[:, 1] * torch.sin(azimuth)
    return (torch.log(torch.special.i0e(kappa)) + kappa - towards).mean()


def train(
    model: FacingReader,
    samples: Samples,
    photographs: Sequence[NDArray[np.uint8]],
    generator: np.random.Generator,
) -> None:
    """Give a facing reader its lesson."""
    patches = [patch((SIZE, SIZE), photographs, generator) for _ in range(PATCHES)]

    def loss() -> Tensor:
        rows = generator.choice(len(samples.views), BATCH, replace=False)
        varied = [vary(samples, row, patches, generator) for row in rows]
        seen = torch.from_numpy(np.stack([one[0] for one in varied]))
        azimuth = torch.from_numpy(np.deg2rad([one[1] for one in varied]).astype(np.float32))
        return loss_of(model(seen.to(memory_format=torch.channels_last)), azimuth)

    descend(model, loss, steps=STEPS, rate=RATE, weight_decay=5e-2, warm_up=0.15)


def main() -> None:
    """Command line."""
    options = read_options(__doc__, samples=16000, out=WEIGHTS_PATH)
    photographs = read_backgrounds(options.backgrounds, options.shared / "real")
    generator = np.random.default_rng(options.seed)
    casting = Casting(options.shared, photographs, rows=ROWS)
    samples = make_samples(casting, options.samples, generator)
    torch.manual_seed(options.seed)
    model = FacingReader()
    model.to(memory_format=torch.channels_last)
    train(model, samples, photographs, generator)
    export(model, options.out, (CHANNELS, SIZE, SIZE), "belief")


if __name__ == "__main__":
    main()
