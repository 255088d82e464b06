"""Noise on the contour: as much as asked for, along the radius, nothing else."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from scripts.experiments.outline_noise import disturb, outline_faults

RADIUS = 20


@pytest.fixture
def disc() -> NDArray[np.uint8]:
    """A filled circle in the middle of the frame."""
    frame = np.zeros((128, 48), np.uint8)
    return np.asarray(cv2.circle(frame, (24, 64), RADIUS, 1, cv2.FILLED), np.uint8)


def test_noise_moves_the_outline_as_far_as_its_deviation_says(disc: NDArray[np.uint8]) -> None:
    # Along a ray, the disturbed outline lies std * N(0, 1) from the true one. Neighbouring
    # points are a pixel apart, so a filled polygon shows nearly all of it.
    rays = np.deg2rad(np.arange(0, 360, 5))
    steps = np.arange(0, 24, 0.1)
    rows = np.rint(64 + np.outer(np.sin(rays), steps)).astype(int)
    columns = np.clip(np.rint(24 + np.outer(np.cos(rays), steps)).astype(int), 0, 47)
    lengths = []
    for seed in range(30):
        noisy = disturb(disc, 1.0, np.random.default_rng(seed))
        lengths.append(noisy[rows, columns].sum(axis=1) * 0.1)
    assert np.std(lengths) == pytest.approx(1.0, abs=0.35)
    assert np.mean(lengths) == pytest.approx(RADIUS, abs=0.7)


def test_learned_noise_leaves_joints_where_they_are(disc: NDArray[np.uint8]) -> None:
    joints = np.ones((8, 19, 2))
    noisy, same = outline_faults(np.stack([disc] * 8), joints, np.random.default_rng(3))
    assert noisy.shape == (8, 128, 48)
    assert_array_equal(same, joints)
    # From none to much.
    changed = (noisy != disc).sum(axis=(1, 2))
    assert changed.min() < 0.5 * changed.max()
