"""The line: who is admitted, whose turn is next, and that nobody starves, in simulated time."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field

import anyio
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.scheduling.queue import (
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


class Clock:
    """Seconds that pass when told to."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@dataclass
class Client:
    """Someone who sends a frame, waits for the answer, and sends the next.

    Who obeys comes back when told to, others at once.
    """

    caller: Hashable
    takes_s: float
    kind: str = "photograph"
    obeys: bool = True
    waits_s: list[float] = field(default_factory=list)
    refused: int = 0

    @property
    def sender(self) -> Sender:
        return Sender(self.caller, id(self))


class Service:
    """A line, two threads, and clients, moment by moment; frames take 20 % more or less."""

    def __init__(self, clients: list[Client]) -> None:
        self.clock = Clock()
        self.line = Line(2, MAX_WAIT_S, self.clock)
        self.busy_s = 0.0
        self._rng = np.random.default_rng(0)
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = itertools.count()
        self._waiting: dict[Turn, tuple[Client, float]] = {}
        for number, client in enumerate(clients):
            self._at(0.01 * number, lambda client=client: self._send(client))

    def run(self, seconds: float = 40) -> None:
        """Let time pass, in which the threads are hardly ever idle."""
        end = self.clock.now + seconds
        while self._events and self._events[0][0] < end:
            self.clock.now, _, event = heapq.heappop(self._events)
            event()
        assert self.busy_s >= 0.97 * 2 * seconds

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
            takes_s = client.takes_s * max(0.1, self._rng.normal(1, 0.2))
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


def answers(clients: list[Client]) -> list[int]:
    """How many frames of each client were answered, none after more than the longest wait."""
    assert max(wait for client in clients for wait in client.waits_s) <= MAX_WAIT_S
    return [len(client.waits_s) for client in clients]


class TestNobodyStarves:
    @pytest.mark.parametrize("callers", [1, 8], ids=["one address", "an address each"])
    @pytest.mark.parametrize("takes_s", [0.04, 0.3, 0.7, 1.4])
    async def test_eight_who_wait_for_their_answers_are_served_alike(
        self, takes_s: float, callers: int
    ) -> None:
        clients = [Client(number % callers, takes_s) for number in range(8)]
        Service(clients).run()
        assert min(answers(clients)) >= 0.6 * max(answers(clients))

    @pytest.mark.parametrize("obeys", [True, False])
    @pytest.mark.parametrize("takes_s", [0.04, 0.7])
    async def test_one_caller_who_sends_ten_times_as_much_takes_nothing_from_the_others(
        self, takes_s: float, obeys: bool
    ) -> None:
        polite = [Client(number, takes_s) for number in range(8)]
        heavy = [Client("heavy", takes_s, obeys=obeys) for _ in range(40)]
        Service(polite + heavy).run()
        counts, all_counts = answers(polite), answers(polite + heavy)
        assert min(counts) >= 0.6 * max(counts)
        assert sum(counts) >= 0.8 * 8 / 9 * sum(all_counts)

    @pytest.mark.parametrize("obeys", [True, False])
    async def test_behind_one_address_the_polite_are_still_served(self, obeys: bool) -> None:
        polite = [Client("proxy", 0.7) for number in range(8)]
        Service(polite + [Client("proxy", 0.7, obeys=obeys) for _ in range(10)]).run()
        assert min(answers(polite)) >= 3

    async def test_short_work_overtakes_the_long_work_of_others(self) -> None:
        photographs = [Client(number, 0.7) for number in range(8)]
        masks = Client("masks", 0.04, kind="mask")
        Service([*photographs, masks]).run()
        assert len(masks.waits_s) > 3 * max(answers(photographs))
        assert np.mean(masks.waits_s) < 0.7
        assert masks.refused == 0


operations = st.lists(
    st.tuples(
        st.sampled_from(["join", "leave", "give_up", "wait"]),
        st.sampled_from(["a", "b", "c"]),
        st.sampled_from([None, "yard", "gate"]),
        st.integers(0, 9),
    ),
    max_size=60,
)


@given(operations=operations, threads=st.integers(1, 3))
def test_whatever_happens_the_line_keeps_its_promises(
    operations: list[tuple[str, str, str | None, int]], threads: int
) -> None:
    anyio.run(play, operations, threads)


async def play(operations: list[tuple[str, str, str | None, int]], threads: int) -> None:
    clock = Clock()
    line = Line(threads, MAX_WAIT_S, clock)
    inside: list[Turn] = []
    for operation, caller, camera, number in operations:
        before = {turn for turn in inside if turn.begun.done()}
        if operation == "join":
            try:
                inside.append(line.join(Sender(caller), camera, camera))
            except OverloadedError as error:
                assert 1 <= (error.retry_after_s or 0) <= 30
        elif operation == "wait":
            clock.now += number / 3
        elif inside:
            turn = inside[number % len(inside)]
            if operation == "leave":
                line.leave(turn, worked=turn.begun.done())
                inside.remove(turn)
            elif not turn.begun.done():
                line.give_up(turn)
                inside.remove(turn)
        superseded = [t for t in inside if t.begun.done() and t.begun.result() is not None]
        assert all(turn.begun.result() is SupersededError for turn in superseded)
        inside = [turn for turn in inside if turn not in superseded]
        working = {turn for turn in inside if turn.begun.done()}
        assert line.inside == len(inside)
        assert line.working == len(working) <= threads
        # Of a camera, one frame is worked on at a time, and one waits.
        for name in ("yard", "gate"):
            ours = [turn for turn in inside if turn.camera == name]
            assert sum(turn in working for turn in ours) <= 1
            assert sum(turn not in working for turn in ours) <= 1
        waiting = [turn for turn in inside if turn not in working]
        if len(working) < threads:
            assert {turn.camera for turn in waiting} <= {turn.camera for turn in working} - {None}
        # One caller's frames of one kind begin in order.
        for turn in working - before:
            assert all(
                other.number > turn.number
                for other in waiting
                if (other.sender, other.camera) == (turn.sender, turn.camera)
            )


def one_second_each() -> tuple[Line, Clock]:
    """A line for one thread that has learned how long frames take."""
    clock = Clock()
    line = Line(1, MAX_WAIT_S, clock)
    for _ in range(40):
        turn = line.join(Sender("before"), "photograph")
        clock.now += 1
        line.leave(turn, worked=True)
    return line, clock


class TestAdmission:
    async def test_the_wait_that_is_expected_decides(self) -> None:
        line, clock = one_second_each()
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
        line, clock = one_second_each()
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
        line, _ = one_second_each()
        for _ in range(2):
            line.join(Sender("a"), "photograph")
        with pytest.raises(OverloadedError):
            line.join(Sender("a"), "photograph")
        line.join(Sender("a"), "photograph", patient=True)
        assert line.inside == 3

    async def test_after_thousands_of_callers_newcomers_are_served_as_before(self) -> None:
        line, clock = one_second_each()
        for number in range(1500):
            turn = line.join(Sender(number), "photograph", patient=True)
            clock.now += 1
            line.leave(turn, worked=True)
            assert turn.begun.done()
        turns = [line.join(Sender(name), "photograph") for name in "ab"]
        for number in range(1500):
            with pytest.raises(OverloadedError) as caught:
                line.check(Sender(number))
            assert 1 <= (caught.value.retry_after_s or 0) <= 30
        clock.now += 60
        for turn in turns:
            line.leave(turn)
        line.check(Sender("a"))
        assert line.join(Sender("newcomer"), "photograph").begun.done()


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

    async def test_where_others_are_refused_a_camera_may_still_replace_its_own(self) -> None:
        line = Line(1, 0.15)
        line.join(Sender("a"), None, "yard")
        line.join(Sender("a"), None, "yard")
        with pytest.raises(OverloadedError):
            line.check(Sender("a"), "gate")
        line.check(Sender("a"), "yard")
        line.join(Sender("a"), None, "yard")
        assert line.inside == 2


async def test_closing_drops_what_waits() -> None:
    line = Line(1, MAX_WAIT_S)
    running, waiting = (line.join(Sender("a"), None) for _ in range(2))
    line.close()
    assert waiting.begun.result() is ShutdownError
    line.leave(running)
    assert line.inside == 0
