"""Poses for an index: all sound frames, thinned to those that add most.

Marker sets let the heads of whole subjects hang or rise: the median pitch of a subject's head over
all upright frames lies anywhere from 6 degrees up to 41 down. Heads are therefore levelled first.
Motion capture hardly shows people lying, so recorded poses are also laid on the ground: on the
back, the belly, a side, or anything between.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from index.posture import POSTURES, classify_postures
from index.skeleton import BODY_UP, JOINT_NAMES, JOINTS
from scripts.index.body import (
    Avatar,
    about_vertical,
    pose_transforms,
    posed_points,
    retarget,
    turned_to_front,
)
from scripts.index.motion import Clip, MotionError, Segment, read_clip, read_rig

# Tilt of the trunk up to which a frame counts as upright.
_UPRIGHT_WITHIN_DEG = 25.0

MIN_UPRIGHT_FRAMES = 100
"""Subjects with fewer upright frames are given the median pitch of the others."""

TRUNK_BELOW_M = 0.3
"""Pelvis and chest of a lying body are at most this far above its lowest joint."""


def with_level_heads(clips: Sequence[Clip], subjects: Sequence[str]) -> tuple[Clip, ...]:
    """Rotate each subject's head so that its median direction in upright frames is ahead."""
    pitches: dict[str, list[NDArray[np.float64]]] = {subject: [] for subject in subjects}
    for clip, subject in zip(clips, subjects, strict=True):
        pitches[subject].append(_upright_pitches(clip))
    all_pitches = {subject: np.concatenate(parts) for subject, parts in pitches.items()}
    middle = {
        s: float(np.median(p)) for s, p in all_pitches.items() if len(p) >= MIN_UPRIGHT_FRAMES
    }
    usual = float(np.median(list(middle.values()))) if middle else 0.0
    return tuple(
        _pitched(clip, middle.get(subject, usual))
        for clip, subject in zip(clips, subjects, strict=True)
    )


def _upright_pitches(clip: Clip) -> NDArray[np.float64]:
    """How far the head looks up, in radians, in upright frames."""
    upright_above = np.cos(np.deg2rad(_UPRIGHT_WITHIN_DEG))
    upright = clip.rotations[:, clip.bone("Spine1"), 1, 1] > upright_above
    forward = clip.rotations[upright & ~clip.broken, clip.bone("Head"), :, 2]
    return np.arcsin(np.clip(forward[:, 1], -1, 1))


def _pitched(clip: Clip, angle: float) -> Clip:
    """Turn a clip's head down by an angle in radians, about the head's own left axis."""
    cosine, sine = np.cos(angle), np.sin(angle)
    down = np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
    rotations = clip.rotations.copy()
    head = clip.bone("Head")
    rotations[:, head] = rotations[:, head] @ down
    return replace(clip, rotations=rotations)


LYING_SIDES = ("back", "left", "belly", "right")
"""Parts of the body that a pose lies on, by quarters of the turn about the body's long axis."""


def laid_down(
    rotations: NDArray[np.float64], lying_deg: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Lay bodies down, whose pelvis faces +z before and after.

    ``rotations`` ``(P, B, 3, 3)`` are world rotations of the bones. ``lying_deg`` ``(P,)`` is the
    turn about the long axis before the body is laid on its back: 90 lies on the left side, 180 on
    the belly. NaN leaves a pose as it is.
    """
    about_long_axis = about_vertical(np.deg2rad(np.nan_to_num(lying_deg)))
    # From upright to the back: what was up points backwards, what was ahead points up.
    onto_back = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    lying = turned_to_front((onto_back @ about_long_axis)[:, None] @ rotations)
    return np.where(np.isnan(lying_deg)[:, None, None, None], rotations, lying)


def side_of(lying_deg: float) -> str:
    """Part that a body laid down lies on, one of :data:`LYING_SIDES`."""
    return LYING_SIDES[int(np.rint(lying_deg / 90.0)) % 4]


@dataclass(frozen=True)
class Poses:
    """Single frames of motion, turned to face +z."""

    clips: tuple[Clip, ...]
    clip: NDArray[np.int64]  # (P,): position in ``clips``
    frame: NDArray[np.int64]  # (P,): frame of that clip, zero-based
    actions: tuple[str, ...]
    action: NDArray[np.int64]  # (P,): position in ``actions``
    # (P,): turn about the body's long axis of poses laid down, see
    # :func:`scripts.index.poses.laid_down`; NaN for those that stay as they were recorded.
    lying_deg: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.frame)

    def take(self, rows: NDArray[np.integer]) -> Poses:
        """Return the poses of some rows."""
        return replace(
            self,
            clip=self.clip[rows],
            frame=self.frame[rows],
            action=self.action[rows],
            lying_deg=self.lying_deg[rows],
        )

    def rotations(self, rows: NDArray[np.integer]) -> NDArray[np.float64]:
        """World rotations ``(R, B, 3, 3)`` of the bones in poses that are of one clip."""
        clip = self.clips[self.clip[rows[0]]]
        recorded = turned_to_front(clip.rotations[self.frame[rows]])
        return laid_down(recorded, self.lying_deg[rows])

    def speeds(self) -> NDArray[np.float64]:
        """Horizontal speed of the pelvis ``(P,)``, metres per second; 0 where laid down."""
        speeds = np.array(
            [self.clips[c].speeds[f] for c, f in zip(self.clip, self.frame, strict=True)]
        )
        return np.where(np.isnan(self.lying_deg), speeds, 0.0)


@dataclass(frozen=True)
class Dropped:
    """Frames that were left out, and why."""

    t_poses: int
    jumps: int


def read_poses(motion: Path, segments: Sequence[Segment]) -> tuple[Poses, Dropped]:
    """Every sound frame of some segments of a motion folder.

    Raises
    ------
    MotionError
        If a clip is missing or malformed, or a segment reaches beyond its clip.
    """
    if not segments:
        raise MotionError("expected at least one segment of motion, got none")
    by_clip = sorted(segments, key=lambda segment: segment.clip)
    subjects = {segment.clip: segment.subject for segment in by_clip}
    files = {name: Path(motion) / "bvh" / f"{name}.bvh" for name in subjects}
    clips = with_level_heads(
        [
            replace(read_clip(file, read_rig(file.parent, Path(motion))), name=name)
            for name, file in files.items()
        ],
        list(subjects.values()),
    )
    actions = tuple(sorted({segment.action for segment in segments}))
    wanted = _wanted(clips, segments, actions)
    rows = [
        (number, frame, wanted[clip.name][frame])
        for number, clip in enumerate(clips)
        for frame in np.flatnonzero((wanted[clip.name] >= 0) & ~clip.broken)
    ]
    if not rows:
        raise MotionError("expected at least one sound frame in the segments, got none")
    clip_rows, frames, action_rows = (
        np.array(column, np.int64) for column in zip(*rows, strict=True)
    )
    recorded = np.full(len(frames), np.nan)
    poses = Poses(clips, clip_rows, frames, actions, action_rows, recorded)
    return poses, Dropped(sum(clip.t_poses for clip in clips), sum(clip.jumps for clip in clips))


def _wanted(
    clips: Sequence[Clip], segments: Sequence[Segment], actions: Sequence[str]
) -> dict[str, NDArray[np.int64]]:
    """Position in ``actions`` of each frame of each clip, by its name; -1 outside segments."""
    wanted = {clip.name: np.full(len(clip.rotations), -1) for clip in clips}
    for segment in segments:
        if segment.end > len(wanted[segment.clip]):
            raise MotionError(
                f"a segment of clip {segment.clip} ends at frame {segment.end}, "
                f"the clip has {len(wanted[segment.clip])}"
            )
        wanted[segment.clip][segment.start : segment.end] = actions.index(segment.action)
    return wanted


def joints_of(poses: Poses, avatar: Avatar) -> NDArray[np.float32]:
    """Joints ``(P, 19, 3)`` of one avatar in every pose: body axes, metres."""
    joints = np.empty((len(poses), JOINTS, 3), np.float32)
    for number, clip in enumerate(poses.clips):
        rows = np.flatnonzero(poses.clip == number)
        if len(rows) == 0:
            continue
        transforms = pose_transforms(avatar, retarget(clip, avatar), poses.rotations(rows))
        joints[rows] = posed_points(avatar, transforms)[:, :JOINTS]
    return joints


def lay_down(poses: Poses, avatar: Avatar, count: int, seed: int) -> Poses:
    """Lay ``count`` poses on the ground, each turned about the body's long axis at random.

    Only those whose trunk then lies on the ground, rather than on the limbs of this avatar, are
    returned, with actions called ``lie-on-...``.
    """
    generator = np.random.default_rng(seed)
    tried = poses.take(np.sort(generator.permutation(len(poses))[:count]))
    lying_deg = generator.uniform(0.0, 360.0, len(tried))
    actions = tuple(f"lie-on-{side}" for side in LYING_SIDES)
    laid = replace(
        tried,
        actions=(*tried.actions, *actions),
        action=np.array(
            [len(tried.actions) + LYING_SIDES.index(side_of(a)) for a in lying_deg], np.int64
        ),
        lying_deg=lying_deg,
    )
    joints = joints_of(laid, avatar)
    heights = joints[..., 1] - joints[..., 1].min(axis=1, keepdims=True)
    trunk = heights[:, [JOINT_NAMES.index("pelvis"), JOINT_NAMES.index("chest")]].max(axis=1)
    lies = classify_postures(joints, BODY_UP) == POSTURES.index("lying")
    return laid.take(np.flatnonzero(lies & (trunk < TRUNK_BELOW_M)))


def merged(parts: Sequence[Poses]) -> Poses:
    """Concatenate poses of the same clips; the actions are those of the part with most."""
    first = max(parts, key=lambda part: len(part.actions))
    return replace(
        first,
        clip=np.concatenate([part.clip for part in parts]),
        frame=np.concatenate([part.frame for part in parts]),
        action=np.concatenate([part.action for part in parts]),
        lying_deg=np.concatenate([part.lying_deg for part in parts]),
    )


def farthest_points(features: NDArray[np.floating], count: int) -> NDArray[np.int64]:
    """Farthest point sampling: each row chosen is the farthest from those before it.

    At most ``count`` rows of features ``(P, D)``, in order of choice; the first is the row nearest
    to the mean.
    """
    points = np.asarray(features, np.float32)
    squares = (points**2).sum(axis=1)
    chosen = [int(((points - points.mean(axis=0)) ** 2).sum(axis=1).argmin())]
    nearest = np.full(len(points), np.inf, np.float32)
    while len(chosen) < min(count, len(points)):
        last = chosen[-1]
        nearest = np.minimum(nearest, squares + squares[last] - 2 * (points @ points[last]))
        nearest[chosen] = -np.inf
        chosen.append(int(nearest.argmax()))
    return np.array(chosen, np.int64)
