"""Triangle meshes, and the simple bodies that furniture is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class Mesh:
    """Triangles ``(T, 3)`` of vertices ``(V, 3)`` in world axes, metres, with a material.

    ``textured`` ``(V, 3)`` is where each vertex lies in the space of its material's pattern,
    metres; ``materials`` ``(V,)`` are rows of a table of materials.
    """

    vertices: NDArray[np.float32]
    textured: NDArray[np.float32]
    triangles: NDArray[np.int32]
    materials: NDArray[np.int32]

    def placed(self, turn: NDArray[np.float64], shift: ArrayLike) -> Mesh:
        """The same mesh, turned ``(3, 3)`` about the origin and then moved ``(3,)``."""
        moved = self.vertices @ turn.T + np.asarray(shift)
        return replace(self, vertices=moved.astype(np.float32))

    def part(self, kept: NDArray[np.bool_]) -> Mesh:
        """Some of the triangles ``(T,)`` and their vertices."""
        used, corners = np.unique(self.triangles[kept], return_inverse=True)
        triangles = corners.reshape(-1, 3).astype(np.int32)
        return Mesh(self.vertices[used], self.textured[used], triangles, self.materials[used])


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Several meshes as one, their triangles in order."""
    counts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]).astype(np.float32),
        np.concatenate([mesh.textured for mesh in meshes]).astype(np.float32),
        np.concatenate(
            [mesh.triangles + first for mesh, first in zip(meshes, counts, strict=False)]
        ).astype(np.int32),
        np.concatenate([mesh.materials for mesh in meshes]).astype(np.int32),
    )


def _mesh(vertices: ArrayLike, triangles: ArrayLike, material: int) -> Mesh:
    points = np.asarray(vertices, np.float32).reshape(-1, 3)
    corners = np.asarray(triangles, np.int32).reshape(-1, 3)
    return Mesh(points, points.copy(), corners, np.full(len(points), material, np.int32))


def grid(rows: int, columns: int) -> NDArray[np.int32]:
    """Triangles of a sheet of ``rows * columns`` vertices, row by row."""
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    one = np.stack([first, first + 1, first + columns], axis=1)
    other = np.stack([first + 1, first + columns + 1, first + columns], axis=1)
    return np.concatenate([one, other]).astype(np.int32)


def box(low: ArrayLike, high: ArrayLike, material: int, parts: int = 3) -> Mesh:
    """Box between two corners; each face of ``parts * parts`` squares, with edges that are sharp.

    Faces are cut up since what reaches behind the camera is left out triangle by triangle.
    """
    start, size = np.asarray(low, np.float64), np.asarray(high, np.float64) - np.asarray(low)
    steps = np.linspace(0.0, 1.0, parts + 1)
    across, along = (side.ravel() for side in np.meshgrid(steps, steps))
    faces = []
    for axis in range(3):
        for end in (0.0, 1.0):
            face = np.empty((len(across), 3))
            face[:, axis] = end
            face[:, (axis + 1) % 3], face[:, (axis + 2) % 3] = across, along
            faces.append(start + face * size)
    sheet = grid(parts + 1, parts + 1)
    triangles = [sheet + number * len(across) for number in range(6)]
    return _mesh(np.concatenate(faces), np.concatenate(triangles), material)


def ellipsoid(centre: ArrayLike, radii: ArrayLike, material: int, parts: int = 12) -> Mesh:
    """Ellipsoid whose axes are those of the world."""
    polar, around = np.linspace(0, np.pi, parts), np.linspace(0, 2 * np.pi, 2 * parts)
    p, a = np.meshgrid(polar, around, indexing="ij")
    unit = np.stack([np.sin(p) * np.cos(a), np.cos(p), np.sin(p) * np.sin(a)], axis=-1)
    points = unit.reshape(-1, 3) * np.asarray(radii) + np.asarray(centre)
    return _mesh(points, grid(parts, 2 * parts), material)


def tube(start: ArrayLike, end: ArrayLike, radius: float, material: int, parts: int = 10) -> Mesh:
    """Round bar between two points, closed by caps."""
    a, b = np.asarray(start, np.float64), np.asarray(end, np.float64)
    along = (b - a) / max(float(np.linalg.norm(b - a)), 1e-9)
    aside = np.cross(along, [0.0, 0.0, 1.0] if abs(along[2]) < 0.9 else [1.0, 0.0, 0.0])
    aside /= max(float(np.linalg.norm(aside)), 1e-9)
    other = np.cross(along, aside)
    angle = np.linspace(0, 2 * np.pi, parts + 1)
    ring = radius * (np.cos(angle)[:, None] * aside + np.sin(angle)[:, None] * other)
    rings = [np.repeat(a[None], parts + 1, 0), a + ring, b + ring]
    rings.append(np.repeat(b[None], parts + 1, 0))
    return _mesh(np.concatenate(rings), grid(4, parts + 1), material)


def wheel(centre: ArrayLike, axle: ArrayLike, radius: float, width: float, material: int) -> Mesh:
    """Ring with spokes, as of a wheelchair."""
    middle, along = np.asarray(centre, np.float64), np.asarray(axle, np.float64)
    along = along / np.linalg.norm(along)
    aside = np.cross(along, [0.0, 1.0, 0.0])
    aside /= np.linalg.norm(aside)
    other = np.cross(along, aside)
    angle = np.linspace(0, 2 * np.pi, 25)
    rim = middle + radius * (np.cos(angle)[:, None] * aside + np.sin(angle)[:, None] * other)
    parts = [tube(p, q, width, material, 5) for p, q in pairwise(rim)]
    parts += [tube(middle, point, width * 0.3, material, 4) for point in rim[:-1:4]]
    return joined(parts)


def sheet(
    x: NDArray[np.float64], z: NDArray[np.float64], heights: NDArray[np.float64], material: int
) -> Mesh:
    """Cloth over a grid: ``heights`` ``(len(z), len(x))`` above the ground."""
    across, along = np.meshgrid(x, z)
    points = np.stack([across, heights, along], axis=-1)
    return _mesh(points, grid(len(z), len(x)), material)
