"""A person's posture by votes and landmarks, and which way skeletons face."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from app.estimation.facing import azimuth_deg
from app.estimation.posture import (
    CLEAR_FROM,
    body_features,
    estimate_posture,
    grounded_probability,
    posture_of,
    vote_posture,
    with_bent_legs,
    with_grounded,
)
from app.vision.people import LANDMARK_NAMES, Landmarks
from index.posture import ON_THE_GROUND, POSTURES, UPRIGHT
from index.search import rotate_clockwise
from index.skeleton import camera_rotation

HEIGHTS = {
    "nose": 0.65, "eye": 0.68, "ear": 0.66, "mouth": 0.62, "shoulder": 0.5, "elbow": 0.25,
    "wrist": 0.0, "pinky": -0.05, "index": -0.05, "thumb": -0.05, "hip": 0.0, "knee": -0.42,
    "ankle": -0.82, "heel": -0.86,
}  # fmt: skip


def standing() -> Landmarks:
    """Landmarks of somebody who stands and faces the camera."""
    metres = np.zeros((len(LANDMARK_NAMES), 3))
    for row, name in enumerate(LANDMARK_NAMES):
        part = next((key for key in HEIGHTS if key in name), "heel")
        metres[row, 0] = 0.18 if "left" in name else -0.18 if "right" in name else 0.0
        metres[row, 1] = -HEIGHTS[part]
    places = 200 * metres[:, :2] + [320, 240]
    return Landmarks(places, np.full(len(metres), 0.95), metres)


def turned(landmarks: Landmarks, angle_deg: float) -> Landmarks:
    """The same, rotated in the picture."""
    angle = np.deg2rad(angle_deg)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    metres = landmarks.metres.copy()
    metres[:, :2] = metres[:, :2] @ turn
    places = (landmarks.positions - [320, 240]) @ turn + [320, 240]
    return Landmarks(places, landmarks.visibility, metres)


def share(votes: NDArray[np.float64], *postures: str) -> float:
    return float(sum(votes[POSTURES.index(name)] for name in postures))  # type: ignore[arg-type]


def test_confidence_decides_rather_than_numbers() -> None:
    votes = vote_posture(["standing", "walking", "walking"], [0.9, 0.3, 0.3])
    assert share(votes, "standing") == pytest.approx(0.6)
    assert share(votes, "walking") == pytest.approx(0.4)


@given(
    weights=st.lists(st.floats(0, 1), min_size=len(POSTURES), max_size=len(POSTURES)),
    probability=st.floats(0, 1),
)
def test_landmarks_decide_how_much_lies_and_votes_what_else(
    weights: list[float], probability: float
) -> None:
    votes = vote_posture(POSTURES, weights)
    shares = with_grounded(votes, probability)
    assert shares.sum() == pytest.approx(1)
    assert share(shares, *ON_THE_GROUND) == pytest.approx(probability)
    order = [i for i, name in enumerate(POSTURES) if name not in ON_THE_GROUND]
    if votes[order].sum() > 0.02 and probability < 1:
        assert_allclose(
            shares[order] / shares[order].sum(), votes[order] / votes[order].sum(), atol=1e-9
        )


def test_who_stands_does_not_lie_and_the_same_body_on_its_side_does() -> None:
    assert grounded_probability(standing()) < 0.05
    for angle_deg in (90, -90):
        assert grounded_probability(turned(standing(), angle_deg)) > 0.5


@pytest.mark.parametrize("angle_deg", [-30, -15, 15, 30])
def test_who_leans_or_is_seen_by_a_rolled_camera_does_not_lie(angle_deg: float) -> None:
    assert grounded_probability(turned(standing(), angle_deg)) < 0.5


def test_where_all_hypotheses_lie_and_the_landmarks_stand_nothing_is_told() -> None:
    assert estimate_posture(vote_posture(["lying"], [1.0]), standing()).label == "unclear"


def with_knees_bent(landmarks: Landmarks, *sides: str) -> Landmarks:
    """The same, with thighs that point at the camera."""
    metres = landmarks.metres.copy()
    for side in sides:
        hip, *below = (
            LANDMARK_NAMES.index(f"{side}_{part}")
            for part in ("hip", "knee", "ankle", "heel", "foot_index")
        )
        metres[below, 1] -= metres[below[0], 1] - metres[hip, 1]
        metres[below, 2] -= 0.42
    return Landmarks(landmarks.positions, landmarks.visibility, metres)


@given(weights=st.lists(st.floats(0, 1), min_size=len(POSTURES), max_size=len(POSTURES)))
def test_only_who_bends_both_knees_does_not_stand(weights: list[float]) -> None:
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
    """The same, with shanks that point away from the camera: on the knees."""
    metres = landmarks.metres.copy()
    for side in ("left", "right"):
        knee, *below = (
            LANDMARK_NAMES.index(f"{side}_{part}")
            for part in ("knee", "ankle", "heel", "foot_index")
        )
        metres[below] = metres[knee] + [0.0, 0.0, 0.4]
    return Landmarks(landmarks.positions, landmarks.visibility, metres)


def test_whether_bent_knees_sit_or_crouch_is_left_to_the_votes() -> None:
    both = with_shanks_level(standing())
    assert estimate_posture(vote_posture(["standing"], [1.0]), both).label == "unclear"
    for other in ("sitting", "kneeling", "crouching"):
        votes = vote_posture(["standing", other], [0.9, 0.1])
        assert estimate_posture(votes, both).label == other


def test_who_bends_both_knees_and_holds_trunk_and_shanks_upright_sits() -> None:
    both = with_knees_bent(standing(), "left", "right")
    assert estimate_posture(vote_posture(["standing"], [1.0]), both).label == "sitting"
    votes = vote_posture(["standing", "crouching"], [0.9, 0.1])
    assert estimate_posture(votes, both).label == "crouching"


def test_left_and_right_count_alike() -> None:
    body = standing()
    rng = np.random.default_rng(0)
    metres = body.metres + rng.normal(0, 0.1, body.metres.shape)
    places = 200 * metres[:, :2] + [320, 240]
    sides = [
        LANDMARK_NAMES.index(
            name.replace("left", "?").replace("right", "left").replace("?", "right")
        )
        for name in LANDMARK_NAMES
    ]
    flipped = metres[sides] * [-1, 1, 1]
    mirrored = Landmarks(200 * flipped[:, :2] + [320, 240], body.visibility, flipped)
    assert_allclose(
        body_features(mirrored), body_features(Landmarks(places, body.visibility, metres)),
        atol=1e-9,
    )  # fmt: skip


def test_what_is_no_person_is_unclear() -> None:
    told = estimate_posture(vote_posture(["lying"], [0.9]), None, presence=0.02)
    assert told.label == "unclear"
    assert told.probability < 0.05


@given(weights=st.lists(st.floats(0.001, 1), min_size=2, max_size=10))
def test_a_posture_is_told_from_a_probability_of_a_half(weights: list[float]) -> None:
    told = posture_of(vote_posture(POSTURES[: len(weights)], weights))
    assert 0 <= told.probability <= 1
    assert (told.label == "unclear") == (told.probability < CLEAR_FROM)


@pytest.mark.parametrize("azimuth", [-170.0, -90.0, -30.0, 0.0, 45.0, 90.0, 179.0])
# From above, depth is foreshortened.
@pytest.mark.parametrize(("elevation", "atol"), [(0.0, 1e-9), (30.0, 5.0)])
def test_azimuth_is_that_of_the_camera(azimuth: float, elevation: float, atol: float) -> None:
    body = np.zeros((24, 3))
    body[[5, 11], 0], body[[8, 15], 0] = 0.2, -0.2  # shoulders and hips, to the left and right
    body[[5, 8], 1] = 0.5
    seen = azimuth_deg(body @ camera_rotation(azimuth, elevation).T)
    assert (seen - azimuth + 180) % 360 - 180 == pytest.approx(0, abs=atol)


@pytest.mark.parametrize("angle", [-135.0, -90.0, 15.0, 90.0, 180.0])
def test_azimuth_does_not_change_as_the_picture_is_rotated(angle: float) -> None:
    bodies = np.random.default_rng(0).normal(size=(20, 24, 3))
    rotated = azimuth_deg(rotate_clockwise(bodies, angle))
    assert_allclose((rotated - azimuth_deg(bodies) + 180) % 360, 180, atol=1e-6)
