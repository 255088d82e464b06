"""One photograph: a body in a pose, its surroundings, a room, light, a camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from app.vision.judgement import FRAME_POSTURES
from app.vision.people import LANDMARK_NAMES
from index.skeleton import JOINT_NAMES, JOINTS, exchange_sides
from scripts.index.body import about_vertical, pose_transforms, posed_points, retarget
from scripts.index.poses import TRUNK_BELOW_M
from scripts.index.render import skin
from scripts.training.render import furniture
from scripts.training.render.cameras import Camera, sample_camera
from scripts.training.render.cut_outs import CutOut, inflated
from scripts.training.render.development import develop
from scripts.training.render.jointed import jointed_thing
from scripts.training.render.materials import Materials, surface
from scripts.training.render.meshes import Mesh, joined
from scripts.training.render.people import (
    BOTTOM,
    MIRRORED,
    SHOES,
    SKIN,
    TOP,
    Person,
    cast,
    person_materials,
    posed_landmarks,
)
from scripts.training.render.pose import about
from scripts.training.render.posing import SHARES, PoseSource, class_of, read_pose_source
from scripts.training.render.raster import (
    NOTHING,
    paint_room,
    rasterise,
    shade,
    shadow_map,
    vertex_normals,
)
from scripts.training.render.rooms import Room, build_room
from scripts.training.render.surroundings import (
    PosedBody,
    clutter_about,
    level_direction,
    support_of,
)

HEIGHTS_PX = (30.0, 400.0)
"""Longest extent of the body in the picture."""

USUALLY_ABOVE_PX = 55.0
"""Most people are larger: barely visible people teach the network little."""

MARGIN = 0.95
"""The picture is the frame's part about the body: so many of its extents each way."""

MIN_DEPTH_M, NEAREST_M = 0.12, 0.35
"""Things nearer to the camera than the first are not drawn; people are not nearer than the second.
"""

COMPANIONS, HIDDEN = 0.14, 0.22
"""Shares: of people with a second person near them; of subjects behind a thing."""

CLOSE_UPS = 0.1
"""Share of people whose picture holds one end of the body, mostly the head's."""

JUMBLED = 0.15
"""Share of pictures without people in which two things overlap."""

STILL_LIVES = {"furniture": 0.35, "jointed": 0.25, "cut out": 0.25, "worn by nobody": 0.15}
"""What pictures without people show, and how often."""

WORN = ((TOP,), (BOTTOM,), (TOP, BOTTOM), (TOP, BOTTOM, SHOES), (TOP, BOTTOM, SHOES, SKIN))
"""What is worn by nobody; with skin, by a mannequin without a head."""

MIN_WORN, LAID_OUT = 300, 0.3
"""Vertices of clothes that are seen as such; share of clothes that lie flat."""

EMPTY = -1
"""Class of pictures that show nobody."""

_SHADOW_PIXELS, _SHADOW_REACH_M = 256, 2.6
_PELVIS = JOINT_NAMES.index("pelvis")
_HIPS, _HEAD, _FEET = (
    [LANDMARK_NAMES.index(name) for name in names]
    for names in (
        ("left_hip", "right_hip"),
        ("nose", "left_shoulder", "right_shoulder"),
        ("left_ankle", "right_ankle"),
    )
)


@dataclass(frozen=True)
class Photograph:
    """A picture and what it shows."""

    image: NDArray[np.uint8]  # (H, W, 3): BGR; the part of the frame about the subject
    # (2,): focal lengths and principal point, pixels; the point may lie outside the picture.
    focal: NDArray[np.float64]
    centre: NDArray[np.float64]
    # (2,): width and height of the whole frame, about the principal point.
    frame_px: NDArray[np.float64]
    box: NDArray[np.float64]  # (4,): left, top, width, height of what is seen of the subject
    # Position in :data:`app.vision.judgement.FRAME_POSTURES`; :data:`EMPTY` without people.
    posture: int
    # (33, 3): camera axes, metres from the camera; NaN without people.
    landmarks: NDArray[np.float64]
    places: NDArray[np.float64]  # (33, 2): where they are in the picture, pixels
    # (33,): whether each is in the picture, and no thing is in front of it.
    shown: NDArray[np.bool_]
    covered: float  # share of the body's pixels that things hide or the frame cuts
    elevation_deg: float  # of the camera as seen from the subject


@dataclass
class Studio:
    """Takes photographs; the same ones for the same seed."""

    people: list[Person]
    source: PoseSource
    # Share of the people who lie whose head points to the camera, beside those by chance.
    head_first: float = 0.0
    # Share of the photographs without people.
    empty: float = 0.0
    cut_outs: Sequence[CutOut] = ()

    @classmethod
    def open(cls, motion: Path, garments: Path, count: int, seed: int, *, held_out: bool) -> Studio:
        """With ``count`` people; clips, bodies and garments are held out or the others.

        Raises
        ------
        MotionError, GarmentError
            If motion or garments are missing or malformed.
        """
        people = cast(count, seed, garments, held_out=held_out)
        return cls(people, read_pose_source(motion, people[0].avatar, held_out=held_out))

    def take(self, generator: Generator, *, empty: bool = False) -> Photograph:
        """Take one photograph, of a person or of things alone."""
        wanted = str(generator.choice(list(SHARES), p=list(SHARES.values())))
        while True:
            materials = Materials()
            made = (
                self._still_life(materials, generator)
                if empty
                else self._portrait(wanted, materials, generator)
            )
            if made is not None:
                return made

    def _portrait(
        self, wanted: str, materials: Materials, generator: Generator
    ) -> Photograph | None:
        body = self.body(wanted, materials, generator)
        if body is None:
            return None
        floor, around = support_of(wanted, body, materials, generator)
        things = list(around)
        if generator.random() < COMPANIONS:
            posture = str(generator.choice(["standing", "bending", "crouching"], p=[0.6, 0.2, 0.2]))
            other = self.body(posture, materials, generator)
            if other is not None:
                turn = about_vertical(np.array([generator.uniform(0, 6.28)]))[0]
                away = generator.uniform(0.45, 2.5) * level_direction(generator)
                low = float(other.mesh.vertices[:, 1].min())
                things.append(other.mesh.placed(turn, away + np.array([0, floor - low, 0])))
        azimuth = None
        if FRAME_POSTURES[body.posture] == "lying" and generator.random() < self.head_first:
            hips, head = (body.landmarks[rows].mean(axis=0) for rows in (_HIPS, _HEAD))
            azimuth = np.arctan2(*(head - hips)[[0, 2]]) + generator.normal(0, 0.4)
        return _photograph(body.mesh, body, things, floor, materials, generator, azimuth)

    def _still_life(self, materials: Materials, generator: Generator) -> Photograph | None:
        subject = self._thing(materials, generator)
        if generator.random() < JUMBLED:
            other = self._thing(materials, generator)
            subject = joined([subject, other.placed(np.eye(3), generator.normal(0, 0.25, 3))])
        turn = about_vertical(np.array([generator.uniform(0, 2 * np.pi)]))[0]
        raised = generator.choice([0.0, generator.uniform(0, 0.8)])
        if not len(subject.triangles):
            return None
        subject = subject.placed(turn, [0.0, raised, 0.0])
        return _photograph(subject, None, [], 0.0, materials, generator)

    def _thing(self, materials: Materials, generator: Generator) -> Mesh:
        kind = generator.choice(list(STILL_LIVES), p=list(STILL_LIVES.values()))
        if kind == "worn by nobody":
            return self._worn_by_nobody(materials, generator)
        if kind == "cut out" and self.cut_outs:
            return inflated(self.cut_outs, materials, generator)
        if kind == "jointed":
            return jointed_thing(materials, generator)
        makers = furniture.SUBJECTS
        return makers[generator.integers(len(makers))](materials, generator)

    def _worn_by_nobody(self, materials: Materials, generator: Generator) -> Mesh:
        """Clothes in the shape of a body, hung or laid out, or on a mannequin without a head."""
        while True:
            person = self.people[generator.integers(len(self.people))]
            parts = WORN[generator.integers(len(WORN))]
            worn = np.isin(person.parts, parts) & ~person.head
            body = self.body("standing", materials, generator, person)
            if body is None or worn.sum() < MIN_WORN:
                continue
            plain = materials.add(surface(generator, pale=0.7))
            rows = np.where(person.parts == SKIN, plain, body.mesh.materials).astype(np.int32)
            clothes = replace(body.mesh, materials=rows).part(
                np.asarray(worn[person.triangles].all(axis=1))
            )
            deep = 1.0 if SKIN in parts else generator.uniform(0.1, 1.0)
            clothes = clothes.placed(np.diag([1.0, 1.0, deep]), np.zeros(3))
            if generator.random() < LAID_OUT:
                clothes = clothes.placed(about(np.array([1.0, 0, 0]), -np.pi / 2), np.zeros(3))
            return clothes.placed(np.eye(3), [0.0, -float(clothes.vertices[:, 1].min()), 0.0])

    def body(
        self, wanted: str, materials: Materials, generator: Generator, person: Person | None = None
    ) -> PosedBody | None:
        """A body, of anyone by default, in a pose of a class; None where it came out as another."""
        person = person or self.people[generator.integers(len(self.people))]
        pose = self.source.draw(wanted, generator)
        turned = pose_transforms(
            person.avatar, retarget(pose.clip, person.avatar), pose.rotations[None]
        )
        joints = posed_points(person.avatar, turned)[0]
        posture = class_of(pose, joints)
        if FRAME_POSTURES[posture] != wanted or (wanted == "lying" and not _rests(joints)):
            return None
        moved = np.ascontiguousarray(turned[0], np.float32)
        vertices = skin(person.vertices, person.influences, person.weights, moved)
        landmarks = posed_landmarks(person, turned[0])
        if generator.random() < 0.5:
            flip = np.array([-1.0, 1.0, 1.0])
            vertices, landmarks = vertices * flip, (landmarks * flip)[MIRRORED]
            joints = exchange_sides(joints) * flip
        rows = person_materials(materials, generator)
        mesh = Mesh(
            np.ascontiguousarray(vertices, np.float32), person.vertices, person.triangles,
            rows[person.parts],
        )  # fmt: skip
        seat = float(np.quantile(vertices[person.seat, 1], 0.02))
        return PosedBody(mesh, landmarks, joints[:JOINTS], posture, seat, pose.support)


def _rests(joints: NDArray[np.float64]) -> bool:
    """Whether the trunk of a body that lies is on the ground rather than on the limbs."""
    trunk = joints[[_PELVIS, JOINT_NAMES.index("chest")], 1]
    return bool(trunk.max() - joints[:JOINTS, 1].min() < TRUNK_BELOW_M)


def sample_light(room: Room, generator: Generator) -> NDArray[np.float32]:
    """Directions, colours and softness, see :func:`scripts.training.render.raster.shade`."""
    first, second = generator.normal(size=3), generator.normal(size=3)
    first[1] = abs(first[1]) + 0.4
    first, second = first / np.linalg.norm(first), second / np.linalg.norm(second)
    warm = generator.uniform(0.85, 1.15, 3)
    if room.outdoors:
        sky, direct = generator.uniform(0.4, 0.9), generator.uniform(0.0, 1.4)
        softness = generator.uniform(0.5, 3)
    else:
        sky, direct = generator.uniform(0.35, 1.0), generator.uniform(0.1, 0.9)
        softness = generator.uniform(2, 12)
    return np.array(
        [*first, *second, *(sky * generator.uniform(0.92, 1.08, 3)), *(direct * warm),
         generator.uniform(0, 0.3), softness],
        np.float32,
    )  # fmt: skip


def _photograph(
    subject: Mesh,
    body: PosedBody | None,
    things: list[Mesh],
    floor: float,
    materials: Materials,
    generator: Generator,
    azimuth: float | None = None,
) -> Photograph | None:
    """Furnish the scene, take the picture and say what it shows; None where little is seen."""
    low, high = subject.vertices.min(axis=0), subject.vertices.max(axis=0)
    middle = np.asarray((low + high) / 2, np.float64)
    end = _end_of(body, generator) if body is not None and generator.random() < CLOSE_UPS else None
    target = middle if end is None else end
    camera = sample_camera(target, floor, generator, close=end is not None, azimuth=azimuth)
    seen = camera.seen(subject.vertices)
    if seen[:, 2].min() < NEAREST_M:
        return None
    plane = seen[:, :2] / seen[:, 2:]
    first, last = plane.min(axis=0), plane.max(axis=0)
    extent = float((last - first).max())
    edge = camera.half / camera.focal
    inside = (np.abs(plane) < edge).all(axis=1).mean()
    if extent > 6 or inside < 0.3:
        return None
    hides = bool(generator.random() < HIDDEN)
    things = things + clutter_about(camera, target, floor, hides, materials, generator)
    room = build_room(np.stack([camera.place, low, high]), floor, generator)
    light = sample_light(room, generator)
    smallest, largest = HEIGHTS_PX
    if generator.random() < 0.88:
        smallest = USUALLY_ABOVE_PX
    pixels = float(np.exp(generator.uniform(np.log(smallest), np.log(largest))))
    finer = 1.0 if pixels > 200 else 1.5 if pixels > 110 else 2.0 if pixels > 60 else 3.0
    drawn = min(pixels, 320.0) * finer
    middle = (first + last) / 2
    begin = np.maximum(middle - MARGIN * extent, -edge)
    end = np.minimum(middle + MARGIN * extent, edge)
    scale = drawn / extent
    columns, rows = np.ceil((end - begin) * scale).astype(int).tolist()
    if min(columns, rows) < 0.3 * drawn:
        return None
    centre = -begin * scale - 0.5
    scene = joined([subject, *things])
    view = Drawing(camera, float(scale), centre, (rows, columns))
    picture, nearness, shown = view.draw(scene, room, light, target, materials, generator)
    own = (shown != NOTHING) & (shown < len(subject.triangles))
    whole = view.covers(subject)
    if own.sum() < 60 or whole < 1:
        return None
    covered = 1.0 - float(own.sum()) / whole
    if covered > 0.85:
        return None
    squeeze = _pixel_aspect(generator)
    size = (max(8, round(columns / finer * squeeze)), max(8, round(rows / finer)))
    image = develop(picture, size, generator)
    ratio = np.array([size[0] / columns, size[1] / rows])
    own_rows, own_columns = np.nonzero(own)
    box_low = np.array([own_columns.min(), own_rows.min()]) * ratio - 0.5
    box_high = np.array([own_columns.max() + 1, own_rows.max() + 1]) * ratio - 0.5
    focal = scale * ratio
    centre_px = (centre + 0.5) * ratio - 0.5
    nobody = np.full((33, 3), np.nan)
    landmarks = camera.seen(body.landmarks) if body else nobody
    places = landmarks[:, :2] / landmarks[:, 2:] * focal + centre_px
    return Photograph(
        image,
        focal,
        centre_px,
        2 * edge * focal,
        np.concatenate([box_low, box_high - box_low]),
        body.posture if body else EMPTY,
        landmarks,
        places,
        _shown(landmarks, view, nearness, shown, len(subject.triangles)),
        covered,
        camera.elevation_deg(target),
    )


def _end_of(body: PosedBody, generator: Generator) -> NDArray[np.float64]:
    """A place between the hips and one end of a body: the head, seldom the feet."""
    hips = body.landmarks[_HIPS].mean(axis=0)
    end = body.landmarks[_HEAD if generator.random() < 0.8 else _FEET].mean(axis=0)
    return np.asarray(hips + generator.uniform(0.5, 1.0) * (end - hips), np.float64)


def _pixel_aspect(generator: Generator) -> float:
    """Width of a pixel's share of the picture over its height: seldom not 1."""
    if generator.random() < 0.93:
        return 1.0
    return float(generator.choice([0.75, 1.33, 0.9, 1.1, 0.5]))


def _shown(
    landmarks: NDArray[np.float64],
    view: Drawing,
    nearness: NDArray[np.float32],
    shown: NDArray[np.int32],
    own: int,
) -> NDArray[np.bool_]:
    """Which landmarks are in the picture, with no thing before them."""
    rows, columns = nearness.shape
    result = np.zeros(len(landmarks), bool)
    for number, place in enumerate(landmarks):
        if not np.isfinite(place).all() or place[2] <= 0:
            continue
        x, y = (place[:2] / place[2] * view.scale + view.centre).round().astype(int)
        if 0 <= x < columns and 0 <= y < rows:
            thing = shown[y, x] >= own
            result[number] = not (thing and 1 / nearness[y, x] < place[2] - 0.03)
    return result


@dataclass(frozen=True)
class Drawing:
    """A part of a camera's frame drawn at a resolution."""

    camera: Camera
    scale: float  # pixels for a tangent of 1
    centre: NDArray[np.float64]  # (2,): principal point, pixels
    shape: tuple[int, int]  # rows and columns

    def _plane(self, mesh: Mesh) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        seen = self.camera.seen(mesh.vertices)
        depth = np.maximum(seen[:, 2:], 1e-3)
        plane = seen[:, :2] / depth * self.scale + self.centre
        return plane.astype(np.float32), np.ascontiguousarray(seen[:, 2], np.float32)

    def covers(self, mesh: Mesh) -> int:
        """Pixels that a mesh covers with nothing before it, those beyond the picture as well."""
        plane, depths = self._plane(mesh)
        low = plane.min(axis=0)
        # At a quarter of the resolution.
        columns, rows = ((plane.max(axis=0) - low) / 4).astype(int) + 2
        nearness = np.zeros((rows, columns), np.float32)
        shown = np.full((rows, columns), NOTHING, np.int32)
        shares = np.empty((rows, columns, 2), np.float32)
        rasterise((plane - low) / 4, depths, mesh.triangles, MIN_DEPTH_M, nearness, shown, shares)
        return 16 * int((shown != NOTHING).sum())

    def draw(
        self,
        scene: Mesh,
        room: Room,
        light: NDArray[np.float32],
        target: NDArray[np.float64],
        materials: Materials,
        generator: Generator,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
        """Linear light, nearness and triangles of the pixels."""
        rows, columns = self.shape
        shown = np.full((rows, columns), NOTHING, np.int32)
        shares = np.zeros((rows, columns, 2), np.float32)
        # Rooms are drawn at half of the resolution.
        half = ((rows + 1) // 2, (columns + 1) // 2)
        backdrop, wall_nearness = np.zeros((*half, 3), np.float32), np.zeros(half, np.float32)
        to_light, heights = _shadows(scene, light[:3].astype(np.float64), target)
        in_room = light.copy()
        in_room[:3], in_room[3:6] = room.turn @ light[:3], room.turn @ light[3:6]
        paint_room(
            (room.turn @ self.camera.rotation.T).astype(np.float32),
            (room.turn @ self.camera.place).astype(np.float32),
            np.array([self.scale, self.scale, *(self.centre - 0.5)], np.float32) / np.float32(2),
            room.corners.astype(np.float32),
            room.materials,
            room.panels,
            in_room,
            room.glow.astype(np.float32),
            np.hstack([to_light[:, :3] @ room.turn.T, to_light[:, 3:]]).astype(np.float32),
            heights,
            wall_nearness,
            backdrop,
        )
        whole = (2 * half[1], 2 * half[0])
        picture, nearness = (
            np.ascontiguousarray(cv2.resize(part, whole)[:rows, :columns], np.float32)
            for part in (backdrop, wall_nearness)
        )
        plane, depths = self._plane(scene)
        rasterise(plane, depths, scene.triangles, MIN_DEPTH_M, nearness, shown, shares)
        shade(
            nearness, shown, shares, scene.triangles, scene.vertices,
            vertex_normals(scene.vertices, scene.triangles), scene.textured, scene.materials,
            materials.table(), _wrinkles(generator), self.camera.place.astype(np.float32), light,
            to_light.astype(np.float32), heights, picture,
        )  # fmt: skip
        return picture, nearness, shown


def _shadows(
    scene: Mesh, towards: NDArray[np.float64], target: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Shadow map about a target, and the transform to it."""
    across = np.cross(towards, [0.0, 0.0, 1.0] if abs(towards[2]) < 0.9 else [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    scale = _SHADOW_PIXELS / (2 * _SHADOW_REACH_M)
    linear = np.stack([scale * across, scale * np.cross(towards, across), towards])
    shift = np.array([_SHADOW_PIXELS / 2, _SHADOW_PIXELS / 2, 0.0]) - linear @ target
    to_light = np.hstack([linear, shift[:, None]])
    heights = np.full((_SHADOW_PIXELS, _SHADOW_PIXELS), -1e9, np.float32)
    points = (scene.vertices @ linear.T + shift).astype(np.float32)
    shadow_map(points, scene.triangles, heights)
    return to_light, heights


def _wrinkles(generator: Generator) -> NDArray[np.float32]:
    """Waves ``(7, 8)`` of cloth."""
    rows = []
    for _ in range(7):
        wave, turn = generator.normal(size=3), generator.normal(size=3)
        wave *= generator.uniform(15, 90) / np.linalg.norm(wave)
        turn /= np.linalg.norm(turn)
        rows.append([*wave, generator.uniform(0, 6.3), generator.uniform(0.1, 0.5), *turn])
    return np.array(rows, np.float32)
