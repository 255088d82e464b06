"""Ordinary films as camera sessions, in which nobody falls: alarms and entries an hour.

Films of ``real/scenes`` of the kind ``ordinary``: streets, squares, offices, buses. Each is sent
whole to a session of its own.
"""

import argparse
from pathlib import Path
from typing import Any

from tqdm import tqdm

from app.camera import CameraSession
from app.photograph import load_estimator
from app.settings import Settings
from scripts.datasets import frames_at, ordinary_films
from scripts.helpers import track

EVENTS = ("fell", "lying", "entered")

Figures = dict[str, Any]


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Add this experiment's options to the command line."""
    parser.add_argument("--films", type=Path, nargs="+", help="instead of those of real/scenes")
    parser.add_argument("--rate", type=float, default=5.0, help="frames sent a second (default: 5)")


def run(options: argparse.Namespace) -> Figures | None:
    """Watch all films; figures of films that were named are printed, not written."""
    estimator = load_estimator(Settings())
    films = options.films or list(ordinary_films(options.shared / "real"))
    rows: dict[str, Figures] = {}
    for film in tqdm(films, unit="film"):
        session = CameraSession(estimator)
        counts, seconds = dict.fromkeys(EVENTS, 0), 0.0
        for seconds, frame in frames_at(film, options.rate):
            for one in track(session, frame, round(seconds, 3)).events:
                if one.event in counts and one.state != "end":
                    counts[one.event] += 1
        rows[film.stem] = {"seconds": seconds, **counts}
    total = {key: sum(row[key] for row in rows.values()) for key in ("seconds", *EVENTS)}
    hours = total["seconds"] / 3600
    figures = {"rate": options.rate, "films": rows, "total": total} | {
        "per_hour": {event: total[event] / hours for event in EVENTS}
    }
    if options.films:
        print(figures)
        return None
    return figures
