"""Which poses are taken: sound frames of the segments, mirrored, thinned by coverage."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from index.posture import POSTURES, classify_postures
from index.skeleton import JOINT_NAMES, NATIVE
from scripts.index.body import Avatar, facing_yaw
from scripts.index.motion import Clip, MotionError, Segment
from scripts.index.poses import (
    LYING_SIDES,
    MIN_UPRIGHT_FRAMES,
    TRUNK_BELOW_M,
    Poses,
    farthest_points,
    joints_of,
    laid_down,
    lay_down,
    merged,
    read_poses,
    side_of,
    with_level_heads,
)
from tests.scripts.index.toys import walk, write_clip


def test_takes_the_frames_of_the_segments(poses: Poses) -> None:
    assert len(poses) == 30 + 18
    assert [clip.name for clip in poses.clips] == ["greet", "stroll"]
    assert poses.actions == ("walk", "wave")
    greeting = poses.clip == 0
    assert_array_equal(poses.frame[greeting], np.arange(2, 20))
    assert {poses.actions[a] for a in poses.action[greeting]} == {"wave"}


@pytest.mark.parametrize(
    ("segments", "said"),
    [
        ([], "at least one segment"),
        ([Segment("stroll", "s1", "walk", 0, 31)], "stroll ends at frame 31, the clip has 30"),
        ([Segment("ghost", "s1", "walk", 0, 3)], "ghost"),
    ],
)
def test_segments_that_are_not_there_are_refused(
    motion_folder: Path, segments: list[Segment], said: str
) -> None:
    with pytest.raises(MotionError, match=said):
        read_poses(motion_folder, segments)


def test_heads_of_whole_subjects_are_held_level(tmp_path: Path) -> None:
    hanging = [{**frame, "Head": (0.0, 0.0, 15.0)} for frame in walk(60)]
    for name in ("one", "two"):
        write_clip(tmp_path / "bvh" / f"{name}.bvh", hanging)
    segments = [Segment(name, "s1", "walk", 0, 60) for name in ("one", "two")]
    poses, _ = read_poses(tmp_path, segments)
    forward = [clip.rotations[:, clip.bones.index("Head"), 1, 2] for clip in poses.clips]
    assert np.median(forward) == pytest.approx(0, abs=1e-6)


def test_speeds_are_those_of_the_clips_but_for_who_lies(poses: Poses) -> None:
    clips = tuple(
        replace(clip, speeds=number + np.arange(len(clip.rotations)) / 100)
        for number, clip in enumerate(poses.clips)
    )
    lying_deg = np.where(np.arange(len(poses)) % 3 == 0, 90.0, np.nan)
    speeds = replace(poses, clips=clips, lying_deg=lying_deg).speeds()
    assert_allclose(speeds, np.where(np.isnan(lying_deg), poses.clip + poses.frame / 100, 0))


def test_merged_holds_all_parts_in_order_and_names_their_actions(poses: Poses, laid: Poses) -> None:
    for parts in ([laid, poses], [poses, laid], [poses.take(np.arange(0)), laid]):
        together = merged(parts)
        assert len(together) == sum(map(len, parts))
        start = 0
        for part in parts:
            rows = np.arange(start, start + len(part))
            same = together.take(rows)
            for name in ("clip", "frame", "lying_deg"):
                assert_array_equal(getattr(same, name), getattr(part, name))
            assert [together.actions[a] for a in same.action] == [
                part.actions[a] for a in part.action
            ]
            start += len(part)


@settings(max_examples=30)
@given(seed=st.integers(0, 999), points=st.integers(2, 40), count=st.integers(1, 12))
def test_farthest_points_cover(seed: int, points: int, count: int) -> None:
    features = np.random.default_rng(seed).normal(size=(points, 3))
    chosen = farthest_points(features, count)
    assert len(chosen) == len(set(chosen.tolist())) == min(count, points)
    apart = np.linalg.norm(features[:, None] - features[None], axis=-1)
    # Greedy: each is at least as far from those before it as any other row then was.
    for step in range(1, len(chosen)):
        nearest = apart[:, chosen[:step]].min(axis=1)
        assert nearest[chosen[step]] == pytest.approx(nearest.max(), abs=1e-3)
    # So the covering radius never exceeds the smallest gap between the chosen.
    if len(chosen) > 1:
        gaps = apart[np.ix_(chosen, chosen)] + np.eye(len(chosen)) * 99
        assert apart[:, chosen].min(axis=1).max() <= gaps.min() + 1e-3


UP = (0.0, 1.0, 0.0)


def lengths(joints: NDArray[np.floating]) -> NDArray[np.float64]:
    parents, children = (list(ends) for ends in zip(*NATIVE.bones, strict=True))
    return np.linalg.norm(joints[:, parents] - joints[:, children], axis=-1)


def standing(count: int) -> NDArray[np.float64]:
    """Rotations of two bones of bodies that stand, the second one bent."""
    bent = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    return np.tile(np.stack([np.eye(3), bent]), (count, 1, 1, 1))


class TestLaidDown:
    @pytest.mark.parametrize(
        ("lying_deg", "side", "upward"),
        [
            (0.0, "back", (0, 0, 1)),  # the chest is up
            (90.0, "left", (-1, 0, 0)),  # the right side is up
            (180.0, "belly", (0, 0, -1)),
            (270.0, "right", (1, 0, 0)),
        ],
    )
    def test_lies_on_the_side_asked_for(
        self, lying_deg: float, side: str, upward: tuple[float, float, float]
    ) -> None:
        pelvis = laid_down(standing(1), np.array([lying_deg]))[0, 0]
        assert_allclose(pelvis @ upward, UP, atol=1e-12)
        assert side_of(lying_deg) == side

    def test_the_long_axis_is_level_and_the_pelvis_faces_ahead(self) -> None:
        angles = np.linspace(0, 360, 24, endpoint=False) + 3.0
        laid = laid_down(standing(len(angles)), angles)
        assert_allclose(laid[:, 0, 1, 1], 0, atol=1e-12)
        assert_allclose(facing_yaw(laid[:, 0]), 0, atol=1e-9)

    def test_limbs_are_held_as_recorded(self) -> None:
        angles = np.arange(0.0, 360.0, 30.0)
        recorded = standing(len(angles))
        laid = laid_down(recorded, angles)
        relative = [bones[:, 0].swapaxes(1, 2) @ bones[:, 1] for bones in (recorded, laid)]
        assert_allclose(*relative, atol=1e-12)


@pytest.mark.parametrize("turn", [-360.0, 0.0, 360.0])
@pytest.mark.parametrize("off", [-44.0, 0.0, 44.0])
def test_sides_by_quarters(turn: float, off: float) -> None:
    assert [side_of(quarter + off + turn) for quarter in (0, 90, 180, 270)] == list(LYING_SIDES)


class TestLayDown:
    def test_the_same_bones_lie(self, poses: Poses, laid: Poses, avatars: list[Avatar]) -> None:
        joints = joints_of(laid, avatars[0])
        assert len(laid) > 20
        assert {POSTURES[row] for row in classify_postures(joints, UP)} == {"lying"}
        recorded = {
            (clip, frame): row
            for row, (clip, frame) in enumerate(zip(poses.clip, poses.frame, strict=True))
        }
        rows = [recorded[pair] for pair in zip(laid.clip, laid.frame, strict=True)]
        before = joints_of(poses, avatars[0])[rows]
        assert_allclose(lengths(joints), lengths(before), atol=1e-5)

    def test_trunks_rest_on_the_ground(self, laid: Poses, avatars: list[Avatar]) -> None:
        heights = joints_of(laid, avatars[0])[..., 1]
        heights -= heights.min(axis=1, keepdims=True)
        trunk = heights[:, [JOINT_NAMES.index(name) for name in ("pelvis", "chest")]]
        assert trunk.max() < TRUNK_BELOW_M

    def test_same_seed_same_poses(self, poses: Poses, laid: Poses, avatars: list[Avatar]) -> None:
        again = lay_down(poses, avatars[0], len(poses), seed=0)
        assert_array_equal(again.lying_deg, laid.lying_deg)
        assert_array_equal(again.frame, laid.frame)
        other = lay_down(poses, avatars[0], len(poses), seed=1)
        assert not set(other.lying_deg) & set(laid.lying_deg)


def about(axis: int, degrees: NDArray[np.floating] | float) -> NDArray[np.float64]:
    """Rotations ``(..., 3, 3)`` about an axis; about x (0), positive pitches the face down."""
    angle = np.deg2rad(np.asarray(degrees, np.float64))
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.zeros((*angle.shape, 3, 3))
    matrix[..., axis, axis] = 1
    matrix[..., first, first] = matrix[..., second, second] = np.cos(angle)
    matrix[..., first, second], matrix[..., second, first] = -np.sin(angle), np.sin(angle)
    return matrix


def hanging(clip: Clip, degrees: float, frames: int = 200, seed: int = 0) -> Clip:
    """The clip's first frame, repeated; the head hangs by ``degrees`` and is turned about."""
    rng = np.random.default_rng(seed)
    rotations = np.repeat(clip.rotations[:1], frames, axis=0)
    head = about(1, rng.normal(0, 20, frames)) @ about(0, degrees + rng.normal(0, 8, frames))
    rotations[:, clip.bones.index("Spine1")] = np.eye(3)
    rotations[:, clip.bones.index("Head")] = head
    still = np.zeros(frames)
    return replace(clip, rotations=rotations, speeds=still, broken=still.astype(bool))


def pitches_deg(clip: Clip) -> NDArray[np.float64]:
    """How far the face looks up in every frame."""
    forward = clip.rotations[:, clip.bones.index("Head"), :, 2]
    return np.rad2deg(np.arcsin(forward[:, 1]))


@pytest.fixture
def clip(poses: Poses) -> Clip:
    return poses.clips[1]


@pytest.mark.parametrize("degrees", [-15.0, 0.0, 20.0, 40.0])
def test_each_subject_looks_ahead_in_the_median(clip: Clip, degrees: float) -> None:
    clips = [hanging(clip, degrees, seed=seed) for seed in (0, 1)] + [hanging(clip, 10.0, seed=2)]
    *both, other = with_level_heads(clips, ["a", "a", "b"])
    assert np.median(np.concatenate([pitches_deg(one) for one in both])) == pytest.approx(
        0, abs=0.5
    )
    assert np.median(pitches_deg(other)) == pytest.approx(0, abs=0.5)


def test_only_the_head_moves(clip: Clip) -> None:
    before = hanging(clip, 25.0)
    (after,) = with_level_heads([before], ["a"])
    others = [bone for bone, name in enumerate(clip.bones) if name != "Head"]
    assert_array_equal(after.rotations[:, others], before.rotations[:, others])
    head = after.rotations[:, clip.bones.index("Head")]
    assert_allclose(head @ head.swapaxes(1, 2), np.broadcast_to(np.eye(3), head.shape), atol=1e-12)
    assert_allclose(np.linalg.det(head), 1)


def test_frames_that_are_not_upright_or_broken_do_not_count(clip: Clip) -> None:
    before = hanging(clip, 20.0, frames=300)
    rotations, broken = before.rotations.copy(), before.broken.copy()
    head, spine = (clip.bones.index(name) for name in ("Head", "Spine1"))
    rotations[100:200, head] = rotations[200:, head] = about(0, -80.0)
    rotations[100:200, spine] = about(0, 60.0)
    broken[200:] = True
    (after,) = with_level_heads([replace(before, rotations=rotations, broken=broken)], ["a"])
    assert np.median(pitches_deg(after)[:100]) == pytest.approx(0, abs=1e-6)


def test_who_is_hardly_seen_upright_is_corrected_as_the_others_are(clip: Clip) -> None:
    clips = [hanging(clip, degrees, seed=seed) for seed, degrees in enumerate((10.0, 20.0, 60.0))]
    rare = hanging(clip, 50.0, frames=MIN_UPRIGHT_FRAMES - 1, seed=4)
    usual = np.median([np.median(pitches_deg(one)) for one in clips])
    *_, after = with_level_heads([*clips, rare], ["a", "b", "c", "d"])
    assert_allclose(pitches_deg(after), pitches_deg(rare) - usual, atol=1e-6)
