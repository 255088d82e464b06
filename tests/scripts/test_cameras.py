"""The load of live cameras: what is sent, and what is told of it."""

from __future__ import annotations

from collections import Counter

import pytest

from scripts.cameras import Outcome, calls_of, rejections, report, send_frames
from scripts.load.client import Call, Client
from scripts.load.loops import Answer, Tally
from tests.conftest import Photo, Server

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


def outcome() -> Outcome:
    """Two cameras of four frames: three answered in time, one late, two superseded, two lost."""
    first = Tally([Answer(200, 300, False), Answer(200, 900, False), Answer(200, 1500, False)])
    second = Tally([Answer(200, 600, False), Answer(503, 20, True), Answer(503, 30, True)])
    first.late_ms, second.late_ms = [0.0] * 4, [0.0] * 4
    return Outcome([first, second], 2.0, Counter(superseded=2))


def test_what_counts_as_in_time() -> None:
    found = outcome()
    assert found.sent() == 8
    assert found.share_in_time() == 3 / 8
    assert found.share_of_answers_in_time() == 3 / 4
    assert sorted(found.ages_ms()) == [300, 600, 900, 1500]
    assert found.refused_ms() == [20, 30]
    assert found.otherwise() == 2
    assert found.frames_per_s() == [1.5, 0.5]


def test_the_report_tells_it() -> None:
    text = report({2: outcome()}, rate=2, seconds=2)
    assert "| **answered with poses within 1 s, of the frames sent** | 37.5% |" in text
    assert "| least / most of a camera | 0.50 / 1.50 |" in text.replace(
        "frames answered a second, ", ""
    )
    assert "| 2 / 0 / 0 |" in text


def test_each_camera_has_a_name_and_a_stretch_of_its_own() -> None:
    frames = [bytes([number]) for number in range(100)]
    first, second = (calls_of(camera, 2, frames) for camera in range(2))
    assert {call.headers["X-Camera-ID"] for call in first} == {"camera-1"}
    assert {call.headers["X-Camera-ID"] for call in second} == {"camera-2"}
    sent = [{call.parts["frame"] for call in calls} for calls in (first, second)]
    assert not sent[0] & sent[1]
    assert first[0].message[1]["X-Camera-ID"] == "camera-1"


async def test_cameras_send_whether_or_not_they_are_answered(server: Server, photo: Photo) -> None:
    tallies = await send_frames(
        server.url, cameras=2, rate=20, seconds=0.5, frames=[photo.frame_png]
    )
    assert [len(tally.late_ms) for tally in tallies] == [10, 10]
    answered = [len(tally.of(200)) + len(tally.of(503)) for tally in tallies]
    assert answered == [10, 10]
    assert min(len(tally.of(200)) for tally in tallies) >= 1


def test_rejections_are_read_from_the_metrics(server: Server) -> None:
    before = rejections(server.url)["undecodable"]
    Client(server.url).send(Call("POST", "/pose", {"frame": b"?"}))
    assert rejections(server.url)["undecodable"] == before + 1
