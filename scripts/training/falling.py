"""Falls by physics: the humanoid of dm_control, whose joints are CMU's, loses its muscle tone.

A fall begins in a frame of a clip, with the clip's motion, so what comes before it is recorded and
what follows is simulated (MuJoCo, 0.4 core seconds a fall). World axes: y up, metres.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scripts.index.motion import Clip

FPS = 30
"""Of clips and of the falls."""

FallKind = Literal["faint", "trip", "slip", "push", "knee", "seat", "wall", "bed", "drop"]
FALLS: tuple[FallKind, ...] = ("faint", "trip", "slip", "push", "knee", "seat", "wall", "bed")
"""Ways to the ground; a ``drop`` leads onto a bed or a sofa, which is daily life."""

BONE_OF_BODY = {
    "root": "Hips", "lhipjoint": "LHipJoint", "lfemur": "LeftUpLeg", "ltibia": "LeftLeg",
    "lfoot": "LeftFoot", "ltoes": "LeftToeBase", "rhipjoint": "RHipJoint",
    "rfemur": "RightUpLeg", "rtibia": "RightLeg", "rfoot": "RightFoot", "rtoes": "RightToeBase",
    "lowerback": "LowerBack", "upperback": "Spine", "thorax": "Spine1", "lowerneck": "Neck",
    "upperneck": "Neck1", "head": "Head", "lclavicle": "LeftShoulder", "lhumerus": "LeftArm",
    "lradius": "LeftForeArm", "lhand": "LeftHand", "rclavicle": "RightShoulder",
    "rhumerus": "RightArm", "rradius": "RightForeArm", "rhand": "RightHand",
}  # fmt: skip
"""Bodies of the humanoid and bones of the clips; the zero poses of both are the same."""

# From the clips' axes (y up) to MuJoCo's (z up).
_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_TIMESTEP_S = 0.002
# Heights of seats and beds, metres.
_SEAT_M, _BED_M = (0.38, 0.5), (0.3, 0.6)


@dataclass(frozen=True)
class Fall:
    """World rotations ``(F, B, 3, 3)`` of a clip's bones, and positions ``(F, 3)`` of the pelvis.

    ``down`` is the frame from which the body is on the ground; ``ends_down`` says whether it stays,
    ``ends_on`` whether it stays on the support instead.
    """

    rotations: NDArray[np.float64]
    positions: NDArray[np.float64]
    down: int
    ends_down: bool
    ends_on: bool


def humanoid() -> Path:
    """The file of the humanoid in dm_control, which is not imported."""
    spec = importlib.util.find_spec("dm_control")
    if spec is None or not spec.submodule_search_locations:
        raise ModuleNotFoundError("expected dm_control and mujoco: install the extra 'training'")
    folder = Path(next(iter(spec.submodule_search_locations)))
    return folder / "locomotion" / "walkers" / "assets" / "humanoid_CMU_V2020.xml"


class _Support(NamedTuple):
    """A seat, bed or wall that carries or stops a body: a box, half sizes and metres, z up."""

    half: tuple[float, float, float]
    place: tuple[float, float, float]
    yaw: float

    @property
    def top(self) -> float:
        """Height of its upper side."""
        return self.place[2] + self.half[2]


@lru_cache(maxsize=1)
def _alone() -> Any:
    """The humanoid over a floor."""
    return _model(None)


def _model(support: _Support | None) -> Any:
    """The humanoid over a floor, with what carries or stops it."""
    import mujoco

    spec = mujoco.MjSpec.from_file(str(humanoid()))
    spec.body("root").add_freejoint()
    spec.option.timestep = _TIMESTEP_S
    floor = spec.worldbody.add_geom()
    floor.type, floor.size = mujoco.mjtGeom.mjGEOM_PLANE, [30, 30, 0.1]
    things = [floor]
    if support is not None:
        box = spec.worldbody.add_geom()
        box.type, box.size, box.pos = mujoco.mjtGeom.mjGEOM_BOX, support.half, support.place
        box.quat = [np.cos(support.yaw / 2), 0, 0, np.sin(support.yaw / 2)]
        things.append(box)
    for thing in things:
        thing.condim, thing.priority, thing.friction = 3, 2, [0.7, 0.005, 0.0001]
    return spec.compile()


def fall_from(
    clip: Clip, frame: int, kind: FallKind, generator: Generator, seconds: float = 4.0
) -> Fall:
    """Let the body of a clip's frame fall in a way.

    It keeps the motion of the clip and is pushed, tripped or slips; joints are springs about the
    pose in which it falls, softer the less tone is left, and some people reach out with the arms.
    """
    import mujoco

    before = max(frame - 1, 0)
    start, ahead = (_posed(_alone(), clip, row) for row in (before, frame))
    velocity = np.zeros(_alone().nv)
    if frame > before:
        mujoco.mj_differentiatePos(_alone(), velocity, 1 / FPS, start, ahead)
    position, support = _placed(ahead, kind, generator)
    model = _model(support)
    data = mujoco.MjData(model)
    data.qpos[:] = position
    data.qvel[:] = np.clip(velocity, -4, 4)
    _disturb(data, kind, support, generator)
    tone = float(np.exp(generator.uniform(np.log(0.02), np.log(0.6))))
    hinges = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)
    names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, row) for row in hinges]
    stiffness = np.full(len(hinges), 40 * tone)
    spring = data.qpos.copy()
    if kind == "knee":
        weak = generator.choice(["l", "r"])
        for row, name in enumerate(names):
            if name.startswith((f"{weak}tibia", f"{weak}femur")):
                stiffness[row] = 0.2
    if generator.random() < 0.4:
        # The hands reach out.
        for row, (joint, name) in enumerate(zip(hinges, names, strict=True)):
            if name.endswith("humerusrz"):
                spring[model.jnt_qposadr[joint]] = generator.uniform(-0.6, 0.6)
                stiffness[row] = 40 * max(tone, 0.3)
    model.qpos_spring[:] = spring
    model.jnt_stiffness[hinges] = stiffness
    model.dof_damping[model.jnt_dofadr[hinges]] = 2 + 6 * tone
    bodies = {
        name: mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) for name in BONE_OF_BODY
    }
    per_frame = round(1 / FPS / _TIMESTEP_S)
    frames = round(seconds * FPS)
    rotations = np.repeat(clip.rotations[frame : frame + 1], frames, axis=0)
    positions, tops = np.empty((frames, 3)), np.empty(frames)
    rest = _rest(model)
    for row in range(frames):
        for _ in range(per_frame):
            mujoco.mj_step(model, data)
        for name, body in bodies.items():
            turned = data.xmat[body].reshape(3, 3) @ rest[body].T
            rotations[row, clip.bone(BONE_OF_BODY[name])] = _Z_UP.T @ turned
        positions[row] = _Z_UP.T @ data.xpos[bodies["root"]]
        trunk = [data.xpos[bodies[name]][2] for name in ("root", "thorax", "head")]
        tops[row] = max(trunk)
    _follow_hands(clip, rotations)
    low = tops < 0.55
    if kind in ("seat", "bed"):
        low &= positions[:, 1] < 0.25  # Of low beds, not on them.
    down = int(np.argmax(low)) if low.any() else frames
    over = positions[-FPS:, 1] - (support.top if support is not None else np.inf)
    ends_on = bool(((over > -0.05) & (over < 0.4)).all())
    stable = not any(warning.number for warning in data.warning)
    return Fall(rotations, positions, down, stable and bool(low[-FPS:].all()), stable and ends_on)


def _rest(model: Any) -> NDArray[np.float64]:
    """World rotations ``(bodies, 3, 3)`` of the zero pose, in the axes of the clips."""
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    mujoco.mj_forward(model, data)
    return np.array(data.xmat.reshape(-1, 3, 3))


def _posed(model: Any, clip: Clip, frame: int) -> NDArray[np.float64]:
    """Positions of all joints in a frame of a clip; its heading and place are kept."""
    import mujoco

    rest, position = _rest(model), model.qpos0.copy()
    rotations = clip.rotations[frame]
    bones = {name: rotations[clip.bone(bone)] for name, bone in BONE_OF_BODY.items()}
    root = _Z_UP @ bones["root"]
    position[:3] = _Z_UP @ clip.positions[frame]
    position[3:7] = Rotation.from_matrix(root).as_quat(scalar_first=True)
    for body in range(model.nbody):
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body)
        joints = [
            joint
            for joint in range(model.njnt)
            if model.jnt_bodyid[joint] == body
            and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
        ]
        parent = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, model.body_parentid[body])
        if not joints or name not in bones or parent not in bones:
            continue
        local = rest[body].T @ bones[parent].T @ bones[name] @ rest[body]
        angles = dict(zip("zyx", Rotation.from_matrix(local).as_euler("ZYX"), strict=True))
        for joint in joints:
            axis = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, joint)[-1]
            limits = model.jnt_range[joint]
            position[model.jnt_qposadr[joint]] = np.clip(angles[axis], *limits)
    return np.asarray(position)


def _placed(
    position: NDArray[np.float64], kind: FallKind, generator: Generator
) -> tuple[NDArray[np.float64], _Support | None]:
    """The same pose with the feet on the floor or the body on a seat or bed; what is beside it."""
    import mujoco

    model, data = _alone(), mujoco.MjData(_alone())
    data.qpos[:] = position
    mujoco.mj_forward(model, data)
    own = np.flatnonzero(model.geom_bodyid > 0)
    lowest = min(float(data.geom_xpos[geom][2] - model.geom_size[geom][0]) for geom in own)
    position = position.copy()
    position[2] -= lowest - 0.005
    facing = data.xmat[mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "root")].reshape(3, 3)
    # Beds lie along the trunk.
    ahead = (facing @ np.eye(3)[1 if kind == "bed" else 2])[:2]
    ahead /= max(float(np.linalg.norm(ahead)), 1e-6)
    yaw = float(np.arctan2(ahead[1], ahead[0]))

    def box(half: tuple[float, float, float], forward: float, left: float = 0.0) -> _Support:
        x, y = (position[:2] + forward * ahead + left * np.array([-ahead[1], ahead[0]])).tolist()
        return _Support(half, (x, y, half[2]), yaw)

    if kind == "wall":
        return position, box((0.1, 1.5, 1.2), -0.3)
    if kind not in ("seat", "bed", "drop"):
        return position, None
    height = generator.uniform(*(_SEAT_M if kind == "seat" else _BED_M)) / 2
    if kind == "drop":
        # A bed or sofa, along or across, behind the legs or before them.
        reach = generator.uniform(0.35, 1.0)
        side = -1 if generator.random() < 0.7 else 1
        return position, box((reach, 1.35 - reach, height), side * (reach + 0.2))
    if kind == "seat":
        position[2] = 2 * height + 0.13
        return position, box((0.22, 0.25, height), -0.1)
    position[2] = 2 * height + 0.18
    # People who roll out lie near an edge.
    aside = generator.uniform(0.2, 0.42) * generator.choice([-1, 1])
    return position, box((1.0, 0.45, height), 0.0, aside)


def _disturb(data: Any, kind: FallKind, support: _Support | None, generator: Generator) -> None:
    """Add the velocities with which a fall begins."""
    flat = data.qvel[:2].copy()
    speed = float(np.linalg.norm(flat))
    way = generator.uniform(-np.pi, np.pi)
    if kind in ("trip", "slip") and speed > 0.3:
        way = float(np.arctan2(flat[1], flat[0])) + generator.normal(0, 0.3)
    if support is not None and kind in ("bed", "drop"):
        x, y = (support.place - data.qpos[:3])[:2] * (1 if kind == "drop" else -1)
        way = float(np.arctan2(y, x)) + generator.normal(0, 0.2)
    direction = np.array([np.cos(way), np.sin(way)])
    tip = np.array([-direction[1], direction[0], 0.0])
    push, turn = {
        "faint": (0.25, 0.5), "trip": (0.8, 2.5), "slip": (0.5, -2.5), "push": (1.6, 1.5),
        "knee": (0.4, 0.8), "seat": (0.9, 1.2), "wall": (0.3, -0.4), "bed": (1.3, 0.0),
        "drop": (0.9, 1.5),
    }[kind]  # fmt: skip
    size = generator.uniform(0.6, 1.5)
    data.qvel[:2] += push * size * direction
    data.qvel[3:6] += turn * size * tip + generator.normal(0, 0.5, 3)
    if kind == "bed":
        # About the trunk, so that the upper side goes where the body goes.
        trunk = Rotation.from_quat(data.qpos[3:7], scalar_first=True).apply([0.0, 1.0, 0.0])
        over = direction[0] * trunk[1] - direction[1] * trunk[0]
        data.qvel[4] += generator.uniform(1.5, 5) * np.sign(over)


def _follow_hands(clip: Clip, rotations: NDArray[np.float64]) -> None:
    """Fingers and thumbs follow the hands."""
    for side in ("Left", "Right"):
        for name in (f"{side}FingerBase", f"{side}HandIndex1", f"{side[0]}Thumb"):
            if name in clip.bones:
                rotations[:, clip.bone(name)] = rotations[:, clip.bone(f"{side}Hand")]
