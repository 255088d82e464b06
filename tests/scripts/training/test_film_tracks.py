"""Tracks and pairs of rendered films."""

from pathlib import Path

import numpy as np
import pytest

from app.vision.geometry import Box
from scripts.training.film_tracks import film_tracks
from scripts.training.identity_pairs import Pairs
from tests.app.tracking.test_track import at, walking

# Camera axes of a level camera: y points down.
DOWN = [0.0, 1.0, 0.0]


def written(folder: Path, tracks: list[list[float]], left: list[list[float]]) -> None:
    """A film of five frames of a person who stands and falls at 0.6 s."""
    joints = np.zeros((24, 3))
    joints[:, 1] = np.linspace(-1.6, 0, 24)
    rows = [[frame, 0, 400, 640, 480, *DOWN, *joints.ravel(), *np.full(17, np.nan)]
            for frame in range(5)]  # fmt: skip
    np.savez(folder / "film-0000.npz", rows=rows, tracks=tracks, left=np.array(left),
             fell=[0.6, 0.8], kind="fall-trip")  # fmt: skip


def row(frame: int, identity: int, person: int, x: float = 10) -> list[float]:
    """A row of a track: a box of 50 by 100 pixels."""
    return [frame, identity, person, x, 10, x + 50, 110, *np.zeros(13)]


def test_a_track_has_the_fall_of_its_person_and_those_of_others_have_none(tmp_path: Path) -> None:
    written(tmp_path, [row(0, 1, 0), row(1, 1, 0), row(1, 2, -1, 300)], [])
    first, thing = film_tracks(tmp_path)
    assert (first.falls, first.down, first.lost_at) == (0.6, 0.8, None)
    assert thing.falls == np.inf
    np.testing.assert_allclose(first.times, [0, 0.2])


@pytest.mark.parametrize(("x", "alone"), [(300, True), (30, False)])
def test_a_person_who_is_let_go_was_alone_if_nobody_is_where_they_were(
    tmp_path: Path, x: float, alone: bool
) -> None:
    written(tmp_path, [row(0, 1, 0), row(4, 2, 1, x)], [[1, 0.8]])
    first, _ = film_tracks(tmp_path)
    assert (first.lost_at, first.alone) == (0.8, alone)


def test_pairs_say_who_is_one_person_and_leave_out_whom_two_boxes_may_show() -> None:
    pairs, tracks = Pairs(), [walking(100, 0)]
    place = tracks[0].place.seen
    away = Box(place.x + 200, place.y, place.width, place.height)
    pairs.truth = {tracks[0].place.seen_at: [place, away], 2.0: [place, away]}
    pairs.add(tracks, [at(100), at(300)], 2.0, {0: tracks[0]})
    assert pairs.rows()[:, 0].tolist() == [1, 0]
    assert pairs.rows()[:, -1].tolist() == [1, 0]
    pairs.truth[2.0] = [place, place]
    pairs.add(tracks, [at(100)], 2.0, None)
    assert len(pairs.rows()) == 2
