"""Render films of falls and daily life, read by a camera session: see ``docs/training.md``.

A fixed camera, five frames a second. Writes ``film-NNNN.npz`` each: where the joints are, what the
session said of the person there, and its tracks. The pictures are not kept; films that are there
are not made again. ``--sheet FILE`` draws six frames of each of 24 films to look at instead.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from tqdm import tqdm

from app.camera import CameraSession
from app.estimation.upload import Upload
from app.photograph import load_estimator
from app.scheduling.job import Job
from app.settings import Settings
from app.tracking.falls import Observation
from app.tracking.results import TrackedPerson
from app.vision.geometry import Box
from app.vision.people import landmark_rows
from index.build.body import about_vertical, pose_transforms, posed_points, retarget
from index.build.render import skin
from scripts.helpers import encoded
from scripts.results import ROOT
from scripts.training.identity_pairs import Pairs, recorded_pairs
from scripts.training.motions import Motion, Motions, drawn
from scripts.training.render import furniture
from scripts.training.render.cameras import Camera, aimed_at, sample_camera
from scripts.training.render.development import develop
from scripts.training.render.materials import Materials
from scripts.training.render.meshes import Mesh, joined
from scripts.training.render.people import Person, cast, person_materials
from scripts.training.render.rooms import Room, build_room
from scripts.training.render.scene import _Drawing, _light
from scripts.training.render.surroundings import clutter_about

RATE = 5
NOBODY = 0.12
"""Share of films that show things alone, some of which move."""

KINDS = (0.4, 0.35, 0.25)
"""Shares of falls, daily life and recorded motion in the others."""

COMPANIONS = (0.62, 0.24, 0.07, 0.03, 0.02, 0.01, 0.01)
"""Shares of films with so many other people, from none on."""

OVERHEAD, HIDES, COVERED, SWITCHED = 0.2, 0.2, 0.5, 0.1
"""Shares of films seen from above; with a thing in front; of people in bed with a blanket; of rooms
in which the light changes."""

LONGER_SIDE_PX = (240, 320, 320, 400, 400, 480, 480, 640)
FRAMES = 35

PEOPLE, HELD_OUT_PEOPLE = 10, 5
FIRST_FRAME = 45
"""A film begins so many frames of its motion later, about two seconds before a fall."""

_HIPS = landmark_rows("hip")


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
        """An animal that runs about, a chair or bag that is pulled, a door that swings."""
        makers = (furniture.animal, furniture.animal, *furniture.SUBJECTS, furniture.cupboard)
        mesh = makers[generator.integers(len(makers))](materials, generator)
        heading = generator.uniform(0, 2 * np.pi) + np.cumsum(
            generator.normal(0, generator.choice([0.05, 0.3]), FRAMES)
        )
        moves = generator.random(FRAMES) < generator.choice([0.2, 1.0])
        step = moves * generator.choice([0.0, 0.1, 0.3]) * generator.uniform(0.5, 1.5)
        path = np.cumsum(
            step[:, None] * np.stack([np.sin(heading), 0 * heading, np.cos(heading)], axis=1),
            axis=0,
        )
        first = middle + generator.uniform(-1.5, 1.5, 3)
        return cls(mesh, (first - path.mean(axis=0)) * [1, 0, 1] + path, heading)

    def at(self, frame: int) -> Mesh:
        """The thing in a frame."""
        turn = about_vertical(self.headings[frame : frame + 1])[0]
        return self.mesh.placed(turn, self.places[frame])


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
    view: _Drawing
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
    light = _light(room, generator)
    scale = int(generator.choice(LONGER_SIDE_PX)) / 2.0
    shape = np.ceil(2 * camera.half * scale).astype(int)
    view = _Drawing(camera, scale * camera.focal, shape / 2 - 0.5, (int(shape[1]), int(shape[0])))
    return Film(actors, things, moving, middle, room, light, _lamps(generator), materials, view,
                int(generator.integers(1 << 30)))  # fmt: skip


def _companion(
    motions: Motions,
    people: Sequence[Person],
    middle: NDArray[np.float64],
    materials: Materials,
    generator: Generator,
) -> Actor:
    """Another person, who walks or stands nearby."""
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
        camera = sample_camera(target, 0.0, generator, close=False)
        if generator.random() < OVERHEAD:
            place = target + np.array(
                [*generator.normal(0, 0.5, 1), 0, *generator.normal(0, 0.5, 1)]
            )
            place[1] = generator.uniform(2.6, 4.5)
            turn = aimed_at(
                target - place, generator.uniform(-0.3, 0.3, 2), float(generator.uniform(0, 6.28))
            )
            camera = Camera(place, turn, float(generator.uniform(0.6, 1.2)), camera.half)
        if np.linalg.norm(camera.place - target) > 1.8:
            return camera


def film_of(motions: Motions, people: Sequence[Person], seed: int, number: int) -> Film:
    """The film of a number, which does not depend on those made before it."""
    generator = np.random.default_rng([seed, number])
    while True:
        film = take(motions, people, generator)
        if film is not None:
            return film


def observed(film: Film, session: CameraSession, pairs: Pairs) -> dict[str, NDArray[Any]]:
    """What the session says of a film.

    ``rows``: per person and frame, joints in camera axes and the answer there. ``tracks``
    ``(K, 20)``: per frame and tracked person, the frame, the identity, which person it is or -1,
    and :meth:`app.tracking.falls.Observation.row`. ``left`` ``(L, 2)``: identities with the time at
    which they were let go. ``pairs`` are :meth:`scripts.training.identity_pairs.Pairs.rows`.
    """
    width, height = film.size
    camera, focal_px = film.view.camera, film.view.scale
    down_axis = camera.rotation @ np.array([0.0, -1.0, 0.0])
    centre = np.array([width, height]) / 2 - 0.5
    rows, tracks, left = [], [], []
    for number in range(len(film)):
        seen = [camera.seen(actor.joints[min(number, len(actor.joints) - 1)])
                for actor in film.actors]  # fmt: skip
        true = [_box_of(joints, focal_px, centre) for joints in seen]
        pairs.truth[number / RATE] = true
        upload = Upload(encoded(film.picture(number)))
        frame = session.process(upload, number / RATE, 0, Job())
        for who, (box, joints) in enumerate(zip(true, seen, strict=True)):
            shown = [one for one in frame.persons if _is_shown_by(box, one)]
            answer = np.full(17, np.nan)
            if shown:
                answer = _answer(shown[int(np.argmax([one.box.iou(box) for one in shown]))])
            rows.append(
                np.concatenate(
                    [[number, who, focal_px, width, height], down_axis, joints.ravel(), answer]
                )
            )
        for person in frame.persons:
            overlaps = [box.iou(person.box) * _is_shown_by(box, person) for box in true]
            who = int(np.argmax(overlaps)) if any(overlaps) else -1
            if person.source != "track" and person.frame_posture is not None:
                row = _observation(person, frame.persons, (height, width)).row()
                tracks.append([number, person.track_id, who, *row])
        left += [
            [event.track_id, event.timestamp] for event in frame.events if event.event == "left"
        ]
    moments = [(actor.motion.falls, actor.motion.down) for actor in film.actors[:1]]
    fell = [
        -1.0 if moment is None else (moment - FIRST_FRAME) / 30
        for moment in (*moments, (None, None))[0]
    ]
    return {"rows": np.array(rows), "tracks": np.array(tracks), "left": np.array(left),
            "fell": np.array(fell), "kind": np.array(film.kind),
            "pairs": pairs.rows()}  # fmt: skip


def _box_of(joints: NDArray[np.float64], focal_px: float, centre: NDArray[np.float64]) -> Box:
    """The box about joints ``(24, 3)`` in camera axes."""
    places = joints[:, :2] / np.maximum(joints[:, 2:], 0.05) * focal_px + centre
    return Box.from_edges(*places.min(axis=0), *(places.max(axis=0) + 1))


def _is_shown_by(box: Box, person: TrackedPerson) -> bool:
    return box.iou(person.box) > 0.15 and person.source != "track"


def _observation(
    person: TrackedPerson, persons: Sequence[TrackedPerson], shape: tuple[int, int]
) -> Observation:
    """What the model of falls sees of a person, as in a session."""
    others = [one for one in persons if one is not person and one.source != "track"]
    covered = max((one.box.intersection(person.box) / person.box.area for one in others), default=0)
    return Observation.of(person, shape, covered)


def _answer(person: TrackedPerson) -> NDArray[np.float64]:
    """Identity, box, hips, posture, presence and trust of a person: 17 numbers."""
    box = person.box
    hips = (
        np.nan if person.landmarks is None else float(person.landmarks.positions[_HIPS, 1].mean())
    )
    posture = (
        np.full(6, np.nan) if person.frame_posture is None else person.frame_posture.probabilities
    )
    trust = (np.nan, np.nan) if person.trust is None else (person.trust.person, person.trust.right)
    presence = np.nan if person.presence is None else person.presence
    return np.array(
        [
            person.track_id,
            box.x,
            box.y,
            box.width,
            box.height,
            hips,
            *posture,
            presence,
            *trust,
            person.detection_score or 0.0,
            person.age_frames,
        ]
    )


def films(options: argparse.Namespace) -> Iterator[tuple[Path, Film]]:
    """The films that are not there yet, with their files."""
    count = HELD_OUT_PEOPLE if options.held_out else PEOPLE
    people = cast(count, options.seed, options.shared / "garments", held_out=options.held_out)
    motions = Motions.open(options.shared / "mocap", people[0].avatar, held_out=options.held_out)
    for number in tqdm(range(options.first, options.first + options.count), unit="film"):
        file = options.out / f"film-{number:04d}.npz"
        if not file.exists():
            yield file, film_of(motions, people, options.seed, number)


def contact_sheet(shown: Sequence[Film], side: int = 150) -> NDArray[np.uint8]:
    """Six frames of each film, four films a row."""
    strips = []
    for film in shown:
        cells = []
        for number in np.linspace(0, len(film) - 1, 6).astype(int):
            cell, image = np.zeros((side, side, 3), np.uint8), film.picture(int(number))
            scale = side / max(image.shape[:2])
            small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)[
                :side, :side
            ]
            cell[: small.shape[0], : small.shape[1]] = small
            cells.append(cell)
        cv2.putText(cells[0], film.kind, (3, 12), 0, 0.4, (0, 255, 255), 1)
        strips.append(np.hstack(cells))
    half = (len(strips) + 1) // 2
    return np.hstack([np.vstack(strips[:half]), np.vstack(strips[half:])])


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--shared", type=Path, default=ROOT.parent / "shared")
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    parser.add_argument("--count", type=int, default=80, help="films")
    parser.add_argument("--first", type=int, default=0, help="number of the first film")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--held-out", action="store_true", help="held-out clips, bodies and garments"
    )
    parser.add_argument("--sheet", type=Path, help="draw the films into this file instead")
    options = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    options.out.mkdir(parents=True, exist_ok=True)
    if options.sheet is not None:
        cv2.imwrite(str(options.sheet), contact_sheet([film for _, film in films(options)]))
        return
    estimator = load_estimator(Settings())
    for file, film in films(options):
        unfinished = file.with_suffix(".part.npz")
        with recorded_pairs() as pairs:
            arrays: dict[str, Any] = observed(film, CameraSession(estimator), pairs)
        np.savez_compressed(unfinished, **arrays)
        unfinished.rename(file)
