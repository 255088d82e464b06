"""Who is who, on boxes that move as people do."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from app.estimation.results import ObservedPerson
from app.tracking.matching import appearance_distance, appearance_histogram, associate
from app.tracking.track import BoxFilter, Sighting, Track
from app.vision.geometry import Box, Silhouette

RED, BLUE = (np.eye(80, dtype=np.float32)[row] for row in (3, 40))


def sighting(x: float, y: float = 100.0, appearance: NDArray[np.float32] | None = None) -> Sighting:
    """Somebody 80 px tall."""
    return Sighting(ObservedPerson(Box(x, y, 30, 80), "detector", 0.9, None), appearance)


def walking(x: float, speed: float, appearance: NDArray[np.float32] | None = None) -> Track:
    """A track seen for a second up to time 1, at ``x`` then, in pixels a second to the right."""
    track = Track(sighting(x - speed, appearance=appearance), 0.0)
    for step in range(11):
        seen = sighting(x - speed + speed * step / 10, appearance=appearance)
        if step:
            track.see(seen, step / 10)
    return track


class TestBoxFilter:
    def test_learns_the_velocity(self) -> None:
        track = walking(200, 60)
        assert track.box_filter.velocity[0] == pytest.approx(60, rel=0.15)
        assert track.box_filter.velocity[1] == pytest.approx(0, abs=1e-9)
        expected = track.box_filter.predict(1.1)
        assert expected.x == pytest.approx(206, abs=2)
        assert (expected.width, expected.height) == (30, 80)

    def test_somebody_unseen_is_not_expected_ever_farther_away(self) -> None:
        track = walking(200, 60)
        assert track.box_filter.predict(100.0).x < 200 + 1.3 * 60

    def test_the_size_does_not_shrink_where_a_part_is_hidden(self) -> None:
        motion = BoxFilter(Box(100, 100, 30, 80), 0.0)
        motion.update(Box(100, 140, 30, 40), 0.1, whole=False)
        assert motion.predict(0.1).height == 80
        motion.update(Box(100, 100, 30, 90), 0.2, whole=False)
        assert 80 < motion.predict(0.2).height < 90

    def test_frames_far_apart_do_not_overshoot(self) -> None:
        motion = BoxFilter(Box(100, 100, 30, 80), 0.0)
        motion.update(Box(150, 100, 30, 80), 5.0, whole=True)
        assert motion.velocity[0] == pytest.approx(10)


class TestAssociate:
    def test_nobody(self) -> None:
        assert associate([], [], 1.0) == []
        assert associate([], [sighting(10)], 1.0) == [None]
        assert associate([walking(100, 0)], [], 1.0) == []

    def test_each_goes_on_as_expected(self) -> None:
        tracks = [walking(100, 50), walking(300, -50)]
        assert associate(tracks, [sighting(295), sighting(105)], 1.1) == [1, 0]

    def test_a_newcomer_is_nobody_yet(self) -> None:
        assert associate([walking(100, 0)], [sighting(400), sighting(101)], 1.1) == [None, 0]

    def test_who_bends_fast_stays_the_same_person(self) -> None:
        """Boxes of UP-Fall at six frames a second: the size expected lags behind."""
        boxes = Box(317, 166, 70, 293), Box(266, 266, 130, 195), Box(253, 300, 157, 158)
        seen = [Sighting(ObservedPerson(box, "detector", 0.9, None), None) for box in boxes]
        track = Track(seen[0], 0.0)
        for number in range(1, 6):
            track.see(seen[0], number / 6)
        track.see(seen[1], 1.0)
        assert associate([track], [seen[2]], 1 + 1 / 6) == [0]

    def test_nobody_grows_at_once(self) -> None:
        child = Sighting(ObservedPerson(Box(108, 140, 14, 40), "detector", 0.9, None), None)
        assert associate([walking(100, 0)], [child], 1.1) == [None]

    def test_who_falls_unseen_is_found_again_though_much_smaller(self) -> None:
        """Boxes of a fall in a care home; a third of a second lies between the last two."""
        boxes = Box(364, 33, 128, 217), Box(343, 28, 169, 208), Box(368, 104, 123, 118)
        seen = [Sighting(ObservedPerson(box, "detector", 0.9, None), None) for box in boxes]
        track = Track(seen[0], 0.0)
        for number in range(1, 6):
            track.see(seen[0], 0.08 * number)
        track.see(seen[1], 0.48)
        assert associate([track], [seen[2]], 0.50) == [None]
        assert associate([track], [seen[2]], 0.80) == [0]

    def test_who_is_unseen_for_longer_may_be_farther_away(self) -> None:
        assert associate([walking(100, 0)], [sighting(180)], 1.1) == [None]
        assert associate([walking(100, 0)], [sighting(180)], 2.9) == [0]

    def test_clothes_tell_who_is_who_where_places_do_not(self) -> None:
        tracks = [walking(100, 0, RED), walking(110, 0, BLUE)]
        seen = [sighting(103, appearance=BLUE), sighting(107, appearance=RED)]
        assert associate(tracks, seen, 1.1) == [1, 0]


class TestClothes:
    def test_of_two_people(self) -> None:
        frame = np.zeros((60, 80, 3), np.uint8)
        frame[10:50, 10:30] = (20, 20, 200)
        frame[10:50, 40:60] = (200, 20, 20)
        crop = np.ones((40, 20), bool)
        red, blue = (
            appearance_histogram(frame, Silhouette(crop, left, 10, "network", False))
            for left in (10, 40)
        )
        assert red.shape == (80,) and red.sum() == pytest.approx(1)
        assert appearance_distance(red, red) == pytest.approx(0, abs=1e-3)
        assert appearance_distance(red, blue) > 0.6
