"""MakeHuman garments and hair fitted to bodies, and the avatars that wear them.

The fit is the one MakeHuman documents for its ``.mhclo`` files: a garment vertex is a weighted sum
of three vertices of the base mesh plus an offset, which is scaled, axis by axis, by how far
apart two named vertices of this body are against the reference body.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scripts.index.body import Avatar, BaseMesh, Phenotype, compact, make_avatar, strongest

DECIMETRE = 0.1
"""MakeHuman's unit, in metres."""


class GarmentError(ValueError):
    """A garment that cannot be used; the message names the file, the line and what is wrong."""


@dataclass(frozen=True)
class Garment:
    """One ``.mhclo`` file with its mesh."""

    name: str
    anchors: NDArray[np.int32]  # (V, 3): vertices of the base mesh that hold each garment vertex
    shares: NDArray[np.float64]  # (V, 3): their weights
    offsets: NDArray[np.float64]  # (V, 3): decimetres on the reference body, body axes
    # (3, 3): for x, y and z: two vertices of the base mesh and their distance along that axis on
    # the reference body, in decimetres.
    scales: NDArray[np.float64]
    triangles: NDArray[np.int32]  # (T, 3)
    hidden: NDArray[np.int64]  # (H,): vertices of the base mesh that the garment covers


def find_garments(folder: Path) -> dict[str, Path]:
    """All ``.mhclo`` files below a folder by name; ``GarmentError`` where there is none."""
    files = {file.stem: file for file in sorted(Path(folder).glob("*/*/*.mhclo"))}
    if not files:
        raise GarmentError(f"the garments folder {folder} holds no .mhclo file two folders down")
    return files


def read_garment(file: Path) -> Garment:
    """Read a ``.mhclo`` file and the ``.obj`` mesh it names.

    Raises
    ------
    GarmentError
        If either is missing or malformed.
    """
    file = Path(file)
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise GarmentError(f"the garment {file} cannot be read: {error}") from error
    found = _Content(file.with_suffix(".obj").name)
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            found.add(words)
        except (IndexError, ValueError) as error:
            raise GarmentError(f"line {number} of {file} is malformed: {line.strip()!r}") from error
    if not found.rows or len(found.scales) != len(_SCALES):
        raise GarmentError(f"{file} is no garment: expected x_scale, y_scale, z_scale and verts")
    anchors, shares, offsets = zip(*found.rows, strict=True)
    return Garment(
        name=file.stem,
        anchors=np.array(anchors, np.int32),
        shares=np.array(shares),
        offsets=np.array(offsets),
        scales=np.array([found.scales[axis] for axis in _SCALES]),
        triangles=_read_triangles(file.parent / found.mesh, len(found.rows)),
        hidden=np.array(found.hidden, np.int64),
    )


_SCALES = ("x_scale", "y_scale", "z_scale")


@dataclass
class _Content:
    """What the lines of a file say."""

    mesh: str
    scales: dict[str, list[float]] = field(default_factory=dict)
    rows: list[tuple[list[int], list[float], list[float]]] = field(default_factory=list)
    hidden: list[int] = field(default_factory=list)
    section: str = ""

    def add(self, words: list[str]) -> None:
        """Add a line; ``IndexError`` or ``ValueError`` if it is malformed."""
        key = words[0]
        if key in _SCALES:
            self.scales[key] = [int(words[1]), int(words[2]), float(words[3])]
        elif key == "obj_file":
            self.mesh = words[1]
        elif key in ("verts", "delete_verts"):
            self.section = key
        elif key.lstrip("-").isdigit() and self.section == "verts":
            self.rows.append(_anchor(words))
        elif key.isdigit() and self.section == "delete_verts":
            self.hidden += _ranges(words)


def _anchor(words: list[str]) -> tuple[list[int], list[float], list[float]]:
    if len(words) == 1:
        return [int(words[0])] * 3, [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]
    numbers = [float(word) for word in words[3:9]]
    if len(numbers) != 6:
        raise ValueError("expected three vertices, three weights and an offset")
    return [int(word) for word in words[:3]], numbers[:3], numbers[3:]


def _ranges(words: list[str]) -> list[int]:
    """``12 - 15 20`` to 12, 13, 14, 15, 20."""
    vertices: list[int] = []
    position = 0
    while position < len(words):
        first = int(words[position])
        if position + 2 < len(words) and words[position + 1] == "-":
            vertices += range(first, int(words[position + 2]) + 1)
            position += 3
        else:
            vertices.append(first)
            position += 1
    return vertices


def _read_triangles(mesh: Path, vertices: int) -> NDArray[np.int32]:
    try:
        lines = mesh.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise GarmentError(f"the garment mesh {mesh} cannot be read: {error}") from error
    triangles = []
    for number, line in enumerate(lines, start=1):
        if not line.startswith("f "):
            continue
        try:
            corners = [int(word.split("/")[0]) - 1 for word in line.split()[1:]]
        except ValueError as error:
            raise GarmentError(f"line {number} of {mesh} is malformed: {line!r}") from error
        if len(corners) < 3 or not all(0 <= corner < vertices for corner in corners):
            raise GarmentError(
                f"line {number} of {mesh} names a vertex beyond the {vertices} of its .mhclo file"
            )
        triangles += [(corners[0], corners[k], corners[k + 1]) for k in range(1, len(corners) - 1)]
    return np.array(triangles, np.int32).reshape(-1, 3)


def fit(garment: Garment, base: BaseMesh) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Vertices ``(V, 3)`` in body axes and dense skin weights ``(V, B)`` of a garment on a body."""
    ends = base.vertices[garment.scales[:, :2].astype(int)]
    apart = np.abs(ends[:, 0] - ends[:, 1])[np.arange(3), np.arange(3)] / DECIMETRE
    scale = apart / garment.scales[:, 2] * DECIMETRE
    held = np.einsum("vk,vkx->vx", garment.shares, base.vertices[garment.anchors])
    shares = np.maximum(garment.shares, 0).astype(np.float32)
    weights = np.einsum("vk,vkb->vb", shares, base.dense_weights[garment.anchors])
    return held + garment.offsets * scale, weights / weights.sum(axis=1, keepdims=True)


Layers = tuple[list[NDArray[np.float64]], list[NDArray[np.float32]], list[NDArray[np.int32]]]
"""Vertices, dense skin weights and triangles: of the skin, then of each garment."""


def layers_of(base: BaseMesh, garments: Sequence[Garment]) -> Layers:
    """Garments on a body, and the skin that they leave uncovered; all vertices of both."""
    hidden = np.zeros(len(base.vertices), bool)
    for garment in garments:
        hidden[garment.hidden] = True
    skin = base.triangles[~hidden[base.triangles].all(axis=1)]
    vertices, weights, triangles = [base.vertices], [base.dense_weights], [skin]
    count = len(base.vertices)
    for garment in garments:
        fitted, moved_by = fit(garment, base)
        vertices.append(fitted)
        weights.append(moved_by)
        triangles.append(garment.triangles + count)
        count += len(fitted)
    return vertices, weights, triangles


def dress(avatar: Avatar, base: BaseMesh, garments: Sequence[Garment]) -> Avatar:
    """Put the avatar in its garments, without the skin they hide."""
    vertices, weights, triangles = layers_of(base, garments)
    influences, kept = strongest(np.concatenate(weights))
    return compact(
        replace(
            avatar,
            vertices=np.concatenate(vertices).astype(np.float32),
            triangles=np.concatenate(triangles).astype(np.int32),
            closed=len(triangles[0]),
            influences=influences,
            weights=kept,
        )
    )


Wardrobe = tuple[str, ...]


def make_avatars(
    wanted: Iterable[tuple[Phenotype, Wardrobe]], garments: Path | None
) -> list[Avatar]:
    """Make dressed avatars; unclothed ones if no garments folder is given.

    Raises
    ------
    GarmentError
        If a garment is missing or malformed.
    """
    files = find_garments(garments) if garments is not None else {}
    avatars = []
    for phenotype, wardrobe in wanted:
        avatar, base = make_avatar(phenotype)
        if files and wardrobe:
            avatar = dress(avatar, base, [read_garment(files[name]) for name in wardrobe])
        avatars.append(avatar)
    return avatars
