"""Two replicas behind the balancer: throughput, sessions that stay, and a replica that ends.

    python -m scripts.load.replicas [--rounds 5] [--seconds 8] [--write]

Each replica is bound to a core of its own, as if on another machine. Client and balancer share the
cores: look at ratios. Needs HAProxy.
"""

from __future__ import annotations

import asyncio
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from index.artefact import load_index
from scripts.experiments.report import table
from scripts.load.balancer import Balancer
from scripts.load.client import Call, Client
from scripts.load.loops import ClosedLoop, Tally
from scripts.load.overload import calls
from scripts.load.server import ServerProcess
from scripts.results import (
    ROOT,
    conclude,
    machine,
    measurement_parser,
    percentile,
    revision,
)

PAGE = ROOT / "docs" / "results" / "replicas.md"
IN_FLIGHT = 2
"""Requests in flight for each replica: one is worked on, one waits."""
CAMERAS = 24
_NOWHERE = "http://127.0.0.1:1"


@contextmanager
def on_core(core: int) -> Iterator[None]:
    """Have processes that are started meanwhile stay on one core."""
    all_cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {core})
    try:
        yield
    finally:
        os.sched_setaffinity(0, all_cores)


@dataclass(frozen=True)
class Throughput:
    """Frames a second of each setting, one for each round; all settings in every round.

    Parameters
    ----------
    settings : dict of str to list of float
    core_ms : dict of str to list of float
        Processor time that the replicas took for each frame.
    """

    settings: dict[str, list[float]]
    core_ms: dict[str, list[float]]

    def ratio(self, setting: str, of: str) -> str:
        """Write the median, least and most of a ratio over the rounds."""
        ratios = [
            above / below
            for above, below in zip(self.settings[setting], self.settings[of], strict=True)
        ]
        return f"{percentile(ratios, 50):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"


async def frames_per_s(urls: Sequence[str], in_flight: int, frames: list[Call], s: float) -> float:
    """Keep requests in flight at each of the URLs; return the answers with poses a second."""
    tallies = await asyncio.gather(*(ClosedLoop(url, frames).run(in_flight, s) for url in urls))
    if any(len(tally.of(200)) < len(tally.answers) or tally.broken for tally in tallies):
        raise RuntimeError("expected every frame to be answered with poses")
    return sum(len(tally.of(200)) / tally.seconds for tally in tallies)


def throughput(
    replicas: Sequence[ServerProcess], frames: list[Call], rounds: int, seconds: float
) -> Throughput:
    """Measure one replica and two, directly and through the balancer, in turns."""
    first, second = (replica.url for replica in replicas)
    with Balancer(first, _NOWHERE) as before_one, Balancer(first, second) as before_two:
        settings = {
            "one, directly": ([first], IN_FLIGHT),
            "one, through the balancer": ([before_one.url], IN_FLIGHT),
            "two, directly": ([first, second], IN_FLIGHT),
            "two, through the balancer": ([before_two.url], 2 * IN_FLIGHT),
        }
        for urls, in_flight in settings.values():
            asyncio.run(frames_per_s(urls, in_flight, frames, 2.0))
        found = Throughput({name: [] for name in settings}, {name: [] for name in settings})
        for _ in range(rounds):
            for name, (urls, in_flight) in settings.items():
                used_s = -sum(replica.cpu_s() for replica in replicas)
                rate = asyncio.run(frames_per_s(urls, in_flight, frames, seconds))
                used_s += sum(replica.cpu_s() for replica in replicas)
                found.settings[name].append(rate)
                found.core_ms[name].append(1000 * used_s / (rate * seconds))
    return found


def send_cameras(url: str, frames: Sequence[Call], site: str) -> dict[str, list[str]]:
    """Send a frame of each camera, again while there is no room for it.

    Returns
    -------
    dict of str to list of str
        ``X-Session`` and ``X-Replica`` of the answers, by path.
    """
    client, found = Client(url), {}
    for number in range(CAMERAS):
        frame = frames[number % len(frames)]
        call = Call("POST", f"/cameras/{site}-{number}/frames", frame.parts)
        status, headers, _ = client.exchange(call)
        while status == 503:
            time.sleep(0.1)
            status, headers, _ = client.exchange(call)
        if status != 200:
            raise RuntimeError(f"expected a camera's frame to be tracked, got {status}")
        found[call.path] = [headers["X-Session"], headers["X-Replica"]]
    client.close()
    return found


@dataclass(frozen=True)
class Ended:
    """What callers saw of a replica that ended under load.

    Parameters
    ----------
    tally : Tally
        Frames to ``/pose``, sent all the time.
    sessions : list of str
        ``X-Session`` of the cameras by where their session was, after the end and after the
        replica was back.
    """

    tally: Tally
    sessions: list[str]

    def statuses(self) -> str:
        """Count the answers."""
        counts = Counter(answer.status for answer in self.tally.answers)
        told = ", ".join(f"{count} x {status}" for status, count in sorted(counts.items()))
        return f"{told}; {self.tally.broken} connections closed"


def _states(before: dict[str, list[str]], now: dict[str, list[str]], ended: str) -> str:
    counts = Counter(
        ("its own" if before[path][1] == ended else "others", session)
        for path, (session, _) in now.items()
    )
    return "; ".join(
        f"{where}: " + ", ".join(f"{counts[where, state]} {state}" for state in ("new", "warm"))
        for where in ("its own", "others")
    )


async def end_one(
    balancer: Balancer,
    replica: ServerProcess,
    end: Callable[[], object],
    frames: list[Call],
    seconds: float,
) -> Ended:
    """End the second replica while frames are sent, and start it again."""
    # Names that no replica has seen: else it might hold a session of them from the last time.
    site = end.__name__
    before = send_cameras(balancer.url, frames, site)
    load = asyncio.create_task(ClosedLoop(balancer.url, frames).run(IN_FLIGHT, 3 * seconds))
    await asyncio.sleep(seconds)
    await asyncio.to_thread(end)
    now = await asyncio.to_thread(send_cameras, balancer.url, frames, site)
    states = [_states(before, now, "pose-2")]
    await asyncio.sleep(seconds)
    with on_core(1):
        replica.__enter__()
    await asyncio.to_thread(replica.wait_until_ready)
    tally = await load
    await asyncio.sleep(3)  # Until the balancer has seen that it is ready.
    states.append(_states(before, send_cameras(balancer.url, frames, site), "pose-2"))
    return Ended(tally, states)


def report(
    rates: Throughput,
    stickiness: str,
    ended: dict[str, Ended],
    rounds: int,
    seconds: float,
) -> str:
    """Return the section in Markdown."""
    one, two = "one, through the balancer", "two, through the balancer"
    rows = [
        [
            name,
            f"{percentile(values, 50):.1f} ({min(values):.1f} to {max(values):.1f})",
            f"{percentile(rates.core_ms[name], 50):.0f}",
            f"{percentile(values, 50) * percentile(rates.core_ms[name], 50) / 1000:.2f}",
        ]
        for name, values in rates.settings.items()
    ]
    ratios = [
        ["**two replicas over one, through the balancer**", rates.ratio(two, one)],
        ["two over one, directly", rates.ratio("two, directly", "one, directly")],
        ["balancer over directly, one replica", rates.ratio(one, "one, directly")],
        ["balancer over directly, two replicas", rates.ratio(two, "two, directly")],
    ]
    ends = [
        [
            name,
            case.statuses(),
            f"{max(answer.ms for answer in case.tally.answers):.0f}",
            *case.sessions,
        ]
        for name, case in ended.items()
    ]
    command = f"python -m scripts.load.replicas --rounds {rounds} --seconds {seconds:g}"
    return f"""`{command}`, revision {revision()}.
{machine()}. Load average before: {os.getloadavg()[0]:.1f}. Other programs use this machine, and
client, balancer and both replicas share its cores: ratios say more than rates, and what a frame
costs in processor time more than both. Two replicas carry twice as much only where they get twice
the cores; what they got stands below.

`/pose` with a mask, frames of 320x240, `POSE_CONCURRENCY=1`, {IN_FLIGHT} requests in flight for
each replica, which is bound to a core; median (least to most) of {rounds} rounds of
{seconds:g} s, all settings in each round.

{table(["replicas", "frames/s", "core-ms a frame", "cores they got"], rows)}

{table(["ratio within a round", ""], ratios)}

**Sessions.** {stickiness}

**A replica ends under load.** {IN_FLIGHT} clients send frames to `/pose` one after the other; the
second replica ends after {seconds:g} s and is started again after {2 * seconds:g} s. Each of
{CAMERAS} cameras sends a frame after the end, and another when the replica is back; sessions are
counted by where they were before. A connection is closed in place of a 502 where it has carried
requests before.

{table(["", "`/pose`", "slowest, ms", "cameras after the end", "cameras when it is back"], ends)}"""


def main() -> int:
    """Command line; 1 where a camera has changed its replica for no reason."""
    parser = measurement_parser("Measure two replicas behind the balancer.", PAGE)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=8.0)
    options = parser.parse_args()
    frames = calls(load_index(options.index))["`/pose` with a mask"]
    with ExitStack() as stack:
        replicas = [ServerProcess(options.index, POSE_CONCURRENCY="1") for _ in range(2)]
        for core, replica in enumerate(replicas):
            with on_core(core):
                stack.enter_context(replica)
            replica.wait_until_ready()
        rates = throughput(replicas, frames, options.rounds, options.seconds)
        second = replicas[1]
        with Balancer(*(replica.url for replica in replicas)) as balancer:
            rounds = [send_cameras(balancer.url, frames, "yard") for _ in range(5)]
            moved = sum(len({answers[path][1] for answers in rounds}) > 1 for path in rounds[0])
            places = Counter(replica for _, replica in rounds[0].values())
            states = Counter(state for answers in rounds for state, _ in answers.values())
            stickiness = (
                f"{CAMERAS} cameras, 5 frames of each: "
                + " and ".join(f"{places[name]} cameras" for name in sorted(places))
                + f" on the replicas, {moved} ever on both; {states['new']} frames began a "
                f"session, {states['warm']} found one."
            )
            ends = {"killed (`SIGKILL`)": second.kill, "stopped (`SIGTERM`)": second.stop}
            ended = {
                name: asyncio.run(end_one(balancer, second, end, frames, options.seconds))
                for name, end in ends.items()
            }
    body = report(rates, stickiness, ended, options.rounds, options.seconds)
    conclude("Two replicas", body, write=options.write, page=PAGE)
    return 1 if moved else 0


if __name__ == "__main__":
    sys.exit(main())
