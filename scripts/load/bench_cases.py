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
from scripts.datasets import Marks, read_frames, read_marks, read_vtest
from scripts.load.client import Call
from scripts.load.scenes import encode
from scripts.results import ROOT

WALKERS = ROOT / "tests" / "data" / "walkers.jpg"
SMALL = (640, 480)
"""Width and height of the yardstick's frame, and of one with nobody in it."""

LARGE = (1440, 1080)
FILM = 30
"""Frames of a film."""

MAX_CALLS = 1000
"""Frames of a camera have an order, and are not sent twice."""

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Case:
    """One kind of request, sent in turn.

    ``wanted_ratio`` is the target of the median, as a multiple of the yardstick's. Requests
    ``in_order`` are sent once, in sequence; the people in their answers are not counted.
    """

    title: str
    calls: tuple[Call, ...]
    wanted_ratio: float
    in_order: bool = False


@dataclass(frozen=True)
class Street:
    """BGR frames with four walkers, the empty street, and a box about the tallest of the first.

    ``film`` are consecutive frames of the street, ``tall`` those of two people, 1080x1920.
    """

    busy: tuple[Picture, ...]
    empty: Picture
    box: Box
    film: tuple[Picture, ...]
    tall: tuple[Picture, ...]

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
        """Read the videos of a folder; a FileNotFoundError where one is missing."""
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


def film_of(video: Path) -> tuple[Picture, ...]:
    """Return the first frames of a video."""
    return tuple(frame for _, frame in itertools.islice(read_frames(video), FILM))


def with_four(marks: Sequence[Marks]) -> list[Marks]:
    """Return the frames in which four walkers are marked; others may be cut, hidden or small."""
    return [mark for mark in marks if len(mark.people) == 4]


def without_people(frames: Sequence[Picture]) -> Picture:
    """Return the scene ``(480, 640, 3)`` of a fixed camera: the usual value of each pixel."""
    return resized(np.median(np.stack(frames), axis=0).astype(np.uint8), SMALL)


def resized(picture: Picture, size: tuple[int, int]) -> Picture:
    """Return a picture of another width and height."""
    smaller = size[0] < picture.shape[1]
    interpolation = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(picture, size, interpolation=interpolation), np.uint8)


def pose_call(**parts: bytes) -> Call:
    """Return a request to ``POST /pose``."""
    return Call("POST", "/pose", parts)


def walkers_case() -> Case:
    """Return the case that needs nothing outside the repository."""
    return Case("298x320, four walkers", (pose_call(frame=WALKERS.read_bytes()),), 1.4)


def mask_call(street: Street) -> Call:
    """Request the silhouette of the walker in the box, to be sent back as a caller's mask."""
    return Call("POST", "/silhouette", {"frame": street.frame, "boxes": street.boxes})


def street_cases(street: Street, mask: bytes) -> dict[str, Case]:
    """Return the cases about the street; ``mask`` is the encoded answer to :func:`mask_call`."""
    height, width = street.busy[0].shape[:2]
    size = f"{width}x{height}"
    busy = tuple(pose_call(frame=encode(".jpg", frame)) for frame in street.busy)
    tall = tuple(pose_call(frame=encode(".jpg", frame)) for frame in street.tall)
    empty, large = (
        (pose_call(frame=encode(".jpg", frame)),)
        for frame in (street.empty, resized(street.empty, LARGE))
    )
    masked = pose_call(frame=street.frame, mask=mask)
    silhouette = Call("POST", "/pose?evidence=silhouette", masked.parts)
    boxed = (pose_call(frame=street.frame, boxes=street.boxes),)
    films = {"street": street.film, "tall": street.tall}
    calls = {name: camera_calls(name, film) for name, film in films.items()}
    return {
        "four_walkers": Case(f"{size}, four walkers", busy, 1.4),
        "nobody": Case(f"{SMALL[0]}x{SMALL[1]}, nobody", empty, 0.5),
        "box": Case(f"{size}, one caller's box", boxed, 0.28),
        "mask_silhouette": Case(f"{size}, one mask, `evidence=silhouette`", (silhouette,), 0.08),
        "mask": Case(f"{size}, one mask", (masked,), 0.28),
        "large_nobody": Case(f"{LARGE[0]}x{LARGE[1]}, nobody", large, 0.6),
        "two_people": Case("1080x1920, two people", tall, 1.1),
        "camera": Case(f"{size}, next frame of a camera", calls["street"], 0.9, True),
        "tall_camera": Case("1080x1920, next frame of a camera", calls["tall"], 0.7, True),
    }


def camera_calls(camera: str, film: Sequence[Picture]) -> tuple[Call, ...]:
    """Return a camera's frames at ten a second: a film played back and forth."""
    frames = [encode(".jpg", frame) for frame in (*film, *film[-2:0:-1])]
    return tuple(
        Call(
            "POST",
            f"/cameras/{camera}/frames",
            {"frame": frames[number % len(frames)], "timestamp": str(number / 10).encode()},
        )
        for number in range(MAX_CALLS)
    )


def yardstick(picture: Picture) -> Callable[[], object]:
    """Return OpenCV's own search for people in a picture at :data:`SMALL`, on one thread.

    It classifies every window, so it takes equally long in any picture.
    """
    cv2.setNumThreads(1)
    hog = cv2.HOGDescriptor()
    hog.setSVMDetector(np.asarray(cv2.HOGDescriptor.getDefaultPeopleDetector()))
    small = resized(picture, SMALL)
    return lambda: hog.detectMultiScale(small, winStride=(8, 8), scale=1.05)
