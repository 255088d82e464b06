"""How far the entries of an index reach."""

from __future__ import annotations

import numpy as np
import pytest

from index.skeleton import JOINTS, mirror_normalised
from index.store import PoseIndex
from scripts.experiments.coverage import EVERY, nearest_entries_px


@pytest.mark.parametrize("mirrored", [False, True])
def test_an_entry_is_covered_by_the_poses_it_is_of(tiny_index: PoseIndex, mirrored: bool) -> None:
    _, points = tiny_index.points(np.array([0, len(tiny_index) - 1]))
    joints = (mirror_normalised(points) if mirrored else points)[:, :JOINTS]
    first, last = nearest_entries_px(tiny_index, joints).T
    assert first == pytest.approx([0] * len(EVERY), abs=1e-3)  # Pose 0 is in every part.
    assert last[-1] == pytest.approx(0, abs=1e-3)
    assert (last[:-1] > 0.1).all()


def test_an_error_is_the_mean_over_the_joints(tiny_index: PoseIndex) -> None:
    _, points = tiny_index.points(np.array([0]))
    joints = points[:, :JOINTS].copy()
    joints[0, 3] += (3, 4)
    assert nearest_entries_px(tiny_index, joints)[-1] == pytest.approx([5 / JOINTS], abs=1e-3)
