"""The limits of processes that decode: they compute, read what is open, and write.

That of a stream receives it as well.
"""

import ctypes
import errno
import os
import resource
import struct
import sys
from contextlib import suppress
from pathlib import Path

# Their numbers for seccomp.
_MACHINES = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}

# The system calls that decoding needs, with their numbers on each machine.
_ALLOWED = (
    ("read", 0, 63), ("write", 1, 64), ("close", 3, 57), ("lseek", 8, 62),
    ("mmap", 9, 222), ("munmap", 11, 215), ("mremap", 25, 216), ("mprotect", 10, 226),
    ("madvise", 28, 233), ("brk", 12, 214), ("futex", 202, 98), ("sched_yield", 24, 124),
    ("clock_gettime", 228, 113), ("getrandom", 318, 278), ("rt_sigaction", 13, 134),
    ("rt_sigprocmask", 14, 135), ("rt_sigreturn", 15, 139), ("exit", 60, 93),
    ("exit_group", 231, 94), ("setitimer", 38, 103),
)  # fmt: skip


# Those that a stream needs besides, to reach a camera by its number.
_NETWORK = (
    ("socket", 41, 198), ("connect", 42, 203), ("bind", 49, 200), ("sendto", 44, 206),
    ("sendmsg", 46, 211), ("recvfrom", 45, 207), ("recvmsg", 47, 212), ("shutdown", 48, 210),
    ("setsockopt", 54, 208), ("getsockopt", 55, 209), ("getsockname", 51, 204),
    ("getpeername", 52, 205), ("poll", 7, 73), ("ppoll", 271, 73), ("fcntl", 72, 25),
    ("nanosleep", 35, 101), ("clock_nanosleep", 230, 115),
)  # fmt: skip


def limit_resources(max_seconds: int, max_bytes: int, *, network: bool = False) -> None:
    """Limit memory and processor time, and let no file or socket be opened from now on.

    With ``network``, descriptors are not limited, since sockets have some.
    """
    # If memory runs out, the kernel ends this process first.
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000")
    for kind, limit in (
        (resource.RLIMIT_DATA, max_bytes),
        (resource.RLIMIT_CPU, max_seconds),
        (resource.RLIMIT_NOFILE, 0),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_CORE, 0),
    ):
        if network and kind == resource.RLIMIT_NOFILE:
            continue
        _, hard = resource.getrlimit(kind)
        resource.setrlimit(kind, (limit if hard < 0 else min(limit, hard),) * 2)


def forbid_system_calls(*, network: bool = False) -> None:
    """Let all system calls of this thread fail that decoding does not need, by seccomp.

    Nothing can then be opened, sent, run or forked, and no other process be traced or ended. With
    ``network``, sockets can be opened, and no files.

    Raises
    ------
    OSError
        If this system cannot do that.
    """
    machine = os.uname().machine
    if sys.platform != "linux" or sys.maxsize < 2**32 or machine not in _MACHINES:
        raise OSError(errno.ENOSYS, f"expected Linux on {' or '.join(_MACHINES)}")
    calls = _ALLOWED + (_NETWORK if network else ())
    allowed = [call[1 + list(_MACHINES).index(machine)] for call in calls]
    load, if_equal, answer = 0x20, 0x15, 0x06
    program = [
        # The machine, then the number of the call; jumps count the steps in between.
        (load, 0, 0, 4),
        (if_equal, 0, len(allowed) + 1, _MACHINES[machine]),
        (load, 0, 0, 0),
        *((if_equal, len(allowed) - step, 0, call) for step, call in enumerate(allowed)),
        (answer, 0, 0, 0x00050000 | errno.EPERM),
        (answer, 0, 0, 0x7FFF0000),
    ]
    steps = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *step) for step in program))
    filter_ = struct.pack("HP", len(program), ctypes.addressof(steps))
    # The system call seccomp would do more, but systemd's @system-service kills who calls it.
    set_no_new_privileges, set_seccomp, by_filter = 38, 22, 2
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(set_no_new_privileges, 1, 0, 0, 0) or libc.prctl(set_seccomp, by_filter, filter_):
        raise OSError(ctypes.get_errno(), "the kernel refuses seccomp")
