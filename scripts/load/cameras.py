"""Find how many cameras a server carries at five frames a second.

Each camera sends the newest frame as soon as the last is answered, as ``watch-camera`` does; frames
that have become older than the next are dropped. Cameras are added until one drops a frame.
"""

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import cv2

from index.store import PoseIndex
from scripts.datasets import read_frames
from scripts.load.bench import back_and_forth
from scripts.load.client import Call, Client, answer
from scripts.load.server import Criteria, Figures, ServerProcess, run, spread
from scripts.results import SHARED

PER_S = 5
WANTED, MAX_CAMERAS = 3, 16
WARM_UP_S = 2.0
FILM = SHARED / "real" / "pose2sim" / "cam01.mp4"
"""Two people, 1080x1920; played back and forth."""


def film() -> list[bytes]:
    """Return the frames that a camera sends, five for each second of the film."""
    step = round(cv2.VideoCapture(str(FILM)).get(cv2.CAP_PROP_FPS)) // PER_S
    return back_and_forth([frame for number, frame in read_frames(FILM) if number % step == 0])


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


def carried(url: str, cameras: int, frames: Sequence[bytes], seconds: float) -> Figures:
    """Let cameras send their frames, evenly spread; frames of the warm-up are not counted."""
    start = time.monotonic()
    with ThreadPoolExecutor(cameras) as threads:
        watching = [
            threads.submit(
                watch,
                url,
                f"{cameras}-{number}",
                frames,
                start + number / (cameras * PER_S),
                WARM_UP_S + seconds,
            )
            for number in range(cameras)
        ]
        found = [one.result() for one in watching]
    counted = [ms for one in found for number, ms in one.items() if number >= WARM_UP_S * PER_S]
    due = cameras * round(seconds * PER_S)
    return {"cameras": cameras, "due": due, "dropped": due - len(counted), "ms": spread(counted)}


def measure(server: ServerProcess, _: PoseIndex, seconds: float) -> tuple[Figures, Criteria]:
    """Add cameras until a frame is dropped."""
    frames, rows = film(), list[Figures]()
    for cameras in range(1, MAX_CAMERAS + 1):
        rows.append(carried(server.url, cameras, frames, seconds))
        if rows[-1]["dropped"]:
            break
    most = max((row["cameras"] for row in rows if not row["dropped"]), default=0)
    return {"rows": rows, "most": most, "seconds": seconds, "memory_mb": server.memory_mb()}, {
        f"cameras without a dropped frame: {most}, target {WANTED}": most >= WANTED
    }


main = partial(run, measure, "cameras", "seconds", 60.0)
