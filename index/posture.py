"""The posture and the facing of skeletons.

Postures follow from rules on geometry. Lengths are measured in legs (thigh and shank), heights from
the lowest joint. The rules are tried in the order of the table in ``docs/notes/index.md``; the
first that holds decides. The posture of a *person* follows from the votes of skeletons:
:mod:`app.estimation.posture`.

A silhouette fits a pose and its reflection in depth equally well, and landmarks may be wrong in
depth, so hypotheses face both ways.
"""

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from index.skeleton import JOINT_NAMES, JOINTS, rows, side_rows, squared_lengths

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


class PostureGroups:
    """Groups of :data:`POSTURES`, in the order in which the outputs of a network name them.

    ``column`` is 0 for what landmarks distinguish, 1 for silhouettes.
    """

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
        # Added to the votes for each posture of a group before the group is split by them.
        within = votes + 1e-3
        return np.asarray((grouped / self.sums(within))[self.of] * within)


SILHOUETTE_GROUPS = PostureGroups(
    1, "upright", "bending", "crouching", "kneeling", "sitting", "crawling", "lying"
)

MIN_WALKING_SPEED_M_S, MIN_RUNNING_SPEED_M_S = 0.5, 2.2
"""Least horizontal speeds of walking and of running people."""

# Bones by their ends: both thighs, both shanks, the trunk.
_KNEES = side_rows("knee")
_UPPER_ENDS = [*side_rows("hip", "knee"), *rows("neck")]
_LOWER_ENDS = [*side_rows("knee", "ankle"), *rows("pelvis")]
_TRUNK = rows("pelvis", "chest", "head")
_WRISTS, _ELBOWS = side_rows("wrist"), side_rows("elbow")
# Shares ``(19,)`` of the body's mass, lumped at joints.
_MASSES = np.zeros(JOINTS)
_MASSES[_TRUNK] = 0.25, 0.25, 0.08
_MASSES[side_rows("elbow", "hip", "knee", "ankle")] = np.repeat((0.05, 0.05, 0.07, 0.04), 2)
_FEET = rows("left_ankle", "left_toe", "right_ankle", "right_toe", among=JOINT_NAMES)
_FIRST, _SECOND = np.triu_indices(len(_FEET), 1)
"""All pairs of points of the feet."""


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
    up = np.asarray(up, np.float64)
    along_up = (joints @ up[..., None])[..., 0]
    bones = joints[:, _UPPER_ENDS] - joints[:, _LOWER_ENDS]
    lengths = np.sqrt(squared_lengths(bones))
    rises = along_up[:, _UPPER_ENDS] - along_up[:, _LOWER_ENDS]
    leg = lengths[:, :4].sum(axis=1) / 2
    heights = (along_up - along_up.min(axis=1, keepdims=True)) / leg[:, None]
    angles_deg = np.rad2deg(np.arcsin(np.clip(rises / lengths, -1, 1)))
    thighs_deg, shanks_deg, tilt_deg = angles_deg[:, :2], angles_deg[:, 2:4], 90 - angles_deg[:, 4]
    height = dict(zip(("pelvis", "chest", "head"), heights[:, _TRUNK].T, strict=True))
    pelvis, knees, wrists = height["pelvis"], heights[:, _KNEES], heights[:, _WRISTS]
    hand = np.minimum(wrists, heights[:, _ELBOWS]).min(axis=1)
    lower = knees.argmin(axis=1)
    every = np.arange(len(joints))
    shank_rise = np.abs(rises[every, 2 + lower]) / leg
    on_knee = (knees[every, lower] < 0.12) & (shank_rise < 0.35)  # Toes may be tucked in.
    # Something else than the feet carries the body.
    unsupported = _distance_from_feet(joints, along_up, up) / leg > 0.15
    # A person whose thighs are level on average, with neither one steep and the pelvis at the
    # height of a seat, sits even if the feet could carry the body: the trunk is upright or both
    # shanks are steep. Squatting people lean the shanks forward to keep the balance.
    level_deg = np.rad2deg(np.arcsin(np.sin(np.deg2rad(thighs_deg)).mean(axis=1)))
    seated = (np.abs(level_deg) < 25.0) & (pelvis > 0.5) & (thighs_deg.max(axis=1) < 50.0)
    seated &= (tilt_deg < 20.0) | (shanks_deg.min(axis=1) > 55.0)

    horizontal = tilt_deg >= 55.0  # Of who lies, or is on all fours.
    lowered, on_floor = pelvis < 0.8, pelvis < 0.3
    low_chest = height["chest"] < 0.5
    flexed = ((bones[:, :2] @ bones[:, 4, :, None])[..., 0] < 0).all(axis=1)
    on_thighs = flexed & (pelvis - knees.max(axis=1) > 0.1)
    conditions: tuple[tuple[PostureName, ArrayLike], ...] = (
        ("kneeling", horizontal & lowered & low_chest & on_thighs),  # Prostrate.
        ("lying", horizontal & (pelvis < 0.5) & low_chest),
        ("crawling", horizontal & unsupported & (hand < 0.3) & (pelvis < 0.85)),
        ("kneeling", lowered & on_knee & (pelvis > 0.2)),  # Perhaps resting on the heels.
        ("sitting", seated | (lowered & (on_floor | unsupported))),
        ("bending", tilt_deg >= np.where(lowered, 60.0, 45.0)),
        ("crouching", lowered),
        ("arms_raised", (wrists > height["head"][:, None]).all(axis=1)),
        ("running", np.asarray(speed) >= MIN_RUNNING_SPEED_M_S),
        ("walking", np.asarray(speed) >= MIN_WALKING_SPEED_M_S),
        ("standing", True),
    )
    first = np.array([np.broadcast_to(holds, len(joints)) for _, holds in conditions]).argmax(
        axis=0
    )
    return np.array([POSTURES.index(posture) for posture, _ in conditions])[first]


def vote_posture(postures: Sequence[PostureName], weights: Sequence[float]) -> NDArray[np.float64]:
    """Share ``(10,)`` of each of ``POSTURES`` in the weighted votes of one or more hypotheses."""
    votes = np.zeros(len(POSTURES))
    for posture, weight in zip(postures, weights, strict=True):
        votes[POSTURES.index(posture)] += weight + 1e-9  # Equal votes if all weights are 0.
    return np.asarray(votes / votes.sum())


def camera_up(elevation_deg: ArrayLike) -> NDArray[np.float64]:
    """Unit vectors ``(..., 3)`` away from the ground, in axes of cameras with this elevation."""
    elevation = np.deg2rad(np.asarray(elevation_deg, np.float64))
    return np.stack([np.zeros_like(elevation), -np.cos(elevation), -np.sin(elevation)], axis=-1)


def lying_elevation_deg(points_3d: NDArray[np.floating]) -> NDArray[np.float64]:
    """Elevations ``(N,)`` of the camera that make trunks of skeletons ``(N, P, 3)`` nearly level.

    They are in the axes of a camera that is not rolled.
    """
    pelvis, neck = rows("pelvis", "neck")
    trunk = np.asarray(points_3d[:, neck] - points_3d[:, pelvis], np.float64)
    elevation_deg = np.rad2deg(np.arctan2(-trunk[:, 1], trunk[:, 2]))
    # Head or hips may be the nearer end, so an angle and its opposite describe the same trunk.
    elevation_deg = np.where(elevation_deg < 0, elevation_deg + 180.0, elevation_deg)
    elevation_deg = np.where(elevation_deg > 135.0, elevation_deg - 180.0, elevation_deg)
    return np.clip(elevation_deg, 0.0, 70.0)  # No camera is steeper.


def _distance_from_feet(
    joints: NDArray[np.float64], along_up: NDArray[np.float64], up: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Horizontal distance ``(N,)`` of the centre of mass from lines between points of the feet.

    Joints ``(N, 19, 3)`` are ``along_up`` ``(N, 19)`` along ``up`` ``(3,)`` or ``(N, 3)``.
    """
    feet = joints[:, _FEET] - (_MASSES @ joints)[:, None]
    aside = along_up[:, _FEET] - (along_up @ _MASSES)[:, None]
    feet -= aside[..., None] * up[..., None, :]
    start = feet[:, _FIRST]
    line = feet[:, _SECOND] - start
    length = np.maximum(squared_lengths(line), 1e-12)
    share = np.clip(-(start * line).sum(axis=-1) / length, 0, 1)
    return np.sqrt(squared_lengths(start + share[..., None] * line).min(axis=1))


_CORNERS = np.array([side_rows("shoulder"), side_rows("hip")]).T
"""Rows ``(2, 2)``: left and right, shoulder and hip."""

HYPOTHESES_PER_OPPOSITE_FACING = 7
"""At least one in this many hypotheses faces the opposite way to the first, since landmarks may be
wrong."""


def azimuth_deg(points_3d: NDArray[np.floating]) -> NDArray[np.float64]:
    """Azimuths ``(...)`` of the camera about shoulders and hips of skeletons ``(..., 24, 3)``.

    In degrees from -180 to 180: 0 in front, 90 on the person's left, whatever the direction of the
    trunk in the picture: people lying down may face the camera as well. Skeletons are in camera
    axes.
    """
    corners = np.asarray(points_3d[..., _CORNERS, :], np.float64)
    across = (corners[..., 0, :, :] - corners[..., 1, :, :]).sum(axis=-2)
    trunk = (corners[..., 0, :] - corners[..., 1, :]).sum(axis=-2)
    length = np.maximum(np.hypot(trunk[..., 0], trunk[..., 1]), 1e-9)
    # Component to the right of the trunk, if the trunk points up.
    aside = (trunk[..., 0] * across[..., 1] - trunk[..., 1] * across[..., 0]) / length
    return np.rad2deg(np.arctan2(-across[..., 2], aside))


def faces_camera(azimuths_deg: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether the camera is in front of the person, for each azimuth."""
    return np.cos(np.deg2rad(azimuths_deg)) > 0


def front_share(azimuths_deg: NDArray[np.float64], confidences: NDArray[np.float64]) -> float:
    """Share of the hypotheses' total confidence that faces the camera; arrays are ``(N,)``."""
    weights = confidences + 1e-9  # Equal weights if all confidences are 0.
    return float(np.clip(weights[faces_camera(azimuths_deg)].sum() / weights.sum(), 0, 1))


def likeliest_of_both_facings(
    azimuths_deg: NDArray[np.float64],
    confidences: NDArray[np.float64],
    front_probability: float,
    count: int,
) -> list[int]:
    """Choose ``count`` rows of hypotheses, with each facing as frequent as it is likely.

    The likeliest is among them, and one in :data:`HYPOTHESES_PER_OPPOSITE_FACING` that faces the
    opposite way, as long as there are any. Rows come in the order of their confidences.
    """
    order: list[int] = np.argsort(-confidences, kind="stable").tolist()
    front = faces_camera(azimuths_deg)
    opposite = front != front[order[0]]
    share = 1 - front_probability if front[order[0]] else front_probability
    share = max(share, 1 / HYPOTHESES_PER_OPPOSITE_FACING)
    wanted = min(int(share * count + 1e-9), count - 1)  # Seven sevenths are one.
    away = [row for row in order if opposite[row]][:wanted]
    others = [row for row in order if row not in away][: max(0, count - len(away))]
    return [row for row in order if row in away or row in others]
