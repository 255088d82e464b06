"""Frames of cameras over HTTP: order, state, callers, late frames, limits."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import pytest
from fastapi.testclient import TestClient
from pydantic import SecretStr

from app.api.tracking_schemas import CameraList, CameraState, TrackResponse
from app.estimation.estimator import Estimator
from app.main import create_app
from app.settings import Settings
from app.tracking.session import CameraSession
from tests.app.test_errors import check_problem
from tests.app.test_metrics import sample
from tests.conftest import Photo, Server


def send(
    client: TestClient | httpx.Client,
    photo: Photo,
    camera: str = "yard",
    query: dict[str, Any] | None = None,
    headers: dict[str, str] | None = None,
    **fields: str,
) -> httpx.Response:
    """Send a frame with its mask."""
    return client.post(  # type: ignore[return-value]
        f"/cameras/{camera}/frames",
        files={"frame": photo.frame_png, "mask": photo.mask_png},
        data=fields,
        params=query or {},
        headers=headers or {},
    )


class TestTrackFrame:
    def test_a_frame_is_answered_as_by_pose_and_tracked(
        self, client: TestClient, photo: Photo
    ) -> None:
        response = send(client, photo, timestamp="12.5")
        assert response.headers["x-session"] == "new"
        answer = TrackResponse.model_validate_json(response.content)
        assert (answer.camera_id, answer.frame_index, answer.timestamp) == ("yard", 0, 12.5)
        assert answer.reset is None
        files = {"frame": photo.frame_png, "mask": photo.mask_png}
        (alone,) = client.post("/pose", files=files).json()["persons"]
        (person,) = response.json()["persons"]
        assert {name: person[name] for name in alone if name not in ("facing", "posture")} == {
            name: value for name, value in alone.items() if name not in ("facing", "posture")
        }
        assert person["track_id"] >= 1
        assert person["age_frames"] == 1

    def test_the_next_frame_finds_the_session_warm(self, client: TestClient, photo: Photo) -> None:
        states = [send(client, photo).headers["x-session"] for _ in range(3)]
        assert states == ["new", "warm", "warm"]
        assert send(client, photo, "gate").headers["x-session"] == "new"
        assert sample(client, "pose_camera_sessions") == 2
        assert sample(client, "pose_camera_sessions_started_total") == 2
        assert sample(client, "pose_camera_frames_total", session="new") == 2
        assert sample(client, "pose_camera_frames_total", session="warm") == 2

    def test_a_photograph_may_be_the_body(self, client: TestClient, photo: Photo) -> None:
        response = client.post(
            "/cameras/yard/frames",
            content=photo.frame_png,
            headers={"content-type": "image/png"},
            params={"timestamp": 3.25},
        )
        assert response.json()["timestamp"] == 3.25

    @pytest.mark.parametrize("text", ["nan", "inf", "-1", "1764000000000", "noon"])
    def test_a_timestamp_that_is_none_is_refused(
        self, client: TestClient, photo: Photo, text: str
    ) -> None:
        check_problem(send(client, photo, timestamp=text), 422, "timestamp")
        check_problem(send(client, photo, query={"timestamp": text}), 422, "timestamp")

    def test_two_timestamps_are_refused(self, client: TestClient, photo: Photo) -> None:
        response = send(client, photo, query={"timestamp": 1}, timestamp="1")
        assert "got both" in check_problem(response, 422, "timestamp")

    @pytest.mark.parametrize("late", ["7", "6.9"])
    def test_a_late_frame_is_told_so(self, client: TestClient, photo: Photo, late: str) -> None:
        send(client, photo, timestamp="7")
        response = send(client, photo, timestamp=late)
        assert "7" in check_problem(response, 409, "timestamp")
        assert response.headers["x-session"] == "warm"
        assert sample(client, "pose_rejected_total", reason="late_frame") == 1
        assert send(client, photo, timestamp="7.1").json()["frame_index"] == 1

    def test_every_answer_tells_the_state(self, client: TestClient, photo: Photo) -> None:
        path = "/cameras/yard/frames"
        broken = client.post(path, files={"frame": b"?"})
        check_problem(broken, 400, "frame")
        assert broken.headers["x-session"] == "new"
        assert send(client, photo).headers["x-session"] == "new"
        for response in (
            client.post(path, files={"frame": b"?"}),
            client.post(path, files={"frames": b"?"}),
            client.post(path, content=b"?"),
            client.post(path, params={"n": 0}, files={"frame": photo.frame_png}),
        ):
            assert 400 <= response.status_code < 500
            assert response.headers["x-session"] == "warm"

    @pytest.mark.parametrize("name", ["a b", "x" * 65, "a\u00e9", "yard%0A"])
    def test_a_name_that_is_none_is_refused(
        self, client: TestClient, photo: Photo, name: str
    ) -> None:
        assert "A-Za-z0-9" in check_problem(send(client, photo, name), 422, "camera_id")

    def test_a_service_may_keep_none(
        self, settings: Settings, estimator: Estimator, photo: Photo
    ) -> None:
        without = settings.model_copy(update={"max_cameras": 0})
        with TestClient(create_app(without, estimator)) as client:
            response = send(client, photo, "yard")
            assert "no camera sessions" in check_problem(response, 404)

    def test_a_session_that_made_room_starts_afresh(
        self, settings: Settings, estimator: Estimator, photo: Photo
    ) -> None:
        narrow = settings.model_copy(update={"max_cameras": 1})
        with TestClient(create_app(narrow, estimator)) as client:
            states = [
                send(client, photo, name).headers["x-session"] for name in ("yard", "gate", "yard")
            ]
            assert states == ["new", "new", "new"]
            assert sample(client, "pose_camera_sessions_ended_total", reason="number") == 2

    def test_idle_sessions_end_by_themselves(
        self, settings: Settings, estimator: Estimator, photo: Photo
    ) -> None:
        narrow = settings.model_copy(update={"camera_idle_s": 0.2})
        with TestClient(create_app(narrow, estimator)) as client:
            send(client, photo)
            while sample(client, "pose_camera_sessions") != 0:
                pass
            assert sample(client, "pose_camera_sessions_ended_total", reason="idle") == 1


class TestOrder:
    """One camera's frames come one after the other, two cameras' side by side."""

    @pytest.fixture
    def gate(self, monkeypatch: pytest.MonkeyPatch) -> Gate:
        gate = Gate()
        process = CameraSession.process

        def slow(self: CameraSession, *arguments: Any) -> Any:
            gate.begun += 1
            gate.let_go.wait(10)
            return process(self, *arguments)

        monkeypatch.setattr(CameraSession, "process", slow)
        return gate

    @pytest.fixture
    def wide(self, settings: Settings, estimator: Estimator) -> Iterator[TestClient]:
        """A service with more threads than a camera may use."""
        roomy = settings.model_copy(update={"concurrency": 4, "max_wait_s": 10.0})
        with TestClient(create_app(roomy, estimator)) as client:
            yield client

    def test_the_newest_of_those_that_wait_wins(
        self, wide: TestClient, photo: Photo, gate: Gate
    ) -> None:
        executor = wide.app.state.runtime.executor  # type: ignore[attr-defined]
        with ThreadPoolExecutor(3) as threads:
            running = threads.submit(send, wide, photo)
            while gate.begun < 1:
                pass
            older = threads.submit(send, wide, photo)
            while executor.line.inside < 2:
                pass
            newer = threads.submit(send, wide, photo)
            refused = older.result(10)
            assert not newer.done()
            assert gate.begun == 1
            gate.let_go.set()
            assert running.result(10).json()["frame_index"] == 0
            assert newer.result(10).json()["frame_index"] == 1
        assert "newer frame of this camera" in check_problem(refused, 503)
        assert refused.headers["x-session"] == "new"
        assert "retry-after" not in refused.headers

    def test_two_cameras_run_side_by_side(self, wide: TestClient, photo: Photo, gate: Gate) -> None:
        with ThreadPoolExecutor(2) as threads:
            answers = [threads.submit(send, wide, photo, name) for name in ("yard", "gate")]
            while gate.begun < 2:
                assert not any(answer.done() for answer in answers)
            gate.let_go.set()
            assert [answer.result(10).status_code for answer in answers] == [200, 200]


class Gate:
    """Where frames wait until they are let go."""

    def __init__(self) -> None:
        self.begun = 0
        self.let_go = threading.Event()


class TestState:
    def test_cameras_are_listed_and_forgotten(self, client: TestClient, photo: Photo) -> None:
        assert client.get("/cameras").json() == {"cameras": []}
        for name in ("yard", "gate", "yard"):
            send(client, photo, name)
        listed = CameraList.model_validate_json(client.get("/cameras").content)
        assert [(camera.camera_id, camera.frames) for camera in listed.cameras] == [
            ("gate", 1),
            ("yard", 2),
        ]
        yard = CameraState.model_validate_json(client.get("/cameras/yard").content)
        assert (yard.image.width, yard.image.height) == (320, 240)
        assert len(yard.track_ids) == 1
        assert yard.memory_bytes > 0
        response = client.delete("/cameras/yard")
        assert (response.status_code, response.content) == (204, b"")
        assert "content-type" not in response.headers
        assert send(client, photo, "yard").headers["x-session"] == "new"

    def test_unknown_cameras_are_told(self, client: TestClient) -> None:
        for method in ("GET", "DELETE"):
            response = client.request(method, "/cameras/yard")
            assert "yard" in check_problem(response, 404)
        check_problem(client.post("/cameras/yard"), 405)


class TestKeys:
    @pytest.fixture
    def locked(self, settings: Settings, estimator: Estimator) -> Iterator[TestClient]:
        keys = (SecretStr("first"), SecretStr("second"))
        with TestClient(
            create_app(settings.model_copy(update={"api_keys": keys}), estimator)
        ) as client:
            yield client

    def test_callers_have_cameras_of_their_own(self, locked: TestClient, photo: Photo) -> None:
        first, second = {"X-API-Key": "first"}, {"X-API-Key": "second"}
        bearer = {"Authorization": "Bearer first"}
        states = [
            send(locked, photo, headers=headers).headers["x-session"]
            for headers in (first, second, first, bearer)
        ]
        assert states == ["new", "new", "warm", "warm"]
        assert locked.get("/cameras/yard", headers=first).json()["frames"] == 3
        assert locked.get("/cameras/yard", headers=second).json()["frames"] == 1
        assert locked.delete("/cameras/yard", headers=second).status_code == 204
        assert locked.get("/cameras", headers=second).json() == {"cameras": []}
        assert locked.get("/cameras/yard", headers=first).status_code == 200

    def test_without_a_key_nothing_is_told(self, locked: TestClient, photo: Photo) -> None:
        response = send(locked, photo)
        assert response.status_code == 401
        assert "x-session" not in response.headers
        assert locked.get("/cameras").status_code == 401
        assert locked.get("/cameras/yard").status_code == 401
        assert locked.delete("/cameras/yard").status_code == 401


def test_eight_cameras_at_once_over_real_sockets(server: Server, photo: Photo) -> None:
    """Concurrent clients; each camera's frames are counted in order, whatever was refused."""

    def play(camera: str) -> list[int]:
        seen = []
        with httpx.Client(base_url=server.url, timeout=30) as client:
            while len(seen) < 6:
                response = send(client, photo, camera, query={"n": 1})
                if response.status_code != 503:
                    assert response.status_code == 200, response.text
                    assert response.json()["camera_id"] == camera
                    seen.append(response.json()["frame_index"])
        return seen

    names = [f"camera-{number}" for number in range(8)]
    with ThreadPoolExecutor(8) as clients:
        assert list(clients.map(play, names)) == [list(range(6))] * 8
    listed = httpx.get(f"{server.url}/cameras").json()["cameras"]
    assert {camera["camera_id"]: camera["frames"] for camera in listed} == dict.fromkeys(names, 6)
    for name in names:
        assert httpx.delete(f"{server.url}/cameras/{name}").status_code == 204
