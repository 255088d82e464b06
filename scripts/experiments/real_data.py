"""The real images in ``../shared/real``, read into arrays."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import Box, Boxes
from app.vision.images import decode_image, decode_mask
from index.skeleton import LIMBS

MAX_PIXELS = 50_000_000

HIPS = (LIMBS.index("left_hip"), LIMBS.index("right_hip"))


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
        """Whether the photograph's number is odd: of the half that nothing was tuned on."""
        return int(Path(self.name).stem[-5:]) % 2 == 1


@dataclass(frozen=True)
class Reference:
    """Where somebody's :data:`LIMBS` are: pixels, and metres in camera axes between the hips."""

    joints_2d: NDArray[np.float64]
    joints_3d: NDArray[np.float64]

    @property
    def azimuth_deg(self) -> float:
        """As :func:`app.estimation.facing.azimuth_deg`, of shoulders and hips."""
        return azimuth_of_limbs(self.joints_3d)


@dataclass(frozen=True)
class StreetPerson:
    """One of the people of ``landmarks.json``: their photograph, label and reference."""

    photograph: Photograph
    label: int
    reference: Reference


def azimuth_of_limbs(joints_3d: NDArray[np.float64]) -> float:
    """As :func:`app.estimation.facing.azimuth_deg`, of limb joints ``(12, 3)``."""
    across = joints_3d[0] - joints_3d[1] + joints_3d[6] - joints_3d[7]
    return float(np.rad2deg(np.arctan2(-across[2], across[0])))


def tight_box(mask: NDArray[np.bool_]) -> Box:
    """Smallest box around the pixels of a mask."""
    x, y, width, height = cv2.boundingRect(mask.astype(np.uint8))
    return Box(x - 0.5, y - 0.5, width, height)


def as_array(boxes: Sequence[Box]) -> Boxes:
    """Boxes as an ``(N, 4)`` array."""
    return np.array([[b.x, b.y, b.width, b.height] for b in boxes], np.float64).reshape(-1, 4)


def read_pennfudan(folder: Path) -> list[Photograph]:
    """Read all photographs with masks in a folder."""
    photographs = []
    for path in sorted(folder.glob("*.jpg")):
        mask_path = path.with_name(f"{path.stem}_mask.png")
        frame = decode_image(path.read_bytes(), max_pixels=MAX_PIXELS)
        labels = decode_mask(mask_path.read_bytes(), max_pixels=MAX_PIXELS).labels
        photographs.append(Photograph(path.name, frame, labels.astype(np.uint16)))
    if not photographs:
        raise FileNotFoundError(f"expected photographs in {folder}, found none")
    return photographs


def read_street_people(folder: Path, photographs: Sequence[Photograph]) -> list[StreetPerson]:
    """Read the people of ``landmarks.json``."""
    document = json.loads((folder / "landmarks.json").read_text())
    if tuple(document["joint_names"]) != LIMBS:
        raise ValueError(f"expected the joints {LIMBS}, got {document['joint_names']}")
    by_name = {photograph.name: photograph for photograph in photographs}
    return [
        StreetPerson(
            by_name[person["image"]],
            person["person"],
            _reference(np.array(person["joints_2d"]), np.array(person["joints_3d"])),
        )
        for person in document["people"]
    ]


def _reference(joints_2d: NDArray[np.float64], joints_3d: NDArray[np.float64]) -> Reference:
    return Reference(joints_2d, joints_3d - joints_3d[list(HIPS)].mean(axis=0))


@dataclass(frozen=True)
class VideoFrame:
    """A frame of ``pose2sim``, BGR, where the one person's joints are, and a padded box of all."""

    name: str
    frame: NDArray[np.uint8]
    reference: Reference
    box: Box


def read_pose2sim(folder: Path, camera: str, step: int) -> list[VideoFrame]:
    """Read every ``step``-th frame of one camera."""
    document = json.loads((folder / f"{camera}.json").read_text())
    names = document["joint_names"]
    rows = [names.index(name[0].upper() + name.split("_")[1].title()) for name in LIMBS]
    joints_2d, joints_3d = (np.array(document[key]) for key in ("joints_2d", "joints_3d"))
    found = []
    for number, frame in read_frames(folder / document["video"]):
        if number % step or number >= len(joints_3d):
            continue
        everything = joints_2d[number]
        everything = everything[np.isfinite(everything).all(axis=1)]
        height, width = frame.shape[:2]
        box = padded_box(everything).clip(width, height)
        if box is not None:
            reference = _reference(joints_2d[number][rows], joints_3d[number][rows])
            found.append(VideoFrame(f"{camera}/{number:03d}", frame, reference, box))
    return found


def padded_box(joints: NDArray[np.float64], share: float = 0.05) -> Box:
    """Box around joints ``(J, 2)``, each side moved out by a share of the larger extent."""
    low, high = joints.min(axis=0), joints.max(axis=0)
    pad = share * float((high - low).max())
    width, height = (high - low + 2 * pad).tolist()
    return Box(float(low[0]) - pad, float(low[1]) - pad, width, height)


def read_frames(video: Path) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Yield number and BGR pixels of every frame of a video."""
    if not video.is_file():
        raise FileNotFoundError(f"expected a video at {video}, found none")
    capture = cv2.VideoCapture(str(video))
    number = 0
    while True:
        done, frame = capture.read()
        if not done:
            return
        yield number, np.asarray(frame, np.uint8)
        number += 1


def read_vtest(folder: Path, count: int) -> list[tuple[int, NDArray[np.uint8]]]:
    """Read ``count`` evenly chosen frames of the street video."""
    video = folder / "vtest.avi"
    total = int(cv2.VideoCapture(str(video)).get(cv2.CAP_PROP_FRAME_COUNT))
    wanted = set(np.linspace(0, total - 1, count).astype(int).tolist())
    return [(number, frame) for number, frame in read_frames(video) if number in wanted]
