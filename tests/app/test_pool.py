"""The work pool: bounded, refusing at once, and dropping what nobody waits for."""

from __future__ import annotations

import resource
import sys
import threading
import time
from pathlib import Path

import anyio
import pytest
from anyio import to_thread

from app.observation import request_id
from app.pool import ClientGoneError, DeadlineError, OverloadedError, Watch, WorkPool

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


async def never() -> None:
    await anyio.sleep_forever()


async def test_results_and_errors_pass_through() -> None:
    pool = WorkPool(threads=1, queue_length=0, timeout_s=5)
    assert await pool.run(lambda watch: 42, never) == 42
    with pytest.raises(KeyError, match="lost"):
        await pool.run(lambda watch: {}["lost"], never)
    assert pool.inside == 0


async def test_no_more_threads_than_allowed_work_at_once() -> None:
    pool = WorkPool(threads=2, queue_length=10, timeout_s=5)
    lock = threading.Lock()
    running, most = 0, 0

    def work(watch: Watch) -> None:
        nonlocal running, most
        with lock:
            running += 1
            most = max(most, running)
        time.sleep(0.02)
        with lock:
            running -= 1

    async with anyio.create_task_group() as tasks:
        for _ in range(10):
            tasks.start_soon(pool.run, work, never)
    assert most == 2


async def test_the_job_beyond_the_queue_is_refused_at_once() -> None:
    pool = WorkPool(threads=1, queue_length=1, timeout_s=5)
    release = threading.Event()
    async with anyio.create_task_group() as tasks:
        for _ in range(2):
            tasks.start_soon(pool.run, lambda watch: release.wait(), never)
        await anyio.wait_all_tasks_blocked()
        started = time.perf_counter()
        with pytest.raises(OverloadedError):
            await pool.run(lambda watch: None, never)
        assert time.perf_counter() - started < 0.05
        release.set()
    assert pool.inside == 0


async def test_a_waiting_job_is_dropped_when_its_client_hangs_up() -> None:
    pool = WorkPool(threads=1, queue_length=1, timeout_s=5)
    release, done = threading.Event(), []

    async def hang_up() -> None:
        await anyio.sleep(0.02)

    async with anyio.create_task_group() as tasks:
        tasks.start_soon(pool.run, lambda watch: release.wait(), never)
        await anyio.wait_all_tasks_blocked()
        with pytest.raises(ClientGoneError):
            await pool.run(lambda watch: done.append(1), hang_up)
        assert pool.inside == 1
        release.set()
    assert done == []


async def test_a_running_job_is_told_when_its_client_hangs_up() -> None:
    pool = WorkPool(threads=1, queue_length=0, timeout_s=5)
    steps = 0

    def work(watch: Watch) -> None:
        nonlocal steps
        while True:
            watch.check()
            steps += 1
            time.sleep(0.005)

    async def hang_up() -> None:
        await anyio.sleep(0.05)

    with pytest.raises(ClientGoneError):
        await pool.run(work, hang_up)
    assert 1 <= steps < 100


async def test_the_deadline_holds_for_work_and_for_waiting() -> None:
    pool = WorkPool(threads=1, queue_length=1, timeout_s=0.1)

    def work(watch: Watch) -> None:
        while True:
            watch.check()
            time.sleep(0.005)

    outcomes = []

    async def job() -> None:
        try:
            await pool.run(work, never)
        except DeadlineError as error:
            outcomes.append(str(error))

    with anyio.fail_after(1):
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(job)
            tasks.start_soon(job)
    assert len(outcomes) == 2
    assert pool.inside == 0


async def test_who_waited_in_vain_hears_that_the_service_was_busy() -> None:
    pool = WorkPool(threads=1, queue_length=1, timeout_s=0.1)
    release = threading.Event()
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(pool.run, lambda watch: release.wait(), never)
        await anyio.wait_all_tasks_blocked()
        with pytest.raises(DeadlineError, match="too busy"):
            await pool.run(lambda watch: None, never)
        release.set()


async def test_how_long_to_wait_follows_from_what_is_to_be_done() -> None:
    pool = WorkPool(threads=1, queue_length=9, timeout_s=10)
    assert pool.retry_after_s() == 1
    await pool.run(lambda watch: time.sleep(0.5), never)  # The mean is then at least 0.1 s.
    release = threading.Event()
    async with anyio.create_task_group() as tasks:
        for _ in range(10):
            tasks.start_soon(pool.run, lambda watch: release.wait(), never)
        await anyio.wait_all_tasks_blocked()
        assert 1 <= pool.retry_after_s() <= 10
        few = pool.retry_after_s()
        pool.inside *= 100
        assert few < pool.retry_after_s() == 10
        pool.inside //= 100
        release.set()


async def test_the_work_knows_whose_it_is() -> None:
    pool = WorkPool(threads=1, queue_length=1, timeout_s=5)
    request_id.set("mine")
    assert await pool.run(lambda watch: request_id.get(), never) == "mine"


async def test_a_request_that_is_cancelled_tells_its_work() -> None:
    pool = WorkPool(threads=1, queue_length=1, timeout_s=5)
    begun, told = threading.Event(), threading.Event()

    def work(watch: Watch) -> None:
        begun.set()
        try:
            while True:
                watch.check()
                time.sleep(0.005)
        except ClientGoneError:
            told.set()
            raise

    async with anyio.create_task_group() as tasks:
        tasks.start_soon(pool.run, work, never)
        await to_thread.run_sync(begun.wait)
        tasks.cancel_scope.cancel()
    assert await to_thread.run_sync(told.wait, 2)
    assert pool.inside == 0


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc, and needs glibc")
async def test_long_work_leaves_no_memory_behind() -> None:
    pool = WorkPool(threads=1, queue_length=0, timeout_s=5)
    kept = []

    def resident() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()

    def work(watch: Watch) -> None:
        # What is freed lies below what is kept, so the heap does not shrink by itself.
        blocks = [bytes(2000) for _ in range(20_000)]
        kept.append(bytes(2000))
        del blocks
        time.sleep(0.06)

    before = resident()
    await pool.run(work, never)
    assert resident() - before < 10_000_000
