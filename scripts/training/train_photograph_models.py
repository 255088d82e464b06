r"""Train the models of depth, posture and trust on rendered people.

    python -m scripts render-people --out /tmp/photographs/train-1 --seed 1
    python -m scripts render-people --out /tmp/photographs/train-2 --seed 2
    python -m scripts render-people --out /tmp/photographs/held --count 2000 --seed 7 --held-out
    python -m scripts train-photographs --train /tmp/photographs/train-1 /tmp/photographs/train-2 \
        --held-out /tmp/photographs/held

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
from dataclasses import dataclass
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
from app.vision.optics import (
    ASSUMED_FOV_DEG,
    PinholeCamera,
    place_on_sight_lines,
    roll_rotation,
    to_line_of_sight,
)
from app.vision.people import landmark_rows
from index.build.calibrate import expected_calibration_error
from scripts.training.fit_dense import averaged, fit_dense, moved_outputs, scaled_outputs
from scripts.training.photograph_data import WindowRows, joined, read_rows

FILE = FOLDER / "photograph_models.npz"

SEEN_FROM = 0.3
"""The network's presence from which a window teaches depth and posture."""

ENSEMBLE = 3
"""Number of networks whose mean is each of the two posture networks."""

NOBODY_FROM = 0.1
"""The network's presence from which it takes a window without people for a person."""

RIGHT_WITHIN, RIGHT_SHARE = 0.2, 0.75
"""A landmark is right within this share of the trunk; a reading is with this share of limb joints.
"""

MIN_SHOWN = 6
"""Landmarks shown, of 33, below which nobody can say whether a window shows a person."""

LANDMARK_LIMBS = landmark_rows("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
"""Rows of the limb joints among the landmarks."""


@dataclass(frozen=True)
class Sights:
    """Cameras of windows: the true ones for half of them, the assumed one for the others."""

    focal: NDArray[np.float64]
    centre: NDArray[np.float64]

    @classmethod
    def of(cls, rows: WindowRows, seed: int, known_share: float = 0.5) -> Sights:
        """Of windows, by seed."""
        longest = rows.frame_px.max(axis=1)
        assumed = longest / 2 / np.tan(np.deg2rad(ASSUMED_FOV_DEG) / 2)
        known = np.random.default_rng(seed).random(len(rows)) < known_share
        focal = np.where(known[:, None], rows.focal, assumed[:, None])
        return cls(focal, rows.centre)


def true_depths(rows: WindowRows) -> NDArray[np.float64]:
    """Depths ``(N, 33)`` along the true line of sight, about the middle of the hips."""
    rays = np.concatenate(
        [(rows.window[:, :2] - rows.centre) / rows.focal, np.ones((len(rows), 1))], axis=1
    )
    depths = np.einsum("nj,npj->np", to_line_of_sight(rays)[:, 2], rows.landmarks)
    return np.asarray(depths - depths[:, HIPS].mean(axis=1, keepdims=True), np.float64)


def places_in_frame(rows: WindowRows) -> NDArray[np.float64]:
    """Where the network saw the landmarks: ``(N, 33, 2)`` pixels."""
    offsets = (rows.points[:, :LANDMARKS, :2].astype(np.float64) - 128.0) / 256.0
    turn = roll_rotation(rows.window[:, 3])[:, :2, :2]
    turned = np.einsum("nji,npj->npi", turn, offsets)
    return np.asarray(turned * rows.window[:, None, 2:3] + rows.window[:, None, :2])


def right_landmarks(rows: WindowRows) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Whether each limb joint is right ``(N, 12)``, and the share of those shown ``(N,)``."""
    apart = np.linalg.norm(places_in_frame(rows) - rows.places, axis=2)[:, LANDMARK_LIMBS]
    trunk = np.linalg.norm(
        rows.places[:, 11:13].mean(axis=1) - rows.places[:, 23:25].mean(axis=1), axis=1
    )
    size = np.maximum(trunk, 0.2 * np.ptp(rows.places, axis=1).max(axis=1))
    right = apart < RIGHT_WITHIN * size[:, None]
    shown = rows.shown[:, LANDMARK_LIMBS]
    share = (right & shown).sum(axis=1) / np.maximum(shown.sum(axis=1), 1)
    return right, share


def depth_inputs(rows: WindowRows, sights: Sights) -> NDArray[np.float32]:
    """Features of the depth network."""
    sight = sight_features(rows.window, sights.focal, sights.centre)
    return depth_features(rows.points, rows.world, rows.sampled, sight)


def train_depth(rows: WindowRows, sights: Sights, epochs: int, seed: int) -> DenseNetwork:
    """Residual of the network's own depth, with a Laplace likelihood."""
    import torch

    residual = np.clip((true_depths(rows) - network_depths(rows.world)) / RESIDUAL_M, -12, 12)
    # Depths of hidden landmarks are known by chance at best.
    weights = np.where(rows.shown, 1.0, 0.3)

    def loss(outputs: Any, targets: Any) -> Any:
        error = (outputs[:, :LANDMARKS] - targets[:, :LANDMARKS]).abs()
        logarithm = outputs[:, LANDMARKS:].clamp(-4, 4)
        weight = targets[:, LANDMARKS:]
        return (weight * (error * torch.exp(-logarithm) + logarithm)).mean()

    return fit_dense(
        depth_inputs(rows, sights), np.hstack([residual, weights]), 2 * LANDMARKS, loss,
        hidden=(256, 128), epochs=epochs, seed=seed, dropout=0.4, noise=0.5, decay=0.1,
    )  # fmt: skip


def apply_depth(network: DenseNetwork, rows: WindowRows, sights: Sights) -> Depths:
    """Corrected depths and sigmas ``(N, 33)`` of all windows."""
    parts = []
    for first in range(0, len(rows), 4096):
        some = np.arange(first, min(first + 4096, len(rows)))
        chosen = rows.take(some)
        seen = Sights(sights.focal[some], sights.centre[some])
        parts.append(
            decode_depths(network(depth_inputs(chosen, seen)), network_depths(chosen.world))
        )
    return Depths(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def bodies(rows: WindowRows, sights: Sights, depths: Depths) -> NDArray[np.float64]:
    """Landmarks ``(N, 33, 3)`` about the hips in camera axes, as the service places them."""
    places = places_in_frame(rows)
    visibility = np.maximum(sigmoid(rows.points[:, :LANDMARKS, 3].astype(np.float64)), 0.05)
    placed = np.empty((len(rows), LANDMARKS, 3))
    for row in range(len(rows)):
        camera = PinholeCamera(sights.focal[row], sights.centre[row])
        axes = roll_rotation(rows.window[row, 3]) @ to_line_of_sight(
            camera.rays(rows.window[row, :2])
        )
        metres = rows.world[row, :LANDMARKS].astype(np.float64)
        metres = metres - metres[HIPS].mean(axis=0)
        metres[:, 2] = depths.metres[row]
        rays = camera.rays(places[row])
        points = place_on_sight_lines(metres, rays, axes, visibility[row]).points
        placed[row] = points - points[HIPS].mean(axis=0)
    return placed


def posture_inputs(rows: WindowRows, sights: Sights, depths: Depths) -> NDArray[np.float64]:
    """Shapes of the bodies, for the posture model."""
    places = places_in_frame(rows)
    width, height = (np.ptp(places[..., axis], axis=1) for axis in (0, 1))
    return posture_features(
        bodies(rows, sights, depths),
        sigmoid(rows.points[:, :LANDMARKS, 3].astype(np.float64)),
        rows.window[:, 3],
        rows.presence.astype(np.float64),
        np.maximum(width, 1.0) / np.maximum(height, 1.0),
    )


def train_posture(
    features: NDArray[np.floating], classes: NDArray[np.int64], epochs: int, seed: int,
    **options: Any,
) -> DenseNetwork:  # fmt: skip
    """The mean of a few networks with one hidden layer: their scores differ by chance."""
    import torch

    def loss(outputs: Any, targets: Any) -> Any:
        return torch.nn.functional.cross_entropy(outputs, targets[:, 0].long())

    return averaged(
        [
            fit_dense(
                features, classes[:, None].astype(np.float32), len(FRAME_POSTURES), loss,
                epochs=epochs, seed=seed + number, batch=64, **options,
            )
            for number in range(ENSEMBLE)
        ]
    )  # fmt: skip


def fit_sharpness(
    scores: NDArray[np.floating], right: NDArray[np.float64], classes: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Sharpness ``(2,)`` that makes the truth likeliest; the truth of nobody (-1) is uniform."""
    count = scores.shape[1]
    truth = np.where(classes[:, None] < 0, 1 / count, np.eye(count)[classes])

    def loss(sharpness: NDArray[np.float64]) -> float:
        return float(
            -(truth * np.log(sharpened(scores, right, sharpness) + 1e-9)).sum(axis=1).mean()
        )

    grid = [np.array([a, b]) for a in np.linspace(-0.8, 1.2, 41) for b in np.linspace(0, 0.6, 25)]
    return min(grid, key=loss)


def fit_platt(odds: NDArray[np.floating], true: NDArray[np.bool_]) -> tuple[float, float]:
    """Factor and offset of log odds that make the truth likeliest."""
    model = LogisticRegression(C=1e3).fit(odds[:, None], true)
    return float(model.coef_[0, 0]), float(model.intercept_[0])


def train_trust(
    features: NDArray[np.float64], person: NDArray[np.bool_], right: NDArray[np.bool_],
    epochs: int, seed: int,
) -> DenseNetwork:  # fmt: skip
    """Log odds of a person, and of right landmarks given a person."""
    import torch

    def loss(outputs: Any, targets: Any) -> Any:
        each = torch.nn.functional.binary_cross_entropy_with_logits(
            outputs, targets, reduction="none"
        )
        return each[:, 0].mean() + (each[:, 1] * targets[:, 0]).mean()

    return fit_dense(
        features, np.column_stack([person, right]), 2, loss,
        hidden=(32,), epochs=epochs, seed=seed, batch=64, dropout=0.2, noise=0.2, decay=0.1,
    )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--train", type=Path, nargs="+", required=True, help="folders of render_people"
    )
    parser.add_argument("--held-out", type=Path, required=True, help="another, held out")
    parser.add_argument("--out", type=Path, default=FILE)
    parser.add_argument("--epochs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    train = joined([read_rows(folder) for folder in options.train])
    held = read_rows(options.held_out)
    models = train_models(train, held, options.epochs, options.seed)
    np.savez_compressed(options.out, **models)
    print(f"{options.out}: {options.out.stat().st_size} bytes")
    if options.out.resolve() == FILE:
        name_shipped()


def name_shipped() -> None:
    """Write the hash of the models that ship into ``models.json``."""
    document = json.loads(MODELS.read_text())
    document["photograph_models"] = {
        "file": FILE.name,
        "sha256": hashlib.sha256(FILE.read_bytes()).hexdigest(),
        "what": "Depth of landmarks with its sigma, posture of a frame, and whether a window "
        "shows a person and its landmarks are right: small networks, run by NumPy",
        "source": "trained on rendered people, see scripts/training/render_people.py",
        "license": "Apache-2.0",
        "made_by": "scripts/training/train_photograph_models.py",
    }
    MODELS.write_text(json.dumps(document, indent=1) + "\n")


def train_models(train: WindowRows, held: WindowRows, epochs: int, seed: int) -> dict[str, Any]:
    """Arrays of all models; figures on the second half of the held-out windows are printed."""
    begun = time.monotonic()

    def say(text: str) -> None:
        print(f"[{time.monotonic() - begun:5.0f} s] {text}", flush=True)

    sights, held_sights = Sights.of(train, seed), Sights.of(held, seed + 1)
    teaches = (train.posture >= 0) & (train.presence > SEEN_FROM)
    halves = train.scene % 2 == 0

    def part(rows: NDArray[np.bool_], number: int) -> DenseNetwork:
        chosen = Sights(sights.focal[rows], sights.centre[rows])
        return train_depth(train.take(rows), chosen, epochs, seed + number)

    # Posture and trust learn from depths that were corrected by a model of other photographs.
    crossed = Depths(np.zeros((len(train), LANDMARKS)), np.zeros((len(train), LANDMARKS)))
    for number, half in enumerate((halves, ~halves)):
        network = part(teaches & half, number)
        rows = np.flatnonzero(~half)
        found = apply_depth(
            network, train.take(rows), Sights(sights.focal[rows], sights.centre[rows])
        )
        crossed.metres[rows], crossed.sigmas[rows] = found.metres, found.sigmas
        say(f"depth of half {number + 1}")
    depth = part(teaches, 2)
    say(f"depth from {teaches.sum()} windows")

    calibrates = held.scene % 2 == 0
    seen = (held.posture >= 0) & (held.presence > SEEN_FROM)
    truth = true_depths(held)
    found = apply_depth(depth, held, held_sights)
    error = np.abs(found.metres - truth)
    # Rescaled, so that the mean sigma of these rows is their mean absolute error.
    fit_rows = (seen & calibrates)[:, None] & held.shown
    offsets = np.zeros(2 * LANDMARKS)
    offsets[LANDMARKS:] = np.log(error[fit_rows].mean() / found.sigmas[fit_rows].mean())
    depth = moved_outputs(depth, offsets)
    found = apply_depth(depth, held, held_sights)
    report_depth(held, found, truth, seen & ~calibrates, say)

    trust = _trust(train, crossed, epochs, seed)
    trust = _calibrated(trust, held, found, calibrates)
    report_trust(trust, held, found, say)
    right = TrustModel(trust).probabilities(_trust_inputs(held, found))[:, 1]

    seen_bodies = [
        np.hstack([posture_inputs(rows, cameras, depths), _trust_inputs(rows, depths)])
        for rows, cameras, depths in ((train, sights, crossed), (held, held_sights, found))
    ]
    around = [region_features(rows.sampled) for rows in (train, held)]
    classes = train.posture[teaches]
    by_body = train_posture(
        seen_bodies[0][teaches], classes, epochs, seed + 10,
        hidden=(48,), dropout=0.3, noise=0.3,
    )  # fmt: skip
    by_surroundings = train_posture(
        np.hstack([seen_bodies[0], around[0]])[teaches], classes, epochs, seed + 20,
        hidden=(96,), dropout=0.4, noise=0.5, decay=0.1,
    )  # fmt: skip
    posture = PostureModel(by_body, by_surroundings, np.zeros(2))
    scores = posture.scores(seen_bodies[1], around[1])
    # Windows without people that the network takes for people limit the certainty.
    asked = (held.presence > NOBODY_FROM) & calibrates
    sharpness = fit_sharpness(scores[asked], right[asked], held.posture[asked])
    say(f"posture: sharpness {sharpness[0]:.2f} {sharpness[1]:.2f}")
    tests = seen & ~calibrates
    report_posture(sharpened(scores, right, sharpness)[tests], held.posture[tests], say)
    arrays: dict[str, Any] = {"posture.trust": sharpness}
    networks = {"depth": depth, "doubt": trust, "posture.by_body": by_body,
                "posture.by_surroundings": by_surroundings}  # fmt: skip
    for name, network in networks.items():
        arrays |= network.arrays(name)
    return arrays


def _calibrated(
    trust: DenseNetwork, held: WindowRows, depths: Depths, rows: NDArray[np.bool_]
) -> DenseNetwork:
    """The same trust, its log odds fitted to the truth of some windows."""
    decided = _decided(held) & rows
    odds = trust(_trust_inputs(held, depths))
    person = held.posture >= 0
    _, share = right_landmarks(held)
    fits = [
        fit_platt(odds[decided, 0], person[decided]),
        fit_platt(odds[decided & person, 1], share[decided & person] >= RIGHT_SHARE),
    ]
    factors, offsets = np.array(fits).T
    return moved_outputs(scaled_outputs(trust, factors), offsets)


def _trust_inputs(rows: WindowRows, depths: Depths) -> NDArray[np.float64]:
    return trust_features(rows.points, rows.world, rows.presence, rows.last, depths.sigmas)


def _decided(rows: WindowRows) -> NDArray[np.bool_]:
    """Windows that show nobody, or enough of a person to be sure."""
    return np.asarray((rows.posture < 0) | (rows.shown.sum(axis=1) >= MIN_SHOWN))


def _trust(train: WindowRows, depths: Depths, epochs: int, seed: int) -> DenseNetwork:
    decided = _decided(train)
    _, share = right_landmarks(train)
    person = train.posture >= 0
    return train_trust(
        _trust_inputs(train, depths)[decided], person[decided],
        (person & (share >= RIGHT_SHARE))[decided], epochs, seed + 30,
    )  # fmt: skip


def report_depth(
    held: WindowRows, found: Depths, truth: NDArray[np.float64], rows: NDArray[np.bool_], say: Any
) -> None:
    """Depth of limb joints before and after, and whether sigmas rank errors."""
    own = np.abs(network_depths(held.world) - truth)[rows][:, LANDMARK_LIMBS]
    error, sigma = (
        np.abs(found.metres - truth)[rows][:, LANDMARK_LIMBS],
        found.sigmas[rows][:, LANDMARK_LIMBS],
    )
    shown = held.shown[rows][:, LANDMARK_LIMBS]
    quartile = np.digitize(sigma, np.quantile(sigma, [0.25, 0.5, 0.75]))
    by = " ".join(f"{1e3 * error[quartile == q].mean():.0f}" for q in range(4))
    say(
        f"depth of limb joints {1e3 * own.mean():.0f} -> {1e3 * error.mean():.0f} mm "
        f"(shown {1e3 * own[shown].mean():.0f} -> {1e3 * error[shown].mean():.0f}); by quartile "
        f"of sigma {by}; mean sigma {1e3 * sigma.mean():.0f}"
    )


def report_posture(given: NDArray[np.float64], classes: NDArray[np.int64], say: Any) -> None:
    """Confusion, calibration, and how often sure estimates are right."""
    best, sure = given.argmax(axis=1), given.max(axis=1)
    right = best == classes
    say(
        f"posture right {right.mean():.3f}, ECE {expected_calibration_error(sure, right):.3f}, "
        "above 0.8: "
        f"{(sure > 0.8).mean():.2f} of windows, right {right[sure > 0.8].mean():.3f}"
    )
    for number, name in enumerate(FRAME_POSTURES):
        rows = classes == number
        shares = np.bincount(best[rows], minlength=len(FRAME_POSTURES)) / max(rows.sum(), 1)
        print(f"    {name:10s} {rows.sum():5d}  " + "  ".join(f"{s:.2f}" for s in shares))


def report_trust(network: DenseNetwork, held: WindowRows, depths: Depths, say: Any) -> None:
    """How well people and right landmarks are distinguished from others."""
    decided = _decided(held) & (held.scene % 2 == 1)
    given = TrustModel(network).probabilities(_trust_inputs(held, depths)[decided])
    person = (held.posture >= 0)[decided]
    _, share = right_landmarks(held)
    right = person & (share[decided] >= RIGHT_SHARE)
    own = held.presence[decided]
    say(
        f"person: AUC {roc_auc_score(person, given[:, 0]):.3f} (the network's presence "
        f"{roc_auc_score(person, own):.3f}), "
        f"ECE {expected_calibration_error(given[:, 0], person):.3f}; "
        "right: AUC "
        f"{roc_auc_score(right, given[:, 1]):.3f} ({roc_auc_score(right, own):.3f}), "
        f"ECE {expected_calibration_error(given[:, 1], right):.3f}, share {right.mean():.2f}"
    )


if __name__ == "__main__":
    main()
