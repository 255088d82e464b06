"""Train the network that refines silhouettes, on simulated people only.

    python -m scripts.refinement.backgrounds /tmp/backgrounds
    python -m scripts.refinement.train --backgrounds /tmp/backgrounds

writes ``app/vision/refiner.onnx`` in about an hour and three quarters on one core. It needs the
extras build and train, and the segmentation networks (``scripts/fetch_models.py``). No photograph
of ``../shared/real`` is seen but the empty street of ``vtest``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from app.vision.networks import Networks
from app.vision.refine import CHANNELS, COLUMNS, PROBABILITY, ROWS, WEIGHTS_PATH
from scripts.refinement.backgrounds import read_backgrounds
from scripts.refinement.lessons import BATCH, descend, read_options
from scripts.refinement.model import Refiner, export
from scripts.refinement.samples import make_samples, spoil
from scripts.refinement.scenes import make_scenes
from scripts.refinement.sprites import Casting


@dataclass(frozen=True)
class Lesson:
    """A part of the training.

    Parameters
    ----------
    steps : int
        Batches.
    rate : float
        Largest learning rate; it rises and falls once.
    helped, spoilt : float
        How often the first networks' answer is first completed by the truth, and how often it is
        spoilt otherwise: it fails more often before simulated people than before real ones.
    severity : (float, float)
        Least and most severe faults.
    """

    steps: int
    rate: float
    helped: float
    spoilt: float
    severity: tuple[float, float]


LESSONS = (
    Lesson(5800, 4e-3, 0.5, 0.6, (1.0, 1.0)),
    Lesson(2500, 2e-3, 0.6, 0.6, (0.1, 0.8)),
)
"""First every fault there is; then those that the first networks have, which are mostly right."""

UNKNOWN_SHARE = 0.25
"""How often nobody says where the neighbours are."""


def batch(
    inputs: NDArray[np.uint8],
    targets: NDArray[np.uint8],
    rows: NDArray[np.int64],
    lesson: Lesson,
    generator: np.random.Generator,
) -> tuple[Tensor, Tensor]:
    """Some samples, varied: ``(N, 6, 192, 128)`` and ``(N, 1, 192, 128)`` in 0..1."""
    seen = inputs[rows].astype(np.float32) / 255
    wanted = targets[rows].astype(np.float32) / 255
    for number in range(len(rows)):
        severity = generator.uniform(*lesson.severity)
        probability = inputs[rows[number], PROBABILITY]
        if generator.random() < lesson.helped:
            probability = np.maximum(probability, targets[rows[number]])
            probability = spoil(probability, generator, severity)
        elif generator.random() < lesson.spoilt:
            probability = spoil(probability, generator, severity)
        seen[number, PROBABILITY] = probability.astype(np.float32) / 255
        gain = np.exp(generator.normal(0, 0.12, 3) + generator.normal(0, 0.15))
        seen[number, :3] *= gain.astype(np.float32)[:, None, None]
        seen[number, :3] += np.float32(generator.normal(0, 0.05))
        if generator.random() < 0.15:
            seen[number, :3] = seen[number, :3].mean(axis=0)
        if generator.random() < UNKNOWN_SHARE:
            seen[number, 5] = 0
        if generator.random() < 0.5:
            seen[number], wanted[number] = seen[number, ..., ::-1], wanted[number, ..., ::-1]
    np.clip(seen[:, :3], 0, 1, out=seen[:, :3])
    return torch.from_numpy(seen), torch.from_numpy(wanted)[:, None]


def loss_of(odds: Tensor, wanted: Tensor) -> Tensor:
    """Cross entropy, and what the overlap lacks of 1."""
    found = torch.sigmoid(odds)
    shared = (found * wanted).sum(dim=(1, 2, 3))
    union = (found + wanted - found * wanted).sum(dim=(1, 2, 3))
    return binary_cross_entropy_with_logits(odds, wanted) * 2 + 1 - (shared / union).mean()


def train(
    model: Refiner,
    inputs: NDArray[np.uint8],
    targets: NDArray[np.uint8],
    lesson: Lesson,
    generator: np.random.Generator,
) -> None:
    """Give a refiner one lesson."""

    def loss() -> Tensor:
        rows = generator.choice(len(inputs), BATCH, replace=False)
        seen, wanted = batch(inputs, targets, rows, lesson, generator)
        return loss_of(model.odds(seen.to(memory_format=torch.channels_last)), wanted)

    descend(model, loss, steps=lesson.steps, rate=lesson.rate, weight_decay=1e-2, warm_up=0.15)


def main() -> None:
    """Command line."""
    options = read_options(__doc__, samples=20000, out=WEIGHTS_PATH)
    photographs = read_backgrounds(options.backgrounds, options.shared / "real")
    generator = np.random.default_rng(options.seed)
    scenes = make_scenes(Casting(options.shared, photographs), photographs, generator)
    samples = make_samples(scenes, Networks.load(options.models), options.samples)
    torch.manual_seed(options.seed)
    model = Refiner()
    model.to(memory_format=torch.channels_last)
    for lesson in LESSONS:
        train(model, *samples, lesson, generator)
    export(model, options.out, (CHANNELS, ROWS, COLUMNS), "probability")


if __name__ == "__main__":
    main()
