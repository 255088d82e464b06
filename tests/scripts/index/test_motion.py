"""Reading motion: every fault named with its file and line; T-poses and jumps left out."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from scripts.index.body import Avatar
from scripts.index.motion import (
    MANIFESTS,
    RIG_FILE,
    MotionError,
    Rig,
    Segment,
    read_clip,
    read_manifest,
    read_rig,
)
from scripts.index.poses import joints_of, read_poses
from tests.scripts.index.toys import Angles, walk, write_clip

HEADER = "clip,subject,action,start_frame,end_frame,fps,description\n"


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    """A sound clip of 20 frames to spoil."""
    return write_clip(tmp_path / "stroll.bvh", walk(20))


class TestSoundClip:
    def test_world_rotations_compose_along_the_chain(self, tmp_path: Path) -> None:
        # 30 degrees about z at the shoulder and 40 at the elbow: 70 at the forearm.
        bent: Angles = {"LeftArm": (30.0, 0.0, 0.0), "LeftForeArm": (40.0, 0.0, 0.0)}
        read = read_clip(write_clip(tmp_path / "bent.bvh", [bent, bent]))
        forearm = read.rotations[0, read.bones.index("LeftForeArm")]
        turn = np.deg2rad(70)
        assert_allclose(forearm @ [1, 0, 0], [np.cos(turn), np.sin(turn), 0], atol=1e-9)


class TestDroppedFrames:
    def test_t_poses(self, tmp_path: Path) -> None:
        read = read_clip(write_clip(tmp_path / "calibrated.bvh", [{}, {}, {}, *walk(20)]))
        assert read.t_poses == 3
        assert read.broken[:3].all()
        assert not read.broken[4:].any()

    @pytest.mark.parametrize(
        ("moved", "dropped"),
        [
            # A single frame, a short run, and a cut, of which the frames on both sides go.
            (slice(9, 10), [9]), (slice(10, 14), [10, 11, 12, 13]), (slice(16, None), [15, 16]),
        ],
    )  # fmt: skip
    def test_jumps(self, tmp_path: Path, moved: slice, dropped: list[int]) -> None:
        frames = walk(30)
        frames[moved] = [{**frame, "RightArm": (-75.0, 90.0, 90.0)} for frame in frames[moved]]
        read = read_clip(write_clip(tmp_path / "flip.bvh", frames))
        broken = np.flatnonzero(read.broken)
        assert set(dropped) <= set(broken) <= {dropped[0] - 1, *dropped, dropped[-1] + 1}
        assert read.jumps == len(broken) and read.t_poses == 0


class TestMalformedClip:
    def fails(self, clip: Path) -> str:
        with pytest.raises(MotionError) as caught:
            read_clip(clip)
        assert str(clip) in str(caught.value)
        assert "\n" not in str(caught.value)
        return str(caught.value)

    @pytest.mark.parametrize(
        ("column", "value", "said"),
        [
            (slice(5, None), "", "has 5 values"),
            (0, "oops", "holds something that is not a number"),
            (0, "nan", "not finite"),
            (-1, "inf", "not finite"),
        ],
    )
    def test_a_line_of_something_else(
        self, clip: Path, column: int | slice, value: str, said: str
    ) -> None:
        lines = clip.read_text().splitlines()
        number = 4 + next(n for n, line in enumerate(lines) if line.startswith("Frame Time"))
        values = lines[number].split()
        if isinstance(column, slice):
            del values[column]
        else:
            values[column] = value
        lines[number] = " ".join(values)
        clip.write_text("\n".join(lines) + "\n")
        message = self.fails(clip)
        assert said in message
        assert f"line {number + 1}" in message or said == "not finite"

    @pytest.mark.parametrize("keep", [0.0, 0.01, 0.3, 0.8])
    def test_truncated(self, clip: Path, keep: float) -> None:
        text = clip.read_text()
        clip.write_text(text[: int(len(text) * keep)])
        self.fails(clip)


class TestManifest:
    def write(self, folder: Path, rows: str) -> Path:
        (folder / "manifest.csv").write_text(HEADER + rows)
        return folder

    def fails(self, folder: Path) -> str:
        with pytest.raises(MotionError) as caught:
            read_manifest(folder)
        assert str(folder / "manifest.csv") in str(caught.value)
        return str(caught.value)

    @pytest.mark.parametrize(
        ("content", "said"),
        [
            (None, "cannot be read"),
            (b"", "lists no segment"),
            (HEADER.encode(), "lists no segment"),
            (b"name,price\nbread,2\n", "clip,subject,action"),
            (b"\xff\xfe\x00\x80", ""),
            *((f"{HEADER}good,1,walk,0,9,30,\n{row}\n".encode(), "line 3 of") for row in (
                "a,1,walk,zero,9,30,", "a,1,walk,9,9,30,", "a,1,walk,-1,9,30,", ",1,walk,0,9,30,",
                "a,1,,0,9,30,", "a,1")),
            # Lines as an editor counts them, not rows.
            (f'{HEADER}a,1,walk,0,9,30,"two\nlines"\nb,1,walk,x,9,30,\n'.encode(), "line 4 of"),
        ],
    )  # fmt: skip
    def test_a_manifest_that_is_none(
        self, tmp_path: Path, content: bytes | None, said: str
    ) -> None:
        # The second one alone is not enough.
        (tmp_path / MANIFESTS[1]).write_text(HEADER + "b,2,sit,0,9,30,\n")
        if content is not None:
            (tmp_path / "manifest.csv").write_bytes(content)
        assert said in self.fails(tmp_path)

    def test_both_manifests_and_which_a_segment_is_from(self, tmp_path: Path) -> None:
        self.write(tmp_path, "a,1,walk,0,9,30,\n")
        (tmp_path / MANIFESTS[1]).write_text(HEADER + "b,2,sit,0,9,30,\na,1,sit,9,12,30,\n")
        segments = read_manifest(tmp_path)
        assert [(s.clip, s.action, s.manifest) for s in segments] == [
            ("a", "walk", MANIFESTS[0]), ("b", "sit", MANIFESTS[1]), ("a", "sit", MANIFESTS[1]),
        ]  # fmt: skip


RENAMED_JOINTS = {"LeftArm": "arm.L", "RightArm": "arm.R", "Spine": "torso", "LowerBack": "torso"}


@pytest.fixture
def ours(tmp_path: Path) -> Path:
    """The clip of CMU's rig."""
    return write_clip(tmp_path / "ours" / "bvh" / "stroll.bvh", walk(20))


@pytest.fixture
def renamed(ours: Path, tmp_path: Path) -> Path:
    """The same with other names, and no joint LowerBack."""
    text = ours.read_text()
    for name, other in RENAMED_JOINTS.items():
        text = text.replace(f"JOINT {name}\n", f"JOINT {other}\n")
    file = tmp_path / "theirs" / "bvh" / "stroll.bvh"
    file.parent.mkdir(parents=True)
    file.write_text(text)
    return file


def describe(file: Path, **values: object) -> Path:
    (file.parents[1] / RIG_FILE).write_text(json.dumps(values))
    return file.parents[1]


STROLL = (Segment("stroll", "s1", "walk", 0, 20),)


def test_a_renamed_rig_gives_the_same_poses(
    ours: Path, renamed: Path, avatars: list[Avatar]
) -> None:
    folder = describe(renamed, joints=RENAMED_JOINTS)
    ours, theirs = (
        joints_of(read_poses(where, STROLL)[0], avatars[0]) for where in (ours.parents[1], folder)
    )
    assert_allclose(theirs, ours, atol=1e-6)


def test_clips_of_two_tools_lie_in_one_folder(
    ours: Path, renamed: Path, avatars: list[Avatar]
) -> None:
    folder = ours.parents[1]
    (folder / "bvh" / "tool").mkdir()
    renamed.rename(folder / "bvh" / "tool" / "stroll.bvh")
    (folder / "bvh" / "tool" / RIG_FILE).write_text(json.dumps({"joints": RENAMED_JOINTS}))
    poses, _ = read_poses(folder, (*STROLL, Segment("tool/stroll", "s1", "walk", 0, 20)))
    joints = joints_of(poses, avatars[0])
    assert_allclose(joints[:20], joints[20:], atol=1e-6)


@pytest.mark.parametrize("unit", [1.0, 0.001])
def test_units_that_make_no_person_are_refused(tmp_path: Path, unit: float) -> None:
    file = write_clip(tmp_path / "walk.bvh", walk(9))
    with pytest.raises(MotionError, match=r"walk is of a person of .* m .*metres_per_unit"):
        read_clip(file, Rig(metres_per_unit=unit))


def test_a_joint_that_the_file_lacks_is_named(renamed: Path) -> None:
    folder = describe(renamed, joints={**RENAMED_JOINTS, "Head": "skull"})
    with pytest.raises(MotionError, match=r"no joint 'skull', which rig\.json names for 'Head'"):
        read_poses(folder, STROLL)


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
