"""Learning the discriminant descriptor from a simulation.

A linear discriminant analysis [1]_ without classes: two silhouettes belong together where
their skeletons, seen by their cameras, nearly coincide. What still differs between such
silhouettes (body, clothes, small turns) is scatter to ignore; what differs between all
silhouettes is scatter to keep.

References
----------
.. [1] K. Fukunaga, "Introduction to Statistical Pattern Recognition", 2nd ed., chapter 10.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from descriptor.descriptor import DiscriminantDescriptor, moment_block
from index.skeleton import JOINTS, camera_rotation, project
from scripts.index.noise import degrade_all
from scripts.index.simulate import BLOCK, Simulation

Faults = Callable[
    [NDArray[np.uint8], NDArray[np.floating], np.random.Generator],
    tuple[NDArray[np.uint8], NDArray[np.floating]],
]
"""Degrades silhouettes and moves their joints, as :func:`scripts.index.noise.degrade_all` does."""

# Silhouettes whose nearest skeletons are searched, and nearest skeletons of each.
_ANCHORS, _NEAREST = 20_000, 5
# Weight of the faults of real silhouettes against differences of body, clothes and pose.
_NOISE_WEIGHT = 0.25
# Joint differences, in the normalised frame and in space, with equal weight.
_SCALE_PX, _SCALE_M = 5.0, 0.11


@dataclass(frozen=True)
class Recipe:
    """Moments and parameters of a discriminant descriptor."""

    # Moments ``Q[n, m]`` with ``n < vertical_orders`` and ``m < horizontal_orders``.
    vertical_orders: int = 28
    horizontal_orders: int = 14
    p1: float = 0.5  # horizontal centre of the polynomials
    p2: tuple[float, ...] = (0.25, 0.75)  # vertical centres, one block of moments each
    dimension: int = 48  # values of the descriptor
    regularisation: float = 1e-2  # share of the mean within-scatter added to every direction

    def block(self, silhouettes: NDArray[np.generic]) -> NDArray[np.float32]:
        """The moments ``(B, F)`` of silhouettes ``(B, 128, 48)``."""
        return moment_block(
            silhouettes, self.vertical_orders, self.horizontal_orders, self.p1, self.p2
        )


@dataclass(frozen=True)
class Scatter:
    """Scatter matrices of the moments over a simulation."""

    total: NDArray[np.float64]  # (F, F): covariance over all silhouettes and their mirror images
    # (F, F): mean square difference of silhouettes that belong together; not yet regularised.
    within: NDArray[np.float64]
    recipe: Recipe  # describes the moments; its dimension and regularisation are not used


def view_joints(
    simulation: Simulation, rows: slice | NDArray[np.integer] = slice(None)
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Joints of entries: ``(E, 19, 3)`` in camera axes and ``(E, 19, 2)`` normalised."""
    entries = simulation.entries[rows]
    rotations = camera_rotation(
        entries["azimuth_deg"], entries["elevation_deg"], entries["roll_deg"]
    ).astype(np.float32)
    body = simulation.skeletons[entries["skeleton"], :JOINTS].astype(np.float32)
    joints_3d = np.einsum("bij,bpj->bpi", rotations, body)
    offsets = np.stack([entries["offset_x"], entries["offset_y"]], axis=-1)
    plane = project(joints_3d, entries["distance"])
    joints_2d = plane * entries["scale"][:, None, None] + offsets[:, None]
    return joints_3d, joints_2d.astype(np.float32)


def learn_descriptor(
    simulation: Simulation, seed: int, recipe: Recipe = Recipe(), *, faults: Faults = degrade_all
) -> DiscriminantDescriptor:
    """The projection that best tells the poses of a simulation apart.

    The seed chooses the silhouettes whose neighbours are compared. The descriptor learns to ignore
    the faults by which silhouettes are degraded.
    """
    scatter = measure_scatter(simulation, seed, recipe, faults=faults)
    return discriminate(scatter, recipe.dimension, recipe.regularisation)


def measure_scatter(
    simulation: Simulation, seed: int, recipe: Recipe, *, faults: Faults = degrade_all
) -> Scatter:
    """Measure the scatter of the moments of a recipe over a simulation.

    Moments are computed block by block, some of them twice: those of all entries would take
    kilobytes each.
    """
    import faiss

    poses = _pose_vectors(simulation)
    anchors = np.random.default_rng(seed).permutation(len(poses))[:_ANCHORS]
    squares, neighbours = faiss.knn(poses[anchors], poses, min(_NEAREST + 1, len(poses)))
    # Nearer skeletons say more about what to ignore.
    closeness = 1.0 / (squares[:, 1:] / (2 * JOINTS) + 0.05)
    within = _within(simulation, anchors, neighbours[:, 1:], closeness, recipe)
    within += _noise_scatter(simulation, anchors, seed, recipe, faults)
    return Scatter(_total(simulation, recipe), within, recipe)


def _pose_vectors(simulation: Simulation) -> NDArray[np.float32]:
    """Joints of every entry ``(E, 95)``, scaled so that distances in and off the picture add."""
    vectors = np.empty((len(simulation), 5 * JOINTS), np.float32)
    for start in range(0, len(vectors), BLOCK):
        rows = slice(start, start + BLOCK)
        joints_3d, joints_2d = view_joints(simulation, rows)
        vectors[rows, : 2 * JOINTS] = joints_2d.reshape(-1, 2 * JOINTS) / _SCALE_PX
        vectors[rows, 2 * JOINTS :] = joints_3d.reshape(-1, 3 * JOINTS) / _SCALE_M
    return vectors


def _within(
    simulation: Simulation,
    anchors: NDArray[np.int64],
    neighbours: NDArray[np.int64],
    closeness: NDArray[np.float32],
    recipe: Recipe,
) -> NDArray[np.float64]:
    """Mean square difference ``(F, F)`` of anchors ``(A,)`` and neighbours ``(A, N)``, weighted."""
    products: NDArray[np.float64] | float = 0.0
    step = BLOCK // (1 + _NEAREST)
    for start in range(0, len(anchors), step):
        block = slice(start, start + step)
        rows = np.concatenate([anchors[block, None], neighbours[block]], axis=1)
        moments = recipe.block(simulation.silhouettes(rows.ravel())).reshape(*rows.shape, -1)
        differences = (moments[:, :1] - moments[:, 1:]).reshape(-1, moments.shape[-1])
        weighted = differences * closeness[block].reshape(-1, 1)
        products = products + weighted.T.astype(np.float64) @ differences
    return products / closeness.sum(dtype=np.float64)


def _total(simulation: Simulation, recipe: Recipe) -> NDArray[np.float64]:
    """Covariance ``(F, F)`` of the moments of all silhouettes and their mirror images."""
    sums: NDArray[np.float64] | float = 0.0
    products: NDArray[np.float64] | float = 0.0
    for start in range(0, len(simulation), BLOCK):
        silhouettes = simulation.silhouettes(slice(start, start + BLOCK))
        moments = recipe.block(silhouettes).astype(np.float64)
        sums = sums + moments.sum(axis=0)
        products = products + moments.T @ moments
    mean = np.asarray(sums / len(simulation))
    # The mean of silhouettes and mirror images has no odd moment.
    centre = mean * ~_odd(recipe)
    cross = np.outer(mean, centre)
    return products / len(simulation) - cross - cross.T + np.outer(centre, centre)


def discriminate(scatter: Scatter, dimension: int, regularisation: float) -> DiscriminantDescriptor:
    """The descriptor that a scatter of moments gives, as :class:`Recipe` describes it."""
    within, recipe = scatter.within, scatter.recipe
    share = regularisation * np.trace(within) / len(within)
    directions = _directions(scatter.total, within + share * np.eye(len(within)), recipe, dimension)
    return DiscriminantDescriptor(
        directions, recipe.vertical_orders, recipe.horizontal_orders, recipe.p1, recipe.p2
    )


def _odd(recipe: Recipe) -> NDArray[np.bool_]:
    """Mask ``(F,)`` of the moments of odd horizontal order."""
    count = len(recipe.p2) * recipe.vertical_orders * recipe.horizontal_orders
    return np.arange(count) % recipe.horizontal_orders % 2 == 1


def _noise_scatter(
    simulation: Simulation, anchors: NDArray[np.int64], seed: int, recipe: Recipe, faults: Faults
) -> NDArray[np.float64]:
    """Mean square change ``(F, F)`` of the moments by faults."""
    some = np.sort(anchors[: _ANCHORS // 4])
    silhouettes, joints_2d = simulation.silhouettes(some), view_joints(simulation, some)[1]
    rough, _ = faults(silhouettes, joints_2d, np.random.default_rng(seed))
    noise = recipe.block(rough) - recipe.block(silhouettes)
    return _NOISE_WEIGHT * (noise.T.astype(np.float64) @ noise) / len(noise)


def _directions(
    total: NDArray[np.float64], within: NDArray[np.float64], recipe: Recipe, dimension: int
) -> NDArray[np.float32]:
    """The most discriminating directions ``(dimension, F)``, each even or odd.

    Mirrored silhouettes are as likely as the simulated ones. Mirroring changes the sign of the
    moments of odd horizontal order, so no scatter remains between those and the even ones.
    """
    odd = _odd(recipe)
    values, rows = [], []
    for part in (np.flatnonzero(~odd), np.flatnonzero(odd)):
        block = np.ix_(part, part)
        eigenvalues, eigenvectors = eigh(total[block], within[block])
        spread = np.zeros((len(part), len(total)))
        spread[:, part] = eigenvectors.T
        values.append(eigenvalues)
        rows.append(spread)
    strongest = np.argsort(-np.concatenate(values), kind="stable")[:dimension]
    directions = np.concatenate(rows)[strongest]
    # The sign of an eigenvector is arbitrary: fixed, so that the same inputs give the same bytes.
    signs = np.sign(directions[np.arange(len(directions)), np.abs(directions).argmax(axis=1)])
    return np.asarray(directions * signs[:, None], np.float32)
