"""Frames of cameras over HTTP: state, order, callers, covered views."""

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from pydantic import SecretStr

from app.api.tracking_schemas import CameraList, CameraState, EventReplay
from app.estimation.finder import PeopleFinder
from tests.app.vision.encoded import encode
from tests.conftest import Photo, Serving
from tests.golden.pictures import EMPTY_YARD
from tests.support.service import check_problem, eventually, sample, send


def sessions_of(client: TestClient, photo: Photo, *cameras: str, **options: Any) -> list[str]:
    """States of the sessions that the frames of cameras find, one after the other."""
    return [send(client, photo, camera, **options).headers["x-session"] for camera in cameras]


ZONE = {"name": "bed", "kind": "rest", "polygon": [[0, 0], [9, 0], [9, 9]]}
AS_JSON = {"Accept": "application/json"}


class TestTrackFrame:
    def test_every_answer_names_the_session_state(self, client: TestClient, photo: Photo) -> None:
        path = "/cameras/yard/frames"
        broken = client.post(path, files={"frame": b"?"})
        assert (broken.status_code, broken.headers["x-session"]) == (400, "new")
        assert sessions_of(client, photo, "yard") == ["new"]
        for response in (
            client.post(path, files={"frame": b"?"}),
            client.post(path, files={"frames": b"?"}),
            client.post(path, content=b"?"),
            client.post(path, params={"n": 0}, files={"frame": photo.frame_png}),
        ):
            assert 400 <= response.status_code < 500
            assert response.headers["x-session"] == "warm"


class Gate:
    """Holds frames back until they are released."""

    def __init__(self) -> None:
        self.begun = 0
        self.let_go = threading.Event()


@pytest.fixture
def gate(monkeypatch: pytest.MonkeyPatch) -> Gate:
    """Holds frames back before people are detected."""
    gate = Gate()
    find = PeopleFinder.find

    def slow(*arguments: Any, **options: Any) -> Any:
        gate.begun += 1
        assert gate.let_go.wait(10)
        return find(*arguments, **options)

    monkeypatch.setattr(PeopleFinder, "find", slow)
    return gate


class TestOrder:
    """Of one camera's waiting frames only the newest stays."""

    Ask = Callable[[TestClient, Photo], Any]

    @pytest.mark.parametrize(
        "ask",
        [
            send,
            *(
                lambda client, photo, path=path: client.post(
                    path, files=photo.files, headers={"X-Camera-ID": "yard"}
                )
                for path in ("/pose", "/pose/overlay", "/silhouette")
            ),
        ],
    )
    def test_the_newest_waiting_frame_replaces_older_ones(
        self, serving: Serving, photo: Photo, gate: Gate, ask: Ask
    ) -> None:
        with serving(concurrency=4) as client, ThreadPoolExecutor(3) as threads:
            queue = client.app.state.runtime.executor.queue  # type: ignore[attr-defined]
            running = threads.submit(ask, client, photo)
            eventually(lambda: gate.begun == 1)
            older = threads.submit(ask, client, photo)
            eventually(lambda: queue.in_flight == 2)
            newer = threads.submit(ask, client, photo)
            refused = older.result(60)
            assert not newer.done()
            assert gate.begun == 1
            gate.let_go.set()
            answers = [running.result(60), newer.result(60)]
            assert [answer.status_code for answer in answers] == [200, 200]
            if ask is send:
                assert [answer.json()["frame_index"] for answer in answers] == [0, 1]
            assert "newer frame of this camera" in check_problem(refused, 503)
            assert refused.json()["reason"] == "superseded"
            assert "retry-after" not in refused.headers  # The frame is out of date.
            assert sample(client, "pose_rejected_total", reason="superseded") == 1
            assert sample(client, "pose_rejected_total", reason="overloaded") is None


def test_cameras_are_listed_and_forgotten(client: TestClient, photo: Photo) -> None:
    assert client.get("/cameras").json() == {"cameras": []}
    sessions_of(client, photo, "yard", "gate", "yard")
    listed = CameraList.model_validate_json(client.get("/cameras").content)
    assert [(one.camera_id, one.frames) for one in listed.cameras] == [("gate", 1), ("yard", 2)]
    yard = CameraState.model_validate_json(client.get("/cameras/yard").content)
    assert (yard.image.width, yard.image.height) == (320, 240)
    assert len(yard.track_ids) == 1
    response = client.delete("/cameras/yard")
    assert (response.status_code, response.content) == (204, b"")
    assert "content-type" not in response.headers
    assert sessions_of(client, photo, "yard") == ["new"]


def test_an_event_is_replayed_without_a_photograph(client: TestClient, photo: Photo) -> None:
    assert sessions_of(client, photo, "yard") == ["new"]
    (event,) = client.get("/cameras/yard/events").json()["events"]
    path = f"/cameras/yard/events/{event['id']}/replay"
    picture = client.get(path)
    assert picture.headers["content-type"] == "image/webp"
    assert picture.content[:4] + picture.content[8:12] == b"RIFFWEBP"
    client.put("/cameras/yard", json={"zones": [ZONE]})
    replay = EventReplay.model_validate_json(client.get(path, headers=AS_JSON).content)
    assert (replay.event.id, replay.complete, len(replay.frames)) == (event["id"], False, 1)
    assert (replay.image.width, replay.zones[0].name) == (320, "bed")
    assert len(replay.frames[0].joints) == 17 and replay.frames[0].outline
    for name in ("gate", "yard"):
        missing = client.get(f"/cameras/{name}/events/none/replay")
        assert check_problem(missing, 404).startswith("expected ")


class TestKeys:
    @pytest.fixture
    def locked(self, serving: Serving) -> Iterator[TestClient]:
        with serving(api_keys=(SecretStr("first"), SecretStr("second"))) as client:
            yield client

    def test_callers_have_separate_cameras(self, locked: TestClient, photo: Photo) -> None:
        first, second = {"X-API-Key": "first"}, {"X-API-Key": "second"}
        bearer = {"Authorization": "Bearer first"}
        states = [
            sessions_of(locked, photo, "yard", headers=headers)
            for headers in (first, second, first, bearer)
        ]
        assert states == [["new"], ["new"], ["warm"], ["warm"]]
        assert locked.get("/cameras/yard", headers=first).json()["frames"] == 3
        assert locked.get("/cameras/yard", headers=second).json()["frames"] == 1
        assert locked.delete("/cameras/yard", headers=second).status_code == 204
        assert locked.get("/cameras", headers=second).json() == {"cameras": []}
        assert locked.get("/cameras/yard", headers=first).status_code == 200

    def test_without_a_key_nothing_is_revealed(self, locked: TestClient, photo: Photo) -> None:
        response = send(locked, photo)
        assert response.status_code == 401
        assert "x-session" not in response.headers
        for method, path in (("GET", ""), ("GET", "/yard"), ("DELETE", "/yard")):
            assert locked.request(method, f"/cameras{path}").status_code == 401


class TestObstructed:
    """A camera that is covered, as a caller sees it."""

    YARD = EMPTY_YARD
    COVER = encode(np.full((330, 400, 3), 90, np.uint8), ".jpg")

    def watch(
        self, client: TestClient, *frames: bytes, since: float = 0.0
    ) -> tuple[list[bool], list[dict[str, Any]]]:
        """Whether each frame, three seconds apart, has the warning; and the camera's events."""
        warned = []
        for number, frame in enumerate(frames):
            timestamp = since + 3 * number
            answer = client.post(
                "/cameras/yard/frames", files={"frame": frame}, data={"timestamp": timestamp}
            )
            assert answer.status_code == 200
            warned.append("obstructed" in answer.json()["image"]["warnings"])
        return warned, client.get("/cameras/yard/events").json()["events"]

    def test_a_covered_camera_says_so_until_it_is_free(self, client: TestClient) -> None:
        frames = [self.YARD] * 6 + [self.COVER] * 6 + [self.YARD] * 6
        warned, events = self.watch(client, *frames)
        assert not any(warned[:7])
        assert all(warned[8:12])
        assert not any(warned[-2:])
        assert [(one["event"], one["state"], one["track_id"]) for one in events] == [
            ("obstructed", "begin", None), ("obstructed", "end", None),
        ]  # fmt: skip
        assert sample(client, "pose_events_total", event="obstructed") == 1
