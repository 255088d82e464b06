"""HOG: how much like a person a box looks, alone and among all windows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.vision.geometry import Box
from app.vision.hog import person_margin, person_windows
from app.vision.windows import resize

EMPTY = [Box(100, 200, 30, 80), Box(20, 200, 40, 100), Box(60, 30, 30, 80)]
"""Asphalt and grass of `street`."""


def test_people_look_more_like_people_than_asphalt_does(
    street: NDArray[np.uint8], walkers: list[Box], far_walkers: list[Box]
) -> None:
    people = [person_margin(street, box) for box in (*walkers, *far_walkers)]
    empty = [person_margin(street, box) for box in EMPTY]
    assert min(people) > max(empty) + 1
    assert min(people[:3]) > 0 > max(empty)


@pytest.mark.parametrize("factor", [1.5, 2, 4])
def test_a_margin_hardly_depends_on_the_size(
    street: NDArray[np.uint8], walkers: list[Box], factor: float
) -> None:
    large = resize(street, round(factor * street.shape[1]), round(factor * street.shape[0]))
    for box in walkers:
        assert person_margin(large, box.scaled(factor)) == pytest.approx(
            person_margin(street, box), abs=0.7
        )


@given(
    x=st.floats(-400, 700), y=st.floats(-400, 700), width=st.floats(0.1, 900),
    height=st.floats(0.1, 900),
)  # fmt: skip
def test_any_box_has_a_finite_margin(x: float, y: float, width: float, height: float) -> None:
    frame = np.random.default_rng(0).integers(0, 256, (120, 90, 3)).astype(np.uint8)
    assert -5 <= person_margin(frame, Box(x, y, width, height)) < 20


def test_windows_of_higher_margins_are_among_those_of_lower(street: NDArray[np.uint8]) -> None:
    all_boxes, all_margins = person_windows(street, 50, -0.5)
    boxes, margins = person_windows(street, 50, 0.5)
    assert 0 < len(boxes) < len(all_boxes)
    assert (margins >= 0.5).all() and (all_margins >= -0.5).all()
    every = {tuple(box) for box in all_boxes.round(3).tolist()}
    assert {tuple(box) for box in boxes.round(3).tolist()} <= every
