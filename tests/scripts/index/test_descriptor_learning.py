"""The learned descriptor: reproducible, and better at telling poses apart than the paper's."""

import numpy as np
from numpy.testing import assert_array_equal

from descriptor.descriptor import DiagonalDescriptor
from index.skeleton import JOINTS
from scripts.index.body import Avatar
from scripts.index.descriptor_learning import Recipe, learn_descriptor, view_joints
from scripts.index.poses import Poses
from scripts.index.simulate import simulate


def test_poses_of_other_frames_are_found_better_than_by_the_papers_descriptor(
    poses: Poses, avatars: list[Avatar]
) -> None:
    """Learned on one half of the frames, asked with the other half on other views."""
    even, odd = poses.take(np.arange(0, 48, 2)), poses.take(np.arange(1, 48, 2))
    known = simulate(even, avatars, bodies=1, views=10, seed=1)
    asked = simulate(odd, avatars, bodies=1, views=4, seed=2)
    learned, again = (learn_descriptor(known, 0, Recipe(14, 8)) for _ in range(2))
    assert_array_equal(learned.projection, again.projection)

    def error_m(describe: DiagonalDescriptor | object) -> float:
        index, queries = known.describe(describe), asked.describe(describe)  # type: ignore[arg-type]
        apart = ((queries[:, None] - index[None]) ** 2).sum(axis=-1)
        best = apart.argmin(axis=1)
        there, here = view_joints(known)[0][best], view_joints(asked)[0]
        assert there.shape[1] == JOINTS
        return float(np.linalg.norm(there - here, axis=-1).mean())

    assert error_m(learned) < error_m(DiagonalDescriptor())
