"""One replica, frame by frame: cores, a short queue, and newer frames that displace older ones."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray


class Fate(IntEnum):
    """What becomes of a frame."""

    ANSWERED = 0
    REFUSED = 1
    SUPERSEDED = 2


@dataclass(frozen=True)
class Outcome:
    """What became of the frames that a replica got.

    Parameters
    ----------
    fates : (N,) uint8 array
        Values of :class:`Fate`.
    latencies_s : (N,) float64 array
        From arrival to answer; NaN where a frame was not answered.
    """

    fates: NDArray[np.uint8]
    latencies_s: NDArray[np.float64]

    def count(self, fate: Fate) -> int:
        """Number of frames of a fate."""
        return int((self.fates == fate).sum())


def serve(
    arrivals_s: NDArray[np.float64],
    work_s: NDArray[np.float64],
    cameras: NDArray[np.int64],
    *,
    cores: int,
    queue: int,
) -> Outcome:
    """Serve frames in order of arrival, one on each core.

    As the service does it: a frame that finds all cores busy waits; where a frame of its camera
    waits already, it takes that one's place; where the queue is full, it is refused. The service
    also lets idle cores help with a frame's people, so it is sooner than this under light load.

    Parameters
    ----------
    arrivals_s : (N,) float64 array
        Ascending.
    work_s : (N,) float64 array
        Seconds of one core.
    cameras : (N,) int array
    cores : int
    queue : int
        Frames that may wait.
    """
    fates = np.zeros(len(arrivals_s), np.uint8)
    ends = np.full(len(arrivals_s), np.nan)
    running: list[float] = []
    # Waiting frames by camera, in the order of their turns: a dict keeps it when values change.
    waiting: dict[int, int] = {}
    work, names = work_s.tolist(), cameras.tolist()

    def start(frame: int, now: float) -> None:
        end = now + work[frame]
        heapq.heappush(running, end)
        ends[frame] = end

    def advance(now: float) -> None:
        while running and running[0] <= now:
            freed = heapq.heappop(running)
            if waiting:
                camera = next(iter(waiting))
                start(waiting.pop(camera), freed)

    for frame, now in enumerate(arrivals_s.tolist()):
        advance(now)
        camera = names[frame]
        if len(running) < cores:
            start(frame, now)
        elif camera in waiting:
            fates[waiting[camera]] = Fate.SUPERSEDED
            waiting[camera] = frame
        elif len(waiting) < queue:
            waiting[camera] = frame
        else:
            fates[frame] = Fate.REFUSED
    advance(np.inf)
    return Outcome(fates, ends - arrivals_s)
