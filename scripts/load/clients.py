"""See whether any of eight clients starves that wait for answers and come back when told to.

    python -m scripts.load.clients [--index index/data] [--seconds 60] [--write]

First two clients, for the rate that the service carries; then eight; then eight beside one caller
with ten times as many connections, from an address of its own. Masks, then photographs. Another
process asks ``/healthz`` meanwhile.
"""

from __future__ import annotations

import re
import sys
import threading
import time
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial

from app.settings import Settings
from index.artefact import load_index
from scripts.experiments.report import table
from scripts.load.client import Call, Client
from scripts.load.overload import PROBE_P99_MS, calls, probe
from scripts.load.server import ServerProcess
from scripts.results import conclude, machine, measurement_parser, percentile, revision

CLIENTS, HEAVY = 8, 10
LEAST_SHARE = 0.95
OTHER_ADDRESS = "127.0.0.2"
BOXES = Call("POST", "/pose", {"frame": b"unread", "boxes": b"[" + b"[1, 2, 3, 4],\n" * 60_000})
HEAD = (
    "frames/s",
    "threads at work",
    "answers of a client, least / most",
    "refused",
    "the other's answers / refused",
    "answer, ms, median / most",
    "`/healthz`, ms, median / p99",
    "answered otherwise",
)


@dataclass
class Polite:
    """A client that sends the next frame when the last one is answered.

    Parameters
    ----------
    client : Client
    calls : list of Call
        Sent in turn.
    """

    client: Client
    calls: list[Call]
    answered_ms: list[float] = field(default_factory=list)
    refused: int = 0
    otherwise: int = 0

    def run(self, until: float) -> None:
        """Send frames until a time on the monotonic clock."""
        number = 0
        while time.monotonic() < until:
            started = time.monotonic()
            status, headers, _ = self.client.exchange(self.calls[number % len(self.calls)])
            if status == 200:
                number += 1
                self.answered_ms.append((time.monotonic() - started) * 1000)
            elif status == 503:
                self.refused += 1
                time.sleep(max(0.0, min(float(headers["Retry-After"]), until - time.monotonic())))
            else:
                self.otherwise += 1


@dataclass(frozen=True)
class Round:
    """What became of the clients' frames.

    Parameters
    ----------
    name : str
    polite, heavy : list of Polite
    seconds : float
    busy : float
        Share of the time in which the service's threads worked on frames. Where other programs
        take the cores, it says more than the rate.
    probes_ms : list of float
    """

    name: str
    polite: list[Polite]
    heavy: list[Polite]
    seconds: float
    busy: float
    probes_ms: list[float]

    @property
    def per_s(self) -> float:
        """Frames answered a second."""
        answered = [len(client.answered_ms) for client in (*self.polite, *self.heavy)]
        return sum(answered) / self.seconds

    def row(self) -> list[str]:
        """Return the round as a row of the table."""
        counts = [len(client.answered_ms) for client in self.polite]
        times = [ms for client in self.polite for ms in client.answered_ms]
        heavy = sum(len(client.answered_ms) for client in self.heavy)
        return [
            self.name,
            f"{self.per_s:.2f}",
            f"{self.busy:.0%}",
            f"{min(counts)} / {max(counts)}",
            str(sum(client.refused for client in self.polite)),
            f"{heavy} / {sum(client.refused for client in self.heavy)}" if self.heavy else "",
            f"{percentile(times, 50):.0f} / {max(times, default=0):.0f}",
            f"{percentile(self.probes_ms, 50):.1f} / {percentile(self.probes_ms, 99):.1f}",
            str(sum(client.otherwise for client in (*self.polite, *self.heavy))),
        ]


def seconds_worked(url: str) -> float:
    """Seconds that the service's threads have worked on frames so far."""
    _, metrics = Client(url).send(Call("GET", "/metrics"))
    found = re.search(rb'^pose_stage_seconds_sum{stage="total"} (\S+)', metrics, re.MULTILINE)
    return float(found.group(1)) if found else 0.0


def play(
    url: str,
    requests: list[Call],
    name: str,
    seconds: float,
    *,
    clients: int,
    heavy: int = 0,
    boxes: int = 0,
) -> Round:
    """Let clients send frames for some seconds, and probe meanwhile."""
    polite = [Polite(Client(url), requests) for _ in range(clients)]
    others = [Polite(Client(url, source=OTHER_ADDRESS), requests) for _ in range(heavy)]
    others += [Polite(Client(url, source=OTHER_ADDRESS), [BOXES]) for _ in range(boxes)]
    worked_s = seconds_worked(url)
    started = time.monotonic()
    until = started + seconds
    threads = [threading.Thread(target=one.run, args=(until,)) for one in (*polite, *others)]
    with ProcessPoolExecutor(1) as prober:
        probes: Future[list[float]] = prober.submit(probe, url, seconds)
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        took_s = (time.monotonic() - started) * Settings().concurrency
        busy = (seconds_worked(url) - worked_s) / took_s
        return Round(name, polite, others, seconds, busy, probes.result())


def failures(kind: str, two: Round, others: list[Round]) -> list[str]:
    """Say which criteria are missed."""
    out = []
    for played in others:
        name = f"{kind}, {played.name}"
        counts = [len(client.answered_ms) for client in played.polite]
        if min(counts) < max(counts) / 2:
            out.append(f"{name}: {min(counts)} answers to one, {max(counts)} to another")
        if max(played.per_s / two.per_s, played.busy / two.busy) < LEAST_SHARE:
            out.append(f"{name}: {played.per_s / two.per_s:.0%} of what two clients get")
        if percentile(played.probes_ms, 99) >= PROBE_P99_MS:
            out.append(f"{name}: p99 of /healthz {percentile(played.probes_ms, 99):.0f} ms")
        if any(client.otherwise for client in (*played.polite, *played.heavy)):
            out.append(f"{name}: answers besides 200 and 503")
    return out


def main() -> int:
    """Command line; 1 where a criterion fails."""
    parser = measurement_parser("Measure clients that wait and come back.")
    parser.add_argument("--seconds", type=float, default=60.0)
    options = parser.parse_args()
    sections, failed = [], []
    with ServerProcess(options.index) as server:
        server.wait_until_ready()
        for kind, requests in calls(load_index(options.index)).items():
            run = partial(play, server.url, requests)
            two = run("two", options.seconds / 3, clients=2)
            others = [
                run("eight", options.seconds, clients=CLIENTS),
                run(
                    "eight, and the other", options.seconds, clients=CLIENTS, heavy=HEAVY * CLIENTS
                ),
            ]
            failed += failures(kind, two, others)
            sections.append(table([kind, *HEAD], [played.row() for played in (two, *others)]))
        flood = run("two, and boxes without number", options.seconds / 3, clients=2, boxes=2)
        if percentile(flood.probes_ms, 99) >= PROBE_P99_MS:
            failed.append(f"{flood.name}: p99 of /healthz {percentile(flood.probes_ms, 99):.0f} ms")
        sections.append(table(["photographs", *HEAD], [flood.row()]))
    command = f"python -m scripts.load.clients --seconds {options.seconds:g}"
    body = f"""`{command}`, revision {revision()}. {machine()}.

{chr(10).join(f"{section}{chr(10)}" for section in sections)}
Each client sends the next frame of 320x240 when the last one is answered; who is refused comes back
after `Retry-After`. Clients, probe and server share the cores. The other caller, of another
address, has {HEAVY * CLIENTS} connections. Boxes without number: bodies of 0.9 MB with 60,000."""
    return conclude("Clients that wait their turn", body, failed, write=options.write)


if __name__ == "__main__":
    sys.exit(main())
