"""Frames of a video, and decoders that misbehave: a hostile stream may have taken one over."""

import json
import os
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.decoding import Frame
from app.decoding import videos as module
from app.decoding.confinement import _HEAD, Program
from app.decoding.videos import Decoder, VideoError, new_file, open_video
from tests.support.videos import numbered_frames, write_video


@pytest.mark.anyio
async def test_frames_of_an_unnamed_file_are_read(tmp_path: Path) -> None:
    with new_file() as file:
        file.write(write_video(tmp_path / "v.avi", numbered_frames(5)))
        async with open_video(file, stride=2, max_pixels=10_000, max_seconds=20) as next_frame:
            frames = []
            while (frame := await next_frame()) is not None:
                frames.append(frame)
    assert [(one.number, round(one.timestamp, 3)) for one in frames] == [(0, 0), (2, 0.2), (4, 0.4)]
    assert frames[2].pixels.shape == (48, 64, 3)
    assert abs(float(frames[2].pixels.mean()) - 40) < 3


def test_frames_of_a_file_come_at_the_rate_that_is_wanted(tmp_path: Path) -> None:
    write_video(tmp_path / "v.avi", numbered_frames(8), fps=10)
    with (tmp_path / "v.avi").open("rb") as file:
        decoder = Decoder(file, interval_s=0.2)
    frames = list(decoder.frames())
    assert decoder.close() == ""
    assert [round(one.timestamp, 2) for one in frames] == [0.0, 0.2, 0.4, 0.6]
    assert [round(float(one.pixels.mean()), -1) for one in frames] == [0, 20, 40, 60]


@pytest.mark.anyio
async def test_words_of_the_decoder_are_for_the_log(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "executable", shutil.which("ls"))
    with new_file() as file:
        async with open_video(file, stride=1, max_pixels=10_000, max_seconds=20) as next_frame:
            with pytest.raises(VideoError, match=r"gave up on$"):
                await next_frame()
    (said,) = (record.message for record in caplog.records if record.name == "app")
    assert said.startswith("decoding a video: ") and "\n" not in said


@pytest.mark.anyio
async def test_a_frame_that_nobody_waits_for_any_more_ends_with_the_decoder() -> None:
    with new_file() as file:
        file.write(b"RIFF")
        async with open_video(file, stride=1, max_pixels=10_000, max_seconds=20) as next_frame:
            waiting = next_frame()
            waiting.cancel()  # type: ignore[attr-defined]


HEAD = {"width": 2, "height": 1, "number": 0, "timestamp": 0.0, "pixel_aspect": 1, "damaged": True}


def message(text: bytes | dict[str, Any], data: bytes = b"") -> bytes:
    written = text if isinstance(text, bytes) else json.dumps(text).encode()
    return _HEAD.pack(len(written), len(data)) + written + data


PICTURE = message(HEAD, bytes(range(6)))


def read(written: bytes, *, ends: bool = True) -> list[Frame]:
    """The frames of what a decoder has written."""
    ours, theirs = os.pipe()
    os.write(theirs, written)
    if ends:
        os.close(theirs)
    program = object.__new__(Program)
    program._out = ours
    decoder = object.__new__(Decoder)
    decoder._program, decoder._max_pixels, decoder._silent_s = program, 100, module._SILENT_S
    try:
        return list(decoder.frames())
    finally:
        os.close(ours)


def test_frames_and_the_end_are_read() -> None:
    (frame,) = read(PICTURE + message({"end": None}))
    assert frame.damaged and np.array_equal(frame.pixels, [[[0, 1, 2], [3, 4, 5]]])


@pytest.mark.parametrize(
    ("written", "said"),
    [
        (b"", "a video .*, got .* gave up"),
        (PICTURE + PICTURE[:-1], "the whole video, got .* gave up"),
        (b"x" * 1000, "does not describe"),
        *((message(text), "does not describe") for text in (
            b"{", b"[1]", b"7", b"\xff", b"[" * 9999)),
        *((message(HEAD | wrong, bytes(6)), "does not describe") for wrong in (
            {"timestamp": "soon"}, {"timestamp": float("nan")}, {"timestamp": float("inf")},
            {"width": 3}, {"width": -2}, {"width": -1, "height": -1}, {"width": 1e3}, {"width": 0},
            {"number": "1"}, {"number": None}, {"pixel_aspect": 1e9}, {"pixel_aspect": None},
            {"more": 1})),
        (message({"width": 9}), "does not describe"),
        (message(HEAD, bytes(301)), "does not describe"),
        (message({"end": "a ZIP archive"}), r"a video \(AVI, .*\), got a ZIP archive"),
        (message({"end": "40x30", "is_too_large": True}), "at most 100 pixels, got 40x30"),
    ],
)  # fmt: skip
def test_what_no_decoder_writes_is_an_error(written: bytes, said: str) -> None:
    with pytest.raises(VideoError, match=said) as raised:
        read(written)
    assert raised.value.reason == ("too_large" if "40x30" in said else "undecodable")


def test_a_decoder_that_hangs_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_SILENT_S", 0.1)
    with pytest.raises(VideoError, match=r"no frame within 0\.1 seconds"):
        read(PICTURE[:9], ends=False)
