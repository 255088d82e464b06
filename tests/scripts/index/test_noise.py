"""Degraded silhouettes: still silhouettes, and the joints move with them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from scripts.index.descriptor_learning import view_joints
from scripts.index.noise import degrade, degrade_all
from scripts.index.simulate import Simulation


@pytest.fixture(scope="module")
def silhouettes(simulation: Simulation) -> np.ndarray:
    return simulation.silhouettes(slice(0, 200))


@pytest.fixture(scope="module")
def joints(simulation: Simulation) -> np.ndarray:
    return view_joints(simulation)[1][:200]


def test_stays_normalised(silhouettes: np.ndarray, joints: np.ndarray) -> None:
    degraded, moved = degrade_all(silhouettes, joints, np.random.default_rng(0))
    assert degraded.shape == silhouettes.shape
    assert degraded.dtype == np.uint8
    assert set(np.unique(degraded)) == {0, 1}
    touches = degraded.any(axis=2)[:, [0, -1]].all(axis=1) | degraded.any(axis=1)[:, [0, -1]].all(
        axis=1
    )
    assert touches.all()
    assert np.isfinite(moved).all()


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


def test_joints_move_with_the_silhouette(silhouettes: np.ndarray, joints: np.ndarray) -> None:
    """One scale and one shift: distances between joints keep their proportions."""
    _, moved = degrade_all(silhouettes, joints, np.random.default_rng(3))
    before = np.linalg.norm(joints[:, 1:] - joints[:, :1], axis=-1)
    after = np.linalg.norm(moved[:, 1:] - moved[:, :1], axis=-1)
    ratio = after / np.maximum(before, 1e-9)
    assert_allclose(ratio, np.broadcast_to(np.median(ratio, axis=1)[:, None], ratio.shape), 1e-3)
