"""An index in Milvus: what clients notice of failing searches, and of another index published."""

import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fastapi.testclient import TestClient
from numpy.typing import NDArray

from app import serving
from app.main import create_app
from app.photograph import Estimator
from app.settings import Settings
from index.artefact import ArtefactError, load_index
from index.search import Neighbours, SearchUnavailableError
from index.store import PoseIndex
from tests.conftest import INDEXES, Photo
from tests.support.service import check_problem, eventually, sample, send


class FakeMilvus:
    """Publishes an index, searches it as this process does, and fails on demand."""

    def __init__(self, neighbours: Neighbours, index_path: Path) -> None:
        self._neighbours = neighbours
        self.published = load_index(index_path, self)
        self.error: Exception | None = None
        self.polls = 0

    def __len__(self) -> int:
        return len(self._neighbours)

    def search(
        self, queries: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        if self.error is not None:
            raise self.error
        return self._neighbours.search(queries, k)

    def load_published(self, uri: str, artefacts: Path, known: str) -> PoseIndex | None:
        self.polls += 1
        if self.error is not None:
            raise self.error
        return None if self.published.version == known else self.published


@pytest.fixture
def milvus(
    tiny_index: PoseIndex, index_path: Path, estimator: Estimator, monkeypatch: pytest.MonkeyPatch
) -> FakeMilvus:
    fake = FakeMilvus(tiny_index.neighbours, index_path)
    module = SimpleNamespace(load_published=fake.load_published)
    monkeypatch.setitem(sys.modules, "index.milvus", module)
    monkeypatch.setattr(serving, "POLL_S", 0.01)
    # The networks are loaded already.
    monkeypatch.setattr(serving, "load_estimator", lambda _, read: estimator.with_index(read()))
    return fake


AWAY = SearchUnavailableError("Milvus failed: nothing at 10.0.0.7")
ERRORS = [(AWAY, str(AWAY)), (ArtefactError("none"), "none"), (KeyError(), "the log says more")]


@pytest.fixture(params=ERRORS[:1])
def client(
    milvus: FakeMilvus, settings: Settings, request: pytest.FixtureRequest
) -> Iterator[TestClient]:
    """A client of a service whose index is in Milvus, which could not be loaded at first."""
    milvus.error, said = request.param
    with TestClient(create_app(settings.model_copy(update={"milvus": "http://m"}))) as client:
        eventually(lambda: said in check_problem(client.get("/readyz"), 503))
        milvus.error = None
        eventually(lambda: client.get("/readyz").status_code == 200)
        yield client


def test_requests_that_search_are_refused_and_all_others_answered(
    client: TestClient, milvus: FakeMilvus, photo: Photo
) -> None:
    milvus.error = AWAY
    for path in ("/pose", "/pose/overlay", "/cameras/yard/frames", "/pose"):
        response = client.post(path, files=photo.files)
        detail = check_problem(response, 503)
        assert detail.startswith("the index cannot be searched at present")
        # The address of Milvus concerns the operator alone.
        assert "10.0.0.7" not in response.text
    assert sample(client, "pose_rejected_total", reason="unavailable") == 4
    for path in ("/readyz", "/index", "/index/entries/5"):
        assert client.get(path).status_code == 200
    assert client.post("/silhouette", files=photo.files).status_code == 200
    milvus.error = None
    assert client.post("/pose", files=photo.files).status_code == 200


def test_another_index_is_served_once_it_is_published(
    client: TestClient, milvus: FakeMilvus, photo: Photo
) -> None:
    assert send(client, photo).headers["x-session"] == "new"
    milvus.published = load_index(INDEXES / "toy")
    version = milvus.published.version
    eventually(lambda: client.get("/index").json()["version"] == version)
    assert sample(client, "pose_camera_sessions_ended_total", reason="index") == 1
    assert send(client, photo).headers["x-session"] == "new"


@pytest.mark.parametrize("client", ERRORS, indirect=True)
def test_an_index_that_cannot_be_loaded_leaves_the_one_before(
    client: TestClient, milvus: FakeMilvus, caplog: pytest.LogCaptureFixture
) -> None:
    version = client.get("/index").json()["version"]
    for error in (AWAY, ArtefactError("none"), KeyError()):
        milvus.error, polls = error, milvus.polls
        eventually(lambda polls=polls: milvus.polls >= polls + 4)
    assert client.get("/index").json()["version"] == version
    for sentence in (AWAY, "none"):
        assert caplog.text.count(f"still serving the index before: {sentence}") == 1
