"""The people that Home Assistant is shown, by the service's answers."""

from collections.abc import Collection, Mapping
from types import SimpleNamespace
from typing import Any

import pytest

from app.bridge.bridge import HELD_S, Bridge
from app.bridge.outbox import Outbox
from app.configuration import EVENT_NAMES
from tests.app.bridge.servers import event

Shown = tuple[int, Mapping[str, bool] | None]


class Camera:
    """A camera of a service that answers with frames given in advance."""

    camera_id = "yard"

    def __init__(self, raised: Collection[str]) -> None:
        self._raised = raised

    def settings(self) -> tuple[list[str], Collection[str]]:
        return ["bed", "door"], self._raised

    def replay_url(self, event_id: str) -> str:
        return f"/replay/{event_id}"


class Watched:
    """A bridge, and what it shows."""

    def __init__(self, raised: Collection[str] = EVENT_NAMES) -> None:
        self.raised = raised
        self.outbox = Outbox("yard", ["webhook"])
        self._shown: list[Shown] = []
        show = SimpleNamespace(
            show=lambda people, zones, *_, **__: self._shown.append((people, zones))
        )
        self._bridge = Bridge(Camera(raised), self.outbox, show)  # type: ignore[arg-type]
        self._bridge._read_settings()

    def see(
        self,
        time: float,
        persons: Mapping[int, list[str]],
        *events: dict[str, Any],
        is_new: bool = False,
        reset: str | None = None,
    ) -> Shown:
        """Hand on an answer with people's zones by identity; return what is shown then."""
        answer = {
            "timestamp": time,
            "reset": reset,
            "image": {"warnings": []},
            "persons": [
                {"track_id": number, "zones": zones, "posture": None}
                for number, zones in persons.items()
            ],
            "events": [one for one in events if one["event"] in self.raised],
        }
        self._bridge._hand_on(is_new, answer)
        return self._shown[-1]


def of(track_id: int, name: str, *zones: str) -> dict[str, Any]:
    return {**event(name, 0.0), "track_id": track_id, "zones": [*zones]}


FILM: list[tuple[dict[int, list[str]], list[dict[str, Any]]]] = [
    ({}, []),
    ({1: []}, [of(1, "entered")]),
    ({1: ["bed"], 2: []}, [of(2, "entered"), of(1, "zone_entered", "bed")]),
    ({1: ["bed"]}, []),  # The second is not seen for a moment.
    ({1: [], 2: ["bed", "door"]}, [of(1, "fell"), of(1, "zone_left", "bed")]),
]


@pytest.mark.parametrize("raised", [EVENT_NAMES, ("fell", "left"), ("fell",), ()])
def test_whatever_events_a_camera_raises_its_people_and_zones_are_shown(
    raised: Collection[str],
) -> None:
    watched = Watched(raised)
    shown = [watched.see(0.2 * step, *rest[:1], *rest[1]) for step, rest in enumerate(FILM)]
    assert shown == [
        (0, {"bed": False, "door": False}),
        (1, {"bed": False, "door": False}),
        (2, {"bed": True, "door": False}),
        (2, {"bed": True, "door": False}),
        (2, {"bed": True, "door": True}),
    ]


@pytest.mark.parametrize("raised", [EVENT_NAMES, ("fell",)])
def test_who_is_not_seen_any_more_is_gone_at_the_latest_with_the_session(
    raised: Collection[str],
) -> None:
    watched = Watched(raised)
    watched.see(0.0, {1: ["bed"], 2: []})
    assert watched.see(0.4, {2: []}) == (2, {"bed": True, "door": False})
    people, _ = watched.see(0.6, {2: []}, of(1, "left"))
    assert people == (1 if "left" in raised else 2)
    assert watched.see(HELD_S + 0.1, {2: []}) == (1, {"bed": False, "door": False})


def test_people_who_are_followed_anew_count_once() -> None:
    watched = Watched()
    watched.see(0.0, {1: ["bed"], 2: []})
    assert watched.see(0.2, {3: []}, reset="roll_deg was 0") == (1, {"bed": False, "door": False})
    assert watched.see(0.4, {1: []}, is_new=True)[0] == 1


@pytest.mark.parametrize(("raised", "told"), [(EVENT_NAMES, [1, 2]), (("fell",), [])])
def test_who_is_forgotten_has_left_for_a_camera_that_raises_that(
    raised: Collection[str], told: list[int]
) -> None:
    watched = Watched(raised)
    watched.see(0.0, {2: [], 1: []})
    watched.see(0.2, {}, is_new=True)
    messages = []
    while (message := watched.outbox.wait_for_next("webhook", 0)) is not None:
        watched.outbox.remove("webhook", message["id"])
        messages.append((message["event"], message["track_id"]))
    assert messages == [("left", number) for number in told]
