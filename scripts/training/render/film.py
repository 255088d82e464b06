"""Films of people and things before a fixed camera, five frames a second.

People fall, live daily life or do what a clip shows, alone or among others; things move; light is
switched. See :mod:`scripts.training.render_films`, where a camera session reads them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from scripts.index.body import about_vertical, pose_transforms, posed_points, retarget
from scripts.index.render import skin
from scripts.training.motions import Motion, Motions, drawn
from scripts.training.render import furniture
from scripts.training.render.cameras import Camera, sample_camera
from scripts.training.render.development import develop
from scripts.training.render.jointed import jointed_thing
from scripts.training.render.materials import Materials
from scripts.training.render.meshes import Mesh, joined
from scripts.training.render.people import Person, person_materials
from scripts.training.render.rooms import Room, build_room
from scripts.training.render.scene import Drawing, sample_light
from scripts.training.render.surroundings import clutter_about

RATE = 5
NOBODY = 0.12
"""Share of films that show things alone, some of which move."""

JUMPS = 0.4
"""Share of the animals that jump up and down."""

KINDS = (0.4, 0.35, 0.25)
"""Shares of falls, daily life and recorded motion in the others."""

COMPANIONS = (0.62, 0.24, 0.07, 0.03, 0.02, 0.01, 0.01)
"""Shares of films with so many other people, from none on."""

OVERHEAD, HIDES, COVERED, SWITCHED = 0.2, 0.2, 0.5, 0.1
"""Shares of films seen from above; with a thing in front; of people in bed with a blanket; of rooms
in which the light changes."""

LONGER_SIDE_PX = (240, 320, 320, 400, 400, 480, 480, 640)
FRAMES = 40

FIRST_FRAME = 45
"""A film begins so many frames of its motion later, about two seconds before a fall."""


@dataclass(frozen=True)
class Actor:
    """A person in the world of a film."""

    person: Person
    motion: Motion
    materials: NDArray[np.int32]
    transforms: NDArray[np.float64]
    path: NDArray[np.float64]
    joints: NDArray[np.float64]

    @classmethod
    def of(
        cls, person: Person, motion: Motion, materials: Materials, generator: Generator
    ) -> Actor:
        """Dress a person for a motion, at the rate of the film."""
        rows = slice(FIRST_FRAME, None, 30 // RATE)
        transforms = pose_transforms(
            person.avatar, retarget(motion.clip, person.avatar), motion.rotations
        )
        points = posed_points(person.avatar, transforms)
        path = motion.path(person.avatar, points)
        joints = points + path[:, None]
        return cls(person, motion, person_materials(materials, generator), transforms[rows],
                   path[rows], joints[rows])  # fmt: skip

    def mesh(self, frame: int) -> Mesh:
        """The body in a frame."""
        person, frame = self.person, min(frame, len(self.path) - 1)
        moved = np.ascontiguousarray(self.transforms[frame], np.float32)
        vertices = skin(person.vertices, person.influences, person.weights, moved)
        vertices = np.ascontiguousarray(vertices + self.path[frame], np.float32)
        return Mesh(vertices, person.vertices, person.triangles, self.materials[person.parts])

    def support(self, materials: Materials, generator: Generator) -> list[Mesh]:
        """The furniture on which the person sits or lies."""
        if self.motion.support is None:
            return []
        frame = min(max(self.motion.held - FIRST_FRAME, 0) * RATE // 30, len(self.path) - 1)
        vertices = self.mesh(frame).vertices
        middle = self.path[frame] * [1, 0, 1]
        joints = self.joints[frame]
        axis = joints[3] - joints[0]
        if self.motion.support == "bed":
            turn = about_vertical(np.array([-np.arctan2(-axis[0], -axis[2])]))[0]
            along = (vertices - middle) @ turn.T
            ends = (float(along[:, 2].min()) - 0.1, float(along[:, 2].max()) + 0.1)
            top = max(0.1, float(np.quantile(vertices[:, 1], 0.03)))
            things = [furniture.bed(0.0, top, ends, materials, generator)]
            if self.motion.kind == "in-bed" and generator.random() < COVERED:
                share, body = generator.uniform(0.3, 0.85), along.astype(np.float32)
                things.append(furniture.blanket(body, top, share, materials, generator))
            return [thing.placed(turn.T, middle) for thing in things]
        thighs = (joints[[12, 16]].mean(axis=0) - joints[0]) * [1, 0, 1]
        turn = about_vertical(np.array([np.arctan2(thighs[0], thighs[2])]))[0]
        top = max(0.2, float(self.path[frame][1]) - 0.1)
        return [furniture.chair(0.0, top, -0.25, materials, generator).placed(turn, middle)]


@dataclass(frozen=True)
class MovingThing:
    """A thing with its places ``(FRAMES, 3)`` and headings ``(FRAMES,)``, radians."""

    mesh: Mesh
    places: NDArray[np.float64]
    headings: NDArray[np.float64]

    @classmethod
    def of(
        cls, middle: NDArray[np.float64], materials: Materials, generator: Generator
    ) -> MovingThing:
        """An animal that runs and jumps, a chair or bag that is pulled, a door that swings."""
        makers = (*[jointed_thing] * 5, *furniture.SUBJECTS, furniture.cupboard)
        maker = makers[generator.integers(len(makers))]
        mesh = maker(materials, generator)
        heading = generator.uniform(0, 2 * np.pi) + np.cumsum(
            generator.normal(0, generator.choice([0.05, 0.3]), FRAMES)
        )
        moves = generator.random(FRAMES) < generator.choice([0.2, 1.0])
        step = moves * generator.choice([0.0, 0.1, 0.3]) * generator.uniform(0.5, 1.5)
        path = np.cumsum(
            step[:, None] * np.stack([np.sin(heading), 0 * heading, np.cos(heading)], axis=1),
            axis=0,
        )
        if maker is jointed_thing and generator.random() < JUMPS:
            path[:, 1] = _jumps(generator)
        first = middle + generator.uniform(-1.5, 1.5, 3)
        return cls(mesh, (first - path.mean(axis=0)) * [1, 0, 1] + path, heading)

    def at(self, frame: int) -> Mesh:
        """The thing in a frame."""
        turn = about_vertical(self.headings[frame : frame + 1])[0]
        return self.mesh.placed(turn, self.places[frame])


def _jumps(generator: Generator) -> NDArray[np.float64]:
    """Heights ``(FRAMES,)`` of an animal that jumps up, stays for a while, and jumps down."""
    heights = np.zeros(FRAMES)
    frame = int(generator.integers(1, 10))
    while frame < FRAMES:
        stays = int(generator.integers(1, 12))
        heights[frame : frame + stays] = generator.uniform(0.2, 1.2)
        frame += stays + int(generator.integers(2, 10))
    # A jump takes about two frames.
    return np.convolve(np.pad(heights, 1, "edge"), [0.25, 0.5, 0.25], "valid")


@dataclass(frozen=True)
class Film:
    """People and things before a fixed camera, whose pictures are drawn when they are asked for.

    The light of the sky and of the lamp is multiplied by ``lamps`` ``(FRAMES, 2)``.
    """

    actors: list[Actor]
    things: list[Mesh]
    moving: list[MovingThing]
    middle: NDArray[np.float64]
    room: Room
    light: NDArray[np.float32]
    lamps: NDArray[np.float32]
    materials: Materials
    view: Drawing
    seed: int

    def __len__(self) -> int:
        return FRAMES

    @property
    def kind(self) -> str:
        """What the first person does."""
        return self.actors[0].motion.kind if self.actors else "nobody"

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, pixels."""
        return self.view.shape[1], self.view.shape[0]

    def picture(self, number: int) -> NDArray[np.uint8]:
        """A frame ``(H, W, 3)``, BGR."""
        scene = joined(
            [
                *(actor.mesh(number) for actor in self.actors),
                *(thing.at(number) for thing in self.moving),
                *self.things,
            ]
        )
        light = self.light.copy()
        light[6:12] *= np.repeat(self.lamps[number], 3)
        picture, _, _ = self.view.draw(
            scene, self.room, light, self.middle, self.materials, np.random.default_rng(self.seed)
        )
        return develop(picture, self.size, np.random.default_rng(self.seed))


def take(motions: Motions, people: Sequence[Person], generator: Generator) -> Film | None:
    """Render a film; None where the camera would see hardly anything of the first person."""
    materials = Materials()
    actors: list[Actor] = []
    middle = generator.uniform([-0.5, 0.3, -0.5], [0.5, 1.2, 0.5])
    if generator.random() >= NOBODY:
        motion = drawn(motions, generator, KINDS)
        actors.append(
            Actor.of(people[int(generator.integers(len(people)))], motion, materials, generator)
        )
        middle = actors[0].path.mean(axis=0)
        for _ in range(generator.choice(len(COMPANIONS), p=COMPANIONS)):
            actors.append(_companion(motions, people, middle, materials, generator))
    camera = _camera(middle, generator)
    places = [actor.joints.reshape(-1, 3) for actor in actors]
    every = np.concatenate([*places, middle[None]])
    if np.linalg.norm(every - camera.place, axis=1).min() < 0.8:
        return None
    if actors:
        inside = camera.seen(actors[0].joints)
        plane = inside[..., :2] / np.maximum(inside[..., 2:], 0.05) * camera.focal
        if ((np.abs(plane) < camera.half) & (inside[..., 2:] > 0.1)).all(axis=-1).mean() < 0.6:
            return None
    things = [one for actor in actors for one in actor.support(materials, generator)]
    hides = bool(generator.random() < HIDES)
    things += clutter_about(camera, middle, 0.0, hides, materials, generator)
    count = int(generator.integers(1, 4)) if not actors else int(generator.random() < 0.12)
    moving = [MovingThing.of(middle, materials, generator) for _ in range(count)]
    low, high = every.min(axis=0), every.max(axis=0)
    room = build_room(np.stack([camera.place, low, high]), 0.0, generator)
    light = sample_light(room, generator)
    scale = int(generator.choice(LONGER_SIDE_PX)) / 2.0
    shape = np.ceil(2 * camera.half * scale).astype(int)
    view = Drawing(camera, scale * camera.focal, shape / 2 - 0.5, (int(shape[1]), int(shape[0])))
    return Film(actors, things, moving, middle, room, light, _lamps(generator), materials, view,
                int(generator.integers(1 << 30)))  # fmt: skip


def _companion(
    motions: Motions,
    people: Sequence[Person],
    middle: NDArray[np.float64],
    materials: Materials,
    generator: Generator,
) -> Actor:
    """A second person, walking or standing nearby."""
    walk = motions.recorded(generator, walks=bool(generator.random() < 0.7))
    other = Actor.of(people[int(generator.integers(len(people)))], walk, materials, generator)
    turn = about_vertical(np.array([generator.uniform(0, 6.28)]))[0]
    level = np.array([1.0, 0.0, 1.0])
    shift = (generator.uniform(-2, 2, 3) + middle) * level - other.path.mean(
        axis=0
    ) * level @ turn.T
    linear = turn @ other.transforms[..., :3]
    offsets = other.transforms[..., 3] @ turn.T
    transforms = np.concatenate([linear, offsets[..., None]], axis=-1)
    path, joints = other.path @ turn.T + shift, other.joints @ turn.T + shift
    return replace(other, transforms=transforms, path=path, joints=joints)


def _lamps(generator: Generator) -> NDArray[np.float32]:
    """Ones, or from some frames on other factors."""
    factors = np.ones((FRAMES, 2), np.float32)
    if generator.random() < SWITCHED:
        for _ in range(generator.integers(1, 4)):
            factors[generator.integers(FRAMES) :] = np.exp(generator.normal(0, 0.8, 2))
    return factors


def _camera(target: NDArray[np.float64], generator: Generator) -> Camera:
    while True:
        camera = sample_camera(target, 0.0, generator, close=False, overhead=OVERHEAD)
        if np.linalg.norm(camera.place - target) > 1.8:
            return camera


def film_of(motions: Motions, people: Sequence[Person], seed: int, number: int) -> Film:
    """The film of a number, which does not depend on those made before it."""
    generator = np.random.default_rng([seed, number])
    while True:
        film = take(motions, people, generator)
        if film is not None:
            return film
