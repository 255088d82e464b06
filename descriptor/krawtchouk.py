"""Weighted Krawtchouk polynomials and the moments of silhouettes.

References
----------
.. [1] P.-T. Yap, R. Paramesran, S.-H. Ong, "Image Analysis by Krawtchouk Moments",
   IEEE Transactions on Image Processing 12(11), 2003.
.. [2] R. Koekoek, R. F. Swarttouw, "The Askey-scheme of hypergeometric orthogonal
   polynomials and its q-analogue", section 1.10 (recurrence and norm).
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray


@lru_cache(maxsize=64)
def weighted_polynomials(orders: int, size: int, p: float) -> NDArray[np.float64]:
    """Orthonormal weighted Krawtchouk polynomials of orders ``0 .. orders - 1``.

    ``K[n, x] = K_n(x; p, N) sqrt(w(x; p, N) / rho(n; p, N))`` with ``N = size - 1`` [1]_,
    by the three-term recurrence [2]_ of the orthonormal functions, which stays accurate
    in float64 where the recurrence of the unweighted polynomials overflows. It also loses digits
    towards the last orders, earlier if ``p`` is nearer to 0 or 1 (with 128 samples: after 117
    orders at p = 0.5, after 43 at p = 0.95); higher orders are refused::

        b[n+1] K[n+1] = (a[n] - x) K[n] - b[n] K[n-1]
        a[n] = p (N - n) + (1 - p) n
        b[n] = sqrt(p (1 - p) n (N - n + 1))

    Parameters
    ----------
    orders : int
        Number of orders; 1 to ``size``.
    size : int
        Number of samples along the axis.
    p : float
        In (0, 1); functions of low order are concentrated around ``x = p N``.

    Returns
    -------
    (orders, size) float64 array
        Rows are orthonormal. Read-only, because it is shared between callers.

    Raises
    ------
    ValueError
        If ``orders`` or ``p`` is out of range, or float64 is not accurate enough for the orders.
    """
    if not 1 <= orders <= size:
        raise ValueError(f"expected 1 to {size} orders for {size} samples, got {orders}")
    if not 0.0 < p < 1.0:
        raise ValueError(f"expected p between 0 and 1, got {p}")
    last = size - 1
    x = np.arange(size, dtype=np.float64)
    n = np.arange(orders + 1, dtype=np.float64)
    a = p * (last - n) + (1 - p) * n
    b = np.sqrt(p * (1 - p) * n * np.maximum(last - n + 1, 0))
    polynomials = np.zeros((orders, size))
    polynomials[0] = np.sqrt(_binomial_weights(size, p))
    for k in range(orders - 1):
        before = polynomials[k - 1] if k else 0.0
        polynomials[k + 1] = ((a[k] - x) * polynomials[k] - b[k] * before) / b[k + 1]
    # Largest error of an inner product, a tenth of the rounding of float32 moments.
    if np.abs(polynomials @ polynomials.T - np.eye(orders)).max() > 1e-6:
        raise ValueError(
            f"float64 is too short for {orders} orders at {size} samples and p = {p}: take fewer"
        )
    polynomials.setflags(write=False)
    return polynomials


def _binomial_weights(size: int, p: float) -> NDArray[np.float64]:
    last = size - 1
    logarithms = [
        math.lgamma(last + 1) - math.lgamma(x + 1) - math.lgamma(last - x + 1)
        + x * math.log(p) + (last - x) * math.log1p(-p)
        for x in range(size)
    ]  # fmt: skip
    return np.exp(logarithms)


def moments(
    silhouettes: NDArray[np.generic],
    vertical: NDArray[np.floating],
    horizontal: NDArray[np.floating],
) -> NDArray[np.float32]:
    """Krawtchouk moments ``Q[n, m] = sum_yx vertical[n, y] horizontal[m, x] f[y, x]``.

    Parameters
    ----------
    silhouettes : (B, H, W) array
    vertical : (N, H) array
        Polynomials along y.
    horizontal : (M, W) array
        Polynomials along x.

    Returns
    -------
    (B, N, M) float32 array
        Summed in float64: float32 sums differ between processors, and with the size of the batch.
    """
    rows = vertical @ np.asarray(silhouettes, np.float64)
    return np.asarray(rows @ horizontal.T, np.float32)


def diagonal_moments(
    silhouettes: NDArray[np.generic],
    vertical: NDArray[np.floating],
    horizontal: NDArray[np.floating],
) -> NDArray[np.float32]:
    """The diagonal moments ``Q[n, n]`` only, ``(B, N)``, summed as in :func:`moments`."""
    rows = vertical @ np.asarray(silhouettes, np.float64)
    return np.asarray(np.einsum("bnx,nx->bn", rows, horizontal), np.float32)
