"""Videos over HTTP: a line for each frame, and a last line that says why it is the last."""

import json
import socket
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi.testclient import TestClient

from app.api.tracking_schemas import SequenceEnd, SequenceFrame, SequenceResponse
from tests.conftest import HTTP, Photo, Server, Serving, running_server
from tests.support.service import check_problem, eventually, sample, slow_frame
from tests.support.videos import numbered_frames, write_video


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory, photo: Photo) -> bytes:
    """Four frames of a standing person, at 10 fps."""
    return write_video(tmp_path_factory.mktemp("video") / "v.avi", [photo.frame] * 4)


@pytest.fixture(scope="module")
def long_video(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A thousand frames of nothing."""
    path = tmp_path_factory.mktemp("video") / "v.avi"
    return write_video(path, numbered_frames(2, 96, 128) * 500)


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
    def test_a_gif_may_be_the_body(self, client: TestClient, tmp_path: Path) -> None:
        gif = write_video(tmp_path / "v.gif", numbered_frames(3), "gif")
        headers = {"content-type": "image/gif"}
        frames, end = parse(client.post("/sequence", content=gif, headers=headers))
        assert (len(frames), end.reason) == (3, "complete")

    def test_every_frame_has_a_line(self, client: TestClient, video: bytes) -> None:
        frames, end = parse(post(client, video, n=2))
        assert [frame.video_frame for frame in frames] == list(range(4))
        assert [frame.frame_index for frame in frames] == list(range(4))
        assert [frame.timestamp for frame in frames] == [pytest.approx(n / 10) for n in range(4)]
        assert frames[0].image.width == 320
        assert (end.reason, end.frames) == ("complete", 4)
        assert "4 frames" in end.detail
        listed = {person.track_id for frame in frames for person in frame.persons}
        assert {track.track_id for track in end.tracks} == listed
        assert end.events == [event for frame in frames for event in frame.events]
        assert sample(client, "pose_sequences") == 0
        assert sample(client, "pose_camera_sessions") == 0

    def test_who_asks_for_json_gets_one_document(self, client: TestClient, video: bytes) -> None:
        def answer(accept: str, data: bytes = video) -> httpx.Response:
            headers = {"accept": accept, "content-type": "video/avi"}
            return client.post("/sequence?n=1", content=data, headers=headers)  # type: ignore[return-value]

        response = answer("application/json")
        assert response.headers["content-type"] == "application/json"
        document = SequenceResponse.model_validate_json(response.content)
        frames, end = parse(answer("application/json, text/plain, */*"))
        assert [one.video_frame for one in document.frames] == [one.video_frame for one in frames]
        assert (document.end.reason, document.end.tracks) == (end.reason, end.tracks)
        check_problem(answer("application/json", b"?"), 400, "video")

    def test_damaged_frames_are_marked_and_counted(
        self, client: TestClient, tmp_path: Path, photo: Photo
    ) -> None:
        data = write_video(tmp_path / "v.ts", [photo.frame] * 8, "libx264", options={"g": "1"})
        lost = len(data) // 188 // 2 * 188
        frames, end = parse(post(client, data[:lost] + data[lost + 5 * 188 :]))
        damaged = ["damaged" in frame.image.warnings for frame in frames]
        assert 0 < sum(damaged) < 8 and end.damaged == sum(damaged)
        assert (end.reason, f"{sum(damaged)} of them damaged" in end.detail) == ("complete", True)


class TestRefusals:
    def test_more_frames_than_the_service_allows_are_refused(
        self, client: TestClient, video: bytes
    ) -> None:
        check_problem(post(client, video, max_frames=10**6), 422, "max_frames")

    def test_a_video_with_too_many_bytes_is_refused(self, serving: Serving, video: bytes) -> None:
        with serving(max_video_bytes=len(video) - 1) as client:
            check_problem(post(client, video), 413)
            parts = iter([video[:1000], video[1000:]])
            headers = {"content-type": "video/avi"}
            check_problem(client.post("/sequence", content=parts, headers=headers), 413)
            assert sample(client, "pose_sequences") == 0


def hang_up_after_sending(url: str, video: bytes) -> None:
    """Send a video and close the connection before the first line of the answer."""
    address = httpx.URL(url)
    head = f"POST /sequence HTTP/1.1\r\nHost: {address.host}\r\nContent-Type: video/avi\r\n"
    with socket.create_connection((address.host, address.port)) as connection:
        # The end is sent together with the hang-up: else a busy machine may answer between them.
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_CORK, 1)
        connection.sendall(f"{head}Content-Length: {len(video)}\r\n\r\n".encode() + video)


@pytest.fixture(scope="module")
def narrow(index_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server for one video at a time, whose log holds no error; the last test ends it."""
    log = tmp_path_factory.mktemp("narrow") / "log"
    with running_server(index_path, log=log, POSE_MAX_SEQUENCES="1") as running:
        yield running
    assert [line for line in log.read_text().splitlines() if '"error"' in line] == []


def test_lines_arrive_while_the_video_is_worked_on(
    narrow: Server, long_video: bytes, photo: Photo
) -> None:
    """One more is refused meanwhile, frames are answered, and a hang-up ends it all."""
    video = {"video": long_video}
    with httpx.Client(base_url=narrow.url, timeout=60) as client:
        with client.stream("POST", "/sequence", files=video) as response:
            lines = response.iter_lines()
            assert json.loads(next(lines))["type"] == "frame"
            refused = client.post("/sequence", files=video)
            assert "at most 1 videos" in check_problem(refused, 503)
            assert client.post("/pose", files=photo.files).status_code == 200
            assert sample(client, "pose_sequences") == 1
        eventually(lambda: sample(client, "pose_sequences") == 0)
        gone = {"reason": "client_gone"}
        eventually(lambda: sample(client, "pose_rejected_total", **gone) == 1)
        hang_up_after_sending(narrow.url, long_video)
        eventually(lambda: sample(client, "pose_rejected_total", **gone) == 2)
        eventually(lambda: sample(client, "pose_in_flight") == 0)
        assert sample(client, "pose_rejected_total", reason="too_many_sequences") == 1
        # The process that decoded it has ended, too.
        pid = narrow.process.pid
        assert Path(f"/proc/{pid}/task/{pid}/children").read_text().split() == []


def test_a_video_takes_a_place_once_it_has_arrived(server: Server, video: bytes) -> None:
    address = httpx.URL(server.url)
    head = b"POST /sequence HTTP/1.1\r\nHost: x\r\nContent-Type: video/avi\r\n"
    head += b"Content-Length: 9999\r\n\r\n"
    with ExitStack() as stack:
        for _ in range(2):
            slow = stack.enter_context(socket.create_connection((address.host, address.port)))
            slow.sendall(head + video[:1000])
        with httpx.Client(base_url=server.url, timeout=60) as client:
            for caller in ("127.0.0.1", "10.9.9.9"):
                headers = {"X-Forwarded-For": caller}
                files = {"video": video}
                answer = client.post("/sequence?max_frames=1", files=files, headers=headers)
                assert parse(answer)[1].frames == 1


def test_one_caller_leaves_a_place_to_others(
    server: Server, long_video: bytes, video: bytes
) -> None:
    with httpx.Client(base_url=server.url, timeout=60) as client:
        with client.stream("POST", "/sequence", files={"video": long_video}) as answer:
            next(answer.iter_lines())
            assert "one caller's" in check_problem(post(client, video), 503)
            headers = {"X-Forwarded-For": "10.9.9.9"}
            other = client.post("/sequence?max_frames=1", files={"video": video}, headers=headers)
            assert parse(other)[1].frames == 1
        eventually(lambda: sample(client, "pose_sequences") == 0)


def test_sigterm_ends_a_video_with_a_line_and_finishes_all_frames(
    narrow: Server, long_video: bytes
) -> None:
    files = {"frame": slow_frame()}
    boxes = json.dumps([[40 * column, 100, 38, 100] for column in range(3)])

    def ask(_: int) -> int:
        data = {"boxes": boxes}
        return HTTP.post(f"{narrow.url}/pose", files=files, data=data).status_code

    with httpx.Client(base_url=narrow.url, timeout=60) as client, ThreadPoolExecutor(3) as threads:
        with client.stream("POST", "/sequence", files={"video": long_video}) as response:
            lines = response.iter_lines()
            assert json.loads(next(lines))["type"] == "frame"
            answers = [threads.submit(ask, number) for number in range(3)]
            eventually(
                lambda: sample(client, "pose_in_flight") == 4 or any(one.done() for one in answers)
            )
            narrow.process.terminate()
            *_, last = lines
        assert [answer.result() for answer in answers] == [200, 200, 200]
    assert narrow.process.wait(timeout=60) == 0  # A second signal would end it with another status.
    end = SequenceEnd.model_validate_json(last)
    assert end.reason == "shutdown"
    assert 0 < end.frames < 1000
