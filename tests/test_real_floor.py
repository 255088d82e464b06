"""What the estimator reads in photographs of people, held to floors; needs ../shared.

The photographs are for evaluation alone: none of them is in this repository. The measures are those
of ``../shared/check_real.py``, on fewer photographs and without the service around them. Each floor
lies 5 points (or 10 mm) below what was measured when it was set.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app.api.replies import MIN_SCORE
from app.estimation.results import Person
from app.estimation.upload import Upload
from app.photograph import Estimator
from app.scheduling.job import Job
from app.serving.loading import load_estimator
from app.settings import Settings
from app.vision.geometry import Box
from app.vision.people import LANDMARK_NAMES
from index.posture import ON_THE_GROUND
from index.skeleton import LIMBS, POINT_NAMES
from tests.conftest import SHARED

REAL = SHARED / "real"

pytestmark = pytest.mark.skipif(
    not (REAL / "lsp" / "joints.json").exists(),
    reason=f"no photographs to evaluate in {REAL}; set SHARED to the folder above it",
)

ORIENTATIONS = {"upright": (0, 45), "horizontal": (45, 135), "inverted": (135, 181)}
LSP_EACH, FALLS_EACH, FRAMES_EACH = 8, 40, 4
PCK_WITHIN = 0.2
"""Share of the trunk's length within which a joint counts as found."""

LSP_FLOORS = {
    "upright": (95.0, 72.0, 67.5),
    "horizontal": (95.0, 69.6, 60.0),
    "inverted": (95.0, 67.5, 51.3),
}
"""Percent found, PCK of the keypoints and PCK of the first hypothesis: 100, 77.1 and 72.5 were
measured of people upright, 100, 74.6 and 65.0 horizontal, 100, 72.5 and 56.3 inverted."""

MOST_MM = {"cam01": (140.0, 116.1), "cam03": (122.8, 116.1)}
"""Of the first hypothesis and of the best of seven: 130.0 and 106.1, 112.8 and 106.1 were
measured."""

HIPS = [LIMBS.index(f"{side}_hip") for side in ("left", "right")]
_ROWS = [POINT_NAMES.index(name) for name in LIMBS]


@pytest.fixture(scope="module")
def real() -> Estimator:
    """An estimator over the index of the package."""
    return load_estimator(Settings())


def persons(real: Estimator, frame: bytes, boxes: tuple[Box, ...] | None = None) -> list[Person]:
    return list(real.estimate(Upload(frame, boxes=boxes), 7, Job()).persons)


def evenly(paths: Sequence[Any], count: int) -> list[Any]:
    """So many of a sequence, spaced evenly."""
    return [paths[i] for i in np.linspace(0, len(paths) - 1, count).round().astype(int)]


def best_score(found: Sequence[Person], truth: dict[str, Any], names: list[str]) -> Any:
    """Found, keypoint PCK and first-hypothesis PCK, 0 to 1, of the person meant."""
    places, visible = np.array(truth["joints_2d"]), np.array(truth["visible"])
    rows = [names.index(name) for name in LIMBS]
    seen = visible[rows]
    middle = places[
        [names.index(f"{s}_{j}") for s in ("left", "right") for j in ("hip", "shoulder")]
    ]
    trunk = max(
        np.linalg.norm(places[names.index(f"{a}_hip")] - places[names.index(f"{b}_shoulder")])
        for a, b in (("left", "right"), ("right", "left"))
    )
    x, y = middle.mean(axis=0)

    def within(points: NDArray[np.float64], told: NDArray[np.bool_] | bool = True) -> float:
        apart = np.linalg.norm(points - places[rows], axis=1) / trunk
        return float(((apart < PCK_WITHIN) & told)[seen].mean())

    best = (0.0, 0.0, 0.0)
    for person in found:
        box = person.box
        if not (box.x - 5 <= x <= box.right + 5 and box.y - 5 <= y <= box.bottom + 5):
            continue
        landmarks = person.landmarks
        read = 0.0
        if landmarks is not None:
            own = [LANDMARK_NAMES.index(name) for name in LIMBS]
            read = within(landmarks.positions[own], landmarks.visibility[own] >= MIN_SCORE)
        first = within(person.hypotheses[0].points_2d[_ROWS]) if person.hypotheses else 0.0
        best = max(best, (1.0, read, first), key=lambda one: one[1] + one[2] + one[0] / 1e3)
    return best


@pytest.mark.parametrize("orientation", ORIENTATIONS)
def test_sports_photographs(real: Estimator, orientation: str) -> None:
    truth = json.loads((REAL / "lsp" / "joints.json").read_text())
    low, high = ORIENTATIONS[orientation]
    people = [one for one in truth["people"] if low <= abs(one["trunk_deg"]) < high]
    scores = np.array(
        [
            best_score(
                persons(real, (REAL / "lsp" / one["image"]).read_bytes()), one, truth["joint_names"]
            )
            for one in evenly(people, LSP_EACH)
        ]
    )
    found, keypoints, first = 100 * scores.mean(axis=0)
    floors = LSP_FLOORS[orientation]
    assert found >= floors[0]
    assert keypoints >= floors[1]
    assert first >= floors[2]


@pytest.mark.parametrize("kind", ["fall", "not-fall"])
def test_photographs_of_falls(real: Estimator, kind: str) -> None:
    paths = sorted((REAL / "falls" / kind).glob("*.jpg"))
    found = [persons(real, path.read_bytes()) for path in evenly(paths, FALLS_EACH)]
    seen = 100 * np.mean([bool(one) for one in found])
    low = 100 * np.mean(
        [
            any(person.posture and person.posture.label in ON_THE_GROUND for person in one)
            for one in found
        ]
    )
    assert seen >= 95
    if kind == "fall":
        assert low >= 75  # Measured: 82; 76 of all photographs.
    else:
        assert low <= 6  # Measured: 0; 4 of all photographs.


def frames_of(camera: str) -> Iterator[tuple[NDArray[np.uint8], NDArray[np.float64], Box]]:
    """Frames of a Pose2Sim camera, the person's limbs ``(12, 3)`` in metres, and their box."""
    truth = json.loads((REAL / "pose2sim" / f"{camera}.json").read_text())
    short = {name: f"{name[0].upper()}{name.split('_')[1].capitalize()}" for name in LIMBS}
    rows = [truth["joint_names"].index(short[name]) for name in LIMBS]
    video = cv2.VideoCapture(str(REAL / "pose2sim" / truth["video"]))
    count = len(truth["joints_3d"])
    wanted = set(np.linspace(0, count - 1, FRAMES_EACH).round().astype(int).tolist())
    for number in range(count):
        done, frame = video.read()
        if not done:
            return
        if number not in wanted:
            continue
        places = np.array(truth["joints_2d"][number])
        (left, top), (right, bottom) = places.min(axis=0), places.max(axis=0)
        room = bottom - top
        box = Box(
            float(max(0.0, left - 0.06 * room)), float(max(0.0, top - 0.08 * room)),
            float(right - left + 0.12 * room), float(1.14 * room),
        )  # fmt: skip
        yield np.asarray(frame, np.uint8), np.array(truth["joints_3d"][number])[rows], box


def error_mm(points: NDArray[np.float64], truth: NDArray[np.float64]) -> float:
    """Mean distance of limb joints about the middle of the hips."""
    limbs = points[_ROWS]
    apart = limbs - limbs[HIPS].mean(axis=0) - truth + truth[HIPS].mean(axis=0)
    return 1000 * float(np.linalg.norm(apart, axis=1).mean())


@pytest.mark.parametrize("camera", ["cam01", "cam03"])
def test_joints_in_three_dimensions(real: Estimator, camera: str) -> None:
    errors, low = [], []
    for frame, truth, box in frames_of(camera):
        (person,) = persons(real, cv2.imencode(".png", frame)[1].tobytes(), (box,))
        errors.append([error_mm(one.points_3d, truth) for one in person.hypotheses])
        low.append(bool(person.posture and person.posture.label in ON_THE_GROUND))
    assert len(errors) == FRAMES_EACH
    assert np.mean([of_one[0] for of_one in errors]) <= MOST_MM[camera][0]
    assert np.mean([min(of_one) for of_one in errors]) <= MOST_MM[camera][1]
    assert 100 * np.mean(low) <= 5
