"""Cores, priorities and settings of the process."""

import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from app.scheduling import process
from app.settings import Settings

Host = Callable[[dict[str, str]], None]


@pytest.fixture
def host(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Host:
    """Make this machine look like one of 64 cores with the given files."""

    def make(files: dict[str, str]) -> None:
        for name, text in files.items():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text(text)

    monkeypatch.setattr(process, "ROOT", tmp_path)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: set(range(64)))
    return make


V2 = "0::/\n"
V1 = "3:cpuset:/\n1:cpu,cpuacct:/\n"
SLICE = "0::/system.slice/pose.service\n"
CONTAINER = "0::/docker/1f\n"


@pytest.mark.parametrize(
    ("group", "quotas", "expected"),
    [
        (None, {}, 64),
        (V2, {}, 64),
        (V2, {"cpu.max": "max 100000\n"}, 64),
        (V2, {"cpu.max": "200000 100000\n"}, 2),
        (V2, {"cpu.max": "150000 100000\n"}, 2),
        (V2, {"cpu.max": "10000 100000\n"}, 1),
        (V2, {"cpu.max": "9900000 100000\n"}, 64),
        # A container whose path is the host's.
        (CONTAINER, {"cpu.max": "200000 100000\n"}, 2),
        # A systemd service: its own quota, or that of its slice.
        (SLICE, {"system.slice/pose.service/cpu.max": "300000 100000\n"}, 3),
        (
            SLICE,
            {
                "system.slice/pose.service/cpu.max": "300000 100000\n",
                "system.slice/cpu.max": "100000 50000\n",
            },
            2,
        ),
        (V1, {"cpu/cpu.cfs_quota_us": "200000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 2),
        (V1, {"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, 64),
    ],
)
def test_quotas_limit_the_cores(
    host: Host, group: str | None, quotas: dict[str, str], expected: int
) -> None:
    files = {f"sys/fs/cgroup/{name}": text for name, text in quotas.items()}
    host(files | ({"proc/self/cgroup": group} if group else {}))
    assert process.available_cores() == expected
    assert Settings().concurrency == expected


def test_affinity_limits_the_cores(host: Host, monkeypatch: pytest.MonkeyPatch) -> None:
    host({"proc/self/cgroup": V2, "sys/fs/cgroup/cpu.max": "800000 100000\n"})
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 5, 7})
    assert process.available_cores() == 3


def test_worker_threads_have_a_lower_priority() -> None:
    priorities: list[int] = []

    def work() -> None:
        for _ in range(2):  # Lowering it twice is the same as once.
            process.lower_thread_priority()
            priorities.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id()))

    worker = threading.Thread(target=work)
    worker.start()
    worker.join()
    own = os.getpriority(os.PRIO_PROCESS, os.getpid())
    assert priorities == [min(19, own + 5)] * 2
