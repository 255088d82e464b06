"""Approximate searches: exact where they look everywhere, and the same from file as built."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path

import faiss
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from index import artefact
from index.approximate import ApproximateNeighbours, Hnsw, Ivf, method_of
from index.artefact import copy_index, load_index, save_index
from index.matching import match
from index.neighbours import STEPS, ExactNeighbours
from index.store import PoseIndex
from index.verified_files import ArtefactError

METHODS = (Ivf(nlist=16, nprobe=4), Hnsw(m=8, ef_construction=40, ef_search=64))
DIMENSION = 16


def clustered(count: int, seed: int = 0) -> NDArray[np.float32]:
    """Vectors about 40 centres, in steps as those of an index."""
    generator = np.random.default_rng(seed)
    centres = np.random.default_rng(99).normal(0, 5, (40, DIMENSION))
    vectors = centres[generator.integers(40, size=count)] + generator.normal(
        0, 1.5, (count, DIMENSION)
    )
    steps = np.rint(vectors * STEPS).clip(-127, 127)
    return (steps / STEPS).astype(np.float32)


VECTORS = clustered(3000)
"""In steps: stored as bytes."""

ANY = np.random.default_rng(5).normal(0, 2, (800, DIMENSION)).astype(np.float32)
"""Not in steps: stored as floats."""

QUERIES = clustered(60, seed=1)
"""In steps, as they are rounded to among bytes."""


def distances(
    vectors: NDArray[np.float32], queries: NDArray[np.float32], numbers: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Squared distances ``(Q, k)`` to the given vectors."""
    apart = queries[:, None].astype(np.float64) - vectors[numbers]
    return np.asarray((apart**2).sum(axis=-1))


@pytest.mark.parametrize("vectors", [VECTORS, ANY], ids=["bytes", "floats"])
class TestSearch:
    def test_of_all_lists_is_the_exact_search(self, vectors: NDArray[np.float32]) -> None:
        everywhere = ApproximateNeighbours.build(vectors, Ivf(nlist=16, nprobe=16))
        squared, numbers = everywhere.search(QUERIES, 50)
        expected, expected_numbers = ExactNeighbours(vectors).search(QUERIES, 50)
        np.testing.assert_allclose(squared, expected, rtol=1e-5)
        # The same vectors, but for ties.
        settled = (np.diff(expected, axis=1, prepend=-1) > 1e-3) & (
            np.diff(expected, axis=1, append=1e9) > 1e-3
        )
        assert settled.mean() > 0.5
        assert_array_equal(numbers[settled], expected_numbers[settled])

    @pytest.mark.parametrize("method", METHODS)
    def test_distances_of_what_is_found_are_exact(
        self, vectors: NDArray[np.float32], method: Ivf | Hnsw
    ) -> None:
        squared, numbers = ApproximateNeighbours.build(vectors, method).search(QUERIES, 20)
        np.testing.assert_allclose(squared, distances(vectors, QUERIES, numbers), rtol=1e-4)
        assert (np.diff(squared, axis=1) >= 0).all()

    @pytest.mark.parametrize("method", METHODS)
    @pytest.mark.parametrize("k", [400, 800])
    def test_all_that_were_asked_for_are_found(
        self, vectors: NDArray[np.float32], method: Ivf | Hnsw, k: int
    ) -> None:
        """Even where the lists searched, or what the graph reaches, hold fewer."""
        squared, numbers = ApproximateNeighbours.build(vectors, method).search(QUERIES[:9], k)
        assert squared.shape == numbers.shape == (9, k)
        assert (numbers >= 0).all() and np.isfinite(squared).all()
        assert all(len(set(row)) == k for row in numbers.tolist())
        np.testing.assert_allclose(squared, distances(vectors, QUERIES[:9], numbers), rtol=1e-4)

    @pytest.mark.parametrize("method", METHODS)
    def test_built_twice_is_the_same_to_the_byte(
        self, vectors: NDArray[np.float32], method: Ivf | Hnsw
    ) -> None:
        first, second = (ApproximateNeighbours.build(vectors, method) for _ in range(2))
        assert first.to_bytes() == second.to_bytes()

    @pytest.mark.parametrize("method", METHODS)
    def test_restored_answers_the_same(
        self, vectors: NDArray[np.float32], method: Ivf | Hnsw
    ) -> None:
        built = ApproximateNeighbours.build(vectors, method)
        content = np.frombuffer(built.to_bytes(), np.uint8)
        parameters = json.loads(json.dumps(built.parameters()))
        restored = ApproximateNeighbours.restore(parameters, content, vectors)
        assert len(restored) == len(vectors) and restored.method == method
        for was, now in zip(built.search(QUERIES, 30), restored.search(QUERIES, 30), strict=True):
            assert_array_equal(was, now)


@pytest.mark.parametrize("method", METHODS)
def test_recall(method: Ivf | Hnsw) -> None:
    _, found = ApproximateNeighbours.build(VECTORS, method).search(QUERIES, 20)
    _, true = ExactNeighbours(VECTORS).search(QUERIES, 20)
    assert np.mean([np.isin(a, b).mean() for a, b in zip(true, found, strict=True)]) > 0.9


def test_a_query_that_falls_short_is_compared_with_all() -> None:
    lists = ApproximateNeighbours.build(VECTORS, Ivf(nlist=64, nprobe=1))
    assert (lists._faiss.search(QUERIES * STEPS, 300)[1] < 0).any(axis=1).mean() > 0.5
    squared, _ = lists.search(QUERIES, 300)
    expected, _ = ExactNeighbours(VECTORS).search(QUERIES, 300)
    np.testing.assert_allclose(squared, expected, rtol=1e-5)


def test_more_lists_searched_find_more() -> None:
    built = ApproximateNeighbours.build(VECTORS, Ivf(nlist=64, nprobe=1))
    content = np.frombuffer(built.to_bytes(), np.uint8)
    more = ApproximateNeighbours.restore({**built.parameters(), "nprobe": 64}, content, VECTORS)
    few, many = (search.search(QUERIES, 5)[0].sum() for search in (built, more))
    assert many < few


class TestParameters:
    @pytest.mark.parametrize(
        "search",
        [
            {},
            {"kind": "lsh"},
            {"kind": "ivf", "nlist": 4, "nprobe": 5},
            {"kind": "ivf", "nlist": 4, "nprobe": 0},
            {"kind": "hnsw", "m": 1, "ef_construction": 8, "ef_search": 8},
            {"kind": "hnsw", "m": 8, "ef_construction": 8, "ef_search": 0},
        ],
    )
    def test_senseless_ones_are_refused(self, search: dict[str, object]) -> None:
        with pytest.raises(ValueError, match="expected"):
            method_of(search)

    @pytest.mark.parametrize("kind", [Ivf, Hnsw])
    @pytest.mark.parametrize("count", [1, 2, 5, 90])
    def test_that_suit_a_few_vectors_find_them(
        self, kind: type[Ivf] | type[Hnsw], count: int
    ) -> None:
        built = ApproximateNeighbours.build(VECTORS[:count], kind.suited(count))
        _, numbers = built.search(VECTORS[:count], 1)
        squared, everything = built.search(VECTORS[:1], count)
        assert (distances(VECTORS, VECTORS[:count], numbers) == 0).all()
        assert sorted(everything[0]) == list(range(count)) and squared[0, 0] == 0


@pytest.fixture(scope="module", params=["ivf", "hnsw"])
def index(request: pytest.FixtureRequest, toy_index: PoseIndex) -> PoseIndex:
    method = {"ivf": Ivf(24, 12), "hnsw": METHODS[1]}[request.param]
    neighbours = ApproximateNeighbours.build(toy_index.vectors, method)
    return dataclasses.replace(toy_index, searched_by=neighbours)


@pytest.fixture
def saved(index: PoseIndex, tmp_path: Path) -> Path:
    save_index(index, tmp_path / "artefact")
    return tmp_path / "artefact"


def kind_of(index: PoseIndex) -> str:
    assert isinstance(index.neighbours, ApproximateNeighbours)
    return index.neighbours.method.kind


class TestArtefact:
    def test_round_trip_gives_the_same_answers(self, index: PoseIndex, saved: Path) -> None:
        back = load_index(saved)
        assert kind_of(back) == kind_of(index)
        queries = index.vectors[::29, None] + np.float32(0.1)
        for was, now in zip(index.search(queries, 40), back.search(queries, 40), strict=True):
            assert_array_equal(was, now)

    def test_matches_as_the_exact_search_does(self, index: PoseIndex, toy_index: PoseIndex) -> None:
        same = 0
        for number in range(0, len(index), 48):
            silhouette = index.silhouette(number)
            first, exact = (match(i, silhouette, 3).hypotheses[0] for i in (index, toy_index))
            same += (first.entry, first.mirrored) == (exact.entry, exact.mirrored)
        assert same >= 10  # Of twelve.

    def test_saving_twice_gives_the_same_bytes(
        self, index: PoseIndex, saved: Path, tmp_path: Path
    ) -> None:
        version = save_index(load_index(saved), tmp_path / "again")
        for file in saved.iterdir():
            assert file.read_bytes() == (tmp_path / "again" / file.name).read_bytes()
        assert load_index(saved).version == version

    def test_manifest_tells_the_search(self, index: PoseIndex, saved: Path) -> None:
        search = json.loads((saved / "manifest.json").read_text())["search"]
        assert search["kind"] == kind_of(index)
        assert method_of(search) == index.neighbours.method  # type: ignore[attr-defined]

    def test_copies_with_another_search_and_back(
        self, toy_index: PoseIndex, saved: Path, tmp_path: Path
    ) -> None:
        flat = save_index(toy_index, tmp_path / "flat")
        assert copy_index(saved, tmp_path / "back", ExactNeighbours(toy_index.vectors)) == flat
        names = {file.name for file in (tmp_path / "flat").iterdir()}
        assert names == {file.name for file in (tmp_path / "back").iterdir()}
        for name in names:
            assert (tmp_path / "flat" / name).read_bytes() == (
                tmp_path / "back" / name
            ).read_bytes()
        again = load_index(saved)
        copy_index(tmp_path / "flat", tmp_path / "copy", again.neighbours)
        assert load_index(tmp_path / "copy").version == again.version

    def test_a_flat_search_may_be_named(self, toy_index: PoseIndex, tmp_path: Path) -> None:
        save_index(toy_index, tmp_path / "flat")
        reseal(tmp_path / "flat", search={"kind": "flat"})
        assert isinstance(load_index(tmp_path / "flat").neighbours, ExactNeighbours)

    def test_another_engine_does_without_the_file(self, index: PoseIndex, saved: Path) -> None:
        (saved / "neighbours.faiss").unlink()
        exact = ExactNeighbours(index.vectors)
        assert load_index(saved, exact).neighbours is exact


def reseal(folder: Path, **changes: object) -> None:
    """Change the manifest, and give it the content hash that fits."""
    file = folder / "manifest.json"
    manifest = {**json.loads(file.read_text()), **changes}
    manifest["version"] = artefact._version(manifest)
    file.write_text(json.dumps(manifest))


def put_search(folder: Path, content: bytes) -> None:
    """Put another search into an artefact, with the hash that fits."""
    (folder / "neighbours.faiss").write_bytes(content)
    files = json.loads((folder / "manifest.json").read_text())["files"]
    reseal(folder, files={**files, "neighbours.faiss": hashlib.sha256(content).hexdigest()})


class TestRefused:
    def told(self, folder: Path) -> str:
        with pytest.raises(ArtefactError) as raised:
            load_index(folder)
        return str(raised.value)

    def test_altered(self, saved: Path) -> None:
        file = saved / "neighbours.faiss"
        content = bytearray(file.read_bytes())
        content[len(content) // 2] ^= 1
        file.write_bytes(content)
        assert "neighbours.faiss was altered" in self.told(saved)

    def test_truncated(self, saved: Path) -> None:
        file = saved / "neighbours.faiss"
        file.write_bytes(file.read_bytes()[:-100])
        assert "neighbours.faiss" in self.told(saved)

    def test_missing(self, saved: Path) -> None:
        (saved / "neighbours.faiss").unlink()
        assert "cannot be read" in self.told(saved)

    def test_not_listed(self, saved: Path) -> None:
        files = json.loads((saved / "manifest.json").read_text())["files"]
        files.pop("neighbours.faiss")
        reseal(saved, files=files)
        assert "lacks 'neighbours.faiss'" in self.told(saved)

    def test_another_type(self, index: PoseIndex, saved: Path) -> None:
        other = faiss.IndexFlatL2(index.descriptor.dimension)
        other.add(index.vectors.astype(np.float32))
        put_search(saved, bytes(faiss.serialize_index(other)))
        assert "got IndexFlatL2" in self.told(saved)

    def test_no_faiss_file(self, saved: Path) -> None:
        put_search(saved, b"\x80\x04 no index")
        assert "does not hold together" in self.told(saved)

    def test_of_fewer_vectors(self, index: PoseIndex, saved: Path) -> None:
        method = index.neighbours.method  # type: ignore[attr-defined]
        fewer = ApproximateNeighbours.build(index.vectors[:-7], method)
        put_search(saved, fewer.to_bytes())
        assert "got (569, 48)" in self.told(saved)

    @pytest.mark.parametrize("changed", ["nlist", "m"])
    def test_parameters_of_another(self, saved: Path, changed: str) -> None:
        search = json.loads((saved / "manifest.json").read_text())["search"]
        if changed not in search:
            changed = "kind"
        reseal(saved, search={**search, changed: 30 if changed != "kind" else "lsh"})
        assert "expected" in self.told(saved)

    def test_parameters_that_are_no_numbers(self, saved: Path) -> None:
        search = json.loads((saved / "manifest.json").read_text())["search"]
        reseal(saved, search={name: "kind" if name != "kind" else search[name] for name in search})
        assert "does not hold together" in self.told(saved)
