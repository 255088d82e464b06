"""A small body on a small skeleton, and clips that move it."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scripts.index.body import INFLUENCES, Avatar
from scripts.index.motion import METRES_PER_UNIT

# Bone, its parent, where it starts from there (metres; BVH files have CMU's unit).
# The zero pose of CMU's clips: arms straight out, legs a little apart.
SKELETON = (
    ("Hips", None, (0.0, 0.0, 0.0)),
    ("LHipJoint", "Hips", (0.0, 0.0, 0.0)),
    ("LeftUpLeg", "LHipJoint", (0.09, -0.04, 0.0)),
    ("LeftLeg", "LeftUpLeg", (0.14, -0.38, 0.0)),
    ("LeftFoot", "LeftLeg", (0.14, -0.38, 0.0)),
    ("LeftToeBase", "LeftFoot", (0.01, -0.04, 0.13)),
    ("RHipJoint", "Hips", (0.0, 0.0, 0.0)),
    ("RightUpLeg", "RHipJoint", (-0.09, -0.04, 0.0)),
    ("RightLeg", "RightUpLeg", (-0.14, -0.38, 0.0)),
    ("RightFoot", "RightLeg", (-0.14, -0.38, 0.0)),
    ("RightToeBase", "RightFoot", (-0.01, -0.04, 0.13)),
    ("Spine", "Hips", (0.0, 0.12, 0.0)),
    ("Spine1", "Spine", (0.0, 0.15, 0.0)),
    ("Neck", "Spine1", (0.0, 0.22, 0.0)),
    ("Head", "Neck", (0.0, 0.08, 0.01)),
    ("LeftArm", "Spine1", (0.17, 0.18, 0.0)),
    ("LeftForeArm", "LeftArm", (0.28, 0.0, 0.0)),
    ("LeftHand", "LeftForeArm", (0.25, 0.0, 0.0)),
    ("RightArm", "Spine1", (-0.17, 0.18, 0.0)),
    ("RightForeArm", "RightArm", (-0.28, 0.0, 0.0)),
    ("RightHand", "RightForeArm", (-0.25, 0.0, 0.0)),
)
BONES = tuple(name for name, _, _ in SKELETON)
TIPS = {
    "Head": (0.0, 0.2, 0.0),
    "LeftHand": (0.12, 0.0, 0.0),
    "RightHand": (-0.12, 0.0, 0.0),
    "LeftToeBase": (0.0, 0.0, 0.06),
    "RightToeBase": (0.0, 0.0, 0.06),
}
"""Where bones without children end."""

Angles = dict[str, tuple[float, float, float]]
"""Degrees about z, y and x by bone; bones left out stay in the zero pose."""


def _offset(metres: tuple[float, float, float]) -> str:
    return "OFFSET {} {} {}".format(*np.divide(metres, METRES_PER_UNIT))


def bvh_text(frames: Sequence[Angles], step: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> str:
    """A BVH file of the skeleton, rotation order ZYX, 30 frames a second.

    The pelvis moves by ``step`` a frame, in file units.
    """

    def joint(name: str) -> list[str]:
        offset = next(o for n, _, o in SKELETON if n == name)
        children = [n for n, parent, _ in SKELETON if parent == name]
        places = "6 Xposition Yposition Zposition" if name == "Hips" else "3"
        lines = [
            f"{'ROOT' if name == 'Hips' else 'JOINT'} {name}",
            "{",
            _offset(offset),
            f"CHANNELS {places} Zrotation Yrotation Xrotation",
            *(line for child in children for line in joint(child)),
        ]
        if not children:
            lines += ["End Site", "{", _offset(TIPS[name]), "}"]
        return [*lines, "}"]

    hierarchy = joint("Hips")
    order = [line.split()[1] for line in hierarchy if line.startswith(("ROOT", "JOINT"))]
    rows = [
        " ".join(
            f"{v:.5f}"
            for values in (np.multiply(number, step), *(frame.get(n, (0, 0, 0)) for n in order))
            for v in values
        )
        for number, frame in enumerate(frames)
    ]
    motion = ["MOTION", f"Frames: {len(frames)}", "Frame Time: 0.0333333", *rows]
    return "\n".join(["HIERARCHY", *hierarchy, *motion, ""])


def stride(phase: float, lift: float = 0.0) -> Angles:
    """A walking person, arms hanging and swinging; ``lift`` degrees raise the left arm."""
    swing = 30 * np.sin(phase)
    return {
        "Hips": (0.0, 10 * np.sin(phase), 0.0),
        "LeftArm": (-75 + lift, 0.0, swing),
        "RightArm": (75.0, 0.0, -swing),
        "LeftForeArm": (0.0, -40.0, 0.0),
        "RightForeArm": (0.0, 40.0, 0.0),
        "LeftUpLeg": (-15.0, 0.0, -swing),
        "RightUpLeg": (15.0, 0.0, swing),
        "LeftLeg": (0.0, 0.0, 40 + swing),
        "RightLeg": (0.0, 0.0, 40 - swing),
        "Spine": (0.0, 0.0, 10.0),
        "Head": (0.0, 20.0, 0.0),
    }


def walk(frames: int, lift: float = 0.0) -> list[Angles]:
    """Frames of :func:`stride`, a stride a second."""
    return [stride(2 * np.pi * frame / 30, lift * frame / frames) for frame in range(frames)]


def write_clip(
    file: Path, frames: Sequence[Angles], step: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Path:
    """Write a clip and make its folder."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(bvh_text(frames, step))
    return file


def box_between(
    start: NDArray[np.float64], end: NDArray[np.float64], half: float
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """A closed box ``half`` thick about a line: ``(8, 3)`` corners and ``(12, 3)`` triangles.

    Triangles turn counter-clockwise seen from outside.
    """
    along = (end - start) / np.linalg.norm(end - start)
    side = np.cross(along, [0.0, 0.0, 1.0] if abs(along[2]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    third = np.cross(along, side)
    ring = [half * (a * side + b * third) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    corners = np.array(
        [start - half * along + r for r in ring] + [end + half * along + r for r in ring]
    )
    quads = [(0, 3, 2, 1), (4, 5, 6, 7)]
    quads += [(k, (k + 1) % 4, 4 + (k + 1) % 4, 4 + k) for k in range(4)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return corners, np.array(triangles, np.int32)


def box_avatar(name: str = "box", build: float = 1.0, stature: float = 1.0) -> Avatar:
    """A body of one box per bone, each moved by its bone alone.

    Its rest pose is not the zero pose of the clips: the arms hang down at 45 degrees, as
    MakeHuman's do.
    """
    rest: dict[str, NDArray[np.float64]] = {}
    hang = np.sqrt(0.5)
    for bone, parent, offset in SKELETON:
        step = stature * np.array(offset)
        if "ForeArm" in bone or "Hand" in bone:
            step = np.array([step[0] * hang, -abs(step[0]) * hang, 0.0])
        rest[bone] = step if parent is None else rest[parent] + step
    children = {bone: [n for n, parent, _ in SKELETON if parent == bone] for bone in BONES}
    tails = {}
    for bone in BONES:
        tip = stature * np.array(TIPS.get(bone, (0.0, 0.0, 0.0)))
        if "Hand" in bone:
            tip = np.array([tip[0] * hang, -abs(tip[0]) * hang, 0.0])
        tails[bone] = rest[children[bone][0]] if children[bone] else rest[bone] + tip
    tails["Hips"] = rest["Spine"]
    parts, triangles, owners = [], [], []
    for number, bone in enumerate(BONES):
        if np.linalg.norm(tails[bone] - rest[bone]) == 0:
            continue
        half = build * (0.09 if bone in ("Hips", "Spine", "Spine1", "Head") else 0.04)
        corners, faces = box_between(rest[bone], tails[bone], half)
        triangles.append(faces + 8 * len(parts))
        parts.append(corners)
        owners += [number] * 8
    weights = np.zeros((len(owners), INFLUENCES), np.float32)
    weights[:, 0] = 1
    face = rest["Head"] + np.array(
        [[0, 0.1, 0.1], [0.03, 0.12, 0.09], [-0.03, 0.12, 0.09], [0.09, 0.1, 0], [-0.09, 0.1, 0]]
    )
    return Avatar(
        name=name,
        vertices=np.concatenate(parts).astype(np.float32),
        triangles=np.concatenate(triangles).astype(np.int32),
        closed=sum(len(t) for t in triangles),
        influences=np.repeat(np.array(owners, np.int32)[:, None], INFLUENCES, axis=1),
        weights=weights,
        bones=BONES,
        parents=tuple(-1 if parent is None else BONES.index(parent) for _, parent, _ in SKELETON),
        heads=np.array([rest[bone] for bone in BONES]),
        tails=np.array([tails[bone] for bone in BONES]),
        face=face,
    )
