"""Tracks of people whom the index does not know: filmed motion and simulated falls, matched.

The index is the shipped one without the entries of a group of subjects, who are then filmed, on the
avatars that it does not know either, and matched frame by frame, from silhouettes alone. Its
descriptor and confidence stay those that were learned on all clips.
"""

from __future__ import annotations

import pickle
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.estimation.estimator import fit_poses, normalise_person
from app.estimation.results import ObservedPerson, Person
from app.tracking.action_features import Measured
from app.tracking.smoothing import PoseSmoother, Smoothed
from app.vision.geometry import Silhouette
from index.artefact import load_index
from index.build.body import Avatar
from index.build.garments import make_avatars
from index.build.motion import Clip, Segment, read_manifest
from index.build.poses import Poses, read_poses
from index.build.splits import CALIBRATION_AVATARS, HELD_OUT_AVATARS
from index.posture import classify
from index.skeleton import BODY_UP
from index.store import PoseIndex
from scripts.experiments.action_model import (
    ACTIONS,
    COPIES,
    SEED,
    SEVERAL_ACTIONS,
    SHORTEST_S,
    Windows,
    make_windows,
    merged,
    read_motions,
    windows_of,
)
from scripts.experiments.sequences import (
    CLIP_FPS,
    FPS,
    Filmed,
    film,
    film_stretch,
    unbroken_stretches,
)

LEFT_OUT_TOGETHER = (
    ("13",),
    ("14",),
    ("131", "m2m", "dm"),
    ("01", "02", "86", "unknown"),
    ("03", "05", "07", "09", "16", "17", "49"),
    ("11", "64", "85", "127", "135", "141"),
)
"""Subjects who are taken out of the index at a time; 13 and 14 do the same exercises."""

HYPOTHESES = 20
LONGEST_S = 6.0
MOST_OF_A_KIND = 4
"""Stretches of one action of one subject."""

FALL = "fall"
TIPPED = 20
"""Simulated falls of people who stand, walk or exercise."""

TIPPED_ACTIONS = ("jumping-jack", "punch", "stand", "twist", "walk")
BEFORE_S, AFTER_S = 2.0, 4.0
FALL_S = (0.6, 1.2)
RECORDED_FALLS = {"m2m_Death01": 1, "dm_getup_faceup": -1}
"""Clips, played forwards or backwards, each filmed by :data:`CAMERAS_OF_RECORDED` cameras."""

CAMERAS_OF_RECORDED = 4

OTHER_FPS = 5
ACROBATICS = ("breakdance", "cartwheel", "fall", "flip", "roll")
"""Actions in which people throw themselves down, so that a fall told is hardly false."""


@dataclass(frozen=True)
class Track:
    """A person over time, as the service would see them.

    Parameters
    ----------
    clip, subject, action : str
    timestamps : (F,) float64 array
        Seconds.
    posture : (F,) int64 array
        Of the true skeletons, with the true speed.
    people : tuple of Person
        Without their silhouettes.
    smoothed : tuple of Smoothed
    """

    clip: str
    subject: str
    action: str
    timestamps: NDArray[np.float64]
    posture: NDArray[np.int64]
    people: tuple[Person, ...]
    smoothed: tuple[Smoothed, ...]


def read_or_make_tracks(shared: Path, index: Path, file: Path | None) -> list[Track]:
    """Read tracks that were kept, or make them, which takes ten minutes, and keep them."""
    if file is not None and file.exists():
        kept: list[Track] = pickle.loads(file.read_bytes())
        return kept
    tracks = make_tracks(shared, load_index(index))
    if file is not None:
        file.write_bytes(pickle.dumps(tracks))
    return tracks


def make_tracks(shared: Path, index: PoseIndex, seed: int = 3) -> list[Track]:
    """Film all subjects of :data:`ACTIONS` and those who fall, and match them."""
    motion = shared / "mocap"
    segments = read_manifest(motion)
    subjects = {segment.clip: segment.subject for segment in segments}
    avatars = make_avatars(HELD_OUT_AVATARS, shared / "garments")
    generator = np.random.default_rng(seed)
    films = film_actions(motion, segments, subjects, avatars, generator)
    films += film_falls(motion, segments, subjects, avatars, generator)
    return _match_unseen(index, films, subjects)


def make_others(shared: Path, index: PoseIndex, seed: int = 4) -> list[Track]:
    """Film all motion but falls and :data:`ACROBATICS`, and match it."""
    motion = shared / "mocap"
    segments = read_manifest(motion)
    subjects = {segment.clip: segment.subject for segment in segments}
    avatars = make_avatars(HELD_OUT_AVATARS, shared / "garments")
    poses, _ = read_poses(motion, [s for s in segments if s.action not in ACROBATICS])
    return _match_unseen(index, film(poses, subjects, avatars, seed, fps=OTHER_FPS), subjects)


def _match_unseen(
    index: PoseIndex, films: Sequence[Filmed], subjects: dict[str, str]
) -> list[Track]:
    """Match films by an index that does not hold their subjects."""
    tracks: list[Track] = []
    with tqdm(total=sum(map(len, films)), desc="matching", unit="frame") as bar:
        for left_out in LEFT_OUT_TOGETHER:
            clips = {clip for clip, subject in subjects.items() if subject in left_out}
            asked = [film for film in films if film.subject in left_out]
            tracks += match_films(without_clips(index, clips), asked, bar.update)
    return tracks


def without_clips(index: PoseIndex, clips: set[str]) -> PoseIndex:
    """The index without the entries of some clips, and without the network, which knows them."""
    known = np.array([clip not in clips for clip in index.clips])
    rows = np.flatnonzero(known[index.skeleton_labels["clip"][index.entries["skeleton"]]])
    return replace(
        index,
        vectors=index.vectors[rows].astype(np.float32),
        entries=index.entries[rows],
        silhouette_store=index.silhouette_store.select(rows),
        reranker=None,
    )


def film_actions(
    motion: Path,
    segments: Sequence[Segment],
    subjects: dict[str, str],
    avatars: Sequence[Avatar],
    generator: np.random.Generator,
) -> list[Filmed]:
    """A piece of every stretch, of no more than some of an action by a subject."""
    poses = _poses(motion, segments)
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


def film_falls(
    motion: Path,
    segments: Sequence[Segment],
    subjects: dict[str, str],
    avatars: Sequence[Avatar],
    generator: np.random.Generator,
) -> list[Filmed]:
    """Upright people tipped over, and the recorded falls."""
    poses = _poses(motion, segments)
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
    recorded, _ = read_poses(motion, [s for s in segments if s.clip in RECORDED_FALLS])
    for clip in recorded.clips:
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
    """Somebody who goes on as recorded, tips over about their feet, and lies, hardly moving."""
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
    """Match every frame and smooth what was found."""

    def matched(silhouette: Silhouette) -> Person:
        observed = ObservedPerson(silhouette.box, "mask", None, silhouette)
        return fit_poses(index, observed, normalise_person(observed), HYPOTHESES)

    tracks = []
    with ThreadPoolExecutor(2) as pool:
        for film in films:
            people = list(pool.map(matched, film.silhouettes))
            smoother = PoseSmoother()
            smoothed = [
                smoother.update(person, timestamp)
                for person, timestamp in zip(people, film.timestamps.tolist(), strict=True)
            ]
            tracks.append(Track(
                film.clip, film.subject, film.action, film.timestamps,
                classify(film.world, BODY_UP, film.speeds),
                tuple(
                    replace(person, observed=replace(person.observed, silhouette=None))
                    for person in people
                ),
                tuple(s for s in smoothed if s is not None),
            ))  # fmt: skip
            done(len(film))
    return tracks


def _poses(motion: Path, segments: Sequence[Segment]) -> Poses:
    wanted = [s for s in segments if s.action in ACTIONS and s.clip not in SEVERAL_ACTIONS]
    return read_poses(motion, wanted)[0]


def track_windows(tracks: Sequence[Track]) -> tuple[list[Track], Windows]:
    """The tracks that show one of :data:`ACTIONS`, and their windows."""
    shown = [track for track in tracks if track.action in ACTIONS and len(track.smoothed) > FPS]
    parts = [
        windows_of([
            Measured.of(timestamp, smoothed)
            for timestamp, smoothed in zip(
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
    """Windows of simulated skeletons, then those of tracks, which are few, three times."""
    motion = shared / "mocap"
    avatars = make_avatars(CALIBRATION_AVATARS, None)
    simulated = make_windows(read_motions(motion, read_manifest(motion), avatars), COPIES, SEED)
    return merged([simulated, *3 * [track_windows(tracks)[1]]])
