"""Where a person of a camera is, whether they have moved, and who hides them."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from app.estimation.results import Matched, Person
from app.scene import Patch
from app.vision.geometry import Box
from app.vision.halved import Frame

# Shares of the difference between prediction and observation that correct place, velocity, size.
_PLACE_GAIN, _VELOCITY_GAIN, _SIZE_GAIN = 0.7, 0.3, 0.3
# Time in which an unseen person's velocity falls to 1/e.
_DRIFT_S = 1.0


class BoxFilter:
    """Predicts a person's box, assuming a constant velocity.

    The place is the middle of the lower edge, where the person stands.
    """

    def __init__(self, box: Box, timestamp: float) -> None:
        self._place = box.foot
        self._size = np.array([box.width, box.height])
        self._timestamp = timestamp
        self.velocity = np.zeros(2)
        """Pixels a second, right and down."""
        self.seen = box
        """The last observed box."""

    def predict(self, timestamp: float) -> Box:
        """Box at a later time; it may lie outside the frame."""
        place = self._predicted_place(timestamp - self._timestamp)
        width, height = self._size.tolist()
        return Box(float(place[0]) - width / 2, float(place[1]) - height, width, height)

    def update(self, box: Box, timestamp: float, *, whole: bool) -> None:
        """Correct the prediction by an observed box; it shrinks only for a whole person."""
        elapsed = max(timestamp - self._timestamp, 1e-3)  # A frame sent again has the same time.
        predicted = self._predicted_place(elapsed)
        growth = np.array([box.width, box.height]) - self._size
        error = box.foot - predicted
        self._place = predicted + _PLACE_GAIN * error
        # The longer the gap, the more of the error is due to the velocity alone.
        gain = _VELOCITY_GAIN / elapsed if elapsed < 1 else 1 / elapsed
        self.velocity = self.velocity + gain * error
        growth = growth if whole else np.maximum(growth, 0)
        self._size = self._size + _SIZE_GAIN * growth
        self._timestamp = timestamp
        self.seen = box

    def _predicted_place(self, elapsed: float) -> NDArray[np.float64]:
        travel = _DRIFT_S * (1 - math.exp(-elapsed / _DRIFT_S))
        return np.asarray(self._place + travel * self.velocity)


PREDICTED_FOR_S = 2.0
"""Time for which the place of a hidden person is predicted."""


class Place(BoxFilter):
    """The place of one person, and what it looks like."""

    def __init__(self, person: Person, timestamp: float) -> None:
        super().__init__(person.box, timestamp)
        self.seen_at = timestamp
        """Time of the last sighting, seconds."""
        self.lies_at: Box | None = None
        """Where the person lies after a fall, once no longer visible; otherwise None."""
        self.hidden = False
        """Whether another person was at the expected place since the last sighting."""
        self._patch, self._rests_from = person.patch, -math.inf
        self._still, self._still_from = person.patch, timestamp
        self._compared_at = timestamp

    def see(self, person: Person, timestamp: float) -> None:
        """Note that the person is seen, whose box is added by :meth:`update`."""
        self.seen_at, self._patch = timestamp, person.patch
        self.lies_at, self.hidden = None, False

    def compare(self, person: Person, frame: Frame, covered: float, timestamp: float) -> None:
        """Keep the first picture since the person last changed; people in front do not count."""
        # Who looks the same for ten minutes is told from others by a look a second.
        if person.patch is None or covered > 0 or 0 < timestamp - self._compared_at < 1:
            return
        self._compared_at = timestamp
        if self._still is None or not self._still.is_shown_by(frame):
            self._still, self._still_from = person.patch, timestamp

    def still_s(self, timestamp: float) -> float | None:
        """Seconds for which the person has looked the same; None for less than ten minutes.

        After these, the picture may show a statue or a poster.
        """
        still_s = timestamp - self._still_from if self._still is not None else 0.0
        return still_s if still_s >= 600.0 else None

    def looks_the_same(self, frame: Frame, timestamp: float, *, falls: bool) -> bool:
        """Whether a frame shows the place of a person who is lost as when they were last seen.

        Who is lost while they fall comes to rest within two seconds.
        """
        if falls:
            self._rests_from = timestamp + 2.0
        if timestamp <= self._rests_from:
            self._patch = Patch.of(frame, self.seen)
        return self._patch is not None and self._patch.is_shown_by(frame)

    def covered_share(self, box: Box, others: Iterable[Place], timestamp: float) -> float:
        """Largest share of a box of the person that a single other person of this frame covers."""
        shares = (
            other.seen.intersection(box) / box.area
            for other in others
            if other is not self and other.seen_at == timestamp
        )
        return max(shares, default=0.0)

    def hidden_box(
        self, others: Iterable[Place], frame_shape: tuple[int, ...], timestamp: float
    ) -> Box | None:
        """Expected place of a hidden person; None if no other hides them, or after too long."""
        if timestamp - self.seen_at > PREDICTED_FOR_S:
            return None
        height, width = frame_shape[:2]
        box = self.predict(timestamp).clip(width, height)
        if box is None:
            return None
        places = (
            other.predict(timestamp)
            for other in others
            if other is not self and other.seen_at == timestamp
        )
        # Share of a person's box that another must cover to hide them.
        hides = any(other.intersection(box) >= 0.5 * box.area for other in places)
        return box if hides else None


# A person who has not moved for `_UNCHANGED_FOR_S` is estimated only every `_ESTIMATED_EVERY_S`. By
# then, a quick fall has been decided, and errors of several readings still average out.
_UNCHANGED_FOR_S, _ESTIMATED_EVERY_S = 3.0, 0.4


class LastEstimate:
    """A person as estimated last, and since when the picture of them has not changed."""

    def __init__(self, timestamp: float) -> None:
        self._person: Person | None = None
        self._estimated_at, self._moved_at = -math.inf, timestamp

    @property
    def outline_bytes(self) -> int:
        silhouette = self._person and self._person.silhouette
        return silhouette.crop.nbytes if silhouette else 0

    @property
    def matched(self) -> Matched | None:
        """What was found for the person's silhouette as drawn last."""
        return self._person.matched if self._person else None

    def update(self, person: Person, timestamp: float) -> None:
        if person is not self._person:
            self._person, self._estimated_at = person, timestamp

    def forget(self) -> None:
        """Have the person estimated anew in the next frame, even if nothing changes."""
        self._person = None

    def still_holds(self, frame: Frame, timestamp: float) -> Person | None:
        """The person, if the estimate still holds in a frame ``(H, W, 3)``.

        To be called with every frame. The estimate holds for a moment if nothing has changed at the
        person's place for a while.
        """
        person = self._person
        if person is None or person.source != "detector" or person.patch is None:
            return None
        if not person.patch.is_unchanged_in(frame):
            self._moved_at = timestamp
        lasts = timestamp - self._moved_at > _UNCHANGED_FOR_S
        return person if lasts and timestamp - self._estimated_at < _ESTIMATED_EVERY_S else None
