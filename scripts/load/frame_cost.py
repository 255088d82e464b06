"""What a frame costs in processor time, by its kind and the people in it.

    python -m scripts.load.frame_cost [--frames 80] [--write]

Processor time of the whole server process, so that neighbours on the machine matter less than for
times by the clock. Frames of a street, and of the same street with nobody in it: the difference is
what people add.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.tracking.following import SEARCH_EVERY_S
from app.work.process import trim_heap
from index.artefact import load_index
from scripts.cameras import VIDEO, read_frames
from scripts.experiments.report import table
from scripts.load.client import Call, Client
from scripts.load.overload import calls
from scripts.load.scenes import encode
from scripts.load.server import ServerProcess
from scripts.results import ROOT, conclude, machine, measurement_parser, revision

PAGE = ROOT / "docs" / "results" / "frame-cost.md"
STRIDE = 1
RATE = 10.0
"""Frames a second: all of the video, so that sessions search only some of them."""

NOISE = 2.0
"""Standard deviation of a camera's noise, of 255."""


@dataclass(frozen=True)
class Cost:
    """Processor time of frames of a kind.

    Parameters
    ----------
    people : (N,) int array
        In each frame.
    core_ms : (N,) float64 array
        Processor time of each, to 10 ms.
    """

    people: NDArray[np.int64]
    core_ms: NDArray[np.float64]

    def each_person_ms(self, nobody: Cost) -> float:
        """Milliseconds that each person adds to a frame with nobody in it."""
        return float((self.core_ms.mean() - nobody.core_ms.mean()) / self.people.mean())

    def of_session(self, *, searched: bool) -> Cost:
        """The frames of a session that were searched as a whole, or all others."""
        whole = np.zeros(len(self.people), bool)
        searched_at = -np.inf
        for number, people in enumerate(self.people):
            if number / RATE - searched_at >= SEARCH_EVERY_S or people == 0:
                whole[number], searched_at = True, number / RATE
        chosen = whole if searched else ~whole
        return Cost(self.people[chosen], self.core_ms[chosen])

    def line(self) -> tuple[float, float]:
        """Milliseconds that each person adds, and of a frame without anybody, by least squares."""
        each, base = np.polyfit(self.people, self.core_ms, 1).tolist()
        return each, base

    def spread(self) -> float:
        """Standard deviation as a share of the mean."""
        return float(self.core_ms.std() / self.core_ms.mean())


def measure(server: ServerProcess, frames: Iterable[Call]) -> Cost:
    """Send frames one after the other."""
    client, people, times = Client(server.url), [], []
    for frame in frames:
        before = server.cpu_s()
        status, body = client.send(frame)
        if status != 200:
            raise RuntimeError(f"expected a frame to be answered with 200, got {status}")
        times.append((server.cpu_s() - before) * 1000)
        people.append(body.count(b'"detection_score":'))
    return Cost(np.array(people), np.array(times))


def still(frames: Iterable[bytes]) -> list[Call]:
    """Frames in which people are searched for all over."""
    return [Call("POST", "/pose", {"frame": frame}) for frame in frames]


def moving(camera: str, frames: Iterable[bytes]) -> list[Call]:
    """Frames of a camera session."""
    return [
        Call(
            "POST",
            f"/cameras/{camera}/frames",
            {"frame": frame, "timestamp": str(number / RATE).encode()},
        )
        for number, frame in enumerate(frames)
    ]


def nobody_in(frames: Sequence[bytes], count: int) -> list[bytes]:
    """Return frames of the scene without people: the median, and a camera's noise."""
    pictures = [cv2.imdecode(np.frombuffer(frame, np.uint8), 1) for frame in frames]
    scene = np.median(np.array(pictures), axis=0)
    rng = np.random.default_rng(0)
    noisy = (np.clip(scene + rng.normal(0, NOISE, scene.shape), 0, 255) for _ in range(count))
    return [encode(".jpg", picture.astype(np.uint8)) for picture in noisy]


def _without(name: str) -> str | None:
    """The name of the same kind of frame with nobody in it."""
    return name.replace(": people", ": nobody") if name.endswith(": people") else None


def resident_bytes() -> int:
    """Resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def main() -> None:
    """Command line."""
    parser = measurement_parser("Measure what a frame costs.", PAGE)
    parser.add_argument("--frames", type=int, default=80, help="of each kind")
    parser.add_argument("--video", type=Path, default=VIDEO)
    options = parser.parse_args()
    load = os.getloadavg()[0]
    video = read_frames(options.video)
    stretch = [video[number * STRIDE % len(video)] for number in range(options.frames)]
    before = resident_bytes()
    index = load_index(options.index)
    trim_heap()
    entry_bytes = (resident_bytes() - before) / len(index)
    masks = calls(index)["`/pose` with a mask"]
    empty = nobody_in(video[:: max(1, len(video) // 100)], options.frames)
    mask_alone = [Call("POST", "/pose", {"mask": call.parts["mask"]}) for call in masks]

    def repeated(calls: list[Call]) -> list[Call]:
        return [calls[number % len(calls)] for number in range(options.frames)]

    with ServerProcess(options.index) as server:
        server.wait_until_ready()
        measure(server, still(stretch[:3]))
        costs = {
            "cold, `/pose`: people": measure(server, still(stretch)),
            "cold, `/pose`: nobody": measure(server, still(empty)),
            "photograph and mask, 320x240": measure(server, repeated(masks)),
            "mask alone, 320x240": measure(server, repeated(mask_alone)),
        }
        for scene, pictures in (("people", stretch), ("nobody", empty)):
            session = measure(server, moving(scene, pictures))
            costs[f"session, searched as a whole: {scene}"] = session.of_session(searched=True)
            if scene == "people":
                warm = session.of_session(searched=False)
    each_warm_ms, warm_ms = warm.line()
    costs["session, warm"] = warm
    rows = [
        [
            name,
            f"{cost.people.mean():.1f}",
            f"{cost.core_ms.mean():.0f}",
            f"{cost.each_person_ms(nobody):.0f}"
            if (nobody := costs.get(_without(name) or ""))
            else "",
            f"{cost.spread():.2f}",
        ]
        for name, cost in costs.items()
    ]
    size = sum(map(len, stretch)) / len(stretch)
    header = ["frame", "people", "core-ms", "of these for each person", "spread"]
    body = f"""`python -m scripts.load.frame_cost --frames {options.frames}`, revision {revision()}.
{machine()}. Load average before: {load:.1f}; busy neighbours on the same
cores have made it up to half as much again.

Processor time of the server process, milliseconds of one core; {options.frames} frames of each
kind, one after the other. Frames of 768x576 (PETS 2009), {RATE:g} a second,
{size / 1000:.0f} kB each as JPEG.

{table(header, rows)}

A session searches the whole frame for people every {SEARCH_EVERY_S:g} s, and while it knows of
nobody; on the other frames, the warm ones, it reads whom it knows. By a line through those, by the
number of people, a warm frame takes {warm_ms:.0f} ms and {each_warm_ms:.0f} ms for each person.

The index, {len(index)} entries, takes {entry_bytes:.0f} bytes of resident memory an entry."""
    conclude("Processor time of a frame", body, write=options.write, page=PAGE)


if __name__ == "__main__":
    main()
