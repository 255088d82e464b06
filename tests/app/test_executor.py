"""The executor: bounded, refusing at once, fair to frames, and dropping what nobody waits for."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import queue
import resource
import sys
import threading
import time
import weakref
from functools import partial
from itertools import pairwise
from pathlib import Path

import anyio
import pytest
from anyio import to_thread

from app.http.request_context import request_id
from app.work.cancellation import BusyError, CancellationToken, ClientGoneError, DeadlineError
from app.work.executor import Executor
from app.work.line import OverloadedError, Sender, ShutdownError, SupersededError

pytestmark = pytest.mark.anyio

ANYONE = Sender("anyone")


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


async def never() -> None:
    await anyio.sleep_forever()


def until_cancelled(token: CancellationToken) -> None:
    while True:
        token.check()
        time.sleep(0.005)


class TestFrames:
    async def test_results_and_errors_pass_through(self) -> None:
        executor = Executor(frames=1, max_wait_s=60, timeout_s=5)
        assert await executor.run(lambda _: 42, never, sender=ANYONE) == 42
        with pytest.raises(KeyError, match="lost"):
            await executor.run(lambda _: {}["lost"], never, sender=ANYONE)
        assert executor.line.inside == 0

    async def test_no_more_than_allowed_are_worked_on_at_once(self) -> None:
        executor = Executor(frames=2, max_wait_s=60, timeout_s=5)
        lock = threading.Lock()
        running, most = 0, 0

        def work(_: CancellationToken) -> None:
            nonlocal running, most
            with lock:
                running += 1
                most = max(most, running)
            executor.map(time.sleep, [0.005] * 3)
            with lock:
                running -= 1

        async with anyio.create_task_group() as tasks:
            for _ in range(10):
                tasks.start_soon(partial(executor.run, sender=ANYONE), work, never)
        assert most == 2
        executor.shut_down()
        assert executor.line.working == executor._helping == 0

    async def test_a_waiting_frame_is_dropped_when_its_client_hangs_up(self) -> None:
        executor = Executor(frames=1, max_wait_s=60, timeout_s=5)
        release, done = threading.Event(), []
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(partial(executor.run, sender=ANYONE), lambda _: release.wait(), never)
            await anyio.wait_all_tasks_blocked()
            with pytest.raises(ClientGoneError):
                await executor.run(
                    lambda _: done.append(1), lambda: anyio.sleep(0.02), sender=ANYONE
                )
            assert executor.line.inside == 1
            release.set()
        assert done == []

    async def test_work_is_cancelled_when_its_client_hangs_up(self) -> None:
        executor = Executor(frames=1, max_wait_s=60, timeout_s=60)
        with anyio.fail_after(10), pytest.raises(ClientGoneError):
            await executor.run(until_cancelled, lambda: anyio.sleep(0.05), sender=ANYONE)

    async def test_the_deadline_holds_for_work_and_for_waiting(self) -> None:
        executor = Executor(frames=1, max_wait_s=60, timeout_s=0.1)
        outcomes = []

        async def frame() -> None:
            with pytest.raises(BusyError) as caught:
                await executor.run(until_cancelled, never, sender=ANYONE)
            outcomes.append(type(caught.value))

        with anyio.fail_after(10):
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(frame)
                tasks.start_soon(frame)
        assert set(outcomes) == {DeadlineError, OverloadedError}
        assert executor.line.inside == 0

    async def test_a_frame_that_waited_in_vain_is_told_that_the_service_was_busy(self) -> None:
        executor = Executor(frames=1, max_wait_s=0.2, timeout_s=60)
        release = threading.Event()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(partial(executor.run, sender=ANYONE), lambda _: release.wait(), never)
            await anyio.wait_all_tasks_blocked()
            with pytest.raises(OverloadedError, match="working to capacity"):
                await executor.run(lambda _: None, never, sender=ANYONE)
            release.set()

    async def test_a_superseded_frame_is_told_so(self) -> None:
        executor = Executor(frames=1, max_wait_s=60, timeout_s=60)
        let_go, outcomes = threading.Event(), list[str]()

        async def frame(name: str) -> None:
            def work(_: CancellationToken) -> None:
                let_go.wait(10)

            try:
                await executor.run(work, never, sender=ANYONE, camera="yard")
                outcomes.append(name)
            except SupersededError as error:
                outcomes.append(f"{name} {error.reason}")

        async with anyio.create_task_group() as tasks:
            for name in ("first", "second", "third"):
                tasks.start_soon(frame, name)
                await anyio.wait_all_tasks_blocked()
            let_go.set()
        assert outcomes == ["second superseded", "first", "third"]

    async def test_a_frame_that_failed_keeps_nothing_of_itself(self) -> None:
        class Picture:
            pass

        async def fail(picture: Picture) -> None:
            def work(_: CancellationToken) -> None:
                raise ValueError(picture)

            with contextlib.suppress(ValueError):
                await executor.run(work, never, sender=ANYONE)

        executor = Executor(frames=1, max_wait_s=60, timeout_s=60)
        picture = Picture()
        kept = weakref.ref(picture)
        gc.disable()
        try:
            await fail(picture)
            del picture
            await anyio.wait_all_tasks_blocked()
            assert kept() is None
        finally:
            gc.enable()

    async def test_a_request_that_is_cancelled_cancels_its_work(self) -> None:
        executor = Executor(frames=1, max_wait_s=60, timeout_s=60)
        begun, cancelled = threading.Event(), threading.Event()

        def work(token: CancellationToken) -> None:
            begun.set()
            with pytest.raises(ClientGoneError):
                until_cancelled(token)
            cancelled.set()

        async with anyio.create_task_group() as tasks:
            tasks.start_soon(partial(executor.run, sender=ANYONE), work, never)
            await to_thread.run_sync(begun.wait)
            tasks.cancel_scope.cancel()
        assert await to_thread.run_sync(cancelled.wait, 10)
        assert executor.line.inside == 0

    @pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc, needs glibc")
    async def test_long_work_leaves_no_memory_behind(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("app.work.executor._TRIM_AFTER_S", 0.0)
        executor = Executor(frames=1, max_wait_s=60, timeout_s=5)
        kept = []

        def resident() -> int:
            return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()

        def work(_: CancellationToken) -> None:
            # What is freed lies below what is kept, so the heap does not shrink by itself.
            blocks = [bytes(2000) for _ in range(20_000)]
            kept.append(bytes(2000))
            del blocks

        before = resident()
        await executor.run(work, never, sender=ANYONE)
        assert resident() - before < 10_000_000


class TestParts:
    @pytest.mark.parametrize("frames", [1, 3])
    def test_results_come_in_the_order_of_the_parts(self, frames: int) -> None:
        executor = Executor(frames, max_wait_s=60, timeout_s=5)
        assert executor.map(lambda item: item**2, range(20)) == [i**2 for i in range(20)]
        assert executor.map(str, []) == []

    def test_several_are_worked_on_at_once(self) -> None:
        meeting = threading.Barrier(3, timeout=10)
        # Each waits for the others: one after the other they would wait in vain.
        executor = Executor(frames=3, max_wait_s=60, timeout_s=5)
        assert sorted(executor.map(lambda _: meeting.wait(), range(3))) == [0, 1, 2]

    @pytest.mark.parametrize("frames", [1, 2])
    def test_the_first_failure_reaches_the_caller(self, frames: int) -> None:
        executor = Executor(frames, max_wait_s=60, timeout_s=5)
        with pytest.raises(ZeroDivisionError):
            executor.map(lambda item: 1 // item, [1, 0, 2])

    def test_after_a_failure_no_further_part_begins(self) -> None:
        begun: list[int] = []

        def part(item: int) -> None:
            begun.append(item)
            raise ValueError(item)

        with pytest.raises(ValueError, match="0"):
            Executor(frames=1, max_wait_s=60, timeout_s=5).map(part, range(9))
        assert begun == [0]

    def test_a_failure_keeps_nothing_of_the_frame(self) -> None:
        class Picture:
            pass

        def part(_: Picture) -> None:
            raise ValueError

        executor = Executor(frames=1, max_wait_s=60, timeout_s=5)
        picture = Picture()
        kept = weakref.ref(picture)
        gc.disable()
        try:
            with contextlib.suppress(ValueError):
                executor.map(part, [picture] * 2)
            del picture
            assert kept() is None
        finally:
            gc.enable()

    async def test_a_new_frame_waits_for_no_part_of_another(self) -> None:
        executor = Executor(frames=2, max_wait_s=60, timeout_s=10)
        begun: queue.Queue[str] = queue.Queue()
        crowd = [f"person {number}" for number in range(8)]
        end = {name: threading.Event() for name in (*crowd, "mask")}

        def work(name: str) -> None:
            begun.put(name)
            assert end[name].wait(10)

        async def next_begun() -> str:
            return await to_thread.run_sync(lambda: begun.get(timeout=10))

        async with anyio.create_task_group() as tasks:
            tasks.start_soon(
                partial(executor.run, sender=ANYONE), lambda _: executor.map(work, crowd), never
            )
            assert {await next_begun(), await next_begun()} == {"person 0", "person 1"}
            tasks.start_soon(partial(executor.run, sender=ANYONE), lambda _: work("mask"), never)
            assert await next_begun() == "mask"
            # The frame's own thread goes on; the one that helped leaves its core to the mask.
            end["person 0"].set()
            end["person 1"].set()
            assert await next_begun() == "person 2"
            while executor._helping:
                await anyio.sleep(0.001)
            assert begun.empty()
            end["mask"].set()
            assert await next_begun() == "person 3"  # Whose thread helps now.
            for event in end.values():
                event.set()

    async def test_other_threads_help_all_frames_in_turn(self) -> None:
        executor = Executor(frames=3, max_wait_s=60, timeout_s=10)
        both_inside = threading.Barrier(2, timeout=10)
        begun = {name: threading.Event() for name in "ab"}
        end = threading.Event()
        helped: list[str] = []

        def frame(name: str) -> None:
            own = threading.get_ident()

            def part(_: int) -> None:
                if threading.get_ident() == own:
                    begun[name].set()
                    assert end.wait(10)
                    return
                assert all(event.wait(10) for event in begun.values())
                helped.append(name)
                if len(helped) == 8:
                    end.set()

            both_inside.wait()
            executor.map(part, range(5))

        async with anyio.create_task_group() as tasks:
            for name in begun:
                tasks.start_soon(
                    partial(executor.run, sender=ANYONE), lambda _, name=name: frame(name), never
                )
        # The first was taken before the other frame was divided.
        assert all(name != following for name, following in pairwise(helped[1:7]))

    async def test_frames_and_parts_know_the_request_they_belong_to(self) -> None:
        executor = Executor(frames=2, max_wait_s=60, timeout_s=5)
        meeting = threading.Barrier(2, timeout=10)  # Two threads have to come.

        def part(_: int) -> str:
            meeting.wait()
            return request_id.get()

        request_id.set("mine")
        assert await executor.run(lambda _: request_id.get(), never, sender=ANYONE) == "mine"
        assert (
            await executor.run(lambda _: executor.map(part, range(4)), never, sender=ANYONE)
            == ["mine"] * 4
        )


class TestReentry:
    """What could wait for itself raises instead."""

    async def test_a_frame_that_starts_another(self) -> None:
        executor = Executor(frames=1, max_wait_s=60, timeout_s=5)

        def work(_: CancellationToken) -> None:
            asyncio.run(executor.run(lambda _: None, never, sender=ANYONE))

        with pytest.raises(RuntimeError, match="not by another frame"):
            await executor.run(work, never, sender=ANYONE)

    @pytest.mark.parametrize("frames", [1, 2])
    async def test_a_part_that_is_divided(self, frames: int) -> None:
        executor = Executor(frames, max_wait_s=60, timeout_s=5)

        def part(_: int) -> list[str]:
            return executor.map(str, range(2))

        with pytest.raises(RuntimeError, match="not to be divided"):
            executor.map(part, range(4))
        with pytest.raises(RuntimeError, match="not to be divided"):
            await executor.run(lambda _: executor.map(part, range(4)), never, sender=ANYONE)


async def test_shutting_down_cancels_what_runs_and_drops_what_waits() -> None:
    executor = Executor(frames=2, max_wait_s=60, timeout_s=60)
    begun = threading.Semaphore(0)
    outcomes: list[str] = []

    def part(token: CancellationToken) -> None:
        begun.release()
        until_cancelled(token)

    async def frame() -> None:
        try:
            await executor.run(lambda token: executor.map(part, [token] * 9), never, sender=ANYONE)
        except (ClientGoneError, ShutdownError) as error:
            outcomes.append(type(error).__name__)

    async with anyio.create_task_group() as tasks:
        for _ in range(3):
            tasks.start_soon(frame)
        for _ in range(2):
            await to_thread.run_sync(begun.acquire)
        executor.shut_down()
        assert not any(thread.is_alive() for thread in executor._threads._threads)
    assert len(outcomes) == 3
    assert set(outcomes) == {"ClientGoneError", "ShutdownError"}
