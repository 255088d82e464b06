"""The frames of a video, as :mod:`app.video.decoder` writes them in a process of its own."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import sys
import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import IO, Literal

import numpy as np

from app.video import Frame

_FRAME_TIMEOUT_S = 20.0
_BUFFER_BYTES = 2**20
_MAX_LINE_BYTES = 300
_FORMATS = "AVI, MP4, MOV, Matroska, WebM, MPEG, FLV, ASF, Ogg, DV, GIF or MJPEG"
_NEEDED = ("PATH", "LD_LIBRARY_PATH", "PYTHONPATH", "PYTHONHOME", "PYTHONDONTWRITEBYTECODE", "LANG")
ROOT = Path(__file__).parents[2]
"""The decoder is run from here, so that it finds its modules."""

log = logging.getLogger("app")


class VideoError(ValueError):
    """A video, or the rest of it, cannot be used; the message is one sentence."""

    def __init__(self, reason: Literal["undecodable", "too_large"], message: str) -> None:
        super().__init__(message)
        self.reason = reason


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
        *(sys.executable, "-m", "app.video.decoder", str(file.fileno())),
        *("--stride", str(stride), "--max-pixels", str(max_pixels)),
        *("--max-seconds", str(int(max_seconds) + 1)),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        pass_fds=(file.fileno(),),
        cwd=ROOT,
        env=environment(),
        limit=_BUFFER_BYTES,
    )
    assert process.stdout is not None
    assert process.stderr is not None
    logged = asyncio.ensure_future(_log_last_line(process.stderr))
    try:
        yield VideoReader(process.stdout, max_pixels)
    finally:
        if process.returncode is None:
            process.kill()
        # asyncio reads no further ahead than its buffer: unread output would keep `wait` waiting.
        while await process.stdout.read(_BUFFER_BYTES):
            pass
        await process.wait()
        await logged


def environment() -> dict[str, str]:
    """What a decoder needs of the environment, which may hold keys and passwords."""
    needed = {name: value for name, value in os.environ.items() if name in _NEEDED}
    # Only the decoder's first thread is confined, so it must be the only one.
    return needed | {"OPENBLAS_NUM_THREADS": "1"}


async def _log_last_line(stream: asyncio.StreamReader) -> None:
    """Log the last line that the decoder writes to standard error, if any."""
    tail = b""
    while chunk := await stream.read(_BUFFER_BYTES):
        tail = (tail + chunk)[-_MAX_LINE_BYTES:]
    if lines := tail.decode(errors="replace").strip().splitlines():
        log.warning("decoding a video: %s", "".join(filter(str.isprintable, lines[-1])))


class VideoReader:
    """Frames of a video as they are decoded, from standard output of the decoder.

    A frame may have ``max_pixels``, and ``timeout_s`` may pass between two frames.
    """

    def __init__(
        self, stream: asyncio.StreamReader, max_pixels: int, timeout_s: float = _FRAME_TIMEOUT_S
    ) -> None:
        self._stream = stream
        self._max_pixels = max_pixels
        self._timeout_s = timeout_s
        self._read = 0

    async def next(self) -> Frame | None:
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
            raise self._broken("one that the decoder gave up on") from None
        except TimeoutError:
            raise self._broken(f"no frame within {self._timeout_s:g} seconds") from None

    async def _next(self) -> Frame | None:
        head = json.loads(await self._stream.readuntil(b"\n"))
        if "end" in head:
            if head["end"] is None:
                return None
            raise self._broken(head["end"])
        width, height = head.pop("width"), head.pop("height")
        if width * height > self._max_pixels:
            raise VideoError(
                "too_large",
                f"video: expected frames of at most {self._max_pixels} pixels, "
                f"got {width}x{height}",
            )
        pixels = await self._stream.readexactly(width * height * 3)
        self._read += 1
        picture = np.frombuffer(pixels, np.uint8).reshape(height, width, 3)
        return Frame(pixels=picture, **head)

    def _broken(self, found: str) -> VideoError:
        """The error for a video that ends early."""
        expected = "the whole video" if self._read else f"a video ({_FORMATS})"
        return VideoError("undecodable", f"video: expected {expected}, got {found}")
