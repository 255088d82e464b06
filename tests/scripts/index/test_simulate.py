"""The simulation: labelled rightly, and the same bytes on any number of cores."""

import os
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from descriptor.silhouette import is_wide, principal_axis_deg
from index.skeleton import JOINT_NAMES
from scripts.index.body import Avatar
from scripts.index.descriptor_learning import view_joints
from scripts.index.poses import Poses, joints_of, merged
from scripts.index.simulate import Simulation, bounded_map, simulate
from scripts.index.views import ELEVATIONS_DEG, GROUND_ELEVATIONS_DEG


def assert_same(one: Simulation, other: Simulation) -> None:
    for field in ("entries", "skeletons", "skeleton_labels"):
        assert_array_equal(getattr(one, field), getattr(other, field))
    for field in ("data", "ends", "dictionary"):
        assert_array_equal(
            getattr(one.silhouette_store, field), getattr(other.silhouette_store, field)
        )


@pytest.mark.parametrize(("cores", "batch"), [(1, 100), (3, 7), (16, 100)])
def test_same_bytes_on_any_number_of_cores_in_tasks_of_any_size(
    poses: Poses, avatars: list[Avatar], simulation: Simulation, cores: int, batch: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    monkeypatch.setattr("scripts.index.simulate.BATCH", batch)
    again = simulate(poses, avatars, bodies=1, views=12, seed=7)
    assert_same(again, simulation)


def test_same_bytes_on_a_dask_cluster(
    poses: Poses, avatars: list[Avatar], simulation: Simulation
) -> None:
    distributed = pytest.importorskip("distributed", reason="needs the extra cluster")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, dashboard_address=":0"
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        executor = client.get_executor(pure=False)
        again = simulate(poses, avatars, bodies=1, views=12, seed=7, executor=executor)
    assert_same(again, simulation)


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

    def test_have_their_joints_on_the_silhouette(self, ground_simulation: Simulation) -> None:
        _, joints_2d = view_joints(ground_simulation)
        x, y = np.moveaxis(np.rint(joints_2d).astype(int), -1, 0)
        silhouettes = ground_simulation.silhouettes(slice(None))
        inside = silhouettes[np.arange(len(silhouettes))[:, None], y.clip(0, 127), x.clip(0, 47)]
        assert inside[rolled(ground_simulation)].mean() > 0.97
        assert inside.mean() > 0.97


def test_cameras_look_down_on_who_lies(ground_simulation: Simulation, laid: Poses) -> None:
    lies = np.repeat(ground_simulation.skeleton_labels["action"] > 1, 12)
    assert lies.sum() == 12 * len(laid)
    elevations = ground_simulation.entries["elevation_deg"]
    for rows, (low, high) in ((lies, GROUND_ELEVATIONS_DEG), (~lies, ELEVATIONS_DEG)):
        assert ((elevations[rows] >= low) & (elevations[rows] <= high)).all()
        assert elevations[rows].min() < low + 2


def alignment(simulation: Simulation, row: int) -> float:
    """Cosine between the optical axis of an entry and the trunk."""
    joints_3d, _ = view_joints(simulation)
    trunk = joints_3d[row, JOINT_NAMES.index("neck")] - joints_3d[row, 0]
    return float(abs(trunk[2]) / np.linalg.norm(trunk))


def test_only_new_leaves_out_views_across_who_lies(
    poses: Poses, laid: Poses, avatars: list[Avatar]
) -> None:
    some = merged([poses.take(np.arange(4)), laid.take(np.arange(8))])
    every, new = (
        simulate(some, avatars, bodies=1, views=6, seed=2, only_new=only_new)
        for only_new in (False, True)
    )
    assert len(every) == len(new)
    assert_array_equal(every.skeletons, new.skeletons)
    standing = every.entries["skeleton"] < 4
    assert_array_equal(every.entries[standing], new.entries[standing])
    rows = np.flatnonzero(~standing)
    ours, theirs = (np.mean([alignment(s, row) for row in rows]) for s in (new, every))
    assert ours > theirs + 0.1


def test_skeletons_are_the_joints_of_their_pose(
    poses: Poses, avatars: list[Avatar], simulation: Simulation
) -> None:
    subject = simulation.skeleton_labels["subject"]
    for body, avatar in enumerate(avatars):
        mine = np.flatnonzero(subject == body)
        assert_allclose(
            simulation.skeletons[mine, :19], joints_of(poses, avatar)[mine], atol=1e-3
        )  # float16: about 0.5 mm at 1 m


class TestBoundedMap:
    def test_takes_tasks_only_as_results_are_read(self) -> None:
        taken = 0
        released = threading.Semaphore(0)

        def tasks() -> Iterator[tuple[float]]:
            nonlocal taken
            for _ in range(20):
                taken += 1
                yield (10.0,)

        def wait(timeout_s: float) -> None:
            assert released.acquire(timeout=timeout_s)

        # Of two threads, the one with the later task might take what is released.
        with ThreadPoolExecutor(1) as pool:
            results = bounded_map(pool, wait, tasks(), 3)
            for finished in range(20):
                released.release()
                next(results)
                assert taken <= finished + 3
        assert taken == 20

    def test_an_error_cancels_what_is_pending(self) -> None:
        called: list[int] = []

        def function(task: int) -> None:
            called.append(task)
            if task == 0:
                raise OSError("the disk is full")
            time.sleep(0.01)

        with ThreadPoolExecutor(1) as pool, pytest.raises(OSError, match="disk is full"):
            list(bounded_map(pool, function, ((n,) for n in range(100)), 4))
        assert len(called) < 10
