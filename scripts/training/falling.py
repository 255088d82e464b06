"""Falls by physics: the humanoid of dm_control, whose joints are CMU's, loses its muscle tone.

A fall begins in a frame of a clip, with the clip's motion, so what comes before it is recorded and
what follows is simulated (MuJoCo, 0.4 core seconds a fall). World axes: y up, metres.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from index.build.motion import Clip

FPS = 30
"""Of clips and of the falls."""

FallKind = Literal["faint", "trip", "slip", "push", "knee", "seat", "wall", "bed"]
FALLS: tuple[FallKind, ...] = ("faint", "trip", "slip", "push", "knee", "seat", "wall", "bed")

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

    ``down`` is the frame from which the body is on the ground; ``ends_down`` says whether it stays.
    """

    rotations: NDArray[np.float64]
    positions: NDArray[np.float64]
    down: int
    ends_down: bool


def humanoid() -> Path:
    """The file of the humanoid in dm_control, which is not imported."""
    spec = importlib.util.find_spec("dm_control")
    if spec is None or not spec.submodule_search_locations:
        raise ModuleNotFoundError("expected dm_control and mujoco: install the extra 'training'")
    folder = Path(next(iter(spec.submodule_search_locations)))
    return folder / "locomotion" / "walkers" / "assets" / "humanoid_CMU_V2020.xml"


@lru_cache(maxsize=4)
def _model(support: Literal["none", "box", "wall"]) -> Any:
    """The humanoid over a floor, with a seat or bed under it, or a wall behind it."""
    import mujoco

    spec = mujoco.MjSpec.from_file(str(humanoid()))
    spec.body("root").add_freejoint()
    spec.option.timestep = _TIMESTEP_S
    floor = spec.worldbody.add_geom()
    floor.type, floor.size = mujoco.mjtGeom.mjGEOM_PLANE, [30, 30, 0.1]
    things = [floor]
    if support != "none":
        box = spec.worldbody.add_geom(name="support")
        box.type, box.size = mujoco.mjtGeom.mjGEOM_BOX, [0.5, 0.5, 0.2]
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

    model = _model("box" if kind in ("seat", "bed") else "wall" if kind == "wall" else "none")
    data = mujoco.MjData(model)
    before = max(frame - 1, 0)
    start, ahead = (_posed(model, clip, row) for row in (before, frame))
    velocity = np.zeros(model.nv)
    if frame > before:
        mujoco.mj_differentiatePos(model, velocity, 1 / FPS, start, ahead)
    data.qpos[:] = ahead
    data.qvel[:] = np.clip(velocity, -4, 4)
    _set_scene(model, data, kind, generator)
    _disturb(data, kind, generator)
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
    down = int(np.argmax(low)) if low.any() else frames
    return Fall(rotations, positions, down, bool(low[-FPS:].all()))


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


def _set_scene(model: Any, data: Any, kind: FallKind, generator: Generator) -> None:
    """Put the feet on the floor, the body on a seat or bed, or a wall behind the back."""
    import mujoco

    mujoco.mj_forward(model, data)
    own = np.flatnonzero(model.geom_bodyid > 0)
    lowest = min(float(data.geom_xpos[geom][2] - model.geom_size[geom][0]) for geom in own)
    data.qpos[2] -= lowest - 0.005
    root = data.qpos[:3]
    facing = data.xmat[mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "root")].reshape(3, 3)
    ahead = facing @ np.array([0.0, 0.0, 1.0])
    ahead[2] = 0
    ahead /= max(float(np.linalg.norm(ahead)), 1e-6)
    if kind not in ("seat", "bed", "wall"):
        return
    box = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, "support")
    yaw = float(np.arctan2(ahead[1], ahead[0]))
    model.geom_quat[box] = [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
    if kind == "wall":
        model.geom_size[box], model.geom_pos[box] = [0.1, 1.5, 1.2], root - 0.3 * ahead
        model.geom_pos[box][2] = 1.2
        return
    height = generator.uniform(*(_SEAT_M if kind == "seat" else _BED_M)) / 2
    if kind == "seat":
        model.geom_size[box] = [0.22, 0.25, height]
        model.geom_pos[box] = [*(root - 0.1 * ahead)[:2], height]
        data.qpos[2] = 2 * height + 0.13
    else:
        model.geom_size[box] = [1.0, 0.45, height]
        model.geom_pos[box] = [*root[:2], height]
        data.qpos[2] = 2 * height + 0.18


def _disturb(data: Any, kind: FallKind, generator: Generator) -> None:
    """Add the velocities with which a fall begins."""
    flat = data.qvel[:2].copy()
    speed = float(np.linalg.norm(flat))
    way = generator.uniform(-np.pi, np.pi)
    if kind in ("trip", "slip") and speed > 0.3:
        way = float(np.arctan2(flat[1], flat[0])) + generator.normal(0, 0.3)
    direction = np.array([np.cos(way), np.sin(way)])
    tip = np.array([-direction[1], direction[0], 0.0])
    push, turn = {
        "faint": (0.25, 0.5), "trip": (0.8, 2.5), "slip": (0.5, -2.5), "push": (1.6, 1.5),
        "knee": (0.4, 0.8), "seat": (0.9, 1.2), "wall": (0.3, -0.4), "bed": (1.3, 0.0),
    }[kind]  # fmt: skip
    size = generator.uniform(0.6, 1.5)
    data.qvel[:2] += push * size * direction
    data.qvel[3:6] += turn * size * tip + generator.normal(0, 0.5, 3)
    if kind == "bed":
        data.qvel[3:6] += (
            generator.uniform(1.5, 5) * generator.choice([-1, 1]) * np.array([0, 1.0, 0])
        )


def _follow_hands(clip: Clip, rotations: NDArray[np.float64]) -> None:
    """Fingers and thumbs follow the hands."""
    for side in ("Left", "Right"):
        for name in (f"{side}FingerBase", f"{side}HandIndex1", f"{side[0]}Thumb"):
            if name in clip.bones:
                rotations[:, clip.bone(name)] = rotations[:, clip.bone(f"{side}Hand")]
