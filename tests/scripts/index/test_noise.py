"""Degraded silhouettes: still silhouettes, and the joints move with them."""

import numpy as np
import pytest

from scripts.index.descriptor_learning import view_joints
from scripts.index.noise import degrade
from scripts.index.simulate import Simulation


@pytest.fixture(scope="module")
def silhouettes(simulation: Simulation) -> np.ndarray:
    return simulation.silhouettes(slice(0, 50))


@pytest.fixture(scope="module")
def joints(simulation: Simulation) -> np.ndarray:
    return view_joints(simulation)[1][:50]


def test_overlaps_with_the_truth_as_real_silhouettes_do(
    silhouettes: np.ndarray, joints: np.ndarray
) -> None:
    """Those of the service overlap street people by 0.86 on average."""
    overlaps = []
    for silhouette, places in zip(silhouettes, joints, strict=True):
        degraded, placement = degrade(silhouette, places, np.random.default_rng(len(overlaps)))
        rows, columns = np.mgrid[:128, :48]
        back = placement.to_normalised(np.stack([columns, rows], axis=-1))
        x, y = np.rint(back).astype(int).transpose(2, 0, 1)
        inside = (x >= 0) & (x < 48) & (y >= 0) & (y < 128)
        aligned = np.zeros_like(silhouette)
        aligned[inside] = degraded[y[inside], x[inside]]
        overlaps.append((aligned & silhouette).sum() / (aligned | silhouette).sum())
    assert 0.75 < np.mean(overlaps) < 0.92
