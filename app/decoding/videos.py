"""The frames of a video or a stream, decoded by a program that may be hostile afterwards."""

import asyncio
import logging
import os
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, suppress
from typing import IO, Any, Literal

import numpy as np
from numpy.typing import NDArray

from app.decoding import Frame
from app.decoding.confinement import UNDESCRIBED, BrokenOffError, Program

_MAX_CHARACTERS = 200
_SILENT_S = 20.0  # The program itself waits less for a stream.
_FORMATS = "AVI, MP4, MOV, Matroska, WebM, MPEG, FLV, ASF, Ogg, DV, GIF or MJPEG"
_ASPECTS = 1 / 8, 8.0  # Fields of a film have half the height.
# More than any camera has, and more seconds than any stream lasts.
_MOST_PIXELS, _MOST_SECONDS = 2**26, 2**31 - 2

NextFrame = Callable[[], Awaitable[Frame | None]]
"""Waits for the next frame; None at the end. Raises VideoError as :meth:`Decoder.frames`."""

log = logging.getLogger("app")


class VideoError(ValueError):
    """A video, or the rest of it, cannot be used; the message is one sentence."""

    def __init__(self, reason: Literal["undecodable", "too_large"], message: str) -> None:
        super().__init__(message)
        self.reason = reason


class Decoder:
    """A process that decodes a file, or a stream by its address, until this is closed.

    It takes every ``stride``-th frame, and at most one in each interval of the video's time, of up
    to ``max_pixels``. Decoding may take ``max_seconds`` of processor time.
    """

    def __init__(
        self,
        source: IO[bytes] | str,
        *,
        stride: int = 1,
        interval_s: float = 0.0,
        max_pixels: int = _MOST_PIXELS,
        max_seconds: float = _MOST_SECONDS,
    ) -> None:
        self._max_pixels, self._silent_s = max_pixels, _SILENT_S
        taken = ("--stride", stride, "--interval", interval_s)
        options = (*taken, "--max-pixels", max_pixels, "--max-seconds", int(max_seconds) + 1)
        if isinstance(source, str):
            self._program = Program("video_program", "--stream", *options)
            with suppress(BrokenPipeError):
                self._program.send(lambda: None, source.encode() + b"\n")
        else:
            self._program = Program("video_program", *options, source=source)

    def frames(self) -> Iterator[Frame]:
        """Yield the frames; raises VideoError if the video, or the rest, cannot be used."""
        expected = f"a video ({_FORMATS})"
        try:
            while (frame := self._next()) is not None:
                yield frame
                expected = "the whole video"
        except BrokenOffError as error:
            message = f"video: expected {expected}, got {error}"
            raise VideoError("undecodable", message) from None

    def kill(self) -> None:
        """End the process, so that a thread which waits for a frame goes on."""
        self._program.kill()

    def close(self) -> str:
        """End the process; return the last line of its complaints."""
        self._program.end()
        lines = self._program.said.decode(errors="replace").strip().splitlines()
        return "".join(filter(str.isprintable, lines[-1])) if lines else ""

    def _next(self) -> Frame | None:
        until = time.monotonic() + self._silent_s

        def check() -> None:
            if time.monotonic() > until:
                raise BrokenOffError(f"no frame within {self._silent_s:g} seconds")

        fields, data = self._program.receive(3 * self._max_pixels, check)
        if "end" not in fields:
            return _frame(fields, data)
        if fields["end"] is not None and fields.get("is_too_large"):
            most = f"frames of at most {self._max_pixels} pixels"
            raise VideoError("too_large", f"video: expected {most}, got {fields['end']}")
        if fields["end"] is not None:
            raise BrokenOffError(str(fields["end"])[:_MAX_CHARACTERS])
        return None


def _frame(fields: dict[str, Any], data: NDArray[np.uint8]) -> Frame:
    """The frame that a decoder describes; a hostile file may have taken the decoder over."""
    try:
        shape = fields.pop("height"), fields.pop("width"), 3
        frame = Frame(pixels=data.reshape(shape), **fields)
        times = 0 <= frame.timestamp < float("inf") and type(frame.number) is int
        is_sound = times and _ASPECTS[0] <= frame.pixel_aspect <= _ASPECTS[1] and min(shape) > 0
    except (KeyError, TypeError, ValueError):
        is_sound = False
    if not is_sound:
        raise BrokenOffError(UNDESCRIBED)
    return frame


def new_file() -> IO[bytes]:
    """Make a file without a name, in memory if there is such: no video should touch a disk."""
    if sys.platform == "linux":
        return os.fdopen(os.memfd_create("video"), "w+b")
    return tempfile.TemporaryFile()


@asynccontextmanager
async def open_video(
    file: IO[bytes], stride: int, max_pixels: int, max_seconds: float
) -> AsyncIterator[NextFrame]:
    """Decode every ``stride``-th frame of a video in a process that ends with the context."""
    file.flush()
    file.seek(0)
    decoder = Decoder(file, stride=stride, max_pixels=max_pixels, max_seconds=max_seconds)
    frames, loop = decoder.frames(), asyncio.get_running_loop()
    thread = ThreadPoolExecutor(1, "video")
    try:
        yield lambda: loop.run_in_executor(thread, next, frames, None)
    finally:
        decoder.kill()
        thread.shutdown()
        if said := decoder.close():
            log.warning("decoding a video: %s", said)
