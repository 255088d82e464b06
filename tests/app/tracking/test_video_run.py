"""The frames of a video, and why they end."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest

from app.camera import CameraSession, LateFrameError
from app.estimation.upload import UploadError
from app.film import VideoEnd, VideoRun
from app.photograph import Estimator
from app.scheduling.executor import Executor
from app.scheduling.job import ClientGoneError, DeadlineError
from app.scheduling.queue import ShutdownError
from app.tracking.results import TrackedFrame
from app.video.reader import VideoError, VideoFrame
from index.search import UnavailableError

FRAMES = [VideoFrame(2 * n, n / 10, np.zeros((40, 60, 3), np.uint8)) for n in range(3)]


@pytest.fixture
def executor() -> Iterator[Executor]:
    executor = Executor(1, 5.0, 5.0)
    yield executor
    executor.shut_down()


async def run(
    drawn: Estimator,
    executor: Executor,
    last: VideoFrame | Exception | None = None,
    *,
    max_frames: int = 9,
    timeout_s: float = 9.0,
    ends_at: int = 9,
    failure: Exception | None = None,
) -> tuple[list[bytes], VideoEnd | None, int]:
    """Lines, end and number of frames of a video of three frames, after which ``last`` comes."""
    frames = iter([*FRAMES[1:], last])
    lines: list[bytes] = []

    async def read() -> VideoFrame | None:
        frame = next(frames)
        if isinstance(frame, Exception):
            raise frame
        return frame

    def write(frame: TrackedFrame, number: int) -> bytes:
        if failure is not None and frame.frame_index == 1:
            raise failure
        return b"%d %d" % (frame.frame_index, number)

    video = VideoRun(
        CameraSession(drawn), executor, "",
        kind="video", n=1, evidence="silhouette", max_frames=max_frames, timeout_s=timeout_s,
    )  # fmt: skip
    reader = SimpleNamespace(next=read)
    async for line in video.lines(FRAMES[0], reader, write, lambda: len(lines) == ends_at):  # type: ignore[arg-type]
        lines.append(line)
        await asyncio.sleep(0.1 if timeout_s < 1 else 0)
    return lines, video.end, video.summary.frames


@pytest.mark.anyio
async def test_every_frame_has_a_line(drawn: Estimator, executor: Executor) -> None:
    lines, end, frames = await run(drawn, executor)
    assert lines == [b"0 0", b"1 2", b"2 4"] and frames == 3
    assert end == VideoEnd("complete", "the video ended after 3 frames")


@pytest.mark.anyio
@pytest.mark.parametrize(
    ("given", "lines", "reason", "detail"),
    [
        ({"max_frames": 2}, 2, "max_frames", "more than 2 frames"),
        ({"max_frames": 3}, 3, "complete", "after 3 frames"),
        ({"ends_at": 1}, 1, "shutdown", "being stopped"),
        ({"last": VideoError("undecodable", "video: cut off")}, 3, "broken", "video: cut off"),
        (
            {"failure": UploadError("frame", "too_large", "frame: too large")},
            1,
            "broken",
            "too large",
        ),
        ({"timeout_s": 0.05}, 1, "timeout", "longer than 0.05 seconds"),
        ({"failure": DeadlineError("too late")}, 1, "timeout", "too late"),
        ({"failure": UnavailableError("gone")}, 1, "unavailable", "cannot be searched"),
        ({"failure": ClientGoneError()}, 1, "shutdown", "being stopped"),
        ({"failure": ShutdownError()}, 1, "shutdown", "being stopped"),
        ({"failure": LateFrameError("late")}, 1, "failed", "error of the service"),
        ({"failure": ZeroDivisionError()}, 1, "failed", "error of the service"),
    ],
)
async def test_why_a_video_ends(
    drawn: Estimator, executor: Executor, given: dict, lines: int, reason: str, detail: str
) -> None:
    found, end, frames = await run(drawn, executor, **given)
    assert len(found) == frames == lines
    assert end is not None and end.reason == reason and detail in end.detail
