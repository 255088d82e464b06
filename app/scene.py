"""What a fixed camera shows beside its people, from small grey pictures of its frames.

They answer three questions: whether anything has changed (:class:`Scene`), whether a person's place
is as it was (:class:`Patch`), and whether the view is blocked (:class:`View`). A cell is the mean
of many pixels and a change the mean over 3x3 cells, so that a sensor's noise of 4 levels becomes
less than one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from app.networks.probabilities import Change, Hysteresis
from app.vision.geometry import Box, crop, shrink_quickly
from app.vision.halved import HALF, Frame, seen_at
from app.vision.images import reduced_grey

# Grey levels from which a frame has changed, and from which a person has moved. In 60 rendered
# films (once, without a command), a person's picture changes by less in 78 % of pairs of frames in
# which no joint moves, and in 1.8 % of those in which one moves by a twentieth of the body; most of
# these are hidden.
_CHANGED_FROM, _MOVED_FROM = 5, 3


def _grey(pixels: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """A small grey picture ``(h, w)`` of BGR pixels."""
    small = shrink_quickly(pixels, width, height)
    return cv2.cvtColor(small, cv2.COLOR_BGR2GRAY).astype(np.uint8, copy=False)


def _changed(before: NDArray[np.uint8], now: NDArray[np.uint8], level: int) -> NDArray[np.bool_]:
    """The cells ``(h, w)`` of two pictures about which 3x3 cells differ by a level or more."""
    differences = cv2.subtract(now, before, dtype=cv2.CV_16S)
    sums = cv2.boxFilter(differences, cv2.CV_32S, (3, 3), normalize=False)
    return np.asarray(np.abs(sums) >= 9 * level)


@dataclass(frozen=True)
class Patch:
    """A small grey picture ``(16, 16)`` of a box, which is in pixels of the frame."""

    box: Box
    grey: NDArray[np.uint8]

    @classmethod
    def of(cls, frame: Frame, box: Box) -> Self:
        """The patch in a box of a frame ``(H, W, 3)``, BGR."""
        pixels, scale = seen_at(frame, HALF)
        # The same part of the frame, whether all of it is decoded or half.
        edges = (round(scale / HALF) * edge for edge in box.scaled(HALF).pixels())
        left, top, right, bottom = edges
        place = crop(pixels, (left, top, right - left, bottom - top))
        return cls(box, _grey(place, 16, 16))

    def is_shown_by(self, frame: Frame) -> bool:
        """Whether another frame shows the same in this box, perhaps in different light."""
        change = Patch.of(frame, self.box).grey.astype(np.float32) - self.grey
        # Up to this change of light and this mean difference besides, grey levels, it shows the
        # same: a person who leaves changes it by far more.
        light = np.clip(np.median(change), -15.0, 15.0)
        return bool(np.abs(change - light).mean() < 6.0)

    def is_unchanged_in(self, frame: Frame) -> bool:
        """Whether nothing in this box has changed in another frame, not even a hand."""
        return not _changed(self.grey, Patch.of(frame, self.box).grey, _MOVED_FROM).any()


# A scene is still after this time: a person may be missed in the frame in which they move.
_STILL_AFTER_S = 2.0

Places = Mapping[Any, tuple[Box, Box]]
"""Boxes of tracked people: as expected in a frame, and as last seen."""


class Scene:
    """What a camera shows around tracked people, compared with the last search's frame.

    Changes since then add up, so slow changes are noticed, too. The smallest person wanted is
    ``smallest_px`` high in a frame.
    """

    def __init__(self) -> None:
        self.now: NDArray[np.uint8] | None = None
        """The newest frame as a small grey picture ``(h, w)``; None before the first."""
        self._searched: NDArray[np.uint8] | None = None
        self._boxes: dict[Any, Box] = {}  # Where tracked people were at the last search.
        self._changed_at = self._still_at = -math.inf

    def is_still(self, frame: Frame, smallest_px: float, time: float, places: Places) -> bool:
        """Whether nothing has changed for a while; the first frame counts as a change."""
        scale, height, width = _small(frame.shape, smallest_px)
        self.now = now = _grey(seen_at(frame, scale)[0], width, height)
        # Tracks that have ended are dropped.
        self._boxes = {one: self._boxes.get(one, seen) for one, (_, seen) in places.items()}
        boxes = [*(expected for expected, _ in places.values()), *self._boxes.values()]
        if self._searched is None or self._differs(self._searched, now, scale, boxes):
            self._changed_at = time
        return self._is_still_at(time)

    def is_still_in_file(
        self, data: bytes, shape: tuple[int, ...], smallest_px: float, time: float
    ) -> bool:
        """The same without tracks, from a JPEG file; False also if the frame has to be decoded."""
        scale, height, width = _small(shape, smallest_px)
        if self._searched is None or time - self._changed_at < _STILL_AFTER_S:
            return False
        grey = reduced_grey(data, shape, (height, width))
        if grey is None:
            return False
        now = shrink_quickly(grey, width, height)
        return not self._differs(self._searched, now, scale, []) and self._is_still_at(time)

    def has_changed_since(self, time: float) -> bool:
        """Whether a later frame differed from the one that was searched."""
        return self._changed_at > time

    def has_just_changed(self, time: float) -> bool:
        """Whether the scene was still a moment ago."""
        # After this time, a person who has entered an empty, still scene is better visible.
        return time - self._still_at <= 1.0

    def _is_still_at(self, time: float) -> bool:
        still = time - self._changed_at >= _STILL_AFTER_S
        if still:
            self._still_at = time
        return still

    def restart(self) -> None:
        """Compare later frames with the present one, since it is searched."""
        self._searched, self._boxes = self.now, {}

    @staticmethod
    def _differs(
        before: NDArray[np.uint8], now: NDArray[np.uint8], scale: float, places: Sequence[Box]
    ) -> bool:
        """Whether two pictures ``(h, w)`` differ outside these boxes of the frame."""
        changed = _changed(before, now, _CHANGED_FROM).view(np.uint8)
        for box in (place.scaled(scale) for place in places):
            left, top, right, bottom = box.pixels()
            # Margin around tracked people, as a share of the larger side of their boxes.
            margin = 1 + round(0.1 * max(box.width, box.height))
            rows = slice(max(0, top - margin), max(0, bottom + margin))
            changed[rows, max(0, left - margin) : max(0, right + margin)] = 0
        _, _, areas, _ = cv2.connectedComponentsWithStats(changed)
        # A change is a connected area of at least this height, which includes a cell added on every
        # side: more than half of the smallest person, and more than the digits of a camera's clock.
        return bool((areas[1:, cv2.CC_STAT_HEIGHT] >= 7).any())


def _small(shape: tuple[int, ...], smallest_px: float) -> tuple[float, int, int]:
    """Scale, height and width of the small pictures of frames of a shape."""
    # The smallest person wanted is eight cells high.
    scale = min(1.0, 8 / smallest_px, 640 / max(shape))
    height, width = (max(1, round(side * scale)) for side in shape[:2])
    return scale, height, width


# Time over which the usual view is learned: a passer-by hardly changes it, the course of a day
# does, and a camera that stays turned gets a new view. At first, all frames have equal weight.
_LEARNED_S = 600.0
# Most time that a single frame counts for: too short to begin an event.
_MAX_STEP_S = 3.0
# Time constant of the evidence: a view has to be blocked for 3.5 s, longer than a person takes to
# pass close to the camera.
_SETTLING_S = 5.0

# The values below were chosen on four photographs and drawings. At least .34 of the edges remain if
# these are dimmed to an eighth, overexposed, or lit from one side or in the middle alone. At most
# .16 remain if they are blurred by 5 % of their height, covered, exchanged, or shifted by a third.

# Least difference between neighbouring cells at an edge, grey levels: the mean noise is below 1.
_MIN_EDGE = 3.0
# Level of a cell below which nothing shows.
_DARK_BELOW = 20.0


class View:
    """Watches whether the view of one camera is blocked: covered, out of focus, or turned away.

    The mean of the pictures of the last minutes is the usual view. A view is blocked while few of
    its edges remain, whatever hides them. In the dark, the view is unknown: a covered lens that
    gives a black picture looks like a room without light.
    """

    def __init__(self) -> None:
        self._usual: NDArray[np.float32] | None = None
        self._lasting: NDArray[np.float32] = np.zeros((0, 0), np.float32)
        self._known_s = 0.0
        self.last_at: float | None = None
        """Time of the last look, seconds."""
        self.blocked = Hysteresis(_SETTLING_S)

    def update(
        self, timestamp: float, grey: NDArray[np.uint8], places: Sequence[Box] = ()
    ) -> Change | None:
        """Add a frame's small grey picture ``(h, w)``; return the change, if any.

        ``places`` are the boxes of people in the picture, since people may hide the view. A picture
        of another size begins a new view.
        """
        elapsed = 0.0 if self.last_at is None else timestamp - self.last_at
        # Time between two frames that are checked: a check costs milliseconds, and a blocked view
        # lasts.
        if 0 < elapsed < 1.0:
            return None
        step = min(max(0.0, elapsed), _MAX_STEP_S)
        self.last_at = timestamp
        if self._usual is None or self._usual.shape != grey.shape:
            self._usual, self._known_s = grey.astype(np.float32), 0.0
            self._lasting = np.zeros(grey.shape, np.float32)
        agreement = edge_agreement(self._usual, grey)
        blocked: bool | None = False
        # Time until the view is known: films are often cut into shots of a few seconds, and the
        # view of a handheld camera seldom lasts this long.
        if self._known_s >= 10.0:
            blocked = self._is_blocked(self._usual, grey, agreement, places)
        self._learn(self._usual, grey, agreement, step, slowly=blocked is not False)
        return None if blocked is None else self.blocked.change(float(blocked), step)

    def _is_blocked(
        self,
        usual: NDArray[np.float32],
        grey: NDArray[np.uint8],
        agreement: NDArray[np.float32],
        places: Sequence[Box],
    ) -> bool | None:
        """Whether few of the lasting edges remain; None if too few edges could be visible."""
        strength = np.abs(_gradients(usual))
        # An edge belongs to the view from this mean agreement over the learning time. The edges of
        # people walking over a plain floor do not last.
        counts = (strength >= _MIN_EDGE) & (self._lasting >= 0.7) & (grey >= _DARK_BELOW)
        for left, top, right, bottom in (box.pixels() for box in places):
            counts[max(0, top) : max(0, bottom), max(0, left) : max(0, right)] = False
        # Least share of cells with edges for a decision.
        if counts.mean() < 0.02:
            return None
        return bool(np.average(agreement[counts], weights=strength[counts]) < 0.25)

    def _learn(
        self,
        usual: NDArray[np.float32],
        grey: NDArray[np.uint8],
        agreement: NDArray[np.float32],
        step: float,
        *,
        slowly: bool,
    ) -> None:
        # A picture with so few edges beside the usual view, as of a cover, is no view to learn.
        if np.mean(_are_edges(grey)) < 0.25 * np.mean(_are_edges(usual)):
            return
        if not slowly:
            self._known_s = min(self._known_s + step, _LEARNED_S)
        weight = step / max(_LEARNED_S if slowly else self._known_s, 1e-6)
        cv2.accumulateWeighted(grey, usual, weight)
        lit = (grey >= _DARK_BELOW).view(np.uint8)
        cv2.accumulateWeighted(agreement, self._lasting, weight, lit)


def edge_agreement(usual: NDArray[np.float32], grey: NDArray[np.uint8]) -> NDArray[np.float32]:
    """How well the edges of two pictures ``(h, w)`` agree in direction: for each cell, -1 to 1.

    Either side of an edge may be the brighter one. The agreement of edges that cross each other is
    negative, so over the edges of two different views it averages to about 0. It is 0 where a
    picture has no edge, or an edge that is weak for the contrast around it.
    """
    before, now = _gradients(usual), _gradients(grey)
    strength, left_of_it = np.abs(before), np.abs(now)
    # Local contrast may fall to a quarter by less light or haze, and double.
    gain = np.clip(_local_contrast(usual) / _local_contrast(grey), 0.5, 4.0)
    # An edge must keep this share of its strength; noise is no edge.
    seen = (left_of_it >= 0.75) & (gain * left_of_it >= 0.4 * strength)
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
    """Standard deviation within a quarter of the height of each cell ``(h, w)``, at least .01."""
    size = (max(3, round(0.25 * grey.shape[0])),) * 2
    mean = cv2.boxFilter(grey, cv2.CV_32F, size)
    variance = cv2.sqrBoxFilter(grey, cv2.CV_32F, size) - mean**2
    return np.asarray(np.sqrt(np.maximum(variance, 1e-4)), np.float32)
