"""Build an index on a Dask cluster of this machine, and once more while a worker is killed.

python -m scripts.experiments.cluster [--entries 6000] [--write]
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory

from index.artefact import save_index
from index.build.builder import Asked, Plan, build
from index.build.cluster import Cluster
from index.build.simulate import SHARD_POSES
from index.build.workers import Result, Task, Threads, Workers
from scripts.experiments.report import table
from scripts.results import ROOT, machine, revision, write_section

PAGE = ROOT / "docs" / "results" / "cluster.md"
CALIBRATION = Asked(150, 75, 45)
WORKERS = 2


@dataclass(frozen=True)
class Built:
    """What a build came to: version, seconds in all and of drawing, peak of resident memory."""

    version: str
    seconds: float
    drawing_s: float
    peak_mb: float


class Timed:
    """Workers, and how long they took.

    Parameters
    ----------
    workers : Workers
    """

    def __init__(self, workers: Workers) -> None:
        self._workers = workers
        self.seconds = 0.0

    def map(self, perform: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """Perform tasks; see :class:`index.build.workers.Workers`."""
        start = time.perf_counter()
        yield from self._workers.map(perform, tasks)
        self.seconds += time.perf_counter() - start


def peak_mb() -> float:
    """Return the most resident memory that this process ever took, in megabytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) / 1024
    raise ValueError("/proc tells no VmHWM")


def coordinate(
    shared: Path, entries: int, address: str | None, folder: Path, answer: Connection
) -> None:
    """Build an index, in a process of its own, and send what it came to."""
    start = time.perf_counter()
    with Cluster(address) if address else nullcontext(Threads()) as workers:
        timed = Timed(workers)
        index = build(
            shared / "mocap",
            shared / "garments",
            Plan(entries=entries, calibration=CALIBRATION),
            name="cluster",
            workers=timed,
            shards=nullcontext(folder / "shards"),
        )
    version = save_index(index, folder / "index")
    answer.send(Built(version, time.perf_counter() - start, timed.seconds, peak_mb()))


@contextmanager
def dask(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run ``dask`` in a process of its own."""
    process = subprocess.Popen(
        [sys.executable, "-m", "dask", *arguments, "--no-dashboard"],
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield process
    finally:
        process.terminate()
        process.wait()


def on_cluster(
    shared: Path, entries: int, *, nanny: bool, killed: bool
) -> tuple[Built, list[float]]:
    """Build on a cluster; return what that came to, and the peaks of the workers, megabytes.

    Parameters
    ----------
    shared : Path
    entries : int
    nanny : bool
        Whether workers have a nanny, which starts another in place of one that dies.
    killed : bool
        Whether a worker is killed when half of the shards are there.
    """
    from distributed import Client

    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        file = folder / "scheduler.json"
        stack.enter_context(
            dask("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file))
        )
        options = [
            *("--scheduler-file", str(file), "--nthreads", "1", "--local-directory", str(folder)),
            "--nanny" if nanny else "--no-nanny",
        ]
        for _ in range(WORKERS):
            stack.enter_context(dask("worker", *options))
        while not file.exists():
            time.sleep(0.1)
        client = stack.enter_context(Client(scheduler_file=str(file)))
        client.wait_for_workers(WORKERS, timeout=120)
        pids = client.run(os.getpid)
        half = (entries // Plan.views // SHARD_POSES + 1) // 2

        def kill_one() -> None:
            shards = folder / "shards"
            while len(list(shards.glob("shard-*"))) < half and not (folder / "index").exists():
                time.sleep(0.05)
            os.kill(next(iter(pids.values())), signal.SIGKILL)

        built = build_apart(
            shared, entries, client.scheduler.address, folder, kill_one if killed else None
        )
        return built, sorted(client.run(peak_mb).values())


def build_apart(
    shared: Path,
    entries: int,
    address: str | None,
    folder: Path,
    meanwhile: Callable[[], None] | None = None,
) -> Built:
    """Build in a process of its own, while something else is done in this one."""
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=coordinate, args=(shared, entries, address, folder, sender))
    process.start()
    sender.close()
    if meanwhile is not None:
        meanwhile()
    built: Built = receiver.recv()
    process.join()
    return built


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--shared", type=Path, default=ROOT.parent / "shared")
    parser.add_argument("--entries", type=int, default=6000)
    parser.add_argument("--write", action="store_true", help=f"into {PAGE.name}")
    options = parser.parse_args()
    with TemporaryDirectory() as folder:
        local = build_apart(options.shared, options.entries, None, Path(folder))
    rows = [row("local, threads", local, [], local)]
    print(rows[-1], flush=True)
    for title, nanny, killed in (
        ("two workers", True, False),
        ("one of them killed, its nanny starts another", True, True),
        ("one of them killed, no nanny", False, True),
    ):
        built, workers = on_cluster(options.shared, options.entries, nanny=nanny, killed=killed)
        rows.append(row(title, built, workers, local))
        print(rows[-1], flush=True)
    command = f"python -m scripts.experiments.cluster --entries {options.entries}"
    header = ["who draws", "hash", "build", "drawing", "coordinator's peak", "workers' peaks"]
    body = f"""`{command}`, revision {revision()}.
{machine()}; scheduler, workers and other work shared it.

{table(header, rows)}

{options.entries:,} entries in shards of {SHARD_POSES} poses; {WORKERS} workers of one thread each.
Times are shares of the local build's, which took {local.seconds:.0f} s, {local.drawing_s:.0f} s of
them drawing. A worker was killed (SIGKILL) when half of the shards were there. A worker that is
started in its place is listed instead of it."""
    print(body)
    if options.write:
        write_section(PAGE, "Two workers against one process", body)


def row(title: str, built: Built, workers: list[float], local: Built) -> list[str]:
    """Return a row of the table."""
    return [
        title,
        built.version.removeprefix("sha256:")[:12],
        f"{built.seconds / local.seconds:.2f}",
        f"{built.drawing_s / local.drawing_s:.2f}",
        f"{built.peak_mb:.0f} MB",
        ", ".join(f"{peak:.0f} MB" for peak in workers),
    ]


if __name__ == "__main__":
    main()
