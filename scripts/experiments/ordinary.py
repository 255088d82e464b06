"""Ordinary films as camera sessions, in which nobody falls: alarms and entries an hour.

Films of ``real/scenes`` of the kind ``ordinary``: streets, squares, offices, buses. Each is sent
whole to a session of its own.
"""

import argparse
from typing import Any

from tqdm import tqdm

from app.camera import CameraSession
from app.photograph import load_estimator
from app.settings import Settings
from scripts.datasets import frames_at, ordinary_films
from scripts.helpers import track

EVENTS = ("fell", "lying", "entered")
RATE = 5.0
"""Frames sent a second."""

Figures = dict[str, Any]


def run(options: argparse.Namespace) -> Figures:
    """Watch all films."""
    estimator = load_estimator(Settings())
    rows: dict[str, Figures] = {}
    for film in tqdm(list(ordinary_films(options.shared / "real")), unit="film"):
        session = CameraSession(estimator)
        counts, seconds = dict.fromkeys(EVENTS, 0), 0.0
        for seconds, frame in frames_at(film, RATE):
            for one in track(session, frame, round(seconds, 3)).events:
                if one.event in counts and one.state != "end":
                    counts[one.event] += 1
        rows[film.stem] = {"seconds": seconds, **counts}
    total = {key: sum(row[key] for row in rows.values()) for key in ("seconds", *EVENTS)}
    hours = total["seconds"] / 3600
    per_hour = {event: total[event] / hours for event in EVENTS}
    return {"rate": RATE, "films": rows, "total": total, "per_hour": per_hour}
