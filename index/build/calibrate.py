"""Fitting the confidence on bodies and clips that the index does not hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sklearn.linear_model import LogisticRegression
from tqdm import tqdm

from index.build.learn import view_joints
from index.build.simulate import Simulation
from index.confidence import FEATURES, RIGHT_BELOW_PX, Calibration
from index.matching import match_with_features
from index.skeleton import JOINTS
from index.store import PoseIndex

HYPOTHESES = 7


@dataclass(frozen=True)
class Trial:
    """What an index answered to simulated queries, and how far off it was.

    Parameters
    ----------
    features : (Q, N, F) float64 array
        Columns are :data:`index.confidence.FEATURES`.
    confidence : (Q, N) float64 array
    error_px : (Q, N) float64 array
        Mean joint error in the normalised frame.
    error_m : (Q, N) float64 array
        Mean joint error in camera axes, pelvis on pelvis, metres.
    """

    features: NDArray[np.float64]
    confidence: NDArray[np.float64]
    error_px: NDArray[np.float64]
    error_m: NDArray[np.float64]

    @property
    def right(self) -> NDArray[np.bool_]:
        """Which hypotheses are right ``(Q, N)``."""
        return self.error_px < RIGHT_BELOW_PX


def run_trial(
    index: PoseIndex,
    queries: Simulation,
    silhouettes: NDArray[np.uint8] | None = None,
    *,
    n: int = HYPOTHESES,
    progress: bool = False,
) -> Trial:
    """Ask an index for every silhouette of a simulation.

    Parameters
    ----------
    index : PoseIndex
    queries : Simulation
        Where the true skeletons are.
    silhouettes : (Q, 128, 48) uint8 array, optional
        What to ask instead of the simulated silhouettes, say their noisy versions.
    n : int
        Hypotheses per query.
    progress : bool
        Whether to draw a progress bar.
    """
    joints_3d, joints_2d = view_joints(queries)
    features = np.empty((len(queries), n, len(FEATURES)))
    confidence, error_px, error_m = (np.empty((len(queries), n)) for _ in range(3))
    for row in tqdm(range(len(queries)), desc="matching", unit="query", disable=not progress):
        asked = (
            queries.silhouettes(slice(row, row + 1))[0] if silhouettes is None else silhouettes[row]
        )
        hypotheses, features[row] = match_with_features(index, asked, n)
        for rank, hypothesis in enumerate(hypotheses):
            apart_2d = hypothesis.points_normalised[:JOINTS] - joints_2d[row]
            apart_3d = hypothesis.points_3d[:JOINTS] - joints_3d[row]
            confidence[row, rank] = hypothesis.confidence
            error_px[row, rank] = np.linalg.norm(apart_2d, axis=-1).mean()
            error_m[row, rank] = np.linalg.norm(apart_3d, axis=-1).mean()
    return Trial(features, confidence, error_px, error_m)


def fit_calibration(trial: Trial) -> Calibration:
    """Logistic regression of being right on what a hypothesis shows of itself."""
    features = trial.features.reshape(-1, len(FEATURES))
    model = LogisticRegression(C=1e3, max_iter=1000).fit(features, trial.right.ravel())
    return Calibration(tuple(float(w) for w in model.coef_[0]), float(model.intercept_[0]))


def expected_calibration_error(
    confidence: NDArray[np.floating], right: NDArray[np.bool_], bins: int = 10
) -> float:
    """Mean gap between confidence and share of right answers over equal-width bins."""
    bin_of = np.minimum((confidence.ravel() * bins).astype(int), bins - 1)
    gaps = [
        abs(confidence.ravel()[bin_of == b].mean() - right.ravel()[bin_of == b].mean())
        * (bin_of == b).mean()
        for b in range(bins)
        if (bin_of == b).any()
    ]
    return float(sum(gaps))
