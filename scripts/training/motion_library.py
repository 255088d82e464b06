"""Joints of many motions: falls, daily life and clips, of training or held-out subjects."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from index.skeleton import JOINT_NAMES
from scripts.index.body import Avatar
from scripts.training.falling import FallKind
from scripts.training.motions import DAILY, Motion, Motions

RATE = 15
"""Frames a second that are kept."""

SECONDS = 14
"""Length of a motion: whoever fell lies for a while."""

COUNTS = {
    "fall": (360, 60), "collapse": (300, 50), "daily": (600, 120), "recorded": (400, 80),
    "acrobatics": (60, 12), "drop": (20, 6), "out-of-bed": (120, 20), "bed": (150, 25),
}  # fmt: skip
"""Motions by kind, of training and of held-out subjects. There are many about beds, since getting
into bed and falling out of it look much alike."""

_FALLS: dict[str, FallKind | None] = {"fall": None, "drop": "drop", "out-of-bed": "bed"}

_NECK, _PELVIS = JOINT_NAMES.index("neck"), JOINT_NAMES.index("pelvis")
_ANKLES = [JOINT_NAMES.index("left_ankle"), JOINT_NAMES.index("right_ankle")]
# Cosine of the tilt, and height of the neck over the feet, of a trunk that is up.
_UPRIGHT, _NECK_M = 0.64, 0.7


def trunk_is_up(joints: NDArray[np.floating], heights: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Whether trunks are up, of joints ``(..., 24, 3)`` and their heights ``(..., 24)``, metres."""
    trunk = np.linalg.norm(joints[..., _NECK, :] - joints[..., _PELVIS, :], axis=-1)
    rise = heights[..., _NECK] - heights[..., _PELVIS]
    lift = heights[..., _NECK] - heights[..., _ANKLES].min(axis=-1)
    return np.asarray((rise > _UPRIGHT * trunk) & (lift > _NECK_M))


@dataclass(frozen=True)
class Library:
    """Joints ``(M, F, 24, 3)`` in the world, y up; 14 seconds each, the last frame held.

    ``falls`` and ``down`` ``(M,)`` are the seconds at which a fall begins and the body is on the
    ground, infinite where nobody falls; ``up`` ``(M, F)`` says whether the trunk is up.
    """

    joints: NDArray[np.float32]
    kinds: NDArray[np.str_]
    falls: NDArray[np.float64]
    down: NDArray[np.float64]
    up: NDArray[np.bool_]

    @classmethod
    def made(cls, motion: Path, avatar: Avatar, seed: int, *, held_out: bool) -> Self:
        """Simulate and read all motions; the same for the same seed."""
        motions = Motions.open(motion, avatar, held_out=held_out)
        made: list[Motion] = []
        for kind, counts in COUNTS.items():
            for number in tqdm(range(counts[held_out]), desc=kind):
                generator = np.random.default_rng([seed, number, len(made)])
                one = None
                while one is None:
                    if kind in _FALLS:
                        one = motions.fall(generator, _FALLS[kind])
                    elif kind == "bed":
                        about = [name for name, (support, _) in DAILY.items() if support == "bed"]
                        one = motions.daily(generator, str(generator.choice(about)))
                    elif kind == "collapse":
                        one = motions.collapse(generator)
                    elif kind == "daily":
                        one = motions.daily(generator)
                    else:
                        acrobatics = kind == "acrobatics"
                        walks = number % 2 == 0 and not acrobatics
                        one = motions.recorded(generator, walks=walks, acrobatics=acrobatics)
                made.append(one)
        frames = SECONDS * RATE
        joints = np.empty((len(made), frames, 24, 3), np.float32)
        for row, one in enumerate(made):
            own = one.joints(avatar)[::2]
            joints[row] = own[np.minimum(np.arange(frames), len(own) - 1)]
        times = np.array(
            [[np.inf if v is None else v / 30 for v in (m.falls, m.down)] for m in made]
        )
        up = trunk_is_up(joints, joints[..., 1])
        return cls(joints, np.array([m.kind for m in made]), times[:, 0], times[:, 1], up)

    def save(self, file: Path) -> None:
        """Write all arrays."""
        np.savez_compressed(file, **vars(self))

    @classmethod
    def load(cls, file: Path) -> Self:
        """Read all arrays."""
        with np.load(file) as arrays:
            return cls(**dict(arrays))
