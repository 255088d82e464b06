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

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from descriptor.descriptor import DiscriminantDescriptor, moment_block
from index.build.noise import degrade_all
from index.build.simulate import BLOCK, Simulation
from index.skeleton import JOINTS, camera_rotation, project

DIMENSION = 48
VERTICAL_ORDERS = 28
HORIZONTAL_ORDERS = 14
P1 = 0.5
P2 = (0.5,)
REGULARISATION = 1e-2
"""Share of the mean within-scatter added to every direction."""

ANCHORS = 20_000
"""Silhouettes whose nearest skeletons are looked up."""

NEAREST = 5
"""Nearest skeletons of each."""

NOISE_WEIGHT = 0.5
"""What the faults of real silhouettes count beside the differences of body, clothes and pose."""

SCALE_PX = 5.0
SCALE_M = 0.11
"""Joint differences, in the normalised frame and in space, that count alike."""


def view_joints(simulation: Simulation) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Joints of every entry: ``(E, 19, 3)`` in camera axes and ``(E, 19, 2)`` normalised."""
    entries = simulation.entries
    rotations = camera_rotation(
        entries["azimuth_deg"], entries["elevation_deg"], entries["roll_deg"]
    ).astype(np.float32)
    body = simulation.skeletons[entries["skeleton"], :JOINTS].astype(np.float32)
    joints_3d = np.einsum("bij,bpj->bpi", rotations, body)
    offsets = np.stack([entries["offset_x"], entries["offset_y"]], axis=-1)
    plane = project(joints_3d, entries["distance"])
    joints_2d = plane * entries["scale"][:, None, None] + offsets[:, None]
    return joints_3d, joints_2d.astype(np.float32)


def learn_descriptor(simulation: Simulation, seed: int) -> DiscriminantDescriptor:
    """The projection that best tells the poses of a simulation apart.

    Parameters
    ----------
    simulation : Simulation
    seed : int
        Chooses the silhouettes whose neighbours are compared.

    Returns
    -------
    DiscriminantDescriptor
    """
    import faiss

    moments = np.concatenate(
        [
            moment_block(
                simulation.silhouettes(slice(start, start + BLOCK)),
                VERTICAL_ORDERS, HORIZONTAL_ORDERS, P1, P2,
            )
            for start in range(0, len(simulation), BLOCK)
        ]
    )  # fmt: skip
    joints_3d, joints_2d = view_joints(simulation)
    poses = np.concatenate(
        [
            joints_2d.reshape(len(moments), -1) / SCALE_PX,
            joints_3d.reshape(len(moments), -1) / SCALE_M,
        ],
        axis=1,
    )
    anchors = np.random.default_rng(seed).permutation(len(moments))[:ANCHORS]
    flat = faiss.IndexFlatL2(poses.shape[1])
    flat.add(poses)
    squares, neighbours = flat.search(poses[anchors], min(NEAREST + 1, len(poses)))
    differences = (moments[anchors][:, None] - moments[neighbours[:, 1:]]).reshape(
        -1, moments.shape[1]
    )
    # Nearer skeletons say more about what to ignore.
    closeness = 1.0 / (squares[:, 1:].ravel() / (2 * JOINTS) + 0.05)
    within = (differences * closeness[:, None]).T.astype(np.float64) @ differences / closeness.sum()
    # The mean of silhouettes and mirror images has no odd moment.
    mean = moments.mean(axis=0) * (np.arange(moments.shape[1]) % HORIZONTAL_ORDERS % 2 == 0)
    centred = moments - mean
    total = centred.T.astype(np.float64) @ centred / len(centred)
    within += _noise_scatter(simulation, anchors, moments, joints_2d, seed)
    within += REGULARISATION * np.trace(within) / len(within) * np.eye(len(within))
    return DiscriminantDescriptor(
        _directions(total, within), VERTICAL_ORDERS, HORIZONTAL_ORDERS, P1, P2
    )


def _noise_scatter(
    simulation: Simulation,
    anchors: NDArray[np.int64],
    moments: NDArray[np.float32],
    joints_2d: NDArray[np.float32],
    seed: int,
) -> NDArray[np.float64]:
    """What cutting silhouettes out of photographs does to the moments ``(F, F)``."""
    some = np.sort(anchors[: ANCHORS // 4])
    rough, _ = degrade_all(
        simulation.silhouettes(some), joints_2d[some], np.random.default_rng(seed)
    )
    noise = moment_block(rough, VERTICAL_ORDERS, HORIZONTAL_ORDERS, P1, P2) - moments[some]
    return NOISE_WEIGHT * (noise.T.astype(np.float64) @ noise) / len(noise)


def _directions(total: NDArray[np.float64], within: NDArray[np.float64]) -> NDArray[np.float32]:
    """The most discriminating directions ``(DIMENSION, F)``, each even or odd.

    Mirrored silhouettes are as likely as the simulated ones. Mirroring changes the sign of the
    moments of odd horizontal order, so no scatter remains between those and the even ones.
    """
    odd = np.arange(len(total)) % HORIZONTAL_ORDERS % 2 == 1
    values, rows = [], []
    for part in (np.flatnonzero(~odd), np.flatnonzero(odd)):
        block = np.ix_(part, part)
        eigenvalues, eigenvectors = eigh(total[block], within[block])
        spread = np.zeros((len(part), len(total)))
        spread[:, part] = eigenvectors.T
        values.append(eigenvalues)
        rows.append(spread)
    strongest = np.argsort(-np.concatenate(values), kind="stable")[:DIMENSION]
    directions = np.concatenate(rows)[strongest]
    # The sign of an eigenvector is arbitrary: fixed, so that the same inputs give the same bytes.
    signs = np.sign(directions[np.arange(DIMENSION), np.abs(directions).argmax(axis=1)])
    return np.asarray(directions * signs[:, None], np.float32)
