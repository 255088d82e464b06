"""People of chosen poses, as the estimator returns them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.estimation.posture import likeliest_posture
from app.estimation.results import Facing, Person
from app.tracking.results import TrackedFrame
from app.vision.geometry import Box
from app.vision.optics import PinholeCamera
from index.matching import PoseHypothesis
from index.posture import PostureName, vote_posture
from index.skeleton import POINT_NAMES, POINTS, camera_rotation
from index.store import Label

PX_PER_M = 100.0

_HEIGHTS = {
    "pelvis": 0.0, "spine": 0.15, "chest": 0.3, "neck": 0.5, "head": 0.65, "shoulder": 0.45,
    "elbow": 0.2, "wrist": -0.05, "hip": -0.05, "knee": -0.45, "ankle": -0.85, "toe": -0.9,
    "nose": 0.65, "eye": 0.68, "ear": 0.68,
}  # fmt: skip


def standing_body() -> NDArray[np.float64]:
    """A skeleton ``(24, 3)`` that faces +z: body axes, metres, pelvis at the origin."""
    points = np.zeros((POINTS, 3))
    for row, name in enumerate(POINT_NAMES):
        side, _, joint = name.rpartition("_")
        points[row, 1] = _HEIGHTS[joint]
        # x to the person's left.
        points[row, 0] = {"left": 0.2, "right": -0.2, "": 0.0}[side]
        points[row, 2] = 0.1 if joint in ("toe", "nose") else 0.0
    return points


def seen_from(azimuth_deg: float, elevation_deg: float = 10.0) -> NDArray[np.float64]:
    """The standing body ``(24, 3)`` in camera axes."""
    return standing_body() @ camera_rotation(azimuth_deg, elevation_deg).T


def person_of(
    poses: Sequence[NDArray[np.float64]],
    confidences: Sequence[float],
    centre: tuple[float, float] = (200.0, 200.0),
    *,
    elevation_deg: float = 10.0,
    postures: Sequence[PostureName] | None = None,
    action: str = "walk",
) -> Person:
    """A person whose hypotheses are these poses, with the box about a point of the frame."""
    hypotheses = []
    for entry, (pose, confidence) in enumerate(zip(poses, confidences, strict=True)):
        label = Label(entry, action, "07_01", "avatar", 0, False, 0.0, elevation_deg, 0.0, 8.0)
        hypothesis = PoseHypothesis(
            entry_id=entry, mirrored=False, silhouette_distance=1.0, reprojection_error_px=1.0,
            confidence=confidence, points_3d=pose,
            posture=postures[entry] if postures else "standing", distance=1.0,
            label=label, points_2d=np.array(centre) + PX_PER_M * pose[:, :2],
        )  # fmt: skip
        hypotheses.append(hypothesis)
    height = 1.7 * PX_PER_M
    box = Box(centre[0] - 30, centre[1] - height / 2, 60, height)
    votes = vote_posture([placed.posture for placed in hypotheses], confidences)
    return Person(
        box, "detector", 0.9, None,
        facing=Facing(0.5, "none"), posture=likeliest_posture(votes), hypotheses=tuple(hypotheses),
    )  # fmt: skip


def result_of(number: int, timestamp: float, width: int = 2, **given: Any) -> TrackedFrame:
    """What a session says of a black frame of two rows; in which nobody is unless it is given."""
    return TrackedFrame(**{
        "frame": np.zeros((2, width, 3), np.uint8), "camera": PinholeCamera.of_frame((2, width)),
        "warnings": (), "frame_index": number, "timestamp": timestamp, "session": "warm",
        "reset": None, "persons": (), "events": (), "timings_ms": {}, **given,
    })  # fmt: skip
