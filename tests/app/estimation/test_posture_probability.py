"""How likely a person is in each posture, by votes and landmarks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from app.estimation.parameters import POSTURE
from app.estimation.posture_probability import (
    body_features,
    estimate_posture,
    on_ground_probability,
    posture_of,
    vote_posture,
    with_bent_legs,
    with_on_ground,
)
from app.vision.people import LANDMARK_NAMES, Landmarks
from index.posture import ON_THE_GROUND, POSTURES, UPRIGHT
from index.skeleton import rotate_clockwise, rows

HEIGHTS = {
    "nose": 0.65, "eye": 0.68, "ear": 0.66, "mouth": 0.62, "shoulder": 0.5, "elbow": 0.25,
    "wrist": 0.0, "pinky": -0.05, "index": -0.05, "thumb": -0.05, "hip": 0.0, "knee": -0.42,
    "ankle": -0.82, "heel": -0.86,
}  # fmt: skip


def standing() -> Landmarks:
    """Landmarks of a person standing and facing the camera."""
    metres = np.zeros((len(LANDMARK_NAMES), 3))
    for row, name in enumerate(LANDMARK_NAMES):
        part = next((key for key in HEIGHTS if key in name), "heel")
        metres[row, 0] = 0.18 if "left" in name else -0.18 if "right" in name else 0.0
        metres[row, 1] = -HEIGHTS[part]
    places = 200 * metres[:, :2] + [320, 240]
    return Landmarks(places, np.full(len(metres), 0.95), metres)


def turned(landmarks: Landmarks, angle_deg: float) -> Landmarks:
    """The same person rotated in the picture."""
    angle = np.deg2rad(angle_deg)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    places = (landmarks.positions - [320, 240]) @ turn + [320, 240]
    return Landmarks(places, landmarks.visibility, rotate_clockwise(landmarks.metres, angle_deg))


def share(votes: NDArray[np.float64], *postures: str) -> float:
    return float(sum(votes[POSTURES.index(name)] for name in postures))  # type: ignore[arg-type]


def test_votes_are_weighted_by_confidence() -> None:
    votes = vote_posture(["standing", "walking", "walking"], [0.9, 0.3, 0.3])
    assert share(votes, "standing") == pytest.approx(0.6)
    assert share(votes, "walking") == pytest.approx(0.4)


@given(
    weights=st.lists(st.floats(0, 1), min_size=len(POSTURES), max_size=len(POSTURES)),
    probability=st.floats(0, 1),
)
def test_landmarks_decide_the_share_on_the_ground_and_votes_the_rest(
    weights: list[float], probability: float
) -> None:
    votes = vote_posture(POSTURES, weights)
    shares = with_on_ground(votes, probability)
    assert shares.sum() == pytest.approx(1)
    assert share(shares, *ON_THE_GROUND) == pytest.approx(probability)
    order = [i for i, name in enumerate(POSTURES) if name not in ON_THE_GROUND]
    if votes[order].sum() > 0.02 and probability < 1:
        assert_allclose(
            shares[order] / shares[order].sum(), votes[order] / votes[order].sum(), atol=1e-9
        )


def test_standing_body_is_on_the_ground_once_rotated() -> None:
    assert on_ground_probability(standing()) < 0.05
    for angle_deg in (90, -90):
        assert on_ground_probability(turned(standing(), angle_deg)) > 0.5


@pytest.mark.parametrize("angle_deg", [-30, -15, 15, 30])
def test_leaning_body_is_not_on_the_ground(angle_deg: float) -> None:
    assert on_ground_probability(turned(standing(), angle_deg)) < 0.5


def test_contradicting_hypotheses_and_landmarks_are_unclear() -> None:
    assert estimate_posture(vote_posture(["lying"], [1.0]), standing()).label == "unclear"


def leg(side: str) -> list[int]:
    """Rows of the landmarks from the hip to the toes."""
    parts = ("hip", "knee", "ankle", "heel", "foot_index")
    return rows(*(f"{side}_{part}" for part in parts), among=LANDMARK_NAMES)


def with_knees_bent(landmarks: Landmarks, *sides: str) -> Landmarks:
    """The same person with thighs that point at the camera."""
    metres = landmarks.metres.copy()
    for side in sides:
        hip, *below = leg(side)
        metres[below, 1] -= metres[below[0], 1] - metres[hip, 1]
        metres[below, 2] -= 0.42
    return Landmarks(landmarks.positions, landmarks.visibility, metres)


@given(weights=st.lists(st.floats(0, 1), min_size=len(POSTURES), max_size=len(POSTURES)))
def test_only_two_bent_knees_exclude_standing(weights: list[float]) -> None:
    votes = vote_posture(POSTURES, weights)
    one = with_knees_bent(standing(), "left")
    both = with_knees_bent(standing(), "left", "right")
    for landmarks, presence in ((standing(), 1.0), (one, 1.0), (both, 0.0)):
        assert_allclose(with_bent_legs(votes, landmarks, presence), votes, atol=1e-3)
    shares = with_bent_legs(votes, both, 1.0)
    assert shares.sum() == pytest.approx(1) and (shares >= 0).all()
    assert share(shares, *UPRIGHT) < 1e-3
    assert share(shares, *ON_THE_GROUND) == pytest.approx(share(votes, *ON_THE_GROUND))


def with_shanks_level(landmarks: Landmarks) -> Landmarks:
    """The same person with shanks that point away from the camera: kneeling."""
    metres = landmarks.metres.copy()
    for side in ("left", "right"):
        _, knee, *below = leg(side)
        metres[below] = metres[knee] + [0.0, 0.0, 0.4]
    return Landmarks(landmarks.positions, landmarks.visibility, metres)


def test_votes_decide_between_sitting_and_crouching() -> None:
    both = with_shanks_level(standing())
    assert estimate_posture(vote_posture(["standing"], [1.0]), both).label == "unclear"
    for other in ("sitting", "kneeling", "crouching"):
        votes = vote_posture(["standing", other], [0.9, 0.1])
        assert estimate_posture(votes, both).label == other


def test_bent_knees_with_upright_trunk_and_shanks_are_sitting() -> None:
    both = with_knees_bent(standing(), "left", "right")
    assert estimate_posture(vote_posture(["standing"], [1.0]), both).label == "sitting"
    votes = vote_posture(["standing", "crouching"], [0.9, 0.1])
    assert estimate_posture(votes, both).label == "crouching"


def test_exchanging_left_and_right_changes_no_feature() -> None:
    body = standing()
    rng = np.random.default_rng(0)
    metres = body.metres + rng.normal(0, 0.1, body.metres.shape)
    places = 200 * metres[:, :2] + [320, 240]
    sides = rows(
        *(
            name.replace("left", "?").replace("right", "left").replace("?", "right")
            for name in LANDMARK_NAMES
        ),
        among=LANDMARK_NAMES,
    )
    flipped = metres[sides] * [-1, 1, 1]
    mirrored = Landmarks(200 * flipped[:, :2] + [320, 240], body.visibility, flipped)
    assert_allclose(
        body_features(mirrored), body_features(Landmarks(places, body.visibility, metres)),
        atol=1e-9,
    )  # fmt: skip


def test_unlikely_person_is_unclear() -> None:
    found = estimate_posture(vote_posture(["lying"], [0.9]), None, presence=0.02)
    assert found.label == "unclear"
    assert found.probability < 0.05


@given(weights=st.lists(st.floats(0.001, 1), min_size=2, max_size=10))
def test_posture_is_reported_from_a_probability_of_one_half(weights: list[float]) -> None:
    found = posture_of(vote_posture(POSTURES[: len(weights)], weights))
    assert 0 <= found.probability <= 1
    assert (found.label == "unclear") == (found.probability < POSTURE.min_probability)
