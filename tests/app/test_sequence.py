"""Videos over HTTP: a line for each frame, and a last line that says why it is the last."""

from __future__ import annotations

import json
import time
from collections.abc import AsyncIterator, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import anyio
import httpx
import pytest
from fastapi.testclient import TestClient
from starlette.types import Message

from app.api.tracking_schemas import SequenceEnd, SequenceFrame
from app.estimation.estimator import Estimator
from app.http.request_context import NOTES
from app.main import create_app
from app.routes import sequence
from app.settings import Settings
from app.tracking.session import CameraSession
from tests.app.test_errors import check_problem
from tests.app.test_metrics import sample
from tests.app.test_server import metric
from tests.conftest import Photo, Server, start_server, wait_until
from tests.videos import noisy_frames, numbered_frames, write_video


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory, photo: Photo) -> bytes:
    """Twelve frames of somebody who stands still, ten a second."""
    return write_video(tmp_path_factory.mktemp("video") / "v.avi", [photo.frame] * 12)


@pytest.fixture(scope="module")
def long_video(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A thousand frames of nothing."""
    path = tmp_path_factory.mktemp("video") / "v.avi"
    return write_video(path, numbered_frames(2, 240, 320) * 500)


def post(client: TestClient | httpx.Client, data: bytes, **query: Any) -> httpx.Response:
    return client.post("/sequence", files={"video": data}, params=query)  # type: ignore[return-value]


def parse(response: httpx.Response) -> tuple[list[SequenceFrame], SequenceEnd]:
    assert response.status_code == 200, response.text
    assert response.headers["content-type"] == "application/x-ndjson"
    *frames, end = response.text.splitlines()
    return [SequenceFrame.model_validate_json(line) for line in frames], (
        SequenceEnd.model_validate_json(end)
    )


class TestLines:
    def test_every_frame_has_a_line(self, client: TestClient, video: bytes) -> None:
        frames, end = parse(post(client, video, n=2))
        assert [frame.video_frame for frame in frames] == list(range(12))
        assert [frame.frame_index for frame in frames] == list(range(12))
        assert [frame.timestamp for frame in frames] == [pytest.approx(n / 10) for n in range(12)]
        assert frames[0].image.width == 320
        assert (end.reason, end.frames) == ("complete", 12)
        assert "12 frames" in end.detail
        listed = {person.track_id for frame in frames for person in frame.persons}
        assert {track.track_id for track in end.tracks} == listed
        assert end.events == [event for frame in frames for event in frame.events]
        assert sample(client, "pose_sequences") == 0
        assert sample(client, "pose_camera_sessions") == 0

    def test_a_video_may_be_the_body(self, client: TestClient, video: bytes) -> None:
        headers = {"content-type": "video/x-msvideo"}
        raw = client.post("/sequence?stride=5&n=1", content=video, headers=headers)
        frames, end = parse(raw)  # type: ignore[arg-type]
        assert [frame.video_frame for frame in frames] == [0, 5, 10]
        assert end.reason == "complete"

    def test_no_more_than_max_frames(self, client: TestClient, video: bytes) -> None:
        frames, end = parse(post(client, video, max_frames=3))
        assert (len(frames), end.reason, end.frames) == (3, "max_frames", 3)
        frames, end = parse(post(client, video, max_frames=12))
        assert (len(frames), end.reason) == (12, "complete")

    def test_a_truncated_video_ends_with_a_line(self, client: TestClient, tmp_path: Path) -> None:
        data = write_video(tmp_path / "v.avi", noisy_frames(10))
        frames, end = parse(post(client, data[: len(data) // 2]))
        assert 0 < len(frames) < 10
        assert (end.reason, end.frames) == ("broken", len(frames))
        assert f"{len(frames)} of 10 frames" in end.detail

    def test_what_takes_too_long_ends_with_a_line(
        self, settings: Settings, estimator: Estimator, long_video: bytes
    ) -> None:
        hasty = settings.model_copy(update={"sequence_timeout_s": 1.0})
        with TestClient(create_app(hasty, estimator)) as client:
            frames, end = parse(post(client, long_video))
        assert (end.reason, end.frames) == ("timeout", len(frames))
        assert len(frames) < 1000

    def test_a_frame_that_takes_too_long_ends_it(
        self,
        settings: Settings,
        estimator: Estimator,
        video: bytes,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        process = CameraSession.process

        def slow(
            self: CameraSession, upload: Any, timestamp: Any, n: Any, check: Any, *_: Any
        ) -> Any:
            while timestamp:
                check()
            return process(self, upload, timestamp, n, check)

        monkeypatch.setattr(CameraSession, "process", slow)
        hasty = settings.model_copy(update={"request_timeout_s": 1.0})
        with TestClient(create_app(hasty, estimator)) as client:
            frames, end = parse(post(client, video))
        assert (end.reason, len(frames)) == ("timeout", 1)


class TestRefusals:
    @pytest.mark.parametrize("data", [b"?", b"RIFF\xff\xff\xff\xffAVI LIST", b"#EXTM3U\n/etc/x\n"])
    def test_what_is_no_video(self, client: TestClient, data: bytes) -> None:
        detail = check_problem(post(client, data), 400, "video")
        assert "a video that FFmpeg can read" in detail
        assert sample(client, "pose_rejected_total", reason="undecodable") == 1
        assert sample(client, "pose_sequences") == 0

    def test_frames_of_too_many_pixels(
        self, settings: Settings, estimator: Estimator, video: bytes
    ) -> None:
        small = settings.model_copy(update={"max_pixels": 320 * 240 - 1})
        with TestClient(create_app(small, estimator)) as client:
            assert "320x240" in check_problem(post(client, video), 413, "video")

    def test_too_many_bytes(self, settings: Settings, estimator: Estimator, video: bytes) -> None:
        small = settings.model_copy(update={"max_video_bytes": len(video) - 1})
        with TestClient(create_app(small, estimator)) as client:
            check_problem(post(client, video), 413)
            headers = {"content-type": "video/avi"}
            parts = iter([video[:1000], video[1000:]])
            check_problem(
                client.post("/sequence", content=parts, headers=headers),  # type: ignore[arg-type]
                413,
            )
            assert sample(client, "pose_sequences") == 0

    def test_a_video_may_be_larger_than_a_frame(
        self, settings: Settings, estimator: Estimator, video: bytes
    ) -> None:
        small = settings.model_copy(update={"max_upload_bytes": 1024})
        with TestClient(create_app(small, estimator)) as client:
            assert parse(post(client, video, stride=6))[1].reason == "complete"

    def test_other_bodies_and_parameters(self, client: TestClient, video: bytes) -> None:
        check_problem(client.post("/sequence", content=b"?"), 415)  # type: ignore[arg-type]
        check_problem(client.post("/sequence", files={"frame": video}), 422, "frame")  # type: ignore[arg-type]
        check_problem(client.post("/sequence", files={"video": (None, "x")}), 422, "video")  # type: ignore[arg-type]
        for name, value in (("stride", 0), ("max_frames", 0), ("max_frames", 10**6), ("fps", 3)):
            check_problem(post(client, video, **{name: value}), 422, name)


@pytest.fixture
def narrow(index_path: Path) -> Iterator[Server]:
    """A server for one video at a time."""
    running = start_server(index_path, POSE_MAX_SEQUENCES="1")
    wait_until(f"{running.url}/readyz")
    yield running
    running.stop()


def wait_for_metric(server: Server, line: str, value: float) -> None:
    deadline = time.monotonic() + 10
    while metric(server, line) != value:
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_lines_come_while_the_video_is_worked_on(
    narrow: Server, long_video: bytes, photo: Photo
) -> None:
    """One more is refused meanwhile, frames are answered, and a hang-up ends it all."""
    url = f"{narrow.url}/sequence"
    with httpx.stream("POST", url, files={"video": long_video}, timeout=30) as response:
        lines = response.iter_lines()
        assert json.loads(next(lines))["type"] == "frame"
        assert metric(narrow, "pose_sequences") == 1
        refused = httpx.post(url, files={"video": long_video})
        assert "at most 1 videos" in check_problem(refused, 503)
        assert int(refused.headers["retry-after"]) >= 1
        files = {"frame": photo.frame_png, "mask": photo.mask_png}
        assert httpx.post(f"{narrow.url}/pose", files=files).status_code == 200
        assert metric(narrow, "pose_sequences") == 1
    wait_for_metric(narrow, "pose_sequences", 0)
    wait_for_metric(narrow, "pose_in_flight", 0)
    assert metric(narrow, 'pose_rejected_total{reason="too_many_sequences"}') == 1
    assert children(narrow) == []


def test_sigterm_ends_a_video_with_a_line(index_path: Path, long_video: bytes) -> None:
    running = start_server(index_path)
    wait_until(f"{running.url}/readyz")
    with (
        ThreadPoolExecutor(1) as threads,
        httpx.stream(
            "POST", f"{running.url}/sequence", files={"video": long_video}, timeout=30
        ) as response,
    ):
        lines = response.iter_lines()
        assert json.loads(next(lines))["type"] == "frame"
        stopped = threads.submit(running.stop)
        *_, last = lines
        end = SequenceEnd.model_validate_json(last)
        assert end.reason == "shutdown"
        assert 0 < end.frames < 1000
        assert stopped.result(20) == 0


@pytest.mark.anyio
@pytest.mark.parametrize("anyio_backend", ["asyncio"])
async def test_who_does_not_read_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sequence, "_UNREAD_S", 0.05)
    closed = []

    async def lines() -> AsyncIterator[bytes]:
        try:
            while True:
                yield b"{}\n"
        finally:
            closed.append(True)

    async def send(message: Message) -> None:
        if message["type"] == "http.response.body":
            await anyio.sleep_forever()

    notes: dict[str, str] = {}
    scope = {"type": "http", "asgi": {"spec_version": "2.3"}, NOTES: notes}
    with anyio.fail_after(5):
        await sequence.LineStream(lines())(scope, anyio.sleep_forever, send)
    assert closed == [True]
    assert notes == {"rejected": "client_gone"}


def children(server: Server) -> list[str]:
    """Processes that a server has started and that still run."""
    listed = Path(f"/proc/{server.process.pid}/task/{server.process.pid}/children")
    return listed.read_text().split()
