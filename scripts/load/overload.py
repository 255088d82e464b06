"""Offer a server ten times the load it can carry.

Capacity is measured first, with two requests more in flight than are processed at once. Then ten
times that many requests are sent each second, whether answered or not, at random times, while
another process asks ``/healthz`` every few milliseconds, each time over a new connection, as
an orchestrator does.
"""

import itertools
import os
import re
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np

from app.settings import Settings
from index.store import PoseIndex
from scripts.load.client import (
    MAX_CONNECTIONS,
    Call,
    Client,
    Request,
    Tally,
    closed_loop,
    open_loop,
)
from scripts.load.scenes import small_calls
from scripts.load.server import Criteria, Figures, ServerProcess, run, spread

TIMES = 10
PROBE_EVERY_S, PROBE_P99_MS = 0.02, 50.0
REJECTED_P99_MS = 50.0
GIVEN_UP = 'pose_rejected_total{reason="deadline"}'


def overload(url: str, calls: list[Call], in_flight: int, seconds: float) -> Figures:
    """Measure capacity, then offer ten times as much."""
    requests = [Request(call) for call in calls]

    def carried(duration: float) -> Tally:
        clients = [(Client(url), itertools.cycle(requests)) for _ in range(in_flight)]
        return closed_loop(clients, duration)

    carried(2)  # Warms up.
    most = carried(seconds / 3)
    capacity = len(most.with_status(200)) / most.seconds
    rng = np.random.default_rng(0)
    gaps = rng.exponential(1 / (TIMES * capacity), round(TIMES * capacity * seconds))
    with ProcessPoolExecutor(1) as prober:
        probes = prober.submit(probe, url, seconds)
        given_up = metric(url, GIVEN_UP)
        tally = open_loop(url, itertools.cycle(requests), np.cumsum(gaps).tolist())
        given_up = metric(url, GIVEN_UP) - given_up
        return figures(capacity, tally, probes.result(), round(given_up), seconds)


def figures(
    capacity: float, tally: Tally, probes_ms: list[float], given_up: int, seconds: float
) -> Figures:
    """Return what became of the requests; ``given_up`` ones got a 503 at their deadline."""
    accepted, refused = tally.with_status(200), tally.with_status(503)
    # All but those that were accepted first are rejected at once.
    rejected_ms = sorted(answer.ms for answer in refused)[: len(refused) - given_up]
    sent = len(tally.late_ms) - tally.unsent
    return {
        "capacity": capacity,
        "offered_per_s": len(tally.late_ms) / seconds,
        "accepted": len(accepted),
        "rejected": len(refused),
        "failed": sent - len(accepted) - len(refused),
        "carried_per_s": len(accepted) / tally.seconds,
        "healthz_ms": spread(probes_ms),
        "rejected_ms": spread(rejected_ms),
        "accepted_ms": spread([answer.ms for answer in accepted]),
        "given_up": given_up,
        "late_ms": spread(tally.late_ms),
        "unsent": tally.unsent,
        "without_retry_after": sum(answer.retry_after_s is None for answer in refused),
        "broken": len(tally.broken),
        "statuses": tally.statuses(),
    }


def criteria(name: str, found: Figures, deadline_s: float) -> Criteria:
    """Return the criteria, and whether each is met."""
    statuses, broken, given_up = found["statuses"], found["broken"], found["given_up"]
    healthz, rejections = found["healthz_ms"]["p99"], found["rejected_ms"]["p99"]
    in_time = not given_up and found["accepted_ms"]["max"] <= deadline_s * 1000
    return {
        f"{name}: answers {statuses}, {broken} broken connections": (
            not broken and set(statuses) <= {"200", "503"}
        ),
        f"{name}: 503 without Retry-After": not found["without_retry_after"],
        f"{name}: p99 of /healthz {healthz:.0f} ms": healthz < PROBE_P99_MS,
        f"{name}: p99 of rejections {rejections:.0f} ms": rejections < REJECTED_P99_MS,
        f"{name}: {given_up} accepted frames given up at their deadline": in_time,
    }


def measure(server: ServerProcess, index: PoseIndex, seconds: float) -> tuple[Figures, Criteria]:
    """Overload a server with both kinds of requests."""
    settings, load_average = Settings(), os.getloadavg()[0]
    kinds = {
        name: overload(server.url, calls, settings.concurrency + 2, seconds)
        for name, calls in small_calls(index).items()
    }
    met: Criteria = {}
    for name, found in kinds.items():
        met |= criteria(name, found, settings.request_timeout_s)
    found = {
        "load_average": load_average,
        "times": TIMES,
        "seconds": seconds,
        "max_connections": MAX_CONNECTIONS,
        "probe_every_ms": 1000 * PROBE_EVERY_S,
        "deadline_s": settings.request_timeout_s,
        "kinds": kinds,
    }
    return found, met


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


def metric(url: str, sample: str) -> float:
    """Return the value of a sample of ``/metrics``; 0 where there is none yet."""
    _, metrics = Client(url).send(Call("GET", "/metrics"))
    found = re.search(rf"^{re.escape(sample)} (\S+)", metrics.decode(), re.MULTILINE)
    return float(found.group(1)) if found else 0.0


main = partial(run, measure, "overload", "seconds", 20.0)
