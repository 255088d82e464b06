"""Frames of a video, and decoders that misbehave."""

from __future__ import annotations

import asyncio
from pathlib import Path

import numpy as np
import pytest

from app.video.decoder import END, FRAME, HEADER, TOO_LARGE
from app.video.reader import VideoError, VideoFrame, VideoReader, new_file, open_video
from tests.support.videos import noisy_frames, numbered_frames, write_video

pytestmark = pytest.mark.anyio


async def test_frames_of_an_unnamed_file_are_read(tmp_path: Path) -> None:
    with new_file() as file:
        file.write(write_video(tmp_path / "v.avi", numbered_frames(5)))
        async with open_video(file, stride=2, max_pixels=10_000, max_seconds=20) as video:
            frames = []
            while (frame := await video.next()) is not None:
                frames.append(frame)
    assert [(one.number, round(one.timestamp, 3)) for one in frames] == [(0, 0), (2, 0.2), (4, 0.4)]
    assert frames[2].pixels.shape == (48, 64, 3)
    assert abs(float(frames[2].pixels.mean()) - 40) < 3


def reading(*parts: bytes, ended: bool = True, timeout_s: float = 5) -> VideoReader:
    """A reader of what a decoder has written."""
    stream = asyncio.StreamReader()
    for part in parts:
        stream.feed_data(part)
    if ended:
        stream.feed_eof()
    return VideoReader(stream, max_pixels=100, timeout_s=timeout_s)


PICTURE = HEADER.pack(FRAME, 0, 2, 1, 0.0, 1.0) + bytes(range(6))


async def test_decoder_that_stops_is_reported() -> None:
    with pytest.raises(VideoError, match=r"a video \(AVI, .*\), got .* gave up"):
        await reading().next()
    reader = reading(PICTURE, PICTURE[:-1])
    assert isinstance(await reader.next(), VideoFrame)
    with pytest.raises(VideoError, match=r"the whole video, got .* gave up"):
        await reader.next()


async def test_words_of_the_decoder_are_for_the_log(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "app")
    with new_file() as file:
        file.write(b"\x00\x00\x00\x20ftypisom" + bytes(500))
        async with open_video(file, stride=1, max_pixels=10_000, max_seconds=20) as video:
            with pytest.raises(VideoError, match=r"got something else or a broken one$"):
                await video.next()
    (said,) = (record.message for record in caplog.records if record.name == "app")
    assert "moov atom not found" in said and "0x" not in said and "\n" not in said


async def test_matroska_that_is_cut_off_is_reported(tmp_path: Path) -> None:
    data = write_video(tmp_path / "v.mkv", noisy_frames(9))
    with new_file() as file:
        file.write(data[: len(data) // 2])
        async with open_video(file, stride=1, max_pixels=100_000, max_seconds=20) as video:
            with pytest.raises(VideoError, match="the whole video, got one that ends after"):
                while await video.next() is not None:
                    pass


async def test_decoder_that_hangs_is_reported() -> None:
    reader = reading(PICTURE, ended=False, timeout_s=0.05)
    frame = await reader.next()
    assert frame is not None
    assert np.array_equal(frame.pixels, [[[0, 1, 2], [3, 4, 5]]])
    with pytest.raises(VideoError, match=r"no frame within 0\.05 seconds"):
        await reader.next()


async def test_ends_of_a_video_are_distinguished() -> None:
    assert await reading(HEADER.pack(END, 97, 0, 0, 0.0, 1.0)).next() is None
    with pytest.raises(VideoError, match="got 40 of 100 frames"):
        await reading(HEADER.pack(END, 40, 100, 0, 0.0, 1.0)).next()
    with pytest.raises(VideoError, match="something else or a broken one"):
        await reading(HEADER.pack(END, 0, 0, 0, 0.0, 1.0)).next()
    with pytest.raises(VideoError, match="at most 100 pixels, got 40x30") as raised:
        await reading(HEADER.pack(TOO_LARGE, 7, 40, 30, 0.0, 1.0)).next()
    assert raised.value.reason == "too_large"
