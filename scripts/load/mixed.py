"""A stream of masks beside frames of many people: how long the masks wait.

    python -m scripts.load.mixed [--people 50] [--rate 10] [--seconds 20] [--write]

One client sends frames with a box for each of many people, the next as soon as the last one is
answered; another sends masks at fixed times, each of one person and without a photograph.
"""

from __future__ import annotations

import asyncio
import json
import math
from itertools import product

import cv2
import numpy as np

from index.artefact import load_index
from index.store import PoseIndex
from scripts.load.client import Call
from scripts.load.loops import ClosedLoop, OpenLoop, Tally
from scripts.load.scenes import encode, street
from scripts.load.server import ServerProcess
from scripts.results import conclude, machine, measurement_parser, percentile, revision

WIDTH, HEIGHT = 1280, 720
MASK_P99_MS = 100.0


def crowd(index: PoseIndex, people: int) -> Call:
    """Draw a frame with people in rows, and a box about each of them."""
    frame, _ = street(index, width=WIDTH, height=HEIGHT)
    columns = math.ceil(math.sqrt(people * WIDTH / HEIGHT))
    rows = math.ceil(people / columns)
    width, height = WIDTH // columns, HEIGHT // rows
    size = min(width, height * 48 // 128), min(height, width * 128 // 48)
    boxes = []
    for number, (row, column) in enumerate(list(product(range(rows), range(columns)))[:people]):
        person = cv2.resize(index.silhouette(97 * number % len(index)), size)
        left, top = column * width, row * height
        frame[top : top + size[1], left : left + size[0]][person == 1] = (60, 50, 45)
        boxes.append([left, top, *size])
    parts = {"frame": encode(".jpg", frame), "boxes": json.dumps(boxes).encode()}
    return Call("POST", "/pose", parts)


def masks(index: PoseIndex) -> list[Call]:
    """Return masks of one person each."""
    return [
        Call("POST", "/pose", {"mask": encode(".png", street(index, seed=seed)[1])})
        for seed in range(8)
    ]


async def measure(url: str, frame: Call, stream: list[Call], rate: float, seconds: float) -> Tally:
    """Send masks at a rate while one frame after the other is worked on."""
    times = np.arange(0.0, seconds, 1 / rate).tolist()
    beside = asyncio.create_task(ClosedLoop(url, [frame]).run(1, seconds))
    tally = await OpenLoop(url, stream).run(times)
    frames = await beside
    if frames.of(503) or frames.broken:
        raise RuntimeError("expected no frame of many people to be refused")
    return tally


def main() -> None:
    """Command line."""
    parser = measurement_parser("Measure masks beside frames of many people.")
    parser.add_argument("--people", type=int, default=50)
    parser.add_argument("--rate", type=float, default=10.0, help="masks a second")
    parser.add_argument("--seconds", type=float, default=20.0)
    options = parser.parse_args()
    index = load_index(options.index)
    frame, stream = crowd(index, options.people), masks(index)
    with ServerProcess(options.index, POSE_REQUEST_TIMEOUT_S="60") as server:
        server.wait_until_ready()
        asyncio.run(
            OpenLoop(server.url, stream).run(np.arange(0, 1, 1 / options.rate))
        )  # Warms up.
        alone = asyncio.run(OpenLoop(server.url, stream).run(np.arange(0, 5, 1 / options.rate)))
        beside = asyncio.run(measure(server.url, frame, stream, options.rate, options.seconds))
    rows = [
        f"| {name} | {len(times)} | {len(tally.of(503))} | {percentile(times, 50):.0f} "
        f"| {percentile(times, 99):.0f} | {max(times):.0f} |"
        for name, tally in (("alone", alone), (f"beside {options.people} people", beside))
        if (times := [answer.ms for answer in tally.of(200)])
    ]
    body = f"""`python -m scripts.load.mixed`, revision {revision()}. {machine()}.

| masks, {options.rate:g} a second | answered | refused | median, ms | p99, ms | most, ms |
|---|---|---|---|---|---|
{chr(10).join(rows)}

Frames of {WIDTH}x{HEIGHT} with {options.people} boxes are sent one after the other meanwhile."""
    conclude("Masks beside many people", body, write=options.write)
    late = percentile([answer.ms for answer in beside.of(200)], 99)
    if late >= MASK_P99_MS:
        raise SystemExit(f"expected a p99 under {MASK_P99_MS:g} ms, got {late:.0f} ms")


if __name__ == "__main__":
    main()
