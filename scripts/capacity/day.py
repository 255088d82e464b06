"""A day of cameras: how many see somebody, what they send, and how many replicas that takes.

The fleet is followed in steps of a minute. A few replicas, each with cameras that chance has given
it, are simulated frame by frame (:mod:`scripts.capacity.queueing`) and stand for all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.tracking.following import SEARCH_EVERY_S
from app.tracking.session import LONGEST_GAP_S
from scripts.capacity.coefficients import Coefficients
from scripts.capacity.queueing import Fate, serve

STEP_S = 60.0
STEPS = int(86400 / STEP_S)
HOURS = np.arange(STEPS) * STEP_S / 3600
IN_TIME_S = 1.0
JITTER_S = 0.02
"""Mean delay of a frame on its way, exponentially distributed."""
LEARNING = 1
"""Frames that a session searches as a whole until it knows who is there."""

UNEVENNESS = 0.03
"""Standard deviation of a replica's share of the circle of hashes; measured in haproxy.cfg."""

Series = NDArray[np.float64]


@dataclass(frozen=True)
class Load:
    """What the cameras do.

    Parameters
    ----------
    cameras : int
    frames_per_s : float
        Of a camera that sends; a whole number a minute.
    gated : bool
        Whether cameras send only while somebody is in view.
    people : float
        In a frame that shows anybody, on average.
    visit_s : float
        How long somebody stays in view, on average.
    bursts : int
        In a day: moments in which twice as many cameras see somebody, for ten minutes.
    """

    cameras: int = 100_000
    frames_per_s: float = 1.0
    gated: bool = False
    people: float = 2.0
    visit_s: float = 30.0
    bursts: int = 6

    def __post_init__(self) -> None:
        """Check the rate."""
        frames = self.frames_per_s * STEP_S
        if frames < 1 or abs(frames - round(frames)) > 1e-6:
            raise ValueError(f"expected a whole number of frames a minute, got {frames:g}")


@dataclass(frozen=True)
class Replicas:
    """A replica and how many of them there are.

    Parameters
    ----------
    cores : int
    queue : int
        Frames that may wait; the service bounds their wait, ``POSE_MAX_WAIT_S``, instead.
    memory_mb : float
        Limit of a replica with the index that ships.
    session_memory_mb : float
        ``POSE_CAMERA_MEMORY_MB``.
    max_sessions : int
        ``POSE_MAX_CAMERAS``.
    idle_s : float
        ``POSE_CAMERA_IDLE_S``.
    target : float
        Share of the cores in use that the autoscaler aims at.
    start_s, down_s : float
        Until a replica that is wanted serves; and how long one is kept that is no longer wanted.
    least : int
    entries : int
    index : str
        Size and kind of the index.
    """

    cores: int = 2
    queue: int = 2
    memory_mb: float = 1792.0
    session_memory_mb: float = 512.0
    max_sessions: int = 64
    idle_s: float = 300.0
    target: float = 0.6
    start_s: float = 120.0
    down_s: float = 600.0
    least: int = 2
    entries: int = 138_000
    index: str = "flat"


@dataclass(frozen=True)
class Day:
    """A day, minute by minute; arrays are ``(1440,)``.

    Parameters
    ----------
    busy : float64 array
        Share of cameras that see somebody.
    sent : float64 array
        Frames a second of all cameras.
    begun : float64 array
        Cameras that start afresh each second: after a pause, or on another replica.
    searched : float64 array
        Share of the frames that show somebody that are searched as a whole; all others are.
    cores : float64 array
        Cores that this work keeps busy.
    sessions : float64 array
    wanted : dict of str to int64 array
        Replicas that are needed for each resource: cores (at the autoscaler's target), memory of
        sessions, number of sessions.
    replicas : int64 array
        That serve.
    answered, in_time, refused, superseded : float64 array
        Shares of the frames of the simulated replicas; NaN where they got none.
    """

    busy: Series
    sent: Series
    begun: Series
    searched: Series
    cores: Series
    sessions: Series
    wanted: dict[str, NDArray[np.int64]]
    replicas: NDArray[np.int64]
    answered: Series
    in_time: Series
    refused: Series
    superseded: Series

    def overall(self, share: Series) -> float:
        """A share of all frames of the day, from that of each minute."""
        known = np.isfinite(share)
        return float((share * self.sent)[known].sum() / self.sent[known].sum())

    def core_hours(self, replicas: Replicas) -> float:
        """Cores paid for, whether busy or not."""
        return float(self.replicas.sum() * replicas.cores * STEP_S / 3600)

    def bottleneck(self) -> str:
        """Which resource asks for most replicas, for most of the day."""
        names = list(self.wanted)
        most = np.argmax([self.wanted[name] for name in names], axis=0)
        return names[int(np.bincount(most, minlength=len(names)).argmax())]


def busy_share(load: Load, rng: np.random.Generator) -> Series:
    """Share of cameras that see somebody: quiet nights, two rush hours, and bursts."""
    morning = 0.20 * np.exp(-0.5 * ((HOURS - 8.5) / 1.3) ** 2)
    midday = 0.14 * np.exp(-0.5 * ((HOURS - 13.0) / 2.5) ** 2)
    evening = 0.25 * np.exp(-0.5 * ((HOURS - 17.5) / 1.8) ** 2)
    share = 0.02 + morning + midday + evening
    for start in rng.integers(0, STEPS - 10, load.bursts):
        share[start : start + 10] *= 2
    return np.minimum(share, 0.95)


def visits(busy: Series, load: Load, idle_s: float) -> tuple[Series, Series]:
    """Share of gated cameras whose session is alive, and sessions that each begins a second.

    A camera sees nobody for exponentially distributed times between visits, whose mean follows from
    the share of time it sees somebody; a session outlives gaps of up to ``idle_s``. Every minute is
    taken for a steady state.

    Returns
    -------
    alive, begun : (1440,) float64 array
    """
    gap_s = load.visit_s * (1 - busy) / busy
    outlived = np.exp(-idle_s / gap_s)
    return busy + (1 - busy) * (1 - outlived), busy / load.visit_s * outlived


def autoscaled(wanted: NDArray[np.int64], replicas: Replicas) -> NDArray[np.int64]:
    """Replicas that serve: the most that were wanted of late, as of ``start_s`` ago."""
    delay, kept = round(replicas.start_s / STEP_S), round(replicas.down_s / STEP_S)
    before = np.concatenate([np.full(delay + kept, wanted[0]), wanted])
    windows = np.lib.stride_tricks.sliding_window_view(before, kept + 1)[: len(wanted)]
    most: NDArray[np.int64] = windows.max(axis=1)
    return np.maximum(most, replicas.least)


def simulate(
    load: Load, replicas: Replicas, costs: Coefficients, *, sample: int = 10, seed: int = 0
) -> Day:
    """Simulate a day.

    Parameters
    ----------
    load : Load
    replicas : Replicas
    costs : Coefficients
    sample : int
        Replicas that are simulated frame by frame.
    seed : int
    """
    busy = busy_share(load, np.random.default_rng(seed))
    if load.gated:
        alive, _ = visits(busy, load, replicas.idle_s)
        _, begun = visits(busy, load, LONGEST_GAP_S)
        quiet = 0.0
    else:
        alive, begun, quiet = np.ones(STEPS), np.zeros(STEPS), 1.0
    sessions = load.cameras * alive
    busy_rate = load.cameras * load.frames_per_s * busy
    quiet_rate = load.cameras * load.frames_per_s * (1 - busy) * quiet
    sent = busy_rate + quiet_rate
    first = np.minimum(load.cameras * begun * LEARNING / busy_rate, 1.0)
    searched = first + (1 - first) / math.ceil(SEARCH_EVERY_S * load.frames_per_s)
    search_ms = costs.larger_index_ms(replicas.index, replicas.entries)
    frame_ms = searched * costs.searched_ms + (1 - searched) * costs.warm_ms
    person_ms = searched * costs.searched_person_ms + (1 - searched) * costs.warm_person_ms
    busy_ms = frame_ms + load.people * (person_ms + search_ms)
    cores = (busy_rate * busy_ms + quiet_rate * costs.searched_ms) / 1000
    wanted = {
        "cores": _whole(cores / (replicas.cores * replicas.target)),
        "memory of sessions": _whole(sessions * costs.session_mb / replicas.session_memory_mb),
        "number of sessions": _whole(sessions / replicas.max_sessions),
    }
    served = autoscaled(np.max(list(wanted.values()), axis=0), replicas)
    # Cameras whose replica has come or gone start afresh.
    before = np.concatenate([served[:1], served[:-1]])
    moved = np.abs(served - before) / np.maximum(served, before)
    again = moved * sessions / STEP_S
    searched = np.minimum(searched + again * LEARNING / sent, 1.0)

    counts = np.zeros((4, STEPS))
    for number in range(sample):
        # The same luck in every variation, so that they can be compared.
        luck = np.random.default_rng((seed, number))
        counts += _one_replica(
            load,
            replicas,
            costs,
            luck,
            cameras=load.cameras / served,
            busy=busy,
            searched=searched,
        )
    arrived, answered, in_time, refused = counts
    superseded = arrived - answered - refused
    arrived[arrived == 0] = np.nan
    return Day(
        busy=busy,
        sent=sent,
        begun=load.cameras * begun + again,
        searched=searched,
        cores=cores,
        sessions=sessions,
        wanted=wanted,
        replicas=served,
        answered=answered / arrived,
        in_time=in_time / arrived,
        refused=refused / arrived,
        superseded=superseded / arrived,
    )


def _one_replica(
    load: Load,
    replicas: Replicas,
    costs: Coefficients,
    rng: np.random.Generator,
    *,
    cameras: Series,
    busy: Series,
    searched: Series,
) -> Series:
    """Simulate a replica frame by frame.

    Returns
    -------
    counts : (4, 1440) float64 array
        By the minute in which they came: frames, those answered, those in time, those refused.
    """
    # Its share of the circle of hashes, and chance.
    here = cameras * rng.normal(1, UNEVENNESS) + np.sqrt(cameras) * rng.normal()
    held = np.maximum(np.rint(here), 1).astype(np.int64)
    seeing = rng.binomial(held, busy)
    # Those that see somebody come first; each sends at regular times, at a moment of its own.
    sending = seeing if load.gated else held
    step = np.repeat(np.arange(STEPS), sending)
    camera = np.arange(len(step)) - np.repeat(np.cumsum(sending) - sending, sending)
    phase = rng.random(int(held.max()))[camera]
    frames = round(load.frames_per_s * STEP_S)
    ticks = (np.arange(frames) + phase[:, None]) / load.frames_per_s
    times = (step[:, None] * STEP_S + ticks + rng.exponential(JITTER_S, ticks.shape)).ravel()
    order = np.argsort(times)
    minute, name = (np.repeat(values, frames)[order] for values in (step, camera))
    times = times[order]
    people = 1 + rng.poisson(load.people - 1, len(minute))
    count = np.where(name < seeing[minute], people, 0)

    search_ms = costs.larger_index_ms(replicas.index, replicas.entries)
    # Where nobody is followed, the whole frame is searched for newcomers.
    whole = (count == 0) | (rng.random(len(minute)) < searched[minute])
    frame_ms = np.where(whole, costs.searched_ms, costs.warm_ms)
    person_ms = np.where(whole, costs.searched_person_ms, costs.warm_person_ms) + search_ms
    shape = 1 / costs.spread**2
    work_s = (frame_ms + person_ms * count) / 1000 * rng.gamma(shape, 1 / shape, len(minute))
    outcome = serve(times, work_s, name, cores=replicas.cores, queue=replicas.queue)
    return np.array(
        [
            np.bincount(minute[chosen], minlength=STEPS)
            for chosen in (
                slice(None),
                outcome.fates == Fate.ANSWERED,
                outcome.latencies_s <= IN_TIME_S,
                outcome.fates == Fate.REFUSED,
            )
        ],
        float,
    )


def _whole(replicas: Series) -> NDArray[np.int64]:
    return np.ceil(replicas).astype(np.int64)
