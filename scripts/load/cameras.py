"""Play the cameras of a house to a server at five frames a second: dropped frames, processor time.

Each camera sends the newest frame as soon as the last is answered, as the bridge does; frames that
have become older than the next are dropped. Some cameras see two people at all times, the others
nobody.
"""

import itertools
import os
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import cv2
import numpy as np

from index.store import PoseIndex
from scripts.datasets import read_frames
from scripts.load.bench import FILM as FRAMES
from scripts.load.bench import back_and_forth, resized, without_people
from scripts.load.client import Call, Client
from scripts.load.server import Criteria, Figures, ServerProcess, run, spread
from scripts.results import SHARED

PER_S = 5
CAMERAS, OCCUPIED = (4, 8), (1, 2, 3)
"""Cameras of a house, and how many of them see people."""

QUERIES = ("n=1", "joints=none")
MAX_DROPPED = {
    (4, 1, "n=1"): 0.01,
    (8, 1, "joints=none"): 0.01,
    (8, 2, "joints=none"): 0.01,
    (4, 3, "joints=none"): 0.01,
    (4, 3, "n=1"): 0.2,
}
"""Largest shares of dropped frames: targets on two cores."""

WARM_UP_S = 2.0
FILM = SHARED / "real" / "pose2sim" / "cam01.mp4"
"""Two people, 1080x1920; played back and forth."""

EMPTY = SHARED / "real" / "vtest" / "vtest.avi"
NOISE = 4
"""Standard deviation of an empty camera's pixels, grey levels."""


def film() -> list[bytes]:
    """Return the frames that a camera sends, five for each second of the film."""
    step = round(cv2.VideoCapture(str(FILM)).get(cv2.CAP_PROP_FPS)) // PER_S
    return back_and_forth([frame for number, frame in read_frames(FILM) if number % step == 0])


def empty_film() -> list[bytes]:
    """Return the frames of a camera before which nobody is: the street without people, enlarged."""
    scene = resized(without_people([frame for _, frame in read_frames(EMPTY)]), (1920, 1080))
    rng = np.random.default_rng(0)
    noisy = (scene + rng.normal(0, NOISE, scene.shape) for _ in range(FRAMES))
    return back_and_forth([np.clip(frame, 0, 255).astype(np.uint8) for frame in noisy])


def watch(
    url: str, path: str, frames: Sequence[bytes], start: float, seconds: float
) -> dict[int, float]:
    """Send a camera's frames to a path from a time of the monotonic clock on.

    Returns the milliseconds from a frame to its answer, by number; dropped ones, and those that the
    server refuses because it is busy, have none.
    """
    client, answered_ms, number = Client(url), dict[int, float](), 0
    while number < seconds * PER_S:
        taken = start + number / PER_S
        time.sleep(max(0.0, taken - time.monotonic()))
        parts = {"frame": frames[number % len(frames)], "timestamp": f"{number / PER_S}".encode()}
        status, body = client.send(Call("POST", path, parts))
        if status == 200:
            answered_ms[number] = (time.monotonic() - taken) * 1000
        elif status != 503:
            raise ValueError(f"expected status 200 or 503, got {status}: {body!r}")
        number = max(number + 1, int((time.monotonic() - start) * PER_S))
    client.close()
    return answered_ms


def carried(
    server: ServerProcess, films: Sequence[Sequence[bytes]], query: str, seconds: float
) -> Figures:
    """Let cameras send their films, evenly spread; the warm-up counts for processor time alone."""
    start, spent = time.monotonic(), server.processor_s()
    with ThreadPoolExecutor(len(films)) as threads:
        watching = [
            threads.submit(
                watch,
                server.url,
                f"/cameras/{number}/frames?{query}",
                frames,
                start + number / (len(films) * PER_S),
                WARM_UP_S + seconds,
            )
            for number, frames in enumerate(films)
        ]
        found = [one.result() for one in watching]
    spent, client = server.processor_s() - spent, Client(server.url)
    for number in range(len(films)):
        client.send(Call("DELETE", f"/cameras/{number}"))
    client.close()
    counted = [ms for one in found for number, ms in one.items() if number >= WARM_UP_S * PER_S]
    due = len(films) * round(seconds * PER_S)
    core_s = spent / sum(map(len, found))
    return {
        "due": due,
        "dropped": 1 - len(counted) / due,
        "ms": spread(counted),
        "core_ms": 1000 * core_s,
        "cores": spent / (WARM_UP_S + seconds),
        "cores_needed": len(films) * PER_S * core_s,
    }


def measure(server: ServerProcess, _: PoseIndex, seconds: float) -> tuple[Figures, Criteria]:
    """Measure every house with every query."""
    people, nobody, load = film(), empty_film(), os.getloadavg()[0]
    rows, criteria = dict[str, Figures](), dict[str, bool]()
    for house in itertools.product(CAMERAS, OCCUPIED, QUERIES):
        cameras, occupied, query = house
        films = [people] * occupied + [nobody] * (cameras - occupied)
        row = carried(server, films, query, seconds)
        key = f"{cameras}_{occupied}_{query.replace('=', '_')}"
        rows[key] = {"cameras": cameras, "occupied": occupied, "query": query, **row}
        if (most := MAX_DROPPED.get(house)) is not None:
            what = f"{cameras} cameras, {occupied} with people, `{query}`"
            criteria[f"{what}: {row['dropped']:.1%} dropped, target {most:.0%}"] = (
                row["dropped"] <= most
            )
    figures = {"rows": rows, "seconds": seconds, "load": load, "memory_mb": server.memory_mb()}
    return figures, criteria


main = partial(run, measure, "cameras", "seconds", 30.0)
