"""Baseline descriptors of silhouettes, to compare the Krawtchouk moments with.

OpenCV computes Hu's moments and HOG, mahotas Zernike's. No Python library computes Hahn moments or
vectors of shape contexts; those are implemented here after their papers.

References
----------
.. [1] M.-K. Hu, "Visual Pattern Recognition by Moment Invariants", IRE Transactions on
   Information Theory 8(2), 1962.
.. [2] A. Khotanzad, Y. H. Hong, "Invariant Image Recognition by Zernike Moments", IEEE
   Transactions on Pattern Analysis and Machine Intelligence 12(5), 1990.
.. [3] P.-T. Yap, R. Paramesran, S.-H. Ong, "Image Analysis Using Hahn Moments", IEEE
   Transactions on Pattern Analysis and Machine Intelligence 29(11), 2007.
.. [4] R. Koekoek, R. F. Swarttouw, "The Askey-scheme of hypergeometric orthogonal polynomials
   and its q-analogue", section 1.5 (recurrence and norm).
.. [5] S. Belongie, J. Malik, J. Puzicha, "Shape Matching and Object Recognition Using Shape
   Contexts", IEEE Transactions on Pattern Analysis and Machine Intelligence 24(4), 2002.
.. [6] A. Agarwal, B. Triggs, "Recovering 3D Human Pose from Monocular Images", IEEE
   Transactions on Pattern Analysis and Machine Intelligence 28(1), 2006.
.. [7] N. Dalal, B. Triggs, "Histograms of Oriented Gradients for Human Detection", CVPR 2005.
"""

from __future__ import annotations

import math
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from descriptor.krawtchouk import diagonal_moments
from descriptor.silhouette import HEIGHT, WIDTH

Vectors = NDArray[np.float32]

HU_FLOOR = 1e-9
"""Hu's invariants span ten powers of ten: logarithms above this, proportional below."""


def hu_moments(silhouettes: NDArray[np.uint8]) -> Vectors:
    """Hu's seven invariants [1]_, on a logarithmic scale that keeps their sign: ``(B, 7)``.

    Invariant to shift, scale and rotation; the seventh changes its sign with mirroring.
    """
    invariants = np.array(
        [cv2.HuMoments(cv2.moments(s, binaryImage=True)).ravel() for s in silhouettes]
    )
    return np.asarray(np.sign(invariants) * np.log10(1 + np.abs(invariants) / HU_FLOOR), np.float32)


def zernike_moments(silhouettes: NDArray[np.uint8], degree: int) -> Vectors:
    """Magnitudes of the Zernike moments [2]_ through a degree, on the disc about the frame.

    Invariant to rotation and mirroring about the centre of the frame.
    """
    import mahotas

    centre = ((HEIGHT - 1) / 2, (WIDTH - 1) / 2)
    radius = math.ceil(math.hypot(*centre))
    moments = [
        mahotas.features.zernike_moments(s, radius, degree=degree, cm=centre) for s in silhouettes
    ]
    return np.asarray(moments, np.float32)


@lru_cache(maxsize=16)
def weighted_hahn_polynomials(
    orders: int, size: int, alpha: float, beta: float
) -> NDArray[np.float64]:
    """Orthonormal weighted Hahn polynomials [3]_ of orders ``0 .. orders - 1``.

    By the three-term recurrence [4]_ of the orthonormal functions, with ``N = size - 1``.
    ``alpha = beta = 0`` gives Tchebichef's, which cover the axis evenly; with
    ``alpha = p t``, ``beta = (1 - p) t`` and growing ``t`` they gather around ``x = p N`` and
    become Krawtchouk's.

    Parameters
    ----------
    orders, size : int
    alpha, beta : float
        Above -1.

    Returns
    -------
    (orders, size) float64 array

    Raises
    ------
    ValueError
        If float64 is too short for the orders.
    """
    last = size - 1
    x = np.arange(size, dtype=np.float64)
    weights = np.array([
        math.lgamma(alpha + k + 1) - math.lgamma(k + 1) - math.lgamma(alpha + 1)
        + math.lgamma(beta + last - k + 1) - math.lgamma(last - k + 1) - math.lgamma(beta + 1)
        for k in range(size)
    ])  # fmt: skip
    weights = np.exp(weights - weights.max())
    n = np.arange(orders + 1, dtype=np.float64)
    double = 2 * n + alpha + beta
    # A[n] and C[n] of [4]; alpha = beta = 0 makes 0 / 0 of their first terms.
    up = (n + alpha + 1) * (last - n) / (double + 2)
    up *= np.where(n == 0, 1.0, (n + alpha + beta + 1) / (double + 1))
    down = n * (n + alpha + beta + last + 1) * (n + beta) / np.where(n == 0, 1, double)
    down /= double + 1
    a = up + down
    b = np.sqrt(np.r_[0.0, np.maximum(up[:-1] * down[1:], 0)])
    polynomials = np.zeros((orders, size))
    polynomials[0] = np.sqrt(weights / weights.sum())
    for k in range(orders - 1):
        before = polynomials[k - 1] if k else 0.0
        polynomials[k + 1] = ((a[k] - x) * polynomials[k] - b[k] * before) / b[k + 1]
    if np.abs(polynomials @ polynomials.T - np.eye(orders)).max() > 1e-6:
        raise ValueError(
            f"float64 is too short for {orders} Hahn orders at {size} samples, "
            f"alpha = {alpha} and beta = {beta}: take fewer"
        )
    polynomials.setflags(write=False)
    return polynomials


def hahn_moments(
    silhouettes: NDArray[np.uint8],
    concentration: float,
    orders: int = 24,
    p2: tuple[float, ...] = (0.1, 0.95),
) -> Vectors:
    """Diagonal Hahn moments in the regions of the paper's descriptor: ``(B, orders * regions)``.

    ``concentration`` is the ``t`` of :func:`weighted_hahn_polynomials`.
    """
    t = concentration
    horizontal = weighted_hahn_polynomials(orders, WIDTH, t / 2, t / 2)
    vertical = [weighted_hahn_polynomials(orders, HEIGHT, p * t, (1 - p) * t) for p in p2]
    return diagonal_moments(
        silhouettes, np.concatenate(vertical), np.tile(horizontal, (len(p2), 1))
    )


ANGLES, RADII = 12, 5
INNER, OUTER = 0.125, 2.0
"""Bins of a shape context; the radii are shares of the mean distance of two points [5]_."""

OUTLINE_POINTS = 64


def outline_points(silhouette: NDArray[np.uint8], count: int = OUTLINE_POINTS) -> Vectors:
    """Points ``(count, 2)`` evenly along the outlines of a silhouette, x before y."""
    outlines, _ = cv2.findContours(silhouette, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    points = np.concatenate([outline[:, 0] for outline in outlines]).astype(np.float32)
    rows = np.linspace(0, len(points), count, endpoint=False).astype(int)
    return np.asarray(points[rows], np.float32)


def shape_contexts(points: Vectors) -> Vectors:
    """Log-polar histograms ``(P, 60)`` of the positions of all other points about each [5]_.

    Invariant to shift and scale.
    """
    apart = points[None] - points[:, None]
    distances = np.linalg.norm(apart, axis=-1)
    others = ~np.eye(len(points), dtype=bool)
    edges = np.geomspace(INNER, OUTER, RADII)
    ring = np.searchsorted(edges, distances / distances[others].mean())
    angle = np.arctan2(apart[..., 1], apart[..., 0]) / (2 * np.pi) % 1.0
    sector = np.minimum((angle * ANGLES).astype(int), ANGLES - 1)
    inside = others & (ring < RADII)
    rows, columns = np.nonzero(inside)
    bins = ring[rows, columns] * ANGLES + sector[rows, columns]
    counts = np.bincount(rows * RADII * ANGLES + bins, minlength=len(points) * RADII * ANGLES)
    return (counts.reshape(len(points), -1) / (len(points) - 1)).astype(np.float32)


def learn_codebook(silhouettes: NDArray[np.uint8], words: int, seed: int) -> Vectors:
    """The most typical shape contexts ``(words, 60)`` of silhouettes, by k-means [6]_."""
    from sklearn.cluster import MiniBatchKMeans

    contexts = np.concatenate([shape_contexts(outline_points(s)) for s in silhouettes])
    clusters = MiniBatchKMeans(words, random_state=seed, n_init=3, batch_size=4096).fit(contexts)
    return np.asarray(clusters.cluster_centers_, np.float32)


def context_histograms(silhouettes: NDArray[np.uint8], codebook: Vectors) -> Vectors:
    """How often each typical shape context occurs in a silhouette [6]_: ``(B, words)``.

    Every context votes for the words near it, in proportion to a Gaussian of their distance
    as wide as the nearest is far. Square roots, so that Euclidean distances are Hellinger's.
    """
    histograms = np.empty((len(silhouettes), len(codebook)), np.float32)
    squares = (codebook**2).sum(axis=1)
    for row, silhouette in enumerate(silhouettes):
        contexts = shape_contexts(outline_points(silhouette))
        far = (contexts**2).sum(axis=1)[:, None] + squares - 2 * contexts @ codebook.T
        nearest = np.maximum(far.min(axis=1, keepdims=True), 1e-9)
        votes = np.exp(-np.maximum(far, 0) / (2 * nearest))
        histograms[row] = (votes / votes.sum(axis=1, keepdims=True)).mean(axis=0)
    return np.sqrt(histograms)


def hog(silhouettes: NDArray[np.uint8]) -> Vectors:
    """Histograms of oriented gradients [7]_ of the frame: ``(B, 2700)``."""
    extractor = cv2.HOGDescriptor((WIDTH, HEIGHT), (16, 16), (8, 8), (8, 8), 9)
    return np.stack([np.asarray(extractor.compute(s * 255)).ravel() for s in silhouettes])


def pixels(silhouettes: NDArray[np.uint8]) -> Vectors:
    """The silhouette itself: ``(B, 6144)``."""
    return silhouettes.reshape(len(silhouettes), -1).astype(np.float32)
