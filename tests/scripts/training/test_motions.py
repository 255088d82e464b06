"""Daily life as rotations of bones: bodies touch the ground, and do what the kind says."""

import numpy as np
import pytest
from numpy.typing import NDArray

from index.posture import POSTURES, classify_postures
from index.skeleton import BODY_UP, JOINT_NAMES, rows
from scripts.index.body import (
    Avatar,
    Phenotype,
    make_avatar,
    pose_transforms,
    posed_points,
    retarget,
)
from scripts.training.motions import DAILY, Motions
from scripts.training.render.makers import ACTIVITY_POSES
from tests.conftest import SHARED

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (SHARED / "mocap").is_dir(), reason=f"needs {SHARED / 'mocap'}"),
]

_NECK, _PELVIS = JOINT_NAMES.index("neck"), JOINT_NAMES.index("pelvis")
_WRISTS = rows("left_wrist", "right_wrist", among=JOINT_NAMES)
_KNEES = rows("left_knee", "right_knee", among=JOINT_NAMES)
_ANKLES = rows("left_ankle", "right_ankle", among=JOINT_NAMES)


@pytest.fixture(scope="module")
def avatar() -> Avatar:
    pytest.importorskip("anny")
    return make_avatar(Phenotype("daily", 0.5, 0.6, 0.5, 0.5, 0.36, 0.5))[0]


@pytest.fixture(scope="module")
def motions(avatar: Avatar) -> Motions:
    return Motions.open(SHARED / "mocap", avatar, held_out=True)


def activity_joints(motions: Motions, avatar: Avatar, name: str) -> NDArray[np.float64]:
    """Joints ``(20, 24, 3)`` of a pose of daily life, from the lowest joint up."""
    generator = np.random.default_rng(4)
    made = []
    for _ in range(20):
        pose = motions.poses.made(ACTIVITY_POSES[name], generator)
        turned = pose_transforms(avatar, retarget(pose.clip, avatar), pose.rotations[None])
        made.append(posed_points(avatar, turned)[0])
    joints = np.array(made)
    joints[..., 1] -= joints[..., 1].min(axis=1, keepdims=True)
    return joints


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


def test_people_who_wipe_the_floor_stay_and_move_their_hands(
    motions: Motions, avatar: Avatar
) -> None:
    joints = motions.daily(np.random.default_rng(2), "cleans-floor").joints(avatar)[-60:]
    body = joints - joints[:, [_PELVIS]]
    moved = np.ptp(body, axis=0).max(axis=-1)
    assert moved[_WRISTS].max() > 0.2 > 0.1 > moved[_KNEES].max()


def test_activities_rest_on_what_their_name_says(motions: Motions, avatar: Avatar) -> None:
    height = {name: activity_joints(motions, avatar, name)[..., 1] for name in ACTIVITY_POSES}
    assert np.median(height["bow"][:, _PELVIS]) > 0.7
    assert np.median(np.abs(height["bow"][:, _NECK] - height["bow"][:, _PELVIS])) < 0.3
    assert np.median(height["on-heels"][:, _KNEES]) < 0.2
    assert np.median(height["on-heels"][:, _NECK] - height["on-heels"][:, _PELVIS]) > 0.35
    assert np.median(height["prostrate"][:, _NECK]) < 0.3
    assert np.median(height["prostrate"][:, _KNEES]) < 0.3
    assert np.median(height["on-floor"][:, _WRISTS].min(axis=1)) < 0.2
    assert np.median(height["on-floor"][:, _KNEES].min(axis=1)) < 0.2


def test_people_who_prostrate_themselves_kneel(motions: Motions, avatar: Avatar) -> None:
    postures = classify_postures(activity_joints(motions, avatar, "prostrate"), BODY_UP)
    assert np.mean(postures == POSTURES.index("kneeling")) >= 0.75
    assert np.mean(postures == POSTURES.index("lying")) <= 0.2


@pytest.mark.parametrize("name", ["at-shoe", "at-shoe-seated"])
def test_hands_are_near_a_foot_that_is_tied(motions: Motions, avatar: Avatar, name: str) -> None:
    joints = activity_joints(motions, avatar, name)
    hands = joints[:, _WRISTS].mean(axis=1)[:, None]
    assert np.median(np.linalg.norm(joints[:, _ANKLES] - hands, axis=-1).min(axis=1)) < 0.45
