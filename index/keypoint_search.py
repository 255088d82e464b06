"""Search for the entries whose skeletons fit keypoints best, up to a similarity transform.

A silhouette does not show what lies inside its outline, keypoints do not show the outline: each
finds entries that the other misses.

With points as complex numbers, the similarity transform that fits two sets of points by weighted
least squares is a quotient of inner products [1]_, so that one matrix product compares all entries.

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
"""Rows of ``POINT_NAMES`` that are compared with keypoints: shoulders, elbows, wrists, knees and
ankles. Hips and nose did not improve the result."""

ROLL_PX = 4.0
"""Penalty on rotation, since few people lean: added to the residual for a right angle."""

_OTHER_SIDE = exchange_sides(np.arange(float(len(POINT_NAMES)))[:, None])[:, 0].astype(int)


@dataclass(frozen=True)
class Nearest:
    """Entries nearest to keypoints, nearest first.

    Parameters
    ----------
    numbers : (K,) int64 array
    mirrored : (K,) bool array
        Whether the mirror image of the entry was found.
    roll_deg : (K,) float64 array
        Clockwise rotation in the picture that fits the entry to the keypoints.
    residual_px : (K,) float64 array
        Weighted root mean square distance after the fit, in pixels of the normalised frame, with
        the penalty on rotation included.
    """

    numbers: NDArray[np.int64]
    mirrored: NDArray[np.bool_]
    roll_deg: NDArray[np.float64]
    residual_px: NDArray[np.float64]


class KeypointSearch:
    """Exhaustive search over projected skeletons; immutable.

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
        # Rows: x, y and squared norm of each point, from which all sums over points are computed.
        self._rows = np.ascontiguousarray(
            np.concatenate([points[..., 0], points[..., 1], (points**2).sum(axis=-1)], axis=1).T
        )

    def __len__(self) -> int:
        return int(self._rows.shape[1])

    def nearest(self, keypoints: Keypoints, k: int) -> Nearest:
        """Find the ``k`` nearest among all entries and their mirror images.

        Keypoints of points that are not in :data:`SEARCHED` are ignored.
        """
        used = [i for i, row in enumerate(keypoints.rows) if row in SEARCHED]
        weights = keypoints.scores[used] / keypoints.scores[used].sum()
        places = keypoints.positions[used] @ np.array([1, 1j])
        # An entry's mirror image fits the keypoints as the entry fits the mirrored keypoints.
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
    """Matrix ``(30, 5)`` by which the rows of points are multiplied.

    Its columns give the weighted means of x, of y and of the squared norm, and the real and the
    imaginary part of the inner product with the query.
    """
    count = len(SEARCHED)
    factors = np.zeros((3 * count, 5))
    columns = np.array([SEARCHED.index(row) for row in rows])
    inner = weights * np.conj(places - weights @ places)
    factors[columns, 0] = factors[count + columns, 1] = factors[2 * count + columns, 2] = weights
    # (x + iy) (a + ib) = (ax - by) + i (bx + ay)
    factors[columns, 3], factors[count + columns, 3] = inner.real, -inner.imag
    factors[columns, 4], factors[count + columns, 4] = inner.imag, inner.real
    return factors
