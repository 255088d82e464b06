"""What surfaces look like: colours, patterns, wrinkles, gloss."""

from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

PLAIN, STRIPES, BARS, CHECKS, BLOTCHES, PRINT, STRANDS, CELLS, PLANKS, TILES, GRAIN = range(11)
"""Kinds of patterns."""

CLOTH_PATTERNS = (PLAIN, PLAIN, PLAIN, PLAIN, STRIPES, BARS, CHECKS, BLOTCHES, PRINT, GRAIN)
SURFACE_PATTERNS = (PLAIN, PLAIN, GRAIN, GRAIN, BLOTCHES, CELLS, PLANKS, TILES)

SKINS = np.array(
    [[0.75, 0.52, 0.40], [0.62, 0.40, 0.28], [0.48, 0.28, 0.18], [0.80, 0.60, 0.48],
     [0.30, 0.16, 0.10], [0.16, 0.085, 0.055], [0.55, 0.36, 0.24], [0.68, 0.45, 0.33]]
)  # fmt: skip
HAIRS = np.array(
    [[0.02, 0.015, 0.012], [0.04, 0.025, 0.018], [0.06, 0.035, 0.02], [0.15, 0.08, 0.04],
     [0.35, 0.22, 0.10], [0.30, 0.30, 0.30], [0.6, 0.6, 0.58]]
)  # fmt: skip


@dataclass(frozen=True)
class Material:
    """One surface: the colours of ground and pattern, linear RGB, and the kind of pattern.

    The frequency is in periods a metre; ``phase`` and ``duty`` are where the pattern begins, in
    periods, and the share of it that has the other colour. ``wrinkles`` is how far these turn the
    surface, as a share of its normal; ``gloss`` is the strength of the highlight.
    """

    colour: NDArray[np.float64]
    other: NDArray[np.float64]
    kind: int = PLAIN
    frequency: float = 8.0
    phase: float = 0.0
    duty: float = 0.5
    wrinkles: float = 0.0
    gloss: float = 0.03


@dataclass
class Materials:
    """A table of materials that grows as a scene is furnished."""

    rows: list[Material] = field(default_factory=list)

    def add(self, material: Material) -> int:
        """Append a material and return its row."""
        self.rows.append(material)
        return len(self.rows) - 1

    def table(self) -> NDArray[np.float32]:
        """``(M, 12)``: colour, other colour, kind, frequency, phase, duty, wrinkles, gloss."""
        return np.array(
            [
                [*m.colour, *m.other, m.kind, m.frequency, m.phase, m.duty, m.wrinkles, m.gloss]
                for m in self.rows
            ],
            np.float32,
        )


def any_colour(generator: Generator) -> NDArray[np.float64]:
    """Linear RGB of any hue, as photographs show it: seldom pure."""
    hue, saturation = generator.random(), generator.beta(1.0, 2.2)
    if generator.random() < 0.45:
        # Wood, sand, brick, leather.
        hue, saturation = generator.normal(0.07, 0.03) % 1, generator.beta(2, 3)
    ramp = np.clip(np.abs((hue * 6 + np.array([0.0, 4.0, 2.0])) % 6 - 3) - 1, 0, 1)
    value = generator.uniform(0.1, 0.9)
    return np.asarray((value * (1 - saturation + saturation * ramp)) ** 2.2)


def cloth_colour(generator: Generator) -> NDArray[np.float64]:
    """Dark, white, denim or any."""
    chance = generator.random()
    if chance < 0.28:
        return np.asarray(generator.uniform(0.008, 0.10) * generator.uniform(0.8, 1.2, 3))
    if chance < 0.42:
        return np.asarray(generator.uniform(0.35, 0.85) * generator.uniform(0.9, 1.1, 3))
    if chance < 0.55:
        return np.array([0.04, 0.07, 0.16]) * generator.uniform(0.5, 3.0)
    return any_colour(generator)


def cloth(generator: Generator) -> Material:
    """Of clothes, blankets and upholstery."""
    colour = cloth_colour(generator)
    second = (
        cloth_colour(generator)
        if generator.random() < 0.5
        else colour * generator.uniform(0.5, 1.6)
    )
    return Material(
        colour,
        second,
        int(generator.choice(CLOTH_PATTERNS)),
        float(np.exp(generator.uniform(np.log(3), np.log(25)))),
        float(generator.random()),
        float(generator.uniform(0.2, 0.7)),
        float(generator.uniform(0.1, 0.6)),
        float(generator.uniform(0.0, 0.06)),
    )


def surface(generator: Generator, *, pale: float = 0.35) -> Material:
    """Of walls, floors and furniture; a share of them is pale."""
    if generator.random() < pale:
        colour = generator.uniform(0.3, 0.8) * generator.uniform(0.85, 1.1, 3)
    else:
        colour = any_colour(generator)
    chance = generator.random()
    second = any_colour(generator) if chance < 0.15 else colour * generator.uniform(0.6, 1.3)
    kind = int(generator.choice(SURFACE_PATTERNS))
    return Material(
        colour,
        second,
        kind,
        float(np.exp(generator.uniform(np.log(1.0), np.log(8.0)))),
        float(generator.uniform(0, 10)),
        float(generator.uniform(0.02, 0.08) if kind in (PLANKS, TILES) else generator.random()),
        0.0,
        float(generator.uniform(0.0, 0.1)),
    )
