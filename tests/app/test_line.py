"""The line: who is admitted, whose turn is next, and that nobody starves, in simulated time."""

from __future__ import annotations

import heapq
import itertools
from collections import Counter
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field

import numpy as np
import pytest

from app.work.line import (
    ADMIT_SHARE,
    Line,
    OverloadedError,
    Sender,
    ShutdownError,
    SupersededError,
    Turn,
)

pytestmark = pytest.mark.anyio

MAX_WAIT_S = 2.0


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


class Clock:
    """Seconds that pass when told to."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@dataclass
class Client:
    """Someone who sends a frame, waits for the answer, and sends the next.

    Parameters
    ----------
    caller : hashable
    takes_s : float
        That a thread takes for a frame.
    kind : hashable
    obeys : bool
        Whether it comes back when it was told to, not at once.
    keeps_connection : bool
        Whether it can be told from the caller's other clients.
    """

    caller: Hashable
    takes_s: float
    kind: str = "photograph"
    obeys: bool = True
    keeps_connection: bool = True
    waits_s: list[float] = field(default_factory=list)
    refused: int = 0

    @property
    def sender(self) -> Sender:
        """As which it appears."""
        return Sender(self.caller, id(self) if self.keeps_connection else None)


class Service:
    """A line, threads, and clients, moment by moment.

    Parameters
    ----------
    threads : int
    clients : list of Client
    jitter : float
        Relative standard deviation of what a frame takes.
    """

    def __init__(self, clients: list[Client], threads: int = 2, jitter: float = 0.2) -> None:
        self.clock = Clock()
        self.line = Line(threads, MAX_WAIT_S, self.clock)
        self.busy_s = 0.0
        self._threads, self._jitter = threads, jitter
        self._rng = np.random.default_rng(0)
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = itertools.count()
        self._waiting: dict[Turn, tuple[Client, float]] = {}
        for number, client in enumerate(clients):
            self._at(0.01 * number, lambda client=client: self._send(client))

    def run(self, seconds: float) -> None:
        """Let time pass."""
        end = self.clock.now + seconds
        while self._events and self._events[0][0] < end:
            self.clock.now, _, event = heapq.heappop(self._events)
            event()

    def share(self, seconds: float) -> float:
        """Share of the threads' time in which they worked."""
        return self.busy_s / (seconds * self._threads)

    def _at(self, after_s: float, event: Callable[[], None]) -> None:
        heapq.heappush(self._events, (self.clock.now + after_s, next(self._numbers), event))

    def _send(self, client: Client) -> None:
        try:
            self.line.check(client.sender)
        except OverloadedError as error:
            self._refuse(client, error)
            return
        self._at(0.005, lambda: self._join(client))

    def _join(self, client: Client) -> None:
        try:
            turn = self.line.join(client.sender, client.kind)
        except OverloadedError as error:
            self._refuse(client, error)
            return
        self._waiting[turn] = client, self.clock.now
        self._begin()
        self._at(MAX_WAIT_S, lambda: self._give_up(turn))

    def _begin(self) -> None:
        for turn in [turn for turn in self._waiting if turn.begun.done()]:
            client, joined = self._waiting.pop(turn)
            client.waits_s.append(self.clock.now - joined)
            takes_s = client.takes_s * max(0.1, self._rng.normal(1, self._jitter))
            self.busy_s += takes_s
            self._at(takes_s, lambda turn=turn, client=client: self._end(turn, client))

    def _end(self, turn: Turn, client: Client) -> None:
        self.line.leave(turn, worked=True)
        self._begin()
        self._at(0.002, lambda: self._send(client))

    def _give_up(self, turn: Turn) -> None:
        if turn in self._waiting:
            client, _ = self._waiting.pop(turn)
            self._refuse(client, self.line.give_up(turn))

    def _refuse(self, client: Client, error: OverloadedError) -> None:
        client.refused += 1
        assert error.retry_after_s is not None
        assert error.retry_after_s >= 1
        self._at(error.retry_after_s if client.obeys else 0.3, lambda: self._send(client))


def shares(clients: list[Client]) -> Counter[Hashable]:
    """Answers by caller."""
    answered: Counter[Hashable] = Counter()
    for client in clients:
        answered[client.caller] += len(client.waits_s)
    return answered


class TestNobodyStarves:
    @pytest.mark.parametrize("callers", [1, 8], ids=["one address", "an address each"])
    @pytest.mark.parametrize("takes_s", [0.04, 0.3, 0.7, 1.4])
    async def test_eight_who_wait_for_their_answers_are_served_alike(
        self, takes_s: float, callers: int
    ) -> None:
        clients = [Client(number % callers, takes_s) for number in range(8)]
        service = Service(clients)
        service.run(40)
        counts = [len(client.waits_s) for client in clients]
        assert min(counts) >= 0.6 * max(counts)
        assert service.share(40) >= 0.97
        assert max(max(client.waits_s) for client in clients) <= MAX_WAIT_S

    @pytest.mark.parametrize("obeys", [True, False])
    @pytest.mark.parametrize("takes_s", [0.04, 0.7])
    async def test_one_caller_who_sends_ten_times_as_much_takes_nothing_from_the_others(
        self, takes_s: float, obeys: bool
    ) -> None:
        polite = [Client(number, takes_s) for number in range(8)]
        heavy = [Client("heavy", takes_s, obeys=obeys) for _ in range(40)]
        service = Service(polite + heavy)
        service.run(40)
        counts = [len(client.waits_s) for client in polite]
        carried = shares(polite + heavy)
        assert min(counts) >= 0.6 * max(counts)
        assert sum(counts) >= 0.8 * 8 / 9 * carried.total()
        assert service.share(40) >= 0.97
        assert max(wait for client in polite + heavy for wait in client.waits_s) <= MAX_WAIT_S

    @pytest.mark.parametrize("obeys", [True, False])
    async def test_behind_one_address_the_polite_are_still_served(self, obeys: bool) -> None:
        polite = [Client("proxy", 0.7) for number in range(8)]
        heavy = [Client("proxy", 0.7, obeys=obeys) for _ in range(10)]
        service = Service(polite + heavy)
        service.run(40)
        counts = [len(client.waits_s) for client in polite]
        assert min(counts) >= 3
        assert service.share(40) >= 0.97

    async def test_short_work_overtakes_the_long_work_of_others(self) -> None:
        photographs = [Client(number, 0.7) for number in range(8)]
        masks = Client("masks", 0.04, kind="mask")
        service = Service([*photographs, masks])
        service.run(40)
        assert len(masks.waits_s) > 3 * max(len(client.waits_s) for client in photographs)
        assert np.mean(masks.waits_s) < 0.7
        assert masks.refused == 0
        assert service.share(40) >= 0.97

    async def test_where_a_thread_is_free_nobody_is_refused(self) -> None:
        service = Service([Client(number, 0.7) for number in range(60)])
        service.run(2)  # All have come, most were told to come back, and nobody does.
        assert service.line._kept
        service._events.clear()
        for turn in [*service.line._waiting, *service.line._working]:
            service.line.leave(turn)
        service.line.check(Sender("newcomer"))
        assert service.line.join(Sender("newcomer"), "photograph").begun.done()


class TestAdmission:
    def line(self, threads: int = 1) -> tuple[Line, Clock]:
        clock = Clock()
        line = Line(threads, MAX_WAIT_S, clock)
        for seconds in [1.0] * 40:  # It learns what a frame takes.
            turn = line.join(Sender("before"), "photograph")
            clock.now += seconds
            line.leave(turn, worked=True)
        return line, clock

    async def test_the_wait_that_is_expected_decides(self) -> None:
        line, clock = self.line()
        assert line.fullness() == 0
        line.join(Sender("a"), "photograph")
        waiting = line.join(Sender("b"), "photograph")
        assert line.fullness() == pytest.approx(2 / (ADMIT_SHARE * MAX_WAIT_S), rel=0.01)
        with pytest.raises(OverloadedError) as caught:
            line.check(Sender("c", 1))
        assert caught.value.retry_after_s == 1
        assert not waiting.begun.done()
        clock.now += 0.6  # Sooner than told, but there is room.
        line.check(Sender("c", 1))

    async def test_who_comes_back_has_kept_the_place(self) -> None:
        line, clock = self.line()
        first = line.join(Sender("a"), "photograph")
        second = line.join(Sender("b"), "photograph")
        with pytest.raises(OverloadedError):
            line.check(Sender("c", 1))
        clock.now += 0.9
        line.leave(first, worked=True)
        with pytest.raises(OverloadedError):
            line.join(Sender("a"), "photograph")
        clock.now += 0.1
        third = line.join(Sender("c", 1), "photograph")
        clock.now += 0.8
        line.leave(second, worked=True)
        assert third.begun.done()

    async def test_the_patient_are_never_refused(self) -> None:
        line, _ = self.line()
        for _ in range(2):
            line.join(Sender("a"), "photograph")
        with pytest.raises(OverloadedError):
            line.join(Sender("a"), "photograph")
        line.join(Sender("a"), "photograph", patient=True)
        assert line.inside == 3

    async def test_callers_who_are_gone_are_forgotten(self) -> None:
        line, clock = self.line()
        line.join(Sender("stays"), "photograph", patient=True)
        for number in range(3000):
            turn = line.join(Sender(number), "photograph", patient=True)
            clock.now += 1
            line.leave(line._working[0], worked=True)
            assert turn.begun.done()
        assert len(line._served_s) <= 1001
        assert len(line._kinds) <= 1001

    async def test_a_flood_leaves_nothing_behind(self) -> None:
        line, clock = self.line()
        turns = [line.join(Sender(name), "photograph") for name in "ab"]
        for number in range(3000):
            with pytest.raises(OverloadedError) as caught:
                line.check(Sender(number))
            assert 1 <= (caught.value.retry_after_s or 0) <= 30
        assert len(line._kept) <= 64
        clock.now += 60
        for turn in turns:
            line.leave(turn)
        line.check(Sender("a"))
        assert line._kept == []


class TestCameras:
    """Frames of live cameras, one thread."""

    async def test_a_newer_frame_takes_the_place_of_the_one_that_waits(self) -> None:
        line = Line(1, MAX_WAIT_S)
        running, older = (line.join(Sender("a"), None, "yard") for _ in range(2))
        other = line.join(Sender("a"), None, "gate")
        newer = line.join(Sender("a"), None, "yard")
        refused = older.begun.result()
        assert refused is SupersededError
        assert refused().retry_after_s is None
        # What runs is finished, and the place before the other camera is kept.
        line.leave(running)
        assert newer.begun.done()
        assert not other.begun.done()
        line.leave(newer)
        assert other.begun.done()

    async def test_where_others_are_refused_a_camera_may_still_replace_its_own(self) -> None:
        line = Line(1, 0.15)
        line.join(Sender("a"), None, "yard")
        line.join(Sender("a"), None, "yard")
        with pytest.raises(OverloadedError):
            line.check(Sender("a"), "gate")
        line.check(Sender("a"), "yard")
        line.join(Sender("a"), None, "yard")
        assert line.inside == 2

    async def test_one_frame_of_a_camera_at_a_time(self) -> None:
        line = Line(4, MAX_WAIT_S)
        first, second = (line.join(Sender("a"), None, "yard") for _ in range(2))
        other = line.join(Sender("a"), None, "gate")
        assert [turn.begun.done() for turn in (first, second, other)] == [True, False, True]
        line.leave(first)
        assert second.begun.done()

    async def test_a_frame_whose_client_has_gone_is_no_place_to_take(self) -> None:
        line = Line(1, MAX_WAIT_S)
        line.join(Sender("a"), None, "yard")
        gone = line.join(Sender("a"), None, "yard")
        line.leave(gone)
        line.join(Sender("a"), None, "yard")
        assert not gone.begun.done()
        assert line.inside == 2


async def test_closing_drops_what_waits() -> None:
    line = Line(1, MAX_WAIT_S)
    running, waiting = (line.join(Sender("a"), None) for _ in range(2))
    line.close()
    assert waiting.begun.result() is ShutdownError
    line.leave(running)
    assert line.inside == 0
