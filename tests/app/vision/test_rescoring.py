"""Re-scoring: HOG's margin, and the detector of objects: people are people, a cat is none."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.vision.detector import NetworkDetector, object_odds
from app.vision.geometry import Box, resize
from app.vision.people import Detection
from app.vision.rescoring import hog_margin
from tests.conftest import ROOT

EMPTY = [Box(100, 200, 30, 80), Box(20, 200, 40, 100), Box(60, 30, 30, 80)]
"""Asphalt and grass of `street`."""


def test_people_have_higher_margins_than_asphalt(
    street: NDArray[np.uint8], walkers: list[Box], far_walkers: list[Box]
) -> None:
    people = [hog_margin(street, box) for box in (*walkers, *far_walkers)]
    empty = [hog_margin(street, box) for box in EMPTY]
    assert min(people) > max(empty) + 1
    assert min(people[:3]) > 0 > max(empty)


@pytest.mark.parametrize("factor", [1.5, 2, 4])
def test_margin_hardly_depends_on_the_size(
    street: NDArray[np.uint8], walkers: list[Box], factor: float
) -> None:
    large = resize(street, round(factor * street.shape[1]), round(factor * street.shape[0]))
    for box in walkers:
        margin = hog_margin(large, box.scaled(factor))
        assert margin == pytest.approx(hog_margin(street, box), abs=0.7)


@given(
    x=st.floats(-400, 700), y=st.floats(-400, 700), width=st.floats(0.1, 900),
    height=st.floats(0.1, 900),
)  # fmt: skip
def test_any_box_has_a_finite_margin(x: float, y: float, width: float, height: float) -> None:
    frame = np.random.default_rng(0).integers(0, 256, (120, 90, 3)).astype(np.uint8)
    assert -5 <= hog_margin(frame, Box(x, y, width, height)) < 20


@pytest.fixture(scope="module")
def cat() -> NDArray[np.uint8]:
    picture = cv2.imread(str(ROOT / "tests" / "data" / "cat.jpg"))
    assert picture is not None
    return np.asarray(picture, np.uint8)


def gained(detector: NetworkDetector, frame: NDArray[np.uint8], box: Box) -> float:
    return object_odds(*detector.object_log_odds(frame, Detection(box, 0.5)))


def test_walkers_are_people(
    detector: NetworkDetector,
    street: NDArray[np.uint8],
    walkers: list[Box],
    far_walkers: list[Box],
) -> None:
    for box in walkers + far_walkers:
        assert gained(detector, street, box) > 0


@pytest.mark.parametrize("margin", [0, 20, 40])
def test_cat_is_none(detector: NetworkDetector, cat: NDArray[np.uint8], margin: int) -> None:
    height, width = cat.shape[:2]
    box = Box(margin, margin / 2, width - 2 * margin, height - margin)
    assert gained(detector, cat, box) < -1


def test_mirror_image_gives_nearly_the_same(
    detector: NetworkDetector, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    mirrored = np.ascontiguousarray(street[:, ::-1])
    for box in walkers:
        other = Box(street.shape[1] - box.right - 1, box.y, box.width, box.height)
        assert gained(detector, mirrored, other) == pytest.approx(
            gained(detector, street, box), abs=1
        )
