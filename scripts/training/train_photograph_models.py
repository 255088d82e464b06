"""Train the models of depth, posture and trust on rendered people: see ``docs/training.md``.

Writes ``app/vision/models/photograph_models.npz``; the same bytes for the same windows. Everything
is chosen and calibrated on one half of the held-out renders and reported on the other. No real
photograph takes part.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.linear_model import LogisticRegression
from sklearn.metrics import roc_auc_score

from app.vision.blazepose import LANDMARKS
from app.vision.depth import (
    HIPS,
    RESIDUAL_M,
    DenseNetwork,
    Depths,
    decode_depths,
    depth_features,
    network_depths,
    sight_features,
)
from app.vision.judgement import (
    FRAME_POSTURES,
    PostureModel,
    TrustModel,
    posture_features,
    region_features,
    sharpened,
    trust_features,
)
from app.vision.models import FOLDER, MODELS
from app.vision.odds import sigmoid
from app.vision.optics import PinholeCamera, place_on_sight_lines, roll_rotation, to_line_of_sight
from index.build.calibrate import expected_calibration_error
from scripts.training.fit_dense import averaged, fit_dense, with_outputs
from scripts.training.photograph_data import LIMBS, TrainingRows, read_rows

FILE = FOLDER / "photograph_models.npz"

ENSEMBLE = 3
"""Number of networks whose mean is each of the two posture networks."""

NOBODY_FROM = 0.1
"""The network's presence from which it takes a window without people for a person."""

BLOCK = 4096
"""Windows corrected at a time."""


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


def trust_inputs(rows: TrainingRows, depths: Depths) -> NDArray[np.float64]:
    """Features of the trust network."""
    return trust_features(rows.points, rows.world, rows.presence, rows.last, depths.sigmas)


def train_trust(rows: TrainingRows, depths: Depths, epochs: int, seed: int) -> DenseNetwork:
    """Log odds of a person, and of right landmarks given a person."""
    import torch

    def loss(outputs: Any, targets: Any) -> Any:
        each = torch.nn.functional.binary_cross_entropy_with_logits(
            outputs, targets, reduction="none"
        )
        return each[:, 0].mean() + (each[:, 1] * targets[:, 0]).mean()

    targets = np.column_stack([rows.person, rows.right]).astype(np.float32)
    return fit_dense(
        trust_inputs(rows, depths)[rows.decided], targets[rows.decided], 2, loss,
        hidden=(32,), epochs=epochs, seed=seed, batch=64, dropout=0.2, noise=0.2, decay=0.1,
    )  # fmt: skip


def calibrated(
    trust: DenseNetwork, held: TrainingRows, depths: Depths, some: NDArray[np.bool_]
) -> DenseNetwork:
    """The same trust, its log odds fitted to the truth of some windows."""
    odds, fits = trust(trust_inputs(held, depths)), []
    for column, (rows, truth) in enumerate(
        ((held.decided & some, held.person), (held.decided & some & held.person, held.right))
    ):
        model = LogisticRegression(C=1e3).fit(odds[rows, column, None], truth[rows])
        fits.append((float(model.coef_[0, 0]), float(model.intercept_[0])))
    factors, offsets = np.array(fits).T
    return with_outputs(trust, factors, offsets)


def posture_inputs(rows: TrainingRows, depths: Depths) -> NDArray[np.float64]:
    """Shapes of the bodies, and what trust is made of, for the posture model."""
    places = rows.found_places
    visibility = sigmoid(rows.points[:, :LANDMARKS, 3].astype(np.float64))
    placed = np.empty((len(rows), LANDMARKS, 3))
    for row in range(len(rows)):
        # As the service places them, about the hips in camera axes.
        camera = PinholeCamera(rows.read_focal[row], rows.centre[row])
        to_sight = to_line_of_sight(camera.rays(rows.window[row, :2]))
        axes = roll_rotation(rows.window[row, 3]) @ to_sight
        metres = rows.world[row, :LANDMARKS].astype(np.float64)
        metres = metres - metres[HIPS].mean(axis=0)
        metres[:, 2] = depths.metres[row]
        rays, weights = camera.rays(places[row]), np.maximum(visibility[row], 0.05)
        points = place_on_sight_lines(metres, rays, axes, weights).points
        placed[row] = points - points[HIPS].mean(axis=0)
    width, height = (np.maximum(np.ptp(places[..., axis], axis=1), 1.0) for axis in (0, 1))
    presence = rows.presence.astype(np.float64)
    shapes = posture_features(placed, visibility, rows.window[:, 3], presence, width / height)
    return np.hstack([shapes, trust_inputs(rows, depths)])


def train_posture(
    features: NDArray[np.floating], classes: NDArray[np.int64], epochs: int, seed: int,
    **options: Any,
) -> DenseNetwork:  # fmt: skip
    """The mean of a few networks with one hidden layer: their scores differ by chance."""
    import torch

    def loss(outputs: Any, targets: Any) -> Any:
        return torch.nn.functional.cross_entropy(outputs, targets[:, 0].long())

    return averaged([
        fit_dense(
            features, classes[:, None].astype(np.float32), len(FRAME_POSTURES), loss,
            epochs=epochs, seed=seed + number, batch=64, **options,
        )
        for number in range(ENSEMBLE)
    ])  # fmt: skip


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


def train_models(train: TrainingRows, held: TrainingRows, epochs: int, seed: int) -> dict[str, Any]:
    """Arrays of all models; figures on the second half of the held-out windows are printed."""
    begun = time.monotonic()

    def say(text: str) -> None:
        print(f"[{time.monotonic() - begun:5.0f} s] {text}", flush=True)

    # Posture and trust learn from depths that were corrected by a model of other photographs.
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

    bodies, held_bodies = posture_inputs(train, crossed), posture_inputs(held, found)
    around, held_around = region_features(train.sampled), region_features(held.sampled)
    classes = train.posture[train.teaches]
    by_body = train_posture(
        bodies[train.teaches], classes, epochs, seed + 10, hidden=(48,), dropout=0.3, noise=0.3
    )
    by_surroundings = train_posture(
        np.hstack([bodies, around])[train.teaches], classes, epochs, seed + 20,
        hidden=(96,), dropout=0.4, noise=0.5, decay=0.1,
    )  # fmt: skip
    posture = PostureModel(by_body, by_surroundings, np.zeros(2))
    scores, right = posture.scores(held_bodies, held_around), trusted[:, 1]
    # Windows without people that the network takes for people limit the certainty.
    asked = (held.presence > NOBODY_FROM) & calibrates
    sharpness = fit_sharpness(scores[asked], right[asked], held.posture[asked])
    say(f"posture: sharpness {sharpness[0]:.2f} {sharpness[1]:.2f}")
    tests = held.teaches & ~calibrates
    say(posture_report(sharpened(scores, right, sharpness)[tests], held.posture[tests]))
    arrays: dict[str, Any] = {"posture.trust": sharpness}
    networks = {"depth": depth, "doubt": trust, "posture.by_body": by_body,
                "posture.by_surroundings": by_surroundings}  # fmt: skip
    for name, network in networks.items():
        arrays |= network.arrays(name)
    return arrays


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
    by = " ".join(f"{error[quartile == q].mean():.0f}" for q in range(4))
    return (
        f"depth of limb joints {own.mean():.0f} -> {error.mean():.0f} mm; by quartile of sigma "
        f"{by}; mean sigma {sigma.mean():.0f}"
    )


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


def trust_report(held: TrainingRows, given: NDArray[np.float64], rows: NDArray[np.bool_]) -> str:
    """How well people and right landmarks are distinguished from others."""
    parts = []
    for name, column, truth in (("person", 0, held.person[rows]), ("right", 1, held.right[rows])):
        area, own = (roc_auc_score(truth, by[rows]) for by in (given[:, column], held.presence))
        error = expected_calibration_error(given[rows, column], truth)
        parts.append(f"{name}: AUC {area:.3f} (the network's presence {own:.3f}), ECE {error:.3f}")
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
    options = parser.parse_args(arguments)
    train = TrainingRows.of(read_rows(options.train), options.seed)
    held = TrainingRows.of(read_rows([options.held_out]), options.seed + 1)
    np.savez_compressed(options.out, **train_models(train, held, options.epochs, options.seed))
    print(f"{options.out}: {options.out.stat().st_size} bytes")
    if options.out.resolve() == FILE:
        document = json.loads(MODELS.read_text())
        document["photograph_models"]["sha256"] = hashlib.sha256(FILE.read_bytes()).hexdigest()
        MODELS.write_text(json.dumps(document, indent=1) + "\n")
