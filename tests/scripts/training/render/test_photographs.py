"""Whole photographs of real motion and bodies: labels that hold, and the same ones by seed."""

import re
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.random import Generator
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from app.vision.judgement import FRAME_POSTURES
from app.vision.people import LANDMARK_NAMES
from index.skeleton import JOINT_NAMES, JOINTS
from scripts.index.body import pose_transforms, posed_points, retarget
from scripts.index.motion import MotionError
from scripts.training.render.makers import lean_on_arm, lunge, plank, squat_wide, stand_on_one_leg
from scripts.training.render.materials import Materials
from scripts.training.render.people import MIRRORED, split_of
from scripts.training.render.pose import Pose
from scripts.training.render.posing import HELD_OUT_SUBJECTS, classes_of
from scripts.training.render.scene import EMPTY, Photograph, Studio
from scripts.training.render.surroundings import PosedBody
from tests.conftest import SHARED

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (SHARED / "mocap").is_dir(), reason=f"needs {SHARED / 'mocap'}"),
]


@pytest.fixture(scope="module")
def studio() -> Studio:
    pytest.importorskip("anny")
    return Studio.open(SHARED / "mocap", SHARED / "garments", 2, 1, held_out=True)


@pytest.fixture(scope="module")
def photographs(studio: Studio) -> list[Photograph]:
    generator = np.random.default_rng(3)
    return [studio.take(generator) for _ in range(12)]


def test_landmarks_are_where_the_camera_projects_them(photographs: list[Photograph]) -> None:
    for photograph in photographs:
        seen = photograph.landmarks
        places = seen[:, :2] / seen[:, 2:] * photograph.focal + photograph.centre
        assert_allclose(places, photograph.places, atol=1e-6)
        height, width = photograph.image.shape[:2]
        inside = ((places > -1) & (places < [width, height])).all(axis=1)
        assert not (photograph.shown & ~inside).any()
        left, top, across, down = photograph.box
        assert left >= -0.51 and top >= -0.51
        assert left + across <= width and top + down <= height


@pytest.fixture(scope="module")
def bodies(studio: Studio) -> list[PosedBody]:
    """Forty tries at each posture, without those that came out as another."""
    generator = np.random.default_rng(2)
    made = [studio.body(name, Materials(), generator) for name in FRAME_POSTURES for _ in range(40)]
    return [body for body in made if body is not None]


def test_postures_that_are_asked_for_can_be_made(bodies: list[PosedBody]) -> None:
    assert {FRAME_POSTURES[body.posture] for body in bodies} == set(FRAME_POSTURES)


def test_the_class_is_that_of_the_joints(bodies: list[PosedBody]) -> None:
    for body in bodies:
        by_joints = FRAME_POSTURES[classes_of(body.joints[None])[0]]
        if FRAME_POSTURES[body.posture] == "sitting":
            # People on a seat sit however far they lean, and on a cycle with straight legs too.
            assert by_joints in ("sitting", "bending", "crouching", "standing")
        else:
            assert by_joints == FRAME_POSTURES[body.posture]


def test_bodies_are_of_human_size(bodies: list[PosedBody]) -> None:
    hip, knee = (JOINT_NAMES.index(name) for name in ("left_hip", "left_knee"))
    for body in bodies:
        assert 0.28 < np.linalg.norm(body.joints[hip] - body.joints[knee]) < 0.6


def test_the_same_seed_takes_the_same_photograph(studio: Studio) -> None:
    one, other = (studio.take(np.random.default_rng([5, 6])) for _ in range(2))
    for part in fields(Photograph):
        assert_array_equal(getattr(one, part.name), getattr(other, part.name))


def test_pictures_of_things_show_nobody(studio: Studio) -> None:
    photograph = studio.take(np.random.default_rng(1), empty=True)
    assert photograph.posture == EMPTY and not photograph.shown.any()
    assert np.isnan(photograph.landmarks).all()


def test_riders_sit_with_their_hands_before_them(studio: Studio) -> None:
    generator = np.random.default_rng(4)
    hands = [LANDMARK_NAMES.index(f"{side}_wrist") for side in ("left", "right")]
    shoulders = [LANDMARK_NAMES.index(f"{side}_shoulder") for side in ("left", "right")]
    reach = []
    while len(reach) < 8:
        body = studio.body("sitting", Materials(), generator)
        if body is not None and body.support == "cycle":
            assert FRAME_POSTURES[body.posture] == "sitting"
            reach.append(body.landmarks[hands, 2].mean() - body.landmarks[shoulders, 2].mean())
    assert np.median(reach) > 0.1


def test_poses_that_no_clip_shows_rest_on_what_their_name_says(studio: Studio) -> None:
    generator, source = np.random.default_rng(8), studio.source
    standing = FRAME_POSTURES.index("standing")
    avatar = studio.people[0].avatar

    def heights(make: Callable[[Pose, Generator], None], names: list[str]) -> NDArray[np.float64]:
        """Of joints over the lowest one, in twenty poses: the lowest, the highest of these."""
        found = []
        for _ in range(20):
            pose = source.recorded(standing, generator)
            make(pose, generator)
            turned = pose_transforms(avatar, retarget(pose.clip, avatar), pose.rotations[None])
            up = posed_points(avatar, turned)[0, :JOINTS, 1]
            rows = [JOINT_NAMES.index(name) for name in names]
            found.append((up[rows] - up.min()).tolist())
        return np.sort(found, axis=1)

    feet, trunk = ["left_ankle", "right_ankle"], ["pelvis", "chest"]
    one, other = np.median(heights(stand_on_one_leg, feet), axis=0)
    assert one < 0.15 and other > 0.2
    assert np.median(heights(lunge, feet)[:, 1]) < 0.25
    assert np.median(heights(lunge, ["pelvis"])) > 0.45
    assert np.median(heights(squat_wide, ["pelvis"])) < 0.75
    assert np.median(heights(plank, feet)[:, 1]) < 0.35
    low, high = heights(plank, trunk).T
    assert low.min() > 0.05 and np.median(low) > 0.15 and high.max() < 0.9
    assert np.median(heights(lean_on_arm, ["pelvis"])) < 0.3


def test_who_fell_lies_on_the_ground(studio: Studio) -> None:
    pytest.importorskip("mujoco")
    studio = replace(studio, source=replace(studio.source, fallen=1.0))
    generator = np.random.default_rng(9)
    made = [studio.body("lying", Materials(), generator) for _ in range(12)]
    bodies = [body for body in made if body is not None]
    assert len(bodies) >= 4
    for body in bodies:
        pelvis = body.joints[JOINT_NAMES.index("pelvis"), 1] - body.joints[:, 1].min()
        assert pelvis < 0.5


def test_held_out_clips_and_garments_are_apart() -> None:
    names = ["female_casualsuit01", "female_elegantsuit01", "male_casualsuit01",
             "male_casualsuit02", "male_worksuit01"]  # fmt: skip
    held, others = split_of(names, True), split_of(names, False)
    assert sorted(held + others) == names and held and others
    assert len(HELD_OUT_SUBJECTS) == 4
    assert_array_equal(MIRRORED[MIRRORED], np.arange(33))


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    pytest.importorskip("anny")
    with pytest.raises(MotionError, match=re.escape(str(tmp_path))):
        Studio.open(tmp_path, SHARED / "garments", 1, 1, held_out=False)
