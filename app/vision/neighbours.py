"""Parting a person from the neighbours that the network melted into the same region."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.people import Box

# Distances are in body heights. Where the region runs on beyond the box by more than the
# margin, a neighbour is there.
_MARGIN = 0.04
# Least share of the region that must lie out there; less is a ragged edge.
_LEAST_SHARE = 0.03
# What a body height off the person's axis costs, in units of colour difference (CIELAB).
_POSITION_COST = 600.0
_STEP_COST = 2.0
# The axis is no wider than this share of the box, however stout the body.
_AXIS_SHARE = 0.35
_UNREACHED = 1e6
_SWEEPS = 60


def own_part(
    image: NDArray[np.uint8],
    region: NDArray[np.bool_],
    box: Box,
    others: Sequence[Box],
) -> NDArray[np.bool_]:
    """Part of a region of people that belongs to the person in ``box``.

    Two geodesic distances compete for every pixel of the region [1]_: from the person's
    axis, and from everything outside the box and the axes of other boxes. Their paths stay
    in the region and pay for colour differences, so the cut runs along edges.

    Parameters
    ----------
    image : (h, w, 3) uint8 array
        BGR crop around the person, at a resolution of about 100 px per body.
    region : (h, w) bool array
        Where the network sees a person, this one or another.
    box : Box
        The person's box in pixels of the crop.
    others : sequence of Box
        Boxes of other people, in pixels of the crop.

    Returns
    -------
    (h, w) bool array
        Subset of ``region``; empty if nothing of it lies on the person's axis.

    References
    ----------
    .. [1] A. Criminisi, T. Sharp, A. Blake, "GeoS: geodesic image segmentation", ECCV 2008.
    """
    across, down = _in_body_heights(region.shape, box)
    aspect = box.width / box.height
    beyond = np.maximum(np.abs(across) - aspect / 2, np.abs(down - 0.5) - 0.5)
    core = region & (np.abs(across) < 0.1) & (down > 0.03) & (down < 0.6)
    person = _touching(region, core)
    outside = person & (beyond > _MARGIN)
    inside = np.count_nonzero(person & ~outside)
    crowded = any(box.intersection(other) > 0.02 * box.area for other in others)
    if not crowded and np.count_nonzero(outside) < _LEAST_SHARE * inside:
        return person
    own = _POSITION_COST * _off_axis(across, down, aspect)
    rival = _POSITION_COST * np.maximum(0, _MARGIN - beyond)
    for other in others:
        other_across, other_down = _in_body_heights(region.shape, other)
        cost = _POSITION_COST * _off_axis(other_across, other_down, other.width / other.height)
        cost *= other.height / box.height
        rival = np.where((other_down >= 0) & (other_down <= 1), np.minimum(rival, cost), rival)
    lab = cv2.cvtColor(cv2.bilateralFilter(image, 5, 30, 3), cv2.COLOR_BGR2LAB).astype(np.float32)
    steps = _step_costs(lab)
    mine = _geodesic(own, region, steps) <= _geodesic(rival, region, steps)
    return _touching(region & mine, core)


def _in_body_heights(
    shape: tuple[int, ...], box: Box
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Position of each pixel in heights of the box: from its vertical axis, from its top."""
    x = (np.arange(shape[1]) - box.x - box.width / 2) / box.height
    y = (np.arange(shape[0]) - box.y) / box.height
    grid = np.meshgrid(x, y)
    return grid[0].astype(np.float32), grid[1].astype(np.float32)


def _off_axis(
    across: NDArray[np.float32], down: NDArray[np.float32], aspect: float
) -> NDArray[np.float32]:
    """How far beyond the trunk, or the cone of the legs, a pixel lies, in body heights."""
    half = np.interp(down, (0.15, 0.22, 0.5, 1.0), (0.06, 0.13, 0.13, 0.25))
    half = np.minimum(half, _AXIS_SHARE * aspect)
    return np.maximum(0, np.abs(across) - half).astype(np.float32)


def _touching(region: NDArray[np.bool_], core: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the connected parts of ``region`` that hold a pixel of ``core``."""
    count, labels = cv2.connectedComponents(region.astype(np.uint8))
    chosen = np.bincount(labels[core & region], minlength=count) > 0
    chosen[0] = False
    return np.asarray(chosen[labels])


_NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))


def _shifted(
    array: NDArray[np.float32], down: int, right: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return views of an array such that equal places are neighbours in direction (down, right)."""
    height, width = array.shape[:2]
    there = array[down:, max(0, right) : width + min(0, right)]
    here = array[: height - down, max(0, -right) : width - max(0, right)]
    return there, here


def _step_costs(lab: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    costs = []
    for down, right in _NEIGHBOURS:
        there, here = _shifted(lab, down, right)
        length = np.hypot(down, right)
        costs.append(
            ((np.linalg.norm(there - here, axis=2) + _STEP_COST) * length).astype(np.float32)
        )
    return costs


def _geodesic(
    start: NDArray[np.float32], region: NDArray[np.bool_], steps: list[NDArray[np.float32]]
) -> NDArray[np.float32]:
    """Cheapest way to each pixel from any start, by sweeps of Bellman and Ford."""
    distance = np.where(region, start, _UNREACHED).astype(np.float32)
    for _ in range(_SWEEPS):
        before = distance.copy()
        for (down, right), step in zip(_NEIGHBOURS, steps, strict=True):
            there, here = _shifted(distance, down, right)
            onward = np.minimum(there, here + step)
            back = np.minimum(here, there + step)
            there[...] = onward
            here[...] = np.minimum(here, back)
        distance[~region] = _UNREACHED
        if np.array_equal(before, distance):
            break
    return distance
