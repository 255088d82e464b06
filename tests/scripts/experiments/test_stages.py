"""What a step adds is measured against an index whose descriptors find random entries."""

import numpy as np
from numpy.testing import assert_array_equal

from app.photograph import Estimator
from index.store import PoseIndex
from scripts.experiments.permutation import permuted
from scripts.experiments.real_poses import in_video
from scripts.experiments.rendered_people import FILE, read_rendered_people
from scripts.experiments.stages import figures_of, ways_of

LEAST_LOSS_MM = 10.0
"""What permuting the index costs the best of seven by silhouettes; half the people: 20 mm."""


def test_in_a_permuted_index_a_descriptor_finds_another_entry(tiny_index: PoseIndex) -> None:
    other = permuted(tiny_index, 0)
    there, moved = tiny_index.vectors[slice(None)], other.vectors[slice(None)]
    assert_array_equal(np.sort(there, axis=0), np.sort(moved, axis=0))
    assert_array_equal(other.entries, tiny_index.entries)
    found = other.neighbours.search(there, 1)[1][:, 0]
    assert (found == np.arange(len(there))).mean() < 0.1


def test_rendered_people_stand_in_their_boxes() -> None:
    frames = read_rendered_people()
    assert len(frames) == 64 and FILE.stat().st_size < 1_200_000
    for one in frames:
        joints = one.reference.joints_2d
        assert (joints >= [one.box.x, one.box.y]).all()
        assert (joints <= [one.box.right, one.box.bottom]).all()
        assert abs(one.reference.joints_3d[[6, 7]].mean(axis=0)).max() < 1e-5


def test_answers_of_rendered_people_rest_on_the_descriptor(shipped: Estimator) -> None:
    people = in_video(read_rendered_people()[::8], shipped)
    ways = ways_of(shipped)
    kept, lost = (
        figures_of([(one, ways[name](one)) for one in people])["best_mm"]
        for name in ("silhouette", "silhouette_permuted")
    )
    assert lost - kept >= LEAST_LOSS_MM
