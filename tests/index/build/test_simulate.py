"""The simulation: labelled rightly, and the same bytes on any number of cores."""

from __future__ import annotations

import os

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from descriptor.descriptor import DiagonalDescriptor
from index.build import simulate as module
from index.build.body import Avatar
from index.build.learn import view_joints
from index.build.poses import Poses, joints_of
from index.build.simulate import Simulation, simulate
from index.store import PoseIndex


@pytest.mark.parametrize("cores", [1, 3, 16])
def test_same_bytes_on_any_number_of_cores(
    poses: Poses, avatars: list[Avatar], simulation: Simulation, cores: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    again = simulate(poses, avatars, bodies=1, views=12, seed=7)
    for field in ("bits", "entries", "skeletons", "skeleton_labels"):
        assert_array_equal(getattr(again, field), getattr(simulation, field))


def test_another_seed_gives_other_views(poses: Poses, avatars: list[Avatar]) -> None:
    some = poses.take(np.arange(4))
    one, other = (simulate(some, avatars, bodies=1, views=2, seed=seed) for seed in (1, 2))
    assert (one.entries["azimuth_deg"] != other.entries["azimuth_deg"]).all()


def test_counts_and_labels(poses: Poses, avatars: list[Avatar]) -> None:
    some = poses.take(np.array([0, 20, 47]))
    result = simulate(some, avatars, bodies=2, views=5, seed=0)
    assert len(result) == 3 * 2 * 5
    assert_array_equal(result.entries["skeleton"], np.repeat(np.arange(6), 5))
    assert_array_equal(result.skeleton_labels["frame"], np.repeat(some.frame, 2))
    assert_array_equal(result.skeleton_labels["clip"], np.repeat(some.clip, 2))
    assert_array_equal(result.skeleton_labels["action"], np.repeat(some.action, 2))
    # Every pose is worn by both bodies.
    assert_array_equal(np.sort(result.skeleton_labels["subject"].reshape(3, 2)), [[0, 1]] * 3)
    assert result.subjects == ("slim", "broad")


def test_skeletons_are_the_joints_of_their_pose(
    poses: Poses, avatars: list[Avatar], simulation: Simulation
) -> None:
    subject = simulation.skeleton_labels["subject"]
    for body, avatar in enumerate(avatars):
        mine = np.flatnonzero(subject == body)
        assert_allclose(
            simulation.skeletons[mine, :19], joints_of(poses, avatar)[mine], atol=1e-3
        )  # float16: about 0.5 mm at 1 m


def test_never_more_bodies_than_avatars(poses: Poses, avatars: list[Avatar]) -> None:
    assert len(simulate(poses.take(np.arange(2)), avatars, bodies=9, views=1, seed=0)) == 4


def test_describes_block_by_block_as_at_once(
    simulation: Simulation, monkeypatch: pytest.MonkeyPatch
) -> None:
    descriptor = DiagonalDescriptor()
    whole = simulation.describe(descriptor)
    monkeypatch.setattr(module, "BLOCK", 100)
    assert_allclose(simulation.describe(descriptor), whole, atol=1e-4)


def test_view_joints_are_those_of_the_index(simulation: Simulation, toy_index: PoseIndex) -> None:
    joints_3d, joints_2d = view_joints(simulation)
    everything = np.arange(len(toy_index))
    assert_allclose(joints_3d, toy_index.points(everything)[0][:, :19], atol=1e-5)
    assert_allclose(joints_2d, toy_index.points(everything)[1][:, :19], atol=1e-3)
