"""Measure a real server: time until ready, resident memory, and the latency of /pose.

python -m scripts.benchmark [--index index/data] [--requests 500] [--write docs/results/bench.md]
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from index.artefact import ArtefactError
from index.store import DEFAULT_PATH, PoseIndex
from scripts.raw_client import Call, RawClient, request_bytes
from scripts.results import machine
from scripts.server_process import ServerProcess
from scripts.street import encode, street

WALKERS = Path(__file__).resolve().parents[1] / "tests" / "data" / "walkers.jpg"
TARGETS = "targets: /pose with a mask under 10 ms at the median, ready within 2 s, under 300 MB"


@dataclass(frozen=True)
class Latency:
    """Round trips of one kind of request, in milliseconds, and what the machine was kept from.

    From the moment the request is handed to the socket to the last byte of the answer.

    Parameters
    ----------
    what : str
    tenth, median, p99 : float
    stolen : float
        Share of the processors' time that the host of a virtual machine gave to others.
    requests : int
    """

    what: str
    tenth: float
    median: float
    p99: float
    stolen: float
    requests: int

    @classmethod
    def measure(cls, client: RawClient, what: str, files: dict[str, bytes], n: int) -> Latency:
        """Send the same request one after another; the first tenth warms up."""
        times = []
        request = request_bytes(Call("POST", "/pose", files))
        before = processor_time()
        for _ in range(n + n // 10):
            started = time.perf_counter()
            status, body = client.exchange(request)
            times.append((time.perf_counter() - started) * 1000)
            if status != 200:
                raise RuntimeError(f"expected status 200, got {status}: {body.decode()}")
        spent = processor_time() - before
        tenth, median, p99 = np.percentile(times[n // 10 :], (10, 50, 99)).tolist()
        return cls(what, tenth, median, p99, float(spent[7] / max(1, spent.sum())), n)


def processor_time() -> NDArray[np.int64]:
    """Ticks of all processors by what they were spent on, as /proc/stat has them; 7 is stolen."""
    with Path("/proc/stat").open() as file:
        return np.array(file.readline().split()[1:9], np.int64)


def benchmark(index_path: Path, requests: int) -> str:
    """Measure and return a report in Markdown."""
    index = PoseIndex.load(index_path)
    picture, person = street(index)
    frame, mask = encode(".jpg", picture), encode(".png", person)
    with ServerProcess(index_path) as server:
        ready_s = server.wait_until_ready()
        client = RawClient(server.url)
        latencies = [
            Latency.measure(client, what, files, count)
            for what, files, count in (
                ("768x576 with a mask of one", {"frame": frame, "mask": mask}, requests),
                ("768x576, nobody found in it", {"frame": frame}, requests // 5),
                ("298x320, four walkers found", {"frame": WALKERS.read_bytes()}, requests // 5),
            )
        ]
        memory_mb = server.memory_mb()
    rows = [
        f"| /pose {row.what} | {row.tenth:.1f} ms | {row.median:.1f} ms | {row.p99:.1f} ms "
        f"| {row.stolen:.0%} | {row.requests} |"
        for row in latencies
    ]
    return "\n".join(
        [
            f"Machine: {machine()}.",
            f"Index: {index.name}, {len(index)} entries, {index.version[:19]}.",
            "",
            "| request | fastest tenth within | median | p99 | stolen by the host | requests |",
            "|---|---|---|---|---|---|",
            *rows,
            "",
            f"Ready {ready_s:.2f} s after its start; {memory_mb:.0f} MB resident after the "
            "requests.",
            f"({TARGETS}.)",
        ]
    )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Measure a real server.")
    parser.add_argument("--index", type=Path, default=DEFAULT_PATH)
    parser.add_argument("--requests", type=int, default=500)
    parser.add_argument("--write", type=Path, help="also write the report to this file")
    options = parser.parse_args()
    try:
        report = benchmark(options.index, options.requests)
    except ArtefactError as error:
        raise SystemExit(f"benchmark: {error}") from None
    print(report)
    if options.write:
        options.write.parent.mkdir(parents=True, exist_ok=True)
        options.write.write_text(f"# `make bench`\n\n{report}\n")


if __name__ == "__main__":
    main()
