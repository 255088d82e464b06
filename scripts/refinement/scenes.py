"""Scenes: simulated people before photographs, as a camera would have taken them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.vision.people import Box
from app.vision.resampling import resize
from index.skeleton import exchange_sides
from scripts.experiments.real_data import tight_box
from scripts.refinement.sprites import Casting, Sprite

T = TypeVar("T")

HEIGHTS_PX = (60.0, 360.0)
"""From the smallest person that the service looks for to one who fills the network's window."""

NEIGHBOUR_SHARES = (0.33, 0.35, 0.22, 0.1)
"""How many scenes have no neighbour, one, two, and three."""

FAR_SHARE = 0.25
"""How many neighbours are farther away, and look smaller."""

LEAST_VISIBLE = 0.4
"""A person who is covered more than this is no example."""

JITTER_SHARE = 0.03
"""Standard deviation of the edges of a person's box, in its sizes."""

CAST, SCENES = 1500, 1100
"""People who are drawn at a time, and the scenes that they appear in, about once each: of people
who are shown oftener, a network remembers every one."""

ROOM = 0.5
"""Room about the person, in heights of the larger side."""


@dataclass(frozen=True)
class Scene:
    """A picture with people in it.

    Parameters
    ----------
    frame : (H, W, 3) uint8 array
        BGR.
    covers : (N, H, W) float32 array
        Share of each pixel that shows a person, one layer for each, without what hands carry.
    boxes : list of Box
        About what is seen of them, a little off.
    points : (N, 24, 2) float64 array
        Where the points of their skeletons are, in pixels; rows are ``POINT_NAMES``.
    azimuth_deg : (N,) float64 array
        From where the camera sees each.
    """

    frame: NDArray[np.uint8]
    covers: NDArray[np.float32]
    boxes: list[Box]
    points: NDArray[np.float64]
    azimuth_deg: NDArray[np.float64]


def make_scenes(
    casting: Casting, backgrounds: Sequence[NDArray[np.uint8]], generator: np.random.Generator
) -> Iterator[Scene]:
    """Compose scenes without end, with ever new people."""
    while True:
        sprites = [casting.sprite(generator) for _ in range(CAST)]
        for _ in range(SCENES):
            yield make_scene(sprites, backgrounds, generator)


def counted(samples: Iterable[T], count: int) -> Iterator[T]:
    """Take the first ``count`` samples, with a progress bar."""
    return iter(tqdm(islice(samples, count), "composing", count, unit="sample", mininterval=5))


def make_scene(
    sprites: Sequence[Sprite],
    backgrounds: Sequence[NDArray[np.uint8]],
    generator: np.random.Generator,
) -> Scene:
    """Compose one scene; the same generator gives the same."""
    while True:
        scene = _try_scene(sprites, backgrounds, generator)
        if scene is not None:
            return scene


def _try_scene(
    sprites: Sequence[Sprite],
    backgrounds: Sequence[NDArray[np.uint8]],
    generator: np.random.Generator,
) -> Scene | None:
    height_px = float(np.exp(generator.uniform(*np.log(HEIGHTS_PX))))
    own = _varied(sprites[int(generator.integers(len(sprites)))], height_px, generator)
    rows, columns = own.cover.shape
    room = round(ROOM * max(rows, columns))
    size = (rows + 2 * room, columns + 2 * room)
    layers, is_far = [(own, room, room)], [False]
    for _ in range(int(generator.choice(4, p=NEIGHBOUR_SHARES))):
        far = generator.random() < FAR_SHARE
        relative = generator.uniform(0.3, 0.8) if far else generator.uniform(0.8, 1.2)
        other = _varied(
            sprites[int(generator.integers(len(sprites)))], relative * height_px, generator
        )
        side = generator.choice([-1, 1]) * generator.uniform(0.05, 0.55) * height_px
        left = room + columns / 2 + side - other.cover.shape[1] / 2
        # Whoever is far away stands higher in the picture.
        foot = rows - max(0.0, 1 - relative) * generator.uniform(0, 0.8) * rows
        top = room + foot - other.cover.shape[0] + generator.normal(0, 0.06) * height_px
        layers.append((other, round(top), round(left)))
        is_far.append(far)
    order = sorted(generator.permutation(len(layers)), key=lambda index: not is_far[index])
    frame = _background(size, backgrounds, generator).astype(np.float32)
    if generator.random() < 0.5:
        for index in order:
            frame *= _shadow(size, layers[index], generator)[..., None]
    covers = np.zeros((len(layers), *size), np.float32)
    for index in order:
        sprite, top, left = layers[index]
        cover = _pasted(sprite.cover, size, top, left)
        colour = _pasted(sprite.colour.astype(np.float32), size, top, left)
        if index == 0:
            colour = _matched(colour, frame, cover, generator)
        frame = frame * (1 - cover[..., None]) + colour * cover[..., None]
        covers *= 1 - cover
        covers[index] = _pasted(sprite.own, size, top, left)
    frame = _with_bars(frame, covers, generator)
    window = _cropped(covers[0], generator)
    frame, covers = frame[window], covers[:, *window]
    corner = np.array([window[1].start, window[0].start])
    points = np.stack([s.points + np.array([left, top]) - corner for s, top, left in layers])
    whole = np.array([layer[0].own.sum() for layer in layers])
    seen = (covers.sum(axis=(1, 2)) > LEAST_VISIBLE * whole) & (covers.max(axis=(1, 2)) > 0.5)
    if not seen.any():
        return None
    covers = covers[seen]
    boxes = [_jittered(tight_box(one > 0.5), frame.shape, generator) for one in covers]
    azimuths = np.array([layer[0].azimuth_deg for layer in layers])[seen]
    return Scene(_photographed(frame, generator), covers, boxes, points[seen], azimuths)


def _varied(sprite: Sprite, height_px: float, generator: np.random.Generator) -> Sprite:
    """Resize, mirror and recolour a sprite."""
    scale = height_px / max(sprite.cover.shape)
    colour, cover, own = (
        cv2.resize(array, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        for array in (sprite.colour, sprite.cover, sprite.own)
    )
    points, azimuth = (sprite.points + 0.5) * scale - 0.5, sprite.azimuth_deg
    if generator.random() < 0.5:
        colour, cover, own = colour[:, ::-1], cover[:, ::-1], own[:, ::-1]
        points = exchange_sides(points) * (-1, 1) + (cover.shape[1] - 1, 0)
        azimuth = -azimuth
    hsv = cv2.cvtColor(np.ascontiguousarray(colour), cv2.COLOR_BGR2HSV)
    if generator.random() < 0.3:
        hsv[..., 0] = (hsv[..., 0].astype(int) + int(generator.integers(180))) % 180
    saturation = generator.uniform(0.2, 1.1)
    hsv[..., 1] = np.minimum(255, hsv[..., 1] * saturation)
    hsv[..., 2] = np.minimum(255, hsv[..., 2] * generator.uniform(0.55, 1.25))
    return Sprite(
        np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR), np.uint8),
        np.ascontiguousarray(cover, np.float32),
        np.ascontiguousarray(own, np.float32),
        points,
        azimuth,
    )


def _pasted(
    array: NDArray[np.float32], size: tuple[int, int], top: int, left: int
) -> NDArray[np.float32]:
    """Put an array into an empty one of another size; what lies outside is lost."""
    result = np.zeros((*size, *array.shape[2:]), np.float32)
    rows, columns = array.shape[:2]
    y0, x0 = max(0, top), max(0, left)
    y1, x1 = min(size[0], top + rows), min(size[1], left + columns)
    if y1 > y0 and x1 > x0:
        result[y0:y1, x0:x1] = array[y0 - top : y1 - top, x0 - left : x1 - left]
    return result


def patch(
    size: tuple[int, int],
    backgrounds: Sequence[NDArray[np.uint8]],
    generator: np.random.Generator,
) -> NDArray[np.uint8]:
    """Cut a piece out of a photograph, stretched to a size."""
    photograph = backgrounds[int(generator.integers(len(backgrounds)))]
    rows, columns = photograph.shape[:2]
    share = np.exp(generator.uniform(np.log(0.35), 0))
    height = max(24, round(share * min(rows, columns * size[0] / size[1])))
    width = min(columns, max(24, round(height * size[1] / size[0])))
    height = min(height, rows)
    top = int(generator.integers(rows - height + 1))
    left = int(generator.integers(columns - width + 1))
    piece = photograph[top : top + height, left : left + width]
    piece = resize(piece, size[1], size[0])
    return np.asarray(piece[:, ::-1] if generator.random() < 0.5 else piece, np.uint8)


def _background(
    size: tuple[int, int],
    backgrounds: Sequence[NDArray[np.uint8]],
    generator: np.random.Generator,
) -> NDArray[np.uint8]:
    """Piece of a photograph, mostly with a ground and things of other photographs in it."""
    scene = patch(size, backgrounds, generator)
    rows, columns = size
    if generator.random() < 0.5:
        horizon = round(rows * generator.uniform(0.45, 0.9))
        ground = patch((rows - horizon, columns), backgrounds, generator)
        if generator.random() < 0.6:
            asphalt = cv2.cvtColor(ground, cv2.COLOR_BGR2GRAY).astype(np.float32)
            asphalt = (asphalt - asphalt.mean()) * generator.uniform(0.1, 0.5)
            asphalt = np.clip(asphalt + generator.uniform(60, 200), 0, 255)
            ground = np.repeat(asphalt[..., None].astype(np.uint8), 3, axis=2)
        scene[horizon:] = ground
    for _ in range(int(generator.poisson(3))):
        _add_thing(scene, backgrounds, generator)
    if generator.random() < 0.5:
        mean = scene.mean(axis=(0, 1))
        contrast = generator.uniform(0.4, 1.0)
        scene = np.clip(mean + (scene - mean) * contrast, 0, 255).astype(np.uint8)
    if generator.random() < 0.4:
        grey = cv2.cvtColor(scene, cv2.COLOR_BGR2GRAY)[..., None]
        share = generator.uniform(0.4, 1.0)
        scene = (scene * (1 - share) + grey * share).astype(np.uint8)
    if generator.random() < 0.3:
        scene = np.asarray(cv2.GaussianBlur(scene, (0, 0), generator.uniform(0.5, 4)), np.uint8)
    return scene


def _add_thing(
    scene: NDArray[np.uint8],
    backgrounds: Sequence[NDArray[np.uint8]],
    generator: np.random.Generator,
) -> None:
    """Draw a post, a wall, a car's outline or a bush into a scene."""
    rows, columns = scene.shape[:2]
    mask = np.zeros((rows, columns), np.uint8)
    kind = generator.random()
    centre = (generator.uniform(0, columns), generator.uniform(0.2, 1) * rows)
    if kind < 0.4:
        width = generator.uniform(0.01, 0.12) * rows
        length = generator.uniform(0.2, 1.5) * rows
    else:
        width, length = generator.uniform(0.1, 0.6, 2) * rows
    angle = generator.normal(0, 8) if kind < 0.8 else generator.uniform(0, 180)
    if kind < 0.7:
        corners = cv2.boxPoints((centre, (width, length), angle))
        cv2.fillConvexPoly(mask, np.rint(corners).astype(np.int32), 255)
    else:
        places = (round(centre[0]), round(centre[1]))
        axes = (max(1, round(width / 2)), max(1, round(length / 2)))
        cv2.ellipse(mask, places, axes, angle, 0, 360, 255, -1)
    if generator.random() < 0.4:
        colour = generator.uniform(0, 255, 3) * 0.4 + generator.uniform(0, 150)
        fill = np.full_like(scene, np.clip(colour, 0, 255).astype(np.uint8))
    else:
        fill = patch((rows, columns), backgrounds, generator)
    share = cv2.GaussianBlur(mask, (0, 0), generator.uniform(0.4, 2)).astype(np.float32) / 255
    scene[:] = (scene * (1 - share[..., None]) + fill * share[..., None]).astype(np.uint8)


def _matched(
    colour: NDArray[np.float32],
    frame: NDArray[np.float32],
    cover: NDArray[np.float32],
    generator: np.random.Generator,
) -> NDArray[np.float32]:
    """Bring a person's colours nearer to those behind, in some scenes."""
    if generator.random() < 0.6:
        return colour
    on = cover > 0.5
    if not on.any():
        return colour
    shift = (frame[on].mean(axis=0) - colour[on].mean(axis=0)) * generator.uniform(0.3, 0.9)
    return np.asarray(np.clip(colour + shift, 0, 255), np.float32)


def _shadow(
    size: tuple[int, int], layer: tuple[Sprite, int, int], generator: np.random.Generator
) -> NDArray[np.float32]:
    """Factor by which a person's shadow on the ground darkens a scene."""
    sprite, top, left = layer
    rows = len(sprite.cover)
    depth, shear = generator.uniform(0.08, 0.5), generator.normal(0, 0.8)
    feet = top + rows * 0.985
    # A point (x, y) of the person lands at (x + shear * up, feet - depth * up), up = feet - y.
    matrix = np.array([[1, -shear, left + shear * (feet - top)], [0, depth, feet * (1 - depth)]])
    matrix[1, 2] += depth * top
    if generator.random() < 0.5:
        matrix = np.array([[1, 0, left], [0, 0.05, feet - 0.04 * rows]])
    dark = cv2.warpAffine(sprite.cover, matrix, size[::-1], flags=cv2.INTER_LINEAR)
    dark = cv2.GaussianBlur(dark, (0, 0), generator.uniform(0.01, 0.03) * rows + 0.5)
    return np.asarray(1 - generator.uniform(0.2, 0.7) * dark, np.float32)


def _with_bars(
    frame: NDArray[np.float32], covers: NDArray[np.float32], generator: np.random.Generator
) -> NDArray[np.float32]:
    """Let a post or something low stand before the people, in few scenes; covers are cut."""
    if generator.random() > 0.1:
        return frame
    rows, columns = frame.shape[:2]
    colour = generator.uniform(0, 255, 3).astype(np.float32)
    if generator.random() < 0.6:
        x = int(generator.integers(columns))
        width = max(1, round(generator.uniform(0.01, 0.05) * rows))
        area = slice(0, rows), slice(x, x + width)
    else:
        area = slice(round(rows * generator.uniform(0.55, 0.8)), rows), slice(0, columns)
    covers[:, *area] = 0
    noise = generator.normal(0, 8, frame[area].shape)
    frame[area] = np.clip(colour + noise, 0, 255)
    return frame


def _cropped(cover: NDArray[np.float32], generator: np.random.Generator) -> tuple[slice, slice]:
    """Choose what of a scene the frame shows: mostly all, else its edge cuts the person."""
    rows, columns = cover.shape
    if generator.random() > 0.12:
        return slice(0, rows), slice(0, columns)
    on = np.argwhere(cover > 0.5)
    low, high = on.min(axis=0), on.max(axis=0)
    cut = (low + (high - low) * generator.uniform(0.55, 0.95, 2)).astype(int)
    choice = generator.integers(3)
    if choice == 0:
        return slice(0, int(cut[0])), slice(0, columns)
    if choice == 1:
        return slice(0, rows), slice(0, int(cut[1]))
    return slice(0, rows), slice(int(high[1] + low[1] - cut[1]), columns)


def _jittered(box: Box, shape: tuple[int, ...], generator: np.random.Generator) -> Box:
    moved = generator.normal(0, JITTER_SHARE, 4) * (generator.random() < 0.7)
    left, right = box.x + moved[0] * box.width, box.right + moved[1] * box.width
    top, bottom = box.y + moved[2] * box.height, box.bottom + moved[3] * box.height
    inside = Box(left, top, right - left, bottom - top).clip(shape[1], shape[0])
    return box if inside is None else inside


def _photographed(frame: NDArray[np.float32], generator: np.random.Generator) -> NDArray[np.uint8]:
    """What a camera adds: blur, noise, white balance, gamma and the artefacts of JPEG."""
    light: NDArray[np.floating] = frame
    if generator.random() < 0.7:
        light = cv2.GaussianBlur(frame, (0, 0), generator.uniform(0.3, 1.1)).astype(np.float32)
    if generator.random() < 0.08:
        length = int(generator.integers(3, 8))
        light = cv2.blur(light, (length, 1)).astype(np.float32)
    light = light * generator.uniform(0.9, 1.1, 3)
    light = 255 * np.clip(light / 255, 0, 1) ** np.exp(generator.normal(0, 0.2))
    light = light + generator.normal(0, generator.uniform(0, 7), frame.shape)
    if generator.random() < 0.2:
        light = 1.6 * light - 0.6 * cv2.GaussianBlur(light, (0, 0), 1.2)
    pixels = np.clip(light, 0, 255).astype(np.uint8)
    quality = int(generator.integers(35, 97))
    coded = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)
