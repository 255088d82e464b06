"""Writing an index: silhouettes compressed, a folder replaced whole or not at all."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from descriptor.descriptor import DiscriminantDescriptor
from descriptor.silhouette import outline_distances
from index.artefact import POSTURES_NPZ, ArtefactError, load_index
from index.network import RankingModel
from index.search import ExactNeighbours
from index.store import PoseIndex
from scripts.index.writer import halved, save_index, save_postures, save_reranker
from tests.index.helpers import contents, random_network, random_postures, seal
from tests.support.toy_indexes import FOLDER, INDEXES


class TestRoundTrip:
    def test_loads_what_was_saved(self, toy_index: PoseIndex, saved: Path) -> None:
        back = load_index(saved)
        assert back.version.startswith("sha256:")
        for field in ("name", "clips", "subjects", "actions", "parameters", "descriptor"):
            assert getattr(back, field) == getattr(toy_index, field)
        for field in ("vectors", "entries", "skeletons", "skeleton_labels"):
            assert_array_equal(getattr(back, field), getattr(toy_index, field))
        everything = np.arange(len(toy_index))
        assert_array_equal(back.silhouettes(everything), toy_index.silhouettes(everything))

    def test_learned_descriptors_travel_with_the_index(
        self, toy_index: PoseIndex, tmp_path: Path
    ) -> None:
        projection = np.random.default_rng(0).normal(size=(6, 28, 14)).astype(np.float32)
        projection[:4, :, 1::2] = 0
        projection[4:, :, 0::2] = 0
        learned = DiscriminantDescriptor(projection.reshape(6, -1))
        silhouettes = toy_index.silhouettes(np.arange(len(toy_index)))
        vectors = learned.describe(silhouettes)
        index = dataclasses.replace(toy_index, descriptor=learned, vectors=ExactNeighbours(vectors))
        save_index(index, tmp_path / "learned")
        back = load_index(tmp_path / "learned")
        assert_array_equal(back.descriptor.describe(silhouettes), index.vectors[:])
        assert_array_equal(back.descriptor.mirror(vectors), learned.mirror(vectors))

    def test_same_index_twice_gives_the_same_bytes(
        self, toy_index: PoseIndex, saved: Path, tmp_path: Path
    ) -> None:
        version = save_index(toy_index, tmp_path / "again")
        assert contents(tmp_path / "again") == contents(saved)
        assert load_index(saved).version == version


def test_postures_lie_beside_the_network_that_they_read(
    saved: Path, reranker: RankingModel
) -> None:
    taught = dataclasses.replace(reranker, postures=random_postures(1))
    save_reranker(taught, saved)
    back = load_index(saved).reranker
    assert back is not None and back.postures is not None and taught.postures is not None
    for name, array in taught.postures.arrays().items():
        assert_array_equal(back.postures.arrays()[name], array)
    kept = (saved / POSTURES_NPZ).read_bytes()
    save_postures(taught.postures, saved)
    assert (saved / POSTURES_NPZ).read_bytes() == kept
    # Another network makes other values of the same silhouette.
    save_reranker(dataclasses.replace(reranker, network=random_network(7)), saved)
    assert not (saved / POSTURES_NPZ).exists()
    (saved / POSTURES_NPZ).write_bytes(kept)
    with pytest.raises(ArtefactError, match="trained for another network"):
        load_index(saved)
    (saved / POSTURES_NPZ).write_bytes(kept[:-40])
    with pytest.raises(ArtefactError, match="do not hold together"):
        load_index(saved)


def test_the_indexes_of_the_tests_are_those_that_their_command_writes() -> None:
    stored, built = load_index(FOLDER / "sticks"), INDEXES["sticks"]()
    everything = np.arange(len(built))
    assert_array_equal(stored.silhouettes(everything), built.silhouettes(everything))
    assert_array_equal(stored.skeletons, built.skeletons)
    assert_allclose(stored.vectors[:], built.vectors[:], atol=1e-3)


class TestReplacing:
    def test_replaces_an_older_artefact_whole(self, toy_index: PoseIndex, saved: Path) -> None:
        for name in ("reranking.json", "reranking.npz", "of-another-format.npy.xz"):
            (saved / name).write_text("of the older index")
        seal(saved, lambda m: m.update(format_version=3, files={"of-another-format.npy": ""}))
        for file in saved.glob("*.npy*"):
            if not file.name.startswith("of-another-format"):
                file.unlink()
        (saved / "descriptors.faiss.xz").unlink()
        save_index(dataclasses.replace(toy_index, name="newer"), saved)
        assert load_index(saved).name == "newer"
        assert not (saved / "of-another-format.npy.xz").exists()
        assert not (saved / "reranking.json").exists()
        assert [p.name for p in saved.parent.iterdir()] == [saved.name]


class TestWhatIsNoIndex:
    """A folder with anything else in it is refused, and stays as it is."""

    @pytest.fixture
    def photographs(self, tmp_path: Path) -> Path:
        folder = tmp_path / "photographs"
        folder.mkdir()
        for number in range(3):
            (folder / f"{number}.jpg").write_bytes(bytes([number]))
        return folder

    def refused(self, index: PoseIndex, folder: Path, *said: str) -> None:
        before = contents(folder)
        with pytest.raises(ArtefactError) as caught:
            save_index(index, folder)
        assert all(part in str(caught.value) for part in (str(folder), *said))
        assert contents(folder) == before
        assert [p.name for p in folder.parent.glob(".*")] == []

    @pytest.mark.parametrize(
        "manifest", [None, "{", "[]", '{"files": {}}', '{"name": "a web application"}']
    )
    def test_photographs(
        self, toy_index: PoseIndex, photographs: Path, manifest: str | None
    ) -> None:
        if manifest is not None:
            (photographs / "manifest.json").write_text(manifest)
        self.refused(toy_index, photographs, "3 other" if manifest is None else "4 other", "0.jpg")


class TestFailedSave:
    @pytest.mark.parametrize("written", ["write_text", "write_bytes"])
    def test_leaves_what_was_there(
        self, toy_index: PoseIndex, saved: Path, monkeypatch: pytest.MonkeyPatch, written: str
    ) -> None:
        before = contents(saved)
        monkeypatch.setattr(Path, written, _full_disk)
        for folder in (saved, saved.parent / "fresh"):
            with pytest.raises(OSError, match="No space left"):
                save_index(dataclasses.replace(toy_index, name="newer"), folder)
        assert contents(saved) == before
        assert [p.name for p in saved.parent.iterdir()] == [saved.name]

    def test_keeps_the_old_artefact_when_the_last_rename_fails(
        self, toy_index: PoseIndex, saved: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        before = contents(saved)
        rename = Path.rename

        def fail_for_the_new(self: Path, target: Path) -> Path:
            if target == saved and self.name == "new":
                raise OSError(5, "Input/output error")
            return rename(self, target)

        monkeypatch.setattr(Path, "rename", fail_for_the_new)
        with pytest.raises(OSError, match="Input/output error"):
            save_index(dataclasses.replace(toy_index, name="newer"), saved)
        assert contents(saved) == before
        assert [p.name for p in saved.parent.iterdir()] == [saved.name]


def _full_disk(*_: object) -> None:
    raise OSError(28, "No space left on device")


class TestHalved:
    def test_outlines_hardly_move_and_take_half_the_bytes(self, toy_index: PoseIndex) -> None:
        stored = toy_index.silhouette_store
        rows = np.arange(len(stored))
        fewer = halved(stored)
        pairs = zip(stored.take(rows), fewer.take(rows), strict=True)
        moved = [outline_distances(whole, half[None])[0] for whole, half in pairs]
        assert np.mean(moved) < 0.4
        assert len(fewer.data) < 0.6 * len(stored.data)
