"""How this process uses its memory and its cores, settled with C library and interpreter.

Memory: by default glibc keeps a heap for every thread and raises, with the first large array
that is freed, the size from which memory is given back. After a few frames the service would
hold half as much again as it uses.

Cores: one thread answers requests, others work on frames. The first has little to do, but
whoever waits for it waits for all of it; so it goes before the others.
"""

from __future__ import annotations

import ctypes
import gc
import os
import sys
import threading
from collections.abc import Callable
from typing import cast

import cv2

# Names and numbers from glibc's malloc.h.
_M_TRIM_THRESHOLD = -1
_M_MMAP_THRESHOLD = -3
_M_ARENA_MAX = -8

# Larger than the pixels of a usual frame: pages given back after each frame are fetched anew for
# the next one, which costs more than decoding it.
_GIVEN_BACK_FROM_BYTES = 8 * 1024**2
_HEAPS = 2

# How long a thread that runs Python keeps another one waiting. The thread that answers has to
# ask anew after every call to the system, several times a request; Python's default is 5 ms.
_SWITCH_S = 0.001

_NICENESS = 5


def give_back_freed_memory() -> None:
    """Settle it for this process; where the C library is not glibc nothing happens."""
    mallopt = _of_glibc("mallopt")
    if mallopt is None:
        return
    mallopt(_M_ARENA_MAX, _HEAPS)
    mallopt(_M_MMAP_THRESHOLD, _GIVEN_BACK_FROM_BYTES)
    mallopt(_M_TRIM_THRESHOLD, _GIVEN_BACK_FROM_BYTES)


def give_back_what_is_free() -> None:
    """Give back at once what was needed for a while; nothing happens without glibc.

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


def switch_threads_often() -> None:
    """Have Python hand over from a thread that works to the one that answers sooner."""
    sys.setswitchinterval(_SWITCH_S)


def leave_threads_to_the_service() -> None:
    """Keep OpenCV from dividing its work: frames, and the pictures in them, are divided already."""
    cv2.setNumThreads(1)


def leave_alone_what_stays() -> None:
    """Never again look for garbage among what is loaded so far.

    Looking through it all stops every thread for tens of milliseconds.
    """
    gc.collect()
    gc.freeze()
    # Python puts a full collection off until a quarter has been added to what the last one
    # found. This one finds next to nothing: what requests leave is collected soon.
    gc.collect()


def give_way() -> None:
    """Have the system prefer other threads of this process to the one that calls this."""
    if sys.platform != "linux":  # Elsewhere a thread has no priority of its own.
        return
    thread = threading.get_native_id()
    wanted = min(19, os.getpriority(os.PRIO_PROCESS, os.getpid()) + _NICENESS)
    # Never the other way: only a privileged process may take precedence.
    if os.getpriority(os.PRIO_PROCESS, thread) < wanted:
        os.setpriority(os.PRIO_PROCESS, thread, wanted)
