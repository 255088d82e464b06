"""Train the model of posture on rendered people: see ``docs/training.md``.

Adds to ``photograph_models.npz``; the same bytes for the same rows. Everything is
chosen and calibrated on one half of the held-out renders and reported on the other. No real
photograph takes part.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.networks.dense import DenseNetwork
from app.vision.judgement import FRAME_POSTURES, PostureModel, load_photograph_models, sharpened
from scripts.index.calibrate import expected_calibration_error
from scripts.training.fit_dense import averaged, fit_dense, half_way
from scripts.training.photograph_data import SEEN_FROM
from scripts.training.render_postures import VIEWS, PostureRows
from scripts.training.train_photograph_models import FILE, store

ENSEMBLE, HIDDEN = 3, 192
"""Number of networks whose mean is the posture network, and hidden values of each."""

TRAINED_ON_RATE = 3e-4
"""Highest learning rate of a network that is trained on."""

BLANK = 0.4
"""Share of the views that are shown once more with average surroundings: bodies alone show their
posture as well, and surroundings unlike any rendered ones do not determine it."""

NOBODY_FROM = 0.1
"""The network's presence from which it takes a picture without people for a person."""


def train_posture(
    features: NDArray[np.floating],
    classes: NDArray[np.int64],
    epochs: int,
    seed: int,
    initial: DenseNetwork | None,
) -> DenseNetwork:
    """The mean of a few networks with one hidden layer, whose scores differ by chance.

    An initial network, which is such a mean, is trained on as one. The result is half-way between
    both [1]_: it knows the new photographs, and forgets less of those before.

    References
    ----------
    .. [1] M. Wortsman et al., "Robust Fine-Tuning of Zero-Shot Models", CVPR 2022.
    """
    import torch

    def loss(outputs: Any, targets: Any) -> Any:
        return torch.nn.functional.cross_entropy(outputs, targets[:, 0].long())

    def fit(hidden: int, rate: float, seed: int) -> DenseNetwork:
        return fit_dense(
            features, classes[:, None].astype(np.float32), len(FRAME_POSTURES), loss,
            epochs=epochs, seed=seed, batch=64, rate=rate, hidden=(hidden,),
            dropout=0.4, noise=0.4, decay=0.1, initial=initial,
        )  # fmt: skip

    if initial is not None:
        return half_way(initial, fit(len(initial.biases[0]), TRAINED_ON_RATE, seed))
    return averaged([fit(HIDDEN, 1e-3, seed + number) for number in range(ENSEMBLE)])


def fit_sharpness(
    scores: NDArray[np.floating], right: NDArray[np.float64], classes: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Sharpness ``(2,)`` that makes the truth likeliest; the truth of nobody (-1) is uniform."""
    count = scores.shape[1]
    truth = np.where(classes[:, None] < 0, 1 / count, np.eye(count)[classes])

    def loss(sharpness: NDArray[np.float64]) -> float:
        likely = np.log(sharpened(scores, right, sharpness) + 1e-9)
        return float(-(truth * likely).sum(axis=1).mean())

    grid = [np.array([a, b]) for a in np.linspace(-0.8, 1.2, 41) for b in np.linspace(0, 0.6, 25)]
    return min(grid, key=loss)


def posture_report(given: NDArray[np.float64], classes: NDArray[np.int64]) -> str:
    """How often postures are right, calibration, and confusions."""
    best, sure = given.argmax(axis=1), given.max(axis=1)
    right, lines = best == classes, []
    for number, name in enumerate(FRAME_POSTURES):
        rows = classes == number
        shares = np.bincount(best[rows], minlength=len(FRAME_POSTURES)) / max(rows.sum(), 1)
        lines.append(f"    {name:10s} {rows.sum():5d}  " + "  ".join(f"{s:.2f}" for s in shares))
    error = expected_calibration_error(sure, right)
    return "\n".join([f"posture right {right.mean():.3f}, ECE {error:.3f}", *lines])


def train_models(
    train: PostureRows,
    held: PostureRows,
    epochs: int,
    seed: int,
    initial: PostureModel | None = None,
) -> dict[str, Any]:
    """Arrays of the model; figures on the second half of the held-out photographs are printed.

    A model that is trained on keeps its sharpness.
    """
    teaches = (train.posture >= 0) & (train.presence > SEEN_FROM)
    body, surroundings = (
        part[teaches].astype(np.float32) for part in (train.body, train.surroundings)
    )
    blank = np.random.default_rng(seed).random(len(body)) < BLANK
    average = np.broadcast_to(surroundings.mean(axis=0), surroundings[blank].shape)
    evidence = np.vstack([np.hstack([body, surroundings]), np.hstack([body[blank], average])])
    classes = np.concatenate([train.posture[teaches], train.posture[teaches][blank]])
    before = None if initial is None else initial.network
    network = train_posture(evidence, classes, epochs, seed + 20, before)
    posture = PostureModel(network, np.zeros(2))
    scores = posture.scores(held.body.astype(np.float32), held.surroundings.astype(np.float32))
    calibrates = held.photograph % 2 == 0
    # Pictures without people that the network takes for people limit the certainty.
    asked = (held.presence > NOBODY_FROM) & calibrates
    sharpness = fit_sharpness(scores[asked], held.right[asked], held.posture[asked])
    if initial is not None:
        sharpness = initial.sharpness
    print(f"from {teaches.sum()} views; sharpness {sharpness.round(3)}")
    given = sharpened(scores, held.right, sharpness)
    for number, name in enumerate(VIEWS):
        rows = (held.posture >= 0) & (held.presence > SEEN_FROM) & ~calibrates
        rows &= held.view == number
        print(f"{name}: {posture_report(given[rows], held.posture[rows])}")
    return {"posture.sharpness": sharpness} | network.arrays("posture")


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add = parser.add_argument
    add("--train", type=Path, nargs="+", required=True, help="folders of render-postures")
    add("--held-out", type=Path, nargs="+", required=True, help="others, held out")
    add("--out", type=Path, default=FILE)
    add("--start", type=Path, help="file of models whose network is trained on")
    add("--epochs", type=int, default=14)
    add("--seed", type=int, default=0)
    add("--share", type=float, default=1.0, help="of the photographs, for a learning curve")
    options = parser.parse_args(arguments)
    train, held = PostureRows.read(options.train), PostureRows.read(options.held_out)
    train = train.take(train.photograph % 1000 < 1000 * options.share)
    initial = None
    if options.start is not None:
        initial = load_photograph_models(options.start).posture
    store(train_models(train, held, options.epochs, options.seed, initial), options.out)
