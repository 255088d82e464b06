"""The photographs and videos of ``../shared/real``, read into arrays with what is known of them."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import Box, Boxes
from app.vision.images import decode_image
from app.vision.masks import decode_mask
from index.skeleton import LIMBS
from scripts.results import ROOT

MAX_PIXELS = 50_000_000
HIPS = [LIMBS.index("left_hip"), LIMBS.index("right_hip")]
LOW, UPRIGHT, SITTING = "on the ground", "upright", "sitting"
"""Postures that the labels of films know."""

POSE2SIM_CAMERAS = ("cam01", "cam03")
VTEST_FRAMES = 20
"""Frames of the street video that are marked, evenly chosen."""


@dataclass(frozen=True)
class Photograph:
    """A street photograph, BGR, with its true label image: 0 background, k = person k."""

    name: str
    frame: NDArray[np.uint8]
    labels: NDArray[np.uint16]

    @property
    def boxes(self) -> list[Box]:
        """Tight boxes of the labelled people, by label."""
        return [tight_box(self.labels == k) for k in range(1, int(self.labels.max()) + 1)]

    @property
    def odd(self) -> bool:
        """Whether the photograph's number is odd: nothing was tuned on that half."""
        return int(Path(self.name).stem[-5:]) % 2 == 1


@dataclass(frozen=True)
class Reference:
    """Positions of :data:`LIMBS`: pixels, and metres in camera axes about the hips."""

    joints_2d: NDArray[np.float64]
    joints_3d: NDArray[np.float64]

    @property
    def azimuth_deg(self) -> float:
        """As :func:`app.estimation.posture.azimuth_deg`, of shoulders and hips."""
        return azimuth_of_limbs(self.joints_3d)


@dataclass(frozen=True)
class StreetPerson:
    """One of the people of ``landmarks.json``: photograph, label and reference."""

    photograph: Photograph
    label: int
    reference: Reference

    @property
    def box(self) -> Box:
        """The person's true box."""
        return self.photograph.boxes[self.label - 1]


@dataclass(frozen=True)
class VideoFrame:
    """A frame of ``pose2sim``, BGR, with the person's joints and a padded box around them."""

    name: str
    frame: NDArray[np.uint8]
    reference: Reference
    box: Box


@dataclass(frozen=True)
class Marks:
    """The people marked by hand in one numbered frame of the street video.

    ``people`` are walkers at least half visible and 50 px tall. Boxes of the others are ignored.
    """

    frame: int
    people: list[Box]
    ignored: list[Box]


@dataclass(frozen=True)
class Athlete:
    """An annotated person of a sports photograph: pixels ``(12, 2)`` of :data:`LIMBS`."""

    name: str
    frame: NDArray[np.uint8]
    encoded: bytes
    limbs: NDArray[np.float64]
    visible: NDArray[np.bool_]
    every_joint: NDArray[np.float64]
    trunk_deg: float


def azimuth_of_limbs(joints_3d: NDArray[np.float64]) -> float:
    """As :func:`app.estimation.posture.azimuth_deg`, of limb joints ``(12, 3)``."""
    across = joints_3d[0] - joints_3d[1] + joints_3d[6] - joints_3d[7]
    return float(np.rad2deg(np.arctan2(-across[2], across[0])))


def about_hips(joints_3d: NDArray[np.float64]) -> NDArray[np.float64]:
    """Limb joints ``(..., 12, 3)`` relative to the middle of the hips."""
    return np.asarray(joints_3d - joints_3d[..., HIPS, :].mean(axis=-2, keepdims=True))


def tight_box(mask: NDArray[np.bool_]) -> Box:
    """Smallest box around the pixels of a mask."""
    x, y, width, height = cv2.boundingRect(mask.astype(np.uint8))
    return Box(x - 0.5, y - 0.5, width, height)


def padded_box(joints: NDArray[np.float64], share: float = 0.05) -> Box:
    """Box around joints ``(J, 2)``, each side moved out by a share of the larger extent."""
    low, high = joints.min(axis=0), joints.max(axis=0)
    pad = share * float((high - low).max())
    width, height = (high - low + 2 * pad).tolist()
    return Box(float(low[0]) - pad, float(low[1]) - pad, width, height)


def as_array(boxes: Sequence[Box]) -> Boxes:
    """Boxes as an ``(N, 4)`` array."""
    return np.array([[b.x, b.y, b.width, b.height] for b in boxes], np.float64).reshape(-1, 4)


def read_pennfudan(folder: Path) -> list[Photograph]:
    """Read all photographs with masks in a folder."""
    photographs = []
    for path in sorted(folder.glob("*.jpg")):
        mask_path = path.with_name(f"{path.stem}_mask.png")
        frame = decode_image(path.read_bytes(), max_pixels=MAX_PIXELS).pixels
        labels = decode_mask(mask_path.read_bytes(), max_pixels=MAX_PIXELS).labels
        photographs.append(Photograph(path.name, frame, labels.astype(np.uint16)))
    if not photographs:
        raise FileNotFoundError(f"expected photographs in {folder}, found none")
    return photographs


def read_street_people(folder: Path, photographs: Sequence[Photograph]) -> list[StreetPerson]:
    """Read the people of ``landmarks.json``."""
    document = _read(folder / "landmarks.json")
    if tuple(document["joint_names"]) != LIMBS:
        raise ValueError(f"expected the joints {LIMBS}, got {document['joint_names']}")
    by_name = {photograph.name: photograph for photograph in photographs}
    return [
        StreetPerson(
            by_name[one["image"]],
            one["person"],
            Reference(np.array(one["joints_2d"]), about_hips(np.array(one["joints_3d"]))),
        )
        for one in document["people"]
    ]


def read_lsp(folder: Path) -> Iterator[Athlete]:
    """Yield the annotated people of the sports photographs."""
    document = _read(folder / "joints.json")
    order = [document["joint_names"].index(name) for name in LIMBS]
    for one in document["people"]:
        joints, encoded = np.array(one["joints_2d"]), (folder / one["image"]).read_bytes()
        yield Athlete(
            one["image"], np.asarray(cv2.imdecode(np.frombuffer(encoded, np.uint8), 1), np.uint8),
            encoded, joints[order], np.array(one["visible"])[order], joints, one["trunk_deg"],
        )  # fmt: skip


def read_pose2sim_joints(
    folder: Path, camera: str
) -> tuple[Path, NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return one camera's video, limbs ``(F, 12, 2)``, ``(F, 12, 3)`` and all joints in 2D."""
    document = _read(folder / f"{camera}.json")
    names = document["joint_names"]
    rows = [names.index(name[0].upper() + name.split("_")[1].title()) for name in LIMBS]
    joints_2d, joints_3d = (np.array(document[key]) for key in ("joints_2d", "joints_3d"))
    return folder / document["video"], joints_2d[:, rows], joints_3d[:, rows], joints_2d


def read_pose2sim(folder: Path, camera: str, step: int) -> list[VideoFrame]:
    """Read every ``step``-th frame of one camera."""
    video, limbs_2d, limbs_3d, joints_2d = read_pose2sim_joints(folder, camera)
    found = []
    for number, frame in read_frames(video):
        if number % step or number >= len(limbs_3d):
            continue
        everything = joints_2d[number]
        everything = everything[np.isfinite(everything).all(axis=1)]
        height, width = frame.shape[:2]
        box = padded_box(everything).clip(width, height)
        if box is not None:
            reference = Reference(limbs_2d[number], about_hips(limbs_3d[number]))
            found.append(VideoFrame(f"{camera}/{number:03d}", frame, reference, box))
    return found


def read_frames(video: Path) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Yield number and BGR pixels of every frame of a video."""
    if not video.is_file():
        raise FileNotFoundError(f"expected a video at {video}, found none")
    capture = cv2.VideoCapture(str(video))
    number = 0
    while (read := capture.read())[0]:
        yield number, np.asarray(read[1], np.uint8)
        number += 1


def frames_at(video: Path, per_second: float) -> Iterator[tuple[float, NDArray[np.uint8]]]:
    """Yield frames of a video at a rate, each with its time in seconds."""
    rate, due = cv2.VideoCapture(str(video)).get(cv2.CAP_PROP_FPS) or 25.0, 0.0
    for number, frame in read_frames(video):
        if number / rate + 1e-6 >= due:
            yield number / rate, frame
            due += 1 / per_second


def read_vtest(folder: Path, count: int = VTEST_FRAMES) -> list[tuple[int, NDArray[np.uint8]]]:
    """Read ``count`` evenly chosen frames of the street video."""
    video = folder / "vtest.avi"
    total = int(cv2.VideoCapture(str(video)).get(cv2.CAP_PROP_FRAME_COUNT))
    wanted = set(np.linspace(0, total - 1, count).astype(int).tolist())
    return [(number, frame) for number, frame in read_frames(video) if number in wanted]


def read_marks(file: Path = ROOT / "tests" / "data" / "vtest-people.json") -> list[Marks]:
    """Read the marks of all frames of the street video."""
    return [
        Marks(
            int(one["frame"]),
            [Box(*map(float, box)) for box in one["people"]],
            [Box(*map(float, box)) for box in one["ignored"]],
        )
        for one in _read(file)["frames"]
    ]


FILM_KINDS = ("fall", "out_of_bed", "in_bed", "daily", "ordinary")
"""What films are a test of. In films of streets, squares and offices nobody falls or lies."""


@dataclass(frozen=True)
class Film:
    """A film of ``../shared/real`` and what its labels say.

    Classes are activities, each from and to a second; ``fall`` is the second at which one begins.
    The crop is the part of the frame that shows the scene: left, top, width, height as shares. The
    kind is one of :data:`FILM_KINDS`; None for people who crawl or lie from the beginning.
    """

    name: str
    source: str
    path: Path
    kind: str | None
    fall: float | None = None
    classes: tuple[tuple[str, float, float], ...] = ()
    crop: tuple[float, float, float, float] = (0, 0, 1, 1)

    def frames(self, per_second: float) -> Iterator[tuple[float, NDArray[np.uint8]]]:
        """Frames at a rate, cropped, each with its time in seconds."""
        x, y, width, height = self.crop
        for at, frame in frames_at(self.path, per_second):
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


def real_films(real: Path) -> Iterator[Film]:
    """All films of falls, daily life and ordinary cameras: the development set."""
    yield from home_films(real)
    for folder in ("scenes", "scenes2"):
        for name, about in sorted(_read(real / folder / "truth.json").items()):
            bed = about["source"].startswith("T2V")
            kind = {("fall", True): "out_of_bed", ("daily", True): "in_bed"}.get(
                (about["kind"], bed), about["kind"]
            )
            yield Film(name, folder, real / folder / name, kind, about["at"])
    for path in sorted((real / "urfd").glob("fall-*.mp4")):
        yield Film(path.name, "urfd", path, "fall", 0.0)
    for path in sorted((real / "upfall").glob("*.mp4")):
        activity = int(path.name.split("_")[0].removeprefix("activity"))
        falls = activity <= 5
        if activity < 11:  # The last one lies down.
            kind = "fall" if falls else "daily"
            yield Film(path.name, "upfall", path, kind, 0.0 if falls else None)
    for name, fall in (("video_3", 3.7), ("video_5", 5.6)):
        yield Film(name, "falls", real / "falls" / f"{name}.mp4", "fall", fall)
    yield Film("vtest", "vtest", real / "vtest" / "vtest.avi", "ordinary")


def home_films(real: Path) -> Iterator[Film]:
    """Films of homes, in the order of their names."""
    sources = {"gmdcsa": "GMDCSA24", "assist": "ASSIST-IoT", "t2vbed": "T2V-Bed-Fall"}
    for name, about in sorted(_read(real / "homes" / "labels.json").items()):
        classes, fall = [tuple(row) for row in about["classes"]], about["fall"]
        described, bed = about["description"], "t2vbed" in name
        if not classes and "_roll_" in name:
            classes = [("Sleeping", -1.0, 9.0)]
        if not classes and ("walking" in name or "jogging" in name):
            classes = [("Walking", 0.5, 99.0)]
        if "imm_stomach" in name:
            classes = [("Sleeping", -1.0, 99.0)]
        if bed and fall is not None:
            # On the ground from two seconds after the fall begins.
            classes = [("Sleeping", fall + 1.7, 99.0)]
        kind: str | None = "daily"
        if fall is not None:
            kind = "out_of_bed" if bed else "fall"
        elif bed or "laying" in described:
            kind = "in_bed"
        elif "crawl" in described or "imm" in described:
            kind = None
        source = sources.get(name.split("_")[0], "phones")
        crop = tuple(about.get("crop", (0, 0, 1, 1)))
        yield Film(name, source, real / "homes" / name, kind, fall, tuple(classes), crop)


def _read(file: Path) -> Any:
    return json.loads(file.read_text())
