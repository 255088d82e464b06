"""How the C library keeps freed memory: given back, rather than kept for each thread.

By default glibc keeps a heap for every thread and raises, with the first large array that is
freed, the size from which memory is given back. After a few frames the service would hold
half as much again as it uses (measured: 300 MB instead of 213 MB with two threads).
"""

from __future__ import annotations

import ctypes

# Names and numbers from glibc's malloc.h.
_M_TRIM_THRESHOLD = -1
_M_MMAP_THRESHOLD = -3
_M_ARENA_MAX = -8

_GIVEN_BACK_FROM_BYTES = 1024**2
_HEAPS = 2


def give_back_freed_memory() -> None:
    """Settle it for this process; where the C library is not glibc nothing happens."""
    try:
        mallopt = ctypes.CDLL("libc.so.6").mallopt
    except (OSError, AttributeError):
        return
    mallopt(_M_ARENA_MAX, _HEAPS)
    mallopt(_M_MMAP_THRESHOLD, _GIVEN_BACK_FROM_BYTES)
    mallopt(_M_TRIM_THRESHOLD, _GIVEN_BACK_FROM_BYTES)
