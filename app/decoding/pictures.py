"""Processes that decode pictures for the service: started when needed, reused, killed when late."""

from __future__ import annotations

import logging
import resource
import signal
import sys
from queue import Empty, SimpleQueue
from typing import Any

from numpy.typing import NDArray

from app.decoding.confinement import BrokenOffError, Checkpoint, Program
from app.decoding.picture_program import TOO_EXPENSIVE
from app.vision.images import ImageError, ImageTooLargeError, turn_of

Decoded = tuple[NDArray[Any], tuple[Any, ...]]

# Processor time for the pictures of one upload, while a small frame may be waiting for the thread.
# Sound ones of 12 megapixels take up to 1 s.
_MAX_SECONDS = 2.0
_LIFETIME_S = 600  # Processor time of a process, after which another one takes its place.
_CHECKED_EVERY_S = 0.05
_BYTES_PER_PIXEL = 3  # Of a photograph; labels have 1 or 2.

log = logging.getLogger("app")


def _memory(data_bytes: int, pixels: int = 0) -> int:
    """Address space for a file and its pixels."""
    # 70 MB at rest, of which 26 MB are in memory. A file may be there twice. A transparent WebP
    # takes 28 bytes for each pixel, other files less.
    return 100 * 1024**2 + 2 * data_bytes + 32 * pixels


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

        Raises as :func:`app.vision.images.decode_image` and :func:`app.vision.masks.decode_mask`,
        and ImageError if it takes more than the allowance or the memory of a process.
        """
        while True:
            try:
                self._turns.get(timeout=_CHECKED_EVERY_S)
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
    """A process that runs :mod:`app.decoding.picture_program`."""

    def __init__(self, max_bytes: int) -> None:
        self.is_usable = True
        self._is_ready = False
        self._seconds = 0.0
        limits = ("--max-seconds", 2 * _LIFETIME_S, "--max-bytes", max_bytes)
        self._program = Program("picture_program", *limits)

    def decode(
        self, data: bytes, asked: dict[str, Any], allowance: Allowance, checkpoint: Checkpoint
    ) -> Decoded:
        """Decode a picture; unless the process is usable afterwards, it must be ended."""
        if not self._is_ready:
            self._wait_until_ready(checkpoint)
        self.is_usable = False
        program, limited = self._program, asked | {"max_seconds": allowance.seconds}
        try:
            self._limit_memory(_memory(len(data)))
            program.send_message(checkpoint, limited, data)
            found, values = program.receive(0, checkpoint)
            if "pixels" in found:
                with turn_of(found["pixels"], checkpoint):
                    self._limit_memory(_memory(len(data), found["pixels"]))
                    program.send_message(checkpoint, {}, b"")
                    most = _BYTES_PER_PIXEL * asked["max_pixels"]
                    found, values = program.receive(most, checkpoint)
        except (BrokenOffError, BrokenPipeError):
            raise ImageError(self._given_up()) from None
        # A timer of 0 s never ends.
        allowance.seconds = max(0.01, allowance.seconds - found["seconds"])
        self._seconds += found["seconds"]
        self.is_usable = self._seconds < _LIFETIME_S
        if "error" in found:
            kind = ImageTooLargeError if found["is_too_large"] else ImageError
            raise kind(found["error"])
        return values.view(found["dtype"]).reshape(found["shape"]), tuple(found["warnings"])

    def end(self) -> int:
        """End the process; return its exit status."""
        return self._program.end()

    def _wait_until_ready(self, checkpoint: Checkpoint) -> None:
        """Read the first message; a process that is late with it is ready for the next picture."""
        self._program.wait(checkpoint)
        try:
            missing = self._program.receive(0, lambda: None)[0]["missing"]
        except BrokenOffError:
            self.is_usable = False
            raise RuntimeError("the program that decodes pictures does not start") from None
        if missing:
            log.warning("pictures are decoded without seccomp: %s", missing)
        self._is_ready = True

    def _limit_memory(self, size: int) -> None:
        if sys.platform == "linux":
            _, most = resource.prlimit(self._program.pid, resource.RLIMIT_DATA)
            resource.prlimit(self._program.pid, resource.RLIMIT_DATA, (min(size, most), most))

    def _given_up(self) -> str:
        if self.end() != -signal.SIGPROF:
            return TOO_EXPENSIVE
        return (
            f"expected an image that takes at most {_MAX_SECONDS} s to decode, got one that takes "
            "longer; send it as JPEG or PNG"
        )
