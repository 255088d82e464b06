"""The frames of a video, as :mod:`app.video.decoder` writes them in a process of its own."""

from __future__ import annotations

import asyncio
import logging
import os
import re
import sys
import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import IO, Literal

import numpy as np
from numpy.typing import NDArray

from app.video import decoder
from app.video.decoder import END, FRAME, HEADER, TOO_LARGE

_FRAME_TIMEOUT_S = 20.0
_LAST_LINE_TIMEOUT_S = 1.0
_BUFFER_BYTES = 2**20
_MAX_LINE_BYTES = 300
# FFmpeg's messages name addresses in memory.
_ADDRESS = re.compile(r" ?@ ?0x[0-9a-f]+")
_FORMATS = "AVI, MP4, MOV, Matroska, WebM, MPEG, FLV, ASF, Ogg or MJPEG"
# FFmpeg's message for a Matroska file that is cut off; other formats do not need it.
_CUT_OFF = "File ended prematurely"

log = logging.getLogger("app")


class VideoError(ValueError):
    """A video, or the rest of it, cannot be used; the message is one sentence."""

    def __init__(self, reason: Literal["undecodable", "too_large"], message: str) -> None:
        super().__init__(message)
        self.reason = reason


@dataclass(frozen=True)
class VideoFrame:
    """A frame of a video.

    Parameters
    ----------
    number : int
        Number in the video, from 0; skipped frames are included.
    timestamp : float
        Seconds since the video began; ascends.
    pixels : (H, W, 3) uint8 array
        BGR, as stored.
    pixel_aspect : float
        Width over height of a pixel.
    """

    number: int
    timestamp: float
    pixels: NDArray[np.uint8]
    pixel_aspect: float = 1.0


def new_file() -> IO[bytes]:
    """Make a file without a name for an upload, which cannot be left behind.

    It is in memory, since a video should not touch a disk, or on disk if the platform has no such
    files.
    """
    if sys.platform == "linux":
        return os.fdopen(os.memfd_create("video"), "w+b")
    return tempfile.TemporaryFile()


@asynccontextmanager
async def open_video(
    file: IO[bytes], stride: int, max_pixels: int, max_seconds: float
) -> AsyncIterator[VideoReader]:
    """Decode every ``stride``-th frame of a video in a process that ends with the context.

    A frame may have up to ``max_pixels``; decoding may take ``max_seconds`` of processor time.
    """
    file.flush()
    file.seek(0)
    process = await asyncio.create_subprocess_exec(
        # The program is named by its path, which is valid in any working directory.
        *(sys.executable, "-P", decoder.__file__, f"/dev/fd/{file.fileno()}"),
        *("--stride", str(stride), "--max-pixels", str(max_pixels)),
        *("--max-seconds", str(int(max_seconds) + 1)),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        pass_fds=(file.fileno(),),
        limit=_BUFFER_BYTES,
    )
    assert process.stdout is not None
    assert process.stderr is not None
    last_line = asyncio.ensure_future(_last_line(process.stderr))
    try:
        yield VideoReader(process.stdout, max_pixels, last_line=last_line)
    finally:
        if process.returncode is None:
            process.kill()
        # asyncio reads no further ahead than its buffer: unread output would keep `wait` waiting.
        while await process.stdout.read(_BUFFER_BYTES):
            pass
        await process.wait()
        last_line.cancel()


async def _last_line(stream: asyncio.StreamReader) -> str:
    """The last line that a process writes, once it has ended."""
    tail = b""
    while chunk := await stream.read(_BUFFER_BYTES):
        tail = (tail + chunk)[-_MAX_LINE_BYTES:]
    line = (tail.decode(errors="replace").strip().splitlines() or [""])[-1]
    return _ADDRESS.sub("", "".join(filter(str.isprintable, line)))


class VideoReader:
    """Frames of a video as they are decoded.

    Parameters
    ----------
    stream : StreamReader
        Standard output of the decoder.
    max_pixels : int
        Limit on a frame, for messages.
    timeout_s : float
        Limit on the time between two frames.
    last_line : Future of str, optional
        Last line that the decoder writes to standard error.
    """

    def __init__(
        self,
        stream: asyncio.StreamReader,
        max_pixels: int,
        timeout_s: float = _FRAME_TIMEOUT_S,
        last_line: asyncio.Future[str] | None = None,
    ) -> None:
        self._last_line = last_line
        self._stream = stream
        self._max_pixels = max_pixels
        self._timeout_s = timeout_s
        self._read = 0

    async def next(self) -> VideoFrame | None:
        """The next frame; None at the end.

        Raises
        ------
        VideoError
            If the video, or the rest of it, cannot be used.
        """
        try:
            async with asyncio.timeout(self._timeout_s):
                return await self._next()
        except asyncio.IncompleteReadError:
            raise self._broken("the decoder gave up", await self._said()) from None
        except TimeoutError:
            found = f"no frame within {self._timeout_s:g} seconds"
            raise self._broken(found, await self._said()) from None

    async def _next(self) -> VideoFrame | None:
        header = HEADER.unpack(await self._stream.readexactly(HEADER.size))
        kind, number, width, height, timestamp, aspect = header
        if kind == TOO_LARGE:
            raise VideoError(
                "too_large",
                f"video: expected frames of at most {self._max_pixels} pixels, "
                f"got {width}x{height}",
            )
        if kind == END:
            said = await self._said()
            if not number:
                raise self._broken("something else or a broken one", said)
            if width:
                raise self._broken(f"{number} of {width} frames", said)
            if _CUT_OFF in said:
                raise self._broken(f"one that ends after {number} frames", said)
            return None
        assert kind == FRAME
        pixels = await self._stream.readexactly(width * height * 3)
        self._read += 1
        picture = np.frombuffer(pixels, np.uint8).reshape(height, width, 3)
        return VideoFrame(number, timestamp, picture, aspect)

    async def _said(self) -> str:
        """The last line that the decoder writes; empty if it does not end in time."""
        if self._last_line is None:
            return ""
        # The decoder may hang, or have children that do.
        await asyncio.wait((self._last_line,), timeout=_LAST_LINE_TIMEOUT_S)
        return self._last_line.result() if self._last_line.done() else ""

    def _broken(self, found: str, said: str) -> VideoError:
        """The error for a video that ends early; what the decoder said goes to the log."""
        if said:
            log.info("a video cannot be read: %s", said)
        expected = "the whole video" if self._read else f"a video ({_FORMATS})"
        return VideoError("undecodable", f"video: expected {expected}, got {found}")
