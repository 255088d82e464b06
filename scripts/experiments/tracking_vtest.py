"""The street video played to a camera session in process: times, memory, identities.

Run with ``OPENBLAS_NUM_THREADS=1 python -m scripts.experiments.tracking_vtest VIDEO``.
"""

from __future__ import annotations

import argparse
import gc
import resource
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.estimation.estimates import Person
from app.estimation.estimator import Estimator
from app.estimation.facing import azimuth_deg
from app.estimation.upload import Upload
from app.settings import Settings
from app.tracking.results import TrackedFrame, TrackedPerson
from app.tracking.session import CameraSession
from app.work.executor import Executor
from app.work.process import configure_process
from index.posture import UPRIGHT
from index.skeleton import mean_joint_distance, wrap_degrees

FRAMES_PER_S = 10.0
CONTACT_EVERY, CONTACT_WIDTH, CONTACT_COLUMNS = 10, 512, 4


def main() -> None:
    """Play the video and print what it cost and found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("video", type=Path)
    parser.add_argument("--frames", type=int, default=None, help="play only the first ones")
    parser.add_argument("--rounds", type=int, default=1, help="play it several times over")
    parser.add_argument("--n", type=int, default=7, help="hypotheses of each person")
    parser.add_argument("--evidence", choices=("photograph", "silhouette"), default="photograph")
    parser.add_argument("--sheets", type=Path, help="folder for annotated contact sheets")
    options = parser.parse_args()
    configure_process()
    settings = Settings()
    executor = Executor(settings.concurrency, settings.max_wait_s, settings.request_timeout_s)
    estimator = Estimator.load(settings, executor.map)
    estimator.warm_up()
    session = CameraSession(estimator)
    frames = 0
    for number in range(options.rounds):
        report = Report()
        for shown, data in encoded_frames(options.video, options.frames):
            result = session.process(
                Upload(frame=data), frames / FRAMES_PER_S, options.n, lambda: None, options.evidence
            )
            frames += 1
            report.add(shown, result)
            if options.sheets and shown % CONTACT_EVERY == 0:
                report.draw(result)
        print(f"round {number}: {report.summary()}")
        print(f"  resident {resident_mb():.0f} MB, session {session.memory_bytes / 1e6:.1f} MB")
    if options.sheets:
        report.save_sheets(options.sheets)
    executor.shut_down()


def encoded_frames(video: Path, limit: int | None) -> Iterator[tuple[int, bytes]]:
    """Frames as a camera sends them, JPEG at quality 90."""
    capture = cv2.VideoCapture(str(video))
    number = 0
    while (limit is None or number < limit) and (read := capture.read())[0]:
        yield number, cv2.imencode(".jpg", read[1], [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()
        number += 1


class Report:
    """What a round found and took."""

    def __init__(self) -> None:
        self.totals: list[float] = []
        self.stages: dict[str, list[float]] = defaultdict(list)
        self.people: list[int] = []
        self.cut_by: dict[str, int] = defaultdict(int)
        self.found_by: dict[str, int] = defaultdict(int)
        self.tracks: dict[int, list[int]] = defaultdict(list)
        self.changes_m: dict[str, list[float]] = {"alone": [], "smooth": []}
        self.flips: dict[str, list[bool]] = {"alone": [], "smooth": []}
        self.not_upright: dict[str, list[bool]] = {"alone": [], "smooth": []}
        self.events: Counter[str] = Counter()
        self._last: dict[tuple[str, int], NDArray[np.float64]] = {}
        self.pictures: list[NDArray[np.uint8]] = []

    def add(self, number: int, result: TrackedFrame) -> None:
        """Count a frame."""
        self.totals.append(result.timings_ms["total"])
        for stage, spent in result.timings_ms.items():
            self.stages[stage].append(spent)
        self.people.append(len(result.persons))
        for tracked in result.persons:
            observed = tracked.person.observed
            self.tracks[tracked.track_id].append(number)
            self.found_by[observed.source] += 1
            self._compare(tracked)
            self.cut_by[observed.silhouette.segmenter if observed.silhouette else "none"] += 1
            self._count_posture(tracked.person)
        self.events.update(event.event for event in result.events if event.state != "end")

    def _count_posture(self, person: Person) -> None:
        if person.hypotheses:
            self.not_upright["alone"].append(person.hypotheses[0].hypothesis.posture not in UPRIGHT)
        if person.posture is not None:
            self.not_upright["smooth"].append(person.posture.label not in UPRIGHT)

    def _compare(self, tracked: TrackedPerson) -> None:
        """Compare a person's poses with the last ones: how far joints moved, who turned round."""
        poses = {}
        if tracked.person.hypotheses:
            poses["alone"] = tracked.person.hypotheses[0].hypothesis.points_3d
        if tracked.pose is not None:
            poses["smooth"] = tracked.pose.points_3d
        for kind, pose in poses.items():
            before = self._last.get((kind, tracked.track_id))
            self._last[kind, tracked.track_id] = pose
            if before is not None:
                self.changes_m[kind].append(float(mean_joint_distance(pose, before)))
                turned = wrap_degrees(azimuth_deg(pose) - azimuth_deg(before))
                self.flips[kind].append(bool(np.abs(turned) > 90))

    def summary(self) -> str:
        """Figures of the round."""
        totals = np.array(self.totals[15:])
        lengths = sorted((len(frames) for frames in self.tracks.values()), reverse=True)
        lines = [
            f"{len(self.totals)} frames, {np.mean(self.people):.2f} people a frame; "
            f"ms median {np.median(totals):.1f}, p90 {np.quantile(totals, 0.9):.1f}, "
            f"max {totals.max():.0f}",
            "  stages (median/p90): "
            + ", ".join(
                f"{stage} {np.median(spent):.1f}/{np.quantile(spent, 0.9):.1f}"
                for stage, spent in self.stages.items()
            ),
            f"  found by {dict(self.found_by)}, cut out by {dict(self.cut_by)}",
            f"  {len(lengths)} tracks, of lengths {lengths}",
        ]
        lines += [
            f"  {kind}: 3D change from pose to pose mean {1000 * np.mean(changes):.0f} mm, median "
            f"{1000 * np.median(changes):.0f} mm; front/back flips {100 * np.mean(flips):.1f} %; "
            f"postures not upright {100 * np.mean(self.not_upright[kind]):.1f} %"
            for (kind, changes), flips in zip(
                self.changes_m.items(), self.flips.values(), strict=True
            )
        ]
        lines.append(f"  events: {dict(self.events)}")
        return "\n".join(lines)

    def draw(self, result: TrackedFrame) -> None:
        """Keep an annotated frame."""
        picture = result.frame.copy()
        for tracked in result.persons:
            observed = tracked.person.observed
            colour = tuple(
                int(c) for c in np.random.default_rng(tracked.track_id).integers(60, 255, 3)
            )
            left, top, right, bottom = observed.box.pixels()
            cv2.rectangle(picture, (left, top), (right, bottom), colour, 2)
            if observed.silhouette is not None:
                mask = observed.silhouette.mask(picture.shape).view(np.uint8)
                outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
                cv2.drawContours(picture, outlines, -1, (255, 255, 255), 1)
            cut_by = observed.silhouette.segmenter[0] if observed.silhouette else "-"
            text = f"{tracked.track_id}{observed.source[0]}{cut_by}"
            cv2.putText(picture, text, (left, top - 4), 0, 0.7, (0, 0, 0), 4)
            cv2.putText(picture, text, (left, top - 4), 0, 0.7, colour, 2)
        cv2.putText(picture, f"{result.frame_index}", (5, 25), 0, 0.8, (255, 255, 255), 2)
        height = round(picture.shape[0] * CONTACT_WIDTH / picture.shape[1])
        self.pictures.append(cv2.resize(picture, (CONTACT_WIDTH, height)).astype(np.uint8))

    def save_sheets(self, folder: Path) -> None:
        """Write the kept frames, 16 to a sheet."""
        folder.mkdir(parents=True, exist_ok=True)
        per_sheet = CONTACT_COLUMNS**2
        for start in range(0, len(self.pictures), per_sheet):
            part = self.pictures[start : start + per_sheet]
            part += [np.zeros_like(part[0])] * (-len(part) % CONTACT_COLUMNS)
            rows = [
                np.hstack(part[row : row + CONTACT_COLUMNS])
                for row in range(0, len(part), CONTACT_COLUMNS)
            ]
            cv2.imwrite(str(folder / f"sheet-{start // per_sheet:02d}.png"), np.vstack(rows))


def resident_mb() -> float:
    """Memory of this process in use."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


if __name__ == "__main__":
    main()
