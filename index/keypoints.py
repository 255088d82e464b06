"""Landmarks of a photograph: how skeletons agree with them, and skeletons fitted to them.

The index gives the nearest of its recorded poses. The fit then rotates bones towards the landmarks
and resets the bones to their lengths. In the picture it goes from coarse to fine, so that limbs far
from their keypoints are found as well. Points without a landmark keep their position relative to
their parents.

In depth the landmarks are one opinion, the pose another. The first skeleton goes most of the way to
them; the others only where they nearly agree, so that they keep their other ways to read the depth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from index.search import rotate_clockwise
from index.skeleton import (
    LIMBS,
    OTHER_SIDE,
    POINT_NAMES,
    POINTS,
    exchange_sides,
    pixels_per_metre,
    with_bone_lengths_of,
)

SPREAD_PX = 8.0
"""Standard deviation of a point about its keypoint, in pixels of the normalised frame."""

SPREAD_M = 0.15
"""Standard deviation of a point about its landmark in three dimensions, in metres."""

LIMB_WEIGHT = 0.25
"""Weight of the landmarks' depths beside their places in the picture, which are surer."""

OUTLIER_WEIGHT = 0.05
"""Weight of outliers among keypoints, so that no single keypoint rules a pose out."""

_MIN_MASS = 1e-6

LIKELIHOOD_EXPONENT = 0.5
"""Exponent of the joint likelihood: errors of keypoints are correlated (left for right)."""

STEPS = ((14.0, 0.7, 4), (7.0, 0.7, 10))
"""Stages of the fit: spread of the keypoints in pixels, share of the way that a point moves in an
iteration, and iterations. Chosen on the street people of even-numbered photographs."""

DEPTH_SHARE = 0.6
"""Share of the way to the landmarks' depths that the fit goes in all."""

_LIMB_ROWS = [POINT_NAMES.index(name) for name in LIMBS]
_HIPS = [LIMBS.index("left_hip"), LIMBS.index("right_hip")]
_HIP_POINTS = [POINT_NAMES.index("left_hip"), POINT_NAMES.index("right_hip")]
# Bodies differ in size by no more than this factor from what landmarks say.
_SIZES = (0.8, 1.25)


@dataclass(frozen=True)
class Agreement:
    """How skeletons agree with keypoints.

    Parameters
    ----------
    log_likelihood : (K,) float64 array
        Of the keypoints, given each skeleton or its twin with left and right exchanged, whichever
        is likelier; at most 0.
    side_log_odds : (K,) float64 array
        Log odds of the skeleton against that twin. They are kept apart because keypoints are more
        reliable about where a joint is than about whether it is the left or the right one.
    residuals : (K, P, 2) float64 array
        Offset from each point of the likelier of the two to its keypoint, in pixels of the
        normalised frame, scaled down by the probability that the keypoint is an outlier.
    """

    log_likelihood: NDArray[np.float64]
    side_log_odds: NDArray[np.float64]
    residuals: NDArray[np.float64]

    def take(self, rows: NDArray[np.integer]) -> Agreement:
        """Select skeletons by row, in the order given."""
        return Agreement(self.log_likelihood[rows], self.side_log_odds[rows], self.residuals[rows])

    def weights(self) -> NDArray[np.float64]:
        """Weights ``(K,)`` of the skeletons; 1 for the likeliest."""
        relative = self.log_likelihood - self.log_likelihood.max()
        return np.asarray(np.exp(LIKELIHOOD_EXPONENT * relative))


@dataclass(frozen=True)
class Keypoints:
    """Positions of points of a skeleton in a photograph, and the limbs in three dimensions.

    Parameters
    ----------
    rows : tuple of int
        Rows of ``POINT_NAMES``.
    positions : (P, 2) float64 array
        Pixels of the normalised frame.
    scores : (P,) float64 array
        Confidence of each, above 0 and at most 1.
    limbs_3d : (12, 3) float64 array, optional
        Metres about the middle of the hips, axes of the normalised frame; rows are ``LIMBS``.
    limb_scores : (12,) float64 array, optional
        Confidence of each limb joint, from 0 to 1.
    spread_px : float
        Standard deviation of a point about its keypoint.
    """

    rows: tuple[int, ...]
    positions: NDArray[np.float64]
    scores: NDArray[np.float64]
    limbs_3d: NDArray[np.float64] | None = None
    limb_scores: NDArray[np.float64] | None = None
    spread_px: float = SPREAD_PX

    def __post_init__(self) -> None:
        count = len(self.rows)
        if self.positions.shape != (count, 2) or self.scores.shape != (count,):
            raise ValueError(
                f"expected positions of shape ({count}, 2) and scores of shape ({count},), "
                f"got {self.positions.shape} and {self.scores.shape}"
            )
        if not count or not all(0 <= row < POINTS for row in self.rows):
            raise ValueError(f"expected rows from 0 to {POINTS - 1}, got {self.rows}")
        if not ((self.scores > 0) & (self.scores <= 1)).all():
            raise ValueError(f"expected scores above 0 and at most 1, got {self.scores}")
        if (self.limbs_3d is None) != (self.limb_scores is None):
            raise ValueError("expected limbs in three dimensions with their scores, or neither")
        if self.limbs_3d is not None and self.limb_scores is not None:
            shapes = (self.limbs_3d.shape, self.limb_scores.shape)
            if shapes != ((len(LIMBS), 3), (len(LIMBS),)):
                raise ValueError(
                    f"expected limbs of shape ({len(LIMBS)}, 3) and scores of shape "
                    f"({len(LIMBS)},), got {shapes[0]} and {shapes[1]}"
                )

    def rotated(self, angle_deg: float) -> Keypoints:
        """The same rotated clockwise about the origin."""
        angle = np.deg2rad(angle_deg)
        cosine, sine = np.cos(angle), np.sin(angle)
        return replace(
            self,
            positions=self.positions @ np.array([[cosine, sine], [-sine, cosine]]),
            limbs_3d=None if self.limbs_3d is None else rotate_clockwise(self.limbs_3d, angle_deg),
        )

    def compare(
        self, points_normalised: NDArray[np.floating], points_3d: NDArray[np.floating]
    ) -> Agreement:
        """Compare skeletons with the keypoints.

        Parameters
        ----------
        points_normalised : (K, 24, 2) array
            Pixels of the normalised frame.
        points_3d : (K, 24, 3) array
            Metres, axes of the normalised frame.
        """
        points = np.asarray(points_normalised, np.float64)
        own, own_residuals = self.compare_sides(points)
        exchanged, exchanged_residuals = self.compare_sides(exchange_sides(points))
        if self.limbs_3d is not None:
            own += self._compare_limbs(points_3d)
            exchanged += self._compare_limbs(exchange_sides(np.asarray(points_3d, np.float64)))
        residuals = np.where((own >= exchanged)[:, None, None], own_residuals, exchanged_residuals)
        return Agreement(np.maximum(own, exchanged), own - exchanged, residuals)

    def limb_offsets(self, points_3d: NDArray[np.floating]) -> NDArray[np.float64]:
        """Offsets ``(K, 12, 3)`` from the limbs of skeletons to the landmarks, in metres.

        Landmarks are first given the size of each skeleton.
        """
        assert self.limbs_3d is not None and self.limb_scores is not None
        limbs = np.asarray(points_3d[:, _LIMB_ROWS], np.float64)
        limbs = limbs - limbs[:, _HIPS].mean(axis=1, keepdims=True)
        weights = self.limb_scores[:, None]
        inner = (weights * limbs * self.limbs_3d).sum(axis=(1, 2))
        size = inner / max(float((weights * self.limbs_3d**2).sum()), 1e-9)
        size = np.clip(size, *_SIZES)[:, None, None]
        return np.asarray(size * self.limbs_3d - limbs)

    def compare_sides(
        self, points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Log likelihoods ``(K,)`` and residuals ``(K, P, 2)`` in the picture, sides as given."""
        offsets = self.positions - points[:, list(self.rows)]
        mass = self._mass(offsets)
        log_likelihood = np.log((mass + OUTLIER_WEIGHT) / (1 + OUTLIER_WEIGHT)).sum(axis=1)
        return log_likelihood, _inlier_probability(mass)[..., None] * offsets

    def inlier_probability(self, offsets: NDArray[np.float64]) -> NDArray[np.float64]:
        """Probability ``(K, P)`` that keypoints at offsets ``(K, P, 2)`` are no outliers."""
        return _inlier_probability(self._mass(offsets))

    def _mass(self, offsets: NDArray[np.float64]) -> NDArray[np.float64]:
        squares = (offsets**2).sum(axis=-1)
        mass = self.scores * np.exp(-squares / (2 * self.spread_px**2))
        # Arithmetic on denormal numbers is slow.
        mass[mass < _MIN_MASS] = 0
        return np.asarray(mass)

    def _compare_limbs(self, points_3d: NDArray[np.floating]) -> NDArray[np.float64]:
        """Log likelihoods ``(K,)`` of the limbs in three dimensions."""
        assert self.limb_scores is not None
        squares = (self.limb_offsets(points_3d) ** 2).sum(axis=-1)
        mass = self.limb_scores * np.exp(-squares / (2 * SPREAD_M**2))
        return np.asarray(
            LIMB_WEIGHT * np.log((mass + OUTLIER_WEIGHT) / (1 + OUTLIER_WEIGHT)).sum(axis=1)
        )


def _inlier_probability(mass: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(mass / (mass + OUTLIER_WEIGHT))


def fit_to_keypoints(
    keypoints: Keypoints, points_3d: NDArray[np.float64], points_normalised: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit skeletons to keypoints.

    Parameters
    ----------
    keypoints : Keypoints
    points_3d : (M, 24, 3) float64 array
        Camera axes, metres, pelvis at the origin; rows are ``POINT_NAMES``. The likeliest first.
    points_normalised : (M, 24, 2) float64 array
        Pixels of the normalised frame.

    Returns
    -------
    points_3d, points_normalised
        Same shapes; bones keep their lengths, and the face moves with the head.
    """
    fitted, placed = points_3d, points_normalised
    px_per_metre = pixels_per_metre(points_3d, points_normalised)[:, None, None]
    if keypoints.limbs_3d is not None:
        fitted = with_bone_lengths_of(points_3d, _deepened(keypoints, points_3d))
        placed = placed + (fitted - points_3d)[..., :2] * px_per_metre
    for spread_px, share, iterations in STEPS:
        blurred = replace(keypoints, spread_px=spread_px)
        rows = _assigned(blurred, blurred.compare(placed, fitted).side_log_odds < 0)
        for _ in range(iterations):
            moves = share * _residuals(blurred, placed, rows)
            moved = fitted.copy()
            moved[..., :2] += moves / px_per_metre
            moved = with_bone_lengths_of(points_3d, moved)
            # The pelvis has no keypoint and follows the hips.
            pelvis_moves = moves[:, _HIP_POINTS].mean(axis=1, keepdims=True)
            placed = placed + (moved - fitted)[..., :2] * px_per_metre + pelvis_moves
            fitted = moved
    return fitted, placed


def _deepened(keypoints: Keypoints, points_3d: NDArray[np.float64]) -> NDArray[np.float64]:
    """Skeletons moved towards the landmarks' depths."""
    assert keypoints.limb_scores is not None
    offsets = keypoints.limb_offsets(points_3d)
    shares = np.repeat(DEPTH_SHARE * keypoints.limb_scores[None], len(points_3d), axis=0)
    near = np.exp(-(offsets**2).sum(axis=-1) / (2 * SPREAD_M**2))
    shares[1:] *= near[1:]
    moved = points_3d.copy()
    moved[:, _LIMB_ROWS] += shares[..., None] * offsets
    return moved


def _assigned(keypoints: Keypoints, exchanged: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Rows ``(M, P)`` of each skeleton's points that the keypoints are about.

    Left and right are exchanged where that is likelier, but not of the first skeleton where
    landmarks come with their depth, since it follows them.
    """
    rows = np.where(exchanged[:, None], OTHER_SIDE[list(keypoints.rows)], keypoints.rows)
    if keypoints.limbs_3d is not None:
        rows[0] = keypoints.rows
    return rows


def _residuals(
    keypoints: Keypoints, points_normalised: NDArray[np.float64], rows: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Offsets ``(M, 24, 2)`` to the keypoints from the points in ``rows`` ``(M, P)``.

    Where landmarks come with their depth, the first skeleton follows them however far they are.
    """
    skeletons = np.arange(len(points_normalised))[:, None]
    offsets = keypoints.positions - points_normalised[skeletons, rows]
    trust = keypoints.inlier_probability(offsets)
    if keypoints.limbs_3d is not None:
        trust[0] = keypoints.scores
    residuals = np.zeros_like(points_normalised)
    residuals[skeletons, rows] = trust[..., None] * offsets
    return residuals
