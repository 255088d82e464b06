"""Real frames on which the models of rendered people are asked: tests only, nothing is fitted.

Each frame is read as the service reads it (detector, windows, landmark network); what the networks
gave can be kept in a folder outside the repository, since reading takes most of the time.
"""

from __future__ import annotations

import json
import pickle
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.photograph import load_models
from app.settings import Settings
from app.vision.blazepose import PoseReading
from app.vision.geometry import Box
from app.vision.people import Detection
from app.vision.person_reader import attenuate_visibility_at_border
from scripts.datasets import read_frames, read_lsp, read_pose2sim

LOW, UPRIGHT, SITTING, ANY = "on the ground", "upright", "sitting", ""
"""Truths that the labels of real frames know; ANY where posture is not asked."""

LONGEST_PX = 1280
_PER_SECOND = 2.0


@dataclass(frozen=True)
class Shown:
    """A frame of a source.

    Parameters
    ----------
    source, name : str
    frame : (H, W, 3) uint8 array
    truth : str
    box : Box or None
        Where the person is, if that is known.
    joints_3d, joints_2d : (12, 3) and (12, 2) float64 arrays or None
        Limb joints in camera axes and in pixels, where they are known.
    """

    source: str
    name: str
    frame: NDArray[np.uint8]
    truth: str
    box: Box | None = None
    joints_3d: NDArray[np.float64] | None = None
    joints_2d: NDArray[np.float64] | None = None
    visible: NDArray[np.bool_] | None = None


@dataclass(frozen=True)
class ReadFrame:
    """A frame that was read: the people in it, the largest first.

    Parameters
    ----------
    source, name, truth : str
    shape : tuple of int
        Height and width.
    readings : list of PoseReading
        Visibility doubted at the border; the mask is left out.
    scores : list of float
        Of the detections.
    """

    source: str
    name: str
    truth: str
    shape: tuple[int, int]
    readings: list[PoseReading]
    scores: list[float]
    joints_3d: NDArray[np.float64] | None = None
    joints_2d: NDArray[np.float64] | None = None
    visible: NDArray[np.bool_] | None = None


def _frames(path: Path, per_second: float) -> Iterator[tuple[float, NDArray[np.uint8]]]:
    """Frames of a video at a rate, each with its time in seconds."""
    rate, due = cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FPS) or 25.0, 0.0
    for number, frame in read_frames(path):
        if number / rate + 1e-6 >= due:
            yield number / rate, frame
            due += 1 / per_second


def pose2sim(real: Path) -> Iterator[Shown]:
    """Every eighth frame of three cameras, with its true box."""
    for camera in ("cam01", "cam02", "cam03"):
        for found in read_pose2sim(real / "pose2sim", camera, 8):
            reference = found.reference
            yield Shown(
                f"pose2sim {camera}", found.name, found.frame, UPRIGHT, found.box,
                reference.joints_3d, reference.joints_2d,
            )  # fmt: skip


@dataclass(frozen=True)
class HomeFilm:
    """A film of ``real/homes`` and what its labels say.

    Parameters
    ----------
    name, source, about : str
        File, data set, description.
    path : Path
    classes : list of (str, float, float)
        Activity, and from when to when, seconds.
    fall : float or None
        Begin of the fall, seconds.
    crop : (4,) tuple of float
        Part of the frame that shows the scene: left, top, width, height as shares.
    """

    name: str
    source: str
    about: str
    path: Path
    classes: list[tuple[str, float, float]]
    fall: float | None
    crop: tuple[float, float, float, float]

    def frames(self, per_second: float) -> Iterator[tuple[float, NDArray[np.uint8]]]:
        """Frames at a rate, cropped, each with its time in seconds."""
        x, y, width, height = self.crop
        for at, frame in _frames(self.path, per_second):
            rows, columns = frame.shape[:2]
            top, left = int(y * rows), int(x * columns)
            part = frame[top : int((y + height) * rows), left : int((x + width) * columns)]
            yield at, np.ascontiguousarray(part)

    def truth(self, at: float) -> str | None:
        """The posture at a time; None where the labels do not say it."""
        truths = {"Sitting": SITTING, "Standing": UPRIGHT, "Walking": UPRIGHT, "Sleeping": LOW}
        if any(name.startswith("Fall") and at > begin + 1.5 for name, begin, _ in self.classes):
            return LOW
        now = {c for c, begin, end in self.classes if begin + 0.3 <= at <= end - 0.3}
        known = {truths[name] for name in now if name in truths}
        return known.pop() if len(known) == 1 else None


def home_films(real: Path) -> Iterator[HomeFilm]:
    """Films of homes, in the order of their names."""
    sources = {"gmdcsa": "GMDCSA24", "assist": "ASSIST-IoT", "t2vbed": "T2V-Bed-Fall"}
    for name, about in sorted(json.loads((real / "homes" / "labels.json").read_text()).items()):
        classes, fall = [tuple(row) for row in about["classes"]], about["fall"]
        if not classes and "_roll_" in name:
            classes = [("Sleeping", -1.0, 9.0)]
        if not classes and ("walking" in name or "jogging" in name):
            classes = [("Walking", 0.5, 99.0)]
        if "imm_stomach" in name:
            classes = [("Sleeping", -1.0, 99.0)]
        if "t2vbed" in name and fall is not None:
            # On the ground from two seconds after the fall begins.
            classes = [("Sleeping", fall + 1.7, 99.0)]
        yield HomeFilm(
            name, sources.get(name.split("_")[0], "phones"), about["description"],
            real / "homes" / name, classes, fall, tuple(about.get("crop", (0, 0, 1, 1))),
        )  # fmt: skip


def homes(real: Path) -> Iterator[Shown]:
    """Frames of homes whose posture is known, two a second."""
    for film in home_films(real):
        for at, frame in film.frames(_PER_SECOND):
            truth = film.truth(at)
            if truth is not None:
                yield Shown(film.source, f"{film.name} {at:.1f}", frame, truth)


def upfall(real: Path) -> Iterator[Shown]:
    """A frame a second of activities, and the last second of falls."""
    truths = {6: UPRIGHT, 7: UPRIGHT, 8: SITTING, 10: UPRIGHT, 11: LOW}
    for path in sorted((real / "upfall").glob("*.mp4")):
        activity = int(path.name.split("_")[0][8:])
        frames = list(_frames(path, 6.0 if activity <= 5 else 1.0))
        if activity <= 5:
            frames = frames[-6::2]
        elif activity not in truths:
            continue
        elif activity in (8, 11):
            # People first sit or lie down.
            frames = [one for one in frames if one[0] > 4]
        truth = truths.get(activity, LOW)
        for at, image in frames:
            yield Shown(f"UP-Fall {path.stem[-4:]}", f"{path.stem} {at:.1f}", image, truth)


def falls(real: Path) -> Iterator[Shown]:
    """Photographs of people who fell, and of others, some of whom rest."""
    for kind, truth in (("fall", LOW), ("not-fall", "not " + LOW)):
        for path in sorted((real / "falls" / kind).glob("*.jpg")):
            image = cv2.imread(str(path))
            if image is not None:
                yield Shown("Ambianic", f"{kind}/{path.name}", np.asarray(image, np.uint8), truth)


def odd(real: Path) -> Iterator[Shown]:
    """Animals, bags, desks, riders: inputs on which answers were wrong."""
    folder = real / "odd"
    for path in sorted([*folder.glob("*.jpg"), *folder.glob("*.png")]):
        image = cv2.imread(str(path))
        if image is not None:
            yield Shown("odd", path.name, np.asarray(image, np.uint8), ANY)


def lsp(real: Path) -> Iterator[Shown]:
    """Sports photographs with limb joints: whether landmarks are right."""
    for one in read_lsp(real / "lsp"):
        yield Shown("LSP", one.name, one.frame, ANY, None, None, one.limbs, one.visible)


SOURCES = {"pose2sim": pose2sim, "homes": homes, "upfall": upfall, "falls": falls, "odd": odd,
           "lsp": lsp}  # fmt: skip


def read_sources(real: Path, names: Sequence[str], cache: Path | None) -> list[ReadFrame]:
    """Read the frames of sources, or take what was kept of them.

    Raises
    ------
    FileNotFoundError
        If there is no such data.
    """
    if not real.is_dir():
        raise FileNotFoundError(f"expected real frames in {real}, found none")
    found: list[ReadFrame] = []
    for name in names:
        kept = cache / f"{name}.pickle" if cache is not None else None
        if kept is not None and kept.is_file():
            found += pickle.loads(kept.read_bytes())
            continue
        read = _read(SOURCES[name](real), name)
        if kept is not None:
            kept.parent.mkdir(parents=True, exist_ok=True)
            kept.write_bytes(pickle.dumps(read))
        found += read
    return found


def _read(frames: Iterator[Shown], name: str) -> list[ReadFrame]:
    settings = Settings()
    models = load_models(settings.concurrency, settings.min_person_px)
    read = []
    for shown in tqdm(frames, desc=name, unit="frame"):
        frame, scale = shown.frame, min(1.0, LONGEST_PX / max(shown.frame.shape))
        if scale < 1 and shown.joints_2d is None:
            frame = np.asarray(
                cv2.resize(frame, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8
            )
        detections = (
            models.detector.detect(frame) if shown.box is None else [Detection(shown.box, 1.0)]
        )
        detections = sorted(detections, key=lambda one: -one.box.area)
        readings = []
        for one in detections:
            reading = models.reader.read(frame, one.box, one.keypoints, one.windows)
            readings.append(_light(reading, frame.shape))
        read.append(
            ReadFrame(
                shown.source,
                shown.name,
                shown.truth,
                (frame.shape[0], frame.shape[1]),
                readings,
                [one.score for one in detections],
                shown.joints_3d,
                shown.joints_2d,
                shown.visible,
            )
        )
    return read


def _light(reading: PoseReading, shape: tuple[int, ...]) -> PoseReading:
    """The same reading without its mask, its visibility doubted at the border."""
    return PoseReading(
        reading.window,
        attenuate_visibility_at_border(reading, shape),
        reading.presence,
        np.zeros((0, 0), np.float32),
        reading.next_window,
        reading.keypoints,
        reading.network_pass,
    )
