"""The requests that ``make bench`` measures, and their yardstick."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import Box
from scripts.experiments.real_data import read_frames, read_vtest
from scripts.experiments.real_vtest import Marks, read_marks
from scripts.load.client import Call
from scripts.load.scenes import encode
from scripts.results import ROOT

WALKERS = ROOT / "tests" / "data" / "walkers.jpg"
SMALL = (640, 480)
"""Width and height of the frame with nobody in it, and of the yardstick's."""

LARGE = (1440, 1080)
FILM = 30
"""Frames of a film."""

MOST_CALLS = 1000
"""Frames of a camera have an order, and are not sent twice."""


@dataclass(frozen=True)
class Case:
    """One kind of request, sent in turn.

    ``wanted_ratio`` is the target of the median, as a multiple of the yardstick's. Calls
    ``in_order`` are sent once, so that nobody is counted in their answers.
    """

    what: str
    calls: tuple[Call, ...]
    wanted_ratio: float | None = None
    in_order: bool = False


@dataclass(frozen=True)
class Street:
    """BGR frames with four walkers, the empty street, and a box about the tallest of the first.

    ``film`` are consecutive frames of the street, ``tall`` those of two people, 1080x1920.
    """

    busy: tuple[NDArray[np.uint8], ...]
    empty: NDArray[np.uint8]
    box: Box
    film: tuple[NDArray[np.uint8], ...]
    tall: tuple[NDArray[np.uint8], ...]

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
        """Read the videos of a folder; a FileNotFoundError where there is none."""
        marks = read_marks()
        frames = dict(read_vtest(folder / "vtest", len(marks)))
        chosen = with_four(marks)
        return cls(
            tuple(frames[mark.frame] for mark in chosen),
            without_people(list(frames.values())),
            max(chosen[0].people, key=lambda box: box.height),
            film_of(folder / "vtest" / "vtest.avi"),
            film_of(folder / "pose2sim" / "cam01.mp4"),
        )


def film_of(video: Path) -> tuple[NDArray[np.uint8], ...]:
    """The first frames of a video; a FileNotFoundError where there is none."""
    return tuple(frame for _, frame in itertools.islice(read_frames(video), FILM))


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
    return Case("298x320, four walkers", (call,), 1.9)


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
    tall = tuple(Call("POST", "/pose", {"frame": encode(".jpg", frame)}) for frame in street.tall)
    large = encode(".jpg", np.asarray(cv2.resize(street.empty, LARGE), np.uint8))
    return [
        Case(f"{size}, four walkers", busy, 1.9),
        Case(f"{SMALL[0]}x{SMALL[1]}, nobody", (empty,), 0.7),
        Case(f"{size}, one caller's box", (boxed,), 0.36),
        Case(f"{size}, one mask, `evidence=silhouette`", (silhouette,), 0.10),
        Case(f"{size}, one mask", (Call("POST", "/pose", masked),), 0.28),
        Case(f"{LARGE[0]}x{LARGE[1]}, nobody", (Call("POST", "/pose", {"frame": large}),), 1.4),
        Case("1080x1920, two people", tall, 1.8),
        Case(
            f"{size}, next frame of a camera",
            camera_calls("street", street.film),
            1.2,
            in_order=True,
        ),
        Case(
            "1080x1920, next frame of a camera",
            camera_calls("tall", street.tall),
            0.8,
            in_order=True,
        ),
    ]


def camera_calls(camera: str, film: Sequence[NDArray[np.uint8]]) -> tuple[Call, ...]:
    """Frames of a camera at ten a second: a film played forwards and backwards again and again."""
    frames = [encode(".jpg", frame) for frame in (*film, *film[-2:0:-1])]
    return tuple(
        Call(
            "POST",
            f"/cameras/{camera}/frames",
            {"frame": frames[number % len(frames)], "timestamp": str(number / 10).encode()},
        )
        for number in range(MOST_CALLS)
    )


def yardstick(picture: NDArray[np.uint8]) -> Callable[[], object]:
    """Return OpenCV's own search for people in a picture at :data:`SMALL`, on one thread.

    It classifies every window, so it takes equally long in any picture.
    """
    cv2.setNumThreads(1)
    hog = cv2.HOGDescriptor()
    hog.setSVMDetector(np.asarray(cv2.HOGDescriptor.getDefaultPeopleDetector()))
    small = resized(picture)
    return lambda: hog.detectMultiScale(small, winStride=(8, 8), scale=1.05)
