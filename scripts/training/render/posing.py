"""Poses for photographs: recorded ones, and ones that motion capture lacks.

Hardly any clip shows people who bend over, kneel, sit on something or lie. Such poses are made
from recorded ones (:mod:`scripts.training.render.makers`), upper and lower bodies are exchanged,
and people fall by physics; each then counts as what its joints say (:func:`classes_of`).
"""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from app.estimation.posture import LANDMARK_GROUPS
from app.vision.judgement import FRAME_POSTURES
from index.posture import classify_postures
from index.skeleton import BODY_UP, JOINT_NAMES, JOINTS
from scripts.index.body import Avatar, turned_to_front
from scripts.index.motion import Clip, read_manifest
from scripts.index.poses import Poses, joints_of, read_poses
from scripts.training.falling import FALLS, FPS, fall_from
from scripts.training.render.makers import MAKERS, UNRECORDED, Maker
from scripts.training.render.pose import Bones, Pose

SHARES = {"standing": 0.27, "bending": 0.12, "crouching": 0.11, "sitting": 0.24, "all_fours": 0.06,
          "lying": 0.2}  # fmt: skip
"""How often each is asked for."""

HELD_OUT_SUBJECTS = ("13", "86", "127", "16")
"""Their clips are seen only by held-out photographs."""

FALLEN_POSES = 400
"""Simulated falls, as many as pay: bodies, clothes and views differ each time."""

REACHING_DOWN_ABOVE = 0.65
"""Height of the pelvis, in legs, above which a person with hands on the ground bends."""


def classes_of(joints: NDArray[np.floating]) -> NDArray[np.int64]:
    """Positions in :data:`FRAME_POSTURES` of skeletons ``(N, P, 3)`` in body axes."""
    classes = LANDMARK_GROUPS.of[classify_postures(joints, BODY_UP)]
    pelvis, hip, knee, ankle = (
        joints[:, JOINT_NAMES.index(name)]
        for name in ("pelvis", "left_hip", "left_knee", "left_ankle")
    )
    leg = np.linalg.norm(hip - knee, axis=1) + np.linalg.norm(knee - ankle, axis=1)
    high = pelvis[:, 1] - joints[:, :JOINTS, 1].min(axis=1) > REACHING_DOWN_ABOVE * leg
    bent = high & (classes == FRAME_POSTURES.index("all_fours"))
    return np.where(bent, FRAME_POSTURES.index("bending"), classes)


def class_of(pose: Pose, joints: NDArray[np.floating]) -> int:
    """Position in :data:`FRAME_POSTURES` of a pose whose joints ``(P, 3)`` are in body axes."""
    if pose.posture is not None:
        return FRAME_POSTURES.index(pose.posture)
    found = int(classes_of(joints[None])[0])
    leans = pose.support == "seat" and FRAME_POSTURES[found] in ("bending", "crouching")
    return FRAME_POSTURES.index("sitting") if leans or pose.support == "cycle" else found


@dataclass
class PoseSource:
    """Draws poses of a class, given recorded ones and the class of each."""

    poses: Poses
    classes: NDArray[np.int64]
    # Shares of the poses that no clip shows, and, of those that lie, of people who fell.
    unrecorded: float = 0.0
    fallen: float = 0.0
    _falls: dict[int, Pose] = field(default_factory=dict)
    _groups: dict[int, list[NDArray[np.int64]]] = field(default_factory=dict)
    _bones: dict[str, Bones] = field(default_factory=dict)

    def recorded(self, wanted: int, generator: Generator) -> Pose:
        """A recorded pose of a class; clips and actions count alike however long they are."""
        if wanted not in self._groups:
            rows = np.flatnonzero(self.classes == wanted)
            keys = self.poses.clip[rows] * 1000 + self.poses.action[rows]
            self._groups[wanted] = [rows[keys == key] for key in np.unique(keys)]
        groups = self._groups[wanted]
        group = groups[generator.integers(len(groups))]
        row = np.array([generator.choice(group)])
        clip = self.poses.clips[self.poses.clip[row[0]]]
        return self._pose(clip, self.poses.rotations(row)[0].copy())

    def _pose(self, clip: Clip, rotations: NDArray[np.float64]) -> Pose:
        if clip.name not in self._bones:
            self._bones[clip.name] = Bones.of(clip)
        return Pose(clip, rotations, self._bones[clip.name])

    def has(self, wanted: int) -> bool:
        """Whether enough recorded poses are of a class."""
        return int((self.classes == wanted).sum()) >= 100

    def draw(self, name: str, generator: Generator) -> Pose:
        """A pose that is meant to be of a class: recorded, or made."""
        wanted = FRAME_POSTURES.index(name)
        standing = FRAME_POSTURES.index("standing")
        if name == "lying" and generator.random() < self.fallen:
            return self.fallen_pose(int(generator.integers(FALLEN_POSES)), generator)
        if name in UNRECORDED and generator.random() < self.unrecorded:
            makers_of = UNRECORDED[name]
            return self.made(makers_of[generator.integers(len(makers_of))], generator)
        made = name in MAKERS and not (self.has(wanted) and generator.random() < 0.4)
        base = standing
        if name == "lying" and generator.random() < 0.5:
            base = int(
                generator.choice([FRAME_POSTURES.index(c) for c in ("sitting", "crouching")])
            )
        pose = self.recorded(base if made and self.has(base) else standing if made else wanted,
                             generator)  # fmt: skip
        if generator.random() < 0.4:
            self._exchange_arms(pose, generator)
        if made:
            MAKERS[name](pose, generator)
        elif name == "standing" and generator.random() < 0.25:
            pose.lean(float(generator.normal(0.1, 0.2)))
        pose.rotations = turned_to_front(pose.rotations[None])[0]
        return pose

    def made(self, make: Maker, generator: Generator) -> Pose:
        """A recorded pose of a person with straight legs and hanging arms, made into another."""
        standing = FRAME_POSTURES.index("standing")
        pose = self.recorded(standing, generator)
        for _ in range(200):
            if pose.hangs:
                break
            pose = self.recorded(standing, generator)
        make(pose, generator)
        pose.rotations = turned_to_front(pose.rotations[None])[0]
        return pose

    def fallen_pose(self, number: int, generator: Generator) -> Pose:
        """How a person lies who fell, by physics; the pose of a number stays the same."""
        while number not in self._falls:
            clip = self.poses.clips[generator.integers(len(self.poses.clips))]
            frame = int(generator.integers(len(clip.rotations)))
            fall = fall_from(clip, frame, FALLS[number % len(FALLS)], generator)
            if fall.ends_down:
                last = min(fall.down + round(generator.uniform(0.2, 2) * FPS), len(fall.rotations))
                self._falls[number] = self._pose(clip, fall.rotations[last - 1].copy())
        pose = replace(self._falls[number])
        pose.rotations = turned_to_front(pose.rotations[None])[0]
        return pose

    def _exchange_arms(self, pose: Pose, generator: Generator) -> None:
        """Give a pose the trunk's upper end, arms and head of another."""
        other = self.recorded(int(generator.choice(np.unique(self.classes))), generator)
        if other.clip.bones != pose.clip.bones:
            return
        chest = pose.clip.bone("Spine1")
        turn = pose.rotations[chest] @ other.rotations[chest].T
        for rows in pose.bones.arms:
            pose.rotations[rows] = turn @ other.rotations[rows]


def read_pose_source(motion: Path, avatar: Avatar, *, held_out: bool) -> PoseSource:
    """Read all recorded poses of the training or of the held-out subjects.

    Raises
    ------
    MotionError
        If the motion is missing or malformed.
    """
    segments = [
        segment
        for segment in read_manifest(motion)
        if (segment.subject in HELD_OUT_SUBJECTS) == held_out
    ]
    poses, _ = read_poses(motion, segments)
    poses = poses.take(np.arange(len(poses))[::3])
    joints = joints_of(poses, avatar)
    return PoseSource(poses, classes_of(joints))
