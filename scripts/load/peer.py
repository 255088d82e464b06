"""Measure a camera's frames beside MediaPipe Pose: core-milliseconds of the whole process a frame.

Both decode the same JPEGs of 1920x1080 and read every frame, in turns. One, two and four people
balance side by side: the same film of one person, cut out and repeated. MediaPipe reads one person,
so it plays the first film alone.
"""

from __future__ import annotations

import argparse
import itertools
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from index import DEFAULT_PATH
from scripts.datasets import read_frames
from scripts.figures import report
from scripts.load.bench import (
    COUNTED,
    FILM,
    Picture,
    Task,
    back_and_forth,
    camera_calls,
    interleaved,
    people_found,
    resized,
    sender,
    summary,
)
from scripts.load.client import Client
from scripts.load.server import ServerProcess, processor_s
from scripts.results import ROOT, SHARED

PEOPLE = (1, 2, 4)
QUERIES = {"no_skeletons": "?joints=none", "default": ""}
PER_S = 30
PEER = ROOT / ".venv-peer" / "bin" / "python"
PLACES, PERSON, FLOOR = 4, np.s_[200:1280, 200:680], np.s_[1280:1920]
"""The places side by side in a frame; where the person of the film is, and where nobody is."""


def film(frames: Sequence[Picture], people: int) -> list[Picture]:
    """Return frames ``(1080, 1920, 3)`` of so many people, made of a film of one."""
    size = (480, 1080)
    return [
        np.hstack([frame[PERSON]] * people + [resized(frame[FLOOR], size)] * (PLACES - people))
        for frame in frames
    ]


class Peer:
    """MediaPipe Pose in a process of another environment, as a context manager."""

    def __init__(self, python: Path) -> None:
        command = [python, Path(__file__).with_name("mediapipe_pose.py")]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )

    def read(self, frame: bytes) -> int:
        """Return how many people it reads in a JPEG file."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(b"%d\n" % len(frame) + frame)
        self._process.stdin.flush()
        return int(self._process.stdout.readline())

    def processor_s(self) -> float:
        """Return the processor time spent so far by all threads, seconds."""
        return processor_s(self._process.pid)

    def __enter__(self) -> Peer:
        """Return itself: it has started."""
        return self

    def __exit__(self, *error: object) -> None:
        """End the process."""
        self._process.communicate()


def why_not(python: Path) -> str | None:
    """Return why MediaPipe cannot be measured there; None if it can."""
    try:
        command = [str(python), "-c", "import mediapipe"]
        subprocess.run(command, check=True, capture_output=True, text=True)
    except OSError as error:
        return str(error)
    except subprocess.CalledProcessError as error:
        return error.stderr.splitlines()[-1]
    return None


def compare(
    server: ServerProcess, peer: Peer | None, frames: Sequence[Picture], rounds: int
) -> dict[str, Any]:
    """Measure the server's sessions, and MediaPipe if there is one, in turns of a film."""
    server.wait_until_ready()
    client, films = Client(server.url), {people: film(frames, people) for people in PEOPLE}
    calls = {
        (people, query): iter(camera_calls(f"{query}{people}", one, QUERIES[query], PER_S))
        for query in QUERIES
        for people, one in films.items()
    }
    tasks: dict[str, Task] = {
        f"{query}_{people}": sender(client, one, server.processor_s)
        for (people, query), one in calls.items()
    }
    if peer is not None:
        alone = itertools.cycle(back_and_forth(films[1]))
        tasks["peer"] = (lambda: peer.read(next(alone))), peer.processor_s
    interleaved(tasks, 1, FILM)  # Warms up, and confirms the people.
    core_ms = {
        name: summary(times)["core_ms"] for name, times in interleaved(tasks, rounds, FILM).items()
    }
    unit = core_ms.get("peer")
    beside = {
        query: ratios({people: core_ms[f"{query}_{people}"] for people in PEOPLE}, unit)
        for query in QUERIES
        if unit
    }
    cases = {
        f"{query}_{people}": {
            "people": people,
            "query": query.replace("_", " "),
            "found": people_found(client, one, COUNTED),
            "core_ms": core_ms[f"{query}_{people}"],
            **beside.get(query, {}).get(people, {}),
        }
        for (people, query), one in calls.items()
    }
    return {"frames": rounds * FILM, "peer_core_ms": unit, "cases": cases}


def ratios(core_ms: Mapping[int, float], unit: float) -> dict[int, dict[str, float]]:
    """Return by number of people the time over a unit, and that of each person after the first."""
    found = {people: {"ratio": time / unit} for people, time in core_ms.items()}
    for people in found.keys() - {1}:
        further = (core_ms[people] - core_ms[1]) / (people - 1)
        found[people]["further_ratio"] = further / unit
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure as the command line asks."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--index", type=Path, default=DEFAULT_PATH)
    parser.add_argument("--shared", type=Path, default=SHARED)
    parser.add_argument("--rounds", type=int, default=12, help=f"of {FILM} frames a kind")
    parser.add_argument("--peer", type=Path, default=PEER, help="a Python that has MediaPipe")
    parser.add_argument("--write", action="store_true", help="into docs/results/peer")
    options = parser.parse_args(arguments)
    video = options.shared / "real" / "pose2sim" / "cam01.mp4"
    frames = [frame for _, frame in itertools.islice(read_frames(video), FILM)]
    missing = why_not(options.peer)
    with ServerProcess(options.index) as server:
        if missing:
            found = compare(server, None, frames, options.rounds)
        else:
            with Peer(options.peer) as peer:
                found = compare(server, peer, frames, options.rounds)
    report("peer", arguments, {**found, "left_out": missing or []}, keep=options.write)
