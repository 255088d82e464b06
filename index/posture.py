"""The postures that answers name, and the posture of a skeleton, by rules on its geometry.

Lengths are measured in legs (thigh and shank), heights from the lowest joint. The rules are tried
in the order of the table in ``docs/notes/index.md``; the first that holds decides. The posture of a
*person* follows from the votes of skeletons: :mod:`app.estimation.posture`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from index.skeleton import JOINT_NAMES, JOINTS, SIDES, rows

PostureName = Literal[
    "standing", "walking", "running", "sitting", "crouching",
    "kneeling", "bending", "arms_raised", "crawling", "lying",
]  # fmt: skip

POSTURES: tuple[PostureName, ...] = get_args(PostureName)

UPRIGHT: tuple[PostureName, ...] = ("standing", "walking", "running", "arms_raised")
"""Postures of a straight body on its legs: neither low nor bending."""

ON_THE_GROUND: tuple[PostureName, ...] = ("lying", "crawling")
"""Postures in which the trunk rests on the ground or on a bed, or is carried on all fours."""

LOW: tuple[PostureName, ...] = ("sitting", "crouching", "kneeling", "crawling", "lying")
"""Postures without straight legs to stand on."""

# What landmarks, and what silhouettes distinguish of each posture; only votes of hypotheses
# distinguish the rest.
_DISTINGUISHED = {
    "standing": ("standing", "upright"),
    "walking": ("standing", "upright"),
    "running": ("standing", "upright"),
    "sitting": ("sitting", "sitting"),
    "crouching": ("crouching", "crouching"),
    "kneeling": ("crouching", "kneeling"),
    "bending": ("bending", "bending"),
    "arms_raised": ("standing", "upright"),
    "crawling": ("all_fours", "crawling"),
    "lying": ("lying", "lying"),
}

# Added to the votes for each posture of a group before the group is split by them.
_MIN_VOTE = 1e-3


class PostureGroups:
    """Groups of :data:`POSTURES`, in the order in which the outputs of a network name them."""

    def __init__(self, column: int, *names: str) -> None:
        self.names = names
        groups = [_DISTINGUISHED[posture][column] for posture in POSTURES]
        self.of = np.array([names.index(group) for group in groups])
        """Position ``(10,)`` in :attr:`names` of the group of each posture."""

    def __len__(self) -> int:
        return len(self.names)

    def sums(self, shares: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sums ``(..., G)`` of shares ``(..., 10)`` of :data:`POSTURES`."""
        return np.asarray(shares @ (self.of[:, None] == np.arange(len(self))))

    def split(
        self, grouped: NDArray[np.float64], votes: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Shares ``(10,)`` of postures, from those of groups ``(G,)`` and votes ``(10,)``."""
        within = votes + _MIN_VOTE
        return np.asarray((grouped / self.sums(within))[self.of] * within)


LANDMARK_GROUPS = PostureGroups(
    0, "standing", "bending", "crouching", "sitting", "all_fours", "lying"
)
SILHOUETTE_GROUPS = PostureGroups(
    1, "upright", "bending", "crouching", "kneeling", "sitting", "crawling", "lying"
)

MIN_WALKING_SPEED_M_S, MIN_RUNNING_SPEED_M_S = 0.5, 2.2
"""Least horizontal speeds of walking and of running people."""

# Steepest elevation of a camera.
_MAX_ELEVATION_DEG = 70.0
# Smallest tilt of the trunk of a person lying or on all fours.
_MIN_HORIZONTAL_DEG = 55.0
# Largest height of the pelvis and the chest of a person lying.
_MAX_LYING_HEIGHT = 0.5
# Least height of the pelvis above both knees of a kneeling person whose trunk is on the thighs.
_MIN_FOLDED_HEIGHT = 0.1
# Largest height of the lowest hand or elbow of a person on all fours.
_MAX_HAND_HEIGHT = 0.3
# Largest height of the pelvis of a person on all fours.
_MAX_CRAWLING_HEIGHT = 0.85
# Height of the pelvis below which a person is not standing.
_MAX_LOWERED_HEIGHT = 0.8
# Largest height of a pelvis that rests on the floor.
_MAX_FLOOR_HEIGHT = 0.3
# Largest height of a knee on the floor.
_MAX_KNEE_HEIGHT = 0.12
# Largest height of a knee on the floor above or below its ankle: toes may be tucked in.
_MAX_SHANK_RISE = 0.35
# Least height of the pelvis of a kneeling person, who may rest on the heels.
_MIN_KNEELING_HEIGHT = 0.2
# Horizontal distance of the centre of mass from the feet beyond which something else carries the
# body.
_MIN_UNSUPPORTED = 0.15
# A person whose thighs are level on average, with neither one steep and the pelvis at the height of
# a seat, sits even if the feet could carry the body: the trunk is upright or both shanks are steep.
# Squatting people lean the shanks forward to keep the balance.
_MAX_LEVEL_THIGH_DEG, _MAX_STEEP_THIGH_DEG, _MIN_SEAT_HEIGHT = 25.0, 50.0, 0.5
_MAX_SEATED_TRUNK_DEG, _MIN_SEATED_SHANK_DEG = 20.0, 55.0
# Least tilt of a trunk that is bent over standing legs, and over lowered legs.
_MIN_BENT_DEG, _MIN_BENT_LOW_DEG = 45.0, 60.0

# Shares of the body's mass, lumped at joints.
_MASSES = {"pelvis": 0.25, "chest": 0.25, "head": 0.08}
_LIMB_MASSES = {"elbow": 0.05, "hip": 0.05, "knee": 0.07, "ankle": 0.04}
_MASSES |= {f"{side}_{joint}": mass for joint, mass in _LIMB_MASSES.items() for side in SIDES}
_FEET = rows("left_ankle", "left_toe", "right_ankle", "right_toe", among=JOINT_NAMES)
_FIRST, _SECOND = np.triu_indices(len(_FEET), 1)
"""All pairs of points of the feet."""


@dataclass(frozen=True)
class _Skeletons:
    """Skeletons ``(N, 19, 3)``, each with its own direction up, ``(N, 3)``."""

    joints: NDArray[np.float64]
    up: NDArray[np.float64]

    def at(self, name: str) -> NDArray[np.float64]:
        return self.joints[:, JOINT_NAMES.index(name)]

    def along_up(self, vectors: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.einsum("n...i,ni->n...", vectors, self.up)

    def bones(self, start: str, end: str) -> NDArray[np.float64]:
        """Vectors ``(N, 2, 3)`` of the left and the right bone, from its end to its start."""
        return np.stack([self.at(f"{s}_{start}") - self.at(f"{s}_{end}") for s in SIDES], axis=1)


def classify_postures(
    points_3d: NDArray[np.floating],
    up: ArrayLike,
    speed: ArrayLike = 0.0,
) -> NDArray[np.int64]:
    """Classify the postures of skeletons.

    Parameters
    ----------
    points_3d : (N, P, 3) float array
        Metres, in any axes; the first 19 points are the joints.
    up : (3,) or (N, 3) float array
        Unit vectors away from the ground, in the same axes.
    speed : float or (N,) array
        Horizontal speed, metres per second; it separates walking and running from standing.

    Returns
    -------
    (N,) int64 array
        Positions in :data:`POSTURES`.
    """
    joints = np.asarray(points_3d, np.float64)[:, :JOINTS]
    bodies = _Skeletons(joints, np.broadcast_to(np.asarray(up, np.float64), (len(joints), 3)))
    speed = np.broadcast_to(np.asarray(speed, np.float64), (len(joints),))
    thighs, shanks = bodies.bones("hip", "knee"), bodies.bones("knee", "ankle")
    thigh_lengths = np.linalg.norm(thighs, axis=-1)
    leg = (thigh_lengths + np.linalg.norm(shanks, axis=-1)).mean(axis=1)
    heights = bodies.along_up(joints)
    heights = (heights - heights.min(axis=1, keepdims=True)) / leg[:, None]
    height = {name: heights[:, row] for row, name in enumerate(JOINT_NAMES)}
    pelvis = height["pelvis"]

    trunk = bodies.at("neck") - bodies.at("pelvis")
    tilt_deg = _degrees(bodies.along_up(trunk) / np.linalg.norm(trunk, axis=1), np.arccos)
    hand = np.min([height[f"{s}_{j}"] for s in SIDES for j in ("wrist", "elbow")], axis=0)
    knees = np.stack([height[f"{s}_knee"] for s in SIDES], axis=1)
    lower = knees.argmin(axis=1)
    every = np.arange(len(joints))
    shank_rise = np.abs(bodies.along_up(shanks)[every, lower]) / leg
    on_knee = (knees[every, lower] < _MAX_KNEE_HEIGHT) & (shank_rise < _MAX_SHANK_RISE)
    unsupported = _distance_from_feet(bodies) / leg > _MIN_UNSUPPORTED
    seated = _has_seated_legs(bodies, tilt_deg) & (pelvis > _MIN_SEAT_HEIGHT)

    horizontal = tilt_deg >= _MIN_HORIZONTAL_DEG
    lowered, on_floor = pelvis < _MAX_LOWERED_HEIGHT, pelvis < _MAX_FLOOR_HEIGHT
    low_chest = height["chest"] < _MAX_LYING_HEIGHT
    flexed = np.einsum("nki,ni->nk", thighs, trunk).max(axis=1) < 0
    on_thighs = flexed & (pelvis - knees.max(axis=1) > _MIN_FOLDED_HEIGHT)
    conditions: tuple[tuple[PostureName, NDArray[np.bool_]], ...] = (
        ("kneeling", horizontal & lowered & low_chest & on_thighs),  # Prostrate.
        ("lying", horizontal & (pelvis < _MAX_LYING_HEIGHT) & low_chest),
        (
            "crawling",
            horizontal & unsupported & (hand < _MAX_HAND_HEIGHT) & (pelvis < _MAX_CRAWLING_HEIGHT),
        ),
        ("kneeling", lowered & on_knee & (pelvis > _MIN_KNEELING_HEIGHT)),
        ("sitting", seated | (lowered & (on_floor | unsupported))),
        ("bending", tilt_deg >= np.where(lowered, _MIN_BENT_LOW_DEG, _MIN_BENT_DEG)),
        ("crouching", lowered),
        (
            "arms_raised",
            (height["left_wrist"] > height["head"]) & (height["right_wrist"] > height["head"]),
        ),
        ("running", speed >= MIN_RUNNING_SPEED_M_S),
        ("walking", speed >= MIN_WALKING_SPEED_M_S),
    )
    return np.select(
        [holds for _, holds in conditions],
        [POSTURES.index(posture) for posture, _ in conditions],
        POSTURES.index("standing"),
    )


def vote_posture(postures: Sequence[PostureName], weights: Sequence[float]) -> NDArray[np.float64]:
    """Share ``(10,)`` of each of ``POSTURES`` in the votes of one or more hypotheses.

    They vote for their postures with their confidences.
    """
    votes = np.zeros(len(POSTURES))
    for posture, weight in zip(postures, weights, strict=True):
        votes[POSTURES.index(posture)] += weight + 1e-9  # Equal votes if all weights are 0.
    return np.asarray(votes / votes.sum())


def camera_up(elevation_deg: ArrayLike) -> NDArray[np.float64]:
    """Unit vectors ``(..., 3)`` away from the ground, in axes of cameras with this elevation."""
    elevation = np.deg2rad(np.asarray(elevation_deg, np.float64))
    return np.stack([np.zeros_like(elevation), -np.cos(elevation), -np.sin(elevation)], axis=-1)


def lying_elevation_deg(points_3d: NDArray[np.floating]) -> NDArray[np.float64]:
    """Elevation of the camera ``(N,)`` that makes trunks most nearly level.

    Skeletons ``(N, P, 3)`` are in the axes of a camera that is not rolled.
    """
    pelvis, neck = rows("pelvis", "neck")
    trunk = np.asarray(points_3d[:, neck] - points_3d[:, pelvis], np.float64)
    elevation_deg = np.rad2deg(np.arctan2(-trunk[:, 1], trunk[:, 2]))
    # Head or hips may be the nearer end, so an angle and its opposite describe the same trunk.
    elevation_deg = np.where(elevation_deg < 0, elevation_deg + 180.0, elevation_deg)
    elevation_deg = np.where(elevation_deg > 135.0, elevation_deg - 180.0, elevation_deg)
    return np.clip(elevation_deg, 0.0, _MAX_ELEVATION_DEG)


def _has_seated_legs(bodies: _Skeletons, tilt_deg: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether legs ``(N,)`` are bent as on a seat, below trunks with these tilts."""
    thigh_sines, shank_sines = (
        bodies.along_up(bones) / np.linalg.norm(bones, axis=-1)
        for bones in (bodies.bones("hip", "knee"), bodies.bones("knee", "ankle"))
    )
    level = np.abs(_degrees(thigh_sines.mean(axis=1), np.arcsin)) < _MAX_LEVEL_THIGH_DEG
    level &= _degrees(thigh_sines.max(axis=1), np.arcsin) < _MAX_STEEP_THIGH_DEG
    steep = _degrees(shank_sines.min(axis=1), np.arcsin) > _MIN_SEATED_SHANK_DEG
    return np.asarray(level & ((tilt_deg < _MAX_SEATED_TRUNK_DEG) | steep))


def _degrees(sine_or_cosine: NDArray[np.float64], inverse: np.ufunc) -> NDArray[np.float64]:
    return np.rad2deg(inverse(np.clip(sine_or_cosine, -1, 1)))


def _distance_from_feet(bodies: _Skeletons) -> NDArray[np.float64]:
    """Horizontal distance ``(N,)`` of the centre of mass from lines between points of the feet."""
    weighted = sum(share * bodies.at(name) for name, share in _MASSES.items())
    centre = np.asarray(weighted) / sum(_MASSES.values())
    feet = bodies.joints[:, _FEET] - centre[:, None]
    feet -= bodies.along_up(feet)[..., None] * bodies.up[:, None]
    start = feet[:, _FIRST]
    line = feet[:, _SECOND] - start
    length = np.maximum((line**2).sum(axis=-1), 1e-12)
    share = np.clip(-(start * line).sum(axis=-1) / length, 0, 1)
    return np.linalg.norm(start + share[..., None] * line, axis=-1).min(axis=1)
