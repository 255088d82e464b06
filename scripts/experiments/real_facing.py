"""Fit and cross-validate the weights by which the photograph tells where a person faces.

The loss is the von Mises likelihood of the reference azimuths with a ridge; the folds are by
photograph, so that nobody is in training and test at once. Each person is shown mirrored too,
with the opposite azimuth, a little displaced, at lower resolutions, and with the face pixelated as
in anonymised videos.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import i0e, i1e
from tqdm import tqdm

from app.vision.facing_evidence import (
    WEIGHTS_PATH,
    AzimuthBelief,
    FacingModel,
    head_features,
    head_window,
)
from app.vision.network import PersonNetwork
from app.vision.people import Silhouette
from app.vision.resampling import resize
from app.vision.segment import Segmenter
from scripts.experiments.real_data import StreetPerson

FOLDS = 6
RIDGE = 0.02
SMALL_PX = (48, 96)
"""Heights at which every person is shown besides their own."""

FACE_CELLS = (3, 4, 5)
"""Into how many squares each way faces are pixelated."""

# Where the face is, in shares of the silhouette's height: below the crown, and as wide.
_FACE_ROWS, _FACE_WIDTH = (0.035, 0.145), 0.11


@dataclass(frozen=True)
class HeadSamples:
    """Head features of people.

    Parameters
    ----------
    plain, mirrored : (N, V, F) float64 array
        V variants of each of N people: with :data:`FACE_CELLS`, at :data:`SMALL_PX`, displaced, and
        last as they are.
    azimuth : (N,) float64 array
        Radians.
    group : (N,) int64 array
        Number of the photograph.
    """

    plain: NDArray[np.float64]
    mirrored: NDArray[np.float64]
    azimuth: NDArray[np.float64]
    group: NDArray[np.int64]


def read_samples(
    people: Sequence[StreetPerson], segmenter: Segmenter, network: PersonNetwork
) -> HeadSamples:
    """Look at the heads of people, found by the segmenter in their true boxes."""
    plain, mirrored, azimuth, group = [], [], [], []
    names = sorted({person.photograph.name for person in people})
    for person in tqdm(people, desc="heads", unit="person"):
        frame = person.photograph.frame
        silhouette = segmenter.segment(frame, person.photograph.boxes)[person.label - 1]
        if silhouette is None:
            continue
        plain.append(_variants(network, frame, silhouette))
        mirrored.append(_variants(network, frame, silhouette, mirror=True))
        azimuth.append(np.deg2rad(person.reference.azimuth_deg))
        group.append(names.index(person.photograph.name))
    return HeadSamples(*map(np.array, (plain, mirrored, azimuth, group)))


def _variants(
    network: PersonNetwork, frame: NDArray[np.uint8], one: Silhouette, *, mirror: bool = False
) -> NDArray[np.float64]:
    left, top, side, _ = head_window(one)
    step = round(0.06 * side)
    found = [(pixelated(frame, one, cells), (left, top, side, side)) for cells in FACE_CELLS]
    for height in SMALL_PX:
        scale = min(1.0, height / len(one.crop))
        size = round(frame.shape[1] * scale), round(frame.shape[0] * scale)
        small = resize(frame, *size)
        edge = max(2, round(side * scale))
        found.append((small, (round(left * scale), round(top * scale), edge, edge)))
    found.append((frame, (left - step, top + step, side, side)))
    found.append((frame, (left + step, top - step, side + step, side + step)))
    found.append((frame, (left, top, side, side)))
    if mirror:
        found = [
            (np.ascontiguousarray(f[:, ::-1]), (f.shape[1] - x - w, y, w, h))
            for f, (x, y, w, h) in found
        ]
    return np.array([head_features(network, *one) for one in found])


def pixelated(frame: NDArray[np.uint8], one: Silhouette, cells: int) -> NDArray[np.uint8]:
    """Make a face unrecognisable: ``cells`` plain squares each way are left of it."""
    left, _, side, _ = head_window(one)
    rows = len(one.crop)
    middle, half = left + side / 2, _FACE_WIDTH * rows / 2
    y0, y1 = (round(one.top + share * rows) for share in _FACE_ROWS)
    x0, x1 = round(middle - half), round(middle + half)
    changed = frame.copy()
    face = changed[max(0, y0) : max(0, y1), max(0, x0) : max(0, x1)]
    if face.size:
        small = cv2.resize(face, (cells, cells), interpolation=cv2.INTER_AREA)
        face[:] = cv2.resize(small, face.shape[1::-1], interpolation=cv2.INTER_NEAREST)
    return changed


def fit(samples: HeadSamples, chosen: NDArray[np.bool_], ridge: float = RIDGE) -> FacingModel:
    """Fit to the chosen people."""
    variants = samples.plain.shape[1]
    count = int(chosen.sum())
    features = np.concatenate([samples.plain[chosen], samples.mirrored[chosen]]).reshape(
        2 * count * variants, -1
    )
    azimuth = np.repeat(samples.azimuth[chosen], variants)
    azimuth = np.concatenate([azimuth, -azimuth])
    mean, spread = features.mean(axis=0), features.std(axis=0) + 1e-6
    design = (features - mean) / (spread * np.sqrt(features.shape[1]))
    cosine, sine = np.cos(azimuth), np.sin(azimuth)

    # A bias for the front only: left and right are alike.
    def loss(flat: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        front, left = flat[:-1].reshape(2, -1) @ design.T
        front = front + flat[-1]
        kappa = np.hypot(front, left) + 1e-9
        shrink = i1e(kappa) / i0e(kappa) / kappa
        gradient = np.stack([shrink * front - cosine, shrink * left - sine])
        value = np.log(i0e(kappa)) + kappa - front * cosine - left * sine
        # Variants of a person count as one.
        total = value.sum() / (2 * variants) + 0.25 * ridge * (flat[:-1] ** 2).sum()
        slopes = (gradient @ design).ravel() / (2 * variants) + 0.5 * ridge * flat[:-1]
        return float(total), np.append(slopes, gradient[0].sum() / (2 * variants))

    start = np.zeros(2 * design.shape[1] + 1)
    solution = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": 300}).x
    weights = solution[:-1].reshape(2, -1) / (spread * np.sqrt(features.shape[1]))
    bias = np.array([solution[-1], 0.0]) - weights @ mean
    unaware = FacingModel(weights, bias, mean, spread, np.array([0.0, 1.0]))
    usual = np.percentile(unaware.strangeness(features), [50, 95])
    return replace(unaware, usual=usual)


def folds(group: NDArray[np.int64], seed: int = 0) -> NDArray[np.int64]:
    """Fold of every person, by photograph."""
    drawn = np.random.default_rng(seed).permutation(int(group.max()) + 1) % FOLDS
    return np.asarray(drawn[group])


def cross_validated(samples: HeadSamples, ridge: float = RIDGE) -> list[FacingModel]:
    """Weights for each person, fitted without their photograph."""
    fold = folds(samples.group)
    by_fold = [fit(samples, fold != held, ridge) for held in range(FOLDS)]
    return [by_fold[held] for held in fold.tolist()]


def facing_figures(
    samples: HeadSamples, weights: Sequence[FacingModel], variant: int
) -> dict[str, float]:
    """How well the photograph alone tells the azimuth, in one of the variants."""
    beliefs = [
        one.belief(features[variant]) or AzimuthBelief(0.0, 0.0)
        for one, features in zip(weights, samples.plain, strict=True)
    ]
    found = np.array([[belief.front, belief.left] for belief in beliefs])
    front = np.cos(samples.azimuth) > 0
    clear = np.abs(np.cos(samples.azimuth)) > 0.5
    error = np.arctan2(found[:, 1], found[:, 0]) - samples.azimuth
    error = np.abs(np.rad2deg((error + np.pi) % (2 * np.pi) - np.pi))
    probability = np.array([belief.front_probability() for belief in beliefs])
    density = np.array(
        [
            float(belief.likelihood(np.rad2deg(azimuth)))
            for belief, azimuth in zip(beliefs, samples.azimuth, strict=True)
        ]
    )
    right = (probability > 0.5) == front
    return {
        "people": len(front),
        "auc": auc(found[:, 0], front),
        "auc_clear": auc(found[clear, 0], front[clear]),
        "right": float(right.mean()),
        "right_clear": float(right[clear].mean()),
        "median_error_deg": float(np.median(error)),
        "within_90_deg": float((error < 90).mean()),
        "log_likelihood": float(np.log(density).mean()),
        "brier": float(((probability - front) ** 2).mean()),
    }


def auc(scores: NDArray[np.float64], positive: NDArray[np.bool_]) -> float:
    """Area under the ROC curve: how often a positive scores above a negative."""
    above, below = scores[positive][:, None], scores[~positive][None]
    return float(((above > below) + 0.5 * (above == below)).mean())


def write_model(model: FacingModel, path: Path = WEIGHTS_PATH) -> None:
    """Write the file that the service reads."""
    arrays = {f.name: getattr(model, f.name).astype(np.float32) for f in fields(model)}
    np.savez_compressed(path, **arrays)
