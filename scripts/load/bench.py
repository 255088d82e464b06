"""Measure whole requests to a real server, and a yardstick in the same minutes.

Every kind of request is sent a few times in a row, in turn and for many rounds, so that a slow
minute of the machine affects all of them. OpenCV's people detector takes part in the same rounds.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from index import DEFAULT_PATH
from scripts.figures import report
from scripts.load.bench_cases import (
    WALKERS,
    Case,
    Street,
    mask_call,
    street_cases,
    walkers_case,
    yardstick,
)
from scripts.load.client import Call, Client
from scripts.load.server import ServerProcess
from scripts.results import SHARED

REPEATS = 3
"""Consecutive requests of a kind: most then find warm caches."""

COUNTED = 3
"""Answers of a kind in which people are counted."""

READY_WANTED_S, MEMORY_WANTED_MB = 2, 300
Task = Callable[[], object]


def interleaved(
    tasks: Mapping[str, Task], rounds: int, repeats: int = REPEATS
) -> dict[str, list[float]]:
    """Return milliseconds of every run: ``repeats`` in a row, task after task, in rounds."""
    times: dict[str, list[float]] = {name: [] for name in tasks}
    for _ in range(rounds):
        for name, task in tasks.items():
            for _ in range(repeats):
                started = time.perf_counter()
                task()
                times[name].append((time.perf_counter() - started) * 1000)
    return times


def answer(client: Client, call: Call) -> bytes:
    """Return the body of an answer that must be 200."""
    status, body = client.send(call)
    if status != 200:
        raise ValueError(f"expected status 200, got {status}: {body.decode(errors='replace')}")
    return body


def sender(client: Client, calls: Sequence[Call]) -> Task:
    """Return a task that sends the next of the calls, in turn, and reads the whole answer."""
    turns = itertools.cycle(calls)
    return lambda: answer(client, next(turns))


def people_found(client: Client, case: Case) -> str | None:
    """Count the people of some answers."""
    if case.in_order:
        return None
    bodies = [answer(client, call) for call in case.calls[:COUNTED]]
    return ", ".join(str(len(json.loads(body)["persons"])) for body in bodies)


def processor_time() -> NDArray[np.int64]:
    """Return ticks of all processors by use, as /proc/stat has them; 7 is stolen."""
    with Path("/proc/stat").open() as file:
        return np.array(file.readline().split()[1:9], np.int64)


def spread(milliseconds: Sequence[float]) -> dict[str, float]:
    """Return the tenth percentile and the median."""
    p10, median = np.percentile(milliseconds, [10, 50]).tolist()
    return {"p10_ms": p10, "median_ms": median}


def benchmark(server: ServerProcess, street: Street | None, rounds: int) -> dict[str, Any]:
    """Measure a server that was just started."""
    ready_s = server.wait_until_ready()
    client = Client(server.url)
    cases = {"small_four_walkers": walkers_case()}
    picture = np.asarray(cv2.imread(str(WALKERS)), np.uint8)
    if street:
        cases |= street_cases(street, answer(client, mask_call(street)))
        picture = street.busy[0]
    tasks: dict[str, Task] = {"yardstick": yardstick(picture)}
    tasks |= {name: sender(client, case.calls) for name, case in cases.items()}
    interleaved(tasks, rounds=1)  # Warms up.
    before = processor_time()
    times = interleaved(tasks, rounds)
    spent = processor_time() - before
    unit = spread(times["yardstick"])
    index = json.loads(answer(client, Call("GET", "/index")))
    figures = {
        "yardstick": unit,
        "requests_of_a_kind": len(times["yardstick"]),
        "cases": {
            name: {
                "title": case.title,
                "people": people_found(client, case),
                **spread(times[name]),
                "ratio": spread(times[name])["median_ms"] / unit["median_ms"],
                "wanted_ratio": case.wanted_ratio,
            }
            for name, case in cases.items()
        },
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
