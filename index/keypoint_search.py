"""Entries whose projected skeletons lie nearest to keypoints, turned and scaled to fit best.

A silhouette hides what lies within it; keypoints tell, but not the outline. Each finds entries
that the other misses.

With points as complex numbers, the similarity transform that lays one set on another in the sense
of weighted least squares is a quotient of inner products [1]_, so that all entries are compared by
one product of matrices.

References
----------
.. [1] I. L. Dryden, K. V. Mardia, "Statistical Shape Analysis", Wiley 1998, section 3.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from index.keypoints import Keypoints
from index.skeleton import LIMBS, POINT_NAMES, exchange_sides

SEARCHED = tuple(POINT_NAMES.index(name) for name in LIMBS if not name.endswith("hip"))
"""Points of the entries that keypoints are compared with, as rows of ``POINT_NAMES``: shoulders,
elbows, wrists, knees and ankles. Hips and nose add nothing to them, but time and memory."""

ROLL_PX = 4.0
"""Few people lean as a whole: an entry turned by a right angle counts as so many pixels farther."""

_OTHER_SIDE = exchange_sides(np.arange(float(len(POINT_NAMES)))[:, None])[:, 0].astype(int)


@dataclass(frozen=True)
class Nearest:
    """Entries nearest to keypoints, best first.

    Parameters
    ----------
    numbers : (K,) int64 array
    mirrored : (K,) bool array
        Whether the mirror image of the entry is meant.
    roll_deg : (K,) float64 array
        How far each must be turned, clockwise in the picture.
    residual_px : (K,) float64 array
        Root mean square distance that remains, in pixels of the normalised frame, together with
        what the turn counts.
    """

    numbers: NDArray[np.int64]
    mirrored: NDArray[np.bool_]
    roll_deg: NDArray[np.float64]
    residual_px: NDArray[np.float64]


class KeypointSearch:
    """Projected skeletons, searchable by keypoints; immutable.

    Parameters
    ----------
    points_normalised : (E, 10, 2) array
        Pixels of the normalised frame; rows are :data:`SEARCHED`.
    """

    def __init__(self, points_normalised: NDArray[np.floating]) -> None:
        points = np.asarray(points_normalised, np.float32)
        if points.shape[1:] != (len(SEARCHED), 2):
            raise ValueError(
                f"expected points of shape (E, {len(SEARCHED)}, 2), got {points.shape}"
            )
        # Rows: x, y and the square of each point, all that sums over points are made of.
        self._rows = np.ascontiguousarray(
            np.concatenate([points[..., 0], points[..., 1], (points**2).sum(axis=-1)], axis=1).T
        )

    def __len__(self) -> int:
        return int(self._rows.shape[1])

    def nearest(self, keypoints: Keypoints, k: int) -> Nearest:
        """Find the ``k`` nearest among all entries and their mirror images.

        Keypoints of other points than :data:`SEARCHED` are left out.
        """
        used = [i for i, row in enumerate(keypoints.rows) if row in SEARCHED]
        weights = keypoints.scores[used] / keypoints.scores[used].sum()
        places = keypoints.positions[used] @ np.array([1, 1j])
        # The mirror image of an entry fits the keypoints as the entry fits theirs.
        reflected = [int(_OTHER_SIDE[keypoints.rows[i]]) for i in used]
        queries = (
            ([keypoints.rows[i] for i in used], places),
            (reflected, -np.conj(places)),
        )
        factors = [_factors(rows, weights, query) for rows, query in queries]
        sums = np.concatenate(factors, axis=1).astype(np.float32).T @ self._rows
        squares, rolls = [], []
        for mirrored, (_, query) in enumerate(queries):
            mean_x, mean_y, square, real, imaginary = sums[5 * mirrored : 5 * mirrored + 5]
            spread = np.maximum(square - mean_x**2 - mean_y**2, np.float32(1e-6))
            own = np.float32(weights @ np.abs(query - weights @ query) ** 2)
            square = real**2 + imaginary**2
            cosine = real / np.sqrt(np.maximum(square, 1e-12))
            squares.append(own - square / spread + np.float32(ROLL_PX**2) * (1 - cosine))
            rolls.append((imaginary, real) if mirrored else (-imaginary, real))
        total = np.concatenate(squares)
        k = min(k, len(total))
        nearest = np.argpartition(total, k - 1)[:k]
        nearest = nearest[np.argsort(total[nearest], kind="stable")]
        sine, cosine = (np.concatenate(part)[nearest] for part in zip(*rolls, strict=True))
        return Nearest(
            nearest % len(self),
            nearest >= len(self),
            np.rad2deg(np.arctan2(sine, cosine)).astype(np.float64),
            np.sqrt(np.maximum(total[nearest], 0)).astype(np.float64),
        )


def _factors(
    rows: list[int], weights: NDArray[np.float64], places: NDArray[np.complex128]
) -> NDArray[np.float64]:
    """What columns of points are multiplied with, ``(30, 5)``.

    For the weighted means of x and y and of the squares, and for the real and the imaginary part of
    the inner product with the query.
    """
    count = len(SEARCHED)
    factors = np.zeros((3 * count, 5))
    at = np.array([SEARCHED.index(row) for row in rows])
    inner = weights * np.conj(places - weights @ places)
    factors[at, 0] = factors[count + at, 1] = factors[2 * count + at, 2] = weights
    # (x + iy) (a + ib) = (ax - by) + i (bx + ay)
    factors[at, 3], factors[count + at, 3] = inner.real, -inner.imag
    factors[at, 4], factors[count + at, 4] = inner.imag, inner.real
    return factors
