"""The descriptors that the paper compares with its own, and raw pixels.

OpenCV computes Hu's moments and HOG, mahotas Zernike's. Hahn moments and histograms of shape
contexts are in no library that we know; OpenCV's own shape contexts are a distance between two
outlines, which takes milliseconds for each of 1.8 million pairs.

References
----------
.. [1] M.-K. Hu, "Visual Pattern Recognition by Moment Invariants", IRE Transactions on
   Information Theory 8(2), 1962.
.. [2] A. Khotanzad, Y. H. Hong, "Invariant Image Recognition by Zernike Moments", PAMI 12(5), 1990.
.. [3] P.-T. Yap, R. Paramesran, S.-H. Ong, "Image Analysis Using Hahn Moments", PAMI 29(11), 2007.
.. [4] P. D. Brubeck, Y. Nakatsukasa, L. N. Trefethen, "Vandermonde with Arnoldi", SIAM Review
   63(2), 2021.
.. [5] S. Belongie, J. Malik, J. Puzicha, "Shape Matching and Object Recognition Using Shape
   Contexts", PAMI 24(4), 2002.
.. [6] A. Agarwal, B. Triggs, "Recovering 3D Human Pose from Monocular Images", PAMI 28(1), 2006.
.. [7] N. Dalal, B. Triggs, "Histograms of Oriented Gradients for Human Detection", CVPR 2005.
"""

import math
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from descriptor.krawtchouk import diagonal_moments
from descriptor.silhouette import HEIGHT, WIDTH

Vectors = NDArray[np.float32]
Describe = Callable[[NDArray[np.uint8]], Vectors]
"""Silhouettes ``(B, 128, 48)`` to vectors ``(B, D)``."""

ZERNIKE_DEGREE = 12
HAHN_CONCENTRATION = 16.0
"""The best of seven, 2 to 512, on known frames held out, at revision fde0768."""

ORDERS, P2 = 24, (0.1, 0.95)
"""Orders and vertical centres of Hahn moments: those of the paper's Krawtchouk moments."""

WORDS = 100
"""Typical shape contexts."""

_CODEBOOK_EVERY = 3
"""Every so many-th known silhouette teaches typical shape contexts: neighbours are alike."""

_POINTS = 64
_ANGLES, _RING_ENDS = 12, np.geomspace(0.125, 2.0, 5)
"""Bins of a shape context; radii are shares of the mean distance of two points [5]_."""

_HU_FLOOR = 1e-9
"""Hu's invariants span ten powers of ten: logarithms above this, proportional below."""


def descriptors_compared(known: NDArray[np.uint8], seed: int) -> dict[str, Describe]:
    """Return the descriptors by name; two of them learn from the known silhouettes."""
    spread = hu_moments(known).std(axis=0)
    codebook = typical_contexts(known[::_CODEBOOK_EVERY], seed)
    return {
        "hu": lambda silhouettes: hu_moments(silhouettes) / spread,
        "zernike": zernike_moments,
        "hahn": hahn_moments,
        "shape_context": lambda silhouettes: context_histograms(silhouettes, codebook),
        "hog_of_silhouette": hog,
        "pixels": pixels,
    }


def pixels(silhouettes: NDArray[np.uint8]) -> Vectors:
    """The silhouette itself: ``(B, 6144)``."""
    return silhouettes.reshape(len(silhouettes), -1).astype(np.float32)


def hog(silhouettes: NDArray[np.uint8]) -> Vectors:
    """Histograms of oriented gradients [7]_ of the silhouette: ``(B, 2700)``."""
    extractor = cv2.HOGDescriptor((WIDTH, HEIGHT), (16, 16), (8, 8), (8, 8), 9)
    return np.stack([np.asarray(extractor.compute(s * 255)).ravel() for s in silhouettes])


def hu_moments(silhouettes: NDArray[np.uint8]) -> Vectors:
    """Hu's seven invariants [1]_, on a logarithmic scale that keeps their sign: ``(B, 7)``."""
    invariants = np.array(
        [cv2.HuMoments(cv2.moments(s, binaryImage=True)).ravel() for s in silhouettes]
    )
    scaled = np.sign(invariants) * np.log10(1 + np.abs(invariants) / _HU_FLOOR)
    return np.asarray(scaled, np.float32)


def zernike_moments(silhouettes: NDArray[np.uint8]) -> Vectors:
    """Magnitudes of the Zernike moments [2]_ on the disc about the frame: ``(B, 49)``."""
    from mahotas.features import zernike_moments

    centre = ((HEIGHT - 1) / 2, (WIDTH - 1) / 2)
    radius = math.ceil(math.hypot(*centre))
    moments = [zernike_moments(s, radius, ZERNIKE_DEGREE, cm=centre) for s in silhouettes]
    return np.asarray(moments, np.float32)


def hahn_moments(silhouettes: NDArray[np.uint8]) -> Vectors:
    """Diagonal Hahn moments [3]_ in the regions of the paper's descriptor: ``(B, 48)``.

    With the concentration 0 they would be Tchebichef's, with an infinite one Krawtchouk's.
    """
    horizontal = weighted_polynomials(hahn_weights(WIDTH, 0.5, HAHN_CONCENTRATION), ORDERS)
    vertical = [
        weighted_polynomials(hahn_weights(HEIGHT, p, HAHN_CONCENTRATION), ORDERS) for p in P2
    ]
    return diagonal_moments(
        silhouettes, np.concatenate(vertical), np.tile(horizontal, (len(P2), 1))
    )


def hahn_weights(size: int, p: float, concentration: float) -> NDArray[np.float64]:
    """Weights of Hahn's polynomials ``(size,)``, with their mode near ``x = p (size - 1)``."""
    x = np.arange(size)
    alpha, beta = p * concentration, (1 - p) * concentration
    logarithms = (
        gammaln(alpha + x + 1) - gammaln(x + 1) + gammaln(beta + size - x) - gammaln(size - x)
    )
    return np.exp(logarithms - logarithms.max())


def weighted_polynomials(weights: NDArray[np.float64], orders: int) -> NDArray[np.float64]:
    """Orthonormal polynomials times the root of their weights, ``(orders, size)``.

    Any weights: each order is the one before times x, without what the lower ones hold [4]_.
    """
    x = np.linspace(-1, 1, len(weights))
    rows = np.zeros((orders, len(weights)))
    rows[0] = np.sqrt(weights / weights.sum())
    for order in range(1, orders):
        row = x * rows[order - 1]
        for _ in range(2):  # Twice, since the first pass leaves rounding errors.
            row -= rows[:order].T @ (rows[:order] @ row)
        rows[order] = row / np.linalg.norm(row)
    return rows


def shape_contexts(silhouette: NDArray[np.uint8]) -> Vectors:
    """Log-polar histograms ``(64, 60)`` of all other points of the outline about each [5]_."""
    outlines, _ = cv2.findContours(silhouette, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    outline = np.concatenate([one[:, 0] for one in outlines]).astype(np.float32)
    points = outline[np.linspace(0, len(outline), _POINTS, endpoint=False).astype(int)]
    apart = points[None] - points[:, None]
    distances = np.linalg.norm(apart, axis=-1)
    others = ~np.eye(_POINTS, dtype=bool)
    ring = np.searchsorted(_RING_ENDS, distances / distances[others].mean())
    turn = np.arctan2(apart[..., 1], apart[..., 0]) / (2 * np.pi) % 1.0
    sector = np.minimum((turn * _ANGLES).astype(int), _ANGLES - 1)
    about, other = np.nonzero(others & (ring < len(_RING_ENDS)))
    counts = np.zeros((_POINTS, len(_RING_ENDS), _ANGLES), np.float32)
    np.add.at(counts, (about, ring[about, other], sector[about, other]), 1)
    return counts.reshape(_POINTS, -1) / np.float32(_POINTS - 1)


def typical_contexts(silhouettes: NDArray[np.uint8], seed: int) -> Vectors:
    """The most typical shape contexts ``(100, 60)`` of silhouettes, by k-means [6]_."""
    from sklearn.cluster import MiniBatchKMeans

    contexts = np.concatenate([shape_contexts(silhouette) for silhouette in silhouettes])
    clusters = MiniBatchKMeans(WORDS, random_state=seed, n_init=3, batch_size=4096).fit(contexts)
    return np.asarray(clusters.cluster_centers_, np.float32)


def context_histograms(silhouettes: NDArray[np.uint8], codebook: Vectors) -> Vectors:
    """How often each typical shape context occurs in a silhouette [6]_: ``(B, 100)``.

    A context votes for the words near it by a Gaussian as wide as the nearest is far. Roots, so
    that Euclidean distances are Hellinger's.
    """
    histograms = np.empty((len(silhouettes), len(codebook)), np.float32)
    for row, silhouette in zip(histograms, silhouettes, strict=True):
        apart = shape_contexts(silhouette)[:, None] - codebook
        squares = (apart**2).sum(axis=-1)
        votes = np.exp(-squares / (2 * np.maximum(squares.min(axis=1, keepdims=True), 1e-9)))
        row[:] = (votes / votes.sum(axis=1, keepdims=True)).mean(axis=0)
    return np.sqrt(histograms)
