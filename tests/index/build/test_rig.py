"""Motion of another rig: joints by other names, another unit, and what is missing said plainly."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from numpy.testing import assert_allclose, assert_array_equal

from index.build.body import Avatar, retarget
from index.build.motion import CMU, RIG_FILE, MotionError, Rig, Segment, read_clip, read_rig
from index.build.poses import joints_of, read_poses
from tests.index.toys import walk, write_clip

JOINTS = {"LeftArm": "arm.L", "RightArm": "arm.R", "Spine": "torso", "LowerBack": "torso"}


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    """The clip of CMU's rig."""
    return write_clip(tmp_path / "ours" / "bvh" / "stroll.bvh", walk(20))


@pytest.fixture
def renamed(clip: Path, tmp_path: Path) -> Path:
    """The same with other names, and no joint LowerBack."""
    text = clip.read_text()
    for ours, theirs in JOINTS.items():
        text = text.replace(f"JOINT {ours}\n", f"JOINT {theirs}\n")
    file = tmp_path / "theirs" / "bvh" / "stroll.bvh"
    file.parent.mkdir(parents=True)
    file.write_text(text)
    return file


def describe(file: Path, **values: object) -> Path:
    (file.parents[1] / RIG_FILE).write_text(json.dumps(values))
    return file.parents[1]


SEGMENTS = (Segment("stroll", "s1", "walk", 0, 20),)


def test_a_renamed_rig_gives_the_same_poses(
    clip: Path, renamed: Path, avatars: list[Avatar]
) -> None:
    folder = describe(renamed, joints=JOINTS)
    ours, theirs = (
        joints_of(read_poses(where, SEGMENTS)[0], avatars[0]) for where in (clip.parents[1], folder)
    )
    assert_allclose(theirs, ours, atol=1e-6)


def test_one_joint_of_the_file_may_turn_several_of_ours(renamed: Path) -> None:
    read = read_clip(renamed, Rig(JOINTS))
    spine, back = read.bone("Spine"), read.bone("LowerBack")
    assert_array_equal(read.rotations[:, spine], read.rotations[:, back])
    assert_array_equal(read.offsets[spine], read.offsets[back])


def test_the_unit_scales_paths(tmp_path: Path) -> None:
    file = write_clip(tmp_path / "run.bvh", walk(40), (0.0, 0.0, 2.0))
    metres = read_clip(file, Rig(metres_per_unit=0.01)).speeds
    assert_allclose(metres * CMU.metres_per_unit, read_clip(file).speeds * 0.01)


def test_a_missing_joint_is_named(renamed: Path, avatars: list[Avatar]) -> None:
    with pytest.raises(MotionError, match=r"no joint 'Spine', which the body needs; rig\.json"):
        retarget(read_clip(renamed), avatars[0])


def test_a_missing_trunk_is_named_before_any_body_is_posed(renamed: Path) -> None:
    renamed.write_text(renamed.read_text().replace("JOINT Spine1\n", "JOINT chest\n"))
    with pytest.raises(MotionError, match="the clip stroll has no joint 'Spine1'"):
        read_poses(renamed.parents[1], SEGMENTS)


def test_a_joint_that_the_file_lacks_is_named(renamed: Path) -> None:
    folder = describe(renamed, joints={**JOINTS, "Head": "skull"})
    with pytest.raises(MotionError, match=r"no joint 'skull', which rig\.json names for 'Head'"):
        read_poses(folder, SEGMENTS)


@pytest.mark.parametrize(
    "content",
    ["", "[]", '{"joints": {"Head": 3}}', '{"joints": ["Head"]}', '{"metres_per_unit": 0}',
     '{"metres_per_unit": "1"}', '{"bones": {}}'],
)  # fmt: skip
def test_malformed_rigs_are_refused_in_one_sentence(tmp_path: Path, content: str) -> None:
    (tmp_path / RIG_FILE).write_text(content)
    with pytest.raises(MotionError, match=r"rig\.json does not describe a rig: ") as error:
        read_rig(tmp_path)
    assert "\n" not in str(error.value)


def test_without_a_file_joints_are_called_as_ours(tmp_path: Path) -> None:
    assert read_rig(tmp_path) == CMU
