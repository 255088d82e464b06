"""Measure what memory the service takes: with small frames, large ones, and more workers.

python -m scripts.load.memory [--workers 1 2 3] [--write]
"""

from __future__ import annotations

import asyncio
from pathlib import Path

from index.artefact import load_index
from index.store import PoseIndex
from scripts.load.client import Call
from scripts.load.loops import ClosedLoop
from scripts.load.overload import calls
from scripts.load.scenes import encode, street
from scripts.load.server import ServerProcess
from scripts.results import conclude, machine, measurement_parser, revision

SECONDS_A_WORKER = 5.0
# The largest that the service takes by default, in a camera's proportions.
LARGE = (4080, 3060)


def large_frame(index: PoseIndex) -> list[Call]:
    """Return a search for people in a frame of 12.5 megapixels."""
    width, height = LARGE
    frame, _ = street(index, width=width, height=height, person_px=1500)
    return [Call("POST", "/pose", {"frame": encode(".jpg", frame)})]


def peaks(path: Path, small: list[Call], large: list[Call]) -> list[str]:
    """Return rows of resident memory, now and at the most, as the work grows."""
    rows: list[str] = []

    def row(what: str) -> None:
        now, most = server.memory_mb(), server.memory_mb("VmHWM")
        rows.append(f"| {what} | {now:.0f} MB | {most:.0f} MB |")

    with ServerProcess(path, POSE_REQUEST_TIMEOUT_S="120") as server:
        server.wait_until_ready()
        row("ready")
        asyncio.run(ClosedLoop(server.url, small).run(4, SECONDS_A_WORKER))
        row("small frames")
        for at_once in (1, 2):
            tally = asyncio.run(ClosedLoop(server.url, large).run(at_once, SECONDS_A_WORKER))
            if tally.broken:
                raise RuntimeError("the server did not answer a large frame")
            row(f"frames of {LARGE[0]}x{LARGE[1]}, {at_once} at once")
    return rows


def with_workers(path: Path, workers: int, small: list[Call]) -> str:
    """Return a row of the memory of all processes."""
    with ServerProcess(path, WORKERS=str(workers), POSE_MAX_CAMERAS="0") as server:
        server.wait_until_ready()
        # Connections are spread over the workers by the system: several for each.
        asyncio.run(ClosedLoop(server.url, small).run(4 * workers, SECONDS_A_WORKER * workers))
        return f"| {workers} | {server.shared_out_memory_mb():.0f} MB |"


def main() -> None:
    """Command line."""
    parser = measurement_parser("Measure what memory the service takes.")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 3])
    options = parser.parse_args()
    index = load_index(options.index)
    small = [call for kind in calls(index).values() for call in kind]
    rows = peaks(options.index, small, large_frame(index))
    workers = [with_workers(options.index, count, small) for count in options.workers]
    body = f"""`python -m scripts.load.memory`, revision {revision()}. {machine()}.

| one process, two threads | resident | at the most so far |
|---|---|---|
{chr(10).join(rows)}

| `WORKERS` | all processes together, small frames |
|---|---|
{chr(10).join(workers)}

Small frames are 320x240, with a mask and without. Pages that several processes share are
counted once (proportional set size)."""
    conclude("Memory", body, write=options.write)


if __name__ == "__main__":
    main()
