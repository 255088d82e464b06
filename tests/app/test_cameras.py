"""Live cameras: the newest frame of a camera takes the place of those that still wait."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import anyio
import httpx
import pytest
from fastapi.testclient import TestClient

from app.cameras import camera_stream
from app.estimator import Estimator
from app.main import create_app
from app.pool import OverloadedError, SupersededError, Watch, WorkPool
from app.settings import Settings
from tests.app.test_errors import check_problem
from tests.app.test_operation import sample
from tests.conftest import Photo

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


class Crossing:
    """A pool with one thread, which is kept busy until it is let go."""

    def __init__(self, queue_length: int) -> None:
        self.pool = WorkPool(threads=1, queue_length=queue_length, timeout_s=5)
        self.let_go = threading.Event()
        self.order: list[str] = []
        self.refused: list[tuple[str, type[Exception]]] = []

    async def send(self, name: str, camera: str | None) -> None:
        def work(watch: Watch) -> None:
            self.let_go.wait(5)
            self.order.append(name)

        try:
            await self.pool.run(work, anyio.sleep_forever, camera)
        except (SupersededError, OverloadedError) as error:
            self.refused.append((name, type(error)))

    async def arrive(self, *frames: tuple[str, str | None]) -> None:
        """Send frames (name, camera) one after the other, and let all of them be done."""
        async with anyio.create_task_group() as tasks:
            for name, camera in frames:
                tasks.start_soon(self.send, name, camera)
                await anyio.wait_all_tasks_blocked()
            self.before = self.pool.inside
            self.let_go.set()


async def test_a_newer_frame_takes_the_place_of_the_one_that_waits() -> None:
    crossing = Crossing(queue_length=2)
    await crossing.arrive(
        ("yard1", "yard"), ("yard2", "yard"), ("gate1", "gate"), ("yard3", "yard")
    )
    assert crossing.refused == [("yard2", SupersededError)]
    # What runs is finished, and the place before the other camera is kept.
    assert crossing.order == ["yard1", "yard3", "gate1"]
    assert crossing.before == 3
    assert crossing.pool.inside == 0


async def test_where_all_is_taken_a_camera_may_still_replace_its_own() -> None:
    crossing = Crossing(queue_length=1)
    await crossing.arrive(
        ("yard1", "yard"), ("yard2", "yard"), ("gate1", "gate"), ("any", None), ("yard3", "yard")
    )
    assert crossing.refused == [
        ("gate1", OverloadedError),
        ("any", OverloadedError),
        ("yard2", SupersededError),
    ]
    assert crossing.order == ["yard1", "yard3"]
    assert crossing.pool.inside == 0


async def test_frames_of_nobody_in_particular_all_wait() -> None:
    crossing = Crossing(queue_length=3)
    await crossing.arrive(("a", None), ("b", None), ("c", None))
    assert crossing.refused == []
    assert crossing.order == ["a", "b", "c"]


async def test_a_frame_whose_client_has_gone_is_no_place_to_take() -> None:
    crossing = Crossing(queue_length=1)
    pool = crossing.pool
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(crossing.send, "yard1", "yard")
        await anyio.wait_all_tasks_blocked()
        async with anyio.create_task_group() as hasty:
            hasty.start_soon(crossing.send, "yard2", "yard")
            await anyio.wait_all_tasks_blocked()
            assert pool.is_full("gate")
            assert not pool.is_full("yard")
            hasty.cancel_scope.cancel()
        assert pool.inside == 1
        tasks.start_soon(crossing.send, "yard3", "yard")
        await anyio.wait_all_tasks_blocked()
        assert pool.inside == 2
        crossing.let_go.set()
    assert crossing.order == ["yard1", "yard3"]
    assert pool.inside == 0


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


@pytest.mark.parametrize("name", ["", "a b", "x" * 65, 'a"b'])
def test_a_name_that_is_none_is_refused(client: TestClient, photo: Photo, name: str) -> None:
    files = {"frame": photo.frame_png, "mask": photo.mask_png}
    response = client.post("/pose", files=files, headers={"X-Camera-ID": name})
    assert "A-Za-z0-9" in check_problem(response, 422, "X-Camera-ID")


@pytest.fixture
def busy(settings: Settings, estimator: Estimator) -> Iterator[TestClient]:
    """A service with one thread and room for one frame to wait."""
    narrow = settings.model_copy(update={"concurrency": 1, "queue_length": 1})
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
    pool = busy.app.state.runtime.pool
    files = {"frame": photo.frame_png, "mask": photo.mask_png}

    def ask() -> httpx.Response:
        return busy.post(path, files=files, headers={"X-Camera-ID": "yard"})

    def ask_and_be_inside(inside: int) -> Future[httpx.Response]:
        answer = threads.submit(ask)
        while pool.inside < inside and not answer.done():
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
    assert int(refused.headers["retry-after"]) >= 1
    assert sample(busy, "pose_rejected_total", reason="superseded") == 1
    assert sample(busy, "pose_rejected_total", reason="queue_full") is None
