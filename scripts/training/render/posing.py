"""Poses for photographs: recorded ones, and ones that motion capture lacks.

Hardly any clip shows people who bend over, kneel, sit on something or lie. Such poses are made
from recorded ones: the trunk is turned at the hips, legs are folded, bodies laid down; upper and
lower bodies are exchanged; each then counts as what its joints say (:func:`classes_of`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from app.vision.judgement import FRAME_POSTURES, FramePostureName
from index.build.body import Avatar, turned_to_front
from index.build.motion import Clip, read_manifest
from index.build.poses import Poses, joints_of, read_poses
from index.posture import POSTURES, classify_postures
from index.skeleton import BODY_UP, JOINT_NAMES, JOINTS
from scripts.training.falling import FALLS, FPS, fall_from

CLASS_OF_POSTURE = {
    "standing": "standing", "walking": "standing", "running": "standing",
    "arms_raised": "standing", "bending": "bending", "crouching": "crouching",
    "kneeling": "crouching", "sitting": "sitting", "crawling": "all_fours", "lying": "lying",
}  # fmt: skip

SHARES = {"standing": 0.27, "bending": 0.12, "crouching": 0.11, "sitting": 0.24, "all_fours": 0.06,
          "lying": 0.2}  # fmt: skip
"""How often each is asked for."""

HELD_OUT_SUBJECTS = ("13", "86", "127", "16")
"""Their clips are seen only by held-out photographs."""

_CLASS_ROWS = np.array([FRAME_POSTURES.index(CLASS_OF_POSTURE[posture]) for posture in POSTURES])


Support = Literal["ground", "seat", "cycle"]

REACHING_DOWN_ABOVE = 0.65
"""Height of the pelvis, in legs, above which a person with hands on the ground bends.
"""


def classes_of(joints: NDArray[np.floating]) -> NDArray[np.int64]:
    """Positions in :data:`FRAME_POSTURES` of skeletons ``(N, P, 3)`` in body axes."""
    classes = _CLASS_ROWS[classify_postures(joints, BODY_UP)]
    pelvis, hip, knee, ankle = (
        joints[:, JOINT_NAMES.index(name)]
        for name in ("pelvis", "left_hip", "left_knee", "left_ankle")
    )
    leg = np.linalg.norm(hip - knee, axis=1) + np.linalg.norm(knee - ankle, axis=1)
    high = pelvis[:, 1] - joints[:, :JOINTS, 1].min(axis=1) > REACHING_DOWN_ABOVE * leg
    bent = high & (classes == FRAME_POSTURES.index("all_fours"))
    return np.where(bent, FRAME_POSTURES.index("bending"), classes)


def about(axis: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """Rotation ``(3, 3)`` by an angle in radians about a unit vector."""
    x, y, z = axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew)


@dataclass(frozen=True)
class Bones:
    """Rows of a clip's bones by part of the body; each with all that hangs on it."""

    trunk: NDArray[np.int64]
    arms: tuple[NDArray[np.int64], NDArray[np.int64]]
    forearms: tuple[NDArray[np.int64], NDArray[np.int64]]
    thighs: tuple[NDArray[np.int64], NDArray[np.int64]]
    shanks: tuple[NDArray[np.int64], NDArray[np.int64]]
    head: NDArray[np.int64]

    @classmethod
    def of(cls, clip: Clip) -> Bones:
        """Find them by name."""

        def below(name: str) -> NDArray[np.int64]:
            top = clip.bone(name)
            rows = []
            for bone in range(len(clip.bones)):
                parent = bone
                while parent >= 0 and parent != top:
                    parent = clip.parents[parent]
                if parent == top:
                    rows.append(bone)
            return np.array(rows)

        def both(name: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
            return below(f"Left{name}"), below(f"Right{name}")

        return cls(
            below("LowerBack"), both("Arm"), both("ForeArm"), both("UpLeg"), both("Leg"),
            below("Neck"),
        )  # fmt: skip


@dataclass
class Pose:
    """A pose that is being made: world rotations ``(B, 3, 3)`` of a clip's bones.

    ``support`` carries the body: on a seat it sits however far it leans, on a cycle whatever the
    legs do. ``posture`` is the class of a pose that its joints do not show.
    """

    clip: Clip
    rotations: NDArray[np.float64]
    bones: Bones
    support: Support = "ground"
    posture: FramePostureName | None = None

    def turn(self, rows: NDArray[np.int64], turn: NDArray[np.float64]) -> None:
        """Turn some bones, as they are in the world."""
        self.rotations[rows] = turn @ self.rotations[rows]

    @property
    def aside(self) -> NDArray[np.float64]:
        """To the left of the pelvis, level."""
        left = self.rotations[0][:, 0] * np.array([1.0, 0.0, 1.0])
        return np.asarray(left / max(float(np.linalg.norm(left)), 1e-6))

    @property
    def ahead(self) -> NDArray[np.float64]:
        """To the front of the pelvis, level."""
        return np.cross(self.aside, [0.0, 1.0, 0.0])

    def turn_all(self, axis: NDArray[np.float64], angle: float) -> None:
        """Turn the whole body."""
        self.rotations = about(axis, angle) @ self.rotations

    def lean(self, angle: float, pelvis: float = 0.7) -> None:
        """Turn trunk, arms and head forward; the pelvis by a share, the legs not at all."""
        legs = np.concatenate(self.bones.thighs)
        held = self.rotations[legs].copy()
        axis = self.aside
        self.turn_all(axis, pelvis * angle)
        self.turn(self.bones.trunk, about(axis, (1 - pelvis) * angle))
        self.rotations[legs] = held

    def fold_leg(self, side: int, thigh: float, shank: float, spread: float = 0.0) -> None:
        """Raise a thigh forward by an angle, and turn the shank so that it leans back by another.

        Both against where the recorded leg has them.
        """
        axis = self.aside
        out = about(np.array([0.0, 1.0, 0.0]), spread if side == 0 else -spread)
        self.turn(self.bones.thighs[side], out @ about(axis, -thigh))
        self.turn(self.bones.shanks[side], about(out @ axis, thigh + shank))

    def spread_arms(
        self, angles: NDArray[np.float64], scatter: float, generator: Generator
    ) -> None:
        """Turn the left and the right arm outward, as they rest beside a body that lies."""
        front = self.ahead
        for side, angle in enumerate(angles):
            chance = about(_direction(generator), generator.normal(0, scatter))
            outward = about(front, float(angle if side == 0 else -angle))
            self.turn(self.bones.arms[side], chance @ outward)
            bend = about(front, generator.normal(0, 0.7))
            self.turn(self.bones.forearms[side], bend)

    def turn_arms(self, forward: float, scatter: float, generator: Generator) -> None:
        """Turn both arms forward, and each a little by chance."""
        for side in (0, 1):
            chance = about(_direction(generator), generator.normal(0, scatter))
            self.turn(self.bones.arms[side], chance @ about(self.aside, -forward))
            bend = about(_direction(generator), abs(generator.normal(0, scatter)))
            self.turn(self.bones.forearms[side], bend)


def _direction(generator: Generator) -> NDArray[np.float64]:
    vector = generator.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


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
        if clip.name not in self._bones:
            self._bones[clip.name] = Bones.of(clip)
        return Pose(clip, self.poses.rotations(row)[0].copy(), self._bones[clip.name])

    def has(self, wanted: int) -> bool:
        """Whether enough recorded poses are of a class."""
        return int((self.classes == wanted).sum()) >= 100

    def draw(self, name: str, generator: Generator) -> Pose:
        """A pose that is meant to be of a class: recorded, or made."""
        wanted = FRAME_POSTURES.index(name)
        standing = FRAME_POSTURES.index("standing")
        if name == "lying" and generator.random() < self.fallen:
            return self._fallen(int(generator.integers(FALLEN_POSES)), generator)
        if name in UNRECORDED and generator.random() < self.unrecorded:
            pose = self.recorded(standing, generator)
            makers_of = UNRECORDED[name]
            makers_of[generator.integers(len(makers_of))](pose, generator)
            pose.rotations = turned_to_front(pose.rotations[None])[0]
            return pose
        makers = {
            "bending": bend_over, "crouching": crouch_or_kneel, "sitting": sit,
            "all_fours": go_on_all_fours, "lying": lie,
        }  # fmt: skip
        made = name in makers and not (self.has(wanted) and generator.random() < 0.4)
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
            makers[name](pose, generator)
        elif name == "standing" and generator.random() < 0.25:
            pose.lean(float(generator.normal(0.1, 0.2)))
        pose.rotations = turned_to_front(pose.rotations[None])[0]
        return pose

    def _fallen(self, number: int, generator: Generator) -> Pose:
        """How a person lies who fell, by physics; the pose of a number stays the same."""
        while number not in self._falls:
            clip = self.poses.clips[generator.integers(len(self.poses.clips))]
            if clip.name not in self._bones:
                self._bones[clip.name] = Bones.of(clip)
            frame = int(generator.integers(len(clip.rotations)))
            fall = fall_from(clip, frame, FALLS[number % len(FALLS)], generator)
            if fall.ends_down:
                last = min(fall.down + round(generator.uniform(0.2, 2) * FPS), len(fall.rotations))
                turned = fall.rotations[last - 1].copy()
                self._falls[number] = Pose(clip, turned, self._bones[clip.name])
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


def bend_over(pose: Pose, generator: Generator) -> None:
    """Turn the trunk forward at the hips, over straight or bent legs."""
    angle = np.deg2rad(generator.uniform(35, 120))
    twist = about(np.array([0.0, 1.0, 0.0]), np.deg2rad(generator.normal(0, 15)))
    if generator.random() < 0.5:
        knee = np.deg2rad(generator.uniform(0, 55))
        for side in (0, 1):
            pose.fold_leg(side, knee * generator.uniform(0.6, 1.1), knee * 0.4)
    pose.lean(float(angle), float(generator.uniform(0.5, 0.9)))
    pose.turn(pose.bones.trunk, twist)
    # Arms hang, reach to the ground or stay with the trunk.
    pose.turn_arms(float(angle * generator.choice([0.0, 0.6, 1.0, 1.3])), 0.3, generator)
    pose.turn(pose.bones.head, about(pose.aside, float(-angle * generator.uniform(0, 0.5))))


RIDERS = 0.1
"""Share of those who sit."""


def sit(pose: Pose, generator: Generator) -> None:
    """Sit on something, with any legs, on the ground with the legs stretched out, or on a cycle."""
    if generator.random() < RIDERS:
        ride(pose, generator)
        return
    on_ground = generator.random() < 0.25
    lean = np.deg2rad(generator.normal(-2, 16) if generator.random() < 0.75
                      else generator.uniform(-50, 45))  # fmt: skip
    alike = generator.random() < 0.6
    pose.support = "ground" if on_ground else "seat"
    if on_ground:
        lean = np.deg2rad(generator.normal(5, 18))
    elif generator.random() < 0.12:
        # To the ground, to shoes, onto the knees.
        lean = np.deg2rad(generator.uniform(45, 90))
    if generator.random() < (0.4 if on_ground else 0.06):
        _cross_legs(pose, generator)
    else:
        folds = [_seated_leg(on_ground, generator) for _ in range(2)]
        for side in (0, 1):
            thigh, shank, spread = folds[0 if alike else side]
            pose.fold_leg(side, thigh, shank, spread)
    pose.lean(float(lean), 0.7)
    turn = about(np.array([0.0, 1.0, 0.0]), np.deg2rad(generator.normal(0, 12)))
    pose.turn(pose.bones.trunk, turn)
    pose.turn_arms(float(np.deg2rad(generator.uniform(-10, 70))), 0.35, generator)
    if generator.random() < 0.5:
        pose.turn(pose.bones.head, about(pose.aside, float(np.deg2rad(generator.uniform(0, 45)))))


def ride(pose: Pose, generator: Generator) -> None:
    """Sit on a cycle, the hands at its bar: pedalling, or with both feet on rests."""
    pose.support = "cycle"
    pedals = generator.random() < 0.6
    crank = generator.uniform(0, 2 * np.pi)
    thigh, shank = generator.uniform(55, 95), generator.uniform(-20, 40)
    spread = float(np.deg2rad(generator.uniform(0, 8 if pedals else 22)))
    for side in (0, 1):
        if pedals:
            high = np.sin(crank + side * np.pi)
            thigh, shank = 50 + 28 * high, 12 + 22 * np.cos(crank + side * np.pi)
        pose.fold_leg(side, float(np.deg2rad(thigh)), float(np.deg2rad(shank)), spread)
    lean = np.deg2rad(generator.uniform(-3, 55 if pedals else 25))
    pose.lean(float(lean), 0.6)
    reach = float(lean + np.deg2rad(generator.uniform(35, 75)))
    pose.turn_arms(reach, 0.12, generator)
    pose.turn(pose.bones.head, about(pose.aside, float(-lean * generator.uniform(0, 0.8))))


def _cross_legs(pose: Pose, generator: Generator) -> None:
    """Thighs level and apart, shanks folded inward."""
    vertical = np.array([0.0, 1.0, 0.0])
    for side, sign in ((0, 1.0), (1, -1.0)):
        pose.fold_leg(side, float(np.deg2rad(generator.uniform(80, 110))), float(np.pi / 2))
        out, inward = np.deg2rad(generator.uniform([25, 35], [60, 80]))
        pose.turn(pose.bones.thighs[side], about(vertical, float(sign * out)))
        pose.turn(pose.bones.shanks[side], about(vertical, float(sign * inward)))


def _seated_leg(on_ground: bool, generator: Generator) -> tuple[float, float, float]:
    spread = generator.uniform(-5, 30)
    if on_ground:
        # Knees up, or legs stretched out ahead.
        up = generator.random()
        thigh = 90 + 50 * up
        shank = -88 + 100 * up
    else:
        thigh = generator.uniform(65, 105)
        shank = generator.choice([generator.uniform(-15, 25), generator.uniform(-65, -10)])
    return float(np.deg2rad(thigh)), float(np.deg2rad(shank)), float(np.deg2rad(spread))


def crouch_or_kneel(pose: Pose, generator: Generator) -> None:
    """Squat, or kneel on one knee or both, upright or on the heels."""
    way = generator.random()
    for side in (0, 1):
        spread = np.deg2rad(generator.uniform(0, 35))
        if way < 0.4:
            thigh, shank = generator.uniform(75, 135), generator.uniform(15, 55)
        elif way < 0.6 and side == 0:
            thigh, shank = generator.uniform(70, 105), generator.uniform(-5, 25)
        else:
            back = generator.uniform(0, 20) if way < 0.8 else generator.uniform(20, 75)
            thigh, shank = back, generator.uniform(80, 100)
        pose.fold_leg(side, float(np.deg2rad(thigh)), float(np.deg2rad(shank)), float(spread))
    lean = generator.uniform(5, 50) if way < 0.4 else generator.normal(12, 15)
    pose.lean(float(np.deg2rad(lean)), 0.6)
    pose.turn_arms(float(np.deg2rad(generator.uniform(0, 80))), 0.35, generator)


def go_on_all_fours(pose: Pose, generator: Generator) -> None:
    """On hands and knees, or hands and feet."""
    on_feet = generator.random() < 0.2
    for side in (0, 1):
        thigh = generator.normal(10, 15)
        shank = generator.uniform(0, 35) if on_feet else generator.uniform(80, 100)
        thigh += 30 if on_feet else 0
        pose.fold_leg(side, float(np.deg2rad(thigh)), float(np.deg2rad(shank)))
    trunk = np.deg2rad(generator.uniform(72, 102) + (15 if on_feet else 0))
    pose.lean(float(trunk), 0.85)
    pose.turn_arms(float(trunk + np.deg2rad(generator.normal(0, 12))), 0.15, generator)
    pose.turn(pose.bones.head, about(pose.aside, float(-np.deg2rad(generator.uniform(0, 60)))))


def lie(pose: Pose, generator: Generator) -> None:
    """Lie on the back, the belly, a side or between, legs drawn up or not, propped up or not."""
    if generator.random() < 0.5:
        drawn = np.deg2rad(generator.uniform(0, 110))
        # Mostly the feet rest as well.
        least = 0.5 if generator.random() < 0.7 else -0.9
        for side in (0, 1):
            thigh = drawn * generator.uniform(0.6, 1.2)
            pose.fold_leg(side, float(thigh), float(thigh * generator.uniform(least, 1.0)))
    if generator.random() < 0.3:
        pose.lean(float(np.deg2rad(generator.uniform(-15, 55))), 0.4)
    if generator.random() < 0.6:
        pose.spread_arms(np.deg2rad(generator.uniform(5, 165, 2)), 0.25, generator)
    else:
        pose.turn_arms(float(np.deg2rad(generator.uniform(-20, 150))), 0.5, generator)
    # What was up points backwards, turned about the long axis; then a slope.
    roll = generator.uniform(0, 2 * np.pi)
    if generator.random() < 0.6:
        roll = generator.choice([0.0, 0.5, 1.0, 1.5], p=[0.4, 0.2, 0.2, 0.2]) * np.pi
        roll += generator.normal(0, 0.25)
    onto_back = about(np.array([1.0, 0.0, 0.0]), -np.pi / 2)
    slope = about(np.array([1.0, 0.0, 0.0]), float(np.deg2rad(abs(generator.normal(0, 9)))))
    turn = slope @ onto_back @ about(np.array([0.0, 1.0, 0.0]), float(roll))
    pose.rotations = turn @ pose.rotations


def stand_on_one_leg(pose: Pose, generator: Generator) -> None:
    """A knee raised, a foot at the other knee, or a leg stretched ahead or behind."""
    pose.posture = "standing"
    side, way = int(generator.integers(2)), generator.random()
    if way < 0.35:
        out = generator.uniform(40, 85) * (1 if side == 0 else -1)
        back = out + generator.uniform(15, 50) * np.sign(out)
        pose.turn(pose.bones.thighs[side], about(pose.ahead, float(np.deg2rad(out))))
        pose.turn(pose.bones.shanks[side], about(pose.ahead, float(np.deg2rad(-back))))
    elif way < 0.7:
        thigh, shank = generator.uniform([40, -10], [115, 70])
        pose.fold_leg(side, float(np.deg2rad(thigh)), float(np.deg2rad(shank)))
    else:
        thigh = generator.choice([generator.uniform(35, 90), generator.uniform(-60, -20)])
        bend = generator.uniform(0, 30)
        pose.fold_leg(side, float(np.deg2rad(thigh)), float(np.deg2rad(bend - thigh)))
        if thigh < 0:
            pose.lean(float(np.deg2rad(generator.uniform(0, 30))), 0.6)
    _gesture(pose, generator)


def lunge(pose: Pose, generator: Generator) -> None:
    """One foot far ahead, its knee bent, the other leg straight behind."""
    pose.posture = "standing"
    side = int(generator.integers(2))
    thigh, shank = generator.uniform(40, 85), generator.normal(0, 8)
    # As low as the leg ahead.
    behind = np.arccos((np.cos(np.deg2rad(thigh)) + np.cos(np.deg2rad(shank))) / 2)
    bend = abs(generator.normal(0, 8))
    pose.fold_leg(side, float(np.deg2rad(thigh)), float(np.deg2rad(shank)))
    pose.fold_leg(1 - side, float(-behind), float(behind + np.deg2rad(bend)))
    pose.lean(float(np.deg2rad(generator.normal(8, 14))), 0.5)
    _gesture(pose, generator)


def fold_arms(pose: Pose, generator: Generator) -> None:
    """Arms before the chest, or the hands at the hips."""
    pose.posture = "standing"
    vertical = np.array([0.0, 1.0, 0.0])
    crossed = generator.random() < 0.6
    for side, sign in ((0, 1.0), (1, -1.0)):
        inward = np.deg2rad(generator.uniform(45, 80))
        if crossed:
            pose.turn(pose.bones.arms[side], about(pose.aside, -generator.uniform(0.1, 0.5)))
            pose.turn(pose.bones.forearms[side], about(pose.aside, -generator.uniform(1.2, 1.7)))
            pose.turn(pose.bones.forearms[side], about(vertical, -sign * inward))
        else:
            out = generator.uniform(0.5, 0.9)
            pose.turn(pose.bones.arms[side], about(pose.ahead, sign * out))
            pose.turn(pose.bones.forearms[side], about(pose.ahead, -sign * (out + inward)))


def squat_wide(pose: Pose, generator: Generator) -> None:
    """Squat with the knees far apart."""
    pose.posture = "crouching"
    thigh, spread = generator.uniform([50, 35], [100, 65])
    for side in (0, 1):
        shank = generator.uniform(-5, 25)
        pose.fold_leg(side, *np.deg2rad([thigh, shank, spread]).tolist())
    pose.lean(float(np.deg2rad(generator.uniform(0, 35))), 0.6)
    _gesture(pose, generator)


def plank(pose: Pose, generator: Generator) -> None:
    """A straight body on hands and feet, on the forearms, or on one hand and a side."""
    pose.posture = "all_fours"
    # An arm of .55 m under shoulders that are 1.4 m from the feet.
    slope = np.deg2rad(generator.normal(67, 5))
    if generator.random() < 0.5:
        low = generator.random() < 0.35
        pose.turn_arms(float(np.deg2rad(generator.normal(85, 8))), 0.12, generator)
        if low:
            for forearm in pose.bones.forearms:
                pose.turn(forearm, about(pose.aside, float(-np.deg2rad(generator.normal(85, 10)))))
            slope += np.deg2rad(12)
        pose.turn_all(pose.aside, float(slope))
        return
    side = int(generator.integers(2))
    sign = 1.0 if side == 0 else -1.0
    up = generator.uniform(60, 100) if generator.random() < 0.6 else generator.uniform(-5, 30)
    raised = {side: generator.normal(85, 8), 1 - side: up}
    for arm, angle in raised.items():
        out = np.deg2rad(angle) * (1 if arm == 0 else -1)
        pose.turn(pose.bones.arms[arm], about(pose.ahead, float(out)))
    pose.turn_all(pose.ahead, float(-sign * slope))


def lean_on_arm(pose: Pose, generator: Generator) -> None:
    """Sit on the ground, the trunk upon one arm, as people do who get up."""
    pose.posture = "sitting"
    for side in (0, 1):
        pose.fold_leg(side, *_seated_leg(True, generator))
    side = int(generator.integers(2))
    sign = 1.0 if side == 0 else -1.0
    lean = float(np.deg2rad(generator.uniform(15, 40)))
    pose.lean(float(np.deg2rad(generator.normal(-10, 12))), 0.7)
    pose.turn(pose.bones.trunk, about(pose.ahead, -sign * lean))
    out = sign * (lean + generator.uniform(0.2, 0.7))
    pose.turn(pose.bones.arms[side], about(pose.ahead, out))
    pose.turn(pose.bones.arms[1 - side], about(pose.aside, -generator.uniform(0, 1.2)))


def _gesture(pose: Pose, generator: Generator) -> None:
    """Leave the arms, spread them, raise them ahead or above the head."""
    way = generator.random()
    if way < 0.3:
        pose.spread_arms(np.deg2rad(generator.uniform(50, 110, 2)), 0.15, generator)
    elif way < 0.5:
        pose.spread_arms(np.deg2rad(generator.uniform(145, 180, 2)), 0.15, generator)
    elif way < 0.7:
        pose.turn_arms(float(np.deg2rad(generator.uniform(40, 100))), 0.2, generator)


UNRECORDED: dict[str, tuple[Callable[[Pose, Generator], None], ...]] = {
    "standing": (stand_on_one_leg, lunge, fold_arms), "crouching": (squat_wide,),
    "all_fours": (plank,), "sitting": (lean_on_arm,),
}  # fmt: skip
"""Poses that no clip shows."""

FALLEN_POSES = 400
"""Simulated falls, as many as pay: bodies, clothes and views differ each time."""


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
