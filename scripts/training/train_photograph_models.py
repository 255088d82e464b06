"""Train the models of depth and trust on rendered people: see ``docs/training.md``.

Writes ``photograph_models.npz``; the same bytes for the same windows. Everything
is chosen and calibrated on one half of the held-out renders and reported on the other. No real
photograph takes part.
"""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.linear_model import LogisticRegression
from sklearn.metrics import roc_auc_score

from app.networks.dense import DenseNetwork
from app.networks.shipped import FOLDER, read_arrays
from app.vision.blazepose import LANDMARKS
from app.vision.depth import (
    RESIDUAL_M,
    Depths,
    decode_depths,
    depth_features,
    network_depths,
    sight_features,
)
from app.vision.judgement import (
    PEOPLE_SHARE,
    TrustModel,
    load_photograph_models,
    region_features,
    trust_features,
)
from scripts.index.calibrate import expected_calibration_error
from scripts.training.fit_dense import averaged, fit_dense, with_outputs
from scripts.training.photograph_data import LIMBS, TrainingRows, WindowRows
from scripts.training.render.people import MIRRORED
from scripts.training.render_postures import PostureRows
from scripts.training.shipping import record_hash

FILE = FOLDER / "photograph_models.npz"

TRUSTED_FROM = 0.5
"""Probability of right landmarks from which a reading counts for :func:`depth_moments`."""

HARD_FROM, HARD = 0.3, 3.0
"""The network's presence from which it takes a thing for a person, and how much more such windows
count than others without people: detectors find few others."""

BLANK = 0.4
"""Share of the windows that trust sees once more with average surroundings, as postures do."""

BLOCK = 4096
"""Windows corrected at a time."""

ELEVATIONS_DEG = (5.0, 20.0, 40.0)
"""Elevations of cameras between which the error of held-out depths is reported."""


def depth_inputs(rows: TrainingRows) -> NDArray[np.float32]:
    """Features of the depth network."""
    sight = sight_features(rows.window, rows.read_focal, rows.centre)
    return depth_features(rows.points, rows.world, rows.sampled, sight)


def train_depth(rows: TrainingRows, epochs: int, seed: int) -> DenseNetwork:
    """Residual of the network's own depth, with a Laplace likelihood."""
    import torch

    residual = np.clip((rows.depths - network_depths(rows.world)) / RESIDUAL_M, -12, 12)
    # Depths of hidden landmarks are known by chance at best.
    weights = np.where(rows.shown, 1.0, 0.3)

    def loss(outputs: Any, targets: Any) -> Any:
        error = (outputs[:, :LANDMARKS] - targets[:, :LANDMARKS]).abs()
        logarithm = outputs[:, LANDMARKS:].clamp(-4, 4)
        weight = targets[:, LANDMARKS:]
        return (weight * (error * torch.exp(-logarithm) + logarithm)).mean()

    return fit_dense(
        depth_inputs(rows), np.hstack([residual, weights]), 2 * LANDMARKS, loss,
        hidden=(256, 128), epochs=epochs, seed=seed, dropout=0.4, noise=0.5, decay=0.1,
    )  # fmt: skip


def corrected(network: DenseNetwork, rows: TrainingRows) -> Depths:
    """Corrected depths and sigmas ``(N, 33)`` of all windows."""
    parts = []
    for first in range(0, len(rows), BLOCK):
        some = rows.take(np.arange(first, min(first + BLOCK, len(rows))))
        parts.append(decode_depths(network(depth_inputs(some)), network_depths(some.world)))
    return Depths(*(np.concatenate(part) for part in zip(*parts, strict=True)))


# Errors beyond so many standard deviations count as so many.
_MOST_SD = 4.0


def depth_moments(
    rows: TrainingRows, depths: Depths, some: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Second moments ``(33, 33)`` of errors over their standard deviations; sides are alike."""
    errors = ((rows.depths - depths.metres) / (np.sqrt(2) * depths.sigmas))[some]
    errors = np.clip(errors, -_MOST_SD, _MOST_SD)
    moments = errors.T @ errors / len(errors)
    return np.asarray((moments + moments[np.ix_(MIRRORED, MIRRORED)]) / 2)


def trust_inputs(rows: TrainingRows, depths: Depths) -> NDArray[np.float64]:
    """Features ``(N, F)`` of the trust network."""
    features = trust_features(rows.points, rows.world, rows.presence, rows.last, depths.sigmas)
    return np.hstack([features, region_features(rows.sampled)])


def trust_weights(rows: TrainingRows) -> NDArray[np.float64]:
    """How much each window ``(N,)`` counts for trust: people make up :data:`PEOPLE_SHARE`."""
    weights = np.where(rows.person, 1.0, np.where(rows.presence > HARD_FROM, HARD, 1.0))
    weights *= rows.decided
    for some, share in ((rows.person, PEOPLE_SHARE), (~rows.person, 1 - PEOPLE_SHARE)):
        weights[some] *= share / weights[some].sum()
    return np.asarray(len(rows) * weights)


def train_trust(
    rows: TrainingRows,
    depths: Depths,
    epochs: int,
    seed: int,
    others: PostureRows | None = None,
    initial: DenseNetwork | None = None,
) -> DenseNetwork:
    """Log odds of a person, and of right landmarks given a person.

    Of others, who are hidden or in bad light, it is known that they are people, but not whether
    their landmarks are right. An initial network of the same inputs is trained on.
    """
    import torch

    def loss(outputs: Any, targets: Any) -> Any:
        each = torch.nn.functional.binary_cross_entropy_with_logits(
            outputs, targets[:, :2], reduction="none"
        )
        return (targets[:, 2:] * each).sum(dim=1).mean()

    inputs, weights = trust_inputs(rows, depths)[rows.decided], trust_weights(rows)
    targets = np.column_stack([rows.person, rows.right, weights, weights * rows.person])
    targets, surroundings = targets[rows.decided], 2 * rows.sampled.shape[2]
    if others is not None:
        people = others.posture >= 0
        body = others.body[people][:, surroundings - inputs.shape[1] :]
        inputs = np.vstack([inputs, np.hstack([body, others.surroundings[people]])])
        shown = targets[:, 0] > 0
        targets[shown, 2] *= shown.sum() / (shown.sum() + len(body))
        alike = [1.0, 0.0, float(targets[shown, 2].mean()), 0.0]
        targets = np.vstack([targets, np.tile(alike, (len(body), 1))])
    blank = np.random.default_rng(seed).random(len(inputs)) < BLANK
    without = inputs[blank]
    without[:, -surroundings:] = inputs[:, -surroundings:].mean(axis=0)
    return fit_dense(
        np.vstack([inputs, without]), np.vstack([targets, targets[blank]]), 2, loss,
        hidden=(32,), epochs=epochs, seed=seed, dropout=0.4, noise=0.5, decay=0.1, initial=initial,
    )  # fmt: skip


def _with_surroundings(network: DenseNetwork, inputs: NDArray[np.float64]) -> DenseNetwork:
    """The same network for inputs ``(N, F)``, whose last columns it does not know."""
    known = len(network.means)
    rest = inputs[:, known:]
    means = np.r_[network.means, rest.mean(axis=0)].astype(np.float32)
    scales = np.r_[network.scales, np.maximum(rest.std(axis=0), 1e-4)].astype(np.float32)
    first, *others = network.weights
    padded = np.vstack([first, np.zeros((rest.shape[1], first.shape[1]), np.float32)])
    return DenseNetwork(means, scales, (padded, *others), network.biases)


def trust_trained_on(
    shipped: Path,
    train: TrainingRows,
    held: TrainingRows,
    others: PostureRows,
    epochs: int,
    seed: int,
) -> DenseNetwork:
    """The mean of a file's trust and of the same trained on with these windows.

    The first knows ten times as many people, the second more kinds of things: their mean
    distinguishes both kinds better than either.
    """
    models = load_photograph_models(shipped)
    depths, found = (corrected(models.depth.network, rows) for rows in (train, held))
    before = _with_surroundings(models.trust.network, trust_inputs(train, depths)[train.decided])
    after = train_trust(train, depths, epochs, seed, others, before)
    calibrates = held.scene % 2 == 0
    after = calibrated(after, held, found, calibrates)
    trust = averaged([before, after])
    for name, one in (("before", before), ("trained on", after), ("mean", trust)):
        given = TrustModel(one).probabilities(trust_inputs(held, found))
        print(f"{name}: {trust_report(held, given, held.decided & ~calibrates)}", flush=True)
    return trust


def calibrated(
    trust: DenseNetwork, held: TrainingRows, depths: Depths, some: NDArray[np.bool_]
) -> DenseNetwork:
    """The same trust, its log odds fitted to the truth of some windows."""
    odds, fits, weights = trust(trust_inputs(held, depths)), [], trust_weights(held)
    for column, (rows, truth) in enumerate(
        ((held.decided & some, held.person), (held.decided & some & held.person, held.right))
    ):
        model = LogisticRegression(C=1e3)
        model.fit(odds[rows, column, None], truth[rows], sample_weight=weights[rows])
        fits.append((float(model.coef_[0, 0]), float(model.intercept_[0])))
    factors, offsets = np.array(fits).T
    return with_outputs(trust, factors, offsets)


def train_models(train: TrainingRows, held: TrainingRows, epochs: int, seed: int) -> dict[str, Any]:
    """Arrays of both models; figures on the second half of the held-out windows are printed."""
    begun = time.monotonic()

    def say(text: str) -> None:
        print(f"[{time.monotonic() - begun:5.0f} s] {text}", flush=True)

    # Trust learns from depths that were corrected by a model of other photographs.
    crossed = Depths(*np.zeros((2, len(train), LANDMARKS)))
    even = train.scene % 2 == 0
    for number, half in enumerate((even, ~even)):
        network = train_depth(train.take(train.teaches & half), epochs, seed + number)
        found = corrected(network, train.take(~half))
        crossed.metres[~half], crossed.sigmas[~half] = found.metres, found.sigmas
        say(f"depth of half {number + 1}")
    depth = train_depth(train.take(train.teaches), epochs, seed + 2)
    say(f"depth from {train.teaches.sum()} windows")

    calibrates = held.scene % 2 == 0
    found = corrected(depth, held)
    # Rescaled, so that the mean sigma of these rows is their mean absolute error.
    fitted = (held.teaches & calibrates)[:, None] & held.shown
    error = np.abs(found.metres - held.depths)[fitted].mean() / found.sigmas[fitted].mean()
    offsets = np.repeat([0.0, np.log(error)], LANDMARKS)
    depth = with_outputs(depth, np.ones(2 * LANDMARKS), offsets)
    found = corrected(depth, held)
    say(depth_report(held, found, held.teaches & ~calibrates))

    trust = train_trust(train, crossed, epochs, seed + 30)
    trust = calibrated(trust, held, found, calibrates)
    trusted = TrustModel(trust).probabilities(trust_inputs(held, found))
    say(trust_report(held, trusted, held.decided & ~calibrates))

    trusted = TrustModel(trust).probabilities(trust_inputs(train, crossed))
    rescaled = Depths(crossed.metres, error * crossed.sigmas)
    moments = depth_moments(train, rescaled, train.teaches & (trusted[:, 1] > TRUSTED_FROM))
    stored = {"depth.moments": moments.astype(np.float32)}
    return depth.arrays("depth") | trust.arrays("trust") | stored


def depth_report(held: TrainingRows, found: Depths, rows: NDArray[np.bool_]) -> str:
    """Depth of limb joints before and after, and whether sigmas rank errors."""
    own, error, sigma = (
        1e3 * values[rows][:, LIMBS]
        for values in (
            np.abs(network_depths(held.world) - held.depths),
            np.abs(found.metres - held.depths),
            found.sigmas,
        )
    )
    quartile = np.digitize(sigma, np.quantile(sigma, [0.25, 0.5, 0.75]))
    by_sigma = " ".join(f"{error[quartile == q].mean():.0f}" for q in range(4))
    above = np.digitize(held.elevation_deg[rows], ELEVATIONS_DEG)
    by_elevation = " ".join(
        f"{own[above == part].mean():.0f} -> {error[above == part].mean():.1f}"
        for part in range(len(ELEVATIONS_DEG) + 1)
    )
    return (
        f"depth of limb joints {own.mean():.0f} -> {error.mean():.1f} mm; by quartile of sigma "
        f"{by_sigma}; mean sigma {sigma.mean():.0f}; by elevation {by_elevation}"
    )


def trust_report(held: TrainingRows, given: NDArray[np.float64], rows: NDArray[np.bool_]) -> str:
    """How well people and right landmarks are distinguished from others."""
    parts = []
    for name, column, truth in (("person", 0, held.person[rows]), ("right", 1, held.right[rows])):
        by = given[rows, column], held.presence[rows]
        area, own = (roc_auc_score(truth, one) for one in by)
        error, own_error = (expected_calibration_error(one, truth) for one in by)
        parts.append(
            f"{name}: AUC {area:.3f} (the network's presence {own:.3f}), "
            f"ECE {error:.3f} ({own_error:.3f})"
        )
    return "; ".join(parts)


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add = parser.add_argument
    add("--train", type=Path, nargs="+", required=True, help="folders of render-people")
    add("--held-out", type=Path, required=True, help="another, held out")
    add("--out", type=Path, default=FILE)
    add("--epochs", type=int, default=20)
    add("--seed", type=int, default=0)
    add("--share", type=float, default=1.0, help="of the photographs, for a learning curve")
    add("--others", type=Path, nargs="+", help="folders of render-postures: trains trust alone on")
    options = parser.parse_args(arguments)
    train = TrainingRows.of(WindowRows.read(options.train), options.seed)
    train = train.take(train.scene % 1000 < 1000 * options.share)
    held = TrainingRows.of(WindowRows.read([options.held_out]), options.seed + 1)
    if options.others is None:
        store(train_models(train, held, options.epochs, options.seed), options.out)
        return
    others = PostureRows.read(options.others)
    trust = trust_trained_on(options.out, train, held, others, options.epochs, options.seed)
    store(trust.arrays("trust"), options.out)


def store(arrays: dict[str, Any], file: Path) -> None:
    """Write arrays into a file of models, beside others that it has."""
    kept: dict[str, Any] = read_arrays(file) if file.exists() else {}
    np.savez_compressed(file, **(kept | arrays))
    record_hash(file)
