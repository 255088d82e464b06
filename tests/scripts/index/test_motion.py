"""Reading motion: every fault named with its file and line; T-poses and jumps left out."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from scripts.index.body import Avatar, retarget
from scripts.index.motion import (
    CMU,
    MANIFESTS,
    METRES_PER_UNIT,
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
    def test_tips_point_to_the_next_bone_or_the_end_site(self, clip: Path) -> None:
        read = read_clip(clip)
        assert_allclose(read.tips[read.bones.index("LeftArm")] * METRES_PER_UNIT, (0.28, 0, 0))
        assert_allclose(read.tips[read.bones.index("LeftHand")] * METRES_PER_UNIT, (0.12, 0, 0))
        # LHipJoint's child starts away from it; Hips skips joints without an offset.
        assert_allclose(
            read.tips[read.bones.index("LHipJoint")] * METRES_PER_UNIT, (0.09, -0.04, 0)
        )

    def test_world_rotations_compose_along_the_chain(self, tmp_path: Path) -> None:
        # 30 degrees about z at the shoulder and 40 at the elbow: 70 at the forearm.
        bent: Angles = {"LeftArm": (30.0, 0.0, 0.0), "LeftForeArm": (40.0, 0.0, 0.0)}
        read = read_clip(write_clip(tmp_path / "bent.bvh", [bent, bent]))
        forearm = read.rotations[0, read.bones.index("LeftForeArm")]
        turn = np.deg2rad(70)
        assert_allclose(forearm @ [1, 0, 0], [np.cos(turn), np.sin(turn), 0], atol=1e-9)


class TestSpeeds:
    @pytest.mark.parametrize(
        ("frames", "step", "units_per_s"),
        # 0.3 ahead and 0.4 aside are half a unit a frame, 30 frames a second.
        [(40, (0.4, 0.0, 0.3), 15), (40, (0.4, 2.0, 0.3), 15), (1, (1.0, 1.0, 1.0), 0)],
    )
    def test_are_metres_per_second_along_the_ground(
        self, tmp_path: Path, frames: int, step: tuple[float, float, float], units_per_s: float
    ) -> None:
        speeds = read_clip(write_clip(tmp_path / "away.bvh", walk(frames), step)).speeds
        assert_allclose(speeds, np.full(frames, units_per_s * METRES_PER_UNIT), rtol=1e-3)


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

    def test_fast_but_smooth_motion_stays(self, tmp_path: Path) -> None:
        # 50 degrees a frame, sustained: a spin, not a fault.
        spin: list[Angles] = [
            {"Hips": (0.0, 50.0 * frame, 0.0), "LeftArm": (-75.0, 0.0, 60.0),
             "RightArm": (75.0, 0.0, 60.0), "LeftLeg": (0.0, 0.0, 60.0),
             "RightLeg": (0.0, 0.0, 60.0), "Spine": (10.0, 30.0, 20.0)}
            for frame in range(12)
        ]  # fmt: skip
        assert read_clip(write_clip(tmp_path / "spin.bvh", spin)).jumps == 0


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

    @pytest.mark.parametrize("content", [None, b"\x89PNG\r\n\x1a\n\x00\xff\xfe"])
    def test_no_bvh_at_all(self, clip: Path, content: bytes | None) -> None:
        clip.unlink() if content is None else clip.write_bytes(content)
        self.fails(clip)

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

    def test_getting_up_is_called_falling_as_well(self, tmp_path: Path) -> None:
        """A frame of it does not tell which of the two it shows."""
        self.write(tmp_path, "a,1,get-up,0,9,30,\nb,1,get-up-stairs,0,9,30,\n")
        assert [s.action for s in read_manifest(tmp_path)] == ["get-up-or-fall", "get-up-stairs"]


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


def test_the_unit_scales_paths(tmp_path: Path) -> None:
    file = write_clip(tmp_path / "run.bvh", walk(40), (0.0, 0.0, 2.0))
    metres = read_clip(file, Rig(metres_per_unit=0.03)).speeds
    assert_allclose(metres * CMU.metres_per_unit, read_clip(file).speeds * 0.03)


def turned(file: Path, order: tuple[int, int, int], signs: tuple[int, int, int]) -> Path:
    """The clip with other axes of its offsets: in its zero pose, the person does not stand."""

    def other(found: re.Match[str]) -> str:
        offset = [float(value) for value in found[1].split()]
        return "OFFSET " + " ".join(
            str(sign * offset[axis]) for axis, sign in zip(order, signs, strict=True)
        )

    file.write_text(re.sub("OFFSET (.*)", other, file.read_text()))
    return file


@pytest.mark.parametrize(
    ("order", "signs", "along"),
    [((1, 0, 2), (1, -1, 1), "+x"), ((0, 2, 1), (1, -1, 1), "+z"), ((0, 1, 2), (1, -1, -1), "-y")],
)
def test_a_zero_pose_that_does_not_stand_is_refused(
    tmp_path: Path, order: tuple[int, int, int], signs: tuple[int, int, int], along: str
) -> None:
    file = turned(write_clip(tmp_path / "rokoko.bvh", walk(9)), order, signs)
    said = f"rokoko does not stand in its zero pose: .* {re.escape(along)}.*rest_frame.: N into rig"
    with pytest.raises(MotionError, match=said):
        read_clip(file)


def test_a_frame_may_replace_a_zero_pose_that_does_not_stand(tmp_path: Path) -> None:
    """The person lies in the zero pose, and stands once the hips are turned by a quarter."""
    upright = {"Hips": (90.0, 0.0, 0.0)}
    frames = [upright, *({**stride, **upright} for stride in walk(9))]
    file = turned(write_clip(tmp_path / "rokoko.bvh", frames), (1, 0, 2), (1, -1, 1))
    clip = read_clip(file, Rig(rest_frame=0))
    stands = read_clip(write_clip(tmp_path / "ours.bvh", [{}]))
    assert_allclose(clip.offsets, stands.offsets, atol=1e-9)
    assert_allclose(clip.tips, stands.tips, atol=1e-9)
    assert_allclose(clip.rotations[0], stands.rotations[0], atol=1e-9)
    with pytest.raises(MotionError, match=r"has 10 frames: none is the rest_frame 10 of rig\.json"):
        read_clip(file, Rig(rest_frame=10))


def test_another_zero_pose_changes_no_motion(tmp_path: Path) -> None:
    file = write_clip(tmp_path / "walk.bvh", [{"Hips": (0.0, 130.0, 0.0)}, *walk(20)])
    ours, other = read_clip(file), read_clip(file, Rig(rest_frame=0))
    for vectors in ("offsets", "tips"):
        before, after = (
            np.einsum("fbij,bj->fbi", clip.rotations[:, rows], getattr(clip, vectors))
            for clip in (ours, other)
            for rows in [range(len(clip.bones)) if vectors == "tips" else [*clip.parents]]
        )
        assert_allclose(after[:, 1:], before[:, 1:], atol=1e-9)


@pytest.mark.parametrize("unit", [1.0, 0.001])
def test_units_that_make_no_person_are_refused(tmp_path: Path, unit: float) -> None:
    file = write_clip(tmp_path / "walk.bvh", walk(9))
    with pytest.raises(MotionError, match=r"walk is of a person of .* m .*metres_per_unit"):
        read_clip(file, Rig(metres_per_unit=unit))


def test_frame_times_in_milliseconds_are_refused(tmp_path: Path) -> None:
    file = write_clip(tmp_path / "walk.bvh", walk(9))
    file.write_text(file.read_text().replace("Frame Time: 0.0333333", "Frame Time: 33.3333"))
    with pytest.raises(MotionError, match=r"Frame Time: expected seconds, at most 1, got 33\.3333"):
        read_clip(file)


def test_byte_order_marks_are_ignored(ours: Path) -> None:
    folder, mark = ours.parents[1], b"\xef\xbb\xbf"
    (folder / RIG_FILE).write_bytes(mark + b'{"metres_per_unit": 0.05}')
    manifest = folder / "manifest.csv"
    manifest.write_bytes(mark + b"clip,subject,action,start_frame,end_frame\nstroll,a,walk,0,9\n")
    assert read_rig(folder).metres_per_unit == 0.05
    assert read_manifest(folder)[0].clip == "stroll"


def test_a_missing_joint_is_named(renamed: Path, avatars: list[Avatar]) -> None:
    with pytest.raises(MotionError, match=r"no joint 'Spine', which the body needs; rig\.json"):
        retarget(read_clip(renamed), avatars[0])


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
