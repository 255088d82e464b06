"""Sightings matched to tracks, on boxes that move as people do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from app.estimation.results import Person
from app.tracking.track import Sighting, Track, appearance_distance, appearance_histogram, associate
from app.vision.geometry import Box
from app.vision.people import Silhouette

RED, BLUE = (np.eye(80, dtype=np.float32)[row] for row in (3, 40))


def sighting(box: Box, appearance: NDArray[np.float32] | None = None) -> Sighting:
    return Sighting(Person(box, "detector", 0.9, None), appearance)


def at(x: float, appearance: NDArray[np.float32] | None = None) -> Sighting:
    """A person 80 px tall."""
    return sighting(Box(x, 100.0, 30, 80), appearance)


def walking(x: float, speed: float, appearance: NDArray[np.float32] | None = None) -> Track:
    """A track seen for a second up to time 1, at ``x`` then, in pixels a second to the right."""
    track = Track(at(x - speed, appearance), 0.0)
    for step in range(11):
        track.see(at(x - speed + speed * step / 10, appearance), step / 10)
    return track


@pytest.mark.parametrize(
    ("tracks", "sightings", "time", "expected"),
    [
        ([], [], 1.0, []),
        ([], [at(10)], 1.0, [None]),
        ([walking(100, 0)], [], 1.0, []),
        # Each goes on as predicted.
        ([walking(100, 50), walking(300, -50)], [at(295), at(105)], 1.1, [1, 0]),
        # A new person.
        ([walking(100, 0)], [at(400), at(101)], 1.1, [None, 0]),
        # Nobody grows at once: a child.
        ([walking(100, 0)], [sighting(Box(108, 140, 14, 40))], 1.1, [None]),
        # A person unseen for longer may be farther away.
        ([walking(100, 0)], [at(180)], 1.1, [None]),
        ([walking(100, 0)], [at(180)], 2.9, [0]),
        # Clothes decide where places do not.
        ([walking(100, 0, RED), walking(110, 0, BLUE)], [at(103, BLUE), at(107, RED)], 1.1, [1, 0]),
    ],
)
def test_sightings_are_assigned_by_place_size_and_clothes(
    tracks: list[Track], sightings: list[Sighting], time: float, expected: list[int | None]
) -> None:
    assert associate(tracks, sightings, time) == expected


def test_the_window_of_a_track_counts_even_far_from_its_prediction() -> None:
    tracks = [walking(100, 0), walking(160, 0)]
    assert associate(tracks, [at(170)], 1.1) == [1]
    assert associate(tracks, [replace(at(170), track=tracks[0])], 1.1) == [0]


def test_a_person_who_bends_fast_stays_the_same() -> None:
    """Boxes of UP-Fall at six frames a second: the predicted size lags behind."""
    first, second, third = map(
        sighting, (Box(317, 166, 70, 293), Box(266, 266, 130, 195), Box(253, 300, 157, 158))
    )
    track = Track(first, 0.0)
    for number in range(1, 6):
        track.see(first, number / 6)
    track.see(second, 1.0)
    assert associate([track], [third], 1 + 1 / 6) == [0]


def test_a_person_who_falls_unseen_is_found_again_though_much_smaller() -> None:
    """Boxes of a fall in a care home; a third of a second lies between the last two."""
    first, second, third = map(
        sighting, (Box(364, 33, 128, 217), Box(343, 28, 169, 208), Box(368, 104, 123, 118))
    )
    track = Track(first, 0.0)
    for number in range(1, 6):
        track.see(first, 0.08 * number)
    track.see(second, 0.48)
    assert associate([track], [third], 0.50) == [None]
    assert associate([track], [third], 0.80) == [0]


def test_clothes_of_two_people_differ() -> None:
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
