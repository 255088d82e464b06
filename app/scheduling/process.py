"""Settings of this process that are not Python's own: memory, threads and priorities.

Memory: by default glibc keeps a heap for every thread and raises, with the first large array
that is freed, the size from which memory is given back. After a few frames the service would
hold half as much again as it uses.

Cores: one thread answers requests, others work on frames. The first has little to do, but
every caller waits for it, so it has precedence.
"""

from __future__ import annotations

import ctypes
import gc
import logging
import math
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import cast

import cv2

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


# Names and numbers from glibc's malloc.h.
_M_TRIM_THRESHOLD = -1
_M_MMAP_THRESHOLD = -3
_M_ARENA_MAX = -8

# Larger than the pixels of a usual frame: pages given back after each frame are fetched anew for
# the next one, which costs more than decoding it.
_TRIM_THRESHOLD_BYTES = 8 * 1024**2
_ARENAS = 2

# How long a thread that runs Python keeps another one waiting. The thread that answers has to
# ask anew after every call to the system, several times a request; Python's default is 5 ms.
_SWITCH_INTERVAL_S = 0.001

_NICENESS = 5


def configure_process() -> None:
    """Set up the process of a server; nothing else that imports the service is changed."""
    configure_malloc()
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    cv2.setNumThreads(1)  # Work is divided among the executor's threads already.


def configure_malloc() -> None:
    """Bound the heaps of glibc; nothing happens where the C library is another one.

    By ``mallopt``, since glibc reads its environment variables before Python can set them: in the
    Dockerfile and the unit file they would not reach a plain ``python -m app``.
    """
    mallopt = _of_glibc("mallopt")
    if mallopt is None:
        return
    mallopt(_M_ARENA_MAX, _ARENAS)
    mallopt(_M_MMAP_THRESHOLD, _TRIM_THRESHOLD_BYTES)
    mallopt(_M_TRIM_THRESHOLD, _TRIM_THRESHOLD_BYTES)


def trim_heap() -> None:
    """Give free memory back to the system; nothing happens without glibc.

    It takes about a millisecond.
    """
    malloc_trim = _of_glibc("malloc_trim")
    if malloc_trim is not None:
        malloc_trim(0)


def _of_glibc(function: str) -> Callable[..., int] | None:
    try:
        return cast(Callable[..., int], getattr(ctypes.CDLL("libc.so.6"), function))
    except (OSError, AttributeError):
        return None


@contextmanager
def native_lines_logged(log: logging.Logger) -> Iterator[None]:
    """Log what libraries in C++ write to standard error meanwhile, so that all lines are alike.

    The networks' runtime has no other way to silence it.
    """
    if sys.platform != "linux":
        yield
        return
    with os.fdopen(os.memfd_create("stderr"), "w+b") as written:
        stderr = os.dup(2)
        os.dup2(written.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            written.seek(0)
            for line in written:
                log.info("%s", line.decode(errors="replace").strip())


def freeze_loaded_objects() -> None:
    """Exclude what is loaded so far from garbage collection.

    Looking through it all stops every thread for tens of milliseconds.
    """
    gc.collect()
    gc.freeze()
    # Python puts a full collection off until a quarter has been added to what the last one
    # found. This one finds next to nothing: what requests leave is collected soon.
    gc.collect()


def lower_thread_priority() -> None:
    """Have the system prefer the process's other threads to the calling one."""
    if sys.platform != "linux":  # Elsewhere a thread has no priority of its own.
        return
    thread = threading.get_native_id()
    wanted = min(19, os.getpriority(os.PRIO_PROCESS, os.getpid()) + _NICENESS)
    # Only a privileged process may raise it again.
    if os.getpriority(os.PRIO_PROCESS, thread) < wanted:
        os.setpriority(os.PRIO_PROCESS, thread, wanted)
