"""Drawn people, whom a detector and a reader find by their colour, and sessions that see them."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from app.camera import CameraSession
from app.estimation.finder import Models
from app.estimation.upload import Upload
from app.photograph import Estimator
from app.scheduling.job import Job
from app.tracking.results import TrackedFrame
from app.vision.blazepose import LANDMARK_PX, PoseReading
from app.vision.geometry import Box, PersonWindow, sample_window
from app.vision.judgement import JudgedReading
from app.vision.optics import PinholeCamera
from app.vision.people import Detection, Landmarks
from index.store import PoseIndex
from tests.app.painted import BLANK_PASS, Believing, keypoints_on

ROWS, COLUMNS = 200, 320
PERSON = 90
COLOURS = ((40, 40, 220), (220, 60, 40), (40, 200, 60), (40, 210, 230))


def of_colour(picture: NDArray[np.uint8], colour: tuple[int, int, int]) -> NDArray[np.uint8]:
    """1 where a picture has about this colour, else 0."""
    apart = cv2.transform(cv2.absdiff(picture, (*colour, 0.0)), np.ones((1, 3)))
    return np.asarray(apart < 60, np.uint8)


class ColourDetector:
    """Finds the drawn people, even where they touch, and counts its searches."""

    name = "network"

    def __init__(self) -> None:
        self.searches = 0
        self.blind = False
        """Whether it finds nobody."""
        self.room = 0
        """Pixels that boxes are too wide on either side."""
        self.lost: Sequence[Box] = ()
        self.known: Sequence[Box] = ()

    def detect(
        self, frame: NDArray[np.uint8], lost: Sequence[Box], known: Sequence[Box], *_: object
    ) -> tuple[list[Detection], list[Detection]]:
        self.searches += 1
        self.lost, self.known = lost, known
        boxes = []
        for colour in () if self.blind else COLOURS:
            left, top, width, height = cv2.boundingRect(of_colour(frame, colour))
            if height >= PERSON // 2:
                room = self.room
                box = Box(left - 0.5 - room, top - 0.5, width + 2 * room, height)
                boxes.append(Detection(box, 0.9))
        return boxes, []


class ColourReader:
    """Reads the drawn people: a mask of their colour, and landmarks within it."""

    def __init__(self) -> None:
        self.passes = 0
        self.looks = 0
        """How often MoveNet should have looked at somebody followed."""

    def follow(
        self,
        frame: NDArray[np.uint8],
        camera: PinholeCamera,
        found: Detection,
        window: PersonWindow,
        least_trust: float,
        seen: object = None,
    ) -> JudgedReading | None:
        self.looks += seen is None
        reading = self._in_window(frame, window)
        apart = reading.window.corners() - reading.next_window.corners()
        drift = np.linalg.norm(apart, axis=1).mean() / reading.window.side
        return reading if reading.presence > 0.5 and drift < 0.35 else None

    def with_mask(self, reading: JudgedReading) -> JudgedReading:
        return reading

    def read(
        self,
        frame: NDArray[np.uint8],
        camera: PinholeCamera,
        found: Detection,
        expected: PersonWindow | JudgedReading | None = None,
    ) -> JudgedReading:
        if isinstance(expected, JudgedReading):
            return expected
        return self._in_window(frame, PersonWindow.about_box(found.box))

    def _in_window(self, frame: NDArray[np.uint8], window: PersonWindow) -> JudgedReading:
        self.passes += 1
        picture = sample_window(frame, window, LANDMARK_PX)
        middle = picture[LANDMARK_PX // 2 - 9 :, LANDMARK_PX // 2 - 9 :][:18, :18]
        near = [np.count_nonzero(of_colour(middle, colour)) for colour in COLOURS]
        mask = of_colour(picture, COLOURS[int(np.argmax(near))])
        left, top, width, height = cv2.boundingRect(mask)
        seen = width > 0
        shares = np.random.default_rng(0).uniform(0.1, 0.9, (33, 2))
        to_frame = window.to_frame(LANDMARK_PX)
        places = np.array([left, top]) + shares * [max(width, 1), max(height, 1)]
        places = places @ to_frame[:, :2].T + to_frame[:, 2]
        corner = to_frame[:, :2] @ np.array([left + width / 2, top + height / 2]) + to_frame[:, 2]
        reading = PoseReading(
            window,
            Landmarks(places, np.full(33, 0.9), np.column_stack([shares - 0.5, shares[:, 0]])),
            1.0 if seen else 0.0,
            PersonWindow(*corner.tolist(), 1.25 * PERSON) if seen else window,
            BLANK_PASS,
            mask.astype(np.float32),
        )
        return Believing().judge(replace(reading, keypoints=keypoints_on(reading)))


def draw(
    *people: tuple[int, int], seed: int = 0, columns: int = COLUMNS, light: float = 150
) -> NDArray[np.uint8]:
    """A frame of people given by colour and left edge, the last in front."""
    noise = np.empty((ROWS, columns, 3), np.int16)
    cv2.setRNGSeed(seed % 2**31)
    cv2.randn(noise, (light,) * 3, (4, 4, 4))
    frame = noise.astype(np.uint8)
    for colour, left in people:
        cv2.rectangle(frame, (left, 60), (left + 29, 59 + PERSON), COLOURS[colour], -1)
    return frame


def drawn_estimator(index: PoseIndex) -> Estimator:
    """An estimator that finds and reads the drawn people."""
    return Estimator(
        index,
        Models(ColourDetector(), ColourReader(), Believing()),  # type: ignore[arg-type]
        min_person_px=50,
        max_pixels=10**6,
        max_persons=4,
    )


def send(
    session: CameraSession,
    time: float | None,
    *people: tuple[int, int],
    columns: int = COLUMNS,
    light: float = 150,
) -> TrackedFrame:
    """Let a session process a drawn frame; frames of different times differ in noise."""
    frame = draw(*people, seed=abs(hash(time or 0.0)), columns=columns, light=light)
    return session.process(Upload(frame), time, 3, Job())


def ids(result: TrackedFrame) -> list[int]:
    return [tracked.track_id for tracked in result.persons]
