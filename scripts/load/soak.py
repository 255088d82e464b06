"""Send a server many requests, good and bad, and watch its memory and its latency.

    python -m scripts.load.soak [--index index/data] [--requests 20000] [--write]

Fails where a request is answered with a 5xx other than 503, where resident memory at the end
is more than 5 % above that after warm-up, or where good requests have become slower.
"""

from __future__ import annotations

import sys
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from index.artefact import load_index
from index.store import PoseIndex
from scripts.experiments.report import table
from scripts.load.client import Call, Client
from scripts.load.scenes import encode, street
from scripts.load.server import ServerProcess
from scripts.results import conclude, machine, measurement_parser, percentile, revision

CLIENTS = 2
MEMORY_GROWTH = 0.05
LATENCY_GROWTH = 1.25
REST_S = 0.2


@dataclass(frozen=True)
class Kind:
    """A kind of request, its share of all, and whether the client hangs up before the answer."""

    name: str
    weight: float
    calls: list[Call]
    hang_up: bool = False


def kinds(index: PoseIndex) -> list[Kind]:
    """Return the mixture: four fifths good, a fifth bad."""
    scenes = [street(index, width=640, height=480, seed=seed) for seed in range(8)]
    frames = [encode(".jpg", frame) for frame, _ in scenes]
    masks = [encode(".png", mask) for _, mask in scenes]
    pairs = [{"frame": f, "mask": m} for f, m in zip(frames, masks, strict=True)]
    boxed = [{"frame": frame, "boxes": b"[[270, 130, 100, 220]]"} for frame in frames]
    rng = np.random.default_rng(0)
    noise = [rng.bytes(int(size)) for size in rng.integers(0, 20_000, 8)]
    small = encode(".png", np.ones((10, 10), np.uint8))
    huge = encode(".png", np.zeros((9000, 9000), np.uint8))

    def post(path: str, forms: list[dict[str, bytes]]) -> list[Call]:
        return [Call("POST", path, form) for form in forms]

    return [
        Kind("pose with a mask", 0.52, post("/pose", pairs)),
        Kind("pose, coco17, n=50", 0.06, post("/pose?keypoints=coco17&n=50", pairs)),
        Kind("pose with boxes", 0.06, post("/pose", boxed)),
        Kind("pose, people searched for", 0.02, post("/pose", [{"frame": f} for f in frames])),
        Kind("overlay", 0.03, post("/pose/overlay", pairs)),
        Kind("silhouette", 0.03, post("/silhouette", pairs)),
        Kind(
            "camera, people followed",
            0.04,
            [
                Call("POST", f"/cameras/soak-{number}/frames", {"frame": frame})
                for number, frame in enumerate(frames)
            ],
        ),
        Kind(
            "camera, frame of no use",
            0.01,
            post(
                "/cameras/soak-0/frames", [{"frame": noise[0]}, {"frame": frames[0], "mask": small}]
            ),
        ),
        Kind(
            "camera, late frame",
            0.01,
            # Its first frame begins the session; all others are of the same moment, thus late.
            post("/cameras/soak-late/frames", [{"frame": frames[1], "timestamp": b"1"}]),
        ),
        Kind("camera forgotten", 0.005, [Call("DELETE", "/cameras/soak-2")]),
        Kind("cameras listed", 0.005, [Call("GET", "/cameras")]),
        Kind("deepstack", 0.02, post("/v1/vision/detection", [{"image": f} for f in frames])),
        Kind("entry", 0.06, [Call("GET", f"/index/entries/{e}") for e in range(8)]),
        Kind("undecodable", 0.04, post("/pose", [{"frame": data} for data in noise])),
        Kind(
            "truncated",
            0.03,
            post("/pose", [{"frame": f[: len(f) // 2], "boxes": b"[]"} for f in frames]),
        ),
        Kind("bomb", 0.01, post("/pose", [{"frame": huge}])),
        Kind("other size", 0.03, post("/pose", [{"frame": frames[0], "mask": small}])),
        Kind("bad boxes", 0.02, post("/pose", [{"frame": frames[0], "boxes": b"[[1, 2]]"}])),
        Kind("bad n", 0.02, post("/pose?n=0", pairs)),
        Kind("no frame", 0.02, post("/pose", [{"boxes": b"[]"}])),
        Kind("no such path", 0.01, [Call("GET", "/nothing")]),
        Kind("client hangs up", 0.02, post("/pose", boxed), hang_up=True),
    ]  # fmt: skip


class Soak:
    """Clients in threads that share a count of what is still to be sent."""

    def __init__(self, server: ServerProcess, mixture: list[Kind], requests: int) -> None:
        self._server = server
        self.mixture = mixture
        self._requests = requests
        self._lock = threading.Lock()
        # Each is held while its client has a request in flight.
        self._in_flight = [threading.Lock() for _ in range(CLIENTS)]
        self._positions = iter(range(1, requests + 1))
        self.statuses: Counter[tuple[str, int]] = Counter()
        self.broken: Counter[str] = Counter()
        self.main_latencies: list[tuple[int, float]] = []
        self.memory: list[tuple[int, float]] = []

    def run(self) -> None:
        """Send everything."""
        with ThreadPoolExecutor(CLIENTS) as threads:
            list(threads.map(self._client, range(CLIENTS)))

    def _measure_memory(self, position: int) -> None:
        """Measure memory while nothing is in flight: one frame can hold tens of megabytes."""
        with ExitStack() as stack:
            for lock in self._in_flight:
                stack.enter_context(lock)
            time.sleep(REST_S)  # For what a client that hung up has left.
            self.memory.append((position, self._server.memory_mb()))

    def _client(self, number: int) -> None:
        rng = np.random.default_rng(number)
        weights = np.array([kind.weight for kind in self.mixture])
        client = Client(self._server.url)
        for position in self._positions:
            if position % max(1, self._requests // 40) == 0:
                self._measure_memory(position)
            kind = self.mixture[rng.choice(len(weights), p=weights / weights.sum())]
            call = kind.calls[rng.integers(len(kind.calls))]
            started = time.perf_counter()
            try:
                with self._in_flight[number]:
                    if kind.hang_up:
                        client.hang_up(call)
                        continue
                    status, _ = client.send(call)
            except Exception as error:  # Whatever it is, it is counted and shown.
                with self._lock:
                    self.broken[f"{kind.name}: {type(error).__name__}"] += 1
                continue
            elapsed = (time.perf_counter() - started) * 1000
            with self._lock:
                self.statuses[kind.name, status] += 1
                if kind is self.mixture[0] and status == 200:
                    self.main_latencies.append((position, elapsed))


def report(
    soak: Soak, server: ServerProcess, requests: int, seconds: float
) -> tuple[str, list[str]]:
    """Return the section in Markdown and what has failed."""
    warm = requests // 10
    fifth = requests // 5
    # Threads come and go with their buffers: one moment says little, so the median of a fifth.
    after_warm_up = percentile(
        [mb for position, mb in soak.memory if warm <= position < warm + fifth], 50
    )
    at_end = percentile([mb for position, mb in soak.memory if position > requests - fifth], 50)
    early = [ms for position, ms in soak.main_latencies if warm <= position < warm + fifth]
    late = [ms for position, ms in soak.main_latencies if position >= requests - fifth]
    deliberate = sum(n for (_, status), n in soak.statuses.items() if status == 503)
    faults = {key: n for key, n in soak.statuses.items() if key[1] >= 500 and key[1] != 503}
    slower = percentile(late, 99) > LATENCY_GROWTH * percentile(early, 99)
    larger = at_end > after_warm_up * (1 + MEMORY_GROWTH)
    criteria = {
        f"5xx besides 503: {faults}": not faults,
        f"broken connections: {dict(soak.broken)}": not soak.broken,
        f"memory grew from {after_warm_up:.0f} to {at_end:.0f} MB": not larger,
        "the p99 of good requests grew": not slower,
    }
    failed = [what for what, met in criteria.items() if not met]
    along = [f"{mb:.0f}" for position, mb in soak.memory if position % (requests // 10) == 0]
    rows = [
        [kind.name, "nobody waits" if kind.hang_up else ", ".join(
            f"{n} x {status}" for (name, status), n in sorted(soak.statuses.items())
            if name == kind.name
        )]
        for kind in soak.mixture
    ]  # fmt: skip
    body = f"""`python -m scripts.load.soak --requests {requests}`, revision {revision()}.
{machine()}; {CLIENTS} clients on the same machine, {seconds:.0f} s,
{requests / seconds:.0f} requests/s.

| medians of a fifth of the run | after warm-up ({warm} requests) | at the end |
|---|---|---|
| resident memory at rest | {after_warm_up:.1f} MB | {at_end:.1f} MB \
({at_end / after_warm_up - 1:+.1%}) |
| `/pose` with a mask, median | {percentile(early, 50):.1f} ms | {percentile(late, 50):.1f} ms |
| `/pose` with a mask, p99 | {percentile(early, 99):.1f} ms | {percentile(late, 99):.1f} ms |

Resident memory in megabytes after each tenth: {", ".join(along)}.
5xx besides deliberate 503s: {sum(faults.values())}; deliberate 503s: {deliberate};
broken connections: {sum(soak.broken.values())}.
The server ended with status {server.stop()}.

{table(["request", "answers"], rows)}"""
    return body, failed


def main() -> int:
    """Command line; 1 where a criterion fails."""
    parser = measurement_parser("Soak a real server.")
    parser.add_argument("--requests", type=int, default=20_000)
    options = parser.parse_args()
    mixture = kinds(load_index(options.index))
    with ServerProcess(options.index, log=Path("/tmp/soak-server.log")) as server:
        server.wait_until_ready()
        soak = Soak(server, mixture, options.requests)
        started = time.perf_counter()
        soak.run()
        seconds = time.perf_counter() - started
        body, failed = report(soak, server, options.requests, seconds)
    return conclude("Soak", body, failed, write=options.write)


if __name__ == "__main__":
    sys.exit(main())
