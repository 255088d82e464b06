"""Fitting the confidence on bodies and clips that the index does not hold."""

from __future__ import annotations

import logging
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from tqdm import tqdm

from index.confidence import FEATURES, RERANKING_FEATURES, RIGHT_BELOW_PX, Calibration, signs
from index.matching import DEFAULT_HYPOTHESES, votes_of
from index.posture import POSTURES
from index.silhouette_matching import match_silhouette
from index.skeleton import JOINTS, LIMB_ROWS, exchange_sides, rotate_clockwise
from index.store import PoseIndex
from scripts.index.descriptor_learning import view_joints
from scripts.index.noise import degrade_all
from scripts.index.simulate import Simulation
from scripts.index.views import MAX_OWN_ROLL_DEG

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Queries:
    """Silhouettes to ask an index for, with their true joints."""

    silhouettes: NDArray[np.uint8]  # (Q, 128, 48)
    joints_2d: NDArray[np.floating]  # (Q, 19, 2): pixels of the normalised frame
    # (Q, 19, 3): axes of an upright camera, metres, pelvis at the origin.
    joints_3d: NDArray[np.floating]
    # (Q,): roll of the camera if it was rolled for a wide silhouette, else 0.
    roll_deg: NDArray[np.floating]

    def __post_init__(self) -> None:
        count = len(self.silhouettes)
        for name, array, shape in (
            ("joints_2d", self.joints_2d, (count, JOINTS, 2)),
            ("joints_3d", self.joints_3d, (count, JOINTS, 3)),
        ):
            if array.shape != shape:
                raise ValueError(f"expected {name} of shape {shape}, got {array.shape}")

    def __len__(self) -> int:
        return len(self.silhouettes)

    def take(self, rows: NDArray[np.integer]) -> Queries:
        """Some of them."""
        return Queries(
            self.silhouettes[rows], self.joints_2d[rows], self.joints_3d[rows], self.roll_deg[rows]
        )

    @classmethod
    def of(cls, simulation: Simulation) -> Queries:
        """The silhouettes of a simulation, not degraded."""
        joints_3d, joints_2d = view_joints(simulation)
        roll_deg = simulation.entries["roll_deg"].astype(np.float64)
        # A roll of a few degrees is the camera's own.
        roll_deg = np.where(np.abs(roll_deg) > MAX_OWN_ROLL_DEG, roll_deg, 0.0)
        for row in np.flatnonzero(roll_deg):
            joints_3d[row] = rotate_clockwise(joints_3d[row], -roll_deg[row])
        return cls(simulation.silhouettes(slice(None)), joints_2d, joints_3d, roll_deg)

    def degraded(self, seed: int) -> Queries:
        """The same queries with the faults of photographs; see :mod:`scripts.index.noise`."""
        silhouettes, joints_2d = degrade_all(
            self.silhouettes, self.joints_2d, np.random.default_rng(seed)
        )
        return replace(self, silhouettes=silhouettes, joints_2d=joints_2d)

    def half_degraded(self, seed: int) -> Queries:
        """Every second one degraded."""
        degraded, odd = self.degraded(seed), np.arange(len(self)) % 2 == 1
        return replace(
            self,
            silhouettes=np.where(odd[:, None, None], degraded.silhouettes, self.silhouettes),
            joints_2d=np.where(odd[:, None, None], degraded.joints_2d, self.joints_2d),
        )


@dataclass(frozen=True)
class Trial:
    """Answers of an index to simulated queries, and their errors."""

    # (Q, N, F): columns are :data:`index.confidence.FEATURES`, or
    # :data:`index.confidence.RERANKING_FEATURES` if the index has a network. 0 where an index has
    # fewer than N poses to offer.
    features: NDArray[np.float64]
    confidence: NDArray[np.float64]  # (Q, N): as features
    # (Q, N, 19): error of each joint, normalised pixels; infinite where there is no hypothesis.
    joint_errors_px: NDArray[np.float64]
    # (Q, N): mean joint error if left and right are exchanged, as an outline seen from the height
    # of the hips cannot tell them.
    twin_error_px: NDArray[np.float64]
    # (Q, N): mean joint error in camera axes, pelvis on pelvis, metres.
    error_m: NDArray[np.float64]
    votes: NDArray[np.float64]  # (Q, 10): see :func:`index.matching.votes_of`
    # (Q, 10): share of each of :data:`index.posture.POSTURES`, as answered.
    postures: NDArray[np.float64]

    def take(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> Trial:
        """The answers to some queries."""
        return Trial(*(getattr(self, field.name)[rows] for field in fields(self)))

    @property
    def error_px(self) -> NDArray[np.float64]:
        """Mean joint errors in the normalised frame ``(Q, N)``."""
        return self.joint_errors_px.mean(axis=-1)

    @property
    def right(self) -> NDArray[np.bool_]:
        """Which hypotheses are right ``(Q, N)``, by their limb joints."""
        return self.joint_errors_px[..., LIMB_ROWS].mean(axis=-1) < RIGHT_BELOW_PX


def run_trial(index: PoseIndex, queries: Queries, *, n: int = DEFAULT_HYPOTHESES) -> Trial:
    """Ask an index for ``n`` hypotheses of each silhouette, whose skeletons are known."""
    names = FEATURES if index.reranker is None else RERANKING_FEATURES
    features = np.zeros((len(queries), n, len(names)))
    confidence = np.zeros((len(queries), n))
    joint_errors_px = np.full((len(queries), n, JOINTS), np.inf)
    twin_error_px, error_m = (np.full((len(queries), n), np.inf) for _ in range(2))
    votes, postures = (np.zeros((len(queries), len(POSTURES))) for _ in range(2))
    for row in tqdm(range(len(queries)), desc="matching", unit="query", disable=None):
        roll_deg = float(queries.roll_deg[row])
        found = match_silhouette(index, queries.silhouettes[row], n, roll_deg=roll_deg)
        votes[row], postures[row] = votes_of(found.voters), found.postures
        for rank, hypothesis in enumerate(found.hypotheses[:n]):
            features[row, rank] = hypothesis.features
            twin = exchange_sides(hypothesis.points_2d)
            apart_2d = hypothesis.points_2d[:JOINTS] - queries.joints_2d[row]
            apart_twin = twin[:JOINTS] - queries.joints_2d[row]
            apart_3d = hypothesis.points_3d[:JOINTS] - queries.joints_3d[row]
            confidence[row, rank] = hypothesis.confidence
            joint_errors_px[row, rank] = np.linalg.norm(apart_2d, axis=-1)
            twin_error_px[row, rank] = np.linalg.norm(apart_twin, axis=-1).mean()
            error_m[row, rank] = np.linalg.norm(apart_3d, axis=-1).mean()
    return Trial(features, confidence, joint_errors_px, twin_error_px, error_m, votes, postures)


_RIDGE = 1e-3  # Keeps weights finite where all hypotheses are right, or none.


def fit_calibration(trial: Trial, features: tuple[str, ...] = FEATURES) -> Calibration:
    """Logistic regression of the correctness of hypotheses on their features.

    No weight is against :func:`index.confidence.signs`.
    """
    offered = np.isfinite(trial.error_px)
    rows = trial.features[offered]
    sides = np.where(trial.right[offered], 1.0, -1.0)
    middle, scale = rows.mean(axis=0), rows.std(axis=0) + 1e-9
    inputs = np.column_stack([(rows - middle) / scale, np.ones(len(rows))])

    def loss(weights: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        margins = sides * (inputs @ weights)
        pull = sides / (1 + np.exp(np.minimum(margins, 30)))
        value = np.logaddexp(0, -margins).sum() + _RIDGE * (weights[:-1] ** 2).sum()
        return float(value), 2 * _RIDGE * np.append(weights[:-1], 0) - pull @ inputs

    bounds = [(0, None) if sign > 0 else (None, 0) for sign in signs(features)]
    found = minimize(
        loss, np.zeros(inputs.shape[1]), jac=True, bounds=[*bounds, (None, None)], tol=1e-10
    ).x
    weights = found[:-1] / scale
    bias = float(found[-1] - weights @ middle)
    return Calibration(tuple(weights.round(4).tolist()), round(bias, 4), features)


def calibrate(
    index: PoseIndex, queries: Queries, features: tuple[str, ...] = FEATURES
) -> Calibration:
    """Fit the confidence on an index's answers to silhouettes of clips and bodies that it lacks."""
    trial = run_trial(index, queries)
    calibration = fit_calibration(trial, features)
    confidence = calibration.probability(trial.features.reshape(-1, len(features)))
    log.info(
        f"Confidence fitted on {len(queries)} silhouettes that were held out, "
        "every second one degraded: "
        f"{100 * trial.right[:, 0].mean():.1f} % right at rank 1, "
        f"{100 * trial.right.any(axis=1).mean():.1f} % within 7, calibration error "
        f"{expected_calibration_error(confidence, trial.right):.3f}."
    )
    return calibration


def expected_calibration_error(confidence: NDArray[np.floating], right: NDArray[np.bool_]) -> float:
    """Mean gap between confidence and share of right answers over ten bins of equal width."""
    bins = 10
    bin_of = np.minimum((confidence.ravel() * bins).astype(int), bins - 1)
    gaps = [
        abs(confidence.ravel()[bin_of == b].mean() - right.ravel()[bin_of == b].mean())
        * (bin_of == b).mean()
        for b in range(bins)
        if (bin_of == b).any()
    ]
    return float(sum(gaps))


def calibration_floor(confidence: NDArray[np.floating]) -> float:
    """Mean :func:`expected_calibration_error` of confidences that are the true probabilities.

    Of so few answers, the shares of right ones differ from them by chance.
    """
    generator, draws = np.random.default_rng(0), 20
    right = generator.random((draws, *confidence.shape)) < confidence
    return float(np.mean([expected_calibration_error(confidence, one) for one in right]))
