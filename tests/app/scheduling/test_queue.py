"""The fair queue in simulated time: admission, order, and that no client starves."""

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
    FairQueue,
    OverloadedError,
    ShutdownError,
    SupersededError,
    Ticket,
)

pytestmark = pytest.mark.anyio

MAX_WAIT_S = 2.0


class Clock:
    """A clock that a test advances."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@dataclass
class Client:
    """A client that sends a frame, waits for the answer, and sends the next.

    After a refusal, an obedient client returns at the time it was given, another one at once.
    """

    caller: Hashable
    takes_s: float
    kind: str = "photograph"
    obeys: bool = True
    waits_s: list[float] = field(default_factory=list)
    refused: int = 0


class Service:
    """A discrete event simulation: a queue, two threads, clients; durations vary by 20 %."""

    def __init__(self, clients: list[Client]) -> None:
        self.clock = Clock()
        self.queue = FairQueue(2, MAX_WAIT_S, self.clock)
        self.busy_s = 0.0
        self._rng = np.random.default_rng(0)
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = itertools.count()
        self._waiting: dict[Ticket, tuple[Client, float]] = {}
        for number, client in enumerate(clients):
            self._at(0.01 * number, lambda client=client: self._send(client))

    def run(self, seconds: float = 40) -> None:
        """Simulate some time, in which the threads are hardly ever idle."""
        end = self.clock.now + seconds
        while self._events and self._events[0][0] < end:
            self.clock.now, _, event = heapq.heappop(self._events)
            event()
        assert self.busy_s >= 0.97 * 2 * seconds

    def _at(self, after_s: float, event: Callable[[], None]) -> None:
        heapq.heappush(self._events, (self.clock.now + after_s, next(self._numbers), event))

    def _send(self, client: Client) -> None:
        try:
            self.queue.check(client.caller)
        except OverloadedError as error:
            self._refuse(client, error)
        else:
            self._at(0.005, lambda: self._enqueue(client))

    def _enqueue(self, client: Client) -> None:
        try:
            ticket = self.queue.enqueue(client.caller, client.kind)
        except OverloadedError as error:
            self._refuse(client, error)
            return
        self._waiting[ticket] = client, self.clock.now
        self._begin()
        self._at(MAX_WAIT_S, lambda: self._expire(ticket))

    def _begin(self) -> None:
        for ticket in [ticket for ticket in self._waiting if ticket.begun.done()]:
            client, enqueued = self._waiting.pop(ticket)
            client.waits_s.append(self.clock.now - enqueued)
            takes_s = client.takes_s * max(0.1, self._rng.normal(1, 0.2))
            self.busy_s += takes_s
            self._at(takes_s, lambda ticket=ticket, client=client: self._end(ticket, client))

    def _end(self, ticket: Ticket, client: Client) -> None:
        self.queue.release(ticket, worked=True)
        self._begin()
        self._at(0.002, lambda: self._send(client))

    def _expire(self, ticket: Ticket) -> None:
        if ticket in self._waiting:
            client, _ = self._waiting.pop(ticket)
            self._refuse(client, self.queue.expire(ticket))

    def _refuse(self, client: Client, error: OverloadedError) -> None:
        client.refused += 1
        assert error.retry_after_s is not None
        assert error.retry_after_s >= 1
        self._at(error.retry_after_s if client.obeys else 0.3, lambda: self._send(client))


def answers(clients: list[Client]) -> list[int]:
    """Number of answered frames of each client; none waited longer than allowed."""
    assert max(wait for client in clients for wait in client.waits_s) <= MAX_WAIT_S
    return [len(client.waits_s) for client in clients]


class TestNobodyStarves:
    @pytest.mark.parametrize(("callers", "share"), [(1, 0.25), (8, 0.6)])
    @pytest.mark.parametrize("takes_s", [0.04, 1.4])
    async def test_eight_equal_clients_are_served_about_equally(
        self, takes_s: float, callers: int, share: float
    ) -> None:
        """Clients of one address less so: whoever returns first after a refusal is served."""
        clients = [Client(number % callers, takes_s) for number in range(8)]
        Service(clients).run()
        assert min(answers(clients)) >= share * max(answers(clients))

    @pytest.mark.parametrize("obeys", [True, False])
    @pytest.mark.parametrize("takes_s", [0.04, 0.7])
    async def test_a_caller_with_forty_clients_takes_nothing_from_others(
        self, takes_s: float, obeys: bool
    ) -> None:
        polite = [Client(number, takes_s) for number in range(8)]
        heavy = [Client("heavy", takes_s, obeys=obeys) for _ in range(40)]
        Service(polite + heavy).run()
        counts, all_counts = answers(polite), answers(polite + heavy)
        assert min(counts) >= 0.6 * max(counts)
        assert sum(counts) >= 0.8 * 8 / 9 * sum(all_counts)

    @pytest.mark.parametrize("obeys", [True, False])
    async def test_polite_clients_behind_one_address_are_still_served(self, obeys: bool) -> None:
        polite = [Client("proxy", 0.7) for number in range(8)]
        Service(polite + [Client("proxy", 0.7, obeys=obeys) for _ in range(10)]).run()
        assert min(answers(polite)) >= 1

    async def test_short_work_overtakes_long_work_of_other_callers(self) -> None:
        photographs = [Client(number, 0.7) for number in range(8)]
        masks = Client("masks", 0.04, kind="mask")
        Service([*photographs, masks]).run()
        assert len(masks.waits_s) > 3 * max(answers(photographs))
        assert np.mean(masks.waits_s) < 0.7
        assert masks.refused == 0


operations = st.lists(
    st.tuples(
        st.sampled_from(["enqueue", "release", "expire", "wait"]),
        st.sampled_from(["a", "b", "c"]),
        st.sampled_from([None, "yard", "gate"]),
        st.integers(0, 9),
    ),
    max_size=60,
)


@given(operations=operations, threads=st.integers(1, 3))
def test_invariants_hold_after_any_operations(
    operations: list[tuple[str, str, str | None, int]], threads: int
) -> None:
    anyio.run(play, operations, threads)


async def play(operations: list[tuple[str, str, str | None, int]], threads: int) -> None:
    clock = Clock()
    queue = FairQueue(threads, MAX_WAIT_S, clock)
    tickets: list[Ticket] = []
    for operation, caller, camera, number in operations:
        before = {ticket for ticket in tickets if ticket.begun.done()}
        if operation == "enqueue":
            try:
                tickets.append(queue.enqueue(caller, camera, camera))
            except OverloadedError as error:
                assert 1 <= (error.retry_after_s or 0) <= 30
        elif operation == "wait":
            clock.now += number / 3
        elif tickets:
            ticket = tickets[number % len(tickets)]
            if operation == "release":
                queue.release(ticket, worked=ticket.begun.done())
                tickets.remove(ticket)
            elif not ticket.begun.done():
                queue.expire(ticket)
                tickets.remove(ticket)
        superseded = [t for t in tickets if t.begun.done() and t.begun.result() is not None]
        for ticket in superseded:
            assert ticket.begun.result() is SupersededError
            queue.release(ticket)  # Its place belongs to the newer frame.
        tickets = [ticket for ticket in tickets if ticket not in superseded]
        working = {ticket for ticket in tickets if ticket.begun.done()}
        assert queue.in_flight == len(tickets)
        assert queue.working == len(working) <= threads
        # At most one frame of a camera is worked on at a time, and one waits.
        for name in ("yard", "gate"):
            ours = [ticket for ticket in tickets if ticket.camera == name]
            assert sum(ticket in working for ticket in ours) <= 1
            assert sum(ticket not in working for ticket in ours) <= 1
        waiting = [ticket for ticket in tickets if ticket not in working]
        if len(working) < threads:
            busy = {ticket.camera for ticket in working} - {None}
            assert {ticket.camera for ticket in waiting} <= busy
        # Frames of one kind from one caller begin in order.
        for ticket in working - before:
            assert all(
                other.number > ticket.number
                for other in waiting
                if (other.caller, other.camera) == (ticket.caller, ticket.camera)
            )


def one_second_each() -> tuple[FairQueue, Clock]:
    """A queue for one thread that has learned how long frames take."""
    clock = Clock()
    queue = FairQueue(1, MAX_WAIT_S, clock)
    for _ in range(40):
        ticket = queue.enqueue("before", "photograph")
        clock.now += 1
        queue.release(ticket, worked=True)
    return queue, clock


class TestAdmission:
    async def test_the_expected_wait_decides(self) -> None:
        queue, clock = one_second_each()
        assert queue.load() == 0
        queue.enqueue("a", "photograph")
        waiting = queue.enqueue("b", "photograph")
        assert queue.load() == pytest.approx(2 / (ADMIT_SHARE * MAX_WAIT_S), rel=0.01)
        with pytest.raises(OverloadedError) as caught:
            queue.check("c")
        assert caught.value.retry_after_s == 1
        assert not waiting.begun.done()
        clock.now += 0.6  # Earlier than asked, but there is room.
        queue.check("c")

    async def test_a_light_caller_is_admitted_where_a_heavy_one_is_not(self) -> None:
        queue, _ = one_second_each()
        queue.enqueue("heavy", "photograph")
        waiting = queue.enqueue("heavy", "photograph")
        with pytest.raises(OverloadedError):
            queue.check("heavy")
        queue.check("light")
        light = queue.enqueue("light", "photograph")
        for _ in range(3):
            queue.enqueue("heavy", "photograph", unbounded_wait=True)
        # Each is told when a frame of its own could begin.
        soon, late = (queue.expire(ticket).retry_after_s for ticket in (light, waiting))
        assert soon is not None and late is not None and soon < late

    @pytest.mark.parametrize(
        ("seconds", "worked", "expected_s"), [(2, True, 1.2), (100, False, 1.0)]
    )
    async def test_one_slow_frame_hardly_changes_what_is_expected_and_an_abandoned_one_nothing(
        self, seconds: float, worked: bool, expected_s: float
    ) -> None:
        queue, clock = one_second_each()
        slow = queue.enqueue("a", "photograph")
        clock.now += seconds
        queue.release(slow, worked=worked)
        queue.enqueue("a", "photograph")
        assert queue.load() == pytest.approx(expected_s / (ADMIT_SHARE * MAX_WAIT_S), rel=0.01)

    async def test_what_a_frame_waits_for_depends_on_its_kind(self) -> None:
        queue, _ = one_second_each()
        working = queue.enqueue("a", "photograph")
        waiting = queue.enqueue("b", "photograph")
        # Shorter work comes first; it is not known of other kinds that they take as long.
        queue.enqueue("c", "mask")
        with pytest.raises(OverloadedError):
            queue.enqueue("c", "photograph")
        # Whoever gives up is told how long a frame of the same kind would wait.
        for caller in ("d", "e", "f"):
            queue.enqueue(caller, "photograph", unbounded_wait=True)
        mask = queue.enqueue("g", "mask", unbounded_wait=True)
        soon, late = (queue.expire(one).retry_after_s for one in (mask, waiting))
        assert soon is not None and late is not None and soon < late
        assert working.begun.done()


async def test_idle_time_gives_no_credit() -> None:
    """Whoever waited while another one worked alone takes turns with them, and is not first."""
    queue, clock = one_second_each()
    for _ in range(10):
        alone = queue.enqueue("busy", "photograph")
        clock.now += 1
        queue.release(alone, worked=True)
    working = queue.enqueue("other", "photograph")
    waiting = {
        queue.enqueue(caller, "photograph", unbounded_wait=True): caller
        for caller in ("busy", "idle")
        for _ in range(4)
    }
    order = ""
    while waiting:
        clock.now += 1
        queue.release(working, worked=True)
        (working,) = (ticket for ticket in waiting if ticket.begun.done())
        order += waiting.pop(working)[0]
    assert order in ("bibibibi", "ibibibib", "ibbibibi", "biibibib"), order


async def test_thousands_of_callers_come_and_go() -> None:
    """Only those whose frames wait are remembered; each is served."""
    queue = FairQueue(1, MAX_WAIT_S)
    waiting = queue.enqueue("first", "photograph")
    for caller in range(1100):
        later = queue.enqueue(caller, "photograph", unbounded_wait=True)
        queue.release(waiting)
        assert later.begun.done()
        waiting = later
    queue.enqueue("patient", "photograph", unbounded_wait=True)
    queue.release(waiting)
    assert queue.in_flight == 1


async def test_a_closed_queue_begins_nothing() -> None:
    queue, _ = one_second_each()
    working, waiting = (queue.enqueue("a", "photograph") for _ in range(2))
    queue.close()
    assert waiting.begun.result() is ShutdownError
    queue.release(working)
    late = queue.enqueue("a", "photograph")
    assert not late.begun.done()


class TestCameras:
    """Frames of live cameras, one thread."""

    async def test_a_frame_that_would_replace_a_waiting_one_is_always_admitted(self) -> None:
        queue, _ = one_second_each()
        queue.enqueue("a", "photograph")
        queue.enqueue("a", "photograph", "yard")
        queue.check("a", "yard")
        with pytest.raises(OverloadedError):
            queue.check("a", "gate")

    async def test_a_newer_frame_replaces_the_waiting_one(self) -> None:
        queue = FairQueue(1, MAX_WAIT_S)
        running, older = (queue.enqueue("a", None, "yard") for _ in range(2))
        other = queue.enqueue("a", None, "gate")
        newer = queue.enqueue("a", None, "yard")
        refused = older.begun.result()
        assert refused is SupersededError
        assert refused().retry_after_s is None
        # The running frame is finished, and the place ahead of the other camera is kept.
        queue.release(running)
        assert newer.begun.done()
        assert not other.begun.done()
