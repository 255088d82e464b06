"""Print where the time of a frame goes: milliseconds and core-milliseconds of each stage.

The frames are processed in this process, so that the processor time of a stage is that of all its
threads. ``idle`` is the share of the cores that a frame leaves unused while it is processed.
"""

import argparse
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from app.camera import CameraSession
from app.estimation.results import Evidence
from app.estimation.upload import Upload
from app.photograph import Estimator, load_estimator
from app.scheduling.job import STAGES, Job, ParallelMap
from app.scheduling.process import available_cores
from app.settings import Settings
from index import DEFAULT_PATH
from index.matching import DEFAULT_HYPOTHESES
from scripts.figures import report
from scripts.load.bench import FILM, Street, back_and_forth
from scripts.load.scenes import encode
from scripts.results import SHARED

TOTAL = "total"

Process = Callable[[Job, int], object]
"""Processes a case's frame of a number."""


class ProfiledJob(Job):
    """A job that counts the processor time of its stages as well."""

    def __init__(self, parallel_map: ParallelMap) -> None:
        super().__init__(parallel_map=parallel_map)
        self.core_ms = dict.fromkeys(STAGES, 0.0)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the processor time that all threads spend inside."""
        started = time.process_time()
        with super().stage(name):
            yield
        self.core_ms[name] += (time.process_time() - started) * 1000


def profiled(process: Process, parallel_map: ParallelMap) -> dict[str, tuple[float, float]]:
    """Return means over a film: milliseconds and core-milliseconds of each stage and in all."""
    process(Job(parallel_map=parallel_map), 0)  # Warms up.
    rows = []
    for number in range(1, FILM + 1):
        job, started = ProfiledJob(parallel_map), time.process_time()
        process(job, number)
        core_ms = {**job.core_ms, TOTAL: (time.process_time() - started) * 1000}
        rows.append([(job.timings_ms()[name], core_ms[name]) for name in core_ms])
    means = np.mean(np.array(rows), axis=0).tolist()
    return {name: tuple(pair) for name, pair in zip((*STAGES, TOTAL), means, strict=True)}


def processes(estimator: Estimator, street: Street) -> dict[str, Process]:
    """Return the kinds of frames by their titles."""

    def estimating(evidence: Evidence = "photograph", **images: Any) -> Process:
        upload = Upload(**images)
        return lambda job, _: estimator.estimate(upload, DEFAULT_HYPOTHESES, job, evidence)

    def following(film: Sequence[bytes]) -> Process:
        session = CameraSession(estimator)
        return lambda job, number: session.process(
            Upload(frame=film[number % len(film)]), number / 10, DEFAULT_HYPOTHESES, job
        )

    silhouette = estimator.find_people(Upload(street.frame, boxes=[street.box]), Job()).persons[0]
    assert silhouette.silhouette is not None
    mask = encode(".png", silhouette.silhouette.mask(street.busy[0].shape).astype(np.uint8))
    film, tall = back_and_forth(street.film), back_and_forth(street.tall)
    return {
        "photograph, 768x576, four walkers": estimating(frame=street.frame),
        "photograph, 1080x1920, two people": estimating(frame=tall[0]),
        "one caller's box": estimating(frame=street.frame, boxes=[street.box]),
        "one mask": estimating(frame=street.frame, mask=mask),
        "one mask, `evidence=silhouette`": estimating("silhouette", mask=mask),
        "camera, 768x576, street": following(film),
        "camera, 1080x1920, two people": following(tall),
    }


def table(found: Mapping[str, Mapping[str, tuple[float, float]]], cores: int) -> list[Any]:
    """Return a row of figures for each stage that takes time."""
    return [
        {
            "frame": frame,
            "stage": stage,
            "wall_ms": wall_ms,
            "core_ms": core_ms,
            "idle": max(0.0, 1 - core_ms / (cores * wall_ms)),
        }
        for frame, stages in found.items()
        for stage, (wall_ms, core_ms) in stages.items()
        if wall_ms >= 0.05
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    """Profile as the command line asks."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--index", type=Path, default=DEFAULT_PATH)
    parser.add_argument("--shared", type=Path, default=SHARED)
    parser.add_argument("--write", action="store_true", help="into docs/results/profile")
    options = parser.parse_args(arguments)
    cores = available_cores()
    estimator = load_estimator(Settings(index=options.index))
    kinds = processes(estimator, Street.read(options.shared / "real"))
    with ThreadPoolExecutor(cores) as pool:

        def parallel_map(function: Callable[[Any], Any], items: Any, /) -> list[Any]:
            return list(pool.map(function, items))

        found = {title: profiled(process, parallel_map) for title, process in kinds.items()}
    figures = {"frames": FILM, "cores": cores, "stages": table(found, cores)}
    report("profile", arguments, figures, keep=options.write)
