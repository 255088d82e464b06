"""Daily life as rotations of bones: bodies touch the ground, and do what the kind says."""

import numpy as np
import pytest

from index.skeleton import JOINT_NAMES
from scripts.index.body import Avatar, Phenotype, make_avatar
from scripts.training.motions import DAILY, Motions
from tests.conftest import SHARED

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (SHARED / "mocap").is_dir(), reason=f"needs {SHARED / 'mocap'}"),
]

_NECK = JOINT_NAMES.index("neck")


@pytest.fixture(scope="module")
def avatar() -> Avatar:
    pytest.importorskip("anny")
    return make_avatar(Phenotype("daily", 0.5, 0.6, 0.5, 0.5, 0.36, 0.5))[0]


@pytest.fixture(scope="module")
def motions(avatar: Avatar) -> Motions:
    return Motions.open(SHARED / "mocap", avatar, held_out=True)


@pytest.mark.parametrize("kind", [kind for kind, (support, _) in DAILY.items() if support is None])
def test_people_on_no_furniture_touch_the_ground_all_the_time(
    motions: Motions, avatar: Avatar, kind: str
) -> None:
    joints = motions.daily(np.random.default_rng(1), kind).joints(avatar)
    np.testing.assert_allclose(joints[..., 1].min(axis=1), 0.06, atol=1e-6)


def test_people_who_pray_bow_to_the_ground_more_than_once(motions: Motions, avatar: Avatar) -> None:
    for seed in range(4):
        neck = motions.daily(np.random.default_rng(seed), "prays").joints(avatar)[:, _NECK, 1]
        assert neck[0] > 1.0
        low = neck < 0.45
        assert np.count_nonzero(np.diff(low.astype(int)) == 1) >= 2
