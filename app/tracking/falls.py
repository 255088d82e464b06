"""The probability that a person fell within the last seconds, from what their track showed.

A small network sees three seconds of boxes, postures and gaps to the border, resampled to a fixed
grid, so that it works at any frame rate. It was trained on simulated tracks by
``python -m scripts train-falls``. Lengths are in sizes of the body in the picture, and left and
right are not told apart, so that neither the frame's size nor a mirror changes anything.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import Box
from app.vision.judgement import FRAME_POSTURES
from app.vision.odds import sigmoid
from app.vision.truncation import gaps_to_border

MODEL = Path(__file__).parent / "models" / "falls.npz"

WINDOW_S = 3.0
"""Time before a frame that the network sees."""

GRID_S = 0.2
"""Time between two points at which it sees it."""

_POINTS = round(WINDOW_S / GRID_S)
_POSTURES = len(FRAME_POSTURES)
COLUMNS = 13 + _POSTURES
"""Inputs at each point; :func:`window_features` says which."""

# Distances beyond so many body sizes, and gaps to the border beyond one, say no more.
_FAR = 3.0


@dataclass(frozen=True)
class Observation:
    """What a frame shows of a tracked person.

    Parameters
    ----------
    box : Box
        Pixels of the frame.
    frame_shape : tuple of int
        Rows and columns.
    posture : (6,) float64 array
        Probabilities of :data:`app.vision.judgement.FRAME_POSTURES`; less than 1 in sum where
        perhaps nobody is there.
    right : float
        Probability that the landmarks are right.
    hips_y : float or None
        Pixels downwards; None where they are not seen.
    covered : float
        Share of the box that boxes of other people cover.
    """

    box: Box
    frame_shape: tuple[int, ...]
    posture: NDArray[np.float64]
    right: float
    hips_y: float | None = None
    covered: float = 0.0

    def row(self) -> NDArray[np.float64]:
        """The same as numbers ``(17,)``, of which :func:`window_features` takes several."""
        box = self.box
        hips = box.y + 0.55 * box.height if self.hips_y is None else self.hips_y
        gaps = gaps_to_border(box, self.frame_shape)
        edges = (box.x, box.y, box.right, box.bottom, hips)
        return np.array([*edges, *self.posture, self.right, self.covered, *gaps])


def window_features(
    times: NDArray[np.float64], rows: NDArray[np.float64], now: float
) -> NDArray[np.float32]:
    """Inputs ``(D,)`` of the network at a time, from rows ``(K, 17)``, oldest first.

    At each point of the grid: the top, the bottom and the hips against those of the last row, the
    distance along the picture, width and height, six postures, right, covered, the gaps to the
    nearer side, the upper and the lower border, and whether the person was seen since then and
    known already.
    """
    grid = now + GRID_S * np.arange(1 - _POINTS, 1)
    right = np.clip(np.searchsorted(times, grid), 1, max(len(times) - 1, 1))
    if len(times) == 1:
        at = np.repeat(rows, _POINTS, axis=0)
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
            (grid >= times[0] - GRID_S / 2)[:, None],
        ],
        axis=1,
    )
    return np.asarray(inputs.ravel(), np.float32)


@dataclass(frozen=True)
class FallModel:
    """A network with two hidden layers.

    Parameters
    ----------
    weights : tuple of arrays
        ``(D, H)``, ``(H, G)``, ``(G, 2)``.
    offsets : tuple of arrays
        ``(H,)``, ``(G,)``, ``(2,)``.
    """

    weights: tuple[NDArray[np.float32], ...]
    offsets: tuple[NDArray[np.float32], ...]

    def __post_init__(self) -> None:
        sizes = [_POINTS * COLUMNS, *(len(offset) for offset in self.offsets)]
        expected = list(pairwise(sizes))
        got = [weight.shape for weight in self.weights]
        if sizes[-1] != 2 or got != expected:
            raise ValueError(
                f"expected weights {_POINTS * COLUMNS}x...x2 of consecutive layers, got {got}"
            )

    @classmethod
    def load(cls, file: Path = MODEL) -> Self:
        """Read what ``python -m scripts train-falls`` wrote."""
        with np.load(file) as arrays:
            layers = range(len(arrays.files) // 2)
            weights, offsets = (
                tuple(np.asarray(arrays[f"{name}{layer}"], np.float32) for layer in layers)
                for name in ("weights", "offsets")
            )
        return cls(weights, offsets)

    def probabilities(self, features: NDArray[np.float32]) -> NDArray[np.float64]:
        """Probabilities ``(..., 2)``: fell within the window and is down; the trunk is up now."""
        values = features
        for weight, offset in zip(self.weights[:-1], self.offsets[:-1], strict=True):
            values = np.maximum(values @ weight + offset, 0)
        odds = values @ self.weights[-1] + self.offsets[-1]
        return sigmoid(np.asarray(odds, np.float64))


@lru_cache(maxsize=1)
def shipped_model() -> FallModel:
    """The model that ships with the package."""
    return FallModel.load()


REPORTED_FROM = 0.8
"""Probability from which a fall is reported, once it has been as high for :data:`CERTAIN_S`.

On held-out simulated tracks, as many falls are found as by the rules before, with a quarter of the
false ones in homes and fewer in crowds (docs/training.md).
"""

CERTAIN_S = 0.4
"""Two frames at five a second: no single frame decides."""

# Probability that the trunk is up, and the time for which it must be as high, before another fall
# is reported.
_UP_FROM, _UP_S = 0.5, 1.0


class FallWatch:
    """Watches one track for falls; reports each once, until the person is up again."""

    def __init__(self, model: FallModel | None = None) -> None:
        self._model = shipped_model() if model is None else model
        self._seen: deque[tuple[float, NDArray[np.float64]]] = deque()
        self._likely_since: float | None = None
        self._up_since: float | None = None
        self.probability = 0.0
        """Probability that the person fell within the last seconds and is down."""
        self.fallen = False
        """Whether a fall was reported and the person was not seen to get up."""

    def update(self, timestamp: float, observation: Observation, *, rests: bool = False) -> bool:
        """Add a frame of the track; return whether a fall is to be reported now.

        Nobody falls who ``rests``, in a zone for it.
        """
        self.add(timestamp, observation.row())
        if rests:
            self.probability, self._likely_since = 0.0, None
            return False
        return self.decide(timestamp)

    def add(self, timestamp: float, row: NDArray[np.float64]) -> None:
        """Keep what a frame shows, and forget what the network does not see or need."""
        if len(self._seen) > 1 and timestamp - self._seen[-2][0] < GRID_S / 4:
            self._seen.pop()
        self._seen.append((timestamp, row))
        # The newest of those too old stays: the first point of the grid lies behind it.
        while len(self._seen) > 1 and self._seen[1][0] < timestamp - WINDOW_S:
            self._seen.popleft()

    def decide(self, timestamp: float) -> bool:
        """Whether a fall is to be reported after what was added."""
        return self._falls(timestamp, CERTAIN_S)

    def lost(self, timestamp: float) -> bool:
        """Whether a person who is not seen any more fell when they were lost."""
        return bool(self._seen) and not self.fallen and self._falls(timestamp, 0.0)

    def _falls(self, timestamp: float, certain_s: float) -> bool:
        times = np.array([time for time, _ in self._seen])
        rows = np.array([row for _, row in self._seen])
        fell, up = self._model.probabilities(window_features(times, rows, timestamp)).tolist()
        self.probability = fell
        self._likely_since = _since(self._likely_since, timestamp, fell >= REPORTED_FROM)
        self._up_since = _since(self._up_since, timestamp, up >= _UP_FROM)
        if self._up_since is not None and timestamp - self._up_since >= _UP_S:
            self.fallen = False
        likely = self._likely_since is not None and timestamp - self._likely_since >= certain_s
        if self.fallen or not likely:
            return False
        self.fallen = True
        return True


def _since(before: float | None, now: float, holds: bool) -> float | None:
    """Since when something holds, None while it does not."""
    return (now if before is None else before) if holds else None
