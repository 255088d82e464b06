"""Candidates to distinct poses: where they gather, and what lies between them.

The density of the candidates in pose space, each weighted by how near its descriptor is to the
query's, is climbed mode by mode. Each mode is then interpolated to the query by locally
weighted linear regression [1]_ of the pose on the descriptor, which gives a pose between the
entries and the distance that remains between the query and the entries' neighbourhood.

References
----------
.. [1] C. G. Atkeson, A. W. Moore, S. Schaal, "Locally Weighted Learning", Artificial
   Intelligence Review 11, 1997.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from index.candidates import Candidates
from index.keypoints import Agreement
from index.skeleton import JOINTS, NATIVE, POINTS

DISTINCT_M = 0.11
"""Poses whose joints differ by less than this (root mean square) count once.

Interpolation may bring two of them nearer, but no nearer than half of it.
"""

BANDWIDTH_M = 0.08
"""Joint distance at which a candidate still belongs to a mode."""

SUPPRESSION = 1.5
"""A mode takes its surroundings with it, by so much more than its bandwidth."""

FALL_OFF, FALL_OFF_SEEN = 0.3, 0.6
"""A candidate farther than the nearest by twice this share of its distance weighs 1/e, without and
with keypoints, which tell near candidates apart better than descriptors do."""

NEAREST_SHARE = 0.02
"""The nearest counts as at least so far off as this share of the farthest's distance.

An entry that is the query itself would else outweigh all others.
"""

PULL = 0.5
"""Distance of descriptors that a pixel between a point and where it should be is worth."""

RIDGE = 0.45
"""Regularisation of the regression, as a share of the mean variance of a mode's descriptors."""


@dataclass(frozen=True)
class Modes:
    """Poses, on each of which several candidates agree.

    Parameters
    ----------
    centres : (M,) int64 array
        The candidate in the middle of each.
    votes : (M,) float64 array
        Share of all candidates' weight that gathers there.
    distances : (M,) float64 array
        From the query's descriptor to the descriptors of each mode, interpolated.
    points_3d : (M, 24, 3) float64 array
    points_normalised : (M, 24, 2) float64 array
        Interpolated; the bones are as long as those of the centre.
    """

    centres: NDArray[np.int64]
    votes: NDArray[np.float64]
    distances: NDArray[np.float64]
    points_3d: NDArray[np.float64]
    points_normalised: NDArray[np.float64]

    def __post_init__(self) -> None:
        count = len(self.centres)
        expected = ((count,),) * 3 + ((count, POINTS, 3), (count, POINTS, 2))
        got = tuple(array.shape for array in vars(self).values())
        if got != expected:
            raise ValueError(f"expected arrays of shapes {expected}, got {got}")

    def __len__(self) -> int:
        return len(self.centres)

    def take(self, rows: NDArray[np.integer] | Sequence[int] | slice) -> Modes:
        """Return some of them, in the order asked for."""
        return Modes(*(array[rows] for array in vars(self).values()))

    def nearest(self, count: int | None = None) -> Modes:
        """Return them in ascending distance, no more than ``count``."""
        return self.take(np.argsort(self.distances, kind="stable")[:count])

    def and_more(self, more: Modes) -> Modes:
        """Put others after these."""
        pairs = zip(vars(self).values(), vars(more).values(), strict=True)
        return Modes(*(np.concatenate(pair) for pair in pairs))


def find_modes(
    candidates: Candidates,
    count: int,
    *,
    agreement: Agreement | None = None,
    bandwidth_m: float = BANDWIDTH_M,
) -> Modes:
    """Up to ``count`` modes, the densest first, no two of their centres alike.

    Parameters
    ----------
    candidates : Candidates
    count : int
    agreement : Agreement, optional
        Of each candidate with keypoints: it weighs them, and modes are pulled to the keypoints.
    bandwidth_m : float
        Smaller where an index covers few motions densely, as in the paper's experiments.

    Returns
    -------
    Modes
        Fewer than ``count`` where the candidates hold fewer distinct poses.
    """
    weights, offsets = mode_weights(candidates.distances, agreement), candidates.offsets
    if agreement is not None:
        pulls = PULL * agreement.pulls.reshape(len(candidates), -1)
        offsets = np.concatenate([offsets, -pulls], axis=1)
    # The ridge keeps the regression far from where single precision would matter.
    offsets = offsets.astype(np.float32)
    apart = _joint_distances(candidates.points_3d[:, :JOINTS])
    densest = _densest(weights, apart, bandwidth_m)
    modes = _interpolate(candidates, offsets, list(islice(densest, count)))
    while len(distinct := _distinct(modes)[:count]) < count:
        # Interpolation made some alike: as many more as that should take.
        more = math.ceil((count - len(distinct)) * len(modes) / len(distinct))
        if not (some := list(islice(densest, more))):
            break
        modes = modes.and_more(_interpolate(candidates, offsets, some))
    modes = modes.take(distinct)
    skeletons = candidates.points_3d[modes.centres]
    return replace(modes, points_3d=with_bones_of(skeletons, modes.points_3d))


def _distinct(modes: Modes) -> list[int]:
    """Interpolated modes, by their rows, without those that come too near to an earlier one."""
    near = _joint_distances(modes.points_3d[:, :JOINTS]) < DISTINCT_M / 2
    distinct: list[int] = []
    for position, near_it in enumerate(near.tolist()):
        if not any(near_it[other] for other in distinct):
            distinct.append(position)
    return distinct


def _densest(
    weights: NDArray[np.float64], apart: NDArray[np.float32], bandwidth_m: float
) -> Iterator[tuple[int, NDArray[np.float32]]]:
    """Centres of modes, the densest first, and the shares ``(K,)`` that gather about each."""
    kernel = np.exp(apart**2 / np.float32(-2 * bandwidth_m**2))
    remaining = (weights / weights.sum()).astype(np.float32)
    free = np.zeros(len(weights), np.float32)  # Else minus infinity.
    while True:
        gathering = kernel @ remaining + free
        centre = int(gathering.argmax())
        if gathering[centre] == -np.inf:
            return
        yield centre, remaining * kernel[centre]
        remaining = remaining * (1 - kernel[centre] ** (1 / SUPPRESSION**2))
        free[apart[centre] < DISTINCT_M] = -np.inf


def mode_weights(
    distances: NDArray[np.float64], agreement: Agreement | None
) -> NDArray[np.float64]:
    """How much candidates at ascending distances ``(K,)`` count for the modes, ``(K,)``."""
    if agreement is None:
        return candidate_weights(distances)
    return candidate_weights(distances, FALL_OFF_SEEN) * agreement.weights()


def candidate_weights(
    distances: NDArray[np.float64], fall_off: float = FALL_OFF
) -> NDArray[np.float64]:
    """How much each candidate counts: ascending distances ``(K,)`` to weights ``(K,)``, 1 first."""
    nearest = max(distances[0], NEAREST_SHARE * distances[-1])
    return np.asarray(np.exp((distances[0] - distances) / (2 * fall_off * nearest + 1e-9)))


def _joint_distances(joints: NDArray[np.floating]) -> NDArray[np.float32]:
    """Root mean square joint distance of each pair of skeletons: ``(K, J, 3)`` to ``(K, K)``."""
    flat = joints.reshape(len(joints), -1).astype(np.float32)
    squares = (flat**2).sum(axis=1)
    squared = squares[:, None] + squares[None] - 2 * flat @ flat.T
    return np.asarray(np.sqrt(np.maximum(squared, 0) / np.float32(joints.shape[1])))


def _interpolate(
    candidates: Candidates,
    offsets: NDArray[np.float32],
    gatherings: Sequence[tuple[int, NDArray[np.float32]]],
) -> Modes:
    """Interpolate to where offsets ``(K, E)`` vanish what gathers ``(K,)`` about each centre."""
    centres, weights = [centre for centre, _ in gatherings], np.stack([w for _, w in gatherings])
    shares = np.where(weights > 1e-3 * weights.max(axis=1, keepdims=True), weights, np.float32(0))
    shares /= shares.sum(axis=1, keepdims=True)
    means = shares @ offsets
    # Means are taken off last, where there is least to take them off.
    scatter = (shares[..., None] * offsets).swapaxes(1, 2) @ offsets
    scatter -= means[:, :, None] * means[:, None]
    # Few effective members make a poor estimate of the scatter: it is then held stiffer.
    diagonals = np.einsum("mdd->md", scatter)
    stiffness = RIDGE * diagonals.sum(axis=1) * (shares**2).sum(axis=1) + 1e-9
    diagonals += stiffness[:, None]
    slopes = np.linalg.solve(scatter, -means[..., None])[..., 0]
    steps = shares * (slopes @ offsets.T - (slopes * means).sum(axis=1, keepdims=True))
    combinations = shares + steps - shares * steps.sum(axis=1, keepdims=True)
    return Modes(
        np.array(centres),
        weights.sum(axis=1).astype(np.float64),
        np.linalg.norm(combinations @ candidates.offsets, axis=1).astype(np.float64),
        _combine(combinations, candidates.points_3d),
        _combine(combinations, candidates.points_normalised),
    )


def _combine(shares: NDArray[np.float32], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weighted sums ``(M, P, D)`` of points ``(K, P, D)``."""
    flat = shares @ points.reshape(len(points), -1).astype(np.float32)
    return np.asarray(flat.reshape(len(shares), *points.shape[1:]), np.float64)


def with_bones_of(
    skeleton: NDArray[np.float64], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Give skeletons the bone lengths of others, keeping their directions.

    Averages of skeletons are shorter than the skeletons.

    Parameters
    ----------
    skeleton : (..., 24, 3) array
        Whose bones.
    points : (..., 24, 3) array
        Whose directions.

    Returns
    -------
    (..., 24, 3) float64 array
        Pelvis at the origin; the face moves with the head.
    """
    wanted = np.linalg.norm(skeleton[..., _CHILDREN, :] - skeleton[..., _PARENTS, :], axis=-1)
    bones = points[..., _CHILDREN, :] - points[..., _PARENTS, :]
    bones = bones * (wanted / np.maximum(np.linalg.norm(bones, axis=-1), 1e-6))[..., None]
    joints = _FROM_THE_PELVIS @ bones
    face = points[..., JOINTS:, :] - points[..., _HEAD : _HEAD + 1, :]
    return np.concatenate([joints, joints[..., _HEAD : _HEAD + 1, :] + face], axis=-2)


def _from_the_pelvis() -> NDArray[np.float64]:
    """Which bones lead from the pelvis to each joint: ``(19, 18)`` of 0 and 1."""
    leading = np.zeros((JOINTS, len(NATIVE.bones)))
    for bone, (parent, child) in enumerate(NATIVE.bones):
        leading[child] = leading[parent]
        leading[child, bone] = 1
    return leading


_PARENTS, _CHILDREN = np.array(NATIVE.bones).T
_FROM_THE_PELVIS = _from_the_pelvis()
_HEAD = NATIVE.names.index("head")
