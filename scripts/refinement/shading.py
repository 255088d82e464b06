"""A depth-buffered rasteriser: which point of which surface every pixel of a body shows."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(nogil=True, cache=True)
def vertex_normals(
    vertices: NDArray[np.float32], triangles: NDArray[np.int32]
) -> NDArray[np.float32]:  # pragma: no cover - compiled
    """Unit normals ``(V, 3)``, averaged over the triangles at each vertex by their area."""
    normals = np.zeros_like(vertices)
    for t in range(len(triangles)):
        a, b, c = triangles[t]
        ux, uy, uz = vertices[b] - vertices[a]
        vx, vy, vz = vertices[c] - vertices[a]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for corner in (a, b, c):
            normals[corner, 0] += x
            normals[corner, 1] += y
            normals[corner, 2] += z
    for v in range(len(normals)):
        x, y, z = normals[v]
        length = np.sqrt(x * x + y * y + z * z) + 1e-12
        for axis in range(3):
            normals[v, axis] /= length
    return normals


@njit(nogil=True, cache=True)
def rasterise(
    plane: NDArray[np.float32],
    depth: NDArray[np.float32],
    triangles: NDArray[np.int32],
    values: NDArray[np.float32],
    height: int,
    width: int,
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:  # pragma: no cover - compiled
    """Draw triangles, the nearest in front.

    Parameters
    ----------
    plane : (V, 2) float32 array
        Where each vertex lies, in pixels.
    depth : (V,) float32 array
        Distance from the camera.
    triangles : (T, 3) int32 array
    values : (V, C) float32 array
        What is interpolated over the triangles.
    height, width : int
        Of the picture.

    Returns
    -------
    shown : (height, width) int32 array
        The triangle at each pixel, -1 where there is none.
    buffer : (height, width, C) float32 array
        The values there.
    """
    shown = np.full((height, width), -1, np.int32)
    nearest = np.full((height, width), np.inf, np.float32)
    buffer = np.zeros((height, width, values.shape[1]), np.float32)
    for t in range(len(triangles)):
        a, b, c = triangles[t]
        ax, ay = plane[a]
        bx, by = plane[b]
        cx, cy = plane[c]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0:
            continue
        top, bottom = int(np.ceil(min(ay, by, cy))), int(np.floor(max(ay, by, cy)))
        left, right = int(np.ceil(min(ax, bx, cx))), int(np.floor(max(ax, bx, cx)))
        for y in range(max(0, top), min(height - 1, bottom) + 1):
            for x in range(max(0, left), min(width - 1, right) + 1):
                of_b = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
                of_c = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
                of_a = 1 - of_b - of_c
                if of_a < 0 or of_b < 0 or of_c < 0:
                    continue
                z = of_a * depth[a] + of_b * depth[b] + of_c * depth[c]
                if z < nearest[y, x]:
                    nearest[y, x] = z
                    shown[y, x] = t
                    for k in range(values.shape[1]):
                        buffer[y, x, k] = (
                            of_a * values[a, k] + of_b * values[b, k] + of_c * values[c, k]
                        )
    return shown, buffer
