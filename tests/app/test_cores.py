"""Cores by affinity and by quota, on a host with many of them."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path

import anyio
import pytest
from fastapi.testclient import TestClient

from app.estimation.estimator import Estimator
from app.main import create_app
from app.settings import Settings
from app.work import cores
from app.work.cancellation import CancellationToken
from app.work.executor import Executor
from app.work.line import Sender

Host = Callable[[dict[str, str]], None]


@pytest.fixture
def host(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Host:
    """Make this machine one of 64 cores with the given files."""

    def make(files: dict[str, str]) -> None:
        for name, text in files.items():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text(text)

    monkeypatch.setattr(cores, "ROOT", tmp_path)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: set(range(64)))
    return make


V2 = "0::/\n"
V1 = "3:cpuset:/\n1:cpu,cpuacct:/\n"
SLICE = "0::/system.slice/pose.service\n"


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({}, 64),
        ({"proc/self/cgroup": V2}, 64),
        ({"proc/self/cgroup": V2, "sys/fs/cgroup/cpu.max": "max 100000\n"}, 64),
        ({"proc/self/cgroup": V2, "sys/fs/cgroup/cpu.max": "200000 100000\n"}, 2),
        ({"proc/self/cgroup": V2, "sys/fs/cgroup/cpu.max": "150000 100000\n"}, 2),
        ({"proc/self/cgroup": V2, "sys/fs/cgroup/cpu.max": "10000 100000\n"}, 1),
        ({"proc/self/cgroup": V2, "sys/fs/cgroup/cpu.max": "9900000 100000\n"}, 64),
        # A container that is told its path on the host.
        (
            {
                "proc/self/cgroup": "0::/docker/1f\n",
                "sys/fs/cgroup/cpu.max": "200000 100000\n",
            },
            2,
        ),
        # A service of systemd: its own quota, or that of the slice it is in.
        (
            {
                "proc/self/cgroup": SLICE,
                "sys/fs/cgroup/system.slice/pose.service/cpu.max": "300000 100000\n",
            },
            3,
        ),
        (
            {
                "proc/self/cgroup": SLICE,
                "sys/fs/cgroup/system.slice/pose.service/cpu.max": "300000 100000\n",
                "sys/fs/cgroup/system.slice/cpu.max": "100000 50000\n",
            },
            2,
        ),
        (
            {
                "proc/self/cgroup": V1,
                "sys/fs/cgroup/cpu/cpu.cfs_quota_us": "200000\n",
                "sys/fs/cgroup/cpu/cpu.cfs_period_us": "100000\n",
            },
            2,
        ),
        (
            {
                "proc/self/cgroup": V1,
                "sys/fs/cgroup/cpu/cpu.cfs_quota_us": "-1\n",
                "sys/fs/cgroup/cpu/cpu.cfs_period_us": "100000\n",
            },
            64,
        ),
    ],
)
def test_the_quota_bounds_the_cores(host: Host, files: dict[str, str], expected: int) -> None:
    host(files)
    assert cores.available_cores() == expected


def test_the_affinity_bounds_the_cores(host: Host, monkeypatch: pytest.MonkeyPatch) -> None:
    host({"proc/self/cgroup": V2, "sys/fs/cgroup/cpu.max": "800000 100000\n"})
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 5, 7})
    assert cores.available_cores() == 3


def test_a_container_with_a_quota_of_two_runs_two_frames_at_once(
    host: Host, estimator: Estimator
) -> None:
    host({"proc/self/cgroup": V2, "sys/fs/cgroup/cpu.max": "200000 100000\n"})
    settings = Settings()
    assert settings.concurrency == 2
    app = create_app(settings, estimator)
    with TestClient(app):
        executor = app.state.runtime.executor
        assert executor.line.threads == 2
        assert anyio.run(most_at_once, executor) == 2


async def most_at_once(executor: Executor) -> int:
    """How many frames are worked on while as many as possible are inside."""
    lock, release = threading.Lock(), threading.Event()
    begun = 0

    def work(_: CancellationToken) -> None:
        nonlocal begun
        with lock:
            begun += 1
        assert release.wait(10)

    async with anyio.create_task_group() as tasks:
        for _ in range(4):
            tasks.start_soon(
                partial(executor.run, sender=Sender("anyone")), work, anyio.sleep_forever
            )
        while begun < 2:
            await anyio.sleep(0.001)
        await anyio.sleep(0.05)  # A third would begin by now.
        at_once = begun
        release.set()
    return at_once
