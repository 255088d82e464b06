"""A Dask cluster gives the same bytes as threads, or an error in one sentence."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from index.build import simulate as simulate_module
from index.build.body import Avatar
from index.build.parameters import RENDERING
from index.build.poses import Poses
from index.build.shard_files import ShardError
from index.build.simulate import Simulation, bounded_map, simulate
from tests.conftest import ROOT
from tests.index.build.test_simulate import assert_same
from tests.support.ports import free_ports
from tests.support.programs import run

distributed = pytest.importorskip("distributed", reason="needs the extra cluster")
from index.build import cluster as module  # noqa: E402
from index.build.cluster import cluster_executor  # noqa: E402


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """Address of a cluster of two threads in this process."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=":0",
        protocol="tcp", host="127.0.0.1",
    ) as local:  # fmt: skip
        yield local.scheduler_address


@pytest.fixture
def small_shards(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulate_module, "RENDERING", replace(RENDERING, shard_poses=5))


@pytest.mark.usefixtures("small_shards")
def test_draws_the_same_bytes_as_threads(
    scheduler: str, poses: Poses, avatars: list[Avatar], simulation: Simulation, tmp_path: Path
) -> None:
    with cluster_executor(scheduler) as executor:
        shared = simulate(
            poses, avatars, bodies=1, views=12, seed=7, executor=executor, folder=tmp_path
        )
    assert len(list(tmp_path.glob("shard-*"))) == 10
    assert_same(shared, simulation)


def test_results_come_in_order(scheduler: str) -> None:
    with cluster_executor(scheduler) as executor:
        tasks = ((number,) for number in range(-50, 0))
        assert list(bounded_map(executor, abs, tasks, 8)) == list(range(50, 0, -1))


def test_an_error_of_a_task_is_raised_here(scheduler: str) -> None:
    with cluster_executor(scheduler) as executor, pytest.raises(OverflowError):
        list(bounded_map(executor, np.int8, ((1,), (2,), (300,))))


def connect(address: str, **settings: float) -> None:
    with cluster_executor(address, **settings):
        pass


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:{port}", "nonsense", "http://127.0.0.1:1"])
def test_says_that_no_scheduler_answers(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RENDERING", replace(RENDERING, connect_s=0.3))
    address = address.format(port=free_ports(1)[0])
    with pytest.raises(ShardError, match=f"no Dask scheduler answers at {address}"):
        connect(address)


def test_another_server_is_no_scheduler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RENDERING", replace(RENDERING, connect_s=0.3))
    with socket.create_server(("127.0.0.1", 0)) as stranger:
        address = f"tcp://127.0.0.1:{stranger.getsockname()[1]}"
        with pytest.raises(ShardError, match="no Dask scheduler answers"):
            connect(address)


def test_a_worker_is_no_scheduler(scheduler: str) -> None:
    with distributed.Client(scheduler) as client:
        (worker, _) = client.scheduler_info()["workers"]
    with pytest.raises(ShardError, match="no Dask scheduler answers"):
        connect(worker)


def test_says_that_no_worker_joined() -> None:
    with (
        distributed.LocalCluster(
            n_workers=0, processes=False, dashboard_address=":0", protocol="tcp", host="127.0.0.1"
        ) as local,
        pytest.raises(ShardError, match=r"no worker joined tcp.* in 0\.2 s"),
    ):
        connect(local.scheduler_address, first_worker_s=0.2)


@pytest.mark.slow
def test_an_unreachable_scheduler_ends_the_command_in_a_sentence(tmp_path: Path) -> None:
    address = f"tcp://127.0.0.1:{free_ports(1)[0]}"
    command = ("build", "--scheduler", address, "--out", tmp_path / "out" / "index")
    built = run(sys.executable, "-m", "scripts", *command)
    assert built.returncode == 1
    assert built.stderr == f"build: no Dask scheduler answers at {address}\n"
    assert list(tmp_path.iterdir()) == []


@contextmanager
def dask(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(
        [sys.executable, "-m", "dask", *arguments, "--no-dashboard"],
        cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        env={**os.environ, "DASK_DISTRIBUTED__SCHEDULER__NO_WORKERS_TIMEOUT": "3s"},
    )  # fmt: skip
    try:
        yield process
    finally:
        process.kill()
        process.wait()


class Interrupted(Executor):
    """An executor, and something that happens once it has finished a few tasks."""

    def __init__(self, executor: Executor, happens: Callable[[], None]) -> None:
        self._executor, self._happens, self._finished = executor, happens, count(1)

    def submit(self, function: Callable[..., Any], /, *task: Any) -> Future[Any]:  # type: ignore[override]
        future = self._executor.submit(function, *task)
        future.add_done_callback(self._note)
        return future

    def _note(self, _: Future[Any]) -> None:
        if next(self._finished) == 3:
            self._happens()


@pytest.mark.slow
@pytest.mark.usefixtures("small_shards")
class TestProcesses:
    @pytest.fixture
    def stack(self) -> Iterator[ExitStack]:
        with ExitStack() as stack:
            yield stack

    @pytest.fixture
    def processes(self, stack: ExitStack, tmp_path: Path) -> list[subprocess.Popen[bytes]]:
        """A scheduler and two workers without nannies."""
        port = str(free_ports(1)[0])
        self.address = f"tcp://127.0.0.1:{port}"
        started = [stack.enter_context(dask("scheduler", "--host", "127.0.0.1", "--port", port))]
        for _ in range(2):
            worker = dask(
                "worker", self.address, "--nthreads", "1", "--no-nanny",
                "--local-directory", str(tmp_path / "scratch"),
            )  # fmt: skip
            started.append(stack.enter_context(worker))
        until = time.monotonic() + 60
        while True:
            try:
                with distributed.Client(self.address, timeout=1) as client:
                    client.wait_for_workers(2, timeout=60)
                    return started
            except OSError:
                assert time.monotonic() < until

    def simulated(
        self, poses: Poses, avatars: list[Avatar], folder: Path, happens: Callable[[], None]
    ) -> Simulation:
        with cluster_executor(self.address) as executor:
            return simulate(
                poses, avatars, bodies=1, views=12, seed=7,
                executor=Interrupted(executor, happens), folder=folder,
            )  # fmt: skip

    def test_a_killed_worker_costs_its_tasks_only(
        self, processes: list[subprocess.Popen[bytes]], poses: Poses, avatars: list[Avatar],
        simulation: Simulation, tmp_path: Path,
    ) -> None:  # fmt: skip
        built = self.simulated(
            poses, avatars, tmp_path / "s", lambda: os.kill(processes[1].pid, signal.SIGKILL)
        )
        assert processes[1].wait(10) == -signal.SIGKILL
        assert_same(built, simulation)

    @pytest.mark.parametrize(
        ("killed", "message"),
        [((0,), "lost the Dask scheduler"), ((1, 2), "no worker of .* is left")],
    )
    def test_reports_what_was_lost(
        self, processes: list[subprocess.Popen[bytes]], poses: Poses, avatars: list[Avatar],
        tmp_path: Path, killed: tuple[int, ...], message: str,
    ) -> None:  # fmt: skip
        def kill() -> None:
            for number in killed:
                processes[number].kill()

        with pytest.raises(ShardError, match=message):
            self.simulated(poses, avatars, tmp_path / "s", kill)
