"""Programs that decode in a process of their own: their limits, and how they are talked to.

A hostile file can make a decoder hang, crash, fill the memory or run code. There it cannot harm the
service, or the bridge that holds passwords: a confined program computes, reads what is open, and
writes; that of a stream receives it as well. What it writes is trusted with nothing.
"""

import ctypes
import errno
import fcntl
import json
import os
import resource
import select
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer

Checkpoint = Callable[[], None]
"""Called now and then; raises an error if what is waited for is no longer wanted, or late."""

# A message: the bytes of a JSON object, and of what follows it, then the two.
_HEAD = struct.Struct(">II")
# Not the keys and passwords that the environment may hold.
_NEEDED = ("PATH", "LD_LIBRARY_PATH", "PYTHONPATH", "PYTHONHOME", "PYTHONDONTWRITEBYTECODE", "LANG")
# Programs are run from here, so that they find their modules.
_ROOT = Path(__file__).parents[2]

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

UNDESCRIBED = "one that the decoder does not describe"


class BrokenOffError(Exception):
    """A program has ended, or does not write what it should; the message says what was found."""


class Program:
    """A confined program of this package, in a process of its own until it is ended.

    It reads ``source``, or else what is sent. ``said`` is what it last wrote to standard error.
    """

    def __init__(self, name: str, *options: object, source: IO[bytes] | None = None) -> None:
        environment = {name: value for name, value in os.environ.items() if name in _NEEDED}
        self._process = subprocess.Popen(
            [sys.executable, "-m", f"app.decoding.{name}", *map(str, options)],
            stdin=source or subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            bufsize=0,
            cwd=_ROOT,
            # Only the program's first thread is confined, so it must be the only one.
            env={**environment, "OPENBLAS_NUM_THREADS": "1"},
            start_new_session=True,  # The interrupt of a terminal is for its parent alone.
        )
        assert self._process.stdout is not None
        self.pid, self._out = self._process.pid, self._process.stdout.fileno()
        with suppress(OSError, AttributeError):  # Linux only, and within a user's allowance.
            fcntl.fcntl(self._out, fcntl.F_SETPIPE_SZ, 2**20)
        self.said = b""
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def send(self, checkpoint: Checkpoint, *parts: Buffer) -> None:
        """Write to its standard input; raises BrokenPipeError once it has ended."""
        assert self._process.stdin is not None
        pipe = self._process.stdin.fileno()
        os.set_blocking(pipe, False)
        for part in parts:
            left = memoryview(part)
            while left:
                _wait_for(pipe, select.POLLOUT, checkpoint)
                left = left[os.write(pipe, left) :]

    def send_message(
        self, checkpoint: Checkpoint, fields: Mapping[str, object], data: bytes
    ) -> None:
        """Send what :func:`read_message` reads; raises as :meth:`send` does."""
        text = json.dumps(fields).encode()
        self.send(checkpoint, _HEAD.pack(len(text), len(data)), text, data)

    def receive(
        self, max_bytes: int, checkpoint: Checkpoint
    ) -> tuple[dict[str, Any], NDArray[np.uint8]]:
        """Read what :func:`write_message` wrote, with at most so many bytes of data.

        Raises BrokenOffError if it wrote something else, or has ended.
        """
        text_bytes, data_bytes = _HEAD.unpack(self._read(_HEAD.size, checkpoint).data)
        try:
            if text_bytes > 10_000 or data_bytes > max_bytes:
                raise ValueError
            fields = dict(json.loads(self._read(text_bytes, checkpoint).tobytes()))
        except (ValueError, TypeError, RecursionError):
            raise BrokenOffError(UNDESCRIBED) from None
        return fields, self._read(data_bytes, checkpoint)

    def wait(self, checkpoint: Checkpoint) -> None:
        """Wait until there is something to receive."""
        _wait_for(self._out, select.POLLIN, checkpoint)

    def kill(self) -> None:
        """Kill the process; a thread that receives learns of it."""
        self._process.kill()

    def end(self) -> int:
        """Kill the process and close the pipes; return its exit status."""
        self.kill()
        self._listener.join()
        with self._process as process:
            pass
        return process.returncode

    def _read(self, size: int, checkpoint: Checkpoint) -> NDArray[np.uint8]:
        read = np.empty(size, np.uint8)
        left = read.data
        while left:
            self.wait(checkpoint)
            got = os.readv(self._out, [left])
            if not got:
                raise BrokenOffError("one that the decoder gave up on")
            left = left[got:]
        return read

    def _listen(self) -> None:
        assert self._process.stderr is not None
        while chunk := self._process.stderr.read(4096):
            self.said = (self.said + chunk)[-300:]


def _wait_for(pipe: int, event: int, checkpoint: Checkpoint) -> None:
    poll = select.poll()
    poll.register(pipe, event)
    checkpoint()
    while not poll.poll(50):
        checkpoint()


def read_message(source: BinaryIO) -> tuple[dict[str, Any], bytes] | None:
    """Read what was sent to this program; None at the end."""
    head = source.read(_HEAD.size)
    if not head:
        return None
    text_bytes, data_bytes = _HEAD.unpack(head)
    return json.loads(source.read(text_bytes)), source.read(data_bytes)


def write_message(out: BinaryIO, fields: Mapping[str, object], data: Buffer = b"") -> None:
    """Write an object, and bytes or a contiguous array, for :meth:`Program.receive`."""
    text = json.dumps(fields).encode()
    out.write(_HEAD.pack(len(text), memoryview(data).nbytes) + text)
    out.write(data)
    out.flush()


def confine(max_seconds: int, max_bytes: int, *, network: bool = False) -> str | None:
    """Limit this process; return why its system calls are not, None if they are."""
    limit_resources(max_seconds, max_bytes, network=network)
    try:
        forbid_system_calls(network=network)
    except OSError as error:
        return str(error)
    return None


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
    ``network``, sockets can be opened, and no files. Raises OSError if this system cannot do that.
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
