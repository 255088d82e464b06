"""Find how many cameras a server carries at five frames a second.

Each camera sends the newest frame as soon as the last is answered, as the bridge does; frames that
have become older than the next are dropped. First come the cameras of a house, of which one shows
people; then cameras that all do are added until too many frames are dropped.
"""

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
from scripts.load.client import Call, Client, answer
from scripts.load.server import Criteria, Figures, ServerProcess, run, spread
from scripts.results import SHARED

PER_S = 5
WANTED, MAX_CAMERAS = 3, 16
HOUSE, HOUSE_CORES = 4, 1.3
"""Cameras of a house, one of which shows people, and the cores that they may take."""

MAX_DROPPED = 0.01
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
    url: str, camera: str, frames: Sequence[bytes], start: float, seconds: float
) -> dict[int, float]:
    """Send a camera's frames from a time of the monotonic clock on.

    Returns the milliseconds from a frame to its answer, by number; dropped ones have none.
    """
    client, answered_ms, number = Client(url), dict[int, float](), 0
    while number < seconds * PER_S:
        taken = start + number / PER_S
        time.sleep(max(0.0, taken - time.monotonic()))
        parts = {"frame": frames[number % len(frames)], "timestamp": f"{number / PER_S}".encode()}
        answer(client, Call("POST", f"/cameras/{camera}/frames", parts))
        answered_ms[number] = (time.monotonic() - taken) * 1000
        number = max(number + 1, int((time.monotonic() - start) * PER_S))
    client.close()
    return answered_ms


def carried(server: ServerProcess, films: Sequence[Sequence[bytes]], seconds: float) -> Figures:
    """Let cameras send their films, evenly spread; frames of the warm-up are not counted."""
    start, spent = time.monotonic(), server.processor_s()
    with ThreadPoolExecutor(len(films)) as threads:
        watching = [
            threads.submit(
                watch,
                server.url,
                f"{len(films)}-{number}",
                frames,
                start + number / (len(films) * PER_S),
                WARM_UP_S + seconds,
            )
            for number, frames in enumerate(films)
        ]
        found = [one.result() for one in watching]
    counted = [ms for one in found for number, ms in one.items() if number >= WARM_UP_S * PER_S]
    due = len(films) * round(seconds * PER_S)
    return {
        "due": due,
        "dropped": due - len(counted),
        "ms": spread(counted),
        "cores": (server.processor_s() - spent) / (time.monotonic() - start),
    }


def measure(server: ServerProcess, _: PoseIndex, seconds: float) -> tuple[Figures, Criteria]:
    """Measure the house, then add cameras until too many frames are dropped."""
    people = film()
    house = carried(server, [people, *[empty_film()] * (HOUSE - 1)], seconds)
    rows = [{"cameras": f"{HOUSE}, one with people", **house}]
    most = 0
    while len(rows) <= MAX_CAMERAS and most == len(rows) - 1:
        row = carried(server, [people] * len(rows), seconds)
        most += row["dropped"] < MAX_DROPPED * row["due"]
        rows.append({"cameras": f"{len(rows)}, all with people", **row})
    lost, cores = house["dropped"] / house["due"], house["cores"]
    return {"rows": rows, "most": most, "seconds": seconds, "memory_mb": server.memory_mb()}, {
        f"{HOUSE} cameras, one with people: {lost:.1%} dropped, {cores:.2f} cores; "
        f"target under {MAX_DROPPED:.0%}, {HOUSE_CORES}": lost < MAX_DROPPED
        and cores <= HOUSE_CORES,
        f"cameras with people that drop under {MAX_DROPPED:.0%}: {most}, target {WANTED}": most
        >= WANTED,
    }


main = partial(run, measure, "cameras", "seconds", 60.0)
