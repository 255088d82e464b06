"""The motions of people in films of falls and of daily life, as rotations of the bones of clips.

Recorded motion is taken from clips, walks repeat; daily life that no clip shows (to lie down, sit,
pray, tie shoes, wipe the floor, get up) leads from pose to pose; falls are simulated
(:mod:`scripts.training.falling`) and begin in clips.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from app.vision.judgement import FRAME_POSTURES
from scripts.index.body import (
    Avatar,
    about_vertical,
    facing_yaw,
    pose_transforms,
    posed_points,
    retarget,
)
from scripts.index.motion import METRES_PER_UNIT, Clip, Segment, read_manifest
from scripts.index.poses import read_poses
from scripts.training.falling import FALLS, FPS, FallKind, fall_from
from scripts.training.render.makers import ACTIVITY_POSES, use_hands
from scripts.training.render.pose import Pose, places_of
from scripts.training.render.posing import HELD_OUT_SUBJECTS, PoseSource, class_of, classes_of

Support = Literal["seat", "bed"]

FILM_S = 8.0
"""Length of a motion; falls begin after three to four seconds."""

WALKS = ("walk", "run")
_ACROBATICS = ("breakdance", "cartwheel", "flip", "roll", "duck", "climb")
_LOW = ("fall", "lie", "get-up")

_Step = tuple[str, float, float]
"""A posture or one of :data:`ACTIVITY_POSES`, and between how many seconds it is reached."""

DAILY: dict[str, tuple[Support | None, tuple[_Step, ...]]] = {
    "sits": ("seat", (("standing", 1, 3), ("sitting", 0.5, 2), ("sitting", 1, 4))),
    "stands-up": ("seat", (("sitting", 1, 3), ("standing", 0.8, 2), ("standing", 1, 4))),
    "lies-on-bed": ("bed", (("standing", 1, 2), ("sitting", 0.6, 1.5), ("lying", 1, 3))),
    "drops-into-seat": ("seat", (("standing", 1, 3), ("sitting", 0.35, 0.7), ("sitting", 1, 4))),
    "drops-onto-bed": ("bed", (("standing", 1, 3), ("lying", 0.7, 1.5), ("lying", 1, 3))),
    "in-bed": ("bed", (("lying", 1, 4), ("lying", 1, 3), ("lying", 1, 3))),
    "sits-up-in-bed": ("bed", (("lying", 2, 3), ("sitting", 1, 3), ("lying", 1, 3))),
    "leaves-bed": ("bed", (("lying", 2, 3), ("sitting", 1, 2), ("standing", 1, 2))),
    "gets-up": (None, (("lying", 2, 3), ("all_fours", 1, 2), ("standing", 1, 2.5))),
    "ties-shoes": (
        None,
        (
            ("standing", 1, 2),
            ("at-shoe", 0.5, 1.5),
            *[("at-shoe", 0.4, 1)] * 4,
            ("standing", 0.6, 1.5),
        ),
    ),
    "ties-shoes-seated": (
        "seat",
        (
            ("sitting", 1, 2),
            ("at-shoe-seated", 0.5, 1.5),
            *[("at-shoe-seated", 0.4, 1)] * 4,
            ("sitting", 0.6, 1.5),
        ),
    ),
    "picks-up": (None, (("standing", 1, 2), ("bending", 0.4, 1.2), ("standing", 0.4, 1.2))),
    "cleans-floor": (
        None,
        (
            ("standing", 1, 2),
            ("crouching", 0.6, 1.5),
            ("on-floor", 0.6, 1.5),
            *[("on-floor", 0.3, 0.8)] * 12,
        ),
    ),
    "prays": (
        None,
        (
            ("standing", 1, 2),
            ("on-heels", 0.8, 2),
            ("prostrate", 0.6, 1.5),
            ("prostrate", 0.5, 2),
            ("on-heels", 0.6, 1.5),
            ("prostrate", 0.6, 1.5),
        ),
    ),
    "bows": (
        None,
        (
            ("standing", 1, 2),
            ("bow", 0.6, 1.5),
            ("bow", 0.5, 2),
            ("standing", 0.6, 1.5),
            ("on-heels", 0.8, 2),
            ("prostrate", 0.6, 1.5),
        ),
    ),
    "sits-on-floor": (
        None,
        (("standing", 1, 2), ("crouching", 0.6, 1.2), ("sitting", 0.6, 1.5), ("sitting", 1, 3)),
    ),
    "looks-under": (
        None,
        (
            ("standing", 1, 2),
            ("crouching", 0.6, 1.5),
            ("all_fours", 0.5, 1.2),
            ("prostrate", 0.5, 1.2),
            ("prostrate", 0.8, 2.5),
            ("all_fours", 0.6, 1.5),
        ),
    ),
    "exercises": (
        None,
        (("standing", 1, 2), ("crouching", 0.5, 1), ("standing", 0.4, 1), ("crouching", 0.4, 1)),
    ),
    "push-ups": (
        None,
        (
            ("standing", 1, 2),
            ("crouching", 0.4, 1),
            ("all_fours", 0.4, 1),
            *[("lying", 0.4, 1), ("all_fours", 0.4, 1)] * 3,
        ),
    ),
}
"""Daily life from pose to pose, and what carries those who sit and lie."""

COLLAPSES: dict[str, tuple[_Step, ...]] = {
    "knees": (("on-heels", 0.3, 1.2), ("all_fours", 0.3, 1.2), ("lying", 0.4, 1.5)),
    "hands": (("bending", 0.3, 1.0), ("all_fours", 0.3, 1.2), ("lying", 0.4, 1.5)),
    "seat": (("crouching", 0.2, 0.8), ("sitting", 0.3, 1.2), ("lying", 0.4, 1.5)),
    "crouch": (("crouching", 0.3, 1.5), ("lying", 0.4, 1.5)),
    "furniture": (
        ("bending", 0.4, 1.5),
        ("crouching", 0.4, 1.5),
        ("sitting", 0.3, 1.0),
        ("lying", 0.5, 1.5),
    ),
}
"""Ways to the ground that are not simulated: people give way in stages, and lie still."""

_STAYS = 0.25
"""Share of the stages in which a collapsing person pauses."""

_LYING_POSES = 60
"""Simulated falls that show how those lie; each takes seconds."""

_REACHES = {"on-floor": 0.9}
"""How far the hands turn in activities that go on, radians; 0.2 in others."""

DROP = "drop"
"""Daily life that is simulated: people let themselves fall onto a bed or a sofa."""


@dataclass(frozen=True)
class Motion:
    """A body that moves: rotations ``(F, B, 3, 3)`` of a clip's bones, positions ``(F, 3)``.

    Positions of the pelvis are metres, y up, for legs as long as the clip's. ``falls`` and ``down``
    are the frames in which a fall begins, and from which the body is on the ground; None for both
    where nobody falls. The support holds the body in the frame ``held``. A ``grounded`` body
    touches the ground in every frame.
    """

    kind: str
    clip: Clip
    rotations: NDArray[np.float64]
    positions: NDArray[np.float64]
    falls: int | None = None
    down: int | None = None
    support: Support | None = None
    held: int = 0
    grounded: bool = False

    def joints(self, avatar: Avatar) -> NDArray[np.float64]:
        """Joints and face ``(F, 24, 3)`` of an avatar in the world, on its ground."""
        points = posed_points(
            avatar, pose_transforms(avatar, retarget(self.clip, avatar), self.rotations)
        )
        return np.asarray(points + self.path(avatar, points)[:, None])

    def path(self, avatar: Avatar, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Place of the pelvis ``(F, 3)`` so that no joint ``(F, 24, 3)`` is below the ground."""
        bones = self.clip.bones
        own = float(
            np.linalg.norm(
                [self.clip.offsets[bones.index(n)] for n in ("LeftLeg", "LeftFoot")], axis=1
            ).sum()
        )
        rows = [avatar.bones.index(n) for n in ("LeftUpLeg", "LeftLeg", "LeftFoot")]
        theirs = float(np.linalg.norm(np.diff(avatar.heads[rows], axis=0), axis=1).sum())
        path = self.positions * theirs / (own * METRES_PER_UNIT)
        if self.grounded:
            path[:, 1] = 0.06 - points[..., 1].min(axis=1)
            return np.asarray(path)
        lowest = points[..., 1].min(axis=1) + path[:, 1]
        if self.support is None:
            path[:, 1] -= np.quantile(lowest, 0.1) - 0.06
            lowest = points[..., 1].min(axis=1) + path[:, 1]
        path[:, 1] += np.maximum(0.05 - lowest, 0)
        return np.asarray(path)


@dataclass
class Motions:
    """Draws motions of the training or of the held-out subjects."""

    poses: PoseSource
    segments: list[Segment]
    clips: dict[str, Clip]
    # Its joints say which class a pose is of.
    avatar: Avatar

    @classmethod
    def open(cls, motion: Path, avatar: Avatar, *, held_out: bool) -> Motions:
        """Read the clips. Sitting and lying clips, of which there are few, serve both parts."""
        segments = [
            one for one in read_manifest(motion)
            if (one.subject in HELD_OUT_SUBJECTS) == held_out or one.action in ("sit", "lie")
        ]  # fmt: skip
        poses, _ = read_poses(motion, segments)
        from scripts.index.poses import joints_of

        thinned = poses.take(np.arange(len(poses))[::3])
        source = PoseSource(thinned, classes_of(joints_of(thinned, avatar)))
        return cls(source, segments, {clip.name: clip for clip in poses.clips}, avatar)

    def recorded(
        self,
        generator: Generator,
        *,
        walks: bool = False,
        acrobatics: bool = False,
        seconds: float = FILM_S,
    ) -> Motion:
        """Motion of one clip; walks and runs go on as long as needed."""
        wanted = [
            one for one in self.segments
            if (one.action in _ACROBATICS if acrobatics else one.action in WALKS if walks
                else one.action not in (*_ACROBATICS, *_LOW, "sit"))
            and one.end - one.start >= FPS
        ]  # fmt: skip
        if not wanted:  # Few subjects do acrobatics.
            return self.recorded(generator, seconds=seconds)
        segment = wanted[generator.integers(len(wanted))]
        clip = self.clips[segment.clip]
        frames = np.arange(segment.start, segment.end)
        rotations, positions = _from_origin(clip.rotations[frames], clip.positions[frames])
        need = round(seconds * FPS)
        if len(frames) > need:
            first = int(generator.integers(len(frames) - need))
            rotations, positions = _from_origin(
                rotations[first : first + need], positions[first : first + need]
            )
        turned, path = [rotations], [positions]
        while sum(map(len, turned)) < need:
            # It goes on where it ended, in the direction in which it went.
            yaw = float(facing_yaw(turned[-1][-1:, 0])[0])
            turn = about_vertical(np.array([yaw]))[0]
            turned.append(turn @ rotations)
            path.append(positions @ turn.T + path[-1][-1] * [1, 0, 1])
        return Motion(
            segment.action, clip, np.concatenate(turned)[:need], np.concatenate(path)[:need]
        )

    def daily(self, generator: Generator, kind: str | None = None) -> Motion:
        """Daily life, pose by pose."""
        kind = kind or str(generator.choice(list(DAILY)))
        support, steps = DAILY[kind]
        height = {"seat": (0.38, 0.5), "bed": (0.3, 0.65), None: (0.0, 0.0)}[support]
        above = float(generator.uniform(*height))
        goes_on = _goes_on(steps)
        poses = self._poses_of(steps, goes_on, generator)
        clip = poses[0].clip
        poses = [pose for pose in poses if pose.clip.bones == clip.bones]
        steps = steps[: len(poses)]
        times = [0.0, *np.cumsum([generator.uniform(low, high) for _, low, high in steps])]
        keys, heights = [], []
        heading = 0.0
        for pose, (name, *_), continued in zip(poses, steps, goes_on, strict=False):
            if not continued:
                heading += generator.normal(0, 0.5)
            keys.append(about_vertical(np.array([heading]))[0] @ pose.rotations)
            low = float(_lowest(clip, keys[-1]))
            on = above if support == "bed" and name in ("lying", "sitting") else 0.0
            if support == "bed" and name == "sitting":
                on = max(0.0, above - 0.35)
            heights.append(on + 0.06 - low)
        # The first pose is held, each next one is reached at the end of its time.
        frames = np.arange(round(max(times[-1], FILM_S) * FPS)) / FPS
        held = [times[1] * 0.8, *times[2:]]
        rotations, ys = _between(np.array(keys), np.array(heights), np.array(held), frames)
        sway = np.cumsum(generator.normal(0, 0.004, (len(frames), 2)), axis=0)
        shift = np.interp(frames, held, np.cumsum(generator.normal(0, 0.12, len(held))))
        positions = np.stack([sway[:, 0] + shift, ys, sway[:, 1]], axis=1)
        on_it = next(
            (row for row, (name, *_) in enumerate(steps) if name in ("lying", "sitting")), 0
        )
        return Motion(kind, clip, rotations, positions, support=support, grounded=support is None,
                      held=min(round(held[on_it] * FPS), len(frames) - 1))  # fmt: skip

    def _poses_of(
        self, steps: Sequence[_Step], goes_on: Sequence[bool], generator: Generator
    ) -> list[Pose]:
        """Draw a pose for each step; while an activity goes on, only the arms move."""
        poses: list[Pose] = []
        for (name, *_), continued in zip(steps, goes_on, strict=True):
            if not continued:
                make = ACTIVITY_POSES.get(name)
                begun = (
                    self.poses.made(make, generator) if make else self._of_class(name, generator)
                )
                poses.append(begun)
                continue
            poses.append(replace(begun, rotations=begun.rotations.copy()))
            use_hands(poses[-1], _REACHES.get(name, 0.2), generator)
        return poses

    def _giving_way(self, name: str, clip: Clip, generator: Generator) -> Pose:
        """Draw a pose for the bones of a clip; lying poses are those after simulated falls."""
        while True:
            if name == "lying":
                pose = self.poses.fallen_pose(int(generator.integers(_LYING_POSES)), generator)
            else:
                pose = self._poses_of([(name, 0, 0)], [False], generator)[0]
            if pose.clip.bones == clip.bones:
                return pose

    def _of_class(self, name: str, generator: Generator) -> Pose:
        """Draw a pose whose joints show the class; the last of many if none does."""
        for _ in range(40):
            pose = self.poses.draw(name, generator)
            turned = pose_transforms(
                self.avatar, retarget(pose.clip, self.avatar), pose.rotations[None]
            )
            joints = posed_points(self.avatar, turned)[0]
            if FRAME_POSTURES[class_of(pose, joints)] == name:
                break
        return pose

    def fall(self, generator: Generator, kind: FallKind | None = None) -> Motion | None:
        """Simulate a person who falls; None if they do not stay on the ground.

        A ``drop`` ends on a bed or sofa, and is daily life; None if it does not.
        """
        kind = kind or FALLS[generator.integers(len(FALLS))]
        before_s = generator.uniform(3.0, 4.0)
        support: Support | None = None
        if kind in ("seat", "bed"):
            support = "seat" if kind == "seat" else "bed"
            action = "sit" if kind == "seat" else "lie"
            wanted = [one for one in self.segments if one.action == action]
            segment = wanted[generator.integers(len(wanted))]
            clip = self.clips[segment.clip]
            frame = int(generator.integers(segment.start, segment.end))
            first = max(segment.start, frame - round(before_s * FPS))
            frames = np.arange(first, frame + 1)
            frames = np.concatenate(
                [np.full(round(before_s * FPS) + 1 - len(frames), first), frames]
            )
            rotations, positions = clip.rotations[frames].copy(), clip.positions[frames].copy()
        else:
            chance = generator.random()
            if chance < 0.8:
                before = self.recorded(generator, walks=chance < 0.5, seconds=before_s)
            else:
                kinds = ("picks-up", "stands-up", "gets-up")
                before = self.daily(generator, str(generator.choice(kinds)))
            count = round(before_s * FPS)
            latest = max(count, round(generator.uniform(2.5, 5.5) * FPS))
            last = min(len(before.rotations), latest)
            clip, some = before.clip, slice(last - count, last)
            rotations, positions = before.rotations[some], before.positions[some]
        start = Clip(**{**vars(clip), "rotations": rotations[-2:], "positions": positions[-2:]})
        fall = fall_from(start, 1, kind, generator)
        drop = fall.positions[0] - positions[-1]
        positions = np.concatenate(
            [positions + drop * [0, 1, 0], fall.positions - drop * [1, 0, 1]]
        )
        begun, rotations = len(rotations), np.concatenate([rotations, fall.rotations])
        if kind == "drop":
            if not fall.ends_on:
                return None
            held = len(rotations) - 1
            return Motion(DROP, clip, rotations, positions, support="bed", held=held)
        if not fall.ends_down or fall.down >= len(fall.positions):
            return None
        down = begun + fall.down
        return Motion(f"fall-{kind}", clip, rotations, positions, begun, down, support)

    def collapse(self, generator: Generator, kind: str | None = None) -> Motion:
        """A person who stands or walks sinks to the ground in stages and stays there."""
        kind = kind or str(generator.choice(list(COLLAPSES)))
        before = self.recorded(
            generator, walks=bool(generator.random() < 0.6), seconds=generator.uniform(2.5, 4.0)
        )
        clip, begun = before.clip, len(before.rotations)
        steps = list(COLLAPSES[kind])
        if generator.random() < 0.4:
            steps.append(("lying", 0.5, 2.0))  # The person turns over.
        poses = [self._giving_way(name, clip, generator) for name, *_ in steps]
        heading = float(facing_yaw(before.rotations[-1:, 0])[0])
        keys, times, lies = [before.rotations[-1]], [0.0], list[float]()
        for pose, (name, low, high) in zip(poses, steps, strict=True):
            heading += generator.normal(0, 0.4)
            keys.append(about_vertical(np.array([heading]))[0] @ pose.rotations)
            times.append(times[-1] + generator.uniform(low, high))
            if name == "lying":
                lies.append(times[-1])
            elif generator.random() < _STAYS:
                keys.append(keys[-1])
                times.append(times[-1] + generator.uniform(0.2, 1.5))
        frames = np.arange(1, round((times[-1] + 1.0) * FPS)) / FPS
        heights = np.zeros(len(keys))  # The ground carries the body in every frame.
        rotations, _ = _between(np.array(keys), heights, np.array(times), frames)
        shift = np.cumsum(generator.normal(0, 0.01, (len(frames), 2)), axis=0)
        positions = before.positions[-1] + np.stack(
            [shift[:, 0], np.zeros(len(frames)), shift[:, 1]], axis=1
        )
        return Motion(
            f"collapse-{kind}", clip, np.concatenate([before.rotations, rotations]),
            np.concatenate([before.positions, positions]), begun, begun + round(lies[0] * FPS),
            grounded=True,
        )  # fmt: skip


def _from_origin(
    rotations: NDArray[np.float64], positions: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The same motion, turned and moved so that it begins over the origin and faces +z."""
    turn = about_vertical(-facing_yaw(rotations[:1, 0]))[0]
    return turn @ rotations, (positions - positions[0] * [1, 0, 1]) @ turn.T


def _lowest(clip: Clip, rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Heights ``(...,)`` of the lowest of bones ``(..., B, 3, 3)`` over the pelvis, metres."""
    return np.asarray(places_of(clip, rotations)[..., 1].min(axis=-1))


def _goes_on(steps: Sequence[_Step]) -> list[bool]:
    """Whether each step continues the activity of the one before."""
    names = [name for name, *_ in steps]
    before = ["", *names[:-1]]
    return [
        one in ACTIVITY_POSES and one == other for one, other in zip(names, before, strict=True)
    ]


def _between(
    keys: NDArray[np.float64], heights: NDArray[np.float64], times: NDArray[np.float64],
    frames: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:  # fmt: skip
    """Rotations and heights at frames, between keys ``(K, B, 3, 3)``; they begin and end slowly."""
    at = np.clip(frames, times[0], times[-1])
    row = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    share = (at - times[row]) / (times[row + 1] - times[row])
    eased = times[row] + (times[row + 1] - times[row]) * share**2 * (3 - 2 * share)
    turned = [
        Slerp(times, Rotation.from_matrix(keys[:, bone]))(eased).as_matrix()
        for bone in range(keys.shape[1])
    ]
    return np.stack(turned, axis=1), np.interp(eased, times, heights)


COLLAPSING = 0.4
"""Share of the falls that go down in stages."""


def drawn(motions: Motions, generator: Generator, kinds: Sequence[float]) -> Motion:
    """A fall, daily life or recorded motion, by these shares."""
    while True:
        chance = generator.random() * sum(kinds)
        if chance < kinds[0]:
            collapses = generator.random() < COLLAPSING
            made = motions.collapse(generator) if collapses else motions.fall(generator)
        elif chance < kinds[0] + kinds[1]:
            made = motions.daily(generator)
        else:
            chance = generator.random()
            made = motions.recorded(
                generator, walks=bool(chance < 0.6), acrobatics=bool(chance > 0.9)
            )
        if made is not None:
            return made
