"""The model of falls on simulated tracks that it was not trained on, and what it must not see."""

import copy
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from app.estimation.results import Person
from app.networks.probabilities import logit
from app.networks.shipped import file_of
from app.tracking.falls import (
    COLUMNS,
    MEMORIES,
    REPORTED_FROM,
    WINDOW_S,
    FallModel,
    FallReport,
    FallWatch,
    observation,
    observation_of,
    shipped_models,
    window_features,
)
from app.vision.geometry import Box
from app.vision.judgement import FramePosture, Trust
from app.vision.people import Landmarks

TRACKS = Path(__file__).parents[2] / "data" / "fall_tracks.npz"
"""Held-out tracks that ``python -m scripts train-falls --examples`` wrote, 15 frames a second."""

FRAME = (480, 640)
STANDS, SITS, LIES = (np.eye(6)[row] for row in (0, 3, 5))


def seen(box: Box, posture: NDArray[np.float64], covered: float = 0.0) -> NDArray[np.float64]:
    return observation(box, FRAME, 0.9 * posture, 0.6, covered=covered)


def mixed(start: Box, end: Box, share: float) -> Box:
    first, last = (np.array([b.x, b.y, b.width, b.height]) for b in (start, end))
    return Box(*(first + share * (last - first)).tolist())


def reported(
    steps: list[tuple[Box, NDArray[np.float64], float]],
    fps: float,
    *,
    rests: bool = False,
    floor_odds: float = 1.0,
) -> list[float]:
    """Times at which a fall is reported: from step to step in so many seconds each."""
    watch, times, now = FallWatch(), [], 0.0
    for (start, before, _), (end, after, seconds) in pairwise([steps[0], *steps]):
        for frame in range(round(seconds * fps)):
            share = (frame + 1) / round(seconds * fps)
            posture = (1 - share) * before + share * after
            now += 1 / fps
            row = seen(mixed(start, end, share), posture)
            if watch.update(now, row, rests=rests, floor_odds=floor_odds):
                times.append(now)
    return times


UPRIGHT, ON_SEAT, DOWN = Box(300, 150, 70, 200), Box(295, 220, 80, 130), Box(240, 290, 190, 65)
FALL = [(UPRIGHT, STANDS, 3.0), (DOWN, LIES, 0.7), (DOWN, LIES, 3.0)]


@pytest.mark.parametrize("fps", [2, 5, 10, 15])
def test_a_fall_is_reported_once_and_soon(fps: float) -> None:
    (time,) = reported(FALL, fps)
    assert 3.3 < time < 5.5


def test_the_floor_speaks_for_a_fall_and_a_bed_against_it() -> None:
    (floor,), (unknown,) = reported(FALL, 15, floor_odds=4), reported(FALL, 15)
    assert floor < unknown < min([*reported(FALL, 15, floor_odds=1 / 4), np.inf])


@pytest.mark.parametrize("fps", [2, 5, 10, 15])
@pytest.mark.parametrize(
    "steps",
    [
        [(UPRIGHT, STANDS, 8.0)],
        [(UPRIGHT, STANDS, 3.0), (ON_SEAT, SITS, 0.8), (ON_SEAT, SITS, 4.0)],
        # Towards a high camera: the top sinks in the picture, the box grows.
        [(Box(310, 60, 30, 80), STANDS, 1.0), (Box(270, 170, 100, 260), STANDS, 5.0)],
        # Out of the frame at the lower border.
        [
            (Box(310, 60, 60, 180), STANDS, 3.0),
            (Box(280, 180, 110, 300), STANDS, 1.5),
            (Box(275, 420, 120, 60), STANDS, 1.0),
        ],
        # In bed all the time.
        [(DOWN, LIES, 9.0)],
    ],
)
def test_daily_life_is_no_fall(
    steps: list[tuple[Box, NDArray[np.float64], float]], fps: float
) -> None:
    assert reported(steps, fps) == []


def test_nobody_falls_in_a_zone_for_resting() -> None:
    assert reported(FALL, 5, rests=True) == []


def test_another_fall_is_reported_after_the_person_is_up_again() -> None:
    again = [*FALL, (UPRIGHT, STANDS, 2.0), (UPRIGHT, STANDS, 3.0), *FALL[1:]]
    assert len(reported(again, 5)) == 2


def test_a_person_who_is_lost_while_falling_fell_and_one_who_walks_out_did_not() -> None:
    def lost(steps: list[tuple[Box, NDArray[np.float64], float]]) -> bool:
        watch, now = FallWatch(), 0.0
        for (start, before, _), (end, after, seconds) in pairwise([steps[0], *steps]):
            for frame in range(round(5 * seconds)):
                share, now = (frame + 1) / round(5 * seconds), now + 0.2
                posture = (1 - share) * before + share * after
                assert not watch.update(now, seen(mixed(start, end, share), posture))
        return watch.lost(now + 2.0)  # As long as sessions look for who vanished.

    assert lost([(UPRIGHT, STANDS, 3.0), (DOWN, LIES, 0.8)])
    assert not lost([(UPRIGHT, STANDS, 3.0), (Box(570, 150, 70, 200), STANDS, 2.0)])
    assert not lost([(UPRIGHT, STANDS, 3.0)])


def test_a_person_who_is_lost_needs_a_higher_probability_but_no_second_frame() -> None:
    report = FallReport(reported_from=0.6, lost_from=0.7)
    assert not report.update(0.0, 0.65, 0.0)
    assert not report.update(0.2, 0.65, 0.0, lost=True)
    assert report.update(0.3, 0.75, 0.0, lost=True)
    assert not report.update(0.4, 0.99, 0.0, lost=True)  # Only once.


@pytest.mark.parametrize("fps", [5, 10, 30])
@pytest.mark.parametrize(("up_s", "again"), [(0.4, False), (0.8, False), (1.2, True)])
def test_only_who_is_up_for_a_second_may_fall_again(fps: float, up_s: float, again: bool) -> None:
    """A person on the ground who looks upright for a moment has raised the alarm already."""
    report, told, frame = FallReport(), 0, 0
    for _ in range(5):
        for seconds, fell, up in ((2.0, 0.9, 0.1), (up_s, 0.1, 0.9)):
            for _ in range(round(seconds * fps)):
                told += report.update(frame / fps, fell, up)
                frame += 1
    assert told == (5 if again else 1)


def test_who_is_not_seen_does_not_get_up() -> None:
    """No network was trained to say that of the unseen; only sightings count."""
    report = FallReport()
    assert report.update(0.0, 0.9, 0.1, lost=True)
    for frame in range(1, 50):
        assert not report.update(frame / 5, 0.9, 1.0, lost=True)
        assert report.fallen
    report.update(10.0, 0.1, 1.0)
    report.update(10.8, 0.1, 1.0)
    assert report.fallen
    report.update(11.1, 0.1, 1.0)
    assert not report.fallen


@pytest.mark.parametrize("fps", [0.5, 2, 5, 15])
def test_no_single_frame_reports_a_fall_and_certainty_does_so_soon(fps: float) -> None:
    def first(fell: list[float]) -> int | None:
        report = FallReport()
        told = [report.update(frame / fps, one, 0.0) for frame, one in enumerate([0.0, *fell])]
        return told.index(True) if True in told else None

    assert first([1.0, *[0.0] * 20]) is None
    assert first([REPORTED_FROM - 0.01] * 60) is None
    frames = first([1.0] * 20)
    assert frames is not None
    assert frames == 2 or frames <= round(0.6 * fps)


def test_a_probability_about_the_threshold_is_judged_by_its_mean() -> None:
    """Frames below the threshold between others above it do not begin the wait anew."""
    report = FallReport(reported_from=0.6)
    told = [report.update(0.2 * frame, 0.5 + 0.3 * (frame % 2), 0.0) for frame in range(20)]
    assert sum(told) == 1


def test_postures_of_a_doubtful_person_count_less() -> None:
    """Their shares sum to the probability that the window shows a person."""
    points = np.full((33, 2), 50.0)
    person = Person(
        UPRIGHT, "detector", 0.9, presence=0.4, trust=Trust(0.4, 0.2),
        landmarks=Landmarks(points, np.ones(33), np.zeros((33, 3))),
        frame_posture=FramePosture(STANDS),
    )  # fmt: skip
    row = observation_of(person, FRAME, 0.3)
    assert row[5:11] == pytest.approx(0.4 * STANDS)
    assert (row[4], row[11], row[12]) == (50, 0.2, 0.3)
    with pytest.raises(ValueError, match="expected a person with landmarks"):
        observation_of(Person(UPRIGHT, "detector", 0.9), FRAME)


@pytest.fixture(scope="module")
def tracks() -> list[tuple[NDArray[np.float64], NDArray[np.float64], float]]:
    """Times, rows and the time of the fall, infinite where nobody falls."""
    with np.load(TRACKS) as arrays:
        parts = np.split(np.arange(len(arrays["rows"])), np.cumsum(arrays["lengths"])[:-1])
        return [
            (arrays["times"][part], arrays["rows"][part].astype(np.float64), float(falls))
            for part, falls in zip(parts, arrays["falls"], strict=True)
        ]


def alarms(times: NDArray[np.float64], rows: NDArray[np.float64]) -> Iterator[float]:
    watch = FallWatch()
    for time, row in zip(times.tolist(), rows, strict=True):
        if watch.update(time, row):
            yield time


@pytest.mark.parametrize(("step", "least"), [(1, 0.65), (3, 0.6), (7, 0.55)])
def test_most_simulated_falls_are_reported_at_any_rate_and_hardly_anything_else(
    tracks: list[tuple[NDArray[np.float64], NDArray[np.float64], float]], step: int, least: float
) -> None:
    found = false = 0
    for times, rows, fell in tracks:
        told = list(alarms(times[::step], rows[::step]))
        found += any(time >= fell for time in told)
        false += any(time < fell for time in told)
    assert found >= least * sum(np.isfinite(fell) for _, _, fell in tracks)
    assert false <= 0.05 * len(tracks)


def test_simulated_people_who_fell_stay_down_once_they_are_lost(
    tracks: list[tuple[NDArray[np.float64], NDArray[np.float64], float]],
) -> None:
    fallen = 0
    for times, rows, _ in tracks[::2]:
        watch = FallWatch()
        for number, (time, row) in enumerate(zip(times.tolist(), rows, strict=True)):
            watch.update(time, row)
            if number % 9 or not watch.report.fallen:
                continue
            fallen, lost = fallen + 1, copy.deepcopy(watch)
            for step in range(10, 40):
                lost.lost(time + step / 5)
                assert lost.report.fallen
    assert fallen > 30


def test_neither_the_size_of_the_frame_nor_a_mirror_changes_anything() -> None:
    generator = np.random.default_rng(1)
    times = np.cumsum(generator.uniform(0.1, 0.4, 20))

    def features(scale: float, mirror: bool) -> NDArray[np.float32]:
        draw, rows = np.random.default_rng(2), []
        for _ in times:
            x, y, width, height = draw.uniform([0, 0, 20, 40], [500, 300, 140, 180])
            x = 640 - x - width - 1 if mirror else x
            corner = scale * (x + 0.5) - 0.5, scale * (y + 0.5) - 0.5
            box = Box(*corner, scale * width, scale * height)
            shape = (round(480 * scale), round(640 * scale))
            rows.append(observation(box, shape, draw.dirichlet(np.ones(6)), 0.5))
        return window_features(times, np.array(rows), float(times[-1]), MEMORIES["long"])

    plain = features(1.0, False)
    np.testing.assert_allclose(features(2.0, False), plain, atol=0.01)
    np.testing.assert_allclose(features(1.0, True), plain, atol=1e-5)


@pytest.mark.parametrize("grid_s", MEMORIES.values(), ids=MEMORIES)
def test_only_the_window_counts(grid_s: NDArray[np.float64]) -> None:
    rows = np.random.default_rng(3).uniform(0, 300, (90, 17))
    times = np.arange(90) * 0.2
    whole = window_features(times, rows, times[-1], grid_s, 0.0)
    recent = times >= times[-1] - grid_s[0] - 0.21
    short = window_features(times[recent], rows[recent], times[-1], grid_s, 0.0)
    np.testing.assert_array_equal(short, whole)


def test_a_person_who_appears_later_was_not_always_there() -> None:
    """The networks see how long the camera was watched before somebody was found."""
    rows, times = np.tile(seen(DOWN, LIES), (5, 1)), np.arange(5) * 0.2
    for grid_s in MEMORIES.values():
        at_once = window_features(times, rows, 0.8, grid_s).reshape(-1, COLUMNS)
        later = window_features(times, rows, 0.8, grid_s, -20.0).reshape(-1, COLUMNS)
        np.testing.assert_array_equal(at_once[:, -1], at_once[:, -2])
        assert later[:, -1].all() and not later[0, -2]


def test_a_slow_descent_is_remembered_while_the_person_lies() -> None:
    """By way of the knees, over four seconds: longer than the recent memory."""
    kneels = Box(290, 230, 90, 125)
    steps = [
        (UPRIGHT, STANDS, 3.0),
        (kneels, np.eye(6)[2], 1.2),
        (kneels, np.eye(6)[4], 1.0),
        (DOWN, LIES, 1.2),
        (DOWN, LIES, 5.0),
    ]
    assert len(reported(steps, 5)) == 1


def test_a_watch_forgets_what_is_older_than_its_window() -> None:
    watch = FallWatch()
    for frame in range(300):
        watch.update(frame / 15, seen(UPRIGHT, STANDS))
    assert len(watch._seen) <= 15 * WINDOW_S + 2


def test_the_models_are_small_and_arrays_of_another_shape_are_refused() -> None:
    assert file_of("falls").stat().st_size < 350_000
    for model in shipped_models():
        assert sum(map(np.size, model.weights)) < 3 * 32_000
        wrong = tuple(weight[:, : COLUMNS + 1] for weight in model.weights)
        with pytest.raises(ValueError, match="expected weights Nx60x"):
            FallModel(model.grid_s, wrong, model.offsets)


@pytest.mark.parametrize("model", shipped_models(), ids=MEMORIES)
def test_the_model_gives_the_mean_of_its_networks(model: FallModel) -> None:
    size = len(model.grid_s) * COLUMNS
    windows = np.random.default_rng(4).uniform(-1, 1, (5, size)).astype(np.float32)
    single = [
        FallModel(
            model.grid_s,
            tuple(weight[[number]] for weight in model.weights),
            tuple(offset[[number]] for offset in model.offsets),
        )
        for number in range(len(model.weights[0]))
    ]
    assert len(single) == 3
    odds = np.mean([logit(one.probabilities(windows), 1e-9) for one in single], axis=0)
    np.testing.assert_allclose(logit(model.probabilities(windows), 1e-9), odds, atol=1e-4)
    np.testing.assert_allclose(
        model.probabilities(windows[0]), model.probabilities(windows)[0], atol=1e-6
    )
