"""The requests that ``make bench`` measures, and their yardstick."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.people import Box
from scripts.experiments.real_data import read_vtest
from scripts.experiments.real_vtest import Marks, read_marks
from scripts.load.client import Call
from scripts.load.scenes import encode
from scripts.results import ROOT

WALKERS = ROOT / "tests" / "data" / "walkers.jpg"
SMALL = (640, 480)
"""Width and height of the frame with nobody in it, and of the yardstick's."""


@dataclass(frozen=True)
class Case:
    """One kind of request, sent in turn.

    ``wanted_ms`` is the target of the median on two quiet cores, ``wanted_ratio`` the same as a
    multiple of the yardstick's; None if only the time was set.
    """

    what: str
    calls: tuple[Call, ...]
    wanted_ms: float
    wanted_ratio: float | None = None


@dataclass(frozen=True)
class Street:
    """BGR frames with four walkers, the empty street, and a box about the tallest of the first."""

    busy: tuple[NDArray[np.uint8], ...]
    empty: NDArray[np.uint8]
    box: Box

    @property
    def frame(self) -> bytes:
        """The first busy frame, encoded."""
        return encode(".jpg", self.busy[0])

    @property
    def boxes(self) -> bytes:
        """The walker's box, as the form field has it."""
        return json.dumps([[self.box.x, self.box.y, self.box.width, self.box.height]]).encode()

    @classmethod
    def read(cls, folder: Path) -> Street:
        """Read the video; a FileNotFoundError where there is none."""
        marks = read_marks()
        frames = dict(read_vtest(folder, len(marks)))
        chosen = with_four(marks)
        return cls(
            tuple(frames[mark.frame] for mark in chosen),
            without_people(list(frames.values())),
            max(chosen[0].people, key=lambda box: box.height),
        )


def with_four(marks: Sequence[Marks]) -> list[Marks]:
    """Frames in which four walkers are marked; others may be cut, hidden or small."""
    return [mark for mark in marks if len(mark.people) == 4]


def without_people(frames: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Scene ``(480, 640, 3)`` of a fixed camera: nobody stands in a place most of the time."""
    scene = np.median(np.stack(frames), axis=0).astype(np.uint8)
    return resized(scene)


def resized(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Picture at :data:`SMALL`."""
    return np.asarray(cv2.resize(picture, SMALL, interpolation=cv2.INTER_AREA), np.uint8)


def walkers_case() -> Case:
    """The case that needs nothing outside the repository."""
    call = Call("POST", "/pose", {"frame": WALKERS.read_bytes()})
    return Case("298x320, four walkers", (call,), 120)


def mask_call(street: Street) -> Call:
    """Request the silhouette of the walker in the box, to be sent back as a caller's mask."""
    return Call("POST", "/silhouette", {"frame": street.frame, "boxes": street.boxes})


def street_cases(street: Street, mask: bytes) -> list[Case]:
    """Cases about the street; ``mask`` is the encoded answer to :func:`mask_call`."""
    height, width = street.busy[0].shape[:2]
    size = f"{width}x{height}"
    busy = tuple(Call("POST", "/pose", {"frame": encode(".jpg", frame)}) for frame in street.busy)
    empty = Call("POST", "/pose", {"frame": encode(".jpg", street.empty)})
    boxed = Call("POST", "/pose", {"frame": street.frame, "boxes": street.boxes})
    masked = {"frame": street.frame, "mask": mask}
    silhouette = Call("POST", "/pose?evidence=silhouette", masked)
    return [
        Case(f"{size}, four walkers", busy, 200, 1.65),
        Case(f"{SMALL[0]}x{SMALL[1]}, nobody", (empty,), 75, 0.6),
        Case(f"{size}, one caller's box", (boxed,), 50, 0.42),
        Case(f"{size}, one mask, `evidence=silhouette`", (silhouette,), 8, 0.08),
        Case(f"{size}, one mask", (Call("POST", "/pose", masked),), 30),
    ]


def yardstick(picture: NDArray[np.uint8]) -> Callable[[], object]:
    """Return OpenCV's own search for people in a picture at :data:`SMALL`, on one thread.

    It classifies every window, so it takes equally long in any picture.
    """
    cv2.setNumThreads(1)
    hog = cv2.HOGDescriptor()
    hog.setSVMDetector(np.asarray(cv2.HOGDescriptor.getDefaultPeopleDetector()))
    small = resized(picture)
    return lambda: hog.detectMultiScale(small, winStride=(8, 8), scale=1.05)
