"""Train the network of camera elevations: ``elevation.npz``.

It learns from the index's skeletons, seen as its entries' cameras see them, with the errors that
landmarks have in depth. Every third clip is held out; the errors on these are printed.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.networks.shipped import FOLDER
from app.tracking.seen_body import elevation_features
from app.vision.judgement import load_photograph_models
from app.vision.people import LANDMARK_NAMES
from index import DEFAULT_PATH
from index.artefact import load_index
from index.posture import POSTURES, classify_postures
from index.skeleton import BODY_UP, LIMB_ROWS, LIMBS, camera_rotation, rows
from index.store import PoseIndex
from scripts.training.fit_dense import fit_dense
from scripts.training.shipping import record_hash

ENTRIES, SEED = 80_000, 0
DEPTH_ERROR_M = (0.04, 0.12)
"""Expected absolute errors of landmarks' depths."""

PICTURE_ERROR_M = 0.03


def seen_limbs(
    index: PoseIndex, entries: NDArray[np.int64], generator: np.random.Generator
) -> NDArray[np.float64]:
    """Draw the limbs ``(N, 12, 3)`` of entries as landmarks would show them."""
    shown = index.entries[entries]
    limbs = index.skeletons[shown["skeleton"]][:, LIMB_ROWS].astype(np.float64)
    angles = zip(shown["azimuth_deg"].tolist(), shown["elevation_deg"].tolist(), strict=True)
    limbs = limbs @ np.array([camera_rotation(*pair).T for pair in angles])
    columns = rows(*LIMBS, among=LANDMARK_NAMES)
    covariance = load_photograph_models().depth.covariance(np.ones(len(LANDMARK_NAMES)))
    errors = generator.multivariate_normal(
        np.zeros(len(LIMBS)), covariance[np.ix_(columns, columns)], len(limbs)
    )
    limbs[..., :2] += generator.normal(0, PICTURE_ERROR_M, limbs[..., :2].shape)
    limbs[..., 2] += generator.uniform(*DEPTH_ERROR_M, (len(limbs), 1)) * errors
    return np.asarray(limbs)


def main(arguments: Sequence[str] | None = None) -> None:
    """Train as the command line asks."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=FOLDER / "elevation.npz")
    parser.add_argument("--index", type=Path, default=DEFAULT_PATH)
    options = parser.parse_args(arguments)
    import torch

    index, generator = load_index(options.index), np.random.default_rng(SEED)
    entries = generator.choice(len(index.entries), ENTRIES, replace=False)
    features = elevation_features(seen_limbs(index, entries, generator))
    truth = index.entries["elevation_deg"][entries].astype(np.float64)
    skeletons = index.entries["skeleton"][entries]
    held = index.skeleton_labels["clip"][skeletons] % 3 == 0
    network = fit_dense(
        features[~held], truth[~held, None], 1, torch.nn.functional.mse_loss,
        hidden=(32, 32), epochs=40, seed=SEED, rate=5e-3, dropout=0.0, noise=0.0,
    )  # fmt: skip
    errors = network(features[held])[:, 0] - truth[held]
    postures = classify_postures(index.skeletons[skeletons[held]].astype(np.float64), BODY_UP)
    for number, posture in enumerate(POSTURES):
        if (rows_of := postures == number).any():
            one = errors[rows_of]
            print(f"{posture:12s} {len(one):6d} rms {np.sqrt(np.mean(one**2)):5.1f} degrees")
    arrays: dict[str, Any] = {**network.arrays("elevation")}
    np.savez(options.out, **arrays)
    record_hash(options.out)
