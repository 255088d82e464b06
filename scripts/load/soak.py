"""Send a server many requests, good and bad, and watch its memory and its latency.

Fails where a request is answered with a 5xx other than 503, where resident memory at the end
is more than 5 % above that after warm-up, or where good requests have become slower.
"""

import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial

import numpy as np

from index.store import PoseIndex
from scripts.load.client import Call, Client, Request, Tally, closed_loop
from scripts.load.scenes import encode, encoded_streets
from scripts.load.server import Criteria, Figures, ServerProcess, run, spread
from scripts.results import percentile

CLIENTS = 2
MEMORY_GROWTH = 0.05
LATENCY_GROWTH = 1.25
REST_S = 0.2
MEASUREMENTS = 40
LATE = "/cameras/soak-late/frames"
MAIN = "pose_with_mask"
HANGS_UP = "client_hangs_up"


@dataclass(frozen=True)
class Kind:
    """A kind of request, and its share of all."""

    weight: float
    calls: list[Call]


def kinds(index: PoseIndex) -> dict[str, Kind]:
    """Return the mixture: four fifths good, a fifth bad."""
    frames, masks = encoded_streets(index, 640, 480)
    pairs = [{"frame": f, "mask": m} for f, m in zip(frames, masks, strict=True)]
    alone = [{"frame": frame} for frame in frames]
    boxed = [{"frame": frame, "boxes": b"[[270, 130, 100, 220]]"} for frame in frames]
    halves = [{"frame": frame[: len(frame) // 2], "boxes": b"[]"} for frame in frames]
    rng = np.random.default_rng(0)
    noise = [{"frame": rng.bytes(int(size))} for size in rng.integers(0, 20_000, 8)]
    small = {"frame": frames[0], "mask": encode(".png", np.ones((10, 10), np.uint8))}
    huge = {"frame": encode(".png", np.zeros((9000, 9000), np.uint8))}

    def post(path: str, *forms: dict[str, bytes]) -> list[Call]:
        return [Call("POST", path, form) for form in forms]

    cameras = [post(f"/cameras/soak-{n}/frames", form)[0] for n, form in enumerate(alone)]
    shares: dict[str, tuple[float, list[Call]]] = {
        MAIN: (0.52, post("/pose", *pairs)),
        "pose_coco17_n_50": (0.06, post("/pose?keypoints=coco17&n=50", *pairs)),
        "pose_with_boxes": (0.06, post("/pose", *boxed)),
        "pose_people_searched_for": (0.02, post("/pose", *alone)),
        "overlay": (0.03, post("/pose/overlay", *pairs)),
        "silhouette": (0.03, post("/silhouette", *pairs)),
        "camera_people_tracked": (0.04, cameras),
        "camera_unusable_frame": (0.01, post("/cameras/soak-0/frames", noise[0], small)),
        "camera_late_frame": (0.01, post(LATE, late_frame(frames[1]))),
        "camera_forgotten": (0.005, [Call("DELETE", "/cameras/soak-2")]),
        "cameras_listed": (0.005, [Call("GET", "/cameras")]),
        "deepstack": (0.02, post("/v1/vision/detection", *({"image": f} for f in frames))),
        "entry": (0.06, [Call("GET", f"/index/entries/{e}") for e in range(8)]),
        "undecodable": (0.04, post("/pose", *noise)),
        "truncated": (0.03, post("/pose", *halves)),
        "bomb": (0.01, post("/pose", huge)),
        "other_size": (0.03, post("/pose", small)),
        "bad_boxes": (0.02, post("/pose", {"frame": frames[0], "boxes": b"[[1, 2]]"})),
        "bad_n": (0.02, post("/pose?n=0", *pairs)),
        "no_frame": (0.02, post("/pose", {"boxes": b"[]"})),
        "no_such_path": (0.01, [Call("GET", "/nothing")]),
        HANGS_UP: (0.02, post("/pose", *boxed)),
    }
    return {name: Kind(*share) for name, share in shares.items()}


def late_frame(frame: bytes) -> dict[str, bytes]:
    """Return the form of a frame whose timestamp never advances: late (409) after the first one."""
    return {"frame": frame, "timestamp": b"1"}


class Soak:
    """Clients that share a count of requests still to be sent."""

    def __init__(self, server: ServerProcess, mixture: dict[str, Kind], requests: int) -> None:
        self._server, self._mixture = server, mixture
        self._every = max(1, requests // MEASUREMENTS)
        # Each is held while its client has a request in flight.
        self._in_flight = [threading.Lock() for _ in range(CLIENTS)]
        self._positions = iter(range(1, requests + 1))
        self.memory: list[tuple[int, float]] = []

    def run(self) -> Tally:
        """Send everything."""
        clients = [(Client(self._server.url), self._requests(n)) for n in range(CLIENTS)]
        return closed_loop(clients)

    def _requests(self, client: int) -> Iterator[Request]:
        rng = np.random.default_rng(client)
        weights = np.array([kind.weight for kind in self._mixture.values()])
        names = list(self._mixture)
        for position in self._positions:
            if position % self._every == 0:
                self._measure_memory(position)
            name = names[rng.choice(len(weights), p=weights / weights.sum())]
            calls = self._mixture[name].calls
            call = calls[rng.integers(len(calls))]
            with self._in_flight[client]:
                yield Request(call, name, position, hang_up=name == HANGS_UP)

    def _measure_memory(self, position: int) -> None:
        """Measure memory while nothing is in flight: one frame can hold tens of megabytes."""
        with ExitStack() as stack:
            for lock in self._in_flight:
                stack.enter_context(lock)
            time.sleep(REST_S)  # The server ends the work of clients that hung up.
            self.memory.append((position, self._server.memory_mb()))


def figures(tally: Tally, memory: Sequence[tuple[int, float]], requests: int) -> Figures:
    """Return figures of the fifth after warm-up and of the last fifth.

    Threads come and go with their buffers, so that one moment says little: memory is the median of
    a fifth.
    """
    warm_up, fifth = requests // 10, requests // 5
    good = [
        (answer.request.number, answer.ms)
        for answer in tally.with_status(200)
        if answer.request.kind == MAIN
    ]

    def early(values: Sequence[tuple[int, float]]) -> list[float]:
        return [value for position, value in values if warm_up <= position < warm_up + fifth]

    def late(values: Sequence[tuple[int, float]]) -> list[float]:
        return [value for position, value in values if position >= requests - fifth]

    memory_mb = {"early": percentile(early(memory), 50), "late": percentile(late(memory), 50)}
    tenths = [mb for position, mb in memory if position % (requests // 10) == 0]
    faults = [answer for answer in tally.answers if answer.status >= 500 and answer.status != 503]
    return {
        "warm_up": warm_up,
        "memory_mb": memory_mb,
        "memory_growth": memory_mb["late"] / memory_mb["early"] - 1,
        "memory_mb_by_tenth": tenths,
        "memory_mb_min": min(tenths, default=0.0),
        "memory_mb_max": max(tenths, default=0.0),
        "early_ms": spread(early(good)),
        "late_ms": spread(late(good)),
        "faults": len(faults),
        "deliberate_503": len(tally.with_status(503)),
        "broken": len(tally.broken),
    }


def answers(tally: Tally, names: Sequence[str]) -> dict[str, dict[str, int]]:
    """Count the answers of each kind of request by status."""
    found = Counter((answer.request.kind, answer.status) for answer in tally.answers)
    return {
        name: {str(status): n for (kind, status), n in sorted(found.items()) if kind == name}
        for name in names
    }


def criteria(found: Figures) -> Criteria:
    """Return the criteria, and whether each is met."""
    memory, early, late = found["memory_mb"], found["early_ms"]["p99"], found["late_ms"]["p99"]
    return {
        f"{found['faults']} answers 5xx besides 503": not found["faults"],
        f"{found['broken']} broken connections": not found["broken"],
        f"memory grew from {memory['early']:.0f} to {memory['late']:.0f} MB": (
            found["memory_growth"] <= MEMORY_GROWTH
        ),
        f"p99 of good requests grew from {early:.0f} to {late:.0f} ms": (
            late <= LATENCY_GROWTH * early
        ),
    }


def measure(server: ServerProcess, index: PoseIndex, requests: int) -> tuple[Figures, Criteria]:
    """Soak a server."""
    if requests < MEASUREMENTS:
        raise ValueError(f"--requests: expected at least {MEASUREMENTS}, got {requests}")
    mixture = kinds(index)
    soak = Soak(server, mixture, requests)
    tally = soak.run()
    found = {
        "requests": requests,
        "clients": CLIENTS,
        "seconds": tally.seconds,
        "per_s": requests / tally.seconds,
        **figures(tally, soak.memory, requests),
        "answers": answers(tally, list(mixture)),
        "exit_status": server.stop(),
    }
    return found, criteria(found)


main = partial(run, measure, "soak", "requests", 20_000)
