"""The operating system's settings of this process: memory, cores, priorities.

By default, glibc keeps a heap per thread, and raises the size above which it returns memory when
the first large array is freed: after a few frames, the service would hold 1.5 times what it uses.
"""

import ctypes
import gc
import logging
import math
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

ROOT = Path("/")  # Folder of `proc` and `sys`.


def available_cores() -> int:
    """The number of cores that affinity and the quotas of control groups [1]_ allow.

    At least 1; a fraction of a core counts as one.

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


# From glibc's malloc.h: M_TRIM_THRESHOLD, M_MMAP_THRESHOLD and M_ARENA_MAX. The thresholds are
# larger than the pixels of a usual frame: pages that are returned after it have to be fetched again
# for the next one, which costs more than decoding it.
_MALLOC_OPTIONS = {-1: 8 * 1024**2, -3: 8 * 1024**2, -8: 2}


_NICENESS = 5  # Of threads that work on frames: every client waits for the one that answers.


def configure_process() -> None:
    """Set up a server's process. Programs that only import the service stay unchanged."""
    import cv2  # Not above: reading the settings needs `available_cores` but no native library.

    # glibc reads its environment variables before Python can set them.
    for option, value in _MALLOC_OPTIONS.items():
        _call_glibc("mallopt", option, value)
    # Longest time a thread holds the interpreter while another waits for it. The event loop's
    # thread waits after every system call, several times a request; Python's default is 5 ms.
    sys.setswitchinterval(0.001)
    cv2.setNumThreads(1)  # The executor's threads share the work already.


def trim_heap() -> None:
    """Return free memory to the system, where glibc is the C library; takes about 1 ms."""
    _call_glibc("malloc_trim", 0)


def _call_glibc(function: str, *arguments: int) -> None:
    with suppress(OSError, AttributeError):  # Another C library.
        getattr(ctypes.CDLL("libc.so.6"), function)(*arguments)


@contextmanager
def native_lines_logged(log: logging.Logger) -> Iterator[None]:
    """Log what native libraries write to standard error: the networks' runtime is never silent."""
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
    """Exclude the objects loaded so far from garbage collection, which stops every thread."""
    gc.collect()
    gc.freeze()
    # Python delays a full collection until the objects have grown by a quarter since the last one,
    # which here finds next to nothing.
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
