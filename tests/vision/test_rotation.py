"""Quarter turns: as numpy turns an array, and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from app.vision.keypoints.movenet import MoveNet
from app.vision.people import COCO_NAMES, Box, ObservedKeypoints, Silhouette
from app.vision.rotation import (
    LYING_FROM_DEG,
    find_quarter_turns,
    measure_lean_deg,
    rotate_box,
    rotate_keypoints,
    rotate_points,
    rotate_shape,
    rotate_silhouette,
)

SHAPE = (30, 50, 3)
TURNS = pytest.mark.parametrize("quarter_turns", [-3, -1, 0, 1, 2, 3])


@TURNS
def test_points_go_where_their_pixels_go(quarter_turns: int) -> None:
    frame = np.zeros(SHAPE[:2], int)
    frame[7, 31] = 1
    row, column = np.argwhere(np.rot90(frame, quarter_turns))[0]
    assert rotate_points(np.array([31.0, 7.0]), SHAPE, quarter_turns).tolist() == [column, row]
    assert rotate_shape(SHAPE, quarter_turns) == np.rot90(frame, quarter_turns).shape


@TURNS
def test_turning_back_undoes_it(quarter_turns: int) -> None:
    points = np.random.default_rng(0).uniform(-10, 60, (4, 5, 2))
    there = rotate_points(points, SHAPE, quarter_turns)
    assert_allclose(
        rotate_points(there, rotate_shape(SHAPE, quarter_turns), -quarter_turns), points
    )
    box = Box(3.5, 4.25, 20, 7)
    there_box = rotate_box(box, SHAPE, quarter_turns)
    assert rotate_box(there_box, rotate_shape(SHAPE, quarter_turns), -quarter_turns) == box


@TURNS
def test_silhouettes_turn_with_the_frame(quarter_turns: int) -> None:
    crop = np.array([[True, False, True], [True, True, False]])
    silhouette = Silhouette(crop, left=11, top=5, segmenter="mask", truncated=False)
    turned = rotate_silhouette(silhouette, SHAPE, quarter_turns)
    expected = np.rot90(silhouette.mask(SHAPE), quarter_turns)
    assert (turned.mask(rotate_shape(SHAPE, quarter_turns)) == expected).all()
    assert turned.box == rotate_box(silhouette.box, SHAPE, quarter_turns)


STANDING = {
    "nose": (0, 0), "left_eye": (2, -2), "right_eye": (-2, -2), "left_ear": (5, 0),
    "right_ear": (-5, 0), "left_shoulder": (12, 15), "right_shoulder": (-12, 15),
    "left_elbow": (16, 35), "right_elbow": (-16, 35), "left_wrist": (15, 52),
    "right_wrist": (-15, 52), "left_hip": (8, 55), "right_hip": (-8, 55), "left_knee": (9, 80),
    "right_knee": (-9, 80), "left_ankle": (9, 105), "right_ankle": (-9, 105),
}  # fmt: skip
"""Pixels of somebody who stands and faces the camera."""


def leaning(angle_deg: float, *unseen: str) -> ObservedKeypoints:
    """`STANDING` turned clockwise about the nose, at 1000, 1000."""
    x, y = np.array([STANDING[name] for name in COCO_NAMES], float).T
    cosine, sine = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    # Down is positive, so this is clockwise as seen.
    places = 1000 + np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)
    scores = np.array([0.01 if name in unseen else 0.8 for name in COCO_NAMES])
    return ObservedKeypoints(places, scores)


@pytest.mark.parametrize(("head_x", "lean", "quarter_turns"), [(90, 90, 1), (-90, -90, 3)])
def test_with_the_head_to_the_right_the_lean_is_positive(
    head_x: float, lean: float, quarter_turns: int
) -> None:
    """Shoulders at so many pixels right of the hips, at the same height."""
    keypoints = ObservedKeypoints(np.full((17, 2), 100.0), np.ones(17))
    for name in ("left_shoulder", "right_shoulder"):
        keypoints.positions[COCO_NAMES.index(name), 0] += head_x
    assert measure_lean_deg(keypoints) == pytest.approx(lean)
    assert find_quarter_turns(keypoints) == quarter_turns


@given(angle=st.floats(-179, 179))
def test_the_lean_is_how_far_somebody_is_turned(angle: float) -> None:
    assert measure_lean_deg(leaning(angle)) == pytest.approx(angle, abs=1e-6)


@given(angle=st.floats(-180, 180))
def test_turned_upright_nobody_lies(angle: float) -> None:
    keypoints = leaning(angle)
    upright = rotate_keypoints(keypoints, SHAPE, find_quarter_turns(keypoints))
    lean = measure_lean_deg(upright)
    assert lean is not None
    # Between head down and head aside there are 90 degrees, shared by thirds.
    assert abs(lean) <= LYING_FROM_DEG + 1e-6
    if abs(angle) < LYING_FROM_DEG:
        assert find_quarter_turns(keypoints) == 0


@given(angle=st.floats(-180, 180), quarter_turns=st.integers(0, 3))
def test_a_quarter_turn_of_the_frame_turns_the_lean_back(angle: float, quarter_turns: int) -> None:
    here, there = (measure_lean_deg(one) for one in (
        leaning(angle), rotate_keypoints(leaning(angle), SHAPE, quarter_turns)
    ))  # fmt: skip
    assert here is not None and there is not None
    assert (there - here + 90 * quarter_turns + 180) % 360 - 180 == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("quarter_turns", range(4))
def test_keypoints_turn_with_the_frame_and_back(quarter_turns: int) -> None:
    keypoints = leaning(20)
    turned = rotate_keypoints(keypoints, SHAPE, quarter_turns)
    assert_allclose(turned.positions, rotate_points(keypoints.positions, SHAPE, quarter_turns))
    assert turned.scores is keypoints.scores
    back = rotate_keypoints(turned, rotate_shape(SHAPE, quarter_turns), -quarter_turns)
    assert_allclose(back.positions, keypoints.positions)


def test_who_bends_does_not_lie() -> None:
    """Level from the hips on, but on their feet."""
    keypoints = leaning(0)
    hip = keypoints.positions[COCO_NAMES.index("left_hip")]
    for name in ("left_shoulder", "right_shoulder", "nose"):
        keypoints.positions[COCO_NAMES.index(name)] = np.add(hip, (40, 0))
    assert find_quarter_turns(keypoints) == 0


def test_without_legs_the_trunk_tells() -> None:
    legs = ("left_ankle", "right_ankle", "left_knee", "right_knee")
    assert measure_lean_deg(leaning(80, *legs)) == pytest.approx(80)
    assert measure_lean_deg(leaning(80, *legs, "left_shoulder", "right_shoulder")) == pytest.approx(
        80
    )


@pytest.mark.parametrize(
    "unseen",
    [
        ("left_shoulder", "right_shoulder", "nose"),
        tuple(name for name in COCO_NAMES if name.endswith(("hip", "knee", "ankle"))),
        COCO_NAMES,
    ],
)
def test_where_an_end_is_not_seen_nothing_is_told(unseen: tuple[str, ...]) -> None:
    assert measure_lean_deg(leaning(90, *unseen)) is None
    assert find_quarter_turns(leaning(90, *unseen)) == 0
    assert find_quarter_turns(None) == 0


@pytest.mark.parametrize("quarter_turns", [0, 1, 3])
def test_walkers_in_a_turned_street_are_set_upright(
    movenet: MoveNet, street: NDArray[np.uint8], walkers: list[Box], quarter_turns: int
) -> None:
    turned = np.ascontiguousarray(np.rot90(street, quarter_turns))
    people = [one for one in movenet.people(turned) if one.score > 0.1]
    truths = [rotate_box(box, street.shape, quarter_turns) for box in walkers]
    told = [
        find_quarter_turns(one.keypoints)
        for one in people
        if max(one.box.iou(truth) for truth in truths) > 0.5
    ]
    assert told and set(told) == {-quarter_turns % 4}
