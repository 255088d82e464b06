"""Whether the view of a fixed camera is blocked: covered, out of focus, or turned away.

The mean of the pictures of the last minutes is the usual view. A view is blocked while few of its
edges remain, whatever hides them. In the dark, the view is unknown: a covered lens that gives a
black picture looks like a room without light.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from app.tracking.filtering import Hysteresis
from app.tracking.results import Event, EventState
from app.vision.geometry import Box

# Time over which the usual view is learned: a passer-by hardly changes it, the course of a day
# does, and a camera that stays turned gets a new view. At first, all frames have equal weight.
_LEARNED_S = 600.0
# Time until the view is known: films are often cut into shots of a few seconds, and the view of a
# handheld camera seldom lasts this long.
_KNOWN_AFTER_S = 10.0
# Time between two frames that are checked: a check costs milliseconds, and a blocked view lasts.
_LOOK_EVERY_S = 1.0
# Most time that a single frame counts for: too short to begin an event.
_MAX_STEP_S = 3.0
# Time constant of the evidence: a view has to be blocked for 3.5 s, longer than a person takes to
# pass close to the camera.
_SETTLING_S = 5.0

# The values below were chosen on four photographs and drawings. At least .34 of the edges remain if
# these are dimmed to an eighth, overexposed, or lit from one side or in the middle alone. At most
# .16 remain if they are blurred by 5 % of their height, covered, exchanged, or shifted by a third.

_BLOCKED_BELOW = 0.25
# Least difference between neighbouring cells at an edge, grey levels: the mean noise is below 1.
_MIN_EDGE = 3.0
# An edge belongs to the view from this mean agreement over the learning time. The edges of people
# walking over a plain floor do not last.
_LASTING = 0.7
# Share of its strength, relative to the local contrast, that an edge must keep; noise is no edge.
_KEPT_STRENGTH, _MIN_KEPT = 0.4, 0.75
# Local contrast is that within a quarter of the picture's height. It may fall to a quarter by less
# light or haze, and double.
_LOCAL_SHARE, _GAINS = 0.25, (0.5, 4.0)
# Level of a cell below which nothing shows.
_DARK_BELOW = 20.0
# Least share of cells with edges for a decision.
_MIN_EDGES = 0.02
# A picture with so few edges beside the usual view, as of a cover, is no view to learn.
_MIN_LEARNED = 0.25


class View:
    """Watches the view of one camera, frame by frame."""

    def __init__(self) -> None:
        self._usual: NDArray[np.float32] | None = None
        self._lasting: NDArray[np.float32] = np.zeros((0, 0), np.float32)
        self._known_s = 0.0
        self._last_at: float | None = None
        self._blocked = Hysteresis(_SETTLING_S)

    @property
    def obstructed(self) -> bool:
        """Whether the view is blocked."""
        return self._blocked.holds

    def update(
        self, timestamp: float, grey: NDArray[np.uint8], places: Sequence[Box] = ()
    ) -> list[Event]:
        """Add a frame's small grey picture ``(h, w)``; return the change, if any.

        ``places`` are the boxes of people in the picture, since people may hide the view. A picture
        of another size begins a new view.
        """
        elapsed = 0.0 if self._last_at is None else timestamp - self._last_at
        if 0 < elapsed < _LOOK_EVERY_S:
            return []
        step = min(max(0.0, elapsed), _MAX_STEP_S)
        self._last_at = timestamp
        if self._usual is None or self._usual.shape != grey.shape:
            self._usual, self._known_s = grey.astype(np.float32), 0.0
            self._lasting = np.zeros(grey.shape, np.float32)
        agreement = edge_agreement(self._usual, grey)
        blocked: bool | None = False
        if self._known_s >= _KNOWN_AFTER_S:
            blocked = self._is_blocked(self._usual, grey, agreement, places)
        self._learn(self._usual, grey, agreement, step, slowly=blocked is not False)
        if blocked is None:
            return []
        return self._events(timestamp, self._blocked.update(float(blocked), step))

    def end(self, timestamp: float) -> list[Event]:
        """End the watching of this view; return the end of the event, if it lasts."""
        return self._events(timestamp, "end" if self.obstructed else None)

    def unconfirmed(self) -> list[Event]:
        """The event that had begun to show at the last frame but was not certain."""
        shown = self._blocked.is_unconfirmed
        return self._events(self._last_at or 0.0, "unconfirmed" if shown else None)

    def _is_blocked(
        self,
        usual: NDArray[np.float32],
        grey: NDArray[np.uint8],
        agreement: NDArray[np.float32],
        places: Sequence[Box],
    ) -> bool | None:
        """Whether few of the lasting edges remain; None if too few edges could be visible."""
        strength = np.abs(_gradients(usual))
        counts = (strength >= _MIN_EDGE) & (self._lasting >= _LASTING) & (grey >= _DARK_BELOW)
        for left, top, right, bottom in (box.pixels() for box in places):
            counts[max(0, top) : max(0, bottom), max(0, left) : max(0, right)] = False
        if counts.mean() < _MIN_EDGES:
            return None
        return bool(np.average(agreement[counts], weights=strength[counts]) < _BLOCKED_BELOW)

    def _learn(
        self,
        usual: NDArray[np.float32],
        grey: NDArray[np.uint8],
        agreement: NDArray[np.float32],
        step: float,
        *,
        slowly: bool,
    ) -> None:
        if np.mean(_are_edges(grey)) < _MIN_LEARNED * np.mean(_are_edges(usual)):
            return
        if not slowly:
            self._known_s = min(self._known_s + step, _LEARNED_S)
        weight = step / max(_LEARNED_S if slowly else self._known_s, 1e-6)
        cv2.accumulateWeighted(grey, usual, weight)
        lit = (grey >= _DARK_BELOW).view(np.uint8)
        cv2.accumulateWeighted(agreement, self._lasting, weight, lit)

    def _events(self, timestamp: float, state: EventState | None) -> list[Event]:
        level = self._blocked.level
        return [Event("obstructed", state, timestamp, level)] if state else []


def edge_agreement(usual: NDArray[np.float32], grey: NDArray[np.uint8]) -> NDArray[np.float32]:
    """How well the edges of two pictures ``(h, w)`` agree in direction: for each cell, -1 to 1.

    Either side of an edge may be the brighter one. The agreement of edges that cross each other is
    negative, so over the edges of two different views it averages to about 0. It is 0 where a
    picture has no edge, or an edge that is weak for the contrast around it.
    """
    before, now = _gradients(usual), _gradients(grey)
    strength, left_of_it = np.abs(before), np.abs(now)
    gain = np.clip(_local_contrast(usual) / _local_contrast(grey), *_GAINS)
    seen = (left_of_it >= _MIN_KEPT) & (gain * left_of_it >= _KEPT_STRENGTH * strength)
    # The cosine of twice the angle between both.
    cosine = np.real((before * now.conj()) ** 2) / np.maximum((strength * left_of_it) ** 2, 1e-6)
    return np.asarray(seen * cosine, np.float32)


def _are_edges(grey: NDArray[np.float32] | NDArray[np.uint8]) -> NDArray[np.bool_]:
    return np.asarray(np.abs(_gradients(grey)) >= _MIN_EDGE)


def _gradients(grey: NDArray[np.float32] | NDArray[np.uint8]) -> NDArray[np.complex64]:
    """Differences between neighbours, as complex numbers ``(h, w)``: across + i down."""
    across, down = (
        cv2.Sobel(grey, cv2.CV_32F, *order, ksize=3, scale=1 / 8) for order in ((1, 0), (0, 1))
    )
    return np.asarray(across + 1j * down, np.complex64)


def _local_contrast(grey: NDArray[np.float32] | NDArray[np.uint8]) -> NDArray[np.float32]:
    """Standard deviation around each cell ``(h, w)``, at least .01."""
    size = (max(3, round(_LOCAL_SHARE * grey.shape[0])),) * 2
    mean = cv2.boxFilter(grey, cv2.CV_32F, size)
    variance = cv2.sqrBoxFilter(grey, cv2.CV_32F, size) - mean**2
    return np.asarray(np.sqrt(np.maximum(variance, 1e-4)), np.float32)
