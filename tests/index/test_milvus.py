"""The search by a real Milvus server, and the publication of an index there."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from index.artefact import load_index, save_index
from index.files import ArtefactError
from index.search import UnavailableError
from index.store import PoseIndex
from tests.conftest import build_tiny_index
from tests.support.milvus_server import why_milvus_cannot_run

if why_milvus_cannot_run() is None or TYPE_CHECKING:
    from index.milvus import (
        LARGEST_K,
        Contents,
        Milvus,
        MilvusNeighbours,
        check_vectors,
        publish,
        remove_older,
    )

pytestmark = pytest.mark.skipif(
    why_milvus_cannot_run() is not None, reason=str(why_milvus_cannot_run())
)


def saved(index: PoseIndex, folder: Path) -> PoseIndex:
    """The index as it is loaded, with a version."""
    save_index(index, folder)
    return load_index(folder)


@pytest.fixture(scope="module")
def tiny_index(tmp_path_factory: pytest.TempPathFactory) -> PoseIndex:
    """The tiny index as a version of its own, since other modules publish theirs."""
    index = replace(build_tiny_index(), name="published")
    return saved(index, tmp_path_factory.mktemp("own") / "index")


@pytest.fixture
def fresh(tmp_path: Path, request: pytest.FixtureRequest) -> PoseIndex:
    """An index that no other test publishes."""
    return saved(replace(build_tiny_index(), name=request.node.name), tmp_path / "index")


class KilledError(Exception):
    """The process was killed."""


def killed_after(batches: int) -> Any:
    """Progress of a publication that is killed after some batches."""

    def progress(starts: Sequence[int]) -> Iterator[int]:
        yield from starts[:batches]
        raise KilledError

    return progress


def note_writes(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, bool]]:
    """The first row of each batch that is written from now on, and whether it replaces others."""
    rows: list[tuple[int, bool]] = []
    write = Milvus.write

    def note(self: Milvus, name: str, start: int, vectors: Any, *, replace: bool) -> None:
        rows.append((start, replace))
        write(self, name, start, vectors, replace=replace)

    monkeypatch.setattr(Milvus, "write", note)
    return rows


@pytest.fixture(scope="module")
def published(milvus: Milvus, tiny_index: PoseIndex) -> MilvusNeighbours:
    """The tiny index, whose publication was killed in the middle of the fourth of six batches."""
    with pytest.raises(KilledError):
        publish(milvus, tiny_index, "published", batch=16, progress=killed_after(3))
    with pytest.raises(ArtefactError, match="there is no alias published"):
        milvus.resolve("published")
    name = Contents.of(tiny_index).collection
    milvus.write(name, 48, tiny_index.vectors[48:56].astype(np.float32), replace=False)
    with pytest.MonkeyPatch.context() as patch:
        rows = note_writes(patch)
        publish(milvus, tiny_index, "published", batch=16)
    assert rows == [(48, True), (64, True), (80, True)]
    return MilvusNeighbours(milvus, name, len(tiny_index))


class TestSearch:
    def test_it_finds_what_faiss_finds(
        self, tiny_index: PoseIndex, published: MilvusNeighbours
    ) -> None:
        rng = np.random.default_rng(0)
        vectors = tiny_index.vectors.astype(np.float32)
        queries = vectors + rng.normal(0, 0.3, vectors.shape).astype(np.float32)
        for k in (7, len(tiny_index)):
            expected, entries = tiny_index.neighbours.search(queries, k)
            squared, numbers = published.search(queries, k)
            assert np.allclose(squared, expected, rtol=1e-4)
            # Near ties may change places.
            apart = np.abs(np.diff(expected, axis=1)) > 1e-4 * expected[:, 1:]
            clear = np.pad(apart, ((0, 0), (1, 0)), constant_values=True)
            clear &= np.pad(apart, ((0, 0), (0, 1)), constant_values=k == len(tiny_index))
            assert clear.mean() > 0.8
            assert np.array_equal(numbers[clear], entries[clear])

    def test_an_index_searches_by_it(
        self, index_path: Path, tiny_index: PoseIndex, published: MilvusNeighbours
    ) -> None:
        index = load_index(index_path, published)
        query = tiny_index.vectors[5:7].astype(np.float32)[None] + np.float32(0.01)
        for found, expected in zip(
            index.search(query, 9), tiny_index.search(query, 9), strict=True
        ):
            assert np.allclose(found, expected, rtol=1e-4)

    def test_more_than_milvus_finds_at_once_is_refused(self, published: MilvusNeighbours) -> None:
        with pytest.raises(ValueError, match="expected k of at most"):
            published.search(np.zeros((1, 48), np.float32), LARGEST_K + 1)

    def test_an_answer_with_too_few_is_none(self, published: MilvusNeighbours) -> None:
        with pytest.raises(UnavailableError, match="found fewer than 97 vectors"):
            published.search(np.zeros((1, 48), np.float32), 97)

    def test_a_collection_of_other_vectors_is_noticed(
        self, tiny_index: PoseIndex, published: MilvusNeighbours, tmp_path: Path
    ) -> None:
        check_vectors(tiny_index, published)
        other = saved(build_tiny_index(seed=2), tmp_path / "other")
        with pytest.raises(ArtefactError, match="holds other vectors"):
            check_vectors(other, published)

    def test_a_missing_collection_is_reported(self, milvus: Milvus) -> None:
        with pytest.raises(UnavailableError, match="answered with an error") as caught:
            milvus.search("poses_gone", np.zeros((1, 48), np.float32), 1)
        assert caught.value.reason == "refused"


class TestPublish:
    def test_killed_and_run_again_it_goes_on(
        self, milvus: Milvus, tiny_index: PoseIndex, published: MilvusNeighbours
    ) -> None:
        name = milvus.resolve("published")
        assert name == f"poses_{tiny_index.version[7:19]}"
        assert milvus.describe(name).contents == Contents.of(tiny_index)
        assert milvus.count(name, 0, 10**9) == len(tiny_index)

    def test_published_again_nothing_is_written(
        self,
        milvus: Milvus,
        tiny_index: PoseIndex,
        published: MilvusNeighbours,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        written = note_writes(monkeypatch)
        publish(milvus, tiny_index, "published")
        assert written == []

    @pytest.mark.slow
    def test_it_switches_forth_and_back_and_removes_only_what_is_asked(
        self, milvus: Milvus, published: MilvusNeighbours, tmp_path: Path
    ) -> None:
        versions = [
            saved(replace(build_tiny_index(), name=f"version {number}"), tmp_path / str(number))
            for number in range(3)
        ]
        names = []
        for version in (*versions, versions[1]):
            collection = publish(milvus, version, "moving")
            names.append(collection.name)
            assert milvus.resolve("moving") == names[-1]
        assert names[3] == names[1]
        remaining = {collection.name for collection in milvus.collections()}
        assert set(names) <= remaining
        # The newest of the others, and everything that another alias names, stays.
        removed = remove_older(milvus, collection, keep=1)
        assert names[0] in removed
        assert {names[1], names[2]}.isdisjoint(removed)
        assert milvus.resolve("published") not in removed
        assert {found.name for found in milvus.collections()} == remaining - set(removed)

    @pytest.mark.slow
    def test_a_collection_of_something_else_is_left_alone(
        self, milvus: Milvus, fresh: PoseIndex
    ) -> None:
        contents = Contents.of(fresh)
        milvus.create(replace(contents, version=f"{contents.version[:19]}0"), shards=1, replicas=1)
        with pytest.raises(ArtefactError, match="expected Contents"):
            publish(milvus, fresh, "taken")

    @pytest.mark.slow
    def test_rows_written_twice_are_there_once(self, milvus: Milvus, fresh: PoseIndex) -> None:
        name = Contents.of(fresh).collection
        milvus.create(Contents.of(fresh), shards=1, replicas=1)
        rows = fresh.vectors[:16].astype(np.float32)
        for _ in range(2):
            milvus.write(name, 0, rows, replace=False)
        # The doubtful batch is written anew, which leaves each row once.
        publish(milvus, fresh, "doubled", batch=16)
        assert milvus.count(name, 0, 10**9) == len(fresh)


def test_an_unreachable_server_is_reported_at_once() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    milvus = Milvus(f"127.0.0.1:{port}", 5.0)
    with pytest.raises(UnavailableError, match="cannot be reached") as caught:
        milvus.resolve("poses")
    assert caught.value.reason == "unreachable"


def test_a_server_that_is_silent_is_given_up_at_the_deadline() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        milvus = Milvus(f"127.0.0.1:{silent.getsockname()[1]}", 0.3)
        started = time.monotonic()
        with pytest.raises(UnavailableError, match=r"did not answer in 0\.3 s") as caught:
            milvus.search("poses_x", np.zeros((1, 48), np.float32), 1)
        assert time.monotonic() - started < 5
    assert caught.value.reason == "deadline"
