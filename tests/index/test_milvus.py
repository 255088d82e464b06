"""An index published in Milvus, and searched there: Milvus Lite, in this process."""

import shutil
import socket
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from index.artefact import ArtefactError, load_index
from index.search import SearchUnavailableError
from index.store import PoseIndex
from tests.conftest import INDEXES
from tests.index.helpers import seal

pytest.importorskip("milvus_lite", reason="needs the extra milvus")

from index.milvus import MilvusNeighbours, load_published
from scripts import publish as publishing
from scripts.publish import main, publish

Versions = tuple[PoseIndex, PoseIndex]


@pytest.fixture(scope="module")
def artefacts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two versions of the tiny index."""
    folder = tmp_path_factory.mktemp("artefacts")
    for number in (1, 2):
        shutil.copytree(INDEXES / "sticks", folder / str(number))
    seal(folder / "2", lambda manifest: manifest.update(name="other"))
    return folder


@pytest.fixture(scope="module")
def versions(artefacts: Path) -> Versions:
    return load_index(artefacts / "1"), load_index(artefacts / "2")


@pytest.fixture
def uri(tmp_path: Path) -> str:
    return str(tmp_path / "milvus.db")


def test_it_finds_the_nearest_vectors(uri: str, artefacts: Path, versions: Versions) -> None:
    vectors = versions[0].vectors[:]
    publish(uri, versions[0])
    published = load_published(uri, artefacts)
    assert published is not None and isinstance(published.neighbours, MilvusNeighbours)
    queries = vectors + np.random.default_rng(0).normal(0, 0.3, vectors.shape).astype(np.float32)
    apart = np.square(queries[:, None] - vectors).sum(axis=2)
    for k in (1, 7, len(vectors)):
        squared, found = published.neighbours.search(queries, k)
        assert (squared.dtype, found.dtype) == (np.float32, np.int64)
        assert np.allclose(squared, np.sort(apart, axis=1)[:, :k], rtol=1e-4)
        assert np.allclose(squared, np.take_along_axis(apart, found, axis=1), rtol=1e-4)
    with pytest.raises(SearchUnavailableError, match="fewer than 97 vectors"):
        published.neighbours.search(queries, 97)


def test_the_alias_moves_to_another_index_and_back(
    uri: str, artefacts: Path, versions: Versions
) -> None:
    with pytest.raises(SearchUnavailableError, match="'poses' does not exist"):
        load_published(uri, artefacts)
    known = ""
    for number in ("1", "2", "1"):
        main([uri, "--index", str(artefacts / number)])
        loaded = load_published(uri, artefacts, known)
        assert loaded is not None and loaded.version == versions[int(number) - 1].version
        known = loaded.version
        assert load_published(uri, artefacts, known) is None


def test_an_interrupted_publication_can_be_repeated(
    uri: str, artefacts: Path, versions: Versions, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(starts: range, **_: object) -> object:
        yield from starts[:2]
        raise KeyboardInterrupt

    before, index = versions
    publish(uri, before)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(publishing, "BATCH", 40)
        patch.setattr(publishing, "tqdm", killed)
        publish(uri, index)
    assert load_published(uri, artefacts, before.version) is None
    publish(uri, index)
    assert load_published(uri, artefacts, index.version) is None


def test_a_collection_of_other_vectors_is_not_served(
    uri: str, artefacts: Path, versions: Versions
) -> None:
    publish(uri, replace(versions[0], version=versions[1].version))
    for attempt in (lambda: load_published(uri, artefacts), lambda: publish(uri, versions[1])):
        with pytest.raises(ArtefactError, match="holds other vectors"):
            attempt()
    with pytest.raises(ArtefactError, match="expected an artefact of version"):
        load_published(uri, artefacts / "1")


@pytest.mark.parametrize("silent", [True, False])
def test_a_server_that_does_not_answer_is_given_up(artefacts: Path, silent: bool) -> None:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        if silent:
            server.listen()
        address = f"http://us:secret@127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(SearchUnavailableError, match="Milvus failed: Fail conn") as caught:
            load_published(address, artefacts)
    assert "secret" not in str(caught.value)
