"""What else a photograph may show: the body cut off or covered, bad light, a bad camera."""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from app.vision.people import landmark_rows
from scripts.training.render.scene import Photograph

_SHOULDERS, _HIPS, _KNEES, _ANKLES = (
    landmark_rows(part) for part in ("shoulder", "hip", "knee", "ankle")
)

_DIRECTIONS = {(0, 1): 0.76, (0, -1): 0.08, (1, 0): 0.08, (-1, 0): 0.08}
"""Where the hidden side lies, right and down, and how often: people mostly lose their legs."""

_CUT, _BEFORE = 0.4, 0.35
"""Shares of hidden bodies that the frame cuts off, and that have a thing in front of them, such as
an animal; a wall or a piece of furniture hides one side of the others."""

_TOPS, _LENGTHS = (0.25, 0.65), (0.15, 0.75)
"""Where a thing in front of a body begins, from the top of the body, and how far it reaches down:
shares of the body's height."""

_MIN_SIDE_PX, _MIN_SHOWN = 12, 5
"""A picture is no smaller, and shows no fewer landmarks of a body."""


def hide(photograph: Photograph, generator: Generator) -> Photograph:
    """Cut a body off, or cover a part of it; the same photograph where too little would be left."""
    if generator.random() < _BEFORE:
        return _behind_a_thing(photograph, generator)
    x, y = list(_DIRECTIONS)[generator.choice(len(_DIRECTIONS), p=list(_DIRECTIONS.values()))]
    along = photograph.places @ np.array([x, y], float)
    chest = np.concatenate([along[_SHOULDERS], along[_HIPS]]).mean()
    levels = (chest, along[_HIPS].mean(), along[_KNEES].mean(), along[_ANKLES].mean())
    level = levels[generator.choice(4, p=[0.3, 0.34, 0.26, 0.1])]
    level += generator.normal(0, 0.05) * np.ptp(along)
    shown = photograph.shown & (along < level)
    if shown.sum() < _MIN_SHOWN:
        return photograph
    hidden = _cut if generator.random() < _CUT / (1 - _BEFORE) else _covered
    return hidden(photograph, (x, y), float(level), shown, generator)


def _cut(
    photograph: Photograph,
    direction: tuple[int, int],
    level: float,
    shown: NDArray[np.bool_],
    _generator: Generator,
) -> Photograph:
    """The photograph as its frame shows it if it ends at a level along a direction."""
    x, y = direction
    rows, columns = photograph.image.shape[:2]
    low, high = np.zeros(2), np.array([columns, rows], float)
    if x + y > 0:
        high = np.where([x, y], np.minimum(high, round(level) + 1), high)
    else:
        low = np.where([x, y], np.maximum(low, -round(level)), low)
    if (high - low).min() < _MIN_SIDE_PX:
        return photograph
    left, top, right, bottom = (int(edge) for edge in (*low, *high))
    first = np.maximum(photograph.box[:2], low)
    last = np.minimum(photograph.box[:2] + photograph.box[2:], high - 0.5)
    return replace(
        photograph,
        image=np.ascontiguousarray(photograph.image[top:bottom, left:right]),
        centre=photograph.centre - low,
        box=np.concatenate([first - low, np.maximum(last - first, 1.0)]),
        places=photograph.places - low,
        shown=shown,
        covered=_covered_share(photograph, shown),
    )


def _covered(
    photograph: Photograph,
    direction: tuple[int, int],
    level: float,
    shown: NDArray[np.bool_],
    generator: Generator,
) -> Photograph:
    """The photograph with a thing in front of the body from a level on."""
    image = photograph.image
    rows, columns = image.shape[:2]
    size = float(np.ptp(photograph.places, axis=0).max())
    y, x = np.mgrid[:rows, :columns].astype(np.float32)
    tilt = np.deg2rad(generator.normal(0, 6))
    turn = np.array([[np.cos(tilt), -np.sin(tilt)], [np.sin(tilt), np.cos(tilt)]])
    across = turn @ np.array(direction, float)
    pivot = photograph.box[:2] + photograph.box[2:] / 2
    reach = (x - pivot[0]) * across[0] + (y - pivot[1]) * across[1]
    begins = level - float(np.dot(pivot, direction))
    deep = size * (generator.uniform(0.5, 2.0) if generator.random() < 0.5 else 9.0)
    inside = (reach >= begins) & (reach < begins + deep)
    box = photograph.box.copy()
    if direction[0] + direction[1] > 0:
        end = np.minimum(box[:2] + box[2:], np.where(direction, level, np.inf))
        box[2:] = np.maximum(end - box[:2], 1.0)
    else:
        begin = np.maximum(box[:2], np.where(direction, -level, -np.inf))
        box = np.concatenate([begin, np.maximum(box[:2] + box[2:] - begin, 1.0)])
    return _with_thing(photograph, inside.astype(np.float32), box, shown, generator)


def _behind_a_thing(photograph: Photograph, generator: Generator) -> Photograph:
    """The photograph with a box, an animal, a wide skirt or a thing in hand before the body."""
    image, box = photograph.image, photograph.box.copy()
    inside, top = _outline(photograph, generator)
    rows, columns = image.shape[:2]
    x, y = np.clip(photograph.places, 0, [columns - 1, rows - 1]).astype(int).T
    shown = photograph.shown & (inside[y, x] == 0)
    if not _MIN_SHOWN <= shown.sum() < photograph.shown.sum():
        return photograph
    if not shown[_KNEES + _ANKLES].any():
        box[3] = max(top, float(photograph.places[shown, 1].max())) - box[1]
    return _with_thing(photograph, inside, box, shown, generator)


def _with_thing(
    photograph: Photograph,
    inside: NDArray[np.float32],
    box: NDArray[np.float64],
    shown: NDArray[np.bool_],
    generator: Generator,
) -> Photograph:
    """The photograph with a thing where ``inside`` ``(H, W)`` is 1; what it leaves to see."""
    image = photograph.image
    soft = cv2.GaussianBlur(inside, (0, 0), generator.uniform(0.3, 1.2))
    mixed = image + soft[..., None] * (_thing(image, generator).astype(np.float32) - image)
    return replace(
        photograph,
        image=np.clip(mixed, 0, 255).astype(np.uint8),
        box=box,
        shown=shown,
        covered=_covered_share(photograph, shown),
    )


def _outline(photograph: Photograph, generator: Generator) -> tuple[NDArray[np.float32], float]:
    """Where a thing is before a body, 0 or 1, ``(H, W)``, and where the body ends above it."""
    inside, box = np.zeros(photograph.image.shape[:2], np.float32), photograph.box
    begin, share = generator.uniform(*_TOPS), generator.uniform(*_LENGTHS)
    top, long = float(box[1] + begin * box[3]), float(share * box[3])
    hips, ankles = (photograph.places[rows].mean(axis=0) for rows in (_HIPS, _ANKLES))
    x, y = hips[0] + generator.normal(0, 0.12) * box[3], top + long / 2
    wide, turned = long * float(np.exp(generator.uniform(-1.2, 0.8))), float(generator.normal(0, 8))
    way = generator.choice(["box", "animal", "skirt", "in hand"])
    if way == "box":
        corners = cv2.boxPoints(((x, y), (1.6 * wide, long), turned))
        cv2.fillPoly(inside, [corners.round().astype(np.int32)], 1)
    elif way == "in hand":
        turned = float(generator.uniform(0, 180))
        cv2.ellipse(inside, ((x, y), (0.6 * wide, 1.3 * long), turned), 1, cv2.FILLED)
    elif way == "animal":
        head = x + generator.choice([-0.6, 0.6]) * wide, y - 0.4 * long
        cv2.ellipse(inside, ((x, y), (2 * wide, 0.7 * long), turned), 1, cv2.FILLED)
        cv2.ellipse(inside, (head, (0.6 * long, 0.45 * long), turned), 1, cv2.FILLED)
        for leg in x + wide * np.array([-0.8, -0.5, 0.5, 0.8]):
            end = round(leg + generator.normal(0, 0.08) * long), round(top + long)
            cv2.line(inside, (round(leg), round(y)), end, 1, max(1, round(0.14 * long)))
    else:
        down = ankles - hips
        across = np.array([-down[1], down[0]])
        waist, middle, hem = generator.uniform([0.15, 0.2, 0.3], [0.3, 0.7, 1.0])
        ends = (-0.15, waist), (0.35, middle), (generator.uniform(0.6, 1.15), hem)
        sides = [[hips + at * down + side * out * across for at, out in ends] for side in (-1, 1)]
        skirt = np.array(sides[0] + sides[1][::-1])
        cv2.fillPoly(inside, [skirt.round().astype(np.int32)], 1)
        top = float(box[1] + box[3])  # It counts as a part of the body.
    return inside, top


def _covered_share(photograph: Photograph, shown: NDArray[np.bool_]) -> float:
    """Share of the body that is hidden, with landmarks that are not shown any more."""
    left = shown.sum() / max(int(photograph.shown.sum()), 1)
    return float(1 - (1 - photograph.covered) * left)


def _thing(image: NDArray[np.uint8], generator: Generator) -> NDArray[np.uint8]:
    """A surface of the size of an image: other parts of it, or plain, patterned, unevenly lit."""
    rows, columns = image.shape[:2]
    if generator.random() < 0.35:
        turned = image[::-1] if generator.random() < 0.5 else image[:, ::-1]
        return np.roll(turned, int(generator.integers(columns)), axis=1)
    colour = generator.uniform(15, 235) + generator.normal(0, 25, 3)
    size = tuple(int(n) for n in generator.integers(2, 24, 2))
    coarse = generator.normal(0, generator.choice([3.0, 12.0, 30.0]), size).astype(np.float32)
    grain = cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_CUBIC)
    above, below = generator.uniform(-25, 25, 2).tolist()
    light = np.linspace(above, below, rows)[:, None]
    surface = colour + (grain + light)[..., None] + generator.normal(0, 2, (rows, columns, 1))
    return np.clip(surface, 0, 255).astype(np.uint8)


def spoil(image: NDArray[np.uint8], generator: Generator) -> NDArray[np.uint8]:
    """A picture ``(H, W, 3)`` as an infrared, dark, overexposed or shaken camera takes it."""
    kinds: tuple[Callable[[NDArray[np.float32], Generator], NDArray[np.float32]], ...]
    kinds = (_infrared, _dark, _overexposed, _shaken)
    picture = kinds[generator.integers(len(kinds))](image.astype(np.float32), generator)
    spoilt = np.clip(picture, 0, 255).astype(np.uint8)
    quality = [cv2.IMWRITE_JPEG_QUALITY, int(generator.integers(15, 80))]
    encoded = cv2.imencode(".jpg", spoilt, quality)[1]
    return np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR), np.uint8)


def _noise(picture: NDArray[np.float32], sigma: float, generator: Generator) -> NDArray[np.float32]:
    return np.float32(sigma) * generator.standard_normal(picture.shape, np.float32)


def _infrared(picture: NDArray[np.float32], generator: Generator) -> NDArray[np.float32]:
    """Grey, brightest about the lamp."""
    rows, columns = picture.shape[:2]
    y, x = np.mgrid[:rows, :columns].astype(np.float32)
    lamp = generator.uniform(0.2, 0.8, 2) * [columns, rows]
    away = np.hypot(x - lamp[0], y - lamp[1]) / max(rows, columns)
    grey = picture.mean(axis=2) ** 0.8 * 255**0.2 * np.exp(-generator.uniform(0.3, 1.5) * away**2)
    return np.asarray(grey[..., None] + _noise(picture, generator.uniform(2, 12), generator))


def _dark(picture: NDArray[np.float32], generator: Generator) -> NDArray[np.float32]:
    level = generator.uniform(0.06, 0.35)
    return np.asarray(picture * level + _noise(picture, generator.uniform(1, 6), generator))


def _overexposed(picture: NDArray[np.float32], generator: Generator) -> NDArray[np.float32]:
    return picture * generator.uniform(1.3, 2.3) + generator.uniform(0, 50)


def _shaken(picture: NDArray[np.float32], generator: Generator) -> NDArray[np.float32]:
    """Blurred along a line."""
    length = max(3, round(generator.uniform(0.015, 0.06) * max(picture.shape)))
    kernel = np.zeros((length, length), np.float32)
    angle, middle = generator.uniform(0, np.pi), (length - 1) / 2
    for step in np.linspace(-middle, middle, 2 * length):
        at = np.round(middle + step * np.array([np.sin(angle), np.cos(angle)])).astype(int)
        kernel[at[0], at[1]] = 1
    return np.asarray(cv2.filter2D(picture, -1, kernel / kernel.sum()), np.float32)
