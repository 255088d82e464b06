"""People in front of others: what they cover, and where those behind are expected."""

import pytest

from app.estimation.results import Person
from app.tracking.occlusion import PREDICTED_FOR_S, covered_share, hidden_box
from app.tracking.track import Track
from app.vision.geometry import Box

BEHIND = Box(100, 100, 40, 100)
SIZE = 480, 640


def seen(box: Box, *, at: float = 1.0, named: bool = True) -> Track:
    track = Track(Person(box, "detector", 0.9), at)
    track.track_id = 1 if named else None
    return track


@pytest.mark.parametrize(("left", "share"), [(100, 1.0), (110, 0.75), (139, 0.025), (150, 0.0)])
def test_the_share_that_another_person_covers(left: float, share: float) -> None:
    track = seen(BEHIND)
    tracks = [track, seen(Box(left, 100, 40, 100))]
    assert covered_share(track, BEHIND, tracks, 1.0) == pytest.approx(share)


@pytest.mark.parametrize("other", [seen(BEHIND, at=0.5), seen(BEHIND, named=False)])
def test_people_out_of_sight_or_without_an_identity_cover_nothing(other: Track) -> None:
    track = seen(BEHIND)
    assert covered_share(track, BEHIND, [track, other], 1.0) == 0


@pytest.mark.parametrize(("left", "hides"), [(100, True), (118, True), (122, False)])
def test_a_person_covered_by_half_is_hidden(left: float, hides: bool) -> None:
    track, other = seen(BEHIND, at=0.5), seen(Box(left, 100, 40, 100))
    assert (hidden_box(track, [track, other], SIZE, 1.0) == BEHIND) == hides


def test_a_hidden_person_is_not_expected_for_long_or_beyond_the_frame() -> None:
    late = 0.5 + PREDICTED_FOR_S + 0.1
    track = seen(BEHIND, at=0.5)
    assert hidden_box(track, [track, seen(BEHIND, at=late)], SIZE, late) is None
    outside = Box(700, 100, 40, 100)
    gone = seen(outside, at=0.5)
    assert hidden_box(gone, [gone, seen(outside)], SIZE, 1.0) is None
