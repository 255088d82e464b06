"""Live cameras before a server: what share of their frames is answered in time, and how late.

    python -m scripts.cameras [--cameras 2 4] [--rate 5] [--seconds 60] [--write]

Each camera sends a frame of a street video at fixed times, whether or not the one before has been
answered, and names itself (``X-Camera-ID``). The server runs with its default settings.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from app.http.cameras import HEADER
from scripts.load.client import Call, Client
from scripts.load.loops import OpenLoop, Tally
from scripts.load.server import ServerProcess
from scripts.results import (
    ROOT,
    machine,
    measurement_parser,
    percentile,
    revision,
    write_section,
)

PAGE = ROOT / "docs" / "results" / "cameras.md"
VIDEO = ROOT.parent / "shared" / "real" / "vtest" / "vtest.avi"
IN_TIME_MS = 1000.0
FRAMES_EACH = 50
REASONS = ("superseded", "overloaded", "deadline")
_WARM_UP_S = 2.0


@dataclass(frozen=True)
class Outcome:
    """What became of the frames of some cameras.

    Parameters
    ----------
    tallies : sequence of Tally
        One for each camera.
    seconds : float
        For which they sent.
    refused : Counter of str
        Frames refused, by the reason that the server's metrics name.
    """

    tallies: Sequence[Tally]
    seconds: float
    refused: Counter[str]

    def sent(self) -> int:
        """Frames sent by all cameras."""
        return sum(len(tally.late_ms) - tally.unsent for tally in self.tallies)

    def ages_ms(self) -> list[float]:
        """Ages of the answers with poses: from sending the frame to the last byte."""
        return [answer.ms for tally in self.tallies for answer in tally.of(200)]

    def refused_ms(self) -> list[float]:
        """After how long the other frames were answered."""
        return [answer.ms for tally in self.tallies for answer in tally.of(503)]

    def share_in_time(self) -> float:
        """Share of the frames sent that were answered with poses in time."""
        return sum(age <= IN_TIME_MS for age in self.ages_ms()) / max(1, self.sent())

    def share_of_answers_in_time(self) -> float:
        """Share of the answers with poses that came in time."""
        ages = self.ages_ms()
        return sum(age <= IN_TIME_MS for age in ages) / max(1, len(ages))

    def otherwise(self) -> int:
        """Frames answered with another status, or not at all."""
        return self.sent() - len(self.ages_ms()) - len(self.refused_ms())

    def frames_per_s(self) -> list[float]:
        """Frames a second that were answered with poses, for each camera."""
        return [len(tally.of(200)) / self.seconds for tally in self.tallies]


def read_frames(video: Path) -> list[bytes]:
    """Return the frames of a video as JPEG.

    Raises
    ------
    SystemExit
        If it cannot be read.
    """
    capture = cv2.VideoCapture(str(video))
    frames = []
    while True:
        found, frame = capture.read()
        if not found:
            break
        frames.append(cv2.imencode(".jpg", frame)[1].tobytes())
    if not frames:
        raise SystemExit(f"--video: expected a video that OpenCV reads, got {video}")
    return frames


def calls_of(camera: int, cameras: int, frames: Sequence[bytes]) -> list[Call]:
    """Return the requests of one camera: a stretch of the video of its own."""
    start = camera * len(frames) // cameras
    stretch = [frames[(start + step) % len(frames)] for step in range(FRAMES_EACH)]
    headers = {HEADER: f"camera-{camera + 1}"}
    return [Call("POST", "/pose", {"frame": frame}, headers) for frame in stretch]


def rejections(url: str) -> Counter[str]:
    """Requests the server has refused so far, by reason."""
    _, metrics = Client(url).send(Call("GET", "/metrics"))
    found = re.findall(rb'^pose_rejected_total{reason="(\w+)"} (\S+)', metrics, re.MULTILINE)
    return Counter({reason.decode(): int(float(count)) for reason, count in found})


async def send_frames(
    url: str, cameras: int, rate: float, seconds: float, frames: Sequence[bytes]
) -> list[Tally]:
    """Have all cameras send at once, each at a moment of its own between two of another."""
    phases = np.random.default_rng(0).uniform(0, 1 / rate, cameras)
    return await asyncio.gather(
        *(
            OpenLoop(url, calls_of(camera, cameras, frames)).run(
                (phase + np.arange(round(rate * seconds)) / rate).tolist()
            )
            for camera, phase in enumerate(phases)
        )
    )


def measure(
    url: str, cameras: int, rate: float, seconds: float, frames: Sequence[bytes]
) -> Outcome:
    """Let some cameras send for a while."""
    asyncio.run(send_frames(url, cameras, rate, _WARM_UP_S, frames))
    before = rejections(url)
    tallies = asyncio.run(send_frames(url, cameras, rate, seconds, frames))
    return Outcome(tallies, seconds, rejections(url) - before)


def report(outcomes: dict[int, Outcome], rate: float, seconds: float) -> str:
    """Return the section in Markdown."""

    def row(what: str, cells: list[str]) -> str:
        return f"| {what} | " + " | ".join(cells) + " |"

    def spread(values: list[float]) -> str:
        return " / ".join(f"{percentile(values, share):.0f}" for share in (50, 95, 100))

    columns = outcomes.values()
    rows = [
        row("cameras", [str(number) for number in outcomes]),
        row("---", ["---"] * len(outcomes)),
        row("frames sent a second, together", [f"{one.sent() / seconds:.1f}" for one in columns]),
        row(
            "**answered with poses within 1 s, of the frames sent**",
            [f"{one.share_in_time():.1%}" for one in columns],
        ),
        row(
            "answered with poses within 1 s, of the answers with poses",
            [f"{one.share_of_answers_in_time():.1%}" for one in columns],
        ),
        row("**age of an answer, ms**", [spread(one.ages_ms()) for one in columns]),
        row(
            "frames answered a second, least / most of a camera",
            [f"{min(one.frames_per_s()):.2f} / {max(one.frames_per_s()):.2f}" for one in columns],
        ),
        row(
            "refused: superseded by a newer frame / no room / too late",
            [
                " / ".join(
                    str(one.refused[name]) for name in ("superseded", "overloaded", "deadline")
                )
                for one in columns
            ],
        ),
        row("refused after, ms", [spread(one.refused_ms()) for one in columns]),
        row("answered otherwise or not at all", [str(one.otherwise()) for one in columns]),
        row(
            "sent after its time, ms",
            [spread([late for tally in one.tallies for late in tally.late_ms]) for one in columns],
        ),
    ]
    numbers = " ".join(str(number) for number in outcomes)
    command = f"python -m scripts.cameras --cameras {numbers} --rate {rate:g} --seconds {seconds:g}"
    return f"""`{command}`, revision {revision()}.
{machine()}. Load average before: {os.getloadavg()[0]:.1f}.

Each camera sends a frame of 768x576 with people in it (PETS 2009) to `/pose`, {rate:g} a second,
whether or not the last one has been answered, and names itself by `{HEADER}`. Default settings;
cameras and server share the machine. Milliseconds are median / p95 / most.

{chr(10).join(rows)}"""


def main() -> None:
    """Command line."""
    parser = measurement_parser("Measure a server before live cameras.", PAGE)
    parser.add_argument("--cameras", type=int, nargs="+", default=[2, 4], metavar="N")
    parser.add_argument("--rate", type=float, default=5.0, help="frames a second of each")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--video", type=Path, default=VIDEO)
    options: argparse.Namespace = parser.parse_args()
    frames = read_frames(options.video)
    with ServerProcess(options.index, log=Path("/tmp/cameras-server.log")) as server:
        server.wait_until_ready()
        outcomes = {
            number: measure(server.url, number, options.rate, options.seconds, frames)
            for number in options.cameras
        }
    body = report(outcomes, options.rate, options.seconds)
    print(body)
    if options.write:
        write_section(PAGE, f"At {options.rate:g} frames a second", body)


if __name__ == "__main__":
    main()
