"""The executor bounds concurrent work, is fair to frames, and drops abandoned ones."""

import asyncio
import contextlib
import gc
import queue
import threading
import time
import weakref
from collections.abc import Callable
from typing import Any

import anyio
import pytest
from anyio import to_thread

from app.http.routing import request_id
from app.scheduling.executor import Executor
from app.scheduling.job import BusyError, ClientGoneError, DeadlineError, Job
from app.scheduling.queue import OverloadedError, ShutdownError

pytestmark = pytest.mark.anyio


def executor_of(frames: int, max_wait_s: float = 60, timeout_s: float = 60) -> Executor:
    return Executor(frames, max_wait_s, timeout_s)


async def run(
    executor: Executor,
    work: Callable[[Job], Any],
    until_gone: Callable[[], Any] = anyio.sleep_forever,
    **options: Any,
) -> Any:
    return await executor.run(work, until_gone, caller="anyone", **options)


def until_cancelled(job: Job) -> None:
    while True:
        job.checkpoint()
        time.sleep(0.005)


class Picture:
    """An object that can be weakly referenced."""


class TestFrames:
    async def test_results_and_errors_pass_through(self) -> None:
        executor = executor_of(1)
        assert await run(executor, lambda _: 42) == 42
        with pytest.raises(KeyError, match="lost"):
            await run(executor, lambda _: {}["lost"])
        assert executor.queue.in_flight == 0

    async def test_the_number_of_concurrent_frames_is_bounded(self) -> None:
        executor = executor_of(2)
        lock = threading.Lock()
        running, most = 0, 0

        def work(_: Job) -> None:
            nonlocal running, most
            with lock:
                running += 1
                most = max(most, running)
            executor.map(time.sleep, [0.005] * 3)
            with lock:
                running -= 1

        async with anyio.create_task_group() as tasks:
            for _ in range(10):
                tasks.start_soon(run, executor, work)
        assert most == 2
        executor.shut_down()

    async def test_a_waiting_frame_is_dropped_when_its_client_disconnects(self) -> None:
        executor = executor_of(1)
        release, done = threading.Event(), []
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(run, executor, lambda _: release.wait(60))
            await anyio.wait_all_tasks_blocked()
            with pytest.raises(ClientGoneError):
                await run(executor, lambda _: done.append(1), lambda: anyio.sleep(0.02))
            assert executor.queue.in_flight == 1
            release.set()
        assert done == []

    async def test_a_frame_that_has_begun_is_finished(self) -> None:
        """Its client may only have closed its sending side."""
        begun = threading.Event()

        def work(_: Job) -> int:
            begun.set()
            time.sleep(0.1)
            return 7

        assert await run(executor_of(1), work, lambda: to_thread.run_sync(begun.wait)) == 7

    async def test_the_deadline_covers_work_and_waiting(self) -> None:
        executor = executor_of(1, timeout_s=0.2)
        outcomes = []

        def work(job: Job) -> None:
            time.sleep(1)  # So that the other frame waits for longer than it may.
            job.checkpoint()

        async def frame() -> None:
            with pytest.raises(BusyError) as caught:
                await run(executor, work)
            outcomes.append(type(caught.value))

        with anyio.fail_after(60):
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(frame)
                tasks.start_soon(frame)
        assert set(outcomes) == {DeadlineError, OverloadedError}
        assert executor.queue.in_flight == 0

    async def test_a_cancelled_request_cancels_its_work(self) -> None:
        executor = executor_of(1)
        begun, cancelled = threading.Event(), threading.Event()
        unheard: list[object] = []
        asyncio.get_running_loop().set_exception_handler(lambda *said: unheard.append(said))

        def work(job: Job) -> None:
            begun.set()
            try:
                until_cancelled(job)
            except ClientGoneError:
                cancelled.set()
                raise

        async with anyio.create_task_group() as tasks:
            tasks.start_soon(run, executor, work)
            await to_thread.run_sync(begun.wait, 60)
            tasks.cancel_scope.cancel()
        assert await to_thread.run_sync(cancelled.wait, 60)
        await to_thread.run_sync(executor.shut_down)
        gc.collect()
        assert executor.queue.in_flight == 0
        assert unheard == []

    @pytest.mark.parametrize("divided", [False, True])
    async def test_a_failed_frame_is_not_kept_in_memory(self, divided: bool) -> None:
        executor = executor_of(1)

        def fail(picture: Picture) -> None:
            raise ValueError(picture)

        async def frame(picture: Picture) -> None:
            with contextlib.suppress(ValueError):
                if divided:
                    executor.map(fail, [picture] * 2)
                else:
                    await run(executor, lambda _: fail(picture))

        picture = Picture()
        kept = weakref.ref(picture)
        gc.disable()
        try:
            await frame(picture)
            del picture
            # The thread lets go of its work only after the answer is there.
            with anyio.move_on_after(60):
                while kept() is not None:
                    await anyio.sleep(0.01)
            assert kept() is None
        finally:
            gc.enable()


class TestParts:
    @pytest.mark.parametrize("frames", [1, 3])
    def test_results_are_in_the_order_of_the_parts(self, frames: int) -> None:
        executor = executor_of(frames)
        assert executor.map(lambda item: item**2, range(20)) == [i**2 for i in range(20)]
        assert executor.map(str, []) == []

    @pytest.mark.parametrize("frames", [1, 2])
    def test_a_failure_is_raised_once_no_part_is_worked_on(self, frames: int) -> None:
        own, begun, ended = threading.get_ident(), [], []

        def part(item: int) -> None:
            begun.append(item)
            try:
                if threading.get_ident() == own:
                    raise ValueError(item)
                time.sleep(0.05)
            finally:
                ended.append(item)

        with pytest.raises(ValueError, match=r"\d"):
            executor_of(frames).map(part, range(9))
        assert sorted(begun) == sorted(ended)
        assert len(begun) < 9

    async def test_a_new_frame_waits_for_no_part_of_another(self) -> None:
        executor = executor_of(2)
        begun: queue.Queue[str] = queue.Queue()
        crowd = [f"person {number}" for number in range(4)]
        end = {name: threading.Event() for name in (*crowd, "mask")}

        def work(name: str) -> None:
            begun.put(name)
            assert end[name].wait(60)

        async def next_begun() -> str:
            return await to_thread.run_sync(lambda: begun.get(timeout=60))

        async with anyio.create_task_group() as tasks:
            tasks.start_soon(run, executor, lambda _: executor.map(work, crowd))
            assert {await next_begun(), await next_begun()} == {"person 0", "person 1"}
            tasks.start_soon(run, executor, lambda _: work("mask"))
            assert await next_begun() == "mask"
            for event in end.values():
                event.set()

    async def test_frames_and_parts_inherit_the_request_id(self) -> None:
        executor = executor_of(2)
        meeting = threading.Barrier(2, timeout=60)  # Needs two threads.

        def part(_: int) -> str:
            meeting.wait()
            return request_id.get()

        request_id.set("mine")
        assert await run(executor, lambda _: request_id.get()) == "mine"
        assert await run(executor, lambda _: executor.map(part, range(4))) == ["mine"] * 4


async def test_shutting_down_cancels_running_and_drops_waiting_frames() -> None:
    executor = executor_of(2)
    begun = threading.Semaphore(0)
    outcomes: list[str] = []

    def part(job: Job) -> None:
        begun.release()
        until_cancelled(job)

    async def frame() -> None:
        try:
            await run(executor, lambda job: executor.map(part, [job] * 9))
        except (ClientGoneError, ShutdownError) as error:
            outcomes.append(type(error).__name__)

    async with anyio.create_task_group() as tasks:
        for _ in range(3):
            tasks.start_soon(frame)
        for _ in range(2):
            assert await to_thread.run_sync(lambda: begun.acquire(timeout=60))
        executor.shut_down()
    assert len(outcomes) == 3
    assert set(outcomes) == {"ClientGoneError", "ShutdownError"}
