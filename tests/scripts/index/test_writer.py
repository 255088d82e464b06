"""Writing an index: silhouettes compressed, a folder replaced whole or not at all."""

import dataclasses
import signal
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from descriptor.silhouette import outline_distances, pack
from index import DEFAULT_PATH
from index.artefact import ArtefactError, load_index
from index.store import PoseIndex
from scripts.index.writer import check_replaceable, compress, halved, save_index
from tests.index.helpers import contents, seal
from tests.support.programs import run


class TestReplacing:
    def test_replaces_an_older_artefact_whole(self, body_index: PoseIndex, saved: Path) -> None:
        for name in ("reranking.json", "reranking.npz", "of-another-format.npy.xz"):
            (saved / name).write_text("of the older index")
        seal(saved, lambda m: m.update(format_version=3, files={"of-another-format.npy": ""}))
        for file in saved.glob("*.npy*"):
            if not file.name.startswith("of-another-format"):
                file.unlink()
        (saved / "descriptors.faiss.xz").unlink()
        save_index(dataclasses.replace(body_index, name="newer"), saved)
        assert load_index(saved).name == "newer"
        assert not (saved / "of-another-format.npy.xz").exists()
        assert not (saved / "reranking.json").exists()
        assert [p.name for p in saved.parent.iterdir()] == [saved.name]

    def test_the_index_of_the_service_may_be_replaced(self) -> None:
        assert (DEFAULT_PATH / "postures.npz").exists()
        check_replaceable(DEFAULT_PATH)

    def test_a_link_stays_a_link(self, body_index: PoseIndex, saved: Path, tmp_path: Path) -> None:
        (tmp_path / "current").symlink_to(saved)
        save_index(dataclasses.replace(body_index, name="newer"), tmp_path / "current")
        assert (tmp_path / "current").is_symlink()
        assert load_index(saved).name == "newer"


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
        self, body_index: PoseIndex, photographs: Path, manifest: str | None
    ) -> None:
        if manifest is not None:
            (photographs / "manifest.json").write_text(manifest)
        self.refused(body_index, photographs, "3 other" if manifest is None else "4 other", "0.jpg")

    def test_photographs_in_an_index(self, body_index: PoseIndex, saved: Path) -> None:
        (saved / "holiday.jpg").write_bytes(b"sun")
        self.refused(body_index, saved, "holds 1 other file, such as holiday.jpg")

    def test_a_file(self, body_index: PoseIndex, tmp_path: Path) -> None:
        file = tmp_path / "notes.txt"
        file.write_text("mine")
        with pytest.raises(ArtefactError, match=r"got the file .*notes\.txt"):
            save_index(body_index, file)
        assert file.read_text() == "mine"

    def test_what_is_put_there_while_it_is_written(
        self, body_index: PoseIndex, saved: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        write_text = Path.write_text

        def write_and_copy(self: Path, *args: Any) -> int:
            (saved / "holiday.jpg").write_bytes(b"sun")
            return write_text(self, *args)

        monkeypatch.setattr(Path, "write_text", write_and_copy)
        with pytest.raises(ArtefactError, match=r"holiday\.jpg"):
            save_index(body_index, saved)
        assert (saved / "holiday.jpg").read_bytes() == b"sun"
        assert [p.name for p in saved.parent.iterdir()] == [saved.name]


class TestFailedSave:
    @pytest.mark.parametrize("written", ["write_text", "write_bytes"])
    def test_leaves_what_was_there(
        self, body_index: PoseIndex, saved: Path, monkeypatch: pytest.MonkeyPatch, written: str
    ) -> None:
        before = contents(saved)
        monkeypatch.setattr(Path, written, _full_disk)
        for folder in (saved, saved.parent / "fresh"):
            with pytest.raises(OSError, match="No space left"):
                save_index(dataclasses.replace(body_index, name="newer"), folder)
        assert contents(saved) == before
        assert [p.name for p in saved.parent.iterdir()] == [saved.name]

    def test_keeps_the_old_artefact_when_the_last_rename_fails(
        self, body_index: PoseIndex, saved: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        before = contents(saved)
        rename = Path.rename

        def fail_for_the_new(self: Path, target: Path) -> Path:
            if target == saved and self.name == "new":
                raise OSError(5, "Input/output error")
            return rename(self, target)

        monkeypatch.setattr(Path, "rename", fail_for_the_new)
        with pytest.raises(OSError, match="Input/output error"):
            save_index(dataclasses.replace(body_index, name="newer"), saved)
        assert contents(saved) == before
        assert [p.name for p in saved.parent.iterdir()] == [saved.name]

    def test_killed_while_writing_keeps_the_old_artefact(self, saved: Path) -> None:
        # The manifest is written last: the process dies with every other file in place.
        script = f"""
import dataclasses, os, pathlib, signal
from index.artefact import find_artefact, load_index
from scripts.index.writer import save_index
index = load_index({str(saved)!r})
pathlib.Path.write_text = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
save_index(dataclasses.replace(index, name="newer"), {str(saved)!r})
"""
        before = contents(saved)
        ended = run(sys.executable, "-c", script)
        assert ended.returncode == -signal.SIGKILL
        assert contents(saved) == before


def _full_disk(*_: object) -> None:
    raise OSError(28, "No space left on device")


@pytest.fixture(scope="module")
def noise() -> np.ndarray:
    return pack(np.random.default_rng(0).integers(0, 2, (100, 128, 48), np.uint8))


def test_silhouettes_compress_block_by_block(
    noise: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = compress(noise)
    monkeypatch.setattr("scripts.index.writer._BLOCK", 30)
    blocks = compress(noise)
    for field in ("data", "ends", "dictionary"):
        assert_array_equal(getattr(blocks, field), getattr(whole, field))


class TestHalved:
    def test_each_stored_pixel_shows_what_most_of_four_do(self) -> None:
        blocks = np.random.default_rng(0).integers(0, 2, (100, 64, 24), np.uint8)
        whole = blocks.repeat(2, axis=1).repeat(2, axis=2)
        one_off = whole.copy()
        one_off[:, 1::2, 1::2] ^= 1
        for silhouettes in (whole, one_off):
            enlarged = halved(compress(pack(silhouettes))).take(np.arange(100))
            # Enlarging changes at most one of four pixels.
            shown = enlarged.reshape(100, 64, 2, 24, 2).sum(axis=(2, 4))
            assert not (shown == 2).any()
            assert_array_equal(shown > 2, blocks)

    def test_outlines_hardly_move_and_take_half_the_bytes(self, body_index: PoseIndex) -> None:
        stored = body_index.silhouette_store
        rows = np.arange(len(stored))
        fewer = halved(stored)
        pairs = zip(stored.take(rows), fewer.take(rows), strict=True)
        moved = [outline_distances(whole, half[None])[0] for whole, half in pairs]
        assert np.mean(moved) < 0.4
        assert len(fewer.data) < 0.6 * len(stored.data)

    def test_is_not_halved_twice(self, noise: np.ndarray) -> None:
        with pytest.raises(ValueError, match="at full resolution"):
            halved(halved(compress(noise)))


@pytest.mark.parametrize("shape", [(0, 768), (3, 767), (768,)])
def test_compresses_packed_silhouettes_only(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="expected silhouettes of shape"):
        compress(np.zeros(shape, np.uint8))
