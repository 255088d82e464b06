"""The simulation: labelled rightly, and the same bytes on any number of cores."""

import os

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from descriptor.silhouette import is_wide, principal_axis_deg
from scripts.index.body import Avatar
from scripts.index.poses import Poses, joints_of
from scripts.index.simulate import Simulation, simulate


def assert_same(one: Simulation, other: Simulation) -> None:
    for field in ("entries", "skeletons", "skeleton_labels"):
        assert_array_equal(getattr(one, field), getattr(other, field))
    for field in ("data", "ends", "dictionary"):
        assert_array_equal(
            getattr(one.silhouette_store, field), getattr(other.silhouette_store, field)
        )


@pytest.mark.parametrize(("cores", "batch"), [(1, 100), (3, 7)])
def test_same_bytes_on_any_number_of_cores_in_tasks_of_any_size(
    poses: Poses, avatars: list[Avatar], simulation: Simulation, cores: int, batch: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    monkeypatch.setattr("scripts.index.simulate.BATCH", batch)
    again = simulate(poses, avatars, bodies=1, views=12, seed=7)
    assert_same(again, simulation)


def rolled(simulation: Simulation) -> np.ndarray:
    """Rows of the entries that were rolled to stand; cameras roll by a few degrees themselves."""
    return np.flatnonzero(np.abs(simulation.entries["roll_deg"]) > 15)


class TestWideBodies:
    def test_are_rolled_until_they_stand(self, ground_simulation: Simulation) -> None:
        rows = rolled(ground_simulation)
        assert 0.2 < len(rows) / len(ground_simulation) < 0.8
        silhouettes = ground_simulation.silhouettes(slice(None))
        assert not any(is_wide(silhouette) for silhouette in silhouettes)
        axes = np.abs([principal_axis_deg(silhouette) for silhouette in silhouettes[rows]])
        # They were measured in a smaller picture; what is nearly round has hardly an axis.
        assert np.quantile(axes, 0.95) < 2
        assert axes.max() < 10


def test_skeletons_are_the_joints_of_their_pose(
    poses: Poses, avatars: list[Avatar], simulation: Simulation
) -> None:
    subject = simulation.skeleton_labels["subject"]
    for body, avatar in enumerate(avatars):
        mine = np.flatnonzero(subject == body)
        assert_allclose(
            simulation.skeletons[mine, :19], joints_of(poses, avatar)[mine], atol=1e-3
        )  # float16: about 0.5 mm at 1 m
