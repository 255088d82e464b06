"""Frames of a video, and decoders that misbehave."""

import asyncio
import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from app.video import Frame
from app.video.reader import VideoError, VideoReader, new_file, open_video
from tests.support.videos import numbered_frames, write_video

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


HEAD = {"width": 2, "height": 1, "number": 0, "timestamp": 0.0, "pixel_aspect": 1, "damaged": True}
PICTURE = json.dumps(HEAD).encode() + b"\n" + bytes(range(6))


async def test_decoder_that_stops_is_reported() -> None:
    with pytest.raises(VideoError, match=r"a video \(AVI, .*\), got .* gave up"):
        await reading().next()
    reader = reading(PICTURE, PICTURE[:-1])
    assert isinstance(await reader.next(), Frame)
    with pytest.raises(VideoError, match=r"the whole video, got .* gave up"):
        await reader.next()


async def test_words_of_the_decoder_are_for_the_log(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "executable", shutil.which("ls"))
    with new_file() as file:
        async with open_video(file, stride=1, max_pixels=10_000, max_seconds=20) as video:
            with pytest.raises(VideoError, match=r"gave up on$"):
                await video.next()
    (said,) = (record.message for record in caplog.records if record.name == "app")
    assert said.startswith("decoding a video: ") and "\n" not in said


async def test_decoder_that_hangs_is_reported() -> None:
    reader = reading(PICTURE, ended=False, timeout_s=0.05)
    frame = await reader.next()
    assert frame is not None and frame.damaged
    assert np.array_equal(frame.pixels, [[[0, 1, 2], [3, 4, 5]]])
    with pytest.raises(VideoError, match=r"no frame within 0\.05 seconds"):
        await reader.next()


async def test_ends_of_a_video_are_distinguished() -> None:
    assert await reading(b'{"end": null}\n').next() is None
    with pytest.raises(VideoError, match=r"a video \(AVI, .*\), got half of one"):
        await reading(b'{"end": "half of one"}\n').next()
    with pytest.raises(VideoError, match="at most 100 pixels, got 40x30") as raised:
        await reading(b'{"width": 40, "height": 30}\n').next()
    assert raised.value.reason == "too_large"
