"""The circuit breaker, and what the service answers where the search fails."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.estimation.estimator import Estimator
from app.main import create_app
from app.serving import loading
from app.serving.milvus import OPEN_AFTER, CircuitBreaker, GuardedNeighbours
from app.serving.runtime import Runtime
from app.settings import Settings
from index.artefact import load_index, save_index
from index.files import ArtefactError
from index.milvus_address import MilvusAddress
from index.search import FailureReason, Neighbours, UnavailableError
from index.store import PoseIndex
from tests.conftest import Photo, Serving
from tests.support.service import check_problem, eventually, sample, send
from tests.support.videos import write_video


class Flaky:
    """Searches in this process, or fails."""

    def __init__(self, neighbours: Neighbours) -> None:
        self._neighbours = neighbours
        self.failing = False
        self.asked = 0

    def __len__(self) -> int:
        return len(self._neighbours)

    def search(
        self, queries: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        self.asked += 1
        if self.failing:
            raise UnavailableError("Milvus at 10.0.0.7:19530 cannot be reached", "unreachable")
        return self._neighbours.search(queries, k)


@pytest.fixture
def flaky(tiny_index: PoseIndex) -> Flaky:
    return Flaky(tiny_index.neighbours)


@given(failing=st.lists(st.booleans(), max_size=12), open_after=st.integers(1, 4))
def test_after_so_many_failures_in_a_row_nothing_is_asked_until_a_search_succeeds(
    tiny_index: PoseIndex, failing: list[bool], open_after: int
) -> None:
    flaky, reasons = Flaky(tiny_index.neighbours), list[FailureReason]()
    breaker = CircuitBreaker(reasons.append, open_after)
    guarded = GuardedNeighbours(flaky, breaker)
    query = np.zeros((1, 48), np.float32)
    in_a_row = 0
    for flaky.failing in failing:
        opened, asked = in_a_row >= open_after, flaky.asked
        assert breaker.is_open == opened
        if flaky.failing or opened:
            with pytest.raises(UnavailableError, match="cannot be reached"):
                guarded.search(query, 1)
        else:
            assert guarded.search(query, 2)[1].shape == (1, 2)
        assert flaky.asked == asked + (not opened)
        in_a_row = in_a_row + (not opened) if flaky.failing or opened else 0
    assert set(reasons) <= {"unreachable"}
    flaky.failing = False
    guarded.search_anyway(query, 1)
    assert not breaker.is_open


@pytest.fixture
def client(
    serving: Serving, estimator: Estimator, index_path: Path, flaky: Flaky
) -> Iterator[TestClient]:
    """A client of an application whose search is flaky."""
    with serving() as client:
        runtime: Runtime = client.app.state.runtime  # type: ignore[attr-defined]
        guarded = GuardedNeighbours(flaky, runtime.breaker)
        runtime.estimator = estimator.with_index(load_index(index_path, guarded))
        yield client


class TestService:
    def test_all_that_searches_is_refused_and_all_else_goes_on(
        self, client: TestClient, flaky: Flaky, photo: Photo
    ) -> None:
        flaky.failing = True
        for path in ("/pose", "/pose/overlay", "/cameras/yard/frames", "/pose"):
            response = client.post(path, files=photo.files)
            detail = check_problem(response, 503)
            assert detail.startswith("the index cannot be searched at present")
            # Where Milvus is concerns the operator alone.
            assert "10.0.0.7" not in response.text
        assert flaky.asked == 3
        assert sample(client, "pose_search_breaker_open") == 1
        assert sample(client, "pose_search_failures_total", reason="unreachable") == 3
        assert sample(client, "pose_rejected_total", reason="unavailable") == 4
        for path in ("/readyz", "/index", "/index/entries/5"):
            assert client.get(path).status_code == 200
        assert client.post("/silhouette", files=photo.files).status_code == 200

    def test_a_failure_leaves_a_camera_session_usable(
        self, client: TestClient, flaky: Flaky, photo: Photo
    ) -> None:
        told = []
        for failing in (False, True, False):
            flaky.failing = failing
            response = send(client, photo)
            told.append((response.status_code, response.headers["x-session"]))
        assert told == [(200, "new"), (503, "warm"), (200, "warm")]

    def test_a_video_ends_with_a_line_that_says_why(
        self, client: TestClient, flaky: Flaky, photo: Photo, tmp_path: Path
    ) -> None:
        video = write_video(tmp_path / "v.avi", [photo.frame] * 12)
        flaky.failing = True
        response = client.post("/sequence", files={"video": video})
        assert response.status_code == 200
        end = json.loads(response.text.splitlines()[-1])
        assert (end["type"], end["reason"]) == ("end", "unavailable")


class FakeRemote:
    """An alias that names one collection or another, none of them far away."""

    def __init__(self, named: PoseIndex) -> None:
        self.named = named
        self.error: Exception | None = None
        self.asked = self.connections = 0
        self._loaded: PoseIndex | None = None

    def load(self) -> PoseIndex | None:
        self.asked += 1
        if self.error is not None:
            raise self.error
        if self.named is self._loaded:
            return None
        self._loaded = self.named
        return self._loaded

    def reconnect(self) -> None:
        self.connections += 1


class TestFollowing:
    """An application whose index is in Milvus, which is asked all the time."""

    @pytest.fixture
    def app(
        self, settings: Settings, estimator: Estimator, monkeypatch: pytest.MonkeyPatch
    ) -> FastAPI:
        monkeypatch.setattr(loading, "check_milvus_package", lambda: None)
        # Its networks are those that are loaded already.
        monkeypatch.setattr(Estimator, "load", lambda *given: estimator.with_index(given[-1]))
        for pause in ("ASKED_EVERY_S", "PROBED_EVERY_S", "LONGEST_PAUSE_S"):
            monkeypatch.setattr(loading, pause, 0.01)
        address = MilvusAddress("vectors", 19530, "poses")
        return create_app(settings.model_copy(update={"index": address}))

    @pytest.fixture
    def remote(
        self, app: FastAPI, index_path: Path, flaky: Flaky, monkeypatch: pytest.MonkeyPatch
    ) -> FakeRemote:
        guarded = GuardedNeighbours(flaky, app.state.runtime.breaker)
        remote = FakeRemote(load_index(index_path, guarded))
        monkeypatch.setattr(loading, "RemoteIndex", lambda *_: remote)
        return remote

    @pytest.fixture
    def ready(self, app: FastAPI, remote: FakeRemote) -> Iterator[TestClient]:
        with TestClient(app) as client:
            eventually(lambda: client.get("/readyz").status_code == 200)
            yield client

    def test_it_gets_ready_although_first_searches_have_opened_the_breaker(
        self, app: FastAPI, remote: FakeRemote, flaky: Flaky
    ) -> None:
        flaky.failing = True
        with TestClient(app) as client:
            eventually(lambda: sample(client, "pose_search_breaker_open") == 1)
            assert "cannot be reached" in check_problem(client.get("/readyz"), 503)
            flaky.failing = False
            eventually(lambda: client.get("/readyz").status_code == 200)
        assert remote.connections >= 1

    def test_it_moves_over_to_another_version(
        self, ready: TestClient, remote: FakeRemote, photo: Photo, tmp_path: Path
    ) -> None:
        assert send(ready, photo).headers["x-session"] == "new"
        save_index(replace(remote.named, name="others"), tmp_path / "others")
        other = load_index(tmp_path / "others")
        remote.named = other
        eventually(lambda: ready.get("/index").json()["version"] == other.version)
        assert sample(ready, "pose_camera_sessions_ended_total", reason="index") == 1
        assert send(ready, photo).headers["x-session"] == "new"

    @pytest.mark.parametrize(
        "error", [ArtefactError("no artefact"), UnavailableError("away", "deadline"), KeyError()]
    )
    def test_what_cannot_be_loaded_leaves_the_one_before(
        self,
        ready: TestClient,
        remote: FakeRemote,
        error: Exception,
        caplog: pytest.LogCaptureFixture,
    ) -> None:
        version = ready.get("/index").json()["version"]
        remote.error, asked = error, remote.asked
        eventually(lambda: remote.asked >= asked + 3)
        assert ready.get("/index").json()["version"] == version
        if isinstance(error, ArtefactError):
            assert caplog.text.count("still serving the index before: no artefact") == 1

    def test_while_the_breaker_is_open_it_searches_over_a_new_connection(
        self, ready: TestClient, remote: FakeRemote, flaky: Flaky, photo: Photo
    ) -> None:
        flaky.failing = True
        for _ in range(OPEN_AFTER):
            check_problem(ready.post("/pose", files=photo.files), 503)
        connections = remote.connections
        eventually(lambda: remote.connections >= connections + 2)
        assert sample(ready, "pose_search_breaker_open") == 1
        flaky.failing = False
        eventually(lambda: sample(ready, "pose_search_breaker_open") == 0)
