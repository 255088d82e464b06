"""Cores by affinity and by quota, on a host with many of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from app.scheduling import process as cores
from app.settings import Settings

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
        # A container that is told its path on the host.
        (CONTAINER, {"cpu.max": "200000 100000\n"}, 2),
        # A service of systemd: its own quota, or that of the slice it is in.
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
    assert cores.available_cores() == expected
    assert Settings().concurrency == expected


def test_affinity_limits_the_cores(host: Host, monkeypatch: pytest.MonkeyPatch) -> None:
    host({"proc/self/cgroup": V2, "sys/fs/cgroup/cpu.max": "800000 100000\n"})
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 5, 7})
    assert cores.available_cores() == 3
