"""The last estimate of a person, which stands while nothing moves."""

from __future__ import annotations

import math

from app.estimation.results import Matched, Person
from app.vision.halved import Frame

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
