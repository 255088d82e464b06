"""The operating system's settings of this process: memory, cores, priorities.

Memory: by default, glibc keeps a heap per thread. When the first large array is freed, it also
raises the size above which it returns memory. After a few frames, the service would hold 1.5 times
what it uses.

Priorities: one thread answers requests, others work on frames. The first has little to do, but
every client waits for it, so it takes precedence.
"""

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

ROOT = Path("/")
"""Folder of ``proc`` and ``sys``."""


def available_cores() -> int:
    """Return the number of cores that affinity and the quotas of control groups [1]_ allow.

    It is at least 1; a fraction of a core counts as one.

    References
    ----------
    .. [1] Linux kernel, "Control Group v2", ``cpu.max``; "CFS Bandwidth Control" (v1).
    """
    if hasattr(os, "sched_getaffinity"):  # Not on macOS and Windows.
        allowed = len(os.sched_getaffinity(0))
    else:
        allowed = os.cpu_count() or 1
    return max(1, math.ceil(min([allowed, *_quotas()])))


def _quotas() -> Iterator[float]:
    """Yield the quotas in cores of the process's control group and those above it."""
    for line in _read(ROOT / "proc/self/cgroup").splitlines():
        _, controllers, path = line.split(":", 2)
        if controllers and "cpu" not in controllers.split(","):
            continue
        mount = ROOT / "sys/fs/cgroup" / ("cpu" if controllers else "")
        # A container sees its own group at the mount, but the path may be the host's.
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

# This is larger than the pixels of a usual frame: pages that are returned after a frame have to be
# fetched again for the next one, which costs more than decoding it.
_TRIM_THRESHOLD_BYTES = 8 * 1024**2
_ARENAS = 2

# Longest time a thread holds the interpreter while another waits for it. The event loop's thread
# waits after every system call, several times a request; Python's default is 5 ms.
_SWITCH_INTERVAL_S = 0.001

_NICENESS = 5


def configure_process() -> None:
    """Set up a server's process. Programs that only import the service stay unchanged."""
    # OpenCV is imported here because reading the settings needs `available_cores` but no native
    # library.
    import cv2

    _configure_malloc()
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    cv2.setNumThreads(1)  # The executor's threads share the work already.


def _configure_malloc() -> None:
    """Bound glibc's heaps, where glibc is the C library.

    This calls ``mallopt``, since glibc reads its environment variables before Python can set them:
    in the Dockerfile or the unit file they would not reach a plain ``python -m app``.
    """
    mallopt = _glibc("mallopt")
    if mallopt is not None:
        mallopt(_M_ARENA_MAX, _ARENAS)
        mallopt(_M_MMAP_THRESHOLD, _TRIM_THRESHOLD_BYTES)
        mallopt(_M_TRIM_THRESHOLD, _TRIM_THRESHOLD_BYTES)


def trim_heap() -> None:
    """Return free memory to the system, where glibc is the C library; takes about 1 ms."""
    malloc_trim = _glibc("malloc_trim")
    if malloc_trim is not None:
        malloc_trim(0)


def _glibc(function: str) -> Callable[..., int] | None:
    try:
        return cast(Callable[..., int], getattr(ctypes.CDLL("libc.so.6"), function))
    except (OSError, AttributeError):
        return None


@contextmanager
def native_lines_logged(log: logging.Logger) -> Iterator[None]:
    """Log what native libraries write to standard error, so that every line is JSON.

    The networks' runtime offers no other way to silence it.
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
    """Exclude the objects loaded so far from garbage collection.

    Traversing them all would stop every thread for tens of milliseconds.
    """
    gc.collect()
    gc.freeze()
    # Python delays a full collection until the objects have grown by a quarter since the last one.
    # This one finds next to nothing, so garbage from requests is collected soon.
    gc.collect()


def lower_thread_priority() -> None:
    """Make the system prefer the process's other threads to the calling thread."""
    if sys.platform != "linux":  # Elsewhere threads have no priority of their own.
        return
    thread = threading.get_native_id()
    wanted = min(19, os.getpriority(os.PRIO_PROCESS, os.getpid()) + _NICENESS)
    # Only privileged processes may raise a priority again.
    if os.getpriority(os.PRIO_PROCESS, thread) < wanted:
        os.setpriority(os.PRIO_PROCESS, thread, wanted)
