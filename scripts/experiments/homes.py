"""Films of homes as camera sessions: falls, false alarms and postures by source.

Whole films are sent as a caller would send them, and no frame is held at the end: what a film does
not show, its session does not see.
"""

import argparse
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from tqdm import tqdm

from app.camera import CameraSession
from app.photograph import Estimator, load_estimator
from app.settings import Settings
from index import posture
from scripts.datasets import LOW, SITTING, UPRIGHT, HomeFilm, home_films
from scripts.helpers import track
from scripts.metrics import percent

EARLY_S = 0.3
"""Seconds by which the labelled beginning of a fall may be late."""

KINDS = ("fall", "out_of_bed", "in_bed", "activity")
"""What films are a test of."""

ANSWERS = {SITTING: ("sitting",), LOW: posture.ON_THE_GROUND, UPRIGHT: posture.UPRIGHT}
"""Labels that answer each truth."""

Figures = dict[str, Any]


@dataclass
class Watched:
    """A session's answers to a film: what began or happened and when, and postures.

    Answers are pairs of the true posture and the label of the largest person.
    """

    film: HomeFilm
    events: list[tuple[float, str]] = field(default_factory=list)
    answers: list[tuple[str, str | None]] = field(default_factory=list)

    def said(self, event: str) -> list[float]:
        """When an event began or happened."""
        return [at for at, name in self.events if name == event]

    @property
    def kind(self) -> str | None:
        """What the film is a test of; None for people who crawl or lie from the beginning."""
        about, bed = self.film.about, self.film.source == "T2V-Bed-Fall"
        if self.film.fall is not None:
            return "out_of_bed" if bed else "fall"
        if bed or "laying" in about:
            return "in_bed"
        return None if "crawl" in about or "imm" in about else "activity"


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Add this experiment's options to the command line."""
    parser.add_argument("--fps", type=float, default=6.0, help="frames sent a second (default: 6)")


def run(options: argparse.Namespace) -> Figures:
    """Watch all films."""
    estimator = load_estimator(Settings())
    films = list(home_films(options.shared / "real"))
    watched = [watch(estimator, film, options.fps) for film in tqdm(films, unit="film")]
    return {
        "fps": options.fps,
        "events": {kind: summarise(watched, kind) for kind in KINDS},
        "sources": by_source(watched),
        "postures": postures(watched),
    }


def watch(estimator: Estimator, film: HomeFilm, fps: float) -> Watched:
    """Send a film, at most ``fps`` frames a second, to a session of its own."""
    session, seen = CameraSession(estimator), Watched(film)
    for at, frame in film.frames(fps):
        reply = track(session, frame, round(at, 3))
        seen.events += [(at, one.event) for one in reply.events if one.state != "end"]
        truth = film.truth(at)
        if truth is not None and reply.persons:
            largest = max(reply.persons, key=lambda one: one.box.area)
            found = largest.posture
            seen.answers.append((truth, found.label if found else None))
    return seen


def summarise(watched: Iterable[Watched], kind: str) -> Figures:
    """Films of a kind, and the share in which ``fell`` and ``lying`` are reported."""
    films = [one for one in watched if one.kind == kind]
    # After a fall has begun; in other films at any time.
    fell = [[at - (one.film.fall or 0.0) for at in one.said("fell")] for one in films]
    detected = [[at for at in times if at > -EARLY_S] for times in fell]
    delays = [times[0] for times in detected if times]
    return {
        "films": len(films),
        "fell": percent([bool(times) for times in detected]) if films else None,
        "lying": percent([bool(one.said("lying")) for one in films]) if films else None,
        "delay_s": float(np.median(delays)) if delays and films[0].film.fall is not None else None,
    }


def by_source(watched: Iterable[Watched]) -> Figures:
    """The same by source and kind."""
    groups: dict[str, list[Watched]] = defaultdict(list)
    for one in watched:
        groups[one.film.source].append(one)
    return {
        source: {kind: found for kind in KINDS if (found := summarise(films, kind))["films"]}
        for source, films in sorted(groups.items())
    }


def postures(watched: Iterable[Watched]) -> Figures:
    """Frames by source and truth: the share right and wrong; others are unclear."""
    rows: dict[str, dict[str, list[str | None]]] = defaultdict(lambda: defaultdict(list))
    for one in watched:
        for truth, label in one.answers:
            rows[one.film.source][truth].append(label)
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
