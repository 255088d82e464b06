"""Which poses go into an index: all sound frames, thinned to those that add most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from index.build.body import Avatar, pose_transforms, posed_points, retarget, turned_to_front
from index.build.motion import Clip, MotionError, Segment, read_clip
from index.skeleton import JOINTS


@dataclass(frozen=True)
class Poses:
    """Single frames of motion, turned to face +z.

    Parameters
    ----------
    clips : tuple of Clip
    clip : (P,) int array
        Position in ``clips``.
    frame : (P,) int array
        Frame of that clip, zero-based.
    actions : tuple of str
    action : (P,) int array
        Position in ``actions``.
    """

    clips: tuple[Clip, ...]
    clip: NDArray[np.int64]
    frame: NDArray[np.int64]
    actions: tuple[str, ...]
    action: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.frame)

    def take(self, rows: NDArray[np.integer]) -> Poses:
        """Return the poses of some rows."""
        return Poses(self.clips, self.clip[rows], self.frame[rows], self.actions, self.action[rows])

    def rotations(self, row: int) -> NDArray[np.float64]:
        """World rotations ``(1, B, 3, 3)`` of the clip's bones in one pose."""
        clip = self.clips[self.clip[row]]
        return turned_to_front(clip.rotations[self.frame[row]][None])


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
    names = sorted({segment.clip for segment in segments})
    clips = tuple(read_clip(Path(motion) / "bvh" / f"{name}.bvh") for name in names)
    actions = tuple(sorted({segment.action for segment in segments}))
    wanted = {
        name: np.full(len(clip.rotations), -1) for name, clip in zip(names, clips, strict=True)
    }
    for segment in segments:
        if segment.end > len(wanted[segment.clip]):
            raise MotionError(
                f"a segment of clip {segment.clip} ends at frame {segment.end}, "
                f"the clip has {len(wanted[segment.clip])}"
            )
        wanted[segment.clip][segment.start : segment.end] = actions.index(segment.action)
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
    poses = Poses(clips, clip_rows, frames, actions, action_rows)
    return poses, Dropped(sum(clip.t_poses for clip in clips), sum(clip.jumps for clip in clips))


def joints_of(poses: Poses, avatar: Avatar) -> NDArray[np.float32]:
    """Joints ``(P, 19, 3)`` of one avatar in every pose: body axes, metres."""
    joints = np.empty((len(poses), JOINTS, 3), np.float32)
    for number, clip in enumerate(poses.clips):
        rows = np.flatnonzero(poses.clip == number)
        if len(rows) == 0:
            continue
        turned = turned_to_front(clip.rotations[poses.frame[rows]])
        transforms = pose_transforms(avatar, retarget(clip, avatar), turned)
        joints[rows] = posed_points(avatar, transforms)[:, :JOINTS]
    return joints


def farthest_points(features: NDArray[np.floating], count: int) -> NDArray[np.int64]:
    """Rows that cover a set: each the farthest from all chosen before it.

    Parameters
    ----------
    features : (P, D) array
    count : int

    Returns
    -------
    (min(count, P),) int64 array
        In order of choice; the first is the row nearest to the mean.
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
