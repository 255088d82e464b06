"""Processes that decode pictures for the service: started when needed, reused, killed when late."""

from __future__ import annotations

import json
import logging
import os
import resource
import select
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.decoding.worker import HEAD, TOO_EXPENSIVE
from app.vision.images import ImageError, ImageTooLargeError, turn_of

Checkpoint = Callable[[], None]
Decoded = tuple[NDArray[Any], tuple[Any, ...]]

# Processor time for the pictures of one upload. Sound ones of 12 megapixels take up to 1 s; all the
# while, a small frame may be waiting for the thread.
_MAX_SECONDS = 2.0
# Processor time of a process, after which another one takes its place.
_LIFETIME_S = 600
# Address space of a process: 70 MB at rest, of which 26 MB are in memory. A file may be there
# twice. A transparent WebP takes 28 bytes for each pixel, other files less.
_BASE_BYTES, _PER_BYTE, _PER_PIXEL = 100 * 1024**2, 2, 32
_CHECKED_EVERY_MS = 50
_MAX_JSON_BYTES = 10_000
_BYTES_PER_PIXEL = 3  # Of a photograph; labels have 1 or 2.
_LEAST_SECONDS = 0.01  # A timer of 0 s never ends.
# The program is run from here, so that it finds its modules.
_ROOT = Path(__file__).parents[2]

log = logging.getLogger("app")


def _memory(data_bytes: int, pixels: int = 0) -> int:
    """Address space for a file and its pixels."""
    return _BASE_BYTES + _PER_BYTE * data_bytes + _PER_PIXEL * pixels


class Allowance:
    """Processor time that is left for the pictures of one upload."""

    def __init__(self) -> None:
        self.seconds = _MAX_SECONDS


class Workers:
    """At most ``count`` processes, for files of ``max_bytes`` and ``max_pixels``."""

    def __init__(self, count: int, max_bytes: int, max_pixels: int) -> None:
        self._max_bytes = _memory(max_bytes, max_pixels)
        self._idle: list[_Worker] = []
        self._turns = SimpleQueue[None]()
        for _ in range(count):
            self._turns.put(None)

    def decode(
        self,
        data: bytes,
        *,
        is_mask: bool,
        max_pixels: int,
        allowance: Allowance,
        checkpoint: Checkpoint,
    ) -> Decoded:
        """Decode a photograph to its pixels and warnings, or a mask to its labels.

        ``checkpoint`` is called now and then; it raises an error if the result is not wanted.

        Raises
        ------
        ImageTooLargeError, ImageError
            As :func:`app.vision.images.decode_image` and :func:`app.vision.masks.decode_mask`, and
            if decoding takes more than the allowance or the memory of a process.
        """
        while True:
            try:
                self._turns.get(timeout=_CHECKED_EVERY_MS / 1000)
                break
            except Empty:
                checkpoint()
        try:
            worker = self._idle.pop() if self._idle else _Worker(self._max_bytes)
            asked = {"is_mask": is_mask, "max_pixels": max_pixels}
            try:
                return worker.decode(data, asked, allowance, checkpoint)
            finally:
                if worker.is_usable:
                    self._idle.append(worker)
                else:
                    worker.end()
        finally:
            self._turns.put(None)

    def close(self) -> None:
        """End the processes, none of which is in use."""
        while self._idle:
            self._idle.pop().end()


class _Worker:
    """A process that runs :mod:`app.decoding.worker`."""

    def __init__(self, max_bytes: int) -> None:
        self.is_usable = True
        self._is_ready = False
        self._seconds = 0.0
        self._process = subprocess.Popen(
            [
                *(sys.executable, "-m", "app.decoding.worker"),
                *("--max-seconds", str(2 * _LIFETIME_S), "--max-bytes", str(max_bytes)),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # What decoders remark about files.
            bufsize=0,
            cwd=_ROOT,
            # Only the program's first thread is confined, so it must be the only one.
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._in, self._out = self._process.stdin.fileno(), self._process.stdout.fileno()
        os.set_blocking(self._in, False)

    def decode(
        self, data: bytes, asked: dict[str, Any], allowance: Allowance, checkpoint: Checkpoint
    ) -> Decoded:
        """Decode a picture; unless the process is usable afterwards, it must be ended."""
        if not self._is_ready:
            self._wait_until_ready(checkpoint)
        self.is_usable = False
        head = json.dumps(asked | {"max_seconds": allowance.seconds}).encode()
        try:
            self._limit_memory(_memory(len(data)))
            for part in (HEAD.pack(len(head), len(data)), head, data):
                self._write(part, checkpoint)
            found, values = self._answer(0, checkpoint)
            if "pixels" in found:
                with turn_of(found["pixels"], checkpoint):
                    self._limit_memory(_memory(len(data), found["pixels"]))
                    self._write(b"\n", checkpoint)
                    found, values = self._answer(_BYTES_PER_PIXEL * asked["max_pixels"], checkpoint)
        except (EOFError, BrokenPipeError):
            raise ImageError(self._given_up()) from None
        allowance.seconds = max(_LEAST_SECONDS, allowance.seconds - found["seconds"])
        self._seconds += found["seconds"]
        self.is_usable = self._seconds < _LIFETIME_S
        if "error" in found:
            kind = ImageTooLargeError if found["is_too_large"] else ImageError
            raise kind(found["error"])
        return values.view(found["dtype"]).reshape(found["shape"]), tuple(found["warnings"])

    def end(self) -> None:
        """End the process and close the pipes."""
        self._process.kill()
        with self._process:
            pass

    def _wait_until_ready(self, checkpoint: Checkpoint) -> None:
        """Read the first answer; a process that is late with it is ready for the next picture."""
        self._wait_for(self._out, select.POLLIN, checkpoint)
        try:
            missing = self._answer(0, checkpoint)[0]["missing"]
        except EOFError:
            self.is_usable = False
            raise RuntimeError("the program that decodes pictures does not start") from None
        if missing:
            log.warning("pictures are decoded without seccomp: %s", missing)
        self._is_ready = True

    def _limit_memory(self, size: int) -> None:
        if sys.platform == "linux":
            _, most = resource.prlimit(self._process.pid, resource.RLIMIT_DATA)
            resource.prlimit(self._process.pid, resource.RLIMIT_DATA, (min(size, most), most))

    def _given_up(self) -> str:
        self._process.kill()
        if self._process.wait() != -signal.SIGPROF:
            return TOO_EXPENSIVE
        return (
            f"expected an image that takes at most {_MAX_SECONDS} s to decode, got one that takes "
            "longer; send it as JPEG or PNG"
        )

    def _answer(
        self, max_bytes: int, checkpoint: Checkpoint
    ) -> tuple[dict[str, Any], NDArray[np.uint8]]:
        """Read the JSON object that the program writes, and the bytes behind it."""
        head = HEAD.unpack(self._read(HEAD.size, checkpoint).tobytes())
        if head[0] > _MAX_JSON_BYTES or head[1] > max_bytes:
            raise EOFError
        found = json.loads(self._read(head[0], checkpoint).tobytes())
        return found, self._read(head[1], checkpoint)

    def _read(self, size: int, checkpoint: Checkpoint) -> NDArray[np.uint8]:
        read = np.empty(size, np.uint8)
        left = read.data
        while left:
            self._wait_for(self._out, select.POLLIN, checkpoint)
            got = os.readv(self._out, [left])
            if not got:
                raise EOFError
            left = left[got:]
        return read

    def _write(self, data: bytes, checkpoint: Checkpoint) -> None:
        left = memoryview(data)
        while left:
            self._wait_for(self._in, select.POLLOUT, checkpoint)
            left = left[os.write(self._in, left) :]

    def _wait_for(self, pipe: int, event: int, checkpoint: Checkpoint) -> None:
        poll = select.poll()
        poll.register(pipe, event)
        while not poll.poll(_CHECKED_EVERY_MS):
            checkpoint()
