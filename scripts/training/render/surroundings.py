"""What surrounds a body: what it sits or lies on, what stands about it and hides it."""

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from app.vision.people import LANDMARK_NAMES
from index.skeleton import JOINT_NAMES
from scripts.index.body import about_vertical
from scripts.training.render import furniture
from scripts.training.render.cameras import Camera
from scripts.training.render.materials import Materials
from scripts.training.render.meshes import Mesh
from scripts.training.render.pose import Support

TABLES, WALKING_FRAMES = 0.42, 0.07
"""Shares: of people on chairs who sit at a table; of people with a walking frame at hand."""

AT_FURNITURE, UNDER_FURNITURE = 0.5, 0.3
"""Shares: of people on their feet who stand at a table or a counter, or before a seat; of people on
the floor who lie under a table or a chair. Otherwise furniture alone would mean sitting."""

_NECK, _PELVIS = JOINT_NAMES.index("neck"), JOINT_NAMES.index("pelvis")
_EARS = [LANDMARK_NAMES.index(f"{side}_ear") for side in ("left", "right")]


@dataclass(frozen=True)
class PosedBody:
    """A body in world axes, its pelvis over the origin.

    It has landmarks ``(33, 3)``, joints ``(19, 3)``, a posture as a position in
    :data:`app.vision.judgement.FRAME_POSTURES`, the height of the seat, and what carries it.
    """

    mesh: Mesh
    landmarks: NDArray[np.float64]
    joints: NDArray[np.float64]
    posture: int
    seat: float
    support: Support


def level_direction(generator: Generator) -> NDArray[np.float64]:
    """A level unit vector ``(3,)`` in any direction."""
    angle = generator.uniform(0, 2 * np.pi)
    return np.array([np.sin(angle), 0.0, np.cos(angle)])


def support_of(
    wanted: str, body: PosedBody, materials: Materials, generator: Generator
) -> tuple[float, list[Mesh]]:
    """Height of the floor, and what a person sits on, sits at or lies on."""
    vertices = body.mesh.vertices
    low = float(vertices[:, 1].min())
    if body.support == "cycle":
        return _cycle(body, low, materials, generator)
    if wanted == "sitting" and body.seat - low > 0.2:
        return _seat(body, low, materials, generator)
    if wanted == "sitting":
        return _sitting_low(vertices, low, materials, generator)
    if wanted == "lying" and generator.random() < 0.5:
        floor = low - generator.choice([generator.uniform(0.02, 0.1), generator.uniform(0.25, 0.7)])
        axis = body.joints[_NECK] - body.joints[_PELVIS]
        # Turned so that the head points to -z.
        turn = about_vertical(np.array([-np.arctan2(-axis[0], -axis[2])]))[0]
        along = vertices @ turn.T
        ends = (float(along[:, 2].min()), float(along[:, 2].max()))
        things = [furniture.bed(floor, low + 0.03, ends, materials, generator)]
        if generator.random() < 0.4:
            share = generator.uniform(0.25, 0.85)
            things.append(furniture.blanket(along, low + 0.03, share, materials, generator))
        return floor, [thing.placed(turn.T, np.zeros(3)) for thing in things]
    if wanted in ("standing", "bending", "lying") and generator.random() < WALKING_FRAMES:
        frame = furniture.walking_frame(materials, generator)
        if wanted != "lying":
            return low, [frame.placed(np.eye(3), [0.0, low, generator.uniform(0.2, 0.45)])]
        turn = about_vertical(np.array([generator.uniform(0, 6.28)]))[0]
        away = generator.uniform(0.3, 0.9) * level_direction(generator)
        return low, [frame.placed(turn, away + np.array([0, low, 0]))]
    if wanted in ("standing", "bending") and generator.random() < AT_FURNITURE:
        return low, [_beside(vertices, low, materials, generator)]
    if wanted == "lying" and generator.random() < UNDER_FURNITURE:
        return low, [_over(vertices, low, materials, generator)]
    return low, []


def _beside(
    vertices: NDArray[np.float32], floor: float, materials: Materials, generator: Generator
) -> Mesh:
    """A table or a counter before a person on their feet, or a seat behind them."""
    if generator.random() < 0.7:
        top = floor + generator.uniform(0.62, 1.15)
        front = float(np.quantile(vertices[vertices[:, 1] < top, 2], 0.98))
        return furniture.desk(floor, top, front + generator.uniform(0.0, 0.4), materials, generator)
    seat = furniture.chair(floor, floor + generator.uniform(0.38, 0.52), -0.3, materials, generator)
    away = 0.35 - float(np.quantile(vertices[:, 2], 0.02)) + generator.uniform(0, 0.5)
    return seat.placed(np.eye(3), [generator.normal(0, 0.2), 0.0, -away])


def _over(
    vertices: NDArray[np.float32], floor: float, materials: Materials, generator: Generator
) -> Mesh:
    """A table or a chair over a part of a person on the floor."""
    if generator.random() < 0.6:
        thing = furniture.desk(
            floor, floor + generator.uniform(0.6, 0.8), -0.3, materials, generator
        )
    else:
        thing = furniture.chair(
            floor, floor + generator.uniform(0.4, 0.52), -0.3, materials, generator
        )
    turn = about_vertical(np.array([generator.uniform(0, 2 * np.pi)]))[0]
    x, _, z = vertices[generator.integers(len(vertices))].tolist()
    return thing.placed(turn, [x, 0.0, z])


def _cycle(
    body: PosedBody, low: float, materials: Materials, generator: Generator
) -> tuple[float, list[Mesh]]:
    floor = min(low, body.seat - 0.6) - generator.uniform(0.02, 0.2)
    things = [furniture.cycle(floor, body.seat + 0.01, materials, generator)]
    if generator.random() < 0.35:
        head = body.landmarks[_EARS].mean(axis=0)
        things.append(furniture.helmet(head, materials, generator))
    return floor, things


def _seat(
    body: PosedBody, low: float, materials: Materials, generator: Generator
) -> tuple[float, list[Mesh]]:
    """A chair or the like; perhaps a table before it, or a blanket over the legs."""
    vertices, floor = body.mesh.vertices, low
    if generator.random() < 0.15:
        floor -= generator.uniform(0, 0.25)
    near = np.abs(vertices[:, 1] - body.seat - 0.2) < 0.2
    behind = float(np.quantile(vertices[near, 2], 0.02)) - 0.02
    things = [furniture.chair(floor, body.seat + 0.01, behind, materials, generator)]
    chance = generator.random()
    if chance < TABLES:
        lap = float(vertices[vertices[:, 2] > 0.15][:, 1].min(initial=0.0))
        top = max(floor + generator.uniform(0.62, 0.8), min(0.12, lap + 0.3))
        near_z = generator.uniform(0.15, 0.5)
        things.append(furniture.desk(floor, top, near_z, materials, generator))
    elif chance < TABLES + 0.08:
        things += furniture.lap_blanket(vertices, floor, body.seat, materials, generator)
    return floor, things


def _sitting_low(
    vertices: NDArray[np.float32], low: float, materials: Materials, generator: Generator
) -> tuple[float, list[Mesh]]:
    """On the ground, on a sofa or a bed with the legs along it."""
    chance = generator.random()
    if chance < 0.55:
        return low, []
    floor = low - generator.uniform(0.25, 0.6)
    if chance < 0.75:
        return floor, [furniture.chair(floor, low + 0.02, -0.6, materials, generator)]
    ends = (-generator.uniform(0.2, 0.6), float(vertices[:, 2].max()))
    things = [furniture.bed(floor, low + 0.03, ends, materials, generator)]
    if generator.random() < 0.5:
        share = generator.uniform(0.4, 0.8)
        legs = vertices[vertices[:, 1] < low + 0.35]
        things.append(furniture.blanket(legs, low + 0.03, share, materials, generator))
    return floor, things


def clutter_about(
    camera: Camera, target: NDArray[np.float64], floor: float, hides: bool,
    materials: Materials, generator: Generator,
) -> list[Mesh]:  # fmt: skip
    """Things about a target, and one in front of it where it is to be hidden in part."""
    things = []
    to_camera = (camera.place - target) * [1, 0, 1]
    distance = float(np.linalg.norm(to_camera))
    for number in range(generator.integers(0, 6)):
        makers = furniture.CLUTTER
        thing = makers[generator.integers(len(makers))](materials, generator)
        turn = about_vertical(np.array([generator.uniform(0, 2 * np.pi)]))[0]
        ground = np.array([target[0], floor, target[2]])
        if hides and number == 0:
            share = generator.uniform(0.25, 0.6)
            aside = np.cross(to_camera / max(distance, 1e-6), [0, 1, 0]) * generator.normal(0, 0.5)
            place = ground + share * to_camera + aside
            things.append(thing.placed(turn, place))
            continue
        place = ground + generator.uniform(0.9, 4.5) * level_direction(generator)
        # Not in the way, nor about the camera.
        along = np.clip((place - ground) @ to_camera / max(distance**2, 1e-6), 0, 1)
        radius = float(np.abs(thing.vertices[:, [0, 2]]).max())
        if np.linalg.norm(place - ground - along * to_camera) > 0.5 + radius:
            things.append(thing.placed(turn, place))
    return things
