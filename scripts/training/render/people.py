"""Bodies with parts that have materials of their own, and where their landmarks are."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from app.vision.people import LANDMARK_NAMES
from index.skeleton import COCO17
from scripts.index.body import Avatar, BaseMesh, Phenotype, keypoint_weights, make_avatar, strongest
from scripts.index.garments import find_garments, layers_of, read_garment
from scripts.training.render.materials import (
    HAIRS,
    PLAIN,
    PRINT,
    SKINS,
    STRANDS,
    Material,
    Materials,
    cloth,
)

PARTS = ("skin", "eyes", "mouth", "brows", "top", "bottom", "shoes", "hair", "hat")
SKIN, EYES, MOUTH, BROWS, TOP, BOTTOM, SHOES, HAIR, HAT = range(len(PARTS))

MIRRORED = np.array(
    [
        LANDMARK_NAMES.index(
            name.replace("left", "?").replace("right", "left").replace("?", "right")
        )
        for name in LANDMARK_NAMES
    ]
)
"""Row of the landmark on the other side."""

SEAT_BONES = ("Hips", "LHipJoint", "RHipJoint", "LeftUpLeg", "RightUpLeg")


@dataclass(frozen=True)
class Person:
    """A body in clothes, in rest pose; the avatar has its bones.

    Vertices ``(V, 3)`` have influences and weights ``(V, 8)``, and positions in :data:`PARTS`. A
    posed landmark is the sum over bones of ``transform @ landmarks[row, bone]``. ``seat`` are
    vertices of the pelvis and the upper thighs; ``head`` ``(V,)`` tells those of head and neck.
    """

    avatar: Avatar
    vertices: NDArray[np.float32]
    triangles: NDArray[np.int32]
    influences: NDArray[np.int32]
    weights: NDArray[np.float32]
    parts: NDArray[np.int32]
    landmarks: NDArray[np.float64]
    seat: NDArray[np.int64]
    head: NDArray[np.bool_]


@dataclass(frozen=True)
class Outfit:
    """What a person wears: garments by name, and clothes painted on the skin."""

    garments: tuple[str, ...] = ()
    painted: bool = False
    long_sleeves: bool = True
    long_legs: bool = True
    topless: bool = False
    barefoot: bool = False


def dressed(phenotype: Phenotype, outfit: Outfit, garments: Path) -> Person:
    """Make a person.

    Raises
    ------
    GarmentError
        If a garment is missing or malformed.
    """
    avatar, base = make_avatar(phenotype)
    files = find_garments(garments)
    worn = [read_garment(files[name]) for name in outfit.garments]
    vertices, weights, triangles = layers_of(base, worn)
    bare_headed = not any(_is_hair(name) for name in outfit.garments)
    parts = [_skin_parts(avatar, base, outfit, bare_headed)]
    hips = float(avatar.heads[avatar.bones.index("Hips")][1])
    for garment, fitted in zip(worn, vertices[1:], strict=True):
        parts.append(_garment_parts(garment.name, fitted, garment.triangles, hips))
    used, corners = np.unique(np.concatenate(triangles), return_inverse=True)
    all_weights = np.concatenate(weights)[used]
    influences, kept = strongest(all_weights)
    leading = np.array(avatar.bones)[influences[:, 0]]
    return Person(
        avatar,
        np.ascontiguousarray(np.concatenate(vertices)[used], np.float32),
        np.ascontiguousarray(corners.reshape(-1, 3), np.int32),
        influences,
        kept,
        np.concatenate(parts)[used],
        _landmark_weights(avatar, base),
        np.flatnonzero(np.isin(leading, SEAT_BONES)),
        np.isin(leading, ("Neck", "Neck1", "Head")),
    )


def _is_hair(name: str) -> bool:
    return name.startswith(("afro", "bob", "long", "ponytail", "short", "fedora"))


def _skin_parts(
    avatar: Avatar, base: BaseMesh, outfit: Outfit, bare_headed: bool
) -> NDArray[np.int32]:
    """Parts of the base mesh: a face, painted clothes, short hair where nothing else is worn."""
    leading = np.array(avatar.bones)[base.dense_weights.argmax(axis=1)]
    parts = np.full(len(base.vertices), SKIN, np.int32)
    if outfit.painted:
        sleeves = ("LeftForeArm", "RightForeArm") if outfit.long_sleeves else ()
        legs = ("LeftLeg", "RightLeg") if outfit.long_legs else ()
        torso = ("LowerBack", "Spine", "Spine1", "LeftShoulder", "RightShoulder", "LeftArm",
                 "RightArm")  # fmt: skip
        parts[np.isin(leading, (*SEAT_BONES, *legs))] = BOTTOM
        if not outfit.topless:
            parts[np.isin(leading, (*torso, *sleeves))] = TOP
        if not outfit.barefoot:
            feet = ("LeftFoot", "RightFoot", "LeftToeBase", "RightToeBase")
            parts[np.isin(leading, feet)] = SHOES
    nose, left_eye, right_eye = avatar.face[:3]
    for eye in (left_eye, right_eye):
        away = base.vertices - eye
        near = np.abs(away[:, 2]) < 0.05
        parts[(np.linalg.norm(away[:, :2] * [1, 1.6], axis=1) < 0.017) & near] = EYES
        brow = (np.abs(away[:, 0]) < 0.022) & (away[:, 1] > 0.016) & (away[:, 1] < 0.027)
        parts[brow & near] = BROWS
    away = base.vertices - nose
    mouth = (np.abs(away[:, 0]) < 0.024) & (away[:, 1] < -0.028) & (away[:, 1] > -0.044)
    parts[mouth & (np.abs(away[:, 2]) < 0.05)] = MOUTH
    if bare_headed:
        behind = np.clip(left_eye[2] - 0.05 - base.vertices[:, 2], 0, 0.12)
        scalp = base.vertices[:, 1] > left_eye[1] + 0.035 - 0.9 * behind
        parts[(leading == "Head") & scalp & (parts == SKIN)] = HAIR
    return parts


def _garment_parts(
    name: str, vertices: NDArray[np.float64], triangles: NDArray[np.int32], hips: float
) -> NDArray[np.int32]:
    """Top and bottom of a suit, piece by piece; one part for all else."""
    if "suit" not in name:
        part = SHOES if name.startswith("shoes") else HAT if name.startswith("fedora") else HAIR
        return np.full(len(vertices), part, np.int32)
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(edges)), edges.T), (len(vertices),) * 2)
    pieces, piece_of = connected_components(graph, directed=False)
    parts = np.full(len(vertices), TOP, np.int32)
    heights = vertices[:, 1]
    for piece in range(pieces):
        rows = piece_of == piece
        low, high, mean = heights[rows].min(), heights[rows].max(), heights[rows].mean()
        if rows.sum() >= 30 and low < hips - 0.25 and high > hips + 0.25:
            # One piece from leg to chest: a belt parts it.
            parts[rows] = np.where(heights[rows] > hips + 0.06, TOP, BOTTOM)
        else:
            parts[rows] = TOP if mean > hips else BOTTOM
    return parts


def _landmark_weights(avatar: Avatar, base: BaseMesh) -> NDArray[np.float64]:
    """See :class:`Person`: regressed from the skin, or points that bones carry."""
    weights = np.zeros((len(LANDMARK_NAMES), len(avatar.bones), 4))
    homogeneous = np.hstack([base.vertices, np.ones((len(base.vertices), 1))])
    regressor = keypoint_weights(COCO17.names)
    for row, name in enumerate(COCO17.names):
        used = np.flatnonzero(np.abs(regressor[row]) > 1e-9)
        shares = regressor[row, used][:, None] * base.dense_weights[used]
        weights[LANDMARK_NAMES.index(name)] = shares.T @ homogeneous[used]

    def carried(name: str, bone: str, place: NDArray[np.float64]) -> None:
        weights[LANDMARK_NAMES.index(name), avatar.bones.index(bone)] = [*place, 1.0]

    nose, left_eye, right_eye = avatar.face[:3]
    apart = (left_eye - right_eye) * np.array([1.0, 0.0, 0.0])
    leading = base.dense_weights.argmax(axis=1)
    for side, letter, eye, sign in (("left", "L", left_eye, 1), ("right", "R", right_eye, -1)):
        carried(f"{side}_eye_inner", "Head", eye - sign * 0.2 * apart)
        carried(f"{side}_eye_outer", "Head", eye + sign * 0.2 * apart)
        carried(f"mouth_{side}", "Head", nose + np.array([sign * 0.024, -0.037, -0.015]))
        title = side.title()
        for finger, bone in (
            ("thumb", f"{letter}Thumb"),
            ("index", f"{title}HandFinger1"),
            ("pinky", f"{title}FingerBase"),
        ):
            carried(f"{side}_{finger}", bone, avatar.tails[avatar.bones.index(bone)])
        foot = avatar.bones.index(f"{title}Foot")
        sole = base.vertices[leading == foot]
        heel = sole[sole[:, 2] < np.quantile(sole[:, 2], 0.05)].mean(axis=0)
        carried(f"{side}_heel", f"{title}Foot", heel)
        toe = f"{title}ToeBase"
        carried(f"{side}_foot_index", toe, avatar.tails[avatar.bones.index(toe)])
    return weights


def posed_landmarks(person: Person, transforms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Landmarks ``(33, 3)`` of a body moved by bones' transforms ``(B, 3, 4)``."""
    return np.asarray(np.einsum("bij,lbj->li", transforms, person.landmarks))


def person_materials(materials: Materials, generator: Generator) -> NDArray[np.int32]:
    """Add skin, hair and clothes of any colour; returns the row of each of :data:`PARTS`."""
    skin = SKINS[generator.integers(len(SKINS))] * generator.uniform(0.8, 1.2)
    hair = HAIRS[generator.integers(len(HAIRS))] * generator.uniform(0.6, 1.4)
    top, bottom = cloth(generator), cloth(generator)
    if generator.random() < 0.12:
        bottom = top
    if bottom.kind == PRINT:
        bottom = Material(bottom.colour, bottom.other, PLAIN, wrinkles=bottom.wrinkles)
    shoes, hat = cloth(generator), cloth(generator)
    strands = Material(hair, hair * 0.5, STRANDS, float(generator.uniform(4, 20)), wrinkles=0.3)
    rows = [
        Material(skin, skin, gloss=float(generator.uniform(0.01, 0.06))),
        Material(skin * 0.15, skin, gloss=0.2),
        Material(skin * [0.75, 0.4, 0.4], skin, gloss=0.1),
        Material(hair * 0.6 + skin * 0.2, skin),
        top,
        bottom,
        Material(shoes.colour * 0.7, shoes.other, gloss=0.08),
        strands,
        hat,
    ]
    return np.array([materials.add(row) for row in rows], np.int32)


AGES = (0.08, 0.2, 0.33, 0.45, 0.6, 0.67, 0.72, 0.72, 0.8, 0.8, 0.9, 0.9, 0.98)
"""Ages drawn from, as :class:`scripts.index.body.Phenotype` has them: 0 newborn, 0.33 child."""


def cast(count: int, seed: int, garments: Path, *, held_out: bool) -> list[Person]:
    """Make people of any build in any clothes; held-out people wear garments of their own."""
    generator = np.random.default_rng([seed, int(held_out)])
    names = sorted(find_garments(garments))
    suits = split_of([name for name in names if "suit" in name], held_out)
    shoes = split_of([name for name in names if name.startswith("shoes")], held_out)
    hair = split_of(
        [name for name in names if _is_hair(name) and not name.startswith("fedora")], held_out
    )
    hats = [name for name in names if name.startswith("fedora")]
    people = []
    for number in range(count):
        female = number % 2 == 1
        phenotype = Phenotype(
            f"photographed-{seed}-{number}",
            float(np.clip((0.95 if female else 0.05) + generator.normal(0, 0.03), 0, 1)),
            float(generator.choice(AGES)),
            float(generator.uniform(0.3, 0.85)),
            float(generator.uniform(0.25, 0.85)),
            float(np.clip(0.36 + generator.normal(0, 0.08), 0.15, 0.75)),
            float(generator.uniform(0.3, 0.9)),
        )
        fitting = [suit for suit in suits if suit.startswith("female") == female]
        worn = []
        painted = generator.random() < 0.3
        if not painted:
            worn = [generator.choice(fitting), generator.choice(shoes)]
        elif generator.random() < 0.6:
            worn = [generator.choice(shoes)]
        chance = generator.random()
        if chance < 0.62:
            worn.append(generator.choice(hair))
        elif chance < 0.68:
            worn.append(generator.choice(hats))
        outfit = Outfit(
            tuple(str(name) for name in worn),
            painted,
            bool(generator.random() < 0.45),
            bool(generator.random() < 0.65),
            bool(generator.random() < 0.15),
            bool(generator.random() < 0.3),
        )
        people.append(dressed(phenotype, outfit, garments))
    return people


def split_of(names: Sequence[str], held_out: bool) -> list[str]:
    """Names of the held-out part, every fifth from the second, or of the rest.

    Where a part would be short, as of suits by gender, it is made of two of each.
    """
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(name.split("_")[0] if "suit" in name else "", []).append(name)
    chosen = []
    for members in groups.values():
        kept = members[1::5] or members[-1:]
        chosen += kept if held_out else [name for name in members if name not in kept]
    return chosen
