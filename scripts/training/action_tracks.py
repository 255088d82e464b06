"""Tracks of subjects that the index does not know: filmed motion and simulated falls, matched.

The entries of a group of subjects are removed from the shipped index. These subjects are then
filmed, on avatars that it does not know either, and matched frame by frame, from silhouettes alone.
Descriptor and confidence stay those that were learned on all clips.
"""

from __future__ import annotations

import pickle
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.estimation.results import Person
from app.tracking.actions import PoseSample
from app.tracking.motion import Motion
from app.tracking.smoothing import Smoothed
from index.artefact import load_index
from index.posture import classify_postures
from index.search import ExactNeighbours
from index.skeleton import BODY_UP
from index.store import PoseIndex
from scripts.filming import CLIP_FPS, FPS, Filmed, film_stretch, unbroken_stretches
from scripts.helpers import Follower, match_silhouettes
from scripts.index.body import Avatar
from scripts.index.builder import CALIBRATION_AVATARS, HELD_OUT_AVATARS
from scripts.index.garments import make_avatars
from scripts.index.motion import Clip, Segment, read_manifest
from scripts.index.poses import Poses, read_poses
from scripts.training.action_model import (
    ACTIONS,
    COPIES,
    SEED,
    SEVERAL_ACTIONS,
    SHORTEST_S,
    Windows,
    joined_windows,
    make_windows,
    read_motions,
    windows_of,
)

LEFT_OUT_TOGETHER = (
    ("13",),
    ("14",),
    ("131", "m2m", "dm"),
    ("01", "02", "86", "unknown"),
    ("03", "05", "07", "09", "16", "17", "49"),
    ("11", "64", "85", "127", "135", "141"),
)
"""Subjects removed from the index at a time; 13 and 14 do the same exercises."""

HYPOTHESES = 20
LONGEST_S = 6.0
MOST_OF_A_KIND = 4
"""Most stretches of one action of one subject."""

FALL = "fall"
TIPPED = 20
"""Number of simulated falls."""

TIPPED_ACTIONS = ("jumping-jack", "punch", "stand", "twist", "walk")
BEFORE_S, AFTER_S = 2.0, 4.0
FALL_S = (0.6, 1.2)
RECORDED_FALLS = {"m2m_Death01": 1, "dm_getup_faceup": -1}
"""Clips, played forwards or backwards, each filmed by :data:`CAMERAS_OF_RECORDED` cameras."""

CAMERAS_OF_RECORDED = 4


@dataclass(frozen=True)
class Track:
    """A person over time, as the service would see them.

    ``posture`` ``(F,)`` is that of the true skeletons and their true speed, as positions in
    ``POSTURES``; ``people`` are the frames' answers, without their silhouettes.
    """

    clip: str
    subject: str
    action: str
    timestamps: NDArray[np.float64]
    posture: NDArray[np.int64]
    people: tuple[Person, ...]
    smoothed: tuple[tuple[Motion, Smoothed], ...]


@dataclass(frozen=True)
class Cast:
    """Motion clips, the subject of each, and the avatars that play them."""

    motion: Path
    segments: list[Segment]
    avatars: list[Avatar]

    @classmethod
    def read(cls, shared: Path) -> Cast:
        """Read the clips, and make avatars that the index does not know."""
        avatars = make_avatars(HELD_OUT_AVATARS, shared / "garments")
        return cls(shared / "mocap", read_manifest(shared / "mocap"), avatars)

    @property
    def subjects(self) -> dict[str, str]:
        """Subject by clip."""
        return {segment.clip: segment.subject for segment in self.segments}

    def poses(self, wanted: Callable[[Segment], bool]) -> Poses:
        """Read the poses of some segments."""
        return read_poses(self.motion, [one for one in self.segments if wanted(one)])[0]


def read_or_make_tracks(shared: Path, index: Path, file: Path | None) -> list[Track]:
    """Read tracks from a file, or make them, which takes ten minutes, and keep them there."""
    if file is not None and file.exists():
        kept: list[Track] = pickle.loads(file.read_bytes())
        return kept
    tracks = make_tracks(shared, load_index(index))
    if file is not None:
        file.write_bytes(pickle.dumps(tracks))
    return tracks


def make_tracks(shared: Path, index: PoseIndex, seed: int = 3) -> list[Track]:
    """Film all subjects of :data:`ACTIONS` and the falls, and match them."""
    cast = Cast.read(shared)
    generator = np.random.default_rng(seed)
    films = [*film_actions(cast, generator), *film_falls(cast, generator)]
    return _match_unseen(index, films, cast.subjects)


def _match_unseen(
    index: PoseIndex, films: Sequence[Filmed], subjects: dict[str, str]
) -> list[Track]:
    """Match films by an index that does not hold their subjects."""
    tracks: list[Track] = []
    with tqdm(total=sum(map(len, films)), desc="matching", unit="frame") as bar:
        for left_out in LEFT_OUT_TOGETHER:
            clips = {clip for clip, subject in subjects.items() if subject in left_out}
            shown = [film for film in films if film.subject in left_out]
            tracks += match_films(without_clips(index, clips), shown, bar.update)
    return tracks


def without_clips(index: PoseIndex, clips: set[str]) -> PoseIndex:
    """Remove the entries of some clips, and the network, which knows them, from an index."""
    known = np.array([clip not in clips for clip in index.clips])
    rows = np.flatnonzero(known[index.skeleton_labels["clip"][index.entries["skeleton"]]])
    return replace(
        index,
        vectors=ExactNeighbours(index.vectors[rows]),
        entries=index.entries[rows],
        silhouette_store=index.silhouette_store.select(rows),
        reranker=None,
    )


def film_actions(cast: Cast, generator: np.random.Generator) -> list[Filmed]:
    """Film a piece of every stretch, at most :data:`MOST_OF_A_KIND` of an action of a subject."""
    poses, subjects, avatars = cast.poses(_shows_an_action), cast.subjects, cast.avatars
    counts: Counter[tuple[str, str]] = Counter()
    films: list[Filmed] = []
    for rows in unbroken_stretches(poses):
        clip, action = poses.clips[poses.clip[rows[0]]], poses.actions[poses.action[rows[0]]]
        subject = subjects[clip.name]
        counts[subject, action] += 1
        if counts[subject, action] > MOST_OF_A_KIND or len(rows) < SHORTEST_S * CLIP_FPS:
            continue
        most = round(LONGEST_S * CLIP_FPS)
        first = int(generator.integers(max(1, len(rows) - most)))
        frames = poses.frame[rows][first : first + most : CLIP_FPS // FPS]
        avatar = avatars[len(films) % len(avatars)]
        films.append(film_stretch(clip, action, subject, frames, avatar, generator))
    return films


def film_falls(cast: Cast, generator: np.random.Generator) -> list[Filmed]:
    """Film upright people who tip over, and the recorded falls."""
    poses, subjects, avatars = cast.poses(_shows_an_action), cast.subjects, cast.avatars
    upright = [
        rows
        for rows in unbroken_stretches(poses)
        if poses.actions[poses.action[rows[0]]] in TIPPED_ACTIONS
        and len(rows) > (BEFORE_S + 0.5) * CLIP_FPS
    ]
    clips = []
    for _ in range(TIPPED):
        rows = upright[int(generator.integers(len(upright)))]
        first = int(generator.integers(max(1, len(rows) - 100)))
        clips.append(
            tipped_over(poses.clips[poses.clip[rows[0]]], poses.frame[rows[first:]], generator)
        )
    for clip in cast.poses(lambda segment: segment.clip in RECORDED_FALLS).clips:
        order = np.arange(len(clip.rotations))[:: RECORDED_FALLS[clip.name]]
        held = np.concatenate([
            np.repeat(order[:1], round(BEFORE_S * CLIP_FPS)), order,
            np.repeat(order[-1:], round(AFTER_S * CLIP_FPS)),
        ])  # fmt: skip
        still = np.zeros(len(held))
        clips += CAMERAS_OF_RECORDED * [
            replace(
                clip, rotations=clip.rotations[held], positions=clip.positions[held],
                speeds=still, broken=still > 0,
            )
        ]  # fmt: skip
    return [
        film_stretch(
            clip, FALL, subjects[clip.name],
            np.arange(len(clip.rotations)), avatars[number % len(avatars)], generator,
        )
        for number, clip in enumerate(clips)
    ]  # fmt: skip


def tipped_over(clip: Clip, frames: NDArray[np.int64], generator: np.random.Generator) -> Clip:
    """Make a subject go on as recorded, tip over about the feet, and lie, hardly moving."""
    before, after = round(BEFORE_S * CLIP_FPS), round(AFTER_S * CLIP_FPS)
    falling = int(generator.uniform(*FALL_S) * CLIP_FPS)
    ahead = np.concatenate(
        [np.arange(before + falling), before + falling + 0.15 * np.arange(after)]
    )
    shown = frames[np.minimum(ahead, len(frames) - 1).astype(int)]
    share = np.clip((np.arange(len(shown)) - before) / falling, 0, 1)
    angle = np.pi / 2 * share**2
    direction = generator.uniform(0, 2 * np.pi)
    x, z = np.cos(direction), np.sin(direction)
    skew = np.array([[0, -z, 0], [z, 0, -x], [0, x, 0]])
    turn = (
        np.eye(3)
        + np.sin(angle)[:, None, None] * skew
        + (1 - np.cos(angle))[:, None, None] * (skew @ skew)
    )
    positions = clip.positions[shown]
    feet = positions[before] * (1.0, 0.0, 1.0)
    return replace(
        clip,
        rotations=turn[:, None] @ clip.rotations[shown],
        positions=np.einsum("fij,fj->fi", turn, positions - feet) + feet,
        speeds=np.where(share > 0, 0.0, clip.speeds[shown]),
        broken=np.zeros(len(shown), bool),
    )


def match_films(
    index: PoseIndex, films: Sequence[Filmed], done: Callable[[int], object]
) -> list[Track]:
    """Match every frame and smooth the poses."""
    tracks = []
    for filmed in films:
        people = match_silhouettes(index, filmed.silhouettes, filmed.camera, HYPOTHESES)
        follower = Follower()
        smoothed = [
            follower.update(person, timestamp)
            for person, timestamp in zip(people, filmed.timestamps.tolist(), strict=True)
        ]
        seen = [replace(one, silhouette=None) for one in people]
        posture = classify_postures(filmed.world, BODY_UP, filmed.speeds)
        tracks.append(Track(
            filmed.clip, filmed.subject, filmed.action, filmed.timestamps, posture, tuple(seen),
            tuple(one for one in smoothed if one is not None),
        ))  # fmt: skip
        done(len(filmed))
    return tracks


def _shows_an_action(segment: Segment) -> bool:
    return segment.action in ACTIONS and segment.clip not in SEVERAL_ACTIONS


def track_windows(tracks: Sequence[Track]) -> tuple[list[Track], Windows]:
    """Return the tracks that show one of :data:`ACTIONS`, and their windows."""
    shown = [track for track in tracks if track.action in ACTIONS and len(track.smoothed) > FPS]
    parts = [
        windows_of([
            PoseSample.of(timestamp, smoothed.pose, motion.elevation_deg)
            for timestamp, (motion, smoothed) in zip(
                track.timestamps.tolist(), track.smoothed, strict=True
            )
        ])
        for track in shown
    ]  # fmt: skip
    return shown, Windows(
        np.concatenate(parts),
        np.repeat(np.arange(len(parts)), [len(part) for part in parts]),
        tuple(track.action for track in shown),
        tuple(track.subject for track in shown),
    )


def training_windows(shared: Path, tracks: Sequence[Track]) -> Windows:
    """Return windows of simulated skeletons, then those of tracks, which are few, three times."""
    motion = shared / "mocap"
    avatars = make_avatars(CALIBRATION_AVATARS, None)
    simulated = make_windows(read_motions(motion, read_manifest(motion), avatars), COPIES, SEED)
    return joined_windows([simulated, *3 * [track_windows(tracks)[1]]])
