"""Measure whole requests to a real server, and a yardstick in the same minutes.

    python -m scripts.load.benchmark [--rounds 30] [--write FILE]

Every kind of request is sent a few times in a row, in turn and for many rounds, so that a slow
minute of the machine affects all of them. OpenCV's people detector takes part in the same rounds.
"""

from __future__ import annotations

import argparse
import itertools
import json
import shlex
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from index import DEFAULT_PATH
from scripts.load.benchmark_cases import (
    WALKERS,
    Street,
    mask_call,
    street_cases,
    walkers_case,
    yardstick,
)
from scripts.load.benchmark_report import Measured, Row, report
from scripts.load.client import Call, Client
from scripts.load.server import ServerProcess
from scripts.results import ROOT

REPEATS = 3
"""Consecutive requests of a kind: most then find warm caches."""

FEW = 3
"""Answers of a kind in which people are counted."""

HOG = "yardstick: OpenCV's `detectMultiScale`, 640x480, one thread"
Task = Callable[[], object]


def interleaved(
    tasks: Mapping[str, Task], rounds: int, repeats: int = REPEATS
) -> dict[str, list[float]]:
    """Milliseconds of every run: ``repeats`` in a row, task after task, round after round."""
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
        raise RuntimeError(f"expected status 200, got {status}: {body.decode(errors='replace')}")
    return body


def sender(client: Client, calls: Sequence[Call]) -> Task:
    """Return a task that sends the next of the calls, in turn, and reads the whole answer."""
    turns = itertools.cycle(calls)
    return lambda: answer(client, next(turns))


def people_found(client: Client, calls: Sequence[Call]) -> str:
    """Count the people of each answer."""
    bodies = [answer(client, call) for call in calls]
    return ", ".join(str(len(json.loads(body)["persons"])) for body in bodies)


def describe_index(reply: bytes) -> str:
    """Write the reply of ``GET /index`` in a line."""
    index = json.loads(reply)
    return f"{index['name']}, {index['entries']} entries, {index['version'][:19]}"


def processor_time() -> NDArray[np.int64]:
    """Ticks of all processors by what they were spent on, as /proc/stat has them; 7 is stolen."""
    with Path("/proc/stat").open() as file:
        return np.array(file.readline().split()[1:9], np.int64)


def benchmark(server: ServerProcess, street: Street | None, rounds: int) -> Measured:
    """Measure a server that was just started."""
    ready_s = server.wait_until_ready()
    client = Client(server.url)
    cases = [walkers_case()]
    picture = np.asarray(cv2.imread(str(WALKERS)), np.uint8)
    if street:
        cases += street_cases(street, answer(client, mask_call(street)))
        picture = street.busy[0]
    tasks: dict[str, Task] = {HOG: yardstick(picture)}
    tasks |= {case.what: sender(client, case.calls) for case in cases}
    interleaved(tasks, rounds=1)  # Warms up.
    before = processor_time()
    times = interleaved(tasks, rounds)
    spent = processor_time() - before
    rows = [
        Row(
            case.what, times[case.what],
            "" if case.in_order else people_found(client, case.calls[:FEW]),
            case.wanted_ratio,
        )
        for case in cases
    ]  # fmt: skip
    index = answer(client, Call("GET", "/index"))
    client.close()
    return Measured(
        Row(HOG, times[HOG]), rows, float(spent[7] / max(1, spent.sum())), describe_index(index),
        ready_s, server.memory_mb(), server.memory_mb("VmHWM"),
    )  # fmt: skip


def read_street(folder: Path) -> tuple[Street | None, list[str]]:
    """Return the street, or None and what is left out for that."""
    try:
        return Street.read(folder), []
    except FileNotFoundError as error:
        return None, [f"all cases but that of {WALKERS.name} ({error})"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--index", type=Path, default=DEFAULT_PATH)
    parser.add_argument("--shared", type=Path, default=ROOT.parent / "shared")
    parser.add_argument("--rounds", type=int, default=30, help=f"of {REPEATS} requests a kind")
    parser.add_argument("--write", type=Path, help="also write the report to this file")
    options = parser.parse_args(arguments)
    street, left_out = read_street(options.shared / "real")
    try:
        with ServerProcess(options.index) as server:
            measured = benchmark(server, street, options.rounds)
    except (OSError, RuntimeError) as error:  # A server that is never ready among them.
        raise SystemExit(f"benchmark: {error}") from None
    command = shlex.join(["python", "-m", "scripts.load.benchmark", *(arguments or sys.argv[1:])])
    page = report(measured, command, left_out)
    print(page)
    if options.write:
        options.write.parent.mkdir(parents=True, exist_ok=True)
        options.write.write_text(page)


if __name__ == "__main__":
    main()
