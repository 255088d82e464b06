"""Bodies that the frame's border or a nearer person cuts."""

from dataclasses import replace

import numpy as np
import pytest

from app.vision.blazepose import PoseReading
from app.vision.geometry import Box, PersonWindow
from app.vision.people import (
    COCO_NAMES,
    LANDMARK_NAMES,
    Landmarks,
    ObservedKeypoints,
    Silhouette,
)
from app.vision.truncation import (
    attenuate_visibility_at_border,
    end_beyond_border,
    hidden_by_others,
    touches_border,
    with_truncation,
)


def block(left: int, top: int, width: int, height: int) -> Silhouette:
    return Silhouette(np.ones((height, width), bool), left, top, "mask", False)


def landmarks_but(*unseen: str) -> Landmarks:
    """Landmarks that are seen, except those of some parts."""
    missing = [any(part in name for part in unseen) for name in LANDMARK_NAMES]
    return Landmarks(np.full((33, 2), 50.0), np.where(missing, 0.05, 0.8), np.zeros((33, 3)))


HEAD, FEET = ("nose", "eye", "ear"), ("ankle",)


def test_silhouette_at_the_border_is_cut() -> None:
    assert touches_border(block(0, 5, 10, 20), (40, 40))
    assert touches_border(block(5, 20, 10, 20), (40, 40))
    assert not touches_border(block(5, 5, 10, 20), (40, 40))


@pytest.mark.parametrize(("left", "top"), [(1, 100), (100, 1), (259, 100), (100, 199)], ids=str)
def test_silhouette_just_short_of_the_edge_is_cut_unless_from_a_mask(left: int, top: int) -> None:
    person = replace(block(left, top, 40, 100), segmenter="network")
    assert touches_border(person, (300, 300))
    assert not touches_border(replace(person, segmenter="mask"), (300, 300))
    inwards = np.clip([left, top], 10, [250, 190]).tolist()
    assert not touches_border(replace(person, left=inwards[0], top=inwards[1]), (300, 300))


def test_unseen_head_or_feet_lie_beyond_the_edge() -> None:
    above, below, inside = (Box(50, y, 40, 100) for y in (3, 198, 100))
    for box, gone in ((above, HEAD), (below, FEET)):
        assert end_beyond_border(box, landmarks_but(*gone), (300, 300))
        assert not end_beyond_border(box, landmarks_but(), (300, 300))
        assert not end_beyond_border(inside, landmarks_but(*gone), (300, 300))


def test_landmarks_beyond_the_edge_are_not_seen() -> None:
    """Whatever their score."""
    landmarks = landmarks_but()
    for i, name in enumerate(LANDMARK_NAMES):
        if name.endswith(FEET):
            landmarks.positions[i, 1] = 310
    assert end_beyond_border(Box(50, 198, 40, 100), landmarks, (300, 300))
    assert not end_beyond_border(Box(50, 198, 40, 100), landmarks, (400, 300))


def test_nearer_person_hides_the_farther() -> None:
    near, far = block(14, 10, 10, 30), block(5, 5, 12, 30)
    both = with_truncation([near, far], [near.box, far.box], (80, 80))
    assert [one is not None and one.truncated for one in both] == [False, True]
    assert hidden_by_others(far, [near.box])
    assert with_truncation([None], [near.box], (80, 80)) == [None]


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
        window, landmarks_but(), 1.0, window, keypoints=ObservedKeypoints(np.zeros((17, 2)), scores)
    )
    reach = 0.3 * reading.body_px
    for shape, hidden in (((300, 50 + round(reach)), landmarks), ((300, 300), set())):
        seen = attenuate_visibility_at_border(reading, shape).visibility
        dimmed = {name for name, value in zip(LANDMARK_NAMES, seen, strict=True) if value < 0.8}
        assert dimmed == hidden
        assert seen.min() == pytest.approx(0.8 * 0.2 if hidden else 0.8)
