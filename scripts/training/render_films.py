"""Render films of falls and daily life, read by a camera session: see ``docs/training.md``.

A fixed camera, five frames a second. Writes a ``film-NNNN.npz`` for each film: the joints, the
session's answer about each person, and its tracks. The pictures are not kept; films that are in the
folder are not made again. ``--sheet FILE`` draws six frames of each film to look at instead.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.camera import CameraSession
from app.estimation.upload import Upload
from app.photograph import load_estimator
from app.scheduling.job import Job
from app.settings import Settings
from app.tracking.falls import observation_of
from app.tracking.results import TrackedPerson
from app.vision.geometry import Box
from app.vision.people import landmark_rows
from scripts.helpers import encoded
from scripts.results import ROOT
from scripts.training.identity_pairs import Pairs, recorded_pairs
from scripts.training.motions import Motions
from scripts.training.render.film import FIRST_FRAME, RATE, Film, film_of
from scripts.training.render.people import cast
from scripts.training.render_people import contact_sheet

PEOPLE, HELD_OUT_PEOPLE = 10, 5
_HIPS = landmark_rows("hip")


def observed(film: Film, session: CameraSession, pairs: Pairs) -> dict[str, NDArray[Any]]:
    """The session's answers to a film.

    ``rows``: per person and frame, joints in camera axes and the answer there. ``tracks``
    ``(K, 20)``: per frame and tracked person, the frame, the identity, which person it is or -1,
    and :meth:`app.tracking.falls.observation`. ``left`` ``(L, 2)``: identities with the time at
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
                row = _observation(person, frame.persons, (height, width))
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
) -> NDArray[np.float64]:
    """The input of the model of falls for a person, as in a session."""
    others = [one for one in persons if one is not person and one.source != "track"]
    covered = max((one.box.intersection(person.box) / person.box.area for one in others), default=0)
    return observation_of(person, shape, covered)


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
    presence = np.nan if person.next_window is None else person.presence
    return np.array([
        person.track_id, box.x, box.y, box.width, box.height, hips, *posture, presence, *trust,
        person.detection_score or 0.0, person.age_frames,
    ])  # fmt: skip


def films(options: argparse.Namespace) -> Iterator[tuple[Path, Film]]:
    """The films that are not there yet, with their files."""
    count = HELD_OUT_PEOPLE if options.held_out else PEOPLE
    people = cast(count, options.seed, options.shared / "garments", held_out=options.held_out)
    motions = Motions.open(options.shared / "mocap", people[0].avatar, held_out=options.held_out)
    for number in tqdm(range(options.first, options.first + options.count), unit="film"):
        file = options.out / f"film-{number:04d}.npz"
        if not file.exists():
            yield file, film_of(motions, people, options.seed, number)


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
        shown = [
            (film.kind, film.picture(int(number)))
            for _, film in films(options)
            for number in np.linspace(0, len(film) - 1, 6)
        ]
        cv2.imwrite(str(options.sheet), contact_sheet(shown, 150, 12))
        return
    estimator = load_estimator(Settings())
    for file, film in films(options):
        unfinished = file.with_suffix(".part.npz")
        with recorded_pairs() as pairs:
            arrays: dict[str, Any] = observed(film, CameraSession(estimator), pairs)
        np.savez_compressed(unfinished, **arrays)
        unfinished.rename(file)
