"""Which frames come from the same camera, and that the newest of them is answered."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import httpx
import pytest
from fastapi.testclient import TestClient

from app.estimation.estimator import Estimator
from app.http.cameras import camera_stream
from app.main import create_app
from app.settings import Settings
from tests.app.test_errors import check_problem
from tests.app.test_metrics import sample
from tests.conftest import Photo


def stream(path: str = "/pose", **headers: str) -> object:
    pairs = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
    return camera_stream({"type": "http", "path": path, "headers": pairs})


def test_frames_of_a_camera_are_those_of_one_caller_who_asks_the_same() -> None:
    yard = stream(x_camera_id="yard")
    assert yard == stream(x_camera_id="yard", accept="*/*")
    assert yard != stream(x_camera_id="gate")
    assert yard != stream("/silhouette", x_camera_id="yard")
    assert yard != stream(x_camera_id="yard", x_api_key="other")
    assert yard != stream(x_camera_id="yard", authorization="Bearer other")
    assert stream() is None
    assert stream(x_camera_id="") is None


@pytest.mark.parametrize("name", ["", "a b", "x" * 65, 'a"b', ".", ".."])
def test_a_name_that_is_none_is_refused(client: TestClient, photo: Photo, name: str) -> None:
    files = {"frame": photo.frame_png, "mask": photo.mask_png}
    response = client.post("/pose", files=files, headers={"X-Camera-ID": name})
    assert "A-Za-z0-9" in check_problem(response, 422, "X-Camera-ID")


@pytest.fixture
def busy(settings: Settings, estimator: Estimator) -> Iterator[TestClient]:
    """A service with one thread."""
    narrow = settings.model_copy(update={"concurrency": 1, "max_wait_s": 10.0})
    with TestClient(create_app(narrow, estimator)) as client:
        yield client


@pytest.mark.parametrize("path", ["/pose", "/pose/overlay", "/silhouette"])
def test_an_older_frame_is_answered_at_once(
    busy: TestClient, photo: Photo, monkeypatch: pytest.MonkeyPatch, path: str
) -> None:
    let_go = threading.Event()
    find_people = Estimator.find_people

    def slow(*arguments: object) -> object:
        let_go.wait(10)
        return find_people(*arguments)

    monkeypatch.setattr(Estimator, "find_people", slow)
    executor = busy.app.state.runtime.executor
    files = {"frame": photo.frame_png, "mask": photo.mask_png}

    def ask() -> httpx.Response:
        return busy.post(path, files=files, headers={"X-Camera-ID": "yard"})

    def ask_and_be_inside(inside: int) -> Future[httpx.Response]:
        answer = threads.submit(ask)
        while executor.line.inside < inside and not answer.done():
            pass
        return answer

    with ThreadPoolExecutor(3) as threads:
        running, older = ask_and_be_inside(1), ask_and_be_inside(2)
        newer = threads.submit(ask)
        refused = older.result(10)
        assert not newer.done()
        let_go.set()
        assert [running.result(10).status_code, newer.result(10).status_code] == [200, 200]
    assert "newer frame of this camera" in check_problem(refused, 503)
    assert refused.json()["reason"] == "superseded"
    assert "retry-after" not in refused.headers  # The frame is out of date.
    assert sample(busy, "pose_rejected_total", reason="superseded") == 1
    assert sample(busy, "pose_rejected_total", reason="overloaded") is None
