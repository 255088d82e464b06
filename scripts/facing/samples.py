"""Training samples: simulated people as the facing reader's two windows show them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.vision.facing_evidence import SIZE, head_window, person_window
from app.vision.people import Silhouette, silhouette_from_mask
from app.vision.resampling import cut, resize
from index.skeleton import POINT_NAMES
from scripts.refinement.samples import spoil
from scripts.refinement.scenes import counted
from scripts.refinement.sprites import Casting, Sprite

ROWS = 160
"""Height at which people are drawn, in pixels; the windows show them smaller."""

SPOILT_SHARE, SEVERITY = 0.6, 0.6
"""How many silhouettes have faults, and how severe they are at most."""

HIDDEN_SHARE = 0.3
"""How many of those are kept whose face or back of the head is not where it is looked for, for
they are bent or raise an arm above it."""

PLANES = 5
"""Of each window: blue, green, red, share covered, silhouette."""

_HEADS = [POINT_NAMES.index(name) for name in ("head", "nose")]


@dataclass(frozen=True)
class Samples:
    """What is learnt from.

    Parameters
    ----------
    views : (N, 2, 5, 64, 64) uint8 array
        Head and shoulders, and all of the person.
    azimuth_deg : (N,) float32 array
    """

    views: NDArray[np.uint8]
    azimuth_deg: NDArray[np.float32]


def views_of(
    sprite: Sprite, generator: np.random.Generator
) -> tuple[NDArray[np.uint8], bool] | None:
    """Both views ``(2, 5, 64, 64)`` of a person, and whether the first shows the head."""
    silhouette = silhouette_from_mask(sprite.cover >= 0.5, segmenter="mask", truncated=False)
    if silhouette is None or min(silhouette.crop.shape) < 8:
        return None
    if generator.random() < SPOILT_SHARE:
        silhouette = _spoilt(silhouette, generator)
    views = np.empty((2, PLANES, SIZE, SIZE), np.uint8)
    cover = np.rint(255 * sprite.cover).astype(np.uint8)
    mask = silhouette.crop.astype(np.uint8) * np.uint8(255)
    windows = (head_window(silhouette), person_window(silhouette))
    for view, window in zip(views, windows, strict=True):
        left, top, width, height = window
        view[:3] = resize(cut(sprite.colour, window), SIZE, SIZE).transpose(2, 0, 1)
        view[3] = resize(cut(cover, window), SIZE, SIZE)
        within = (left - silhouette.left, top - silhouette.top, width, height)
        view[4] = resize(cut(mask, within), SIZE, SIZE)
    left, top, side, _ = windows[0]
    heads = (sprite.points[_HEADS] - (left, top)) / side
    return views, bool(((heads > (0.3, 0.05)) & (heads < (0.7, 0.5))).all())


def _spoilt(silhouette: Silhouette, generator: np.random.Generator) -> Silhouette:
    """Give a silhouette some of the faults that a segmenter leaves."""
    true = silhouette.crop.astype(np.uint8) * np.uint8(255)
    mask = spoil(true, generator, generator.uniform(0, SEVERITY)) >= 128
    place = {"left": silhouette.left, "top": silhouette.top}
    return silhouette_from_mask(mask, **place, segmenter="mask", truncated=False) or silhouette


def make_samples(casting: Casting, count: int, generator: np.random.Generator) -> Samples:
    """Draw ``count`` people, each once: of fewer, a network remembers every one."""
    views = np.empty((count, 2, PLANES, SIZE, SIZE), np.uint8)
    azimuth = np.empty(count, np.float32)
    for row, (view, azimuth_deg) in enumerate(counted(_people(casting, generator), count)):
        views[row], azimuth[row] = view, azimuth_deg
    return Samples(views, azimuth)


def _people(
    casting: Casting, generator: np.random.Generator
) -> Iterator[tuple[NDArray[np.uint8], float]]:
    """Yield views and azimuth of people without end."""
    while True:
        sprite = casting.sprite(generator)
        found = views_of(sprite, generator)
        if found is not None and (found[1] or generator.random() < HIDDEN_SHARE):
            yield found[0], sprite.azimuth_deg
