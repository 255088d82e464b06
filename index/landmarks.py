"""Landmarks of a person: agreement of skeletons with them, and the fit of skeletons to them.

The fit moves joints of recorded poses towards the landmarks and restores the bone lengths. Points
without a landmark keep their position relative to their parents. In depth, the first skeleton moves
most of the way to the landmarks; the others only where they nearly agree, and remain alternatives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from index.skeleton import (
    LIMB_HIPS,
    LIMB_ROWS,
    LIMBS,
    OTHER_SIDE,
    POINTS,
    bone_lengths,
    pixels_per_metre,
    side_rows,
    squared_lengths,
    with_bone_lengths,
)

# Standard deviation of a point about its landmark in the picture, and in three dimensions.
_SIGMA_PX, _SIGMA_M = 8.0, 0.15

OUTLIER_WEIGHT = 0.05
"""Weight of outliers among landmarks, so that no single landmark rules a pose out."""

SIZE_RANGE = (0.8, 1.25)
"""Factors by which a body may differ in size from its landmarks."""


@dataclass(frozen=True)
class NormalisedLandmarks:
    """Landmarks of a person in the normalised frame, and the limbs in three dimensions."""

    rows: tuple[int, ...]  # rows of ``POINT_NAMES``
    positions: NDArray[np.float64]  # (P, 2): pixels of the normalised frame
    scores: NDArray[np.float64]  # (P,): confidence of each, above 0 and at most 1
    # (12, 3): metres about the middle of the hips, axes of the normalised frame; rows are
    # ``LIMBS``.
    limbs_3d: NDArray[np.float64]
    limb_scores: NDArray[np.float64]  # (12,): confidence of each limb joint, from 0 to 1
    # (12, 12): covariance of the errors of the limbs' depths, square metres.
    limb_covariance: NDArray[np.float64]
    whole: bool = True  # whether the photograph shows the person from head to feet
    sigma_px: float = _SIGMA_PX  # standard deviation of a point about its landmark in the picture

    def __post_init__(self) -> None:
        count, limbs = len(self.rows), len(LIMBS)
        arrays = (
            self.positions, self.scores, self.limbs_3d, self.limb_scores, self.limb_covariance
        )  # fmt: skip
        shapes, expected = (
            tuple(a.shape for a in arrays),
            ((count, 2), (count,), (limbs, 3), (limbs,), (limbs, limbs)),
        )
        if shapes != expected:
            raise ValueError(f"expected arrays of shapes {expected}, got {shapes}")
        if not count or not all(0 <= row < POINTS for row in self.rows):
            raise ValueError(f"expected rows from 0 to {POINTS - 1}, got {self.rows}")
        if not ((self.scores > 0) & (self.scores <= 1)).all():
            raise ValueError(f"expected scores above 0 and at most 1, got {self.scores}")

    def compare(
        self, points_normalised: NDArray[np.floating], points_3d: NDArray[np.floating]
    ) -> Agreement:
        """Compare skeletons with the landmarks.

        Parameters
        ----------
        points_normalised : (K, 24, 2) array
            Pixels of the normalised frame.
        points_3d : (K, 24, 3) array
            Metres, axes of the normalised frame.
        """
        points = np.asarray(points_normalised, np.float64)
        # Each skeleton beside its twin: (K, 2, P, 2).
        offsets = self.positions - points.take(self._both_sides, axis=1)
        mass = self._mass(offsets)
        likelihood = _log_likelihoods(mass)
        limbs = np.asarray(points_3d, np.float64).take(_BOTH_LIMBS, axis=1)
        squares = squared_lengths(self._offsets_of_limbs(limbs))
        near = self.limb_scores * np.exp(-squares / (2 * _SIGMA_M**2))
        # Weight of the landmarks in three dimensions relative to their places in the picture, which
        # are more certain.
        likelihood += 0.25 * _log_likelihoods(near)
        likelier = likelihood.argmax(axis=1)
        each = np.arange(len(points))
        return Agreement(
            likelihood[each, likelier],
            likelihood[:, 0] - likelihood[:, 1],
            _inlier_share(mass[each, likelier])[..., None] * offsets[each, likelier],
        )

    @cached_property
    def _both_sides(self) -> NDArray[np.int64]:
        return _with_other_side(self.rows)

    def reprojection_errors(self, points_normalised: NDArray[np.floating]) -> NDArray[np.float64]:
        """Mean distances ``(K,)`` of skeletons ``(K, 24, 2)`` from the landmarks, in pixels."""
        offsets = self.positions - points_normalised[:, list(self.rows)]
        return np.asarray(np.linalg.norm(offsets, axis=-1).mean(axis=-1))

    def limb_offsets(self, points_3d: NDArray[np.floating]) -> NDArray[np.float64]:
        """Offsets ``(K, 12, 3)``, metres, from the limbs of skeletons to the landmarks.

        Landmarks are first scaled to the size of each skeleton.
        """
        return self._offsets_of_limbs(np.asarray(points_3d[:, LIMB_ROWS], np.float64))

    def inlier_shares(self, offsets: NDArray[np.float64]) -> NDArray[np.float64]:
        """Probability ``(K, P)`` that landmarks at offsets ``(K, P, 2)`` are not outliers."""
        return _inlier_share(self._mass(offsets))

    def _offsets_of_limbs(self, limbs: NDArray[np.float64]) -> NDArray[np.float64]:
        """Offsets ``(..., 12, 3)`` from limbs to the landmarks; see :meth:`limb_offsets`."""
        limbs = limbs - limbs.take(LIMB_HIPS, axis=-2).mean(axis=-2, keepdims=True)
        weighted = self.limb_scores[:, None] * self.limbs_3d
        inner = limbs.reshape(*limbs.shape[:-2], -1) @ weighted.ravel()
        size = inner / max(float((weighted * self.limbs_3d).sum()), 1e-9)
        return np.clip(size, *SIZE_RANGE)[..., None, None] * self.limbs_3d - limbs

    def _mass(self, offsets: NDArray[np.float64]) -> NDArray[np.float64]:
        """Likelihoods ``(..., P)`` of landmarks at offsets ``(..., P, 2)`` if not outliers."""
        mass = self.scores * np.exp(squared_lengths(offsets) / (-2 * self.sigma_px**2))
        mass[mass < 1e-6] = 0  # Arithmetic on denormal numbers is slow.
        return mass


@dataclass(frozen=True)
class Agreement:
    """How skeletons agree with landmarks."""

    # (K,): log likelihood of the landmarks, given each skeleton or its twin with left and right
    # exchanged, whichever is likelier; at most 0.
    log_likelihood: NDArray[np.float64]
    # (K,): log odds of the skeleton against that twin. They are separate because landmarks show
    # more reliably where a joint is than whether it is the left or the right one.
    side_log_odds: NDArray[np.float64]
    # (K, P, 2): offset from each point of the likelier of the two to its landmark, in pixels of the
    # normalised frame, scaled down by the probability that the landmark is an outlier.
    residuals: NDArray[np.float64]

    def take(self, rows: NDArray[np.integer]) -> Agreement:
        return Agreement(self.log_likelihood[rows], self.side_log_odds[rows], self.residuals[rows])

    def weights(self, exponent: float) -> NDArray[np.float64]:
        """Likelihoods ``(K,)`` to the power of ``exponent``, relative to the likeliest."""
        return np.exp(exponent * (self.log_likelihood - self.log_likelihood.max()))


DISTANCE_WEIGHT = 4.0
"""Weight of the log distance of the descriptors against a hypothesis, beside the log-likelihood of
the landmarks. Like the weight of sides, it was chosen on people in even-numbered photographs."""


def fused_distances(
    distances: NDArray[np.float64], agreement: Agreement, tilt_deg: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distances ``(N,)`` of hypotheses from silhouette and landmarks together.

    Parameters
    ----------
    distances : (N,) float64 array
        Distances between descriptors.
    agreement : Agreement
        Agreement of the hypotheses with the landmarks.
    tilt_deg : (N,) float64 array
        In-plane tilt of the person according to each hypothesis.
    """
    # Weight of the log odds of a hypothesis's sides.
    # Few people are tilted in the picture: a tilt of this size makes a hypothesis 1/e as likely.
    likelihood = agreement.log_likelihood + 0.3 * agreement.side_log_odds - np.abs(tilt_deg) / 60.0
    return distances * np.exp(-likelihood / DISTANCE_WEIGHT)


_HIP_POINTS = side_rows("hip")


def fit_to_landmarks(
    landmarks: NormalisedLandmarks,
    points_3d: NDArray[np.float64],
    points_normalised: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit skeletons to landmarks.

    Parameters
    ----------
    points_3d : (M, 24, 3) float64 array
        Camera axes, metres, pelvis at the origin; rows are ``POINT_NAMES``. The likeliest comes
        first.
    points_normalised : (M, 24, 2) float64 array
        Pixels of the normalised frame.

    Returns
    -------
    points_3d, points_normalised
        Of the same shapes; bones keep their lengths, and the face moves with the head.
    """
    moved = _moved_in_depth(landmarks, points_3d)
    blurred = replace(landmarks, sigma_px=10.0)
    # In pixels, a move in the picture is one in space.
    scale = pixels_per_metre(points_3d, points_normalised)[:, None, None]
    lengths = bone_lengths(points_3d) * scale[..., 0]
    fitted = with_bone_lengths(scale * moved, lengths)
    about = points_normalised - scale * points_3d[..., :2]  # What perspective and place add.
    sides = blurred.compare(about + fitted[..., :2], fitted / scale).side_log_odds
    # Left and right are exchanged if that is likelier; the first follows the landmarks.
    exchanged = (sides < 0)[:, None] & (np.arange(len(fitted)) > 0)[:, None]
    rows = np.where(exchanged, OTHER_SIDE[list(landmarks.rows)], landmarks.rows)
    rows = rows + POINTS * np.arange(len(fitted))[:, None]
    for _ in range(6):  # Coarse to fine, in 14 iterations, it came no nearer.
        moves = np.zeros_like(about)
        moves.reshape(-1, 2)[rows] = 0.8 * _pulls(blurred, about + fitted[..., :2], rows)
        fitted[..., :2] += moves
        fitted = with_bone_lengths(fitted, lengths)
        # The pelvis has no landmark and follows the hips.
        about += moves.take(_HIP_POINTS, axis=1).sum(axis=1, keepdims=True) / 2
    return fitted / scale, about + fitted[..., :2]


def _moved_in_depth(
    landmarks: NormalisedLandmarks, points_3d: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Move skeletons ``(M, 24, 3)`` towards the landmarks in three dimensions."""
    offsets = landmarks.limb_offsets(points_3d)
    # Total share of the way to the landmarks' depths by which the fit moves joints.
    shares = np.repeat(0.6 * landmarks.limb_scores[None], len(points_3d), axis=0)
    near = np.exp(-squared_lengths(offsets) / (2 * _SIGMA_M**2))
    shares[1:] *= near[1:]
    moved = points_3d.copy()
    moved[:, LIMB_ROWS] += shares[..., None] * offsets
    return moved


def _pulls(
    landmarks: NormalisedLandmarks, placed: NDArray[np.float64], rows: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Offsets ``(M, P, 2)`` to the landmarks, of points in ``rows`` ``(M, P)`` of all skeletons.

    They are scaled down by the probability that a landmark is an outlier, but for the first
    skeleton.
    """
    offsets = landmarks.positions - placed.reshape(-1, 2).take(rows, axis=0)
    trust = landmarks.inlier_shares(offsets)
    trust[0] = landmarks.scores
    return trust[..., None] * offsets


def _inlier_share(mass: NDArray[np.float64]) -> NDArray[np.float64]:
    return mass / (mass + OUTLIER_WEIGHT)


def _log_likelihoods(mass: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums ``(...)`` of the log likelihoods of points, each an inlier or an outlier."""
    likelihoods: NDArray[np.float64] = np.log((mass + OUTLIER_WEIGHT) / (1 + OUTLIER_WEIGHT))
    return likelihoods.sum(axis=-1)


def _with_other_side(rows: Sequence[int]) -> NDArray[np.int64]:
    """Rows of points, and of the same points on the other side of the body: ``(2, P)``."""
    return np.stack([np.asarray(rows), OTHER_SIDE[list(rows)]])


_BOTH_LIMBS = _with_other_side(LIMB_ROWS)
