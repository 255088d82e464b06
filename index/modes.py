"""Distinct poses among candidates: the modes of their density, interpolated to the query.

Candidates are weighted by the distance of their descriptors from the query's. The modes of their
density in pose space are taken greedily, densest first, and interpolated to the query by locally
weighted linear regression [1]_ of the pose on the descriptor.

With landmarks, the depths of the limbs remain uncertain. The depths of the candidates and the
errors of the landmarks give a posterior of these depths; :func:`depth_modes` takes a few along its
principal axes.

References
----------
.. [1] C. G. Atkeson, A. W. Moore, S. Schaal, "Locally Weighted Learning", Artificial
   Intelligence Review 11, 1997.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from index.candidates import Candidates
from index.landmarks import Agreement, NormalisedLandmarks
from index.skeleton import JOINTS, LIMBS, POINTS, with_bone_lengths_of

DISTINCT_M = 0.11
"""Smallest root mean square joint distance between the centres of two modes; half of it is enough
after interpolation."""

BANDWIDTH_M = 0.08
"""Bandwidth of the density's Gaussian kernel, a root mean square joint distance."""

# Ridge of the regression, relative to the variance of a mode's offsets.
_RIDGE = 0.45


@dataclass(frozen=True)
class Modes:
    """Poses at which candidates gather.

    Parameters
    ----------
    centres : (M,) int64 array
        Row of each mode's central candidate.
    distances : (M,) float64 array
        Distance from the query's descriptor to the interpolated descriptor of each mode.
    points_3d : (M, 24, 3) float64 array
        Interpolated, with the bone lengths of the centre; camera axes, metres.
    points_normalised : (M, 24, 2) float64 array
        Interpolated; pixels of the normalised frame.
    """

    centres: NDArray[np.int64]
    distances: NDArray[np.float64]
    points_3d: NDArray[np.float64]
    points_normalised: NDArray[np.float64]

    def __post_init__(self) -> None:
        count = len(self.centres)
        expected = ((count,),) * 2 + ((count, POINTS, 3), (count, POINTS, 2))
        got = tuple(array.shape for array in vars(self).values())
        if got != expected:
            raise ValueError(f"expected arrays of shapes {expected}, got {got}")

    def __len__(self) -> int:
        return len(self.centres)

    def take(self, rows: NDArray[np.integer] | Sequence[int] | slice) -> Modes:
        return Modes(*(array[rows] for array in vars(self).values()))

    def append(self, modes: Modes) -> Modes:
        pairs = zip(vars(self).values(), vars(modes).values(), strict=True)
        return Modes(*(np.concatenate(pair) for pair in pairs))


def find_modes(
    candidates: Candidates,
    weights: NDArray[np.float64],
    count: int,
    offsets: NDArray[np.floating],
    fit: Callable[[Modes], Modes] = lambda modes: modes,
    bandwidth_m: float = BANDWIDTH_M,
) -> Modes:
    """Find up to ``count`` distinct modes, densest first.

    Parameters
    ----------
    weights : (K,) array
        Weights of the candidates in the density.
    offsets : (K, ...) array
        From the candidates to the query, between descriptors or between points in the picture;
        modes are interpolated to where these vanish.
    fit : callable
        Moves interpolated modes towards other evidence; modes that then coincide are kept once.
    bandwidth_m : float
        Smaller for an index that covers few motions densely, as in the paper's experiments.
    """
    flat = np.asarray(offsets, np.float64).reshape(len(candidates), -1)
    densest = _densest(weights, _joint_distances(candidates.points_3d[:, :JOINTS]), bandwidth_m)
    modes = fit(_interpolate(candidates, flat, list(islice(densest, count))))
    while len(distinct := _distinct(modes, DISTINCT_M / 2)[:count]) < count:
        # Interpolation or the fit made modes coincide: take enough others to replace them.
        missing = math.ceil((count - len(distinct)) * len(modes) / len(distinct))
        if not (next_densest := list(islice(densest, missing))):
            break
        modes = modes.append(fit(_interpolate(candidates, flat, next_densest)))
    return modes.take(distinct)


_MIN_VARIANCE = 1e-5
_NORMAL = NormalDist()


@dataclass(frozen=True)
class DepthModes:
    """Alternatives to the depths of landmarks.

    Parameters
    ----------
    offsets : (5, 12) float64 array
        Depths of the limbs behind the landmarks, metres.
    nearer : (5,) float64 array
        Probability that the truth is nearer to each than to the depths of the landmarks.
    misfits : (5,) float64 array
        Negative log likelihood of the landmarks, relative to that at their own depths.
    """

    offsets: NDArray[np.float64]
    nearer: NDArray[np.float64]
    misfits: NDArray[np.float64]


def depth_modes(
    candidates: Candidates, landmarks: NormalisedLandmarks, agreement: Agreement
) -> DepthModes:
    """Find alternatives to the depths of landmarks.

    For each candidate, the posterior of the depths is the product of the errors of the landmarks
    and a normal distribution about the candidate. The mixture of these is taken as normal, and the
    alternatives lie along its principal axes.

    Parameters
    ----------
    agreement : Agreement
        How the candidates agree with the landmarks.
    """
    apart = -landmarks.limb_offsets(candidates.points_3d)[..., 2]
    limbs = np.eye(len(LIMBS))
    errors = landmarks.limb_covariance + _MIN_VARIANCE * limbs
    # Standard deviation of a limb's depth about that of an entry of the same pose.
    precision = np.linalg.inv(errors + 0.2**2 * limbs)
    gain = errors @ precision
    log_weights = np.log(likely_weights(candidates.distances, agreement) + 1e-300)
    # Weights include part of the evidence of the depths.
    log_shares = 0.3 * log_weights - ((apart @ precision) * apart).sum(axis=1) / 2
    shares = np.exp(log_shares - log_shares.max())
    shares /= shares.sum()
    mean = shares @ apart
    about = apart - mean
    spread = gain @ (about.T * shares @ about) @ gain.T
    covariance = errors - gain @ errors + spread
    variances, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    largest = axes[:, :-3:-1] * np.sqrt(np.maximum(variances[:-3:-1], 0))
    mean = gain @ mean
    # Of each axis, the end to which the mean is comes first: the direction of an axis is arbitrary.
    largest *= np.where(mean @ largest < 0, -1.0, 1.0)
    # Alternatives in standard deviations along the first two axes, which have most of the variance;
    # no two coincide if the first has all.
    along = np.array([[1.2, 0], [-1.2, 0], [0.4, 1.2], [-0.4, -1.2], [2.2, 0]])
    offsets = mean + along @ largest.T
    # The truth is nearer to an alternative if it is beyond the middle between the two.
    beyond = offsets @ mean - (offsets**2).sum(axis=1) / 2
    deviations = beyond / np.sqrt(((offsets @ covariance) * offsets).sum(axis=1) + _MIN_VARIANCE**2)
    misfits = ((offsets @ np.linalg.inv(errors)) * offsets).sum(axis=1) / 2
    return DepthModes(offsets, np.array([_NORMAL.cdf(one) for one in deviations]), misfits)


def _distinct(modes: Modes, min_distance_m: float) -> list[int]:
    near = _joint_distances(modes.points_3d[:, :JOINTS]) < min_distance_m
    distinct: list[int] = []
    for row, near_row in enumerate(near.tolist()):
        if not any(near_row[earlier] for earlier in distinct):
            distinct.append(row)
    return distinct


def _densest(
    weights: NDArray[np.float64], apart: NDArray[np.float64], bandwidth_m: float
) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Centres of modes, densest first, each with its share ``(K,)`` of the candidates' weights."""
    kernel = np.exp(apart**2 / (-2 * bandwidth_m**2))
    remaining = weights / weights.sum()
    penalty = np.zeros(len(weights))  # It is minus infinity near the centres taken.
    while True:
        # Decimals to which densities are rounded, so that rounding errors do not break ties.
        density = (kernel @ remaining).round(12) + penalty
        centre = int(density.argmax())
        if density[centre] == -np.inf:
            return
        yield centre, remaining * kernel[centre]
        # Bandwidth of the kernel that removes a mode once taken, as a multiple of that of the
        # density.
        remaining = remaining * (1 - kernel[centre] ** (1 / 1.5**2))
        penalty[apart[centre] < DISTINCT_M] = -np.inf


def likely_weights(distances: NDArray[np.float64], agreement: Agreement) -> NDArray[np.float64]:
    """Weights ``(K,)`` of candidates at ascending distances ``(K,)`` that agree with landmarks."""
    # Fall-off of the candidates' weights with distance if landmarks are the other factor of the
    # weights: they distinguish near candidates better than descriptors; see
    # :func:`candidate_weights`.
    weights = candidate_weights(distances, 0.6)
    # Exponent of the landmarks' likelihood in the weights: their errors are correlated (left for
    # right).
    return weights * agreement.weights(0.5)


def candidate_weights(distances: NDArray[np.float64], fall_off: float = 0.3) -> NDArray[np.float64]:
    """Weights ``(K,)`` of candidates at ascending distances ``(K,)``: 1 for the nearest.

    1/e for one farther than the nearest by twice ``fall_off`` times the nearest's distance.
    """
    # Smallest distance of the nearest candidate, as a share of the farthest's, for the fall-off:
    # otherwise an entry that equals the query would outweigh all others.
    nearest = max(distances[0], 0.02 * distances[-1])
    return np.exp((distances[0] - distances) / (2 * fall_off * nearest + 1e-9))


def _joint_distances(joints: NDArray[np.floating]) -> NDArray[np.float64]:
    """Root mean square joint distances ``(K, K)`` between skeletons ``(K, J, 3)``."""
    flat = joints.reshape(len(joints), -1)
    squares = (flat**2).sum(axis=1)
    squared = squares[:, None] + squares - 2 * flat @ flat.T
    return np.sqrt(np.maximum(squared, 0) / joints.shape[1])


def _interpolate(
    candidates: Candidates,
    offsets: NDArray[np.float64],
    weighted_centres: Sequence[tuple[int, NDArray[np.float64]]],
) -> Modes:
    """Interpolate modes, each a centre and weights ``(K,)``, to where offsets ``(K, E)`` vanish."""
    centres = [centre for centre, _ in weighted_centres]
    weights = np.stack([weights for _, weights in weighted_centres])
    combinations = _combinations(weights, offsets)
    return Modes(
        np.array(centres),
        np.linalg.norm(combinations @ candidates.offsets, axis=1),
        with_bone_lengths_of(
            candidates.points_3d[centres], _combine(combinations, candidates.points_3d)
        ),
        _combine(combinations, candidates.points_normalised),
    )


def _combinations(
    weights: NDArray[np.float64], offsets: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Shares ``(M, K)``, summing to 1, by which members make up the interpolated pose of a mode."""
    # Candidates below this share of the largest weight in a mode do not belong to it.
    shares = np.where(weights > 1e-3 * weights.max(axis=1)[:, None], weights, 0.0)
    shares /= shares.sum(axis=1)[:, None]
    means = shares @ offsets
    scatters = np.empty((*means.shape, means.shape[1]))
    rows = [np.flatnonzero(own) for own in shares]
    # Centred before they are multiplied: else a difference of large numbers is left, whose digits
    # differ from processor to processor.
    centred = [offsets.take(own, axis=0) - mean for own, mean in zip(rows, means, strict=True)]
    for mode, near in enumerate(centred):
        weighted = near * shares[mode, rows[mode], None]
        np.matmul(weighted.T, near, out=scatters[mode])
    # The fewer effective members, the worse the estimate of the scatter and the larger the ridge.
    diagonals = np.einsum("mdd->md", scatters)
    diagonals += (_RIDGE * diagonals.sum(axis=1) * (shares**2).sum(axis=1) + 1e-9)[:, None]
    slopes = np.linalg.solve(scatters, means[..., None])[..., 0]
    for mode, near in enumerate(centred):
        shares[mode, rows[mode]] *= 1 - near @ slopes[mode]
    return shares


def _combine(shares: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weighted sums ``(M, P, D)`` of points ``(K, P, D)``."""
    flat = shares @ points.reshape(len(points), -1)
    return flat.reshape(len(shares), *points.shape[1:])
