"""Pairs of known people and those of a frame, as a camera session compares them in a film."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app import camera
from app.estimation.results import Person
from app.tracking.track import Track, associate
from app.vision.geometry import Box

_MIN_IOU, _MARGIN = 0.15, 0.1


class Pairs:
    """Records the pairs of a film; ``truth`` has each person's true box at each time."""

    def __init__(self) -> None:
        self.truth: dict[float, list[Box]] = {}
        self._rows: list[NDArray[np.float64]] = []

    def rows(self) -> NDArray[np.float64]:
        """Per pair, whether both are one person, and :meth:`KnownPerson.features`."""
        return np.array(self._rows)

    def add(
        self,
        tracks: Sequence[Track],
        people: Sequence[Person],
        timestamp: float,
        in_window: Mapping[int, Track] | None,
    ) -> None:
        """Add the pairs of a frame; those of unknown people are left out."""
        shown = in_window or {}
        for track in tracks:
            who = self._who(track.place.seen, track.place.seen_at)
            known = track.known(timestamp)
            for column, person in enumerate(people):
                other = self._who(person.box, timestamp)
                if who is None or other is None or (who == other == -1):
                    continue
                features = known.features(
                    person.box, person.colours, in_window=shown.get(column) is track
                )
                self._rows.append(np.array([who == other, *features]))

    def _who(self, box: Box, timestamp: float) -> int | None:
        """The person whom a box shows, -1 for nobody, None where two are as likely."""
        overlaps = [true.iou(box) for true in self.truth.get(timestamp, [])]
        best = max(overlaps, default=0.0)
        if best < _MIN_IOU:
            return -1
        if sum(one > best - _MARGIN for one in overlaps) > 1:
            return None
        return overlaps.index(best)


@contextmanager
def recorded_pairs() -> Iterator[Pairs]:
    """Record what camera sessions compare meanwhile."""
    pairs = Pairs()

    def recording(*given: Any) -> list[Track | None]:
        pairs.add(*given)
        return associate(*given)

    camera.associate = recording  # type: ignore[attr-defined, assignment]
    try:
        yield pairs
    finally:
        camera.associate = associate  # type: ignore[attr-defined]
