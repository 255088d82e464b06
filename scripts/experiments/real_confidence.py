"""Whether confidences of the poses of real people mean what they say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from sklearn.linear_model import LogisticRegression

from app.vision.weights import fitted as constants_of
from scripts.experiments.real_poses import Trial


def fit_confidence(trials: Sequence[Trial]) -> tuple[float, float]:
    """Fit slope and bias that :mod:`app.estimation.reranking` makes a confidence with.

    Parameters
    ----------
    trials : sequence of Trial
        Of people whose keypoints were read.
    """
    agreement = np.concatenate([_agreement(t) for t in trials])
    model = LogisticRegression(C=1e3).fit(
        agreement[:, None], np.concatenate([t.right for t in trials])
    )
    return float(model.coef_[0, 0]), float(model.intercept_[0])


def cross_validated(trials: Sequence[Trial]) -> list[Trial]:
    """The same trials with the confidences that people in the other half of the photographs give.

    Slope and bias of the service are fitted to both halves.
    """
    fitted = {odd: fit_confidence([t for t in trials if t.odd != odd]) for odd in (False, True)}

    def refitted(trial: Trial) -> Trial:
        slope, bias = fitted[trial.odd]
        confidence = 1 / (1 + np.exp(-slope * _agreement(trial) - bias))
        return replace(trial, confidence=confidence)

    return [refitted(trial) for trial in trials]


def _agreement(trial: Trial) -> NDArray[np.float64]:
    """What the confidences of the service, ``(N,)``, were made of."""
    confidence = np.clip(trial.confidence, 1e-9, 1 - 1e-9)
    constants = constants_of("confidence")
    odds = np.log(confidence / (1 - confidence))
    return np.asarray((odds - constants["offset"]) / constants["slope"])


def reliability(trials: Sequence[Trial], bins: int = 5) -> list[dict[str, float]]:
    """Confidences stated and met, of all hypotheses, in bins of equal width."""
    confidence = np.concatenate([t.confidence for t in trials])
    right = np.concatenate([t.right for t in trials])
    bin_of = np.minimum((confidence * bins).astype(int), bins - 1)
    return [
        {
            "from": b / bins,
            "to": (b + 1) / bins,
            "hypotheses": int((bin_of == b).sum()),
            "stated": float(confidence[bin_of == b].mean()),
            "right": float(right[bin_of == b].mean()),
        }
        for b in range(bins)
        if (bin_of == b).any()
    ]


def calibration_error(trials: Sequence[Trial]) -> float:
    """Expected calibration error of all hypotheses over ten bins, 0 to 1."""
    table = reliability(trials, bins=10)
    total = sum(row["hypotheses"] for row in table)
    gaps = (row["hypotheses"] * abs(row["stated"] - row["right"]) for row in table)
    return float(sum(gaps) / total)
