"""Bodies that the frame's border or a nearer person cuts."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.vision.blazepose import PoseReading
from app.vision.geometry import Box, PersonWindow
from app.vision.people import (
    COCO_NAMES,
    LANDMARK_NAMES,
    Landmarks,
    ObservedKeypoints,
    Silhouette,
    landmark_rows,
)
from app.vision.truncation import (
    attenuate_visibility_at_border,
    end_beyond_border,
    ends_at_border,
    extended_to_border,
    hidden_by_others,
    may_have_left,
    touches_border,
    with_truncation,
)
from tests.app.painted import BLANK_PASS


def block(left: int, top: int, width: int, height: int) -> Silhouette:
    return Silhouette(np.ones((height, width), bool), left, top, "mask", False)


def landmarks_but(*unseen: str) -> Landmarks:
    """Landmarks that are seen, except those of some parts."""
    missing = [any(part in name for part in unseen) for name in LANDMARK_NAMES]
    return Landmarks(np.full((33, 2), 50.0), np.where(missing, 0.05, 0.8), np.zeros((33, 3)))


HEAD, FEET = ("nose", "eye", "ear"), ("ankle",)


@pytest.mark.parametrize(("left", "top"), [(1, 100), (100, 1), (259, 100), (100, 199)], ids=str)
def test_silhouette_just_short_of_the_edge_is_cut_unless_from_a_mask(left: int, top: int) -> None:
    person = replace(block(left, top, 40, 100), segmenter="network")
    assert touches_border(person, (300, 300))
    assert not touches_border(replace(person, segmenter="mask"), (300, 300))
    inwards = np.clip([left, top], 10, [250, 190]).tolist()
    assert not touches_border(replace(person, left=inwards[0], top=inwards[1]), (300, 300))


sides = st.tuples(st.floats(-0.5, 199), st.floats(0.1, 150))


@given(across=sides, down=sides)
def test_a_box_goes_on_to_the_edges_that_are_nearer_than_a_twentieth_of_it(
    across: tuple[float, float], down: tuple[float, float]
) -> None:
    inside = Box(across[0], down[0], across[1], down[1]).clip(300, 200)
    assert inside is not None
    reach = 0.05 * max(inside.width, inside.height)
    whole = extended_to_border(inside, (200, 300, 3))
    gaps = inside.x + 0.5, inside.y + 0.5, 299.5 - inside.right, 199.5 - inside.bottom
    for side, edge, gap in zip(
        ("x", "y", "right", "bottom"), (-0.5, -0.5, 299.5, 199.5), gaps, strict=True
    ):
        expected = edge if gap <= reach else getattr(inside, side)
        assert getattr(whole, side) == pytest.approx(expected, abs=1e-9)
    assert ends_at_border(inside, (200, 300, 3)) == (min(gaps) <= reach)
    assert may_have_left(inside, (200, 300, 3)) == (min(gaps[:3]) <= reach)


def test_unseen_head_or_feet_lie_beyond_the_edge() -> None:
    above, below, inside = (Box(50, y, 40, 100) for y in (3, 198, 100))
    for box, gone in ((above, HEAD), (below, FEET)):
        assert end_beyond_border(box, landmarks_but(*gone), (300, 300))
        assert not end_beyond_border(box, landmarks_but(), (300, 300))
        assert not end_beyond_border(inside, landmarks_but(*gone), (300, 300))


SHAPE = (200, 300, 3)


def opposite(landmarks: Landmarks) -> Landmarks:
    """The same landmarks after half a turn of the frame."""
    return replace(landmarks, positions=np.array([299, 199]) - landmarks.positions)


@given(x=st.floats(-3, 3), y=st.floats(-3, 3))
def test_landmarks_beyond_any_edge_are_not_seen(x: float, y: float) -> None:
    """Whatever their score; hands beyond it do not matter."""
    landmarks, is_outside = landmarks_but(), min(x, y) <= -0.5
    landmarks.positions[landmark_rows("wrist")] = -9.0
    landmarks.positions[landmark_rows("ankle")] = x, y
    assert end_beyond_border(Box(-0.5, -0.5, 60, 100), landmarks, SHAPE) == is_outside
    assert end_beyond_border(Box(239.5, 99.5, 60, 100), opposite(landmarks), SHAPE) == is_outside


def test_nearer_person_hides_the_farther() -> None:
    near, far = block(14, 10, 10, 30), block(5, 5, 12, 30)
    both = with_truncation([near, far], [near.box, far.box], (80, 80))
    assert [one is not None and one.truncated for one in both] == [False, True]
    assert hidden_by_others(far, [near.box])
    assert with_truncation([None], [near.box], (80, 80)) == [None]
    # Of a person without a silhouette, the box hides others, wherever in the list they are.
    boxes = [near.box, far.box, far.box]
    for row in (1, 2):
        people: list[Silhouette | None] = [None, None, None]
        people[row] = far
        seen = with_truncation(people, boxes, (80, 80))[row]
        assert seen is not None and seen.truncated
    (first, _) = with_truncation([far, None], [far.box, near.box], (80, 80))
    assert first is not None and first.truncated


@pytest.mark.parametrize(
    ("keypoint", "landmarks"),
    [
        ("left_wrist", {"left_wrist", "left_pinky", "left_index", "left_thumb"}),
        ("right_ankle", {"right_ankle", "right_heel", "right_foot_index"}),
        ("nose", {"nose", "mouth_left", "mouth_right"}),
        ("left_eye", {"left_eye_inner", "left_eye", "left_eye_outer"}),
        ("right_knee", {"right_knee"}),
    ],
)
def test_landmarks_near_the_border_are_as_visible_as_the_keypoint_next_to_them(
    keypoint: str, landmarks: set[str]
) -> None:
    scores = np.full(17, 0.9)
    scores[COCO_NAMES.index(keypoint)] = 0.05
    window = PersonWindow(50, 50, 100)
    reading = PoseReading(
        window,
        landmarks_but(),
        1.0,
        window,
        BLANK_PASS,
        keypoints=ObservedKeypoints(np.zeros((17, 2)), scores),
    )
    reach = 0.3 * reading.body_px
    nearest = 50 + math.ceil(reach)
    for shape, hidden in (
        ((300, nearest), landmarks), ((nearest, 300), landmarks), ((300, nearest + 1), set()),
    ):  # fmt: skip
        seen = attenuate_visibility_at_border(reading, shape).visibility
        dimmed = {name for name, value in zip(LANDMARK_NAMES, seen, strict=True) if value < 0.8}
        assert dimmed == hidden
        assert seen.min() == pytest.approx(0.8 * 0.2 if hidden else 0.8)
