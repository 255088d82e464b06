"""What is painted on simulated people lies in front, or behind, and as far to either side."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from scripts.refinement.features import paint_bare_trunk, paint_face, pixelate, scalp_of

EYES = np.array([0.0, 1.6, 0.1], np.float32)
FLESH = np.array([120.0, 150.0, 200.0], np.float32)
HAIR = np.array([30.0, 30.0, 30.0])


def head() -> NDArray[np.float32]:
    """Points of a ball about the head, each with its mirror image next to it."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(20000, 3))
    points *= (0.09, 0.12, 0.1) / np.linalg.norm(points, axis=1, keepdims=True)
    points += (0.0, 1.58, 0.0)
    both = np.repeat(points, 2, axis=0)
    both[1::2, 0] *= -1
    return both.astype(np.float32)


@pytest.mark.parametrize("seed", range(8))
def test_a_face_is_alike_on_both_sides_and_nowhere_else(seed: int) -> None:
    points = head()
    colour = np.tile(FLESH, (len(points), 1))
    paint_face(colour, points, EYES, HAIR, True, np.random.default_rng(seed))
    changed = (colour != FLESH).any(axis=1)
    assert 0.01 < changed.mean() < 0.5
    assert (changed[::2] == changed[1::2]).all()
    assert points[changed, 2].min() > -0.01
    assert (changed & (np.abs(points[:, 1] - EYES[1]) < 0.01)).any()


def test_scalps_reach_lower_behind_than_in_front() -> None:
    points = head()
    rng = np.random.default_rng(1)
    behind = points[:, 2] < -0.05
    for _ in range(5):
        hair = scalp_of(points, EYES, 0.8, rng)
        assert points[hair & behind, 1].min() < points[hair & (points[:, 2] > 0.05), 1].min() - 0.03
        assert hair[points[:, 1] > 1.69].all()


@pytest.mark.parametrize("seed", range(4))
def test_a_bare_trunk_has_its_navel_in_front_and_its_spine_behind(seed: int) -> None:
    rng = np.random.default_rng(2)
    rest = rng.uniform((-0.2, 0, -0.1), (0.2, 1.7, 0.16), (60000, 3)).astype(np.float32)
    up = rest[:, 1] / np.float32(1.7)
    colour = np.tile(FLESH, (len(rest), 1))
    paint_bare_trunk(colour, rest, up, HAIR, False, np.random.default_rng(seed))
    changed = (colour != FLESH).any(axis=1)
    assert np.abs(rest[changed & (rest[:, 2] < 0), 0]).max() < 0.01
    navel = changed & (np.abs(up - 0.605) < 0.004)
    assert (navel & (rest[:, 2] > 0.06)).any()
    assert not (changed & (np.abs(rest[:, 2] - 0.03) < 0.025)).any()


@pytest.mark.parametrize("seed", range(6))
def test_hidden_faces_leave_the_rest_of_the_picture_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    picture = rng.uniform(0, 255, (80, 60, 3)).astype(np.float32)
    face = np.zeros((80, 60), bool)
    face[10:30, 20:38] = True
    hidden = pixelate(picture, face, rng)
    assert (hidden[~face] == picture[~face]).all()
    assert hidden[face].std() < picture[face].std()
    assert hidden[face].mean() == pytest.approx(picture[face].mean(), rel=0.15)
    assert pixelate(picture, np.zeros_like(face), rng) is picture
