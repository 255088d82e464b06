"""The people before a camera and in each of its zones, derived from events."""

from collections.abc import Iterable, Mapping
from typing import Any


class Presence:
    """The people before a camera: steadier than those of single frames."""

    def __init__(self) -> None:
        self._people: set[int] = set()
        self._zones: dict[str, set[int]] = {}

    @property
    def track_ids(self) -> list[int]:
        """Identities of the people."""
        return sorted(self._people)

    @property
    def people(self) -> int:
        """Number of people."""
        return len(self._people)

    def is_occupied(self, zone: str) -> bool:
        """Whether a person is in a zone."""
        return bool(self._zones.get(zone))

    def begin(self, persons: Iterable[Mapping[str, Any]]) -> None:
        """Begin with the people of a frame whose history is not known."""
        self._people, self._zones = set(), {}
        for person in persons:
            self._people.add(person["track_id"])
            for zone in person["zones"]:
                self._zones.setdefault(zone, set()).add(person["track_id"])

    def update(self, event: Mapping[str, Any]) -> None:
        """Update the people by an event."""
        person = event["track_id"]
        if event["event"] == "entered":
            self._people.add(person)
        elif event["event"] == "left":
            self._people.discard(person)
            for inside in self._zones.values():
                inside.discard(person)
        elif event["event"] == "zone_entered":
            self._zones.setdefault(event["zones"][0], set()).add(person)
        elif event["event"] == "zone_left":
            self._zones.get(event["zones"][0], set()).discard(person)
