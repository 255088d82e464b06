"""Features of a hypothesis from which its confidence is computed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from index.candidates import Candidates
from index.confidence import RIGHT_BELOW_PX
from index.modes import Modes, candidate_weights
from index.skeleton import JOINTS

AGREEMENT_PX = (RIGHT_BELOW_PX, 2 * RIGHT_BELOW_PX)
"""Mean joint distances below which a candidate agrees with a mode."""

AGREEMENT_FALL_OFFS = (0.15, 0.5)
"""Fall-offs of the candidates' weights, as in :func:`index.modes.candidate_weights`."""


def match_features(
    candidates: Candidates, modes: Modes, outline_errors: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Compute :data:`index.confidence.FEATURES`.

    Parameters
    ----------
    modes : Modes
        M modes of the candidates, ordered by rank.
    outline_errors : (M,) array
        Outline distance between the query and the centre of each mode, pixels.

    Returns
    -------
    (M, F) float64 array
    """
    distances, votes = np.log(modes.distances + 1e-6), np.log(modes.votes + 1e-6)
    nearest = np.full(len(modes), np.log(candidates.distances[0] + 1e-6))
    return np.stack(
        [
            distances,
            distances - distances.min(),
            votes,
            votes - votes.max(),
            nearest,
            np.asarray(outline_errors, np.float64),
            np.log(np.arange(1, len(modes) + 1)),
            *np.log(_agreements(candidates, modes) + 1e-3),
        ],
        axis=-1,
    )


def _agreements(candidates: Candidates, modes: Modes) -> NDArray[np.float64]:
    """Weighted shares ``(4, M)`` of the candidates that agree with each mode.

    The share of candidates that agree with a hypothesis is a better predictor of its being right
    than the fit of the hypothesis itself.
    """
    mode_joints = modes.points_normalised[:, :JOINTS]
    joints = candidates.points_normalised[:, :JOINTS]
    # Candidates come last, because NumPy is several times slower along short axes.
    joints = joints.transpose(2, 1, 0).copy()
    squares = (mode_joints[:, :, 0, None] - joints[0]) ** 2
    squares += (mode_joints[:, :, 1, None] - joints[1]) ** 2
    errors = np.sqrt(squares).sum(axis=1) / JOINTS
    agree = [(errors < px).astype(np.float64) for px in AGREEMENT_PX]
    weights = [candidate_weights(candidates.distances, f) for f in AGREEMENT_FALL_OFFS]
    return np.stack([a @ w / w.sum() for w in weights for a in agree])
