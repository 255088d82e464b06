"""How likely a person is in each posture, in a frame and over time."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.estimation.posture import (
    LANDMARK_GROUPS,
    MIN_PROBABILITY,
    PostureFilter,
    as_standing,
    likeliest_posture,
)
from app.vision.geometry import Box
from app.vision.judgement import FRAME_POSTURES, FramePosture
from index.posture import ON_THE_GROUND, POSTURES, UPRIGHT, PostureName, vote_posture

some_weights = st.lists(st.floats(0.001, 1), min_size=len(POSTURES), max_size=len(POSTURES))
some_probabilities = st.lists(
    st.floats(0.001, 1), min_size=len(FRAME_POSTURES), max_size=len(FRAME_POSTURES)
)


def frame_posture(**weights: float) -> FramePosture:
    """Probabilities in proportion to the weights of some frame postures."""
    values = np.array([weights.get(name, 0.0) for name in FRAME_POSTURES])
    return FramePosture(values / values.sum())


def share(votes: NDArray[np.float64], *postures: str) -> float:
    return float(sum(votes[POSTURES.index(name)] for name in postures))  # type: ignore[arg-type]


@given(weights=some_weights, probabilities=some_probabilities)
def test_landmarks_decide_between_groups_and_votes_within(
    weights: list[float], probabilities: list[float]
) -> None:
    seen = frame_posture(**dict(zip(FRAME_POSTURES, probabilities, strict=True)))
    votes = vote_posture(POSTURES, weights)
    shares = LANDMARK_GROUPS.split(seen.probabilities, votes)
    assert shares.sum() == pytest.approx(1)
    assert share(shares, *UPRIGHT) == pytest.approx(seen.of("standing"))
    assert share(shares, "lying") == pytest.approx(seen.of("lying"))
    assert share(shares, "crawling") == pytest.approx(seen.of("all_fours"))
    if share(votes, "walking") > share(votes, "standing") + 1e-9:
        assert share(shares, "walking") > share(shares, "standing")


def test_probability_is_that_of_the_label() -> None:
    votes = vote_posture(["standing", "walking"], [0.7, 0.3])
    upright = likeliest_posture(
        LANDMARK_GROUPS.split(frame_posture(standing=0.9, sitting=0.1).probabilities, votes)
    )
    assert upright.label == "standing"
    assert upright.probability == pytest.approx(0.63, abs=0.01)
    seen = frame_posture(lying=0.55, all_fours=0.35, sitting=0.1)
    low = likeliest_posture(LANDMARK_GROUPS.split(seen.probabilities, votes))
    assert (low.label, low.probability) == ("lying", pytest.approx(0.55))
    # Surely upright, but nothing says whether the person walks.
    either = likeliest_posture(vote_posture(["standing", "walking", "running"], [0.4, 0.3, 0.3]))
    assert (either.label, either.probability) == ("unclear", pytest.approx(0.4))


@given(weights=some_weights, confidence=st.floats(0, 1), presence=st.floats(0, 1))
def test_posture_is_limited_by_presence_and_by_the_best_hypothesis(
    weights: list[float], confidence: float, presence: float
) -> None:
    shares = np.array(weights) / sum(weights)
    found = likeliest_posture(shares, presence, confidence)
    assert found.probability <= presence + 1e-9
    assert confidence >= 0.2 or found.probability <= 0.8
    assert (found.label == "unclear") == (found.probability < MIN_PROBABILITY)


@given(weights=some_weights)
def test_nobody_walks_whose_feet_are_not_seen(weights: list[float]) -> None:
    shares = as_standing(vote_posture(POSTURES, weights))
    assert shares.sum() == pytest.approx(1)
    assert share(shares, "walking", "running") == 0


NARROW, WIDE = Box(0, 0, 40, 160), Box(0, 0, 160, 40)


def votes(posture: PostureName) -> NDArray[np.float64]:
    return vote_posture([posture], [1.0])


@pytest.mark.parametrize("fps", [5, 30])
def test_the_posture_settles_on_a_new_one_within_a_second(fps: int) -> None:
    postures = PostureFilter()
    labels = []
    for frame in range(3 * fps):
        seen = votes("standing" if frame < fps else "sitting")
        posture, shares = postures.update(frame / fps, seen, None, 1.0, NARROW)
        labels.append(posture.label)
        assert shares is seen
    assert set(labels[:fps]) == {"standing"} and labels[fps] != "sitting"
    assert set(labels[2 * fps :]) == {"sitting"}


def test_after_a_long_gap_the_newest_frame_counts_for_most() -> None:
    postures = PostureFilter()
    postures.update(0.0, votes("standing"), None, 1.0, NARROW)
    posture, _ = postures.update(60.0, votes("lying"), None, 1.0, WIDE)
    assert posture.label == "lying"
    assert posture.share(["standing"]) == pytest.approx(np.exp(-1 / 0.4))


@pytest.mark.parametrize(("box", "lies"), [(NARROW, False), (WIDE, True)])
def test_where_the_network_sees_no_person_the_box_decides(box: Box, lies: bool) -> None:
    frame_posture = FramePosture(np.full(len(FRAME_POSTURES), 1 / len(FRAME_POSTURES)))
    _, shares = PostureFilter().update(0.0, votes("standing"), frame_posture, 0.0, box)
    share = sum(shares[POSTURES.index(posture)] for posture in ON_THE_GROUND)
    assert (share > 0.9) if lies else (share < 0.1)
    assert shares.sum() == pytest.approx(1)


def test_unreliable_frames_hardly_change_the_posture() -> None:
    postures = PostureFilter()
    postures.update(0.0, votes("lying"), None, 1.0, WIDE)
    for frame in range(1, 11):
        posture, _ = postures.update(frame / 10, votes("standing"), None, 1.0, NARROW, 0.1)
    assert posture.label == "lying"


def test_a_posture_fades_with_the_probability_of_a_person() -> None:
    postures = PostureFilter()
    first, _ = postures.update(0.0, votes("standing"), None, 1.0, NARROW)
    for frame in range(1, 5):
        last, _ = postures.update(frame / 10, votes("standing"), None, 0.2, NARROW)
    presence = np.exp(-1) + (1 - np.exp(-1)) * 0.2
    assert last.probability == pytest.approx(presence * first.probability)
