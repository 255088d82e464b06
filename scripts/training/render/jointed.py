"""Jointed things that are no people: insects, birds, beasts, dolls, aircraft."""

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from scripts.training.render.materials import Materials, cloth, surface
from scripts.training.render.meshes import Mesh, ellipsoid, joined, tube
from scripts.training.render.pose import about


@dataclass(frozen=True)
class Kind:
    """Ranges from which the parts of a kind are drawn; lengths in those of the trunk.

    Pairs of limbs sit along the trunk, from the head on.
    """

    segments: tuple[int, int]
    thick: tuple[float, float]
    head: tuple[float, float]
    pairs: tuple[int, int]
    limb: tuple[float, float]
    limb_thick: tuple[float, float]
    wings: float = 0.0
    tail: float = 0.5
    upright: float = 0.0


KINDS = (
    # Insects, spiders, crabs, centipedes.
    Kind((3, 8), (0.08, 0.3), (0.08, 0.25), (3, 5), (0.4, 1.6), (0.01, 0.04), wings=0.3),
    Kind((10, 20), (0.03, 0.07), (0.04, 0.08), (8, 18), (0.1, 0.4), (0.004, 0.015)),
    # Birds, bats, aeroplanes.
    Kind((3, 6), (0.12, 0.3), (0.1, 0.2), (1, 1), (0.2, 0.9), (0.01, 0.04), wings=0.9, tail=0.9),
    Kind((5, 9), (0.05, 0.12), (0.04, 0.1), (0, 0), (0.1, 0.2), (0.02, 0.03), wings=1.0, tail=1.0),
    # Beasts on four legs, apes.
    Kind((4, 7), (0.13, 0.28), (0.13, 0.3), (2, 2), (0.5, 1.1), (0.03, 0.09), tail=0.8),
    Kind(
        (4, 6), (0.2, 0.36), (0.18, 0.28), (2, 2), (0.7, 1.3), (0.06, 0.14), tail=0.3, upright=0.5
    ),
    # Dolls, puppets, toy figures.
    Kind((2, 4), (0.15, 0.32), (0.25, 0.45), (2, 2), (0.5, 1.1), (0.05, 0.14), tail=0, upright=0.7),
)


def jointed_thing(materials: Materials, generator: Generator) -> Mesh:
    """A thing of any kind, size, colour and pose."""
    kind = KINDS[generator.integers(len(KINDS))]
    skin = materials.add(cloth(generator) if generator.random() < 0.6 else surface(generator))
    other = materials.add(cloth(generator)) if generator.random() < 0.5 else skin
    size = float(np.exp(generator.uniform(np.log(0.15), np.log(1.0))))
    spine = _spine(int(generator.integers(*kind.segments, endpoint=True)), generator)
    thick = generator.uniform(*kind.thick)
    girth = thick * (0.6 + 0.4 * np.sin(np.linspace(0.4, 2.8, len(spine))))
    girth *= generator.uniform(0.8, 1.2, len(spine))
    long = 0.75 / len(spine)
    parts = [
        ellipsoid(place, [wide, wide, max(long, 0.8 * wide)], skin, 9)
        for place, wide in zip(spine, girth, strict=True)
    ]
    parts += _head(spine[0], generator.uniform(*kind.head), other, generator)
    for at in _places(spine, int(generator.integers(*kind.pairs, endpoint=True)), generator):
        out, length = generator.uniform([-0.9, 0.7], [0.9, 1.3])
        for side in (-1.0, 1.0):
            if generator.random() < 0.04:
                continue
            swing = generator.normal(0, 0.35)
            start = at + np.array([side * thick * 0.8, 0.0, 0.0])
            reach = length * generator.uniform(*kind.limb)
            parts += _limb(start, side, out + swing, reach, kind, other, generator)
    if generator.random() < kind.wings:
        parts += _wings(spine, thick, other, generator)
    if generator.random() < kind.tail:
        end = spine[-1] + generator.normal(0, 0.15, 3) + [0, 0, -generator.uniform(0.1, 0.7)]
        parts.append(tube(spine[-1], end, generator.uniform(0.01, 0.08), skin, 6))
    mesh = joined(parts).placed(size * np.eye(3), np.zeros(3))
    return _set_down(mesh, generator.random() < kind.upright, generator)


def _spine(count: int, generator: Generator) -> NDArray[np.float64]:
    """Places ``(N, 3)`` along a bent trunk of length 1, from the head towards -z."""
    heading = np.cumsum(generator.normal(0, 0.25, (count, 2)), axis=0) * (3 / max(count, 3))
    steps = np.column_stack([np.sin(heading[:, 0]), 0.5 * np.sin(heading[:, 1])])
    steps = np.column_stack([steps, -np.cos(heading[:, 0])]) / count
    return np.asarray(np.cumsum(steps, axis=0) + np.array([0.0, 0.0, 0.5]))


def _places(
    spine: NDArray[np.float64], pairs: int, generator: Generator
) -> list[NDArray[np.float64]]:
    """Where pairs of limbs sit: the first near the head, the last near the end."""
    if pairs == 0:
        return []
    shares = np.linspace(0.1, 0.9, pairs) if pairs > 1 else np.array([0.6])
    rows = np.clip((shares + generator.normal(0, 0.03, pairs)) * (len(spine) - 1), 0, None)
    return [spine[min(round(row), len(spine) - 1)] for row in rows.tolist()]


def _head(
    neck: NDArray[np.float64], size: float, material: int, generator: Generator
) -> list[Mesh]:
    """A head, perhaps with a snout or a beak, eyes, ears or feelers; seldom none."""
    if generator.random() < 0.08:
        return []
    radii = size * generator.uniform(0.7, 1.2, 3)
    place = neck + size * generator.uniform([0.0, -0.1, 0.6], [1e-6, 0.5, 1.5])
    parts = [ellipsoid(place, radii, material, 10), tube(neck, place, size * 0.45, material, 7)]
    if generator.random() < 0.5:
        tip = place + size * np.array([0.0, -0.2, generator.uniform(1.1, 2.2)])
        parts.append(tube(place, tip, size * generator.uniform(0.12, 0.45), material, 7))
    for side in (-1.0, 1.0):
        eye = place + radii * [0.5 * side, 0.3, 0.8]
        parts.append(ellipsoid(eye, np.full(3, 0.13 * size), material, 5))
        if generator.random() < 0.5:
            top = place + radii * [0.6 * side, 0.8, 0.0]
            end = top + size * generator.uniform([0.2 * side, 0.2, -0.3], [0.6, 1.2, 0.8])
            parts.append(tube(top, end, size * 0.1, material, 5))
    return parts


def _limb(
    start: NDArray[np.float64],
    side: float,
    swing: float,
    length: float,
    kind: Kind,
    material: int,
    generator: Generator,
) -> list[Mesh]:
    """Two or three bones from the trunk outwards and down; ``swing`` leads ahead."""
    thick, parts = generator.uniform(*kind.limb_thick), []
    down = generator.uniform(-0.3, 1.4)
    bones = int(generator.integers(2, 4))
    for bone in range(bones):
        way = [side * np.cos(down) * np.cos(swing), -np.sin(down), np.sin(swing)]
        end = start + length / bones * np.array(way)
        parts.append(tube(start, end, thick * (1 - 0.2 * bone), material, 7))
        parts.append(ellipsoid(end, np.full(3, thick * 1.1), material, 6))
        start, down = end, down + generator.uniform(-0.3, 1.0)
        swing += generator.normal(0, 0.3)
    return parts


def _wings(
    spine: NDArray[np.float64], thick: float, material: int, generator: Generator
) -> list[Mesh]:
    """One or two pairs of flat wings, spread or raised."""
    parts = []
    for _ in range(int(generator.integers(1, 3))):
        at = spine[int(len(spine) * generator.uniform(0.1, 0.6))]
        span, deep = generator.uniform([0.5, 0.12], [1.4, 0.5])
        raised, swept = generator.uniform([-0.3, -0.5], [1.1, 0.5])
        for side in (-1.0, 1.0):
            wing = ellipsoid([span / 2, 0, 0], [span / 2, 0.02, deep / 2], material, 9)
            turn = about(np.array([0.0, 0.0, 1.0]), float(raised))
            turn = about(np.array([0.0, 1.0, 0.0]), float(swept)) @ turn
            turn = np.diag([side, 1.0, 1.0]) @ turn
            parts.append(wing.placed(turn, at + thick * np.array([0.5 * side, 0.3, 0.0])))
    return parts


def _set_down(mesh: Mesh, upright: bool, generator: Generator) -> Mesh:
    """On the ground, its trunk level or upright; or turned any way, as on a wall or in the air."""
    turn = about(np.array([1.0, 0.0, 0.0]), -np.pi / 2 if upright else 0.0)
    if generator.random() < 0.5:
        axis = generator.normal(size=3)
        turn = about(axis / np.linalg.norm(axis), float(generator.uniform(0, np.pi))) @ turn
    mesh = mesh.placed(turn, np.zeros(3))
    return mesh.placed(np.eye(3), [0.0, -float(mesh.vertices[:, 1].min()), 0.0])
