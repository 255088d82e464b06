"""Cores this process may use: a container's or service's share, not the machine's."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path

ROOT = Path("/")
"""Where ``proc`` and ``sys`` are."""


def available_cores() -> int:
    """Return the cores that affinity and the quotas of the control groups [1]_ leave, at least 1.

    A part of a core counts as one.

    References
    ----------
    .. [1] Linux kernel, "Control Group v2", ``cpu.max``; "CFS Bandwidth Control" (v1).
    """
    allowed = len(os.sched_getaffinity(0))
    return max(1, math.ceil(min([allowed, *_quotas()])))


def _quotas() -> Iterator[float]:
    """Yield the quotas in cores of the process's control group and those above it."""
    for line in _read(ROOT / "proc/self/cgroup").splitlines():
        _, controllers, path = line.split(":", 2)
        if controllers and "cpu" not in controllers.split(","):
            continue
        mount = ROOT / "sys/fs/cgroup" / ("cpu" if controllers else "")
        # A container sees its own group at the mount, but may be told the path outside.
        group = Path(path.lstrip("/"))
        for folder in (mount / group, *(mount / parent for parent in group.parents)):
            if controllers:
                files = ("cpu.cfs_quota_us", "cpu.cfs_period_us")
                limit = [_read(folder / file).strip() for file in files]
            else:
                limit = _read(folder / "cpu.max").split()
            if len(limit) == 2 and all(number.isdigit() for number in limit):
                yield int(limit[0]) / int(limit[1])


def _read(file: Path) -> str:
    try:
        return file.read_text()
    except OSError:
        return ""
