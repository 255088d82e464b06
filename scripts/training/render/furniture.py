"""Furniture, bags and animals as simple bodies.

Objects stand on the floor, at height 0, and face +z. Objects fitted to a person use the person's
axes and the height of their support.
"""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from scripts.training.render.materials import Materials, any_colour, cloth, surface
from scripts.training.render.meshes import Mesh, box, ellipsoid, joined, sheet, tube, wheel


def _legs(
    low: tuple[float, float], high: tuple[float, float], floor: float, top: float, radius: float,
    material: int,
) -> list[Mesh]:  # fmt: skip
    return [
        tube([x, floor, z], [x, top, z], radius, material, 6)
        for x in (low[0], high[0])
        for z in (low[1], high[1])
    ]


def chair(
    floor: float, seat: float, behind: float, materials: Materials, generator: Generator
) -> Mesh:
    """Something to sit on: stool, chair, armchair, sofa, bench, bed or wheelchair.

    Floor and seat are heights in metres; a back may stand ``behind``, along z.
    """
    frame = materials.add(surface(generator, pale=0.2))
    soft = materials.add(cloth(generator))
    kind = generator.choice(
        ["stool", "chair", "armchair", "sofa", "bench", "bed", "wheelchair", "office"],
        p=[0.07, 0.27, 0.13, 0.17, 0.06, 0.14, 0.08, 0.08],
    )
    width = generator.uniform(0.2, 0.27)
    front = generator.uniform(0.1, 0.3)
    thick = generator.uniform(0.03, 0.1)
    back = seat + generator.uniform(0.3, 0.75)
    parts = [box([-width, seat - thick, behind], [width, seat, front], soft)]
    corners = ((-width + 0.03, behind + 0.03), (width - 0.03, front - 0.03))
    if kind == "stool":
        parts += _legs(*corners, floor, seat, 0.02, frame)
    elif kind == "chair":
        parts += _legs(*corners, floor, seat, generator.uniform(0.012, 0.03), frame)
        parts.append(box([-width, seat + 0.05, behind - 0.05], [width, back, behind], soft))
    elif kind == "office":
        parts.append(tube([0, floor + 0.05, 0], [0, seat, 0], 0.03, frame))
        parts += [
            tube(
                [0, floor + 0.05, 0], [0.3 * np.sin(a), floor + 0.03, 0.3 * np.cos(a)], 0.025, frame
            )
            for a in np.arange(5) * 2 * np.pi / 5
        ]
        parts.append(box([-width, seat + 0.1, behind - 0.07], [width, back, behind], soft))
    elif kind in ("armchair", "sofa"):
        room = 0.08 if kind == "armchair" else generator.uniform(0.3, 0.9)
        other = 0.08 if kind == "armchair" else generator.uniform(0.1, 0.9)
        left, right, arm = -width - room, width + other, generator.uniform(0.08, 0.2)
        rest = seat + generator.uniform(0.1, 0.28)
        parts = [
            box([left, floor, behind], [right, seat, front + 0.1], soft),
            box([left, floor, behind - 0.2], [right, back, behind], soft),
            box([left - arm, floor, behind - 0.2], [left, rest, front + 0.1], soft),
            box([right, floor, behind - 0.2], [right + arm, rest, front + 0.1], soft),
        ]
    elif kind == "bench":
        wide = generator.uniform(0.5, 1.2)
        parts = [box([-wide, seat - 0.05, behind], [wide, seat, front], frame)]
        parts += _legs((-wide + 0.1, behind), (wide - 0.1, front), floor, seat, 0.03, frame)
    elif kind == "bed":
        far, aside = generator.uniform(0.5, 1.6), generator.uniform(0.5, 1.3, 2)
        parts = [
            box([-aside[0], seat - 0.2, -far], [aside[1], seat, front], soft, 5),
            box([-aside[0], floor, -far], [aside[1], seat - 0.2, front - 0.03], frame, 5),
        ]
    else:
        large = generator.uniform(0.26, 0.33)
        parts.append(box([-width, seat, behind - 0.04], [width, seat + 0.45, behind], soft))
        for x in (-width - 0.05, width + 0.05):
            parts.append(wheel([x, floor + large, behind + 0.1], [1, 0, 0], large, 0.015, frame))
            parts.append(wheel([x, floor + 0.09, front + 0.15], [1, 0, 0], 0.09, 0.012, frame))
            parts.append(box([x - 0.03, seat + 0.2, behind], [x + 0.03, seat + 0.23, front], frame))
            parts.append(tube([x, seat + 0.2, front], [x, floor + 0.1, front + 0.25], 0.012, frame))
            parts.append(
                tube([x, floor + 0.4, behind], [x, seat + 0.5, behind - 0.1], 0.012, frame)
            )
    return joined(parts)


def helmet(head: NDArray[np.float64], materials: Materials, generator: Generator) -> Mesh:
    """Shell about the middle ``(3,)`` of the ears."""
    shell = materials.add(surface(generator))
    return ellipsoid(head + np.array([0.0, 0.06, -0.01]), [0.12, 0.12, 0.15], shell)


def desk(floor: float, top: float, near: float, materials: Materials, generator: Generator) -> Mesh:
    """Table from ``near`` along z on, with what lies on it."""
    plate = materials.add(surface(generator))
    left, right = -generator.uniform(0.35, 1.0), generator.uniform(0.35, 1.0)
    far = near + generator.uniform(0.5, 0.9)
    parts = [box([left, top - 0.04, near], [right, top, far], plate)]
    parts += _legs((left + 0.05, near + 0.05), (right - 0.05, far - 0.05), floor, top, 0.025, plate)
    if generator.random() < 0.35:
        parts.append(box([left, floor + 0.1, far - 0.05], [right, top - 0.04, far - 0.03], plate))
    elif generator.random() < 0.15:
        hem = max(floor, top - generator.uniform(0.15, 0.7))
        cover = materials.add(cloth(generator))
        parts.append(box([left - 0.01, hem, near - 0.01], [right + 0.01, top + 0.01, far], cover))
    for _ in range(generator.integers(0, 4)):
        x, z = generator.uniform(left, right - 0.1), generator.uniform(near + 0.15, far - 0.05)
        size = generator.uniform([0.05, 0.02, 0.02], [0.45, 0.4, 0.08])
        item = materials.add(surface(generator))
        parts.append(box([x, top, z], np.array([x, top, z]) + size, item, 1))
    return joined(parts)


def bed(
    floor: float,
    top: float,
    length: tuple[float, float],
    materials: Materials,
    generator: Generator,
) -> Mesh:
    """Bed, sofa, mat or stretcher along z between two ends; the head at the low end."""
    soft, frame = materials.add(cloth(generator)), materials.add(surface(generator))
    low, high = length[0] - generator.uniform(0.05, 0.4), length[1] + generator.uniform(0.0, 0.4)
    left, right = generator.uniform(0.35, 1.0, 2)
    mattress = min(generator.uniform(0.1, 0.25), top - floor)
    parts = [box([-left, top - mattress, low], [right, top, high], soft, 6)]
    if top - floor > 0.2:
        if generator.random() < 0.6:
            parts.append(box([-left, floor, low], [right, top - mattress, high], frame, 6))
        else:
            ends = ((-left + 0.05, low + 0.05), (right - 0.05, high - 0.05))
            parts += _legs(*ends, floor, top - mattress, 0.035, frame)
        if generator.random() < 0.6:
            head = top + generator.uniform(0.15, 0.6)
            parts.append(box([-left, floor, low - 0.05], [right, head, low], frame, 4))
        if generator.random() < 0.3:
            foot = top + generator.uniform(0.0, 0.3)
            parts.append(box([-left, floor, high], [right, foot, high + 0.05], frame, 4))
        if generator.random() < 0.25:
            for x in (-left, right):
                for up in (0.12, 0.28):
                    parts.append(tube([x, top + up, low], [x, top + up, high], 0.012, frame))
        if generator.random() < 0.3:
            parts.append(box([right - 0.12, floor, low], [right + 0.1, top + 0.4, high], soft, 5))
    if generator.random() < 0.7:
        pillow = materials.add(cloth(generator))
        place = [generator.normal(0, 0.05), top, low + 0.25]
        parts.append(ellipsoid(place, [0.32, 0.07, 0.2], pillow))
    return joined(parts)


def blanket(
    body: NDArray[np.float32], top: float, share: float, materials: Materials, generator: Generator
) -> Mesh:
    """Cloth over the legs of a person who lies along z, up to a share of the length."""
    low, high = float(body[:, 2].min()), float(body[:, 2].max())
    begin = high - share * (high - low)
    x = np.arange(float(body[:, 0].min()) - 0.25, float(body[:, 0].max()) + 0.25, 0.04)
    z = np.arange(begin, high + 0.12, 0.04)
    heights = np.full((len(z), len(x)), top, np.float32)
    under = body[body[:, 2] > begin - 0.05]
    column = np.clip(((under[:, 0] - x[0]) / 0.04).astype(int), 0, len(x) - 1)
    row = np.clip(((under[:, 2] - z[0]) / 0.04).astype(int), 0, len(z) - 1)
    np.maximum.at(heights, (row, column), under[:, 1])
    wide = cv2.dilate(heights, np.ones((5, 5), np.uint8))
    draped = np.asarray(cv2.GaussianBlur(wide, (0, 0), 1.5) + 0.025, np.float32)
    draped += generator.normal(0, 0.006, draped.shape).astype(np.float32)
    return sheet(x, z, draped.astype(np.float64), materials.add(cloth(generator)))


def lap_blanket(
    body: NDArray[np.float32], floor: float, seat: float, materials: Materials, generator: Generator
) -> list[Mesh]:
    """Cloth over the legs of a person who sits and faces +z."""
    legs = body[(body[:, 1] < seat + 0.22) & (body[:, 2] > 0.05)]
    if not len(legs):
        return []  # Both are drawn back under the seat.
    hem = floor + generator.uniform(0.05, 0.35)
    return [blanket(legs, hem, 0.98, materials, generator)]


def cycle(floor: float, saddle: float, materials: Materials, generator: Generator) -> Mesh:
    """Bicycle, scooter or motorcycle towards +z, its saddle below the origin."""
    frame, tyre = materials.add(surface(generator, pale=0.15)), materials.add(surface(generator))
    motor = generator.random() < 0.4
    radius = generator.uniform(0.24, 0.3) if motor else generator.uniform(0.28, 0.36)
    rear = np.array([0.0, floor + radius, -generator.uniform(0.35, 0.55)])
    front = np.array([0.0, floor + radius, generator.uniform(0.55, 0.8)])
    head = np.array([0.0, max(saddle, floor + 0.75), front[2] - 0.15])
    bar = head + np.array([0.0, generator.uniform(0.05, 0.25), -0.02])
    crank = np.array([0.0, floor + 0.3, 0.08])
    seat = np.array([0.0, saddle - 0.03, -0.05])
    grip = np.array([generator.uniform(0.2, 0.38), 0.0, 0.0])
    thick = 0.035 if motor else 0.018
    parts = [wheel(place, [1, 0, 0], radius, 0.05 if motor else 0.018, tyre)
             for place in (rear, front)]  # fmt: skip
    parts += [
        tube(start, end, thick, frame, 7)
        for start, end in ((seat, crank), (seat, head), (crank, head), (crank, rear), (seat, rear),
                           (bar, front), (bar - grip, bar + grip))
    ]  # fmt: skip
    if not motor:
        parts.append(ellipsoid(seat, [0.09, 0.04, 0.14], tyre, 7))
        return joined(parts)
    paint = materials.add(surface(generator, pale=0.25))
    parts.append(box([-0.13, saddle - 0.12, -0.6], [0.13, saddle, 0.2], tyre))
    parts.append(box([-0.16, floor + 0.25, -0.5], [0.16, saddle - 0.12, 0.05], paint))
    if generator.random() < 0.5:
        shield = [-0.22, floor + 0.25, head[2] - 0.06], [0.22, head[1], head[2]]
        parts.append(box(*shield, paint))
    else:
        parts.append(ellipsoid([0, saddle, 0.3], [0.13, 0.14, 0.22], paint, 8))
    return joined(parts)


def walking_frame(materials: Materials, generator: Generator) -> Mesh:
    """Four legs, rails for the hands and bars between, open to -z; with wheels or a seat."""
    metal = materials.add(surface(generator, pale=0.6))
    wide, deep = generator.uniform(0.24, 0.3), generator.uniform(0.2, 0.3)
    high = generator.uniform(0.78, 0.95)
    parts = _legs((-wide, -deep), (wide, deep), 0.0, high, 0.014, metal)
    for up in (high, 0.45 * high):
        parts += [tube([x, up, -deep], [x, up, deep], 0.014, metal) for x in (-wide, wide)]
        parts.append(tube([-wide, up - 0.03, deep], [wide, up - 0.03, deep], 0.014, metal))
    if generator.random() < 0.5:
        parts += [wheel([x, 0.08, z], [1, 0, 0], 0.08, 0.015, metal)
                  for x in (-wide, wide) for z in (-deep, deep)]  # fmt: skip
        cloth_row = materials.add(cloth(generator))
        parts.append(box([-wide, 0.5, -0.05], [wide, 0.56, deep], cloth_row, 2))
    return joined(parts)


def cupboard(materials: Materials, generator: Generator) -> Mesh:
    """A box of any size."""
    size = generator.uniform([0.2, 0.3, 0.2], [0.8, 1.9, 0.5]) * [1, generator.random() ** 0.5, 1]
    material = materials.add(surface(generator))
    parts = [box([-size[0], 0, -size[2]], size, material)]
    if generator.random() < 0.5:
        front = materials.add(surface(generator))
        parts.append(box([-size[0] * 0.9, 0.06, size[2]],
                         [size[0] * 0.9, size[1] * 0.95, size[2] + 0.015], front))  # fmt: skip
    return joined(parts)


def empty_table(materials: Materials, generator: Generator) -> Mesh:
    """Table or desk."""
    return desk(0.0, generator.uniform(0.4, 0.8), -0.3, materials, generator)


def empty_chair(materials: Materials, generator: Generator) -> Mesh:
    """Chair, armchair, sofa, wheelchair."""
    return chair(0.0, generator.uniform(0.38, 0.55), -0.25, materials, generator)


def empty_bed(materials: Materials, generator: Generator) -> Mesh:
    """Bed, perhaps with a crumpled blanket."""
    top = generator.uniform(0.2, 0.6)
    parts = [bed(0.0, top, (-0.9, 0.9), materials, generator)]
    if generator.random() < 0.6:
        x, z = np.arange(-0.6, 0.6, 0.05), np.arange(-0.3, 0.9, 0.05)
        lumps = cv2.GaussianBlur(
            generator.normal(0, 1, (len(z), len(x))).astype(np.float32), (0, 0), 2.0
        )
        heights = top + 0.03 + 0.35 * np.maximum(lumps, 0).astype(np.float64)
        parts.append(sheet(x, z, heights, materials.add(cloth(generator))))
    return joined(parts)


def empty_cycle(materials: Materials, generator: Generator) -> Mesh:
    """Parked bicycle, scooter or motorcycle."""
    return cycle(0.0, generator.uniform(0.75, 0.95), materials, generator)


def bag(materials: Materials, generator: Generator) -> Mesh:
    """Rucksack, handbag, bin bag or suitcase."""
    material, second = materials.add(cloth(generator)), materials.add(cloth(generator))
    wide, high, deep = generator.uniform([0.12, 0.25, 0.08], [0.3, 0.65, 0.2])
    if generator.random() < 0.3:
        parts = [box([-wide, 0, -deep], [wide, high, deep], material)]
    else:
        parts = [ellipsoid([0, high * 0.5, 0], [wide, high * 0.5, deep], material)]
        parts.append(
            ellipsoid([0, high * 0.35, deep * 0.8], [wide * 0.7, high * 0.3, deep], second)
        )
    for x in (-wide * 0.5, wide * 0.5):
        parts.append(tube([x, high * 0.95, -deep], [x, high * 0.2, -deep * 1.6], 0.02, second))
    parts.append(tube([-0.06, high, 0], [0.06, high + 0.06, 0], 0.015, second))
    return joined(parts)


def plant(materials: Materials, generator: Generator) -> Mesh:
    """Pot with leaves, or a coat stand with coats."""
    pot, leaf = materials.add(surface(generator)), materials.add(cloth(generator))
    high = generator.uniform(0.5, 1.7)
    parts = [tube([0, 0, 0], [0, 0.3, 0], 0.15, pot), tube([0, 0.2, 0], [0, high, 0], 0.02, pot)]
    for _ in range(generator.integers(3, 12)):
        place = [*generator.normal(0, 0.15, 1), generator.uniform(0.5, 1) * high,
                 *generator.normal(0, 0.15, 1)]  # fmt: skip
        radii = generator.uniform(0.04, [0.22, 0.3, 0.22])
        parts.append(ellipsoid(place, radii, leaf, 7))
    return joined(parts)


def heap(materials: Materials, generator: Generator) -> Mesh:
    """Lumps of cloth and boxes in a heap."""
    parts = []
    for _ in range(generator.integers(2, 7)):
        place = generator.uniform([-0.4, 0.05, -0.4], [0.4, 0.5, 0.4])
        radii = generator.uniform(0.06, 0.35, 3)
        material = materials.add(cloth(generator))
        if generator.random() < 0.5:
            parts.append(ellipsoid(place, radii, material, 9))
        else:
            parts.append(box(place - radii * 0.5, place + radii * 0.5, material))
    return joined(parts)


def bust(materials: Materials, generator: Generator) -> Mesh:
    """Vases, lamps, coats on hangers, chairs with clothes: upright round bodies."""
    parts, height = [], 0.0
    base = generator.uniform(0.4, 1.0)
    parts.append(tube([0, 0, 0], [0, base, 0], 0.03, materials.add(surface(generator))))
    height = base
    for _ in range(generator.integers(1, 4)):
        radii = generator.uniform(0.06, 0.28, 3)
        parts.append(ellipsoid([0, height + radii[1], 0], radii, materials.add(cloth(generator))))
        height += 1.6 * radii[1]
    return joined(parts)


Maker = Callable[[Materials, Generator], Mesh]

CLUTTER: tuple[Maker, ...] = (
    cupboard, cupboard, cupboard, empty_table, empty_table, empty_chair, empty_chair, empty_bed,
    bag, plant, walking_frame,
)  # fmt: skip
SUBJECTS: tuple[Maker, ...] = (
    bag, bag, heap, bust, plant, empty_chair, empty_table, empty_bed, cupboard, empty_cycle,
)  # fmt: skip
"""Furniture and things that photographs without people show."""


def wall_colour(generator: Generator) -> NDArray[np.float64]:
    """Mostly pale."""
    if generator.random() < 0.75:
        return np.asarray(generator.uniform(0.25, 0.85) * generator.uniform(0.88, 1.08, 3))
    return any_colour(generator)
