"""See whether any of eight clients starves; each waits for answers and returns after a refusal.

First two clients, for the rate that the service carries; then eight; then eight beside one caller
with ten times as many connections, from an address of its own. Masks, then photographs. Another
process asks ``/healthz`` meanwhile.
"""

from __future__ import annotations

import itertools
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

from app.settings import Settings
from index.store import PoseIndex
from scripts.load.client import (
    PROBE_P99_MS,
    Call,
    Client,
    Request,
    Tally,
    closed_loop,
    metric,
    probe,
)
from scripts.load.scenes import small_calls
from scripts.load.server import Criteria, Figures, ServerProcess, run
from scripts.results import percentile

CLIENTS, HEAVY = 8, 10
MIN_SHARE = 0.95
OTHER_ADDRESS = "127.0.0.2"
BOXES = Call("POST", "/pose", {"frame": b"unread", "boxes": b"[" + b"[1, 2, 3, 4],\n" * 60_000})
WORKED_S = 'pose_stage_seconds_sum{stage="total"}'


def play(
    url: str, calls: list[Call], seconds: float, clients: int, *, heavy: int = 0, boxes: int = 0
) -> Figures:
    """Let clients send frames for some seconds beside the other caller, and probe meanwhile."""

    def client(calls: list[Call], source: str | None = None) -> tuple[Client, Any]:
        return Client(url, source=source), itertools.cycle(map(Request, calls))

    senders = [client(calls) for _ in range(clients)]
    senders += [client(calls, OTHER_ADDRESS) for _ in range(heavy)]
    senders += [client([BOXES], OTHER_ADDRESS) for _ in range(boxes)]
    worked_s = metric(url, WORKED_S)
    with ProcessPoolExecutor(1) as prober:
        probes = prober.submit(probe, url, seconds)
        started = time.monotonic()
        tallies = closed_loop(senders, seconds, patient=True)
        available_s = (time.monotonic() - started) * Settings().concurrency
        busy = (metric(url, WORKED_S) - worked_s) / available_s
        return figures(tallies[:clients], tallies[clients:], seconds, busy, probes.result())


def figures(
    polite: list[Tally], others: list[Tally], seconds: float, busy: float, probes_ms: list[float]
) -> Figures:
    """Return what became of the frames.

    ``busy`` is the share of the time in which the service's threads worked on frames. Where other
    programs take the cores, it says more than the rate.
    """
    counts = [len(tally.with_status(200)) for tally in polite]
    own, other = Tally.of(polite), Tally.of(others) if others else Tally()
    answered_ms = [answer.ms for answer in own.with_status(200)]
    every = [*own.answers, *other.answers]
    return {
        "per_s": sum(answer.status == 200 for answer in every) / seconds,
        "busy": busy,
        "min_answers": min(counts),
        "max_answers": max(counts),
        "refused": len(own.with_status(503)),
        "other_answers": len(other.with_status(200)) if others else None,
        "other_refused": len(other.with_status(503)) if others else None,
        "median_ms": percentile(answered_ms, 50),
        "max_ms": max(answered_ms, default=0.0),
        "healthz_p50_ms": percentile(probes_ms, 50),
        "healthz_p99_ms": percentile(probes_ms, 99),
        "otherwise": sum(answer.status not in (200, 503) for answer in every)
        + len(own.broken)
        + len(other.broken),
    }


def criteria(kind: str, rounds: dict[str, Figures]) -> Criteria:
    """Return the criteria of the rounds after the first, and whether each is met."""
    two, *others = rounds.items()
    out: Criteria = {}
    for name, found in others:
        fewest, most = found["min_answers"], found["max_answers"]
        shares = [found[key] / two[1][key] for key in ("per_s", "busy")]
        p99 = found["healthz_p99_ms"]
        out |= {
            f"{kind}, {name}: {fewest} answers to one, {most} to another": fewest >= most / 2,
            f"{kind}, {name}: {shares[0]:.0%} of the rate of two": max(shares) >= MIN_SHARE,
            f"{kind}, {name}: p99 of /healthz {p99:.0f} ms": p99 < PROBE_P99_MS,
            f"{kind}, {name}: answers besides 200 and 503": not found["otherwise"],
        }
    return out


def measure(server: ServerProcess, index: PoseIndex, seconds: float) -> tuple[Figures, Criteria]:
    """Let clients compete for each kind of request."""
    heavy = HEAVY * CLIENTS
    rounds: dict[str, dict[str, Figures]] = {}
    met: Criteria = {}
    for kind, calls in small_calls(index).items():
        rounds[kind] = {
            "two": play(server.url, calls, seconds / 3, 2),
            "eight": play(server.url, calls, seconds, CLIENTS),
            "eight_and_the_other": play(server.url, calls, seconds, CLIENTS, heavy=heavy),
        }
        met |= criteria(kind, rounds[kind])
    flood = play(server.url, calls, seconds / 3, 2, boxes=2)
    rounds[kind]["two_and_boxes_without_number"] = flood
    p99 = flood["healthz_p99_ms"]
    met[f"boxes without number: p99 of /healthz {p99:.0f} ms"] = p99 < PROBE_P99_MS
    return {"heavy_connections": heavy, "rounds": rounds}, met


main = partial(run, measure, "clients", "seconds", 60.0)
