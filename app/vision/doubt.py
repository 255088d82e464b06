"""Whether a window shows a person at all, and whether its landmarks are right.

The model was trained on rendered people (hidden, cut off or whole) and on rendered rooms, bags and
animals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.vision.dense import DenseNetwork
from app.vision.depth import HIPS
from app.vision.landmark_features import LANDMARKS
from app.vision.odds import sigmoid
from app.vision.people import LANDMARK_NAMES, landmark_rows


@dataclass(frozen=True)
class Doubt:
    """How far to trust a reading.

    Parameters
    ----------
    person : float
        Probability that the window shows a person, 0 to 1.
    right : float
        Probability that it does and that at least three in four of the visible limb joints are
        within a fifth of the trunk of their true places, 0 to 1.
    """

    person: float
    right: float


_LIMBS = landmark_rows("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
_FACE = [LANDMARK_NAMES.index("nose"), *landmark_rows("ear")]
_SHOULDERS = landmark_rows("shoulder")
_WINDOW_PX = 256


def doubt_features(
    points: NDArray[np.floating],
    world: NDArray[np.floating],
    presence: NDArray[np.floating],
    last: NDArray[np.floating],
    sigmas: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Inputs of the model: ``(N, F)``.

    Parameters
    ----------
    points : (N, 39, 5) array
    world : (N, 39, 3) array
    presence : (N,) array
    last : (N, 2, 2, 288) array
        The fields of :class:`app.vision.network_pass.NetworkPass`.
    sigmas : (N, 33) float64 array
        Sigmas of the corrected depths.
    """
    points, metres = points.astype(np.float64), world[:, :LANDMARKS].astype(np.float64)
    places = points[:, :LANDMARKS, :2] / _WINDOW_PX - 0.5
    visibility = sigmoid(points[:, :LANDMARKS, 3])
    odds = np.clip(points[:, :LANDMARKS, 3], -8, 8)
    sure = np.clip(presence.astype(np.float64), 1e-5, 1 - 1e-5)
    # The window that the network would look at next, relative to this one.
    centre, towards = points[:, 33, :2] / _WINDOW_PX - 0.5, points[:, 34, :2] / _WINDOW_PX - 0.5
    arm = towards - centre
    radius = np.linalg.norm(arm, axis=1)
    # Lengths in the picture relative to lengths in metres: for one body, the scale is the same.
    flat = np.linalg.norm(metres[..., :2] - metres[:, HIPS, :2].mean(1, keepdims=True), axis=-1)
    seen = np.linalg.norm(places - places[:, HIPS].mean(axis=1, keepdims=True), axis=-1)
    scale = seen.sum(axis=1) / np.maximum(flat.sum(axis=1), 1e-3)
    misfit = np.abs(seen - scale[:, None] * flat).mean(axis=1)
    trunk = metres[:, _SHOULDERS].mean(axis=1) - metres[:, HIPS].mean(axis=1)
    return np.column_stack(
        [
            np.log(sure / (1 - sure)),
            np.linalg.norm(centre, axis=1),
            np.log(np.maximum(radius, 1e-3) / 0.4),
            arm[:, 0] / np.maximum(radius, 1e-3),
            -arm[:, 1] / np.maximum(radius, 1e-3),
            visibility[:, _LIMBS].mean(axis=1),
            visibility[:, _LIMBS].min(axis=1),
            visibility[:, _FACE].mean(axis=1),
            odds[:, _LIMBS].mean(axis=1),
            np.log(sigmas[:, _LIMBS]).mean(axis=1),
            np.log(sigmas[:, _LIMBS]).max(axis=1),
            np.ptp(places[:, _LIMBS], axis=1).max(axis=1),
            np.linalg.norm(trunk, axis=1),
            misfit,
            np.clip(points[:, _LIMBS, 4], -8, 8).mean(axis=1),
            last.reshape(len(points), 4, -1).mean(axis=1, dtype=np.float64),
        ]
    )


@dataclass(frozen=True)
class DoubtModel:
    """Estimates how far to trust readings.

    Parameters
    ----------
    network : DenseNetwork
        Log odds of a person, and of right landmarks where there is one.
    """

    network: DenseNetwork

    def probabilities(self, features: NDArray[np.float64]) -> NDArray[np.float64]:
        """Probabilities ``(N, 2)``: a person; a person whose landmarks are right."""
        given = sigmoid(self.network(features).astype(np.float64))
        return np.column_stack([given[:, 0], given[:, 0] * given[:, 1]])

    def estimate(self, features: NDArray[np.float64]) -> Doubt:
        """Doubt about one reading with features ``(F,)``."""
        person, right = self.probabilities(features[None])[0].tolist()
        return Doubt(person, right)
