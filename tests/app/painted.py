"""Readings of painted bodies, and a reader that knows them, for tests without networks."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from app.vision.blazepose import LANDMARK_PX, MAP_SHAPES, NetworkPass, PoseReading
from app.vision.depth import Body3D
from app.vision.geometry import Box, PersonWindow, transform_points
from app.vision.judgement import FRAME_POSTURES, FramePosture, JudgedReading, Trust
from app.vision.optics import PinholeCamera
from app.vision.people import (
    COCO_LANDMARKS,
    LANDMARK_NAMES,
    Detection,
    Landmarks,
    ObservedKeypoints,
)

BLANK_PASS = NetworkPass(
    np.zeros((39, 5), np.float32),
    np.zeros((39, 3), np.float32),
    1.0,
    *(np.zeros(shape, np.float32) for shape in MAP_SHAPES),
)
"""The raw output of a network that saw nothing, for readings that no network made."""


class Believing:
    """Judges that readings are as right as the person is present, and that everybody stands."""

    depth = SimpleNamespace(covariance=lambda sigmas: np.diag(2 * sigmas**2))

    def judge(self, reading: PoseReading, camera: PinholeCamera | None = None) -> JudgedReading:
        body = Body3D(reading.landmarks.metres, np.full(33, 0.1), np.array([0.0, 0.0, 5.0]))
        posture = 0.9 * np.array([name == "standing" for name in FRAME_POSTURES]) + 0.1 / 6
        trust = Trust(reading.presence, reading.presence)
        given = {field.name: getattr(reading, field.name) for field in fields(PoseReading)}
        return JudgedReading(**given, body=body, trust=trust, posture=FramePosture(posture))


def painted(
    box: Box, peak: float = 0.95, roll_deg: float = 0.0, width: float = 0.0
) -> JudgedReading:
    """A reading of an ellipse in a box, surest in its middle; the bones are its axis.

    The two sides may be apart by a share of the box's width.
    """
    window = PersonWindow.about_box(box, roll_deg)
    grid = np.stack(np.meshgrid(np.arange(LANDMARK_PX), np.arange(LANDMARK_PX)), axis=-1)
    x, y = np.moveaxis(transform_points(window.to_frame(LANDMARK_PX), grid), -1, 0)
    middle = np.array([box.x + box.width / 2, box.y + box.height / 2])
    across, down = 2 * (x - middle[0]) / box.width, 2 * (y - middle[1]) / box.height
    probability = peak * np.clip(1.3 - across**2 - down**2, 0, 1)
    heights = {"nose": 0.05, "shoulder": 0.2, "hip": 0.5, "knee": 0.7, "ankle": 0.95}
    shares = [
        next((at for part, at in heights.items() if name.endswith(part)), 0.5)
        for name in LANDMARK_NAMES
    ]
    sides = np.array(
        [name.startswith("left") - name.startswith("right") for name in LANDMARK_NAMES]
    )
    across = middle[0] + sides * width / 2 * box.width
    positions = np.stack([across, box.y + np.array(shares) * box.height], axis=1)
    landmarks = Landmarks(positions, np.ones(33), np.zeros((33, 3)))
    mask = probability.astype(np.float32)
    return Believing().judge(PoseReading(window, landmarks, 1.0, window, BLANK_PASS, mask))


def keypoints_on(reading: PoseReading, x: float = 0.0, y: float = 0.0) -> ObservedKeypoints:
    """Keypoints on the landmarks of a reading, or beside them."""
    positions = reading.landmarks.positions[COCO_LANDMARKS] + np.array([x, y])
    return ObservedKeypoints(positions, np.full(17, 0.9))


@dataclass
class KnownReader:
    """Reads the bodies of the windows and boxes it was told, and those beside others."""

    shown: dict[Box | PersonWindow, JudgedReading | None]
    hidden: dict[Box, JudgedReading] = field(default_factory=dict)
    others: list[int] = field(default_factory=list)
    """Number of bodies that were painted over each time."""

    def read(self, _: Any, camera: Any, found: Detection, *__: Any) -> JudgedReading | None:
        return self.shown[found.box]

    def follow(
        self, _: Any, camera: Any, found: Detection, window: PersonWindow, *__: Any
    ) -> JudgedReading | None:
        return self.shown[window]

    def read_beside(
        self, _: Any, camera: Any, found: Detection, others: Sequence[PoseReading]
    ) -> JudgedReading | None:
        self.others.append(len(others))
        return self.hidden.get(found.box)

    def with_mask(self, reading: JudgedReading) -> JudgedReading:
        return reading


def detected(reading: PoseReading, box: Box, score: float = 0.9, **moved: float) -> Detection:
    """A detection with keypoints on a body, or beside it."""
    return Detection(box, score, keypoints_on(reading, **moved))


def unseen(reading: PoseReading, presence: float = 0.1) -> JudgedReading:
    """The same reading of a window in which the network hardly sees anybody."""
    return Believing().judge(replace(reading, presence=presence))
