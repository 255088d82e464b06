"""An index in Milvus: failing searches, and following an alias."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.main import create_app
from app.photograph import Estimator
from app.serving import loading
from app.serving.milvus import ObservedNeighbours, RemoteIndex
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
    """A search in this process that fails on demand."""

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


@given(failing=st.lists(st.booleans(), max_size=12))
def test_every_search_asks_and_its_outcome_is_reported(
    tiny_index: PoseIndex, failing: list[bool]
) -> None:
    flaky, outcomes = Flaky(tiny_index.neighbours), list[FailureReason | None]()
    observed = ObservedNeighbours(flaky, outcomes.append)
    query = np.zeros((1, 48), np.float32)
    for flaky.failing in failing:
        if flaky.failing:
            with pytest.raises(UnavailableError, match="cannot be reached"):
                observed.search(query, 1)
        else:
            assert observed.search(query, 2)[1].shape == (1, 2)
    assert flaky.asked == len(failing)
    assert outcomes == ["unreachable" if failed else None for failed in failing]


def test_the_log_says_where_failures_begin_and_end(
    flaky: Flaky, caplog: pytest.LogCaptureFixture
) -> None:
    observed = ObservedNeighbours(flaky, lambda failure: None)
    with caplog.at_level(logging.INFO, "app"):
        for flaky.failing in (False, True, True, False, False):
            with suppress(UnavailableError):
                observed.search(np.zeros((1, 48), np.float32), 1)
    assert [record.getMessage() for record in caplog.records] == [
        "searches fail: Milvus at 10.0.0.7:19530 cannot be reached",
        "searches succeed again",
    ]


@pytest.fixture
def client(
    serving: Serving, estimator: Estimator, index_path: Path, flaky: Flaky
) -> Iterator[TestClient]:
    """A client of an application whose searches fail on demand."""
    with serving() as client:
        runtime: Runtime = client.app.state.runtime  # type: ignore[attr-defined]
        observed = ObservedNeighbours(flaky, runtime.metrics.observe_search)
        runtime.estimator = estimator.with_index(load_index(index_path, observed))
        yield client


class TestService:
    def test_requests_that_search_are_refused_and_all_others_answered(
        self, client: TestClient, flaky: Flaky, photo: Photo
    ) -> None:
        flaky.failing = True
        for path in ("/pose", "/pose/overlay", "/cameras/yard/frames", "/pose"):
            response = client.post(path, files=photo.files)
            detail = check_problem(response, 503)
            assert detail.startswith("the index cannot be searched at present")
            # The address of Milvus concerns the operator alone.
            assert "10.0.0.7" not in response.text
        assert sample(client, "pose_search_breaker_open") == 1
        assert sample(client, "pose_search_failures_total", reason="unreachable") == 4
        assert sample(client, "pose_rejected_total", reason="unavailable") == 4
        for path in ("/readyz", "/index", "/index/entries/5"):
            assert client.get(path).status_code == 200
        assert client.post("/silhouette", files=photo.files).status_code == 200
        flaky.failing = False
        assert client.post("/pose", files=photo.files).status_code == 200
        assert sample(client, "pose_search_breaker_open") == 0

    def test_a_failure_leaves_a_camera_session_usable(
        self, client: TestClient, flaky: Flaky, photo: Photo
    ) -> None:
        answers = []
        for failing in (False, True, False):
            flaky.failing = failing
            response = send(client, photo)
            answers.append((response.status_code, response.headers["x-session"]))
        assert answers == [(200, "new"), (503, "warm"), (200, "warm")]

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
    """An alias that names one index or another, without Milvus."""

    def __init__(self, named: PoseIndex) -> None:
        self.named = named
        self.error: Exception | None = None
        self.asked = 0
        self._loaded: PoseIndex | None = None

    def load(self) -> PoseIndex | None:
        self.asked += 1
        if self.error is not None:
            raise self.error
        if self.named is self._loaded:
            return None
        self._loaded = self.named
        return self._loaded


class TestFollowing:
    """An application whose index is in Milvus, polled all the time."""

    @pytest.fixture
    def app(
        self, settings: Settings, estimator: Estimator, monkeypatch: pytest.MonkeyPatch
    ) -> FastAPI:
        monkeypatch.setattr(loading, "check_milvus_package", lambda: None)
        # The networks are loaded already.
        monkeypatch.setattr(loading, "load_estimator", lambda _, index: estimator.with_index(index))
        for pause in ("POLL_S", "RETRY_S", "MAX_RETRY_S"):
            monkeypatch.setattr(loading, pause, 0.01)
        address = MilvusAddress("vectors", 19530, "poses")
        return create_app(settings.model_copy(update={"index": address}))

    @pytest.fixture
    def remote(
        self, app: FastAPI, index_path: Path, flaky: Flaky, monkeypatch: pytest.MonkeyPatch
    ) -> FakeRemote:
        observed = ObservedNeighbours(flaky, app.state.runtime.metrics.observe_search)
        remote = FakeRemote(load_index(index_path, observed))
        monkeypatch.setattr(loading, "RemoteIndex", lambda *_: remote)
        return remote

    @pytest.fixture
    def ready(self, app: FastAPI, remote: FakeRemote) -> Iterator[TestClient]:
        with TestClient(app) as client:
            eventually(lambda: client.get("/readyz").status_code == 200)
            yield client

    @pytest.mark.parametrize("searches", [True, False])
    def test_it_gets_ready_as_soon_as_milvus_answers(
        self, app: FastAPI, remote: FakeRemote, flaky: Flaky, searches: bool
    ) -> None:
        if searches:
            remote.error = UnavailableError("Milvus cannot be reached", "unreachable")
        else:
            flaky.failing = True
        with TestClient(app) as client:
            eventually(lambda: "cannot be reached" in check_problem(client.get("/readyz"), 503))
            assert sample(client, "pose_search_breaker_open") == (not searches)
            flaky.failing, remote.error = False, None
            eventually(lambda: client.get("/readyz").status_code == 200)
            assert sample(client, "pose_search_breaker_open") == 0

    def test_it_switches_to_another_version(
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
    def test_an_index_that_cannot_be_loaded_leaves_the_one_before(
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


def test_a_milvus_that_does_not_answer_gets_a_new_connection(
    index_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    class SilentMilvus:
        def __init__(self, *_: object) -> None:
            pass

        def resolve(self, alias: str) -> str:
            calls.append(alias)
            raise UnavailableError("Milvus did not answer", "deadline")

        def reconnect(self) -> None:
            calls.append("reconnect")

    monkeypatch.setitem(
        sys.modules,
        "index.milvus",
        SimpleNamespace(Milvus=SilentMilvus, MilvusNeighbours=None, check_vectors=None),
    )
    remote = RemoteIndex(MilvusAddress("m", 1, "poses"), index_path, 1.0, lambda failure: None)
    for _ in range(2):
        with pytest.raises(UnavailableError):
            remote.load()
    assert calls == ["poses", "reconnect"] * 2
