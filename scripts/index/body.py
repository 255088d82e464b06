"""Avatars: MakeHuman bodies on the CMU skeleton, and how a pose moves them.

Body axes as in :mod:`index.skeleton`, which are MakeHuman's own: x to the person's left,
y up, z forward; metres.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from index.skeleton import FACE_NAMES, JOINT_NAMES
from scripts.index.motion import Clip

BONE_OF_JOINT = {
    "pelvis": "Hips", "spine": "Spine", "chest": "Spine1", "neck": "Neck", "head": "Head",
    "left_shoulder": "LeftArm", "left_elbow": "LeftForeArm", "left_wrist": "LeftHand",
    "right_shoulder": "RightArm", "right_elbow": "RightForeArm", "right_wrist": "RightHand",
    "left_hip": "LeftUpLeg", "left_knee": "LeftLeg", "left_ankle": "LeftFoot",
    "left_toe": "LeftToeBase",
    "right_hip": "RightUpLeg", "right_knee": "RightLeg", "right_ankle": "RightFoot",
    "right_toe": "RightToeBase",
}  # fmt: skip
"""A joint is the start of its bone; the head is the middle of the bone Head."""

INFLUENCES = 8
"""Largest number of bones that move one vertex."""

_FOLLOWS_HAND = ("LThumb", "LeftFingerBase", "LeftHandFinger1", "RThumb", "RightFingerBase",
                 "RightHandFinger1")  # fmt: skip
"""Fingers follow the hand: CMU's hands carry too few markers."""

_UPRIGHT = ("Hips", "LHipJoint", "RHipJoint", "LowerBack", "Spine", "Spine1", "Neck", "Neck1",
            "Head")  # fmt: skip
"""Bones with the same direction in the body's rest pose as in the zero pose of the motion."""


@dataclass(frozen=True)
class Phenotype:
    """Shape of a body in MakeHuman's parameters, all in 0..1.

    ``gender`` 0 male, 1 female; ``age`` 0.33 child, 0.67 young adult, 1 old.
    """

    name: str
    gender: float
    age: float
    muscle: float
    weight: float
    height: float
    proportions: float


@dataclass(frozen=True)
class Avatar:
    """A body in rest pose with its skin weights."""

    name: str
    vertices: NDArray[np.float32]  # (V, 3): rest pose, body axes, metres
    triangles: NDArray[np.int32]  # (T, 3)
    # Number of leading triangles that form closed surfaces: the body before its garments.
    closed: int
    influences: NDArray[np.int32]  # (V, 8): bones that move each vertex
    weights: NDArray[np.float32]  # (V, 8): weight of each of these bones; rows sum to 1
    bones: tuple[str, ...]
    parents: tuple[int, ...]
    heads: NDArray[np.float64]  # (B, 3): start of each bone in rest pose
    tails: NDArray[np.float64]  # (B, 3): end of each bone in rest pose
    # (5, 3): nose, eyes and ears in rest pose; they move with the bone Head.
    face: NDArray[np.float64]

    def __post_init__(self) -> None:
        count = len(self.vertices)
        for name, array, shape in (
            ("vertices", self.vertices, (count, 3)),
            ("influences", self.influences, (count, INFLUENCES)),
            ("weights", self.weights, (count, INFLUENCES)),
            ("heads", self.heads, (len(self.bones), 3)),
            ("tails", self.tails, (len(self.bones), 3)),
            ("face", self.face, (len(FACE_NAMES), 3)),
        ):
            if array.shape != shape:
                raise ValueError(f"expected {name} of shape {shape}, got {array.shape}")


@dataclass(frozen=True)
class BaseMesh:
    """All 19,158 ``hm08`` vertices of one body, helpers included; garments refer to them."""

    vertices: NDArray[np.float64]  # (19158, 3): rest pose, body axes, metres
    dense_weights: NDArray[np.float32]  # (19158, B)
    triangles: NDArray[np.int32]  # (T, 3): the skin, without helpers


@lru_cache(maxsize=1)
def body_model() -> Any:
    """Return Anny's model of bodies on the CMU skeleton."""
    import anny

    return anny.Anny(rig="cmu_mb", topology="anny-full", skinning_method="lbs")


@lru_cache
def keypoint_weights(names: tuple[str, ...]) -> NDArray[np.float64]:
    """Return the weights ``(K, 19158)`` of the vertices whose sum is a COCO keypoint."""
    import anny.keypoints

    regressor = anny.keypoints.KeypointsRegressor.coco(body_model(), labels=list(names))
    weights = {name: value.numpy() for name, value in regressor.named_buffers()}
    if "regression_indices" not in weights:
        return np.asarray(weights["regression_weights"], np.float64)
    dense = np.zeros((len(names), len(body_model().template_vertices)))
    np.put_along_axis(dense, weights["regression_indices"], weights["regression_weights"], axis=1)
    return dense


def make_avatar(phenotype: Phenotype) -> tuple[Avatar, BaseMesh]:
    """Make the unclothed avatar of a phenotype, and the base mesh that garments are fitted to."""
    import torch

    model = body_model()
    values = {
        name: torch.tensor([getattr(phenotype, name)], dtype=torch.float64)
        for name in model.phenotype_labels
    }
    rest = model.get_rest_model(model.get_phenotype_blendshape_coefficients(**values))
    vertices = _to_body_axes(rest["rest_vertices"][0].numpy())
    heads = _to_body_axes(rest["rest_bone_heads"][0].numpy())
    tails = _to_body_axes(rest["rest_bone_tails"][0].numpy())
    bones = tuple(model.bone_labels)
    weights = np.zeros((len(vertices), len(bones)), np.float32)
    np.add.at(
        weights,
        (np.arange(len(vertices))[:, None], model.vertex_bone_indices.numpy()),
        model.vertex_bone_weights.numpy(),
    )
    base = BaseMesh(vertices, weights, model.get_triangular_faces().numpy().astype(np.int32))
    influences, kept = strongest(weights)
    avatar = Avatar(
        name=phenotype.name,
        vertices=vertices.astype(np.float32),
        triangles=base.triangles,
        closed=len(base.triangles),
        influences=influences,
        weights=kept,
        bones=bones,
        parents=tuple(model.bone_parents),
        heads=heads,
        tails=tails,
        face=keypoint_weights(FACE_NAMES) @ vertices,
    )
    return compact(avatar), base


def compact(avatar: Avatar) -> Avatar:
    """Return the same avatar without the vertices that no triangle uses."""
    used, triangles = np.unique(avatar.triangles, return_inverse=True)
    return replace(
        avatar,
        vertices=avatar.vertices[used],
        triangles=triangles.reshape(-1, 3).astype(np.int32),
        influences=avatar.influences[used],
        weights=avatar.weights[used],
    )


def strongest(weights: NDArray[np.float32]) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Dense weights ``(V, B)`` to the 8 strongest bones of each vertex and their shares."""
    influences = np.argsort(-weights, axis=1, kind="stable")[:, :INFLUENCES]
    kept = np.take_along_axis(weights, influences, axis=1)
    return influences.astype(np.int32), (kept / kept.sum(axis=1, keepdims=True)).astype(np.float32)


def _to_body_axes(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """From Anny's axes (z up, facing -y) to body axes."""
    return np.stack([points[:, 0], points[:, 2], -points[:, 1]], axis=1)


@dataclass(frozen=True)
class Retargeting:
    """How the bones of a clip drive those of an avatar.

    ``source`` ``(B,)`` are the bones of the clip that turn those of the avatar, ``alignment`` ``(B,
    3, 3)`` rotations from the avatar's rest pose to the zero pose of the motion.
    """

    source: NDArray[np.int64]
    alignment: NDArray[np.float64]


def retarget(clip: Clip, avatar: Avatar) -> Retargeting:
    """Match bones by name and rest poses by bone direction.

    Raises
    ------
    MotionError
        If the clip lacks a bone that the avatar needs.
    """
    source = np.zeros(len(avatar.bones), np.int64)
    alignment = np.tile(np.eye(3), (len(avatar.bones), 1, 1))
    for bone, name in enumerate(avatar.bones):
        driver = name
        if name in _FOLLOWS_HAND:
            driver = "LeftHand" if name.startswith("L") else "RightHand"
        source[bone] = clip.bone(driver)
        if name in _UPRIGHT:
            continue
        tip = clip.tips[source[bone]]
        if not tip.any():
            # Some clips give the toes no length; they then follow the foot.
            alignment[bone] = alignment[avatar.parents[bone]]
            continue
        leader = avatar.bones.index(driver)
        alignment[bone] = rotation_between(avatar.tails[leader] - avatar.heads[leader], tip)
    return Retargeting(source, alignment)


def rotation_between(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """Find the smallest rotation ``(3, 3)`` that turns one direction into another."""
    a, b = start / np.linalg.norm(start), end / np.linalg.norm(end)
    axis, cosine = np.cross(a, b), float(a @ b)
    if cosine < -1 + 1e-9:
        raise ValueError("expected two directions less than 180 degrees apart")
    x, y, z = axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + skew + skew @ skew / (1 + cosine), np.float64)


def facing_yaw(pelvis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn about the vertical, in radians ``(F,)``, of pelvis rotations ``(F, 3, 3)``.

    Both the forward and the left axis of the pelvis vote, so that a person bent over or
    lying on a side still faces somewhere.
    """
    forward, left = pelvis[..., :, 2], pelvis[..., :, 0]
    return np.arctan2(forward[..., 0] - left[..., 2], forward[..., 2] + left[..., 0])


def turned_to_front(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """World rotations ``(F, B, 3, 3)``, root first, turned so that the pelvis faces +z."""
    return about_vertical(-facing_yaw(rotations[:, 0]))[:, None] @ rotations


def about_vertical(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotations ``(F, 3, 3)`` by angles ``(F,)`` in radians about y, from z towards x."""
    cosine, sine = np.cos(angle), np.sin(angle)
    zero, one = np.zeros_like(angle), np.ones_like(angle)
    return np.stack(
        [
            np.stack([cosine, zero, sine], -1),
            np.stack([zero, one, zero], -1),
            np.stack([-sine, zero, cosine], -1),
        ],
        axis=-2,
    )


def pose_transforms(
    avatar: Avatar, retargeting: Retargeting, rotations: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Transforms ``(F, B, 3, 4)`` of the bones from rest pose to posed body axes, pelvis at 0.

    ``rotations`` ``(F, B', 3, 3)`` are the world rotations of the clip's bones.
    """
    linear = rotations[:, retargeting.source] @ retargeting.alignment
    starts = np.zeros((len(rotations), len(avatar.bones), 3))
    for bone, parent in enumerate(avatar.parents):
        if parent >= 0:
            offset = avatar.heads[bone] - avatar.heads[parent]
            starts[:, bone] = starts[:, parent] + linear[:, parent] @ offset
    shift = starts - np.einsum("fbij,bj->fbi", linear, avatar.heads)
    return np.concatenate([linear, shift[..., None]], axis=-1)


def posed_points(avatar: Avatar, transforms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Joints and face of posed bodies ``(F, 24, 3)``: body axes, metres, pelvis at 0."""
    bones = [avatar.bones.index(BONE_OF_JOINT[name]) for name in JOINT_NAMES]
    rest = avatar.heads[bones].copy()
    head = JOINT_NAMES.index("head")
    rest[head] = (avatar.heads[bones[head]] + avatar.tails[bones[head]]) / 2
    rest = np.concatenate([rest, avatar.face])
    moved_by = transforms[:, [*bones, *[bones[head]] * len(FACE_NAMES)]]
    return np.einsum("fpij,pj->fpi", moved_by[..., :3], rest) + moved_by[..., 3]
