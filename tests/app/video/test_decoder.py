"""What the decoder of a video writes."""

from __future__ import annotations

import io
import struct
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app import camera
from app.video.decoder import END, FRAME, HEADER, MIN_STEP_S, TOO_LARGE, Clock, write_frames
from tests.conftest import ROOT
from tests.support.videos import noisy_frames, numbered_frames, write_video


def decode(path: Path, stride: int = 1, max_pixels: int = 10_000) -> list[tuple[object, ...]]:
    """Kind, number, timestamp and mean brightness of each frame, then what ends it."""
    out = io.BytesIO()
    write_frames(path, stride, max_pixels, out)
    out.seek(0)
    found: list[tuple[object, ...]] = []
    while header := out.read(HEADER.size):
        kind, number, width, height, timestamp, _ = HEADER.unpack(header)
        if kind == FRAME:
            pixels = np.frombuffer(out.read(width * height * 3), np.uint8)
            found.append((number, round(timestamp, 3), int(pixels.mean().round(-1))))
        else:
            found.append((kind, number, width, height))
    return found


@pytest.mark.parametrize(
    ("name", "codec"), [("v.avi", "MJPG"), ("v.mp4", "mp4v"), ("v.webm", "VP80")]
)
def test_frames_have_their_numbers_and_times(tmp_path: Path, name: str, codec: str) -> None:
    write_video(tmp_path / name, numbered_frames(8), codec)
    frames = decode(tmp_path / name)
    assert frames[:-1] == [(n, n / 10, 10 * n) for n in range(8)]
    assert frames[-1][:2] == (END, 8)


def test_stride_skips_frames(tmp_path: Path) -> None:
    write_video(tmp_path / "v.avi", numbered_frames(8))
    frames = decode(tmp_path / "v.avi", stride=3)
    assert frames == [(0, 0.0, 0), (3, 0.3, 30), (6, 0.6, 60), (END, 8, 0, 0)]


def test_truncated_file_ends_early(tmp_path: Path) -> None:
    path = tmp_path / "v.avi"
    data = write_video(path, noisy_frames(20))
    path.write_bytes(data[: len(data) // 2])
    kind, read, announced, _ = decode(path, max_pixels=100_000)[-1]
    assert kind == END
    assert 0 < int(str(read)) < int(str(announced)) == 20


def test_frames_counted_by_estimate_are_not_missed(tmp_path: Path) -> None:
    """Matroska has no count: it is estimated from the duration, here of the last frame."""
    path = tmp_path / "v.mkv"
    data = write_video(path, numbered_frames(8))
    duration = data.index(b"\x44\x89\x88") + 3
    path.write_bytes(data[:duration] + struct.pack(">d", 99_000.0) + data[duration + 8 :])
    assert decode(path)[-1] == (END, 8, 0, 0)


def test_stream_of_jpeg_pictures_is_read(tmp_path: Path) -> None:
    pictures = [cv2.imencode(".jpg", frame)[1].tobytes() for frame in numbered_frames(4)]
    (tmp_path / "v").write_bytes(b"".join(pictures))
    frames = decode(tmp_path / "v")
    assert frames == [(n, n / 25, 10 * n) for n in range(4)] + [(END, 4, 0, 0)]


@given(st.lists(st.floats(-1, 10) | st.sampled_from([0.0, 1e-4, 0.04, 0.0401, 1e12]), min_size=1))
def test_timestamps_ascend_by_what_a_session_takes(reported: list[float]) -> None:
    clock = Clock(25.0)
    times = [clock.timestamp(number, one) for number, one in enumerate(reported)]
    assert camera.MIN_STEP_S == MIN_STEP_S
    assert all(second >= first + MIN_STEP_S for first, second in pairwise(times))


def test_frames_of_too_many_pixels_are_not_decoded(tmp_path: Path) -> None:
    write_video(tmp_path / "v.avi", numbered_frames(3))
    assert decode(tmp_path / "v.avi", max_pixels=48 * 64 - 1) == [(TOO_LARGE, 0, 64, 48)]


@pytest.mark.parametrize("data", [b"", b"?", b"RIFF\xff\xff\xff\xffAVI LIST", b"\x00" * 5000])
def test_other_bytes_have_no_frames(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "v.avi").write_bytes(data)
    assert decode(tmp_path / "v.avi")[-1][:2] == (END, 0)


def test_no_other_file_is_opened(tmp_path: Path) -> None:
    write_video(tmp_path / "other.avi", numbered_frames(3))
    (tmp_path / "v.avi").write_text("ffconcat version 1.0\nfile other.avi\n")
    assert decode(tmp_path / "v.avi") == [(END, 0, 0, 0)]


def test_decoder_ends_quietly_when_its_output_is_closed(tmp_path: Path) -> None:
    write_video(tmp_path / "v.avi", numbered_frames(20, 480, 640))
    command = [sys.executable, "-m", "app.video.decoder", str(tmp_path / "v.avi")]
    command += ["--max-pixels", "1000000", "--max-seconds", "20"]
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        assert process.stdout.read(1) == FRAME
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(20) == 0
