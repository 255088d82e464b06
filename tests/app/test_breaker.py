"""The circuit breaker, and what the service answers where the search fails."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from fastapi.testclient import TestClient
from numpy.typing import NDArray

from app.estimation.estimator import Estimator
from app.main import create_app
from app.serving import loading
from app.serving.breaker import CircuitBreaker, GuardedNeighbours
from app.serving.runtime import Runtime
from app.settings import Settings
from index.artefact import load_index
from index.milvus_address import MilvusAddress
from index.neighbours import FailureReason, Neighbours, UnavailableError
from index.store import PoseIndex
from index.verified_files import ArtefactError
from tests.app.test_errors import check_problem
from tests.app.test_metrics import sample
from tests.conftest import Photo
from tests.videos import write_video


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


class TestCircuitBreaker:
    def test_it_opens_after_failures_in_a_row_and_asks_no_more(self, flaky: Flaky) -> None:
        reasons: list[FailureReason] = []
        breaker = CircuitBreaker(reasons.append, open_after=3)
        guarded = GuardedNeighbours(flaky, breaker)
        query = np.zeros((1, 48), np.float32)
        for failing in (True, True, False, True, True, True):
            assert not breaker.is_open
            flaky.failing = failing
            if failing:
                with pytest.raises(UnavailableError):
                    guarded.search(query, 1)
            else:
                guarded.search(query, 1)
        assert breaker.is_open
        assert reasons == ["unreachable"] * 5
        asked = flaky.asked
        with pytest.raises(UnavailableError, match="cannot be reached"):
            guarded.search(query, 1)
        assert flaky.asked == asked
        assert len(reasons) == 5

    def test_a_search_that_succeeds_closes_it(self, flaky: Flaky) -> None:
        breaker = CircuitBreaker(open_after=1)
        guarded = GuardedNeighbours(flaky, breaker)
        query = np.zeros((1, 48), np.float32)
        flaky.failing = True
        with pytest.raises(UnavailableError):
            guarded.search(query, 1)
        flaky.failing = False
        guarded.search_anyway(query, 1)
        assert not breaker.is_open
        assert guarded.search(query, 2)[1].shape == (1, 2)
        assert len(guarded) == len(flaky)


@pytest.fixture
def client(
    settings: Settings, estimator: Estimator, index_path: Path, flaky: Flaky
) -> Iterator[TestClient]:
    """A client of an application whose search is flaky."""
    app = create_app(settings, estimator)
    guarded = GuardedNeighbours(flaky, app.state.runtime.breaker)
    app.state.runtime.estimator = estimator.with_index(load_index(index_path, guarded))
    with TestClient(app, raise_server_exceptions=False) as client:
        yield client


class TestService:
    def test_all_that_searches_is_refused_and_all_else_goes_on(
        self, client: TestClient, flaky: Flaky, photo: Photo
    ) -> None:
        files = {"frame": photo.frame_png, "mask": photo.mask_png}
        flaky.failing = True
        for path in ("/pose", "/pose/overlay", "/cameras/yard/frames", "/pose"):
            response = client.post(path, files=files)
            check_problem(response, 503)
            assert int(response.headers["retry-after"]) >= 1
            assert response.json()["detail"].startswith("the index cannot be searched at present")
            # Where Milvus is concerns the operator alone.
            assert "10.0.0.7" not in response.text
        assert flaky.asked == 3
        assert sample(client, "pose_search_breaker_open") == 1
        assert sample(client, "pose_search_failures_total", reason="unreachable") == 3
        assert sample(client, "pose_rejected_total", reason="unavailable") == 4
        for path in ("/readyz", "/index", "/index/entries/5"):
            assert client.get(path).status_code == 200
        assert client.post("/silhouette", files=files).status_code == 200

    def test_a_failure_leaves_a_camera_session_usable(
        self, client: TestClient, flaky: Flaky, photo: Photo
    ) -> None:
        files = {"frame": photo.frame_png, "mask": photo.mask_png}

        def send(timestamp: float) -> tuple[int, str]:
            data = {"timestamp": str(timestamp)}
            response = client.post("/cameras/yard/frames", files=files, data=data)
            return response.status_code, response.headers["x-session"]

        assert send(1.0) == (200, "new")
        flaky.failing = True
        assert send(1.1) == (503, "warm")
        flaky.failing = False
        assert send(1.2) == (200, "warm")

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
    """An alias that names one collection or another, none of them far away.

    Parameters
    ----------
    index : PoseIndex
    """

    def __init__(self, index: PoseIndex) -> None:
        self.named: PoseIndex | None = index
        self.loaded: PoseIndex | None = None
        self.error: Exception | None = None
        self.connections = 1

    def load(self) -> PoseIndex | None:
        if self.error is not None:
            raise self.error
        if self.named is self.loaded:
            return None
        self.loaded = self.named
        return self.loaded

    def reconnect(self) -> None:
        self.connections += 1


class TestFollower:
    @pytest.fixture
    def follower(
        self, settings: Settings, index_path: Path, flaky: Flaky, monkeypatch: pytest.MonkeyPatch
    ) -> loading._Follower:
        runtime: Runtime = create_app(settings).state.runtime
        index = load_index(index_path, GuardedNeighbours(flaky, runtime.breaker))
        monkeypatch.setattr(loading, "check_milvus_package", lambda: None)
        monkeypatch.setattr(loading, "RemoteIndex", lambda *_: FakeRemote(index))
        return loading._Follower(runtime, MilvusAddress("vectors", 19530, "poses"))

    def test_it_gets_ready_although_first_searches_have_opened_the_breaker(
        self, follower: loading._Follower, flaky: Flaky
    ) -> None:
        flaky.failing = True
        for _ in range(5):
            with pytest.raises(UnavailableError):
                follower.first()
        assert follower._runtime.breaker.is_open
        flaky.failing = False
        assert len(follower.first().index) == len(flaky)

    def test_it_moves_over_and_keeps_the_networks(
        self, follower: loading._Follower, estimator: Estimator, index_path: Path
    ) -> None:
        before = follower._runtime.estimator = follower.first()
        assert follower.next() is None
        remote = cast(FakeRemote, follower._remote)
        remote.named = load_index(index_path)
        after = follower.next()
        assert after is not None
        assert after.index is remote.named
        assert before.index is not after.index
        assert after.finder is before.finder

    @pytest.mark.parametrize(
        "error", [ArtefactError("no artefact"), UnavailableError("away", "deadline"), KeyError()]
    )
    def test_what_cannot_be_loaded_leaves_the_one_before(
        self, follower: loading._Follower, error: Exception, caplog: pytest.LogCaptureFixture
    ) -> None:
        follower._runtime.estimator = follower.first()
        cast(FakeRemote, follower._remote).error = error
        assert [follower.next() for _ in range(3)] == [None] * 3
        if isinstance(error, ArtefactError):
            assert caplog.text.count("still serving the index before: no artefact") == 1

    def test_while_the_breaker_is_open_it_searches_over_a_new_connection(
        self, follower: loading._Follower, flaky: Flaky
    ) -> None:
        follower._runtime.estimator = follower.first()
        breaker = follower._runtime.breaker
        flaky.failing = True
        while not breaker.is_open:
            breaker.failed(UnavailableError("away", "unreachable"))
        for _ in range(2):
            assert follower.next() is None
            assert breaker.is_open
        flaky.failing = False
        assert follower.next() is None
        assert not breaker.is_open
        assert cast(FakeRemote, follower._remote).connections == 4
