"""The skeleton: its points, the keypoint sets of the API, the camera, and geometry of skeletons.

Body axes: x to the person's left, y up, z forward, metres, origin at the pelvis, rotated about the
vertical so that the pelvis faces +z. Camera axes: x right, y down, z forward.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from descriptor.silhouette import WIDTH

SIDES = ("left", "right")

JOINT_NAMES = (
    "pelvis", "spine", "chest", "neck", "head",
    "left_shoulder", "left_elbow", "left_wrist",
    "right_shoulder", "right_elbow", "right_wrist",
    "left_hip", "left_knee", "left_ankle", "left_toe",
    "right_hip", "right_knee", "right_ankle", "right_toe",
)  # fmt: skip

LIMBS = (
    "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
    "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
)  # fmt: skip
"""The 12 limb joints, which annotated photographs have as well."""

FACE_NAMES = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")

POINT_NAMES = JOINT_NAMES + FACE_NAMES
"""The points of a skeleton in an index: 19 joints, then 5 points of the face."""

BODY_UP = (0.0, 1.0, 0.0)
"""Direction away from the ground, in body axes."""

JOINTS = len(JOINT_NAMES)
POINTS = len(POINT_NAMES)


def rows(*names: str, among: Sequence[str] = POINT_NAMES) -> list[int]:
    """Rows of the named points.

    Examples
    --------
    >>> rows("pelvis", "head")
    [0, 4]
    """
    return [among.index(name) for name in names]


def side_rows(*parts: str, among: Sequence[str] = POINT_NAMES) -> list[int]:
    """Rows of paired points, part by part, left before right.

    Examples
    --------
    >>> side_rows("shoulder", "hip")
    [5, 8, 11, 15]
    """
    return rows(*(f"{side}_{part}" for part in parts for side in SIDES), among=among)


def other_side(name: str) -> str:
    side, _, part = name.partition("_")
    return f"{SIDES[side == 'left']}_{part}" if side in SIDES else name


LIMB_ROWS = rows(*LIMBS)
"""Rows of the limb joints among :data:`POINT_NAMES`."""

LIMB_SHOULDERS, LIMB_HIPS = (side_rows(part, among=LIMBS) for part in ("shoulder", "hip"))
"""Rows among :data:`LIMBS`."""


@dataclass(frozen=True)
class KeypointSet:
    """A named selection of the stored points, in its own order.

    ``indices`` are rows among :data:`POINT_NAMES`; bones lead from parent to child, as positions in
    ``names``.
    """

    name: str
    names: tuple[str, ...]
    indices: tuple[int, ...]
    bones: tuple[tuple[int, int], ...]


def _keypoint_set(
    name: str,
    names: tuple[str, ...],
    bones: tuple[tuple[str, str], ...],
    points: dict[str, str] | None = None,
) -> KeypointSet:
    """A set whose keypoints are the points of the same name, or those that ``points`` names."""
    renamed = points or {}
    return KeypointSet(
        name,
        names,
        tuple(POINT_NAMES.index(renamed.get(keypoint, keypoint)) for keypoint in names),
        tuple((names.index(parent), names.index(child)) for parent, child in bones),
    )


def _limbs(side: str) -> tuple[tuple[str, str], ...]:
    return (
        (f"{side}_shoulder", f"{side}_elbow"),
        (f"{side}_elbow", f"{side}_wrist"),
        (f"{side}_hip", f"{side}_knee"),
        (f"{side}_knee", f"{side}_ankle"),
    )


NATIVE = _keypoint_set(
    "native",
    JOINT_NAMES,
    (
        ("pelvis", "spine"),
        ("spine", "chest"),
        ("chest", "neck"),
        ("neck", "head"),
        ("chest", "left_shoulder"),
        ("chest", "right_shoulder"),
        ("pelvis", "left_hip"),
        ("pelvis", "right_hip"),
        *_limbs("left"),
        *_limbs("right"),
        ("left_ankle", "left_toe"),
        ("right_ankle", "right_toe"),
    ),
)

COCO17 = _keypoint_set(
    "coco17",
    (
        "nose", "left_eye", "right_eye", "left_ear", "right_ear",
        "left_shoulder", "right_shoulder", "left_elbow", "right_elbow",
        "left_wrist", "right_wrist", "left_hip", "right_hip",
        "left_knee", "right_knee", "left_ankle", "right_ankle",
    ),
    (
        ("nose", "left_eye"),
        ("nose", "right_eye"),
        ("left_eye", "left_ear"),
        ("right_eye", "right_ear"),
        ("left_shoulder", "right_shoulder"),
        ("left_shoulder", "left_hip"),
        ("right_shoulder", "right_hip"),
        ("left_hip", "right_hip"),
        *_limbs("left"),
        *_limbs("right"),
    ),
)  # fmt: skip

H36M17 = _keypoint_set(
    "h36m17",
    (
        "pelvis", "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle",
        "spine", "thorax", "nose", "head",
        "left_shoulder", "left_elbow", "left_wrist",
        "right_shoulder", "right_elbow", "right_wrist",
    ),
    (
        ("pelvis", "right_hip"),
        ("pelvis", "left_hip"),
        ("pelvis", "spine"),
        ("spine", "thorax"),
        ("thorax", "nose"),
        ("nose", "head"),
        ("thorax", "left_shoulder"),
        ("thorax", "right_shoulder"),
        *_limbs("left"),
        *_limbs("right"),
    ),
    # Human3.6M's spine lies between pelvis and thorax, its thorax at the base of the neck.
    {"spine": "chest", "thorax": "neck"},
)  # fmt: skip

OTHER_SIDE = np.array(rows(*(other_side(name) for name in POINT_NAMES)))
"""Row of the same point on the other side of the body, for each of ``POINT_NAMES``."""


def exchange_sides(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Exchange the names left and right of skeletons ``(..., 24, D)``; no point moves."""
    return points.take(OTHER_SIDE, axis=-2)


def reversed_in_depth(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The twins of skeletons ``(..., 24, 3)`` in camera axes, with the same outline from behind.

    Depths change their sign, and left and right are exchanged, as in a body turned round.
    """
    turned = exchange_sides(points)
    np.negative(turned[..., 2], out=turned[..., 2])
    return turned


def mirror_3d(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mirror image of skeletons ``(..., 24, 3)`` in body or camera axes."""
    mirrored = exchange_sides(points)
    np.negative(mirrored[..., 0], out=mirrored[..., 0])
    return mirrored


def mirror_normalised(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mirror image of skeletons ``(..., 24, 2)`` in pixels of the normalised frame."""
    mirrored = exchange_sides(points)
    np.subtract(WIDTH - 1.0, mirrored[..., 0], out=mirrored[..., 0])
    return mirrored


KEYPOINT_SETS = {keypoints.name: keypoints for keypoints in (NATIVE, COCO17, H36M17)}
KEYPOINT_SETS["cmu19"] = NATIVE
"""Sets by name; ``cmu19`` is an alias of ``native``, after the motion capture of its joints."""


def mean_joint_distance(
    points: NDArray[np.float64], others: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Mean distances ``(...)`` between the 19 joints of skeletons ``(..., P, D)``, broadcast."""
    joints = np.s_[..., :JOINTS, :]
    return np.sqrt(squared_lengths(points[joints] - others[joints])).mean(axis=-1)


def squared_lengths(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squared lengths; NumPy is several times slower along axes of length two or three."""
    squares = vectors[..., 0] * vectors[..., 0]
    for axis in range(1, vectors.shape[-1]):
        squares += vectors[..., axis] * vectors[..., axis]
    return squares


def wrap_degrees(angle_deg: ArrayLike) -> NDArray[np.float64]:
    """The same angles in the interval [-180, 180) degrees."""
    return (np.asarray(angle_deg, np.float64) + 180.0) % 360.0 - 180.0


def rotate_clockwise(points_3d: NDArray[np.float64], angle_deg: float) -> NDArray[np.float64]:
    """Rotate points ``(..., 3)`` in camera axes about the optical axis, clockwise as seen."""
    angle = np.deg2rad(angle_deg)
    cosine, sine = np.cos(angle), np.sin(angle)
    rotation = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
    return points_3d @ rotation


def camera_rotation(
    azimuth_deg: ArrayLike, elevation_deg: ArrayLike, roll_deg: ArrayLike = 0.0
) -> NDArray[np.float64]:
    """Rotation from body axes to the axes of a camera that looks at the pelvis.

    Parameters
    ----------
    azimuth_deg : float or (V,) array
        0: in front of the person; 90: at the person's left side.
    elevation_deg : float or (V,) array
        Elevation of the camera above the horizontal.
    roll_deg : float or (V,) array
        Rotation about the optical axis; positive rotates the picture clockwise.

    Returns
    -------
    (3, 3) or (V, 3, 3) float64 array
        ``camera = rotation @ body``.
    """
    azimuth, elevation, roll = np.broadcast_arrays(
        *(np.deg2rad(np.asarray(a, np.float64)) for a in (azimuth_deg, elevation_deg, roll_deg))
    )
    aside, ahead = np.sin(azimuth), np.cos(azimuth)
    up, level = np.sin(elevation), np.cos(elevation)
    right = (ahead, 0.0, -aside)
    down = (up * aside, -level, up * ahead)
    cos, sin = np.cos(roll), np.sin(roll)
    rotation = np.empty((*azimuth.shape, 3, 3))
    for column in range(3):
        rotation[..., 0, column] = cos * right[column] - sin * down[column]
        rotation[..., 1, column] = sin * right[column] + cos * down[column]
    for column, forward in enumerate((level * aside, up, level * ahead)):
        rotation[..., 2, column] = -forward
    return rotation


def project(points: NDArray[np.floating], distance: ArrayLike) -> NDArray[np.float64]:
    """Perspective projection ``(..., P, 2)`` of points, for a camera ``distance`` metres away.

    Points ``(..., P, 3)``, in camera axes and metres about the pelvis, are in front of the camera.
    The result is in metres in the plane through the pelvis, x right and y down.
    """
    points = np.asarray(points, np.float64)
    depth = np.asarray(distance, np.float64)[..., None]
    nearer = depth / (depth + points[..., 2])
    # NumPy is several times slower along axes of length two.
    plane = np.empty((*nearer.shape, 2))
    for axis in range(2):
        np.multiply(points[..., axis], nearer, out=plane[..., axis])
    return plane


def bone_lengths(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths ``(..., 18)`` of the bones of skeletons ``(..., 24, D)``, as in ``NATIVE.bones``."""
    return _bones(points)[0]


def with_bone_lengths(
    points: NDArray[np.float64], lengths: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Set the bone lengths of skeletons ``(..., 24, 3)``, keeping the directions of their bones.

    Averaging skeletons shortens their bones; this restores them. The lengths ``(..., 18)`` are in
    the order of ``NATIVE.bones``. The pelvis is then at the origin; the face moves with the head.
    """
    current, bones = _bones(points)
    bones = bones * (lengths / np.maximum(current, 1e-6))[..., None]
    joints = _PATHS @ bones
    face = points[..., JOINTS:, :] - points[..., _HEAD : _HEAD + 1, :]
    return np.concatenate([joints, joints[..., _HEAD : _HEAD + 1, :] + face], axis=-2)


def with_bone_lengths_of(
    skeleton: NDArray[np.float64], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    return with_bone_lengths(points, bone_lengths(skeleton))


def moved_in_depth(
    points: NDArray[np.float64], offsets: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Skeletons ``(M, 24, 3)``: one ``(24, 3)``, its limbs moved away by ``(M, 12)`` metres.

    Toes move with the ankles, the head with the shoulders, and the spine in between.
    """
    shoulders = offsets[:, LIMB_SHOULDERS].mean(axis=1)
    away = np.repeat(shoulders[:, None], POINTS, axis=1)
    for row, share in enumerate(_TRUNK_SHARES):
        away[:, row] *= share
    away[:, LIMB_ROWS] = offsets
    away[:, _TOES] = away[:, _ANKLES]
    moved = np.repeat(points[None], len(offsets), axis=0)
    moved[..., 2] += away
    return moved


_TRUNK_SHARES = np.arange(3) / 3  # How far pelvis, spine and chest move with the shoulders.
_TOES, _ANKLES = side_rows("toe"), side_rows("ankle")


def pixels_per_metre(
    points_3d: NDArray[np.float64], points_2d: NDArray[np.float64], points: int = JOINTS
) -> NDArray[np.float64]:
    """Scales ``(M,)`` of weak-perspective projections of skeletons, by least squares.

    Of skeletons ``(M, 24, 3)``, in camera axes and metres, and their places ``(M, 24, 2)`` in
    pixels, the leading ``points`` are used, by default the joints.
    """
    metres = points_3d[:, :points, :2] - points_3d[:, :points, :2].mean(axis=1, keepdims=True)
    pixels = points_2d[:, :points]
    pixels = pixels - pixels.mean(axis=1, keepdims=True)
    return (metres * pixels).sum(axis=(1, 2)) / (metres**2).sum(axis=(1, 2))


def _bones(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lengths ``(..., 18)`` of the bones, and vectors ``(..., 18, 3)`` from parent to child."""
    bones = points.take(_CHILDREN, axis=-2) - points.take(_PARENTS, axis=-2)
    return np.sqrt(squared_lengths(bones)), bones


def _paths_from_pelvis() -> NDArray[np.float64]:
    """Which bones lead from the pelvis to each joint: ``(19, 18)`` of 0 and 1."""
    paths = np.zeros((JOINTS, len(NATIVE.bones)))
    for bone, (parent, child) in enumerate(NATIVE.bones):
        paths[child] = paths[parent]
        paths[child, bone] = 1
    return paths


_PARENTS, _CHILDREN = np.array(NATIVE.bones).T
_PATHS = _paths_from_pelvis()
(_HEAD,) = rows("head")
