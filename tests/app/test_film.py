"""The frames of a video, why they end, and their summary."""

import asyncio
from collections.abc import Iterator

import numpy as np
import pytest

from app.camera import CameraSession, LateFrameError
from app.decoding import Frame
from app.decoding.videos import VideoError
from app.estimation.posture import EstimatedPosture
from app.estimation.upload import UploadError
from app.film import MAX_GAP_S, VideoEnd, VideoRun, VideoSummary
from app.photograph import Estimator
from app.scheduling.executor import Executor
from app.scheduling.job import ClientGoneError, DeadlineError
from app.scheduling.queue import ShutdownError
from app.tracking.results import Event, RecognisedAction, TrackedFrame, TrackedPerson
from app.vision.geometry import Box
from index.posture import PostureName
from index.search import SearchUnavailableError
from tests.app.tracking.people import result_of

FRAMES = [Frame(2 * n, n / 10, np.zeros((40, 60, 3), np.uint8)) for n in range(3)]


@pytest.fixture
def executor() -> Iterator[Executor]:
    executor = Executor(1, 5.0, 5.0)
    yield executor
    executor.shut_down()


async def run(
    drawn: Estimator,
    executor: Executor,
    last: Frame | Exception | None = None,
    *,
    max_frames: int = 9,
    timeout_s: float = 9.0,
    ends_at: int = 9,
    failure: Exception | None = None,
) -> tuple[list[bytes], VideoEnd | None, int]:
    """Lines, end and number of frames of a video of three frames, after which ``last`` comes."""
    frames = iter([*FRAMES[1:], last])
    lines: list[bytes] = []

    async def read() -> Frame | None:
        frame = next(frames)
        if isinstance(frame, Exception):
            raise frame
        return frame

    def write(frame: TrackedFrame, number: int) -> bytes:
        if failure is not None and frame.frame_index == 1:
            raise failure
        return b"%d %d" % (frame.frame_index, number)

    video = VideoRun(
        session=CameraSession(drawn), executor=executor, caller="",
        kind="video", n=1, evidence="silhouette", max_frames=max_frames, timeout_s=timeout_s,
    )  # fmt: skip
    async for line in video.lines(FRAMES[0], read, write, lambda: len(lines) == ends_at):  # type: ignore[arg-type]
        lines.append(line)
        await asyncio.sleep(1.2 * timeout_s if timeout_s < 2 else 0)
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
            {"failure": UploadError("frame", "frame: too large", "too_large")},
            1,
            "broken",
            "too large",
        ),
        # Thirty times what the first frame takes.
        ({"timeout_s": 1.5}, 1, "timeout", "longer than 1.5 seconds"),
        ({"failure": DeadlineError("too late")}, 1, "timeout", "too late"),
        ({"failure": SearchUnavailableError("gone")}, 1, "unavailable", "cannot be searched"),
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


def person(
    track_id: int, posture: PostureName | None, action: RecognisedAction | None = None
) -> TrackedPerson:
    return TrackedPerson(
        Box(0, 0, 10, 20), "detector", 0.9, None,
        posture=EstimatedPosture(posture, 0.9) if posture else None,
        track_id=track_id, age_frames=1, pose=None, action=action,
    )  # fmt: skip


def summarised(*frames: tuple[float, list[TrackedPerson]]) -> VideoSummary:
    summary = VideoSummary()
    for index, (timestamp, persons) in enumerate(frames):
        event = Event("entered", "instant", timestamp, 1.0, index + 1)
        summary.add(result_of(index, timestamp, persons=tuple(persons), events=(event,)))
    return summary


def test_a_posture_lasts_until_the_next_frame() -> None:
    summary = summarised(
        (0.0, [person(1, "walking")]),
        (0.5, [person(1, "walking")]),
        (1.0, [person(1, "lying")]),
        (3.0, [person(1, "lying")]),
        (3.5, [person(1, None)]),
        (4.0, [person(1, "standing")]),
    )
    assert summary.tracks[1].postures == [("lying", 2.5), ("walking", 1.0), ("standing", 0.0)]


def test_no_posture_is_kept_while_unseen_for_long() -> None:
    summary = summarised((0.0, [person(1, "walking")]), (MAX_GAP_S + 0.1, [person(1, "walking")]))
    assert summary.tracks[1].postures == [("walking", 0.0)]


def test_the_action_with_the_largest_sum_wins() -> None:
    walk, jump = RecognisedAction("walk", 0.4), RecognisedAction("jump", 0.9)
    summary = summarised(
        (0.0, [person(1, None)]),
        (0.1, [person(1, None, walk)]),
        (0.2, [person(1, None, walk)]),
        (0.3, [person(1, None, jump)]),
    )
    action = summary.tracks[1].action
    assert action is not None
    assert (action.label, action.probability) == ("jump", pytest.approx(0.3))
