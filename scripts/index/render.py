"""Skinning and the rasteriser: posed bodies to normalised silhouettes.

A silhouette is the union of projected triangles, so no depth is needed.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from descriptor.silhouette import HEIGHT, WIDTH

SUPERSAMPLING = 2
"""Samples per normalised pixel and axis; a pixel is set if at least half of them are."""


@njit(nogil=True, cache=True)
def skin(
    vertices: NDArray[np.float32],
    influences: NDArray[np.int32],
    weights: NDArray[np.float32],
    transforms: NDArray[np.float32],
) -> NDArray[np.float32]:  # pragma: no cover - compiled
    """Linear blend skinning: vertices ``(V, 3)`` posed by transforms ``(B, 3, 4)`` of bones.

    Influences and weights ``(V, K)`` are in descending order; a zero ends the list.
    """
    posed = np.zeros_like(vertices)
    for v in range(len(vertices)):
        x, y, z = vertices[v]
        for k in range(influences.shape[1]):
            weight = weights[v, k]
            if weight == 0.0:
                break
            t = transforms[influences[v, k]]
            for axis in range(3):
                posed[v, axis] += weight * (
                    t[axis, 0] * x + t[axis, 1] * y + t[axis, 2] * z + t[axis, 3]
                )
    return posed


@njit(nogil=True, cache=True)
def render(
    vertices: NDArray[np.float32],
    triangles: NDArray[np.int32],
    closed: int,
    rotation: NDArray[np.float32],
    distance: float,
    silhouette: NDArray[np.uint8],
) -> tuple[float, float, float]:  # pragma: no cover - compiled
    """Draw one silhouette, normalised: aspect ratio kept, filling and centred in 128x48.

    Parameters
    ----------
    vertices : (V, 3) float32 array
        Body axes, metres, pelvis at the origin; every vertex is used by a triangle.
    triangles : (T, 3) int32 array
    closed : int
        Number of leading triangles that form closed surfaces, whose far side is not drawn.
    rotation : (3, 3) float32 array
        Body axes to camera axes.
    distance : float
        From the camera to the pelvis, metres.
    silhouette : (128, 48) uint8 array
        Written: 1 on the person, 0 elsewhere.

    Returns
    -------
    scale, offset_x, offset_y : float
        Normalised pixel = scale * metres in the plane through the pelvis + offset.
    """
    plane = _project(vertices, rotation, np.float32(distance))
    left, top, right, bottom = _bounds(plane)
    scale = min(HEIGHT / (bottom - top), WIDTH / (right - left))
    offset_x = (WIDTH - 1) / 2 - scale * (left + right) / 2
    offset_y = (HEIGHT - 1) / 2 - scale * (top + bottom) / 2
    for v in range(len(plane)):
        plane[v, 0] = (scale * plane[v, 0] + offset_x + 0.5) * SUPERSAMPLING - 0.5
        plane[v, 1] = (scale * plane[v, 1] + offset_y + 0.5) * SUPERSAMPLING - 0.5
    fine = np.zeros((HEIGHT * SUPERSAMPLING, WIDTH * SUPERSAMPLING), np.uint8)
    fill_triangles(plane, triangles, closed, fine)
    _reduce(fine, silhouette)
    return scale, offset_x, offset_y


@njit(nogil=True, cache=True)
def fill_triangles(
    plane: NDArray[np.float32], triangles: NDArray[np.int32], closed: int, image: NDArray[np.uint8]
) -> None:  # pragma: no cover - compiled
    """Set the pixels of an image that triangles ``(T, 3)`` cover to 1.

    ``plane`` ``(V, 2)`` are projected vertices, pixels, x before y. The first ``closed`` triangles
    form closed surfaces, whose far side is not drawn.
    """
    for t in range(len(triangles)):
        _fill(plane, triangles[t, 0], triangles[t, 1], triangles[t, 2], t < closed, image)


@njit(nogil=True, cache=True)
def _project(
    vertices: NDArray[np.float32], rotation: NDArray[np.float32], distance: np.float32
) -> NDArray[np.float32]:  # pragma: no cover - compiled
    plane = np.empty((len(vertices), 2), np.float32)
    for v in range(len(vertices)):
        x, y, z = vertices[v]
        depth = distance + rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z
        ratio = distance / depth
        plane[v, 0] = ratio * (rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z)
        plane[v, 1] = ratio * (rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z)
    return plane


@njit(nogil=True, cache=True)
def _bounds(
    plane: NDArray[np.float32],
) -> tuple[float, float, float, float]:  # pragma: no cover - compiled
    left, top, right, bottom = np.inf, np.inf, -np.inf, -np.inf
    for v in range(len(plane)):
        left, right = min(left, plane[v, 0]), max(right, plane[v, 0])
        top, bottom = min(top, plane[v, 1]), max(bottom, plane[v, 1])
    return left, top, right, bottom


@njit(nogil=True, cache=True)
def _samples_between(a: float, b: float, c: float) -> tuple[int, int]:  # pragma: no cover
    """First and last whole number between the smallest and the largest of three."""
    # Plain comparisons: min() and max() also order NaNs, which costs a third of the time.
    low = a if a < b else b
    low = low if low < c else c
    high = a if a > b else b
    high = high if high > c else c
    return int(np.ceil(low)), int(np.floor(high))


@njit(nogil=True, cache=True)
def _fill(
    plane: NDArray[np.float32], a: int, b: int, c: int, cull: bool, fine: NDArray[np.uint8]
) -> None:  # pragma: no cover - compiled
    """Set the samples inside one triangle."""
    ax, ay = plane[a, 0], plane[a, 1]
    bx, by = plane[b, 0], plane[b, 1]
    cx, cy = plane[c, 0], plane[c, 1]
    if cull and (bx - ax) * (cy - ay) < (by - ay) * (cx - ax):
        return
    first, last = _samples_between(ay, by, cy)
    begin, end = _samples_between(ax, bx, cx)
    # Many triangles are smaller than a sample and lie between samples.
    if first > last or begin > end:
        return
    turn = np.float32(1.0) if (bx - ax) * (cy - ay) >= (by - ay) * (cx - ax) else np.float32(-1.0)
    for row in range(max(first, 0), min(last, fine.shape[0] - 1) + 1):
        for column in range(max(begin, 0), min(end, fine.shape[1] - 1) + 1):
            # Most samples are set already: bodies are covered several times over.
            if fine[row, column] == 0:
                ab = (bx - ax) * (row - ay) - (by - ay) * (column - ax)
                bc = (cx - bx) * (row - by) - (cy - by) * (column - bx)
                ca = (ax - cx) * (row - cy) - (ay - cy) * (column - cx)
                if turn * ab >= 0 and turn * bc >= 0 and turn * ca >= 0:
                    fine[row, column] = 1


@njit(nogil=True, cache=True)
def _reduce(
    fine: NDArray[np.uint8], silhouette: NDArray[np.uint8]
) -> None:  # pragma: no cover - compiled
    half = SUPERSAMPLING * SUPERSAMPLING // 2
    for row in range(HEIGHT):
        for column in range(WIDTH):
            total = 0
            for dy in range(SUPERSAMPLING):
                for dx in range(SUPERSAMPLING):
                    total += fine[row * SUPERSAMPLING + dy, column * SUPERSAMPLING + dx]
            silhouette[row, column] = total >= half
