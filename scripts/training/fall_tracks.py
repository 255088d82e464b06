"""Tracks of people without pictures: skeletons projected, with the errors of a camera session.

The session's errors come from rendered films (``python -m scripts render-films``): the answer to a
skeleton is the answer to a rendered person who looked alike (direction of trunk, thighs and shanks
against the camera, size), mostly of the same film from frame to frame, so that errors last. People
cover each other, things cover them, the frame cuts them; identities are lost, begin again, and are
exchanged where people cross.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from app.tracking.falls import observation
from app.vision.geometry import Box
from index.skeleton import JOINT_NAMES
from scripts.index.body import about_vertical
from scripts.training.motion_library import RATE, Library
from scripts.training.render.cameras import Camera, aimed_at, sample_camera

STEPS = (1, 1, 2, 2, 3, 3, 3, 4, 5, 7)
"""Steps between the frames that a camera sends, of 15 a second: 15 to 2 are sent, mostly 5."""

LOST_AFTER_S = (0.5, 2.0)
"""Time after which a session lets a person go: at the frame's border, and elsewhere."""

_WATCHED_BEFORE, _UNSEEN = 0.4, 0.2
"""Shares of scenes watched before anybody comes, and of people who are not found from the start."""

_NEIGHBOURS = 8
# Chance of a neighbour of the same film against one of another.
_SAME_FILM = 12.0
_PAIRS = [(JOINT_NAMES.index(a), JOINT_NAMES.index(b)) for a, b in (
    ("pelvis", "neck"), ("left_hip", "left_knee"), ("right_hip", "right_knee"),
    ("left_knee", "left_ankle"), ("right_knee", "right_ankle"))]  # fmt: skip


def looks(
    joints: NDArray[np.floating], size_px: NDArray[np.floating], inside: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Features ``(N, 11)`` to compare people by, from joints ``(N, 24, 3)`` in camera axes."""
    bones = np.stack([joints[:, b] - joints[:, a] for a, b in _PAIRS], axis=1)
    bones /= np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), 1e-6)
    thighs, shanks = bones[:, 1:3].mean(axis=1), bones[:, 3:5].mean(axis=1)
    return np.concatenate(
        [1.5 * bones[:, 0], thighs, shanks, 0.5 * np.log(np.maximum(size_px, 8))[:, None],
         1.5 * inside[:, None]], axis=1
    )  # fmt: skip


def boxes_of(
    joints: NDArray[np.floating], focal: float, shape: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Boxes ``(N, 4)`` about joints, by edges; their places ``(N, 24, 2)``; which are in view."""
    depth = np.maximum(joints[..., 2:], 0.05)
    places = joints[..., :2] / depth * focal + np.array(shape[::-1]) / 2 - 0.5
    shown = (joints[..., 2] > 0.1) & ((places > -0.5) & (places < np.array(shape[::-1]) - 0.5)).all(
        axis=-1
    )
    return np.concatenate([places.min(axis=1), places.max(axis=1)], axis=1), places, shown


@dataclass(frozen=True)
class Eyes:
    """Answers of the session to rendered people, searched by their looks.

    ``errors`` ``(N, 4)`` are those of the edges of the box in sizes of the body, ``hips`` ``(N,)``
    the height of the hips in it; NaN where the person was not found. ``posture`` ``(N, 6)``.
    """

    tree: cKDTree
    film: NDArray[np.int64]
    errors: NDArray[np.float64]
    hips: NDArray[np.float64]
    posture: NDArray[np.float64]
    right: NDArray[np.float64]

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read the rendered films of a folder."""
        parts = []
        for number, file in enumerate(sorted(folder.glob("film-*.npz"))):
            with np.load(file) as arrays:
                rows = arrays["rows"]
            if not len(rows):
                continue
            keep = _in_view(rows)
            parts.append(np.concatenate([np.full((keep.sum(), 1), 2 * number), rows[keep]], axis=1))
        rows = np.concatenate(parts)
        joints, shape = rows[:, 9:81].reshape(-1, 24, 3), rows[:, 4:6]
        boxes, inside = _projected(joints, rows[:, 3], shape)
        size = np.maximum(boxes[:, 2] - boxes[:, 0], boxes[:, 3] - boxes[:, 1])
        answer = rows[:, 81:]
        edges = np.concatenate([answer[:, 1:3], answer[:, 1:3] + answer[:, 3:5]], axis=1)
        true = np.clip(boxes, 0, np.concatenate([shape, shape], axis=1))
        presence = answer[:, 12:13]
        return cls(
            cKDTree(looks(joints, size, inside)),
            (rows[:, 0] + rows[:, 2]).astype(np.int64),
            (edges - true) / size[:, None],
            (answer[:, 5] - answer[:, 2]) / np.maximum(answer[:, 4], 1),
            answer[:, 6:12] * presence,
            answer[:, 14],
        )

    def see(self, wanted: NDArray[np.float64], generator: Generator) -> NDArray[np.int64]:
        """Rows of the answers to a person's looks ``(F, D)``, one after the other."""
        distances, rows = self.tree.query(wanted, k=_NEIGHBOURS)
        weights = np.exp(-((distances - distances[:, :1]) ** 2) / 0.08)
        chosen = np.empty(len(wanted), np.int64)
        film = -1
        for number, (near, weight) in enumerate(zip(rows, weights, strict=True)):
            weight = weight * np.where(self.film[near] == film, _SAME_FILM, 1.0)
            total = np.cumsum(weight)
            chosen[number] = near[np.searchsorted(total, generator.random() * total[-1])]
            film = self.film[chosen[number]]
        return chosen


def _projected(
    joints: NDArray[np.float64], focal: NDArray[np.float64], shape: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    places = (
        joints[..., :2] / np.maximum(joints[..., 2:], 0.05) * focal[:, None, None]
        + shape[:, None] / 2
        - 0.5
    )
    shown = (joints[..., 2] > 0.1) & ((places > -0.5) & (places < shape[:, None] - 0.5)).all(
        axis=-1
    )
    return np.concatenate([places.min(axis=1), places.max(axis=1)], axis=1), shown.mean(axis=1)


def _in_view(rows: NDArray[np.float64]) -> NDArray[np.bool_]:
    _, inside = _projected(rows[:, 8:80].reshape(-1, 24, 3), rows[:, 2], rows[:, 3:5])
    return np.asarray(inside > 0.3)


@dataclass(frozen=True)
class Track:
    """A session's observations of a person over time, and how the track ends.

    ``falls``, ``down`` are the seconds of the person's fall, ``up`` ``(K,)`` whether the trunk was
    up. ``lost_at`` is when the session let the person go; None if the film ended before. ``alone``
    says whether nobody else was seen in the person's place then. The camera is ``watched_from`` a
    time on.
    """

    times: NDArray[np.float64]
    rows: NDArray[np.float64]
    falls: float
    down: float
    up: NDArray[np.bool_]
    lost_at: float | None
    alone: bool
    watched_from: float


@dataclass(frozen=True)
class Scene:
    """A camera, and people ``(P, F, 24, 3)`` in its axes with their motions."""

    joints: NDArray[np.float64]
    motion: NDArray[np.int64]
    focal: float
    shape: tuple[int, int]
    step: int
    cover: NDArray[np.float64] | None


def home(library: Library, generator: Generator, falls: float = 0.4) -> Scene:
    """One to three people at home or on a pavement: falls, daily life, people who pass."""
    count = int(generator.choice([1, 1, 2, 3]))
    fall, daily, other = _rows(library)
    first = fall if generator.random() < falls else daily if generator.random() < 0.5 else other
    rows = [
        generator.choice(first),
        *generator.choice(other if generator.random() < 0.7 else daily, count - 1),
    ]
    middle = library.joints[rows[0], :, 0].mean(axis=0)
    places = [np.zeros(3)] + [generator.uniform(-2.5, 2.5, 3) * [1, 0, 1] for _ in rows[1:]]
    return _scene(library, rows, places, middle, generator, wide=False)


def crowd(library: Library, generator: Generator) -> Scene:
    """Five to forty people who walk, cross, meet and stand about."""
    _, _, other = _rows(library)
    count = round(np.exp(generator.uniform(np.log(5), np.log(40))))
    walks = other[np.isin(library.kinds[other], ("walk", "run"))]
    rows = [generator.choice(walks if generator.random() < 0.75 else other) for _ in range(count)]
    reach = generator.uniform(3, 14)
    places = [generator.uniform(-reach, reach, 3) * [1, 0, 1] for _ in rows]
    return _scene(library, rows, places, np.array([0.0, 0.9, 0.0]), generator, wide=True)


def _rows(library: Library) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    falls = np.isfinite(library.falls)
    from scripts.training.motions import DAILY, DROP

    daily = np.isin(library.kinds, [*DAILY, DROP])
    return np.flatnonzero(falls), np.flatnonzero(daily), np.flatnonzero(~falls & ~daily)


def _scene(
    library: Library,
    rows: Sequence[int],
    places: Sequence[NDArray[np.float64]],
    middle: NDArray[np.float64],
    generator: Generator,
    *,
    wide: bool,
) -> Scene:
    people: list[NDArray[np.float64]] = []
    for row, place in zip(rows, places, strict=True):
        turn = (
            about_vertical(np.array([generator.uniform(0, 2 * np.pi)]))[0]
            if len(people)
            else np.eye(3)
        )
        size = (
            generator.uniform(0.88, 1.08)
            if generator.random() < 0.93
            else generator.uniform(0.55, 0.8)
        )
        mirror = np.array([generator.choice([-1, 1]), 1, 1])
        people.append(size * (library.joints[row] * mirror) @ turn.T + place)
    camera = _camera(middle, generator, wide)
    rows_px = int(generator.choice([240, 360, 480, 720, 1080]))
    shape = (rows_px, round(rows_px * camera.half[0] / camera.half[1]))
    focal = camera.focal * max(shape) / 2
    cover = None
    if generator.random() < 0.3:
        # A thing in the picture that hides what is behind it: left, top, right, bottom, distance.
        low = generator.uniform([0, 0.3], [0.8, 0.9])
        high = low + generator.uniform(0.1, 0.6, 2)
        far = generator.uniform(0.6, 1.0) * np.linalg.norm(camera.place - middle)
        cover = np.array([*(low * shape[::-1]), *(high * shape[::-1]), far])
    step = int(generator.choice(STEPS))
    return Scene(camera.seen(np.array(people)), np.array(rows), float(focal), shape, step, cover)


def _camera(middle: NDArray[np.float64], generator: Generator, wide: bool) -> Camera:
    if not wide and generator.random() < 0.8:
        camera = sample_camera(middle, 0.0, generator, close=False)
        if np.linalg.norm(camera.place - middle) > 1.8:
            return camera
    base = sample_camera(middle, 0.0, generator, close=False)
    height = generator.uniform(2.3, 12) if wide else generator.uniform(2.4, 4.5)
    elevation = np.deg2rad(generator.uniform(5, 88))
    azimuth = generator.uniform(0, 2 * np.pi)
    away = min(height / np.tan(elevation), 25.0)
    place = middle + np.array([away * np.sin(azimuth), 0.0, away * np.cos(azimuth)])
    place[1] = height
    roll = generator.normal(0, 0.05) if generator.random() < 0.9 else generator.uniform(0, 6.28)
    return Camera(
        place,
        aimed_at(middle - place, generator.uniform(-0.3, 0.3, 2), float(roll)),
        base.focal,
        base.half,
    )


def tracks_of(scene: Scene, library: Library, eyes: Eyes, generator: Generator) -> list[Track]:
    """The tracks that a session would have of a scene."""
    frames = np.arange(int(generator.integers(scene.step)), scene.joints.shape[1], scene.step)
    joints = scene.joints[:, frames]
    people, count = joints.shape[:2]
    flat = joints.reshape(-1, 24, 3)
    boxes, places, shown = boxes_of(flat, scene.focal, scene.shape)
    size = np.maximum(boxes[:, 2] - boxes[:, 0], boxes[:, 3] - boxes[:, 1])
    boxes, places, shown = (
        boxes.reshape(people, count, 4),
        places.reshape(people, count, 24, 2),
        shown.reshape(people, count, 24),
    )
    in_view = shown.mean(axis=2)
    depth = joints[:, :, 0, 2]
    clear = shown.copy()
    for other in range(people):
        edges = boxes[other]
        width = edges[:, 2] - edges[:, 0]
        low, high = edges[:, :2].copy(), edges[:, 2:].copy()
        low[:, 0] += 0.2 * width
        high[:, 0] -= 0.2 * width
        inside = ((places > low[None, :, None]) & (places < high[None, :, None])).all(axis=-1)
        behind = (depth > depth[other][None] + 0.15) & (in_view[other] > 0.3)[None]
        clear &= ~(inside & behind[..., None])
    if scene.cover is not None:
        left, top, right, bottom, far = scene.cover
        inside = (
            (places[..., 0] > left)
            & (places[..., 0] < right)
            & (places[..., 1] > top)
            & (places[..., 1] < bottom)
        )
        clear &= ~(inside & (joints[..., 2] > far))
    # A session follows some people until nearly nothing of them is in the frame.
    least = generator.uniform(0.06, 0.3, (people, 1))
    seen = (clear.mean(axis=2) > least) & (size.reshape(people, count) > 14) & (depth > 0.4)
    times = frames / RATE + generator.uniform(-0.02, 0.02, count)
    observed = np.full((people, count, 17), np.nan)
    for who in range(people):
        wanted = looks(joints[who], size.reshape(people, count)[who], in_view[who])
        answer = eyes.see(wanted, generator)
        for number in np.flatnonzero(seen[who]):
            row = answer[number]
            if np.isnan(eyes.errors[row, 0]):
                continue
            visible = places[who, number][clear[who, number]]
            covered_now = clear[who, number].mean() < 0.85 * max(in_view[who, number], 0.01)
            edges = (
                np.concatenate([visible.min(axis=0), visible.max(axis=0)])
                if covered_now and generator.random() < 0.7
                else np.clip(boxes[who, number], 0, [scene.shape[1], scene.shape[0]] * 2)
            )
            edges = edges + eyes.errors[row] * size.reshape(people, count)[who, number]
            edges = np.clip(edges, -0.5, [scene.shape[1] - 0.5, scene.shape[0] - 0.5] * 2)
            if min(edges[2] - edges[0], edges[3] - edges[1]) < 4:
                continue
            box = Box.from_edges(*edges)
            hips = None if np.isnan(eyes.hips[row]) else box.y + eyes.hips[row] * box.height
            posture = np.nan_to_num(eyes.posture[row])
            observed[who, number] = observation(
                box, scene.shape, posture, float(np.nan_to_num(eyes.right[row])), hips
            )
    _cover(observed)
    _exchange(observed, generator)
    tracks: list[Track] = []
    watched_from = float(times[0])
    if generator.random() < _WATCHED_BEFORE:
        watched_from -= float(generator.exponential(8.0))
    for who in range(people):
        if generator.random() < _UNSEEN:
            observed[who, : int(generator.integers(count))] = np.nan
        motion = scene.motion[who]
        up = library.up[motion][np.minimum(frames, library.up.shape[1] - 1)]
        tracks += _tracks(
            observed, who, times, (library.falls[motion], library.down[motion]), up, watched_from,
            generator,
        )  # fmt: skip
    return tracks


def _cover(observed: NDArray[np.float64]) -> None:
    """Set the share of each box that others cover."""
    edges = observed[..., :4]
    area = (edges[..., 2] - edges[..., 0]) * (edges[..., 3] - edges[..., 1])
    covered = np.zeros(edges.shape[:2])
    for other in range(len(edges)):
        low = np.fmax(edges[..., :2], edges[other][None, :, :2])
        high = np.fmin(edges[..., 2:], edges[other][None, :, 2:])
        share = np.nan_to_num(np.prod(np.clip(high - low, 0, None), axis=-1) / area)
        share[other] = 0
        share[:, np.isnan(edges[other, :, 0])] = 0
        covered = np.maximum(covered, share)
    observed[..., 12] = np.where(np.isnan(observed[..., 0]), np.nan, covered)


def _exchange(observed: NDArray[np.float64], generator: Generator) -> None:
    """Let some tracks go on with another person where two boxes overlap."""
    for number in range(1, observed.shape[1]):
        for who in np.flatnonzero(np.nan_to_num(observed[:, number, 12]) > 0.5).tolist():
            if generator.random() > 0.03:
                continue
            centres = (observed[:, number, :2] + observed[:, number, 2:4]) / 2
            away = np.linalg.norm(centres - centres[who], axis=1)
            away[who] = np.nan
            if np.isnan(away).all():
                continue
            other = int(np.nanargmin(away))
            observed[[who, other], number:] = observed[[other, who], number:]


def _tracks(
    observed: NDArray[np.float64],
    who: int,
    times: NDArray[np.float64],
    fall: tuple[float, float],
    up: NDArray[np.bool_],
    watched_from: float,
    generator: Generator,
) -> Iterator[Track]:
    """Cut a person's observations where the session lets the person go."""
    rows = observed[who]
    known = np.flatnonzero(~np.isnan(rows[:, 0]))
    begin = 0
    for end in range(len(known)):
        last = end == len(known) - 1
        gaps = rows[known[end], 13:17]
        size = max(
            rows[known[end], 2] - rows[known[end], 0], rows[known[end], 3] - rows[known[end], 1]
        )
        patience = LOST_AFTER_S[0] if gaps.min() < 0.05 * size else LOST_AFTER_S[1]
        until = times[known[end]] + patience
        following = times[-1] + 1e3 if last else times[known[end + 1]]
        breaks = generator.random() < 0.01
        if following <= until and not breaks:
            continue
        lost_at = next((float(t) for t in times if t > until), None) if following > until else None
        part = known[begin : end + 1]
        begin = end + 1
        if len(part) < 2:
            continue
        alone = True
        if lost_at is not None:
            at = int(np.searchsorted(times, lost_at))
            edges, own = observed[:, at, :4], rows[part[-1], :4]
            meets = (np.minimum(edges[:, 2:], own[2:]) - np.maximum(edges[:, :2], own[:2]) > 0).all(
                axis=1
            )
            meets[who] = False
            alone = not meets.any()
        yield Track(times[part], rows[part], *fall, up[part], lost_at, alone, watched_from)
