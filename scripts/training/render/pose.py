"""A pose that is being made: the bones of a recorded one, and how they are turned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from scripts.index.motion import METRES_PER_UNIT, Clip

Support = Literal["ground", "seat", "cycle"]


def about(axis: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """Rotation ``(3, 3)`` by an angle in radians about a unit vector."""
    x, y, z = axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew)


def places_of(clip: Clip, rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where bones turned by rotations ``(..., B, 3, 3)`` begin, from the pelvis, metres."""
    places = np.zeros(rotations.shape[:-1])
    for bone, parent in enumerate(clip.parents):
        if parent >= 0:
            along = rotations[..., parent, :, :] @ clip.offsets[bone]
            places[..., bone, :] = places[..., parent, :] + along
    return METRES_PER_UNIT * places


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
    posture: str | None = None

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

    @property
    def hangs(self) -> bool:
        """Whether legs and arms point down."""
        bones = self.bones
        for least, limbs in ((0.9, (*bones.thighs, *bones.shanks)), (0.85, bones.arms)):
            for first, second, *_ in limbs:
                bone = self.rotations[first] @ self.clip.offsets[second]
                if -bone[1] < least * np.linalg.norm(bone):
                    return False
        return True

    def turn_all(self, axis: NDArray[np.float64], angle: float) -> None:
        """Turn the whole body."""
        self.rotations = about(axis, angle) @ self.rotations

    def rest_on_knees_and_hands(self) -> None:
        """Turn the whole body forward or back until legs and arms or head reach as far down."""
        places = places_of(self.clip, self.rotations)
        behind, before = (
            places[min(np.concatenate(rows), key=lambda row: places[row, 1])]
            for rows in (self.bones.shanks, (*self.bones.arms, self.bones.head))
        )
        apart = before - behind
        angle = np.arctan2(apart[1], max(float(apart @ self.ahead), 0.1))
        self.turn_all(self.aside, float(angle))

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

    def point_arms(self, bone: int) -> None:
        """Turn both arms, as they are bent, so that the hands are towards where a bone begins."""
        places = places_of(self.clip, self.rotations)
        for arm, forearm in zip(self.bones.arms, self.bones.forearms, strict=True):
            shoulder, hand = places[arm[0]], places[forearm[1]]
            axis = np.cross(hand - shoulder, places[bone] - shoulder)
            size = float(np.linalg.norm(axis))
            angle = np.arctan2(size, (hand - shoulder) @ (places[bone] - shoulder))
            self.turn(arm, about(axis / max(size, 1e-9), float(angle)))

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
