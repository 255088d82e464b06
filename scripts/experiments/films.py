"""All real films as camera sessions: falls, false alarms and postures, by kind and source.

The films of ``../shared/real`` together are the development set. Whole films are sent as a caller
would send them, and no frame is held at the end: what a film does not show, its session does not
see. ``--log FOLDER`` keeps the answers to each film, so that an interrupted run goes on.
"""

import argparse
import dataclasses
import json
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from app.camera import CameraSession
from app.photograph import Estimator, load_estimator
from app.settings import Settings
from index import posture
from scripts.datasets import FILM_KINDS, LOW, SITTING, UPRIGHT, Film, real_films
from scripts.helpers import track
from scripts.metrics import percent

EARLY_S = 0.3
"""Seconds by which the labelled beginning of a fall may be late."""

ANSWERS = {SITTING: ("sitting",), LOW: posture.ON_THE_GROUND, UPRIGHT: posture.UPRIGHT}
"""Labels that answer each truth."""

EVENTS = ("fell", "lying", "entered")

Figures = dict[str, Any]


@dataclass
class Watched:
    """A session's answers to a film: what began or happened and when, and postures.

    Answers are pairs of the true posture and the label of the largest person; ``on_floor`` has the
    times at which ``lying`` began, with its probability of the floor if that is known.
    """

    seconds: float = 0.0
    events: list[tuple[float, str]] = field(default_factory=list)
    answers: list[tuple[str, str | None]] = field(default_factory=list)
    on_floor: list[tuple[float, float | None]] = field(default_factory=list)

    def said(self, event: str) -> list[float]:
        """When an event began or happened."""
        return [at for at, name in self.events if name == event]


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Add this experiment's options to the command line."""
    parser.add_argument("--fps", type=float, default=5.0, help="frames sent a second (default: 5)")
    parser.add_argument("--log", type=Path, help="folder that keeps the answers to each film")


def run(options: argparse.Namespace) -> Figures:
    """Watch all films."""
    films = list(real_films(options.shared / "real"))
    watched = list(zip(films, _all_watched(films, options.fps, options.log), strict=True))
    return {
        "fps": options.fps,
        "films": len(films),
        "events": {kind: summarise(watched, kind) for kind in FILM_KINDS},
        "sources": by_source(watched),
        "on_floor": on_floor(watched),
        "ordinary": ordinary(watched),
        "postures": postures(watched),
    }


def _all_watched(films: Iterable[Film], fps: float, log: Path | None) -> Iterator[Watched]:
    estimator = load_estimator(Settings())
    for film in tqdm(films, unit="film"):
        kept = None if log is None else log / f"{film.source}-{film.name}.json"
        if kept is not None and kept.exists():
            yield Watched(**json.loads(kept.read_text()))
            continue
        seen = watch(estimator, film, fps)
        if kept is not None:
            kept.parent.mkdir(parents=True, exist_ok=True)
            unfinished = kept.with_suffix(".part")
            unfinished.write_text(json.dumps(dataclasses.asdict(seen)))
            unfinished.rename(kept)
        yield seen


def watch(estimator: Estimator, film: Film, fps: float) -> Watched:
    """Send a film, at most ``fps`` frames a second, to a session of its own."""
    session, seen = CameraSession(estimator), Watched()
    for at, frame in film.frames(fps):
        reply = track(session, frame, round(at, 3), 0)
        seen.seconds = at
        seen.events += [(at, one.event) for one in reply.events if one.state != "end"]
        lying = [one for one in reply.events if (one.event, one.state) == ("lying", "begin")]
        seen.on_floor += [(at, one.on_floor) for one in lying]
        truth = film.truth(at)
        if truth is not None and reply.persons:
            largest = max(reply.persons, key=lambda one: one.box.area)
            found = largest.posture
            seen.answers.append((truth, found.label if found else None))
    return seen


def summarise(watched: Iterable[tuple[Film, Watched]], kind: str) -> Figures:
    """Films of a kind, and the share in which ``fell`` and ``lying`` are reported."""
    films = [pair for pair in watched if pair[0].kind == kind]

    def said(event: str) -> list[list[float]]:
        """Delays after a fall has begun; in other films the times."""
        delays = [[at - (film.fall or 0.0) for at in seen.said(event)] for film, seen in films]
        return [[at for at in times if at > -EARLY_S] for times in delays]

    fell, lying = said("fell"), said("lying")
    delays = [times[0] for times in fell if times]
    return {
        "films": len(films),
        "fell": percent([bool(times) for times in fell]) if films else None,
        "lying": percent([bool(times) for times in lying]) if films else None,
        "either": percent([bool(a or b) for a, b in zip(fell, lying, strict=True)])
        if films
        else None,
        "delay_s": float(np.median(delays)) if delays and films[0][0].fall is not None else None,
    }


def on_floor(watched: Iterable[tuple[Film, Watched]]) -> Figures:
    """Films in which ``lying`` begins, on the floor after a fall or on a bed, and says where."""
    figures: Figures = {}
    for kind in ("fall", "in_bed"):
        said = [
            [p for at, p in seen.on_floor if at > (film.fall or 0.0) - EARLY_S]
            for film, seen in watched
            if film.kind == kind
        ]
        known = [[p for p in one if p is not None][:1] for one in said]
        decided = [p >= 0.8 if kind == "fall" else p <= 0.2 for one in known for p in one]
        figures[kind] = {
            "films": sum(map(bool, said)),
            "known": len(decided),
            "right": percent(decided) if decided else None,
        }
    return figures


def by_source(watched: Iterable[tuple[Film, Watched]]) -> Figures:
    """The same by source and kind."""
    groups: dict[str, list[tuple[Film, Watched]]] = defaultdict(list)
    for film, seen in watched:
        groups[film.source].append((film, seen))
    return {
        source: {kind: found for kind in FILM_KINDS if (found := summarise(films, kind))["films"]}
        for source, films in sorted(groups.items())
    }


def ordinary(watched: Iterable[tuple[Film, Watched]]) -> Figures:
    """Events of films in which nobody falls or lies, and as many an hour."""
    films = [seen for film, seen in watched if film.kind == "ordinary"]
    hours = sum(seen.seconds for seen in films) / 3600
    counts = {event: sum(len(seen.said(event)) for seen in films) for event in EVENTS}
    an_hour = {event: count / max(hours, 1e-9) for event, count in counts.items()}
    return {"films": len(films), "minutes": 60 * hours, "counts": counts, "an_hour": an_hour}


def postures(watched: Iterable[tuple[Film, Watched]]) -> Figures:
    """Frames by source and truth: the share right and wrong; others are unclear."""
    rows: dict[str, dict[str, list[str | None]]] = defaultdict(lambda: defaultdict(list))
    for film, seen in watched:
        for truth, label in seen.answers:
            rows[film.source][truth].append(label)
    figures: Figures = {}
    for source, truths in sorted(rows.items()):
        for truth, labels in sorted(truths.items()):
            right = np.array([label in ANSWERS[truth] for label in labels])
            unclear = np.array([label in ("unclear", None) for label in labels])
            figures.setdefault(source, {})[truth.replace(" ", "_")] = {
                "frames": len(labels),
                "right": percent(right),
                "wrong": percent(~right & ~unclear),
            }
    return figures
