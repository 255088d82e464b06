"""Offer a server ten times the load it can carry.

    python -m scripts.load.overload [--index index/data] [--seconds 20] [--write]

Capacity is measured first, with two requests more in flight than are worked on at once. Then ten
times that many requests are sent each second, whether answered or not, at random times, while
another process asks ``/healthz`` every few milliseconds, each time over a new connection, as
an orchestrator does.
"""

from __future__ import annotations

import asyncio
import os
import re
import sys
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from app.settings import Settings
from index.artefact import load_index
from index.store import PoseIndex
from scripts.experiments.report import table
from scripts.load.client import Call, Client
from scripts.load.loops import MAX_CONNECTIONS, ClosedLoop, OpenLoop, Tally
from scripts.load.scenes import encode, street
from scripts.load.server import ServerProcess
from scripts.results import conclude, machine, measurement_parser, percentile, revision

TIMES = 10
PROBE_EVERY_S = 0.02
PROBE_P99_MS = 50.0
REJECTED_MS = 50.0


@dataclass(frozen=True)
class Outcome:
    """One kind of request under overload.

    ``capacity`` is the frames a second that the service carries, ``tally`` that of the requests
    offered at ten times as many, ``probes_ms`` the times of ``/healthz`` meanwhile. ``given_up``
    frames were accepted and answered with a 503 at their deadline.
    """

    name: str
    capacity: float
    tally: Tally
    probes_ms: list[float]
    given_up: int

    def accepted_ms(self) -> list[float]:
        """Answer times of the frames that were worked on."""
        return [answer.ms for answer in self.tally.of(200)]

    def rejected_ms(self) -> list[float]:
        """Answer times of those that were sent away at once: all but the given up."""
        times = sorted(answer.ms for answer in self.tally.of(503))
        return times[: len(times) - self.given_up]

    def failed(self) -> int:
        """Number of requests answered otherwise, or not at all."""
        sent = len(self.tally.late_ms) - self.tally.unsent
        return sent - len(self.tally.of(200)) - len(self.tally.of(503))

    def failures(self, deadline_s: float) -> list[str]:
        """Say which criteria are missed."""
        out = []
        statuses = Counter(answer.status for answer in self.tally.answers)
        if set(statuses) - {200, 503} or self.tally.broken:
            out.append(f"answers {dict(statuses)}, {self.tally.broken} broken connections")
        if any(not answer.retry_after for answer in self.tally.of(503)):
            out.append("503 without Retry-After")
        if percentile(self.probes_ms, 99) >= PROBE_P99_MS:
            out.append(f"p99 of /healthz {percentile(self.probes_ms, 99):.0f} ms")
        if percentile(self.rejected_ms(), 99) >= REJECTED_MS:
            out.append(f"p99 of rejections {percentile(self.rejected_ms(), 99):.0f} ms")
        if self.given_up or max(self.accepted_ms(), default=0.0) > deadline_s * 1000:
            out.append(f"{self.given_up} accepted frames given up at their deadline")
        return [f"{self.name}: {failure}" for failure in out]


def calls(index: PoseIndex) -> dict[str, list[Call]]:
    """Return the kinds of request tried, from the quickest to the slowest to serve."""
    scenes = [street(index, width=320, height=240, seed=seed) for seed in range(8)]
    frames = [encode(".jpg", frame) for frame, _ in scenes]
    masks = [encode(".png", mask) for _, mask in scenes]
    return {
        "`/pose` with a mask": [
            Call("POST", "/pose", {"frame": frame, "mask": mask})
            for frame, mask in zip(frames, masks, strict=True)
        ],
        "`/pose`, people searched for": [Call("POST", "/pose", {"frame": f}) for f in frames],
    }


def probe(url: str, seconds: float) -> list[float]:
    """Ask ``/healthz`` at fixed times, each over a new connection; return milliseconds."""
    times = []
    started = time.perf_counter()
    for at in np.arange(0.0, seconds, PROBE_EVERY_S):
        time.sleep(max(0.0, started + at - time.perf_counter()))
        asked = time.perf_counter()
        status, _ = Client(url).send(Call("GET", "/healthz"))
        if status != 200:
            raise RuntimeError(f"/healthz answered {status}")
        times.append((time.perf_counter() - asked) * 1000)
    return times


def frames_given_up(url: str) -> int:
    """How many frames the server has given up at their deadline so far."""
    _, metrics = Client(url).send(Call("GET", "/metrics"))
    found = re.search(rb'^pose_rejected_total{reason="deadline"} (\S+)', metrics, re.MULTILINE)
    return int(float(found.group(1))) if found else 0


def overload(
    server: ServerProcess, name: str, requests: list[Call], in_flight: int, seconds: float
) -> Outcome:
    """Measure capacity, then offer ten times as much."""
    asyncio.run(ClosedLoop(server.url, requests).run(in_flight, 2))  # Warms up.
    carried = asyncio.run(ClosedLoop(server.url, requests).run(in_flight, seconds / 3))
    capacity = len(carried.of(200)) / carried.seconds
    rng = np.random.default_rng(0)
    gaps = rng.exponential(1 / (TIMES * capacity), round(TIMES * capacity * seconds))
    times = np.cumsum(gaps).tolist()
    with ProcessPoolExecutor(1) as prober:
        probes = prober.submit(probe, server.url, seconds)
        given_up = frames_given_up(server.url)
        tally = asyncio.run(OpenLoop(server.url, requests).run(times))
        given_up = frames_given_up(server.url) - given_up
        return Outcome(name, capacity, tally, probes.result(), given_up)


def spread(values: list[float]) -> str:
    """Write median, p99 and the most."""
    most = max(values, default=0.0)
    return f"{percentile(values, 50):.1f} / {percentile(values, 99):.1f} / {most:.0f}"


def report(outcomes: list[Outcome], seconds: float) -> tuple[str, list[str]]:
    """Return the section in Markdown and what has failed."""
    settings = Settings()
    deadline_s = settings.request_timeout_s
    failed = [text for outcome in outcomes for text in outcome.failures(deadline_s)]

    cells: dict[str, Callable[[Outcome], str]] = {
        "capacity, frames/s": lambda o: f"{o.capacity:.0f}",
        "offered, requests/s": lambda o: f"{len(o.tally.late_ms) / seconds:.0f}",
        "answered 200 / 503 / otherwise or not at all": lambda o: (
            f"{len(o.tally.of(200))} / {len(o.tally.of(503))} / {o.failed()}"
        ),
        "frames/s carried meanwhile": lambda o: f"{len(o.tally.of(200)) / o.tally.seconds:.0f}",
        "**`/healthz`**": lambda o: spread(o.probes_ms),
        "**rejected at once**": lambda o: spread(o.rejected_ms()),
        "**accepted**": lambda o: spread(o.accepted_ms()),
        "accepted, but given up at the deadline": lambda o: str(o.given_up),
        "sent after its time": lambda o: spread(o.tally.late_ms),
        "not sent, too many unanswered": lambda o: str(o.tally.unsent),
    }
    rows = [[name, *map(cell, outcomes)] for name, cell in cells.items()]
    body = f"""`python -m scripts.load.overload --seconds {seconds:g}`, revision {revision()}.
{machine()}. Load average before: {os.getloadavg()[0]:.1f}.

{TIMES} times capacity for {seconds:g} s at random times, from one client with at most
{MAX_CONNECTIONS} kept-alive connections; `/healthz` every {PROBE_EVERY_S * 1000:g} ms from a
process of its own, over a new connection each. **Client, probe and server share the
machine's cores**, so the server has less than it would have alone. Times are milliseconds,
median / p99 / most, as the client sees them, its own delays included. Frames of 320x240.
Deadline of an accepted frame: {settings.request_timeout_s:g} s (`POSE_REQUEST_TIMEOUT_S`).

{table(["", *(outcome.name for outcome in outcomes)], rows)}

Targets: p99 of `/healthz` and of rejections under 50 ms, every accepted frame within its
deadline, nothing but 200 and 503 with `Retry-After`."""
    return body, failed


def main() -> int:
    """Command line; 1 where a criterion fails."""
    parser = measurement_parser("Overload a real server.")
    parser.add_argument("--seconds", type=float, default=20.0)
    options = parser.parse_args()
    settings = Settings()
    in_flight = settings.concurrency + 2
    outcomes = []
    with ServerProcess(options.index, log=Path("/tmp/overload-server.log")) as server:
        server.wait_until_ready()
        for name, requests in calls(load_index(options.index)).items():
            outcomes.append(overload(server, name, requests, in_flight, options.seconds))
        body, failed = report(outcomes, options.seconds)
    return conclude("Ten times the load it carries", body, failed, write=options.write)


if __name__ == "__main__":
    sys.exit(main())
