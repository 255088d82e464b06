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

_CUT = 0.6
"""Share of hidden bodies that the frame cuts off; things in front cover the others."""

_MIN_SIDE_PX, _MIN_SHOWN = 12, 5
"""A picture is no smaller, and shows no fewer landmarks of a body."""


def hide(photograph: Photograph, generator: Generator) -> Photograph:
    """Cut a body off, or cover a part of it; the same photograph where too little would be left."""
    x, y = list(_DIRECTIONS)[generator.choice(len(_DIRECTIONS), p=list(_DIRECTIONS.values()))]
    along = photograph.places @ np.array([x, y], float)
    chest = np.concatenate([along[_SHOULDERS], along[_HIPS]]).mean()
    levels = (chest, along[_HIPS].mean(), along[_KNEES].mean(), along[_ANKLES].mean())
    level = levels[generator.choice(4, p=[0.3, 0.34, 0.26, 0.1])]
    level += generator.normal(0, 0.05) * np.ptp(along)
    shown = photograph.shown & (along < level)
    if shown.sum() < _MIN_SHOWN:
        return photograph
    hidden = _cut if generator.random() < _CUT else _covered
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
    inside = cv2.GaussianBlur(inside.astype(np.float32), (0, 0), generator.uniform(0.3, 1.2))
    thing = _thing(image, generator).astype(np.float32)
    mixed = image + inside[..., None] * (thing - image)
    box = photograph.box.copy()
    if direction[0] + direction[1] > 0:
        end = np.minimum(box[:2] + box[2:], np.where(direction, level, np.inf))
        box[2:] = np.maximum(end - box[:2], 1.0)
    else:
        begin = np.maximum(box[:2], np.where(direction, -level, -np.inf))
        box = np.concatenate([begin, np.maximum(box[:2] + box[2:] - begin, 1.0)])
    return replace(
        photograph,
        image=np.clip(mixed, 0, 255).astype(np.uint8),
        box=box,
        shown=shown,
        covered=_covered_share(photograph, shown),
    )


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
