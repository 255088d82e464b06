"""Bodies made of pictures of things: cut out, inflated and coloured."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from scripts.training.render.materials import Material, Materials, cloth
from scripts.training.render.meshes import Mesh, grid, joined

CutOut = NDArray[np.uint8]
"""A picture ``(H, W, 4)``, BGR and opacity."""

CELLS = 110
"""Cells along the longer side of a body."""

RECOLOURED, FLAT = 0.3, 0.3
"""Shares: of bodies in one cloth or stone instead of the picture's colours; of those that stay
flat, such as posters and garments that are laid out."""


def read_cut_outs(folder: Path, *, held_out: bool) -> list[CutOut]:
    """Every fifth picture of a folder, or the others.

    Raises
    ------
    FileNotFoundError
        If there is none.
    """
    files = sorted(folder.glob("*.png"))
    chosen = [file for row, file in enumerate(files) if (row % 5 == 1) == held_out]
    pictures = [cv2.imread(str(file), cv2.IMREAD_UNCHANGED) for file in chosen]
    found = [np.asarray(one, np.uint8) for one in pictures if one is not None and one.ndim == 3]
    if not found:
        raise FileNotFoundError(f"expected pictures of cut-out things in {folder}, found none")
    return [one for one in found if one.shape[2] == 4]


def inflated(cut_outs: Sequence[CutOut], materials: Materials, generator: Generator) -> Mesh:
    """One of the pictures as a body that stands in the plane of x and y."""
    picture = cut_outs[int(generator.integers(len(cut_outs)))]
    scale = CELLS / max(picture.shape[:2])
    shape = [max(3, round(side * scale)) for side in picture.shape[1::-1]]
    small = cv2.resize(picture, shape, interpolation=cv2.INTER_AREA).astype(np.float32)
    small = np.pad(small, ((1, 1), (1, 1), (0, 0)))
    if generator.random() < 0.5:
        small = small[:, ::-1]
    solid = _filled(small[..., 3] > 100)
    opaque = np.clip(small[..., 3:] / 255, 0, 1)
    ground = generator.uniform(40, 240)
    colours = small[..., :3] * opaque + ground * (1 - opaque)
    inside = cv2.distanceTransform(solid.astype(np.uint8), cv2.DIST_L2, 5)
    bulge = 0.0 if generator.random() < FLAT else generator.uniform(0.4, 1.2)
    relief = cv2.GaussianBlur(bulge * np.sqrt(inside * inside.max()), (0, 0), 1.0)
    rows, columns = solid.shape
    y, x = np.mgrid[:rows, :columns]
    cell = np.exp(generator.uniform(np.log(0.2), np.log(1.8))) / CELLS
    triangles, material = grid(rows, columns), _materials(colours, materials, generator)
    kept = np.asarray(solid.ravel()[triangles].all(axis=1))
    faces = []
    for side in (1.0, -1.0):
        points = np.stack([x - columns / 2, rows / 2 - y, side * (relief + 0.3)], axis=-1)
        vertices = (cell * points).reshape(-1, 3).astype(np.float32)
        faces.append(Mesh(vertices, vertices, triangles, material).part(kept))
    return joined(faces)


def _filled(solid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A silhouette without holes; lines are two cells wide."""
    outlines, _ = cv2.findContours(solid.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = np.zeros(solid.shape, np.uint8)
    cv2.drawContours(filled, outlines, -1, 1, cv2.FILLED)
    return np.asarray(cv2.dilate(filled, np.ones((2, 2), np.uint8)) > 0)


def _materials(
    colours: NDArray[np.floating], materials: Materials, generator: Generator
) -> NDArray[np.int32]:
    """Materials ``(H * W,)`` of colours ``(H, W, 3)``, BGR, of which few are told apart."""
    colours = colours.reshape(-1, 3)
    if generator.random() < RECOLOURED:
        return np.full(len(colours), materials.add(cloth(generator)), np.int32)
    levels = (colours[:, ::-1] // 43).astype(np.int64)
    kinds, which = np.unique(levels, axis=0, return_inverse=True)
    gain = generator.uniform(0.4, 1.1) * generator.uniform(0.85, 1.15, 3)
    gloss = float(generator.uniform(0.0, 0.2))
    rows = []
    for kind in kinds:
        linear = ((kind * 43 + 21) / 255.0) ** 2.2 * gain
        rows.append(materials.add(Material(linear, linear, gloss=gloss)))
    return np.array(rows, np.int32)[which.ravel()]
