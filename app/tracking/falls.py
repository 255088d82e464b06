"""The probability that a person fell within the last seconds, from what their track showed.

A few small networks see boxes, postures and gaps to the border, resampled to a fixed grid, so that
they work at any frame rate. Those of the recent past see three seconds in detail; those with a long
memory see ten, ever coarser, and recognise a slow fall while the person lies. They were trained on
simulated tracks and rendered films by ``python -m scripts train-falls``. Lengths are in sizes of
the body in the picture, and left and right are not distinguished, so that neither the frame's size
nor mirroring it changes anything.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import NDArray

from app.estimation.results import Person
from app.networks.probabilities import MAX_STEP_S, LowPass, sigmoid
from app.networks.shipped import arrays_of
from app.vision.geometry import Box
from app.vision.judgement import FRAME_POSTURES
from app.vision.people import landmark_rows
from app.vision.truncation import gaps_to_border

MEMORIES = {
    "recent": np.arange(2.8, -0.1, -0.2),
    "long": np.array(
        [10, 8.5, 7.2, 6.2, 5.4, 4.6, 3.8, 3.2, 2.6, 2.2, 1.8, 1.4, 1.0, 0.8, 0.6, 0.4, 0.2, 0]
    ),
}  # fmt: skip
"""Seconds before a frame that the networks of each memory see, oldest first."""

WINDOW_S = float(MEMORIES["long"][0])
"""Time that the longest memory reaches back."""

# Frames closer together than this show the networks nothing more.
_MIN_STEP_S = 0.05

_HIPS = landmark_rows("hip")
_POSTURES = len(FRAME_POSTURES)
COLUMNS = 14 + _POSTURES
"""Inputs at each point; :func:`window_features` says which."""

# Distances beyond so many body sizes, and gaps to the border beyond one, say no more.
_FAR = 3.0


def observation(
    box: Box,
    frame_shape: tuple[int, ...],
    posture: NDArray[np.float64],
    right: float,
    hips_y: float | None = None,
    covered: float = 0.0,
) -> NDArray[np.float64]:
    """What a frame shows of a tracked person ``(17,)``; :func:`window_features` takes several.

    Parameters
    ----------
    box : Box
        Pixels of the frame of ``frame_shape``.
    posture : (6,) float64 array
        Probabilities of :data:`app.vision.judgement.FRAME_POSTURES`; less than 1 in sum where
        the window may show no person.
    right : float
        Probability that the landmarks are right.
    hips_y : float or None
        Pixels downwards; None where they are not seen.
    covered : float
        Share of the box that boxes of other people cover.
    """
    hips = box.y + 0.55 * box.height if hips_y is None else hips_y
    edges = (box.x, box.y, box.right, box.bottom, hips)
    return np.array([*edges, *posture, right, covered, *gaps_to_border(box, frame_shape)])


def observation_of(
    person: Person, frame_shape: tuple[int, ...], covered: float = 0.0
) -> NDArray[np.float64]:
    """The :func:`observation` of a person whose landmarks and posture were read."""
    if person.frame_posture is None or person.landmarks is None:
        raise ValueError("expected a person with landmarks and the posture of the frame")
    return observation(
        person.box,
        frame_shape,
        person.presence * np.asarray(person.frame_posture.probabilities),
        1.0 if person.trust is None else person.trust.right,
        float(person.landmarks.positions[_HIPS, 1].mean()),
        covered,
    )


def window_features(
    times: NDArray[np.float64],
    rows: NDArray[np.float64],
    now: float,
    grid_s: NDArray[np.float64],
    watched_from: float = math.inf,
) -> NDArray[np.float32]:
    """Inputs ``(D,)`` of a network at a time, from rows ``(K, 17)``, oldest first.

    The grid is one of :data:`MEMORIES`. The camera is watched from ``watched_from`` on, at the
    latest from the first row. At each point of the grid: the top, the bottom and the hips relative
    to those of the last row, the horizontal distance from its middle, width and height, six
    postures, right, covered, the gaps to the nearer side, the upper and the lower border, whether
    the person was still seen at that time, whether the track had begun, and whether the camera was
    watched.
    """
    grid = now - grid_s
    right = np.clip(np.searchsorted(times, grid), 1, max(len(times) - 1, 1))
    if len(times) == 1:
        at = np.repeat(rows, len(grid), axis=0)
    else:
        step = times[right] - times[right - 1]
        share = np.clip((grid - times[right - 1]) / np.maximum(step, 1e-6), 0, 1)[:, None]
        at = (1 - share) * rows[right - 1] + share * rows[right]
    last = rows[-1]
    width, height = at[:, 2] - at[:, 0], at[:, 3] - at[:, 1]
    size = max(float(np.median(np.maximum(width, height))), 1e-6)
    away = np.abs(at[:, 0] + at[:, 2] - last[0] - last[2]) / 2
    lengths = np.stack(
        [at[:, 1] - last[1], at[:, 3] - last[3], at[:, 4] - last[4], away, width, height], axis=1
    )
    gaps = np.stack([np.minimum(at[:, -4], at[:, -2]), at[:, -3], at[:, -1]], axis=1)
    inputs = np.concatenate(
        [
            np.clip(lengths / size, -_FAR, _FAR),
            at[:, 5 : 5 + _POSTURES],
            np.sqrt(at[:, 5 + _POSTURES : 6 + _POSTURES]),
            at[:, 6 + _POSTURES : 7 + _POSTURES],
            np.clip(gaps / size, 0, 1),
            (grid <= times[-1] + 1e-3)[:, None],
            (grid >= times[0] - 0.1)[:, None],
            (grid >= min(watched_from, times[0]) - 0.1)[:, None],
        ],
        axis=1,
    )
    return np.asarray(inputs.ravel(), np.float32)


_STRIDES = (1, 2)
"""Of the two convolutions, in points of the grid; each sees three points."""


@dataclass(frozen=True)
class FallModel:
    """The mean of a few networks with two convolutions over time and a hidden layer.

    Weights are ``(N, 3 D, H)``, ``(N, 3 H, G)``, ``(N, P / 2 G, K)`` and ``(N, K, 2)`` of ``N``
    networks and ``D`` inputs at each of the ``P`` points of the grid, one of :data:`MEMORIES`;
    offsets ``(N, H)``, ``(N, G)``, ``(N, K)`` and ``(N, 2)``. The answers of single networks differ
    by chance, the more so the less a track shows.
    """

    grid_s: NDArray[np.float64]
    weights: tuple[NDArray[np.float32], ...]
    offsets: tuple[NDArray[np.float32], ...]

    def __post_init__(self) -> None:
        networks = len(self.weights[0])
        sizes = [COLUMNS, *(offset.shape[-1] for offset in self.offsets)]
        points = -(-len(self.grid_s) // np.prod(_STRIDES))
        factors = [3, 3, int(points), 1]
        expected = [
            (networks, n * a, b) for n, (a, b) in zip(factors, pairwise(sizes), strict=False)
        ]
        got = [weight.shape for weight in self.weights]
        if len(sizes) != 5 or sizes[-1] != 2 or got != expected:
            raise ValueError(
                f"expected weights Nx{3 * COLUMNS}x... of two convolutions and two layers, "
                f"got {got}"
            )

    @classmethod
    def of(cls, arrays: Mapping[str, NDArray[np.generic]], memory: str) -> Self:
        """The networks of a memory in a file that ``python -m scripts train-falls`` wrote."""
        weights, offsets = (
            tuple(np.asarray(arrays[f"{memory}_{name}{row}"], np.float32) for row in range(4))
            for name in ("weights", "offsets")
        )
        return cls(MEMORIES[memory], weights, offsets)

    def probabilities(self, features: NDArray[np.float32]) -> NDArray[np.float64]:
        """Probabilities ``(..., 2)``: fell within the window and is down; the trunk is up now."""
        values = features.reshape(*features.shape[:-1], 1, len(self.grid_s), COLUMNS)
        for layer, stride in enumerate(_STRIDES):
            values = np.maximum(self._layer(layer, _three_points(values, stride)), 0)
        values = values.reshape(*values.shape[:-2], 1, -1)
        odds = self._layer(3, np.maximum(self._layer(2, values), 0))
        return sigmoid(np.asarray(odds[..., 0, :].mean(axis=-2), np.float64))

    def _layer(self, layer: int, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Outputs ``(..., N, P, b)`` of a layer of each network for ``(..., N or 1, P, a)``."""
        return np.asarray(values @ self.weights[layer] + self.offsets[layer][:, None])


def _three_points(values: NDArray[np.float32], stride: int) -> NDArray[np.float32]:
    """Each point's values ``(..., P, D)`` between those of its neighbours ``(..., Q, 3 D)``."""
    points = values.shape[-2]
    empty = np.zeros_like(values[..., :1, :])
    padded = np.concatenate([empty, values, empty], axis=-2)
    parts = [padded[..., first : first + points : stride, :] for first in range(3)]
    return np.concatenate(parts, axis=-1)


@cache
def shipped_models() -> tuple[FallModel, ...]:
    arrays = arrays_of("falls")
    return tuple(FallModel.of(arrays, memory) for memory in MEMORIES)


REPORTED_FROM, REPORTED_LOST_FROM = 0.5, 0.7
"""Low-pass filtered probability from which a fall is reported; and the unfiltered one of a person
who is lost, for which crowds mostly have other reasons.

Chosen on held-out simulated tracks, the first with a look at real films (docs/training.md).
"""

_UP_FROM = 0.5  # Probability that the trunk is up.


def _weighed(probability: float, factor: float) -> float:
    """The probability whose odds are those of another times a factor."""
    return probability * factor / (1 + (factor - 1) * probability)


class FallReport:
    """Says when a fall is to be reported: once, until the person is up again.

    Parameters
    ----------
    reported_from, lost_from : float
        Filtered probability from which a fall is reported; and the unfiltered one of a person who
        is lost.
    """

    def __init__(
        self, reported_from: float = REPORTED_FROM, lost_from: float = REPORTED_LOST_FROM
    ) -> None:
        self._reported_from, self._lost_from = reported_from, lost_from
        self._likely = LowPass()
        self._last_at: float | None = None
        self._up_since: float | None = None
        self.fallen = False
        """Whether a fall was reported and the person was not seen to get up."""

    def update(self, timestamp: float, fell: float, up: float, *, lost: bool = False) -> bool:
        """Add the probabilities of a frame; return whether a fall is to be reported now.

        In the frames in which a person is ``lost``, the probability is not filtered, since no other
        frame can confirm it, and nothing shows that the person is up.
        """
        elapsed = 0.0 if self._last_at is None else min(timestamp - self._last_at, MAX_STEP_S)
        self._last_at = timestamp
        likely = self._likely.update(fell, elapsed)
        if lost or up < _UP_FROM:
            self._up_since = None
        elif self._up_since is None:
            self._up_since = timestamp
        elif timestamp - self._up_since >= 1.0:
            self.fallen = False
        certain = fell >= self._lost_from if lost else likely >= self._reported_from
        if self.fallen or not certain:
            return False
        self.fallen = True
        return True


class FallWatch:
    """Watches one track for falls.

    Parameters
    ----------
    watched_from : float
        Time from which the camera is watched, seconds: whoever appears later was not always there.
        By default the camera is watched from the first frame of the track.
    """

    def __init__(self, watched_from: float = math.inf) -> None:
        self._watched_from = watched_from
        self._seen: deque[tuple[float, NDArray[np.float64]]] = deque()
        self.report = FallReport()
        self.probability = 0.0
        """Probability of the last frame that the person fell within the last seconds and is down.
        """

    def update(
        self,
        timestamp: float,
        row: NDArray[np.float64],
        *,
        rests: bool = False,
        floor_odds: float = 1.0,
    ) -> bool:
        """Add a frame of the track; return whether a fall is to be reported now.

        The row ``(17,)`` is an :func:`observation`. A person who ``rests``, in a zone for it, does
        not fall. The odds of a fall are multiplied by ``floor_odds``, those of
        :class:`app.tracking.floor.Rest`: a person who drops onto a bed has not fallen.
        """
        self._add(timestamp, row)
        self.probability, up = (0.0, 0.0) if rests else self._probabilities(timestamp)
        self.probability = _weighed(self.probability, floor_odds)
        return self.report.update(timestamp, self.probability, up)

    def _add(self, timestamp: float, row: NDArray[np.float64]) -> None:
        """Keep what a frame shows, and forget what the network does not see or need."""
        if len(self._seen) > 1 and timestamp - self._seen[-2][0] < _MIN_STEP_S:
            self._seen.pop()
        self._seen.append((timestamp, row))
        # The newest of those too old stays: the first point of the grid lies behind it.
        while len(self._seen) > 1 and self._seen[1][0] < timestamp - WINDOW_S:
            self._seen.popleft()

    def lost(self, timestamp: float) -> bool:
        """Whether a person who is not seen any more fell when they were lost."""
        if not self._seen:
            return False
        self.probability, up = self._probabilities(timestamp, lost=True)
        return self.report.update(timestamp, self.probability, up, lost=True)

    def _probabilities(self, timestamp: float, *, lost: bool = False) -> tuple[float, float]:
        times = np.array([time for time, _ in self._seen])
        rows = np.array([row for _, row in self._seen])
        recent, long = shipped_models()
        fell, up = recent.probabilities(self._window(times, rows, timestamp, recent)).tolist()
        # The long memory is asked only about people who are not up and whose landmarks were rather
        # right in the last second. Otherwise a parked car that is detected as a lying person is
        # reported as a fall in the end.
        trusted, slowly = rows[times > timestamp - 1.0, 5 + _POSTURES], 0.0
        if not lost and up < _UP_FROM and trusted.mean() >= 0.1:
            slowly, _ = long.probabilities(self._window(times, rows, timestamp, long)).tolist()
        # Two pieces of evidence: either memory may see the fall.
        return 1 - (1 - fell) * (1 - slowly), up

    def _window(
        self,
        times: NDArray[np.float64],
        rows: NDArray[np.float64],
        now: float,
        model: FallModel,
    ) -> NDArray[np.float32]:
        return window_features(times, rows, now, model.grid_s, self._watched_from)
