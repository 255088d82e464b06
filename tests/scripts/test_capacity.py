"""The model of capacity against closed forms, and what it conserves."""

from __future__ import annotations

import json
import math
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.settings import Settings
from app.tracking.following import SEARCH_EVERY_S
from scripts import simulate_load
from scripts.capacity.coefficients import PATH, Coefficients, read_coefficients
from scripts.capacity.day import STEPS, Load, Replicas, autoscaled, simulate, visits
from scripts.capacity.queueing import Fate, Outcome, serve
from tests.conftest import ROOT
from tests.deploy.test_kubernetes import REPLICAS, VALUES, container, mebibytes

COSTS = Coefficients(
    pose_ms=2500.0,
    pose_person_ms=600.0,
    searched_ms=400.0,
    searched_person_ms=100.0,
    warm_ms=200.0,
    warm_person_ms=50.0,
    mask_ms=50.0,
    spread=0.2,
    resident_mb=400.0,
    session_mb=2.0,
    index_entry_bytes=600.0,
    index_entries=138_000,
    frame_kb=60.0,
    search_ms={"flat": ((138_000, 2.0),), "hnsw": ((1_000_000, 1.0), (10_000_000, 3.0)), "ivf": ()},
)
SMALL = Load(cameras=100)


def poisson_queue(rate: float, servers: int, queue: int, frames: int = 200_000) -> Outcome:
    """Frames of as many cameras at random times, with exponential work of one second on average."""
    rng = np.random.default_rng(0)
    arrivals = np.cumsum(rng.exponential(1 / rate, frames))
    work = rng.exponential(1.0, frames)
    return serve(arrivals, work, np.arange(frames), cores=servers, queue=queue)


def state_probabilities(rate: float, servers: int, places: int) -> list[float]:
    """Probabilities of 0 to ``places`` customers in M/M/c/K, work of one second on average."""
    weights = [1.0]
    for number in range(1, places + 1):
        weights.append(weights[-1] * rate / min(number, servers))
    return [weight / sum(weights) for weight in weights]


class TestQueue:
    @pytest.mark.parametrize(("rate", "servers"), [(0.7, 1), (1.5, 2), (3.2, 4)])
    def test_waits_as_erlang_c_says(self, rate: float, servers: int) -> None:
        outcome = poisson_queue(rate, servers, queue=10**9)
        wait = state_probabilities(rate, servers, 400)
        erlang_c = sum(wait[servers:])
        expected_s = 1 + erlang_c / (servers - rate)
        assert outcome.count(Fate.ANSWERED) == len(outcome.fates)
        assert outcome.latencies_s.mean() == pytest.approx(expected_s, rel=0.04)

    @pytest.mark.parametrize(("rate", "servers", "queue"), [(0.9, 1, 0), (1.6, 2, 2), (5.0, 2, 2)])
    def test_refuses_as_a_queue_with_few_places_does(
        self, rate: float, servers: int, queue: int
    ) -> None:
        outcome = poisson_queue(rate, servers, queue)
        states = state_probabilities(rate, servers, servers + queue)
        assert outcome.fates.mean() == pytest.approx(states[-1], abs=0.006)
        # Little's law over those let in.
        inside = sum(number * share for number, share in enumerate(states))
        assert np.nanmean(outcome.latencies_s) == pytest.approx(
            inside / (rate * (1 - states[-1])), rel=0.02
        )

    def test_regular_frames_that_there_is_time_for_never_wait(self) -> None:
        frames = 1000
        outcome = serve(
            np.arange(frames) * 0.5, np.full(frames, 0.99), np.arange(frames), cores=2, queue=0
        )
        assert outcome.latencies_s == pytest.approx(np.full(frames, 0.99))

    def test_of_twice_too_many_regular_frames_half_are_refused(self) -> None:
        frames = 10_000
        outcome = serve(
            np.arange(frames) * 0.5, np.ones(frames), np.arange(frames), cores=1, queue=2
        )
        assert outcome.count(Fate.REFUSED) / frames == pytest.approx(0.5, abs=0.001)
        # Behind two frames that wait and one that has just begun or is half done.
        assert np.nanmax(outcome.latencies_s) <= 3.0

    def test_one_camera_that_is_too_fast_displaces_its_own_frames_alone(self) -> None:
        frames = 1000
        outcome = serve(
            np.arange(frames) * 0.1, np.ones(frames), np.zeros(frames, int), cores=1, queue=2
        )
        assert outcome.count(Fate.REFUSED) == 0
        assert outcome.count(Fate.SUPERSEDED) / frames == pytest.approx(0.9, abs=0.01)
        # What is answered is what the camera sent last before its turn.
        assert np.nanmax(outcome.latencies_s) <= 1.1 + 1e-9

    def test_a_newer_frame_keeps_the_turn_of_the_older(self) -> None:
        #          works   a waits  b waits  a again
        arrivals = np.array([0.0, 0.1, 0.2, 0.3])
        outcome = serve(arrivals, np.ones(4), np.array([9, 0, 1, 0]), cores=1, queue=2)
        assert outcome.fates.tolist() == [0, Fate.SUPERSEDED, 0, 0]
        assert outcome.latencies_s[[0, 2, 3]].tolist() == pytest.approx([1.0, 2.8, 1.7])

    @given(
        st.lists(
            st.tuples(st.floats(0, 2), st.floats(0.01, 3), st.integers(0, 3)),
            min_size=1, max_size=60,
        ),
        st.integers(1, 3),
        st.integers(0, 3),
    )  # fmt: skip
    def test_no_frame_is_lost_and_no_core_does_two_things(
        self, frames: list[tuple[float, float, int]], cores: int, queue: int
    ) -> None:
        gaps, work, cameras = map(np.array, zip(*frames, strict=True))
        arrivals = np.cumsum(gaps)
        outcome = serve(arrivals, work, cameras, cores=cores, queue=queue)
        answered = outcome.fates == Fate.ANSWERED
        assert sum(map(outcome.count, Fate)) == len(frames)
        assert np.isfinite(outcome.latencies_s).tolist() == answered.tolist()
        ends = (arrivals + outcome.latencies_s)[answered]
        begins = ends - work[answered]
        assert (begins >= arrivals[answered] - 1e-9).all()
        for moment in begins:
            assert ((begins <= moment) & (moment < ends - 1e-9)).sum() <= cores


class TestFleet:
    def test_replicas_come_late_and_go_later(self) -> None:
        wanted = np.full(100, 10)
        wanted[20:30] = 50
        served = autoscaled(wanted, Replicas(start_s=120, down_s=600))
        assert served.tolist() == [10] * 22 + [50] * 20 + [10] * 58

    def test_a_few_are_always_there(self) -> None:
        assert autoscaled(np.ones(5, np.int64), Replicas(least=3)).tolist() == [3] * 5

    def test_sessions_follow_visits(self) -> None:
        rng = np.random.default_rng(0)
        share, visit_s, idle_s, visits_made = 0.1, 30.0, 300.0, 100_000
        seen = rng.exponential(visit_s, visits_made)
        gaps = rng.exponential(visit_s * (1 - share) / share, visits_made)
        alive, begun = visits(np.array([share]), Load(visit_s=visit_s), idle_s)
        total = seen.sum() + gaps.sum()
        assert alive[0] == pytest.approx((seen + np.minimum(gaps, idle_s)).sum() / total, rel=0.01)
        assert begun[0] == pytest.approx((gaps > idle_s).sum() / total, rel=0.02)

    @pytest.mark.parametrize("gated", [False, True])
    def test_every_frame_of_the_day_has_a_fate(self, gated: bool) -> None:
        day = simulate(replace(SMALL, gated=gated), Replicas(), COSTS, sample=2)
        known = np.isfinite(day.answered)
        assert known.mean() > 0.9
        fates = (day.answered + day.refused + day.superseded)[known]
        assert fates == pytest.approx(np.ones(len(fates)))
        assert (day.in_time <= day.answered)[known].all()
        assert ((day.searched > 0) & (day.searched <= 1)).all()
        sent = SMALL.cameras * SMALL.frames_per_s * (day.busy if gated else 1)
        assert day.sent == pytest.approx(sent * np.ones(STEPS))

    def test_cores_kept_busy_are_frames_times_their_cost(self) -> None:
        load = replace(SMALL, bursts=0, frames_per_s=2 / SEARCH_EVERY_S)
        day = simulate(load, Replicas(), COSTS, sample=1)
        # Of frames that show somebody every other is searched as a whole, of others each.
        frame_ms = (COSTS.searched_ms + COSTS.warm_ms) / 2
        person_ms = (COSTS.searched_person_ms + COSTS.warm_person_ms) / 2
        busy_ms = frame_ms + person_ms * load.people
        each_ms = day.busy * busy_ms + (1 - day.busy) * COSTS.searched_ms
        assert day.cores == pytest.approx(load.cameras * load.frames_per_s * each_ms / 1000)
        wanted = np.ceil(day.cores / (2 * 0.6))
        assert day.wanted["cores"].tolist() == wanted.tolist()
        assert day.core_hours(Replicas()) == 2 * day.replicas.sum() / 60

    def test_gating_saves_cores_and_costs_cold_frames(self) -> None:
        load = replace(SMALL, frames_per_s=2 / SEARCH_EVERY_S)
        all_the_time = simulate(load, Replicas(), COSTS, sample=1)
        gated = simulate(replace(load, gated=True), Replicas(), COSTS, sample=1)
        assert gated.cores.sum() < all_the_time.cores.sum() / 2
        assert gated.begun.sum() > all_the_time.begun.sum()
        assert gated.searched.mean() > all_the_time.searched.mean()

    def test_a_rate_that_is_no_whole_number_a_minute_is_refused(self) -> None:
        with pytest.raises(ValueError, match="whole number"):
            Load(frames_per_s=0.99)

    def test_too_few_cores_show(self) -> None:
        calm = simulate(SMALL, Replicas(target=0.3), COSTS, sample=2)
        pressed = simulate(SMALL, Replicas(target=2.0), COSTS, sample=2)
        assert calm.overall(calm.in_time) > 0.98
        assert pressed.overall(pressed.refused + pressed.superseded) > 0.2

    @pytest.mark.parametrize(
        ("replicas", "expected"),
        [
            (Replicas(), "cores"),
            (Replicas(session_memory_mb=3), "memory of sessions"),
            (Replicas(max_sessions=1), "number of sessions"),
        ],
    )
    def test_the_scarcest_resource_is_named(self, replicas: Replicas, expected: str) -> None:
        day = simulate(SMALL, replicas, COSTS, sample=1)
        assert day.bottleneck() == expected
        assert (day.replicas >= day.wanted[expected].min()).all()

    def test_a_replica_is_what_the_manifests_say(self) -> None:
        replicas, limits = Replicas(), container(REPLICAS)["resources"]["limits"]
        settings = {name: field.default for name, field in Settings.model_fields.items()}
        assert replicas.cores == int(limits["cpu"])
        assert replicas.memory_mb == mebibytes(limits["memory"])
        assert replicas.session_memory_mb == float(VALUES["POSE_CAMERA_MEMORY_MB"] or 0)
        assert replicas.max_sessions == settings["max_cameras"]
        assert replicas.idle_s == settings["camera_idle_s"]


class TestCoefficients:
    def test_each_number_has_a_source(self) -> None:
        found = json.loads(PATH.read_text())
        for name, entry in found.items():
            assert set(entry) == {"value", "unit", "command", "page"}, name
            assert (ROOT / entry["page"]).is_file(), name
            module = entry["command"].split()[2]
            assert (ROOT / f"{module.replace('.', '/')}.py").is_file(), name
        assert read_coefficients().warm_ms > 0

    def test_a_missing_number_is_named(self, tmp_path: Path) -> None:
        found = json.loads(PATH.read_text())
        del found["session_mb"]
        path = tmp_path / "coefficients.json"
        path.write_text(json.dumps(found))
        with pytest.raises(ValueError, match="session_mb"):
            read_coefficients(path)

    def test_searches_lie_between_those_measured(self) -> None:
        assert COSTS.search("flat", 1_380_000) == pytest.approx(20)
        assert COSTS.search("hnsw", 1_000_000) == pytest.approx(1)
        middle = COSTS.search("hnsw", round(math.sqrt(1e6 * 1e7)))
        assert middle == pytest.approx(math.sqrt(3), rel=1e-3)
        assert COSTS.larger_index_ms("flat", 138_000) == 0

    @pytest.mark.parametrize(("kind", "entries"), [("ivf", 10), ("tree", 10), ("hnsw", 10**9)])
    def test_a_search_that_nobody_measured_is_not_guessed(self, kind: str, entries: int) -> None:
        with pytest.raises(ValueError, match=kind):
            COSTS.search(kind, entries)

    def test_a_larger_index_takes_memory(self) -> None:
        assert COSTS.process_mb(1_138_000) == pytest.approx(1000)


def test_the_command_writes_page_figures_and_plot(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="needs the evaluate extra")
    arguments = ["--cameras", "60", "--rate", "0.1", "--sample", "1", "--price", "0.5", "--write"]
    simulate_load.main([*arguments, "--out", str(tmp_path)])
    assert Counter(path.name for path in tmp_path.iterdir()) == Counter(
        ["load-day.md", "load-day.json", "load-day.png"]
    )
    found = json.loads((tmp_path / "load-day.json").read_text())
    for day in found["days"].values():
        assert day["cost"] == pytest.approx(day["core_hours"] * 0.5)
        fates = day["answered"] + day["refused"] + day["superseded"]
        assert fates == pytest.approx(1)


def test_a_kind_of_index_that_nobody_measured_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="expected a kind of index"):
        simulate_load.main(["--index", "tree", "--out", str(tmp_path)])
