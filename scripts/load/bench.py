"""Measure whole requests to a real server, and a yardstick in the same minutes.

Every kind of request is sent a few times in a row, in turn and for many rounds, so that a slow
minute of the machine affects all of them. OpenCV's people detector takes part in the same rounds,
at the priority of the service's threads.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from app.scheduling.process import lower_thread_priority
from app.vision.geometry import Box
from index import DEFAULT_PATH
from scripts.datasets import read_frames, read_marks, read_vtest
from scripts.figures import report
from scripts.load.client import Call, Client, answer
from scripts.load.scenes import encode
from scripts.load.server import ServerProcess
from scripts.results import ROOT, SHARED

WALKERS = ROOT / "tests" / "data" / "walkers.jpg"
SMALL, LARGE = (640, 480), (1440, 1080)
"""Width and height of the yardstick's frame, and of a large one."""

FILM = 30
"""Frames of a film."""

MAX_CALLS = 1000
"""Frames of a camera have an order, and are not sent twice."""

REPEATS = 3
"""Consecutive requests of a kind: most then find warm caches."""

COUNTED = 3
"""Answers of a kind in which people are counted."""

READY_WANTED_S, MEMORY_WANTED_MB = 2, 300
Picture = NDArray[np.uint8]
Clock = Callable[[], float]
Task = tuple[Callable[[], object], Clock]
"""What to do, and the processor time in seconds of those who do it."""


@dataclass(frozen=True)
class Case:
    """One kind of request, sent in turn.

    ``wanted_ratio`` is the target of the median, as a multiple of the yardstick's. ``sent_before``
    calls come before the first that is measured.
    """

    title: str
    calls: tuple[Call, ...]
    wanted_ratio: float
    sent_before: int = 0


@dataclass(frozen=True)
class Street:
    """BGR frames with four walkers, the empty street, and a box about the tallest of the first.

    ``film`` are consecutive frames of the street, ``tall`` those of two people, 1080x1920.
    """

    busy: tuple[Picture, ...]
    empty: Picture
    box: Box
    film: tuple[Picture, ...]
    tall: tuple[Picture, ...]

    @property
    def frame(self) -> bytes:
        """The first busy frame, encoded."""
        return encode(".jpg", self.busy[0])

    @property
    def boxes(self) -> bytes:
        """The walker's box, as the form field has it."""
        return json.dumps([[self.box.x, self.box.y, self.box.width, self.box.height]]).encode()

    @classmethod
    def read(cls, folder: Path) -> Street:
        """Read the videos of a folder; a FileNotFoundError where one is missing."""
        marks = read_marks()
        frames = dict(read_vtest(folder / "vtest", len(marks)))
        # Others may be cut, hidden or small.
        with_four = [mark for mark in marks if len(mark.people) == 4]
        film, tall = (
            tuple(frame for _, frame in itertools.islice(read_frames(folder / video), FILM))
            for video in ("vtest/vtest.avi", "pose2sim/cam01.mp4")
        )
        return cls(
            tuple(frames[mark.frame] for mark in with_four),
            without_people(list(frames.values())),
            max(with_four[0].people, key=lambda box: box.height),
            film,
            tall,
        )


def without_people(frames: Sequence[Picture]) -> Picture:
    """Return the scene ``(480, 640, 3)`` of a fixed camera: the usual value of each pixel."""
    return resized(np.median(np.stack(frames), axis=0).astype(np.uint8), SMALL)


def resized(picture: Picture, size: tuple[int, int]) -> Picture:
    """Return a picture of another width and height."""
    smaller = size[0] < picture.shape[1]
    interpolation = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(picture, size, interpolation=interpolation), np.uint8)


def without_motion(picture: Picture) -> tuple[Picture, ...]:
    """Return a film in which nothing moves, with the noise of a sensor: two grey levels."""
    rng = np.random.default_rng(0)
    noise = (rng.normal(0, 2, picture.shape) for _ in range(FILM))
    return tuple(np.clip(picture + one, 0, 255).astype(np.uint8) for one in noise)


def back_and_forth(film: Sequence[Picture]) -> list[bytes]:
    """Encode a film and its way back, to be repeated."""
    return [encode(".jpg", frame) for frame in (*film, *film[-2:0:-1])]


def camera_calls(
    camera: str, film: Sequence[Picture], query: str = "", per_s: int = 10
) -> tuple[Call, ...]:
    """Return a camera's frames: a film played back and forth."""
    frames = back_and_forth(film)
    return tuple(
        Call(
            "POST",
            f"/cameras/{camera}/frames{query}",
            {"frame": frames[number % len(frames)], "timestamp": str(number / per_s).encode()},
        )
        for number in range(MAX_CALLS)
    )


def pose_calls(*frames: Picture) -> tuple[Call, ...]:
    """Return requests to ``POST /pose``."""
    return tuple(Call("POST", "/pose", {"frame": encode(".jpg", frame)}) for frame in frames)


def street_cases(street: Street, client: Client) -> dict[str, Case]:
    """Return the cases about the street; a caller's mask is the service's own silhouette."""
    height, width = street.busy[0].shape[:2]
    size = f"{width}x{height}"
    boxed = {"frame": street.frame, "boxes": street.boxes}
    mask = answer(client, Call("POST", "/silhouette", boxed))
    masked = {"frame": street.frame, "mask": mask}
    silhouette, both, box = (
        (Call("POST", f"/pose{query}", parts),)
        for query, parts in (("?evidence=silhouette", masked), ("", masked), ("", boxed))
    )
    large = pose_calls(resized(street.empty, LARGE))
    film = camera_calls("film", street.film)
    tall, tall_first, tall_events = (
        camera_calls(f"tall{number}", street.tall, query)
        for number, query in enumerate(("", "?n=1", "?joints=none"))
    )
    still = camera_calls("still", without_motion(street.tall[0]))
    return {
        "four_walkers": Case(f"{size}, four walkers", pose_calls(*street.busy), 1.4),
        "nobody": Case(f"{SMALL[0]}x{SMALL[1]}, nobody", pose_calls(street.empty), 0.5),
        "box": Case(f"{size}, one caller's box", box, 0.28),
        "mask_silhouette": Case(f"{size}, one mask, `evidence=silhouette`", silhouette, 0.08),
        "mask": Case(f"{size}, one mask", both, 0.28),
        "large_nobody": Case(f"{LARGE[0]}x{LARGE[1]}, nobody", large, 0.6),
        "two_people": Case("1080x1920, two people", pose_calls(*street.tall), 1.1),
        "camera": Case(f"{size}, next frame of a camera", film, 0.9),
        "tall_camera": Case("1080x1920, next frame of a camera", tall, 0.7),
        "tall_first": Case("1080x1920, the same, `n=1`", tall_first, 0.7),
        "tall_events": Case("1080x1920, the same, `joints=none`", tall_events, 0.5),
        "rest_camera": Case("1080x1920, the same, nobody moves", still, 0.35, 40),
    }


def yardstick(picture: Picture) -> Task:
    """Return OpenCV's own search for people in a picture at :data:`SMALL`, on one thread.

    It classifies every window, so it takes equally long in any picture.
    """
    cv2.setNumThreads(1)
    hog = cv2.HOGDescriptor()
    hog.setSVMDetector(np.asarray(cv2.HOGDescriptor.getDefaultPeopleDetector()))
    small = resized(picture, SMALL)
    # On a busy machine, a thread of usual priority would gain on those of the service.
    thread = ThreadPoolExecutor(1, initializer=lower_thread_priority)

    def search() -> object:
        return thread.submit(hog.detectMultiScale, small, winStride=(8, 8), scale=1.05).result()

    return search, time.process_time


def interleaved(
    tasks: Mapping[str, Task], rounds: int, repeats: int = REPEATS
) -> dict[str, list[tuple[float, float]]]:
    """Return milliseconds and core-milliseconds of every run.

    There are ``repeats`` in a row, task after task, in rounds.
    """
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in tasks}
    for _ in range(rounds):
        for name, (do, clock) in tasks.items():
            for _ in range(repeats):
                started, spent = time.perf_counter(), clock()
                do()
                taken = time.perf_counter() - started, clock() - spent
                times[name].append((1000 * taken[0], 1000 * taken[1]))
    return times


def sender(client: Client, calls: Iterator[Call], clock: Clock) -> Task:
    """Return a task that sends the next of the calls and reads the whole answer."""
    return lambda: answer(client, next(calls)), clock


def people_found(client: Client, calls: Iterator[Call], count: int) -> list[int]:
    """Count the people of the next answers."""
    bodies = [answer(client, call) for call in itertools.islice(calls, count)]
    return [len(json.loads(body)["persons"]) for body in bodies]


def summary(times: Sequence[tuple[float, float]], people: Sequence[int] = ()) -> dict[str, Any]:
    """Return the figures of a kind; those a person only where people are found."""
    wall_ms, core_ms = np.array(times).T
    p10_ms, median_ms = np.percentile(wall_ms, [10, 50]).tolist()
    found = {"p10_ms": p10_ms, "median_ms": median_ms, "core_ms": float(core_ms.mean())}
    persons = sum(people) / max(1, len(people))
    each = {f"{name}_a_person": found[name] / persons for name in found if persons}
    return {"people": list(people), **found, **each}


def processor_time() -> NDArray[np.int64]:
    """Return ticks of all processors by use, as /proc/stat has them; 7 is stolen."""
    with Path("/proc/stat").open() as file:
        return np.array(file.readline().split()[1:9], np.int64)


def benchmark(server: ServerProcess, street: Street | None, rounds: int) -> dict[str, Any]:
    """Measure a server that was just started."""
    ready_s = server.wait_until_ready()
    client, picture = Client(server.url), np.asarray(cv2.imread(str(WALKERS)), np.uint8)
    walkers = Call("POST", "/pose", {"frame": WALKERS.read_bytes()})
    cases = {"small_four_walkers": Case("298x320, four walkers", (walkers,), 1.4)}
    if street:
        cases |= street_cases(street, client)
        picture = street.busy[0]
    turns = {name: itertools.cycle(case.calls) for name, case in cases.items()}
    tasks: dict[str, Task] = {"yardstick": yardstick(picture)}
    tasks |= {name: sender(client, calls, server.processor_s) for name, calls in turns.items()}
    for name, case in cases.items():
        for call in itertools.islice(turns[name], case.sent_before):
            answer(client, call)
    load = os.getloadavg()[0]
    interleaved(tasks, rounds=1)  # Warms up.
    before = processor_time()
    times = interleaved(tasks, rounds)
    spent = processor_time() - before
    unit = summary(times["yardstick"])
    found = {
        name: summary(times[name], people_found(client, turns[name], min(COUNTED, len(case.calls))))
        for name, case in cases.items()
    }
    index = json.loads(answer(client, Call("GET", "/index")))
    figures = {
        "yardstick": unit,
        "requests_of_a_kind": len(times["yardstick"]),
        "cases": {
            name: {
                "title": case.title,
                **found[name],
                "ratio": found[name]["median_ms"] / unit["median_ms"],
                "core_ratio": found[name]["core_ms"] / unit["core_ms"],
                "wanted_ratio": case.wanted_ratio,
            }
            for name, case in cases.items()
        },
        "load": load,
        "stolen": float(spent[7] / max(1, spent.sum())),
        "index": {
            "name": index["name"], "entries": index["entries"], "version": index["version"][:19],
        },
        "ready_s": ready_s,
        "ready_wanted_s": READY_WANTED_S,
        "memory_mb": server.memory_mb(),
        "max_memory_mb": server.memory_mb("VmHWM"),
        "memory_wanted_mb": MEMORY_WANTED_MB,
    }  # fmt: skip
    client.close()
    return figures


def read_street(folder: Path) -> tuple[Street | None, list[str]]:
    """Return the street, or None and the cases left out without it."""
    try:
        return Street.read(folder), []
    except FileNotFoundError as error:
        return None, [f"all cases but that of {WALKERS.name} ({error})"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure as the command line asks."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--index", type=Path, default=DEFAULT_PATH)
    parser.add_argument("--shared", type=Path, default=SHARED)
    parser.add_argument("--rounds", type=int, default=30, help=f"of {REPEATS} requests a kind")
    parser.add_argument("--write", action="store_true", help="into docs/results/bench")
    options = parser.parse_args(arguments)
    street, left_out = read_street(options.shared / "real")
    with ServerProcess(options.index) as server:
        figures = {**benchmark(server, street, options.rounds), "left_out": left_out}
    report("bench", arguments, figures, keep=options.write)
