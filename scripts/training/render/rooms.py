"""Rooms and streets: a box seen from inside, with windows, doors and pictures on its walls."""

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from scripts.index.body import about_vertical
from scripts.training.render.furniture import wall_colour
from scripts.training.render.materials import (
    CELLS,
    GRAIN,
    PLAIN,
    PLANKS,
    TILES,
    Material,
    Materials,
    any_colour,
    surface,
)

OUTDOORS = 0.22
"""Share of scenes that are streets or yards."""

KINDS = ("window", "door", "picture", "shelf")
KIND_LIMITS = (0.25, 0.45, 0.8)
"""What hangs on walls or stands against them, and the cumulative shares of all but the last."""


@dataclass(frozen=True)
class Room:
    """A room in axes of its own, to which ``turn`` leads from the world's.

    Corners ``(2, 3)`` are its lowest and highest; materials ``(6, 12)`` those of low x, high x,
    floor, ceiling, low z and high z. Panels are as in
    :func:`scripts.training.render.raster.paint_room`. ``glow`` ``(5,)`` is a lamp: place, share,
    reach.
    """

    turn: NDArray[np.float64]
    corners: NDArray[np.float64]
    materials: NDArray[np.float32]
    panels: NDArray[np.float32]
    glow: NDArray[np.float64]
    outdoors: bool


def build_room(inside: NDArray[np.float64], floor: float, generator: Generator) -> Room:
    """A room about some places ``(P, 3)`` in world axes."""
    turn = about_vertical(np.array([generator.uniform(0, 2 * np.pi)]))[0]
    if generator.random() < 0.35:
        turn = about_vertical(
            np.array([generator.choice(4) * np.pi / 2 + generator.normal(0, 0.05)])
        )[0]
    places = inside @ turn.T
    outdoors = bool(generator.random() < OUTDOORS)
    reach = generator.uniform(5, 40, 4) if outdoors else np.exp(generator.uniform(-0.9, 1.6, 4))
    low, high = places.min(axis=0) - 0.35, places.max(axis=0) + 0.35
    low[[0, 2]] -= reach[:2]
    high[[0, 2]] += reach[2:]
    low[1] = floor
    high[1] = max(places[:, 1].max() + 0.15, floor + generator.uniform(2.2, 3.6))
    if outdoors:
        high[1] += generator.uniform(3, 15)
    walls = _wall(generator)
    kinds = [walls if generator.random() < 0.7 else _wall(generator) for _ in range(4)]
    floor_material, ceiling = _floor(generator), _ceiling(outdoors, generator)
    rows = [kinds[0], kinds[1], floor_material, ceiling, kinds[2], kinds[3]]
    if outdoors:
        rows = [row if number in (2, 3) else _facade(generator) for number, row in enumerate(rows)]
    table = Materials(rows).table()
    corners = np.stack([low, high])
    lamp = np.array([*generator.uniform(low, high), generator.uniform(0, 0.7),
                     generator.uniform(1.5, 5)])  # fmt: skip
    lamp[1] = high[1] - 0.3
    return Room(turn, corners, table, _panels(corners, outdoors, generator), lamp, outdoors)


def _wall(generator: Generator) -> Material:
    colour = wall_colour(generator)
    kind = int(generator.choice([PLAIN, GRAIN, GRAIN, TILES, CELLS], p=[0.35, 0.3, 0.2, 0.1, 0.05]))
    other = colour * generator.uniform(0.8, 1.1)
    return Material(
        colour, other, kind, float(np.exp(generator.uniform(-0.5, 1.5))),
        float(generator.uniform(0, 9)), float(generator.uniform(0.01, 0.04)),
    )  # fmt: skip


def _floor(generator: Generator) -> Material:
    material = surface(generator, pale=0.3)
    kind = int(generator.choice([PLAIN, GRAIN, PLANKS, TILES], p=[0.15, 0.4, 0.25, 0.2]))
    other = material.colour * generator.uniform(0.55, 1.2)
    return Material(material.colour * 0.8, other, kind, float(np.exp(generator.uniform(0, 2.2))),
                    material.phase, float(generator.uniform(0.01, 0.05)))  # fmt: skip


def _ceiling(outdoors: bool, generator: Generator) -> Material:
    if outdoors:
        sky = np.array([0.5, 0.62, 0.85]) * generator.uniform(0.5, 1.6)
        return Material(sky, np.repeat(generator.uniform(0.5, 1.2), 3), GRAIN, 0.1)
    colour = generator.uniform(0.45, 0.9) * generator.uniform(0.95, 1.03, 3)
    kind = TILES if generator.random() < 0.25 else PLAIN
    return Material(colour, colour * 0.7, kind, 1.6, 0.0, 0.02)


def _facade(generator: Generator) -> Material:
    """Houses, hedges, far away."""
    colour = any_colour(generator) * 0.8 + 0.05
    kind = int(generator.choice([GRAIN, CELLS, TILES, PLAIN], p=[0.45, 0.2, 0.25, 0.1]))
    return Material(colour, colour * generator.uniform(0.3, 0.9), kind,
                    float(np.exp(generator.uniform(-1.5, 1))), float(generator.uniform(0, 9)),
                    float(generator.uniform(0.05, 0.4)))  # fmt: skip


def _panels(
    corners: NDArray[np.float64], outdoors: bool, generator: Generator
) -> NDArray[np.float32]:
    """Draw random rectangles on the walls and the floor, a row each."""
    floor, ceiling = corners[0, 1], corners[1, 1]
    rows = []

    def put(side: int, u: float, v: float, size: NDArray[np.float64], material: Material,
            bright: float = 0.0) -> None:  # fmt: skip
        look = Materials([material]).table()[0]
        rows.append([side, u, u + size[0], v, v + size[1], bright, *look])

    board = surface(generator)
    for side in (0, 1, 4, 5):
        along = 2 if side < 2 else 0
        low, high = corners[0, along], corners[1, along]
        if not outdoors and generator.random() < 0.6:
            put(side, low, floor, np.array([high - low, 0.1]), board)
        # As dense on long walls as on short ones.
        for _ in range(generator.poisson(min(0.5 * (high - low), 5))):
            u = generator.uniform(low, high)
            kind = KINDS[int(np.searchsorted(KIND_LIMITS, generator.random(), side="right"))]
            if kind == "window":
                size = generator.uniform([0.6, 0.8], [2.0, 1.6])
                bright = generator.choice([0.0, generator.uniform(0.5, 4)])
                put(side, u, floor + 0.9, size, surface(generator, pale=0.7), bright)
            elif kind == "door":
                size = np.array([0.9, min(2.05, ceiling - floor - 0.1)])
                put(side, u, floor, size, surface(generator))
                put(side, u + 0.05, floor, size - [0.1, 0.05], surface(generator))
            elif kind == "picture":
                size = generator.uniform(0.2, [1.2, 0.9])
                frame, inside = surface(generator), surface(generator)
                put(side, u, floor + 1.3, size, frame)
                put(side, u + 0.03, floor + 1.33, size - 0.06, inside)
            else:
                size, shelf = generator.uniform([0.5, 1.0], [1.6, 2.1]), surface(generator)
                pattern = CELLS if generator.random() < 0.6 else PLANKS
                other, above = any_colour(generator), floor + generator.uniform(0, 0.4)
                frequency = float(generator.uniform(3, 8))
                look = Material(shelf.colour, other, pattern, frequency, 0.0, 0.2)
                put(side, u, above, size, look)
    if generator.random() < 0.3:
        # A rug.
        u, v = generator.uniform(corners[0, [0, 2]], corners[1, [0, 2]])
        put(2, u - 1, v - 1, generator.uniform(1, 3, 2), surface(generator))
    return np.array(rows, np.float32).reshape(-1, 18)
