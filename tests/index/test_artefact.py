"""The artefact: the same on disk as in memory, or refused in one sentence."""

import gc
import hashlib
import io
import json
import lzma
import pickle
import re
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import faiss
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from index import DEFAULT_PATH
from index.arrays import load_arrays
from index.artefact import (
    FORMAT_VERSION,
    RERANKING_JSON,
    RERANKING_NPZ,
    ArtefactError,
    find_artefact,
    load_index,
    read_array,
)
from index.store import ENTRY_DTYPE, PoseIndex
from tests.conftest import INDEXES
from tests.index.helpers import seal


class TestRefusal:
    """One sentence that names the file and the fault."""

    def refused(self, folder: Path) -> str:
        with pytest.raises(ArtefactError) as caught:
            load_index(folder)
        message = str(caught.value)
        assert str(folder) in message
        assert "\n" not in message
        return message

    def test_missing_folder(self, tmp_path: Path) -> None:
        assert "there is no index at" in self.refused(tmp_path / "nowhere")

    def test_folder_without_manifest(self, tmp_path: Path) -> None:
        assert "manifest.json is missing" in self.refused(tmp_path)

    def test_every_file_truncated_altered_or_missing(self, saved: Path) -> None:
        for file in sorted(saved.glob("*.*")):
            whole = file.read_bytes()
            altered = whole[:-1] + bytes([whole[-1] ^ 1])
            spoilt = {
                "truncated|unreadable": whole[: len(whole) // 2],
                "altered": altered,
                "": None,
            }
            for said, content in spoilt.items():
                if content is altered and file.name == "manifest.json":
                    continue
                file.unlink()
                if content is not None:
                    file.write_bytes(content)
                message = self.refused(saved)
                assert file.name in message
                assert re.search(said, message)
            file.write_bytes(whole)
        load_index(saved)

    @pytest.mark.parametrize(
        ("content", "said"),
        [
            *((text, "is not the manifest of a pose index")
              for text in (b"[]", b'"pose"', b"{}", b'{"name": "mnist"}')),
            *((text, "is unreadable") for text in (b"", b"{", b"\x80\x02}q\x00.", b"\xff\xfe")),
        ],
    )  # fmt: skip
    def test_another_manifest(self, saved: Path, content: bytes, said: str) -> None:
        (saved / "manifest.json").write_bytes(content)
        assert said in self.refused(saved)

    @pytest.mark.parametrize(
        ("changed", "said"),
        [
            *(({"format_version": number}, f"this service reads format {FORMAT_VERSION}")
              for number in (0, FORMAT_VERSION + 1, "1")),
            ({"joints": ["nose"]}, "another set of joints"),
            ({"descriptor": {"name": "hu"}}, "descriptor"),
            *(({key: None}, key) for key in ("files", "descriptor", "clips", "parameters")),
        ],
    )  # fmt: skip
    def test_a_sealed_manifest_of_something_else(
        self, saved: Path, changed: dict[str, object], said: str
    ) -> None:
        def change(manifest: dict[str, object]) -> None:
            manifest.update(changed)
            for key in [key for key, value in changed.items() if value is None]:
                del manifest[key]

        seal(saved, change)
        assert said in self.refused(saved)

    @pytest.mark.parametrize("name", ["entries.npy", "descriptors.faiss"])
    def test_sealed_files_of_something_else(
        self, toy_index: PoseIndex, saved: Path, name: str
    ) -> None:
        other = faiss.IndexFlatIP(toy_index.descriptor.dimension)
        other.add(toy_index.vectors[:])
        content, said = {
            "entries.npy": (
                npy_bytes(toy_index.entries[: len(toy_index) // 2]), "does not hold together"
            ),
            "descriptors.faiss": (
                faiss.serialize_index(other).tobytes(),
                "expected a FAISS IndexFlatL2, got IndexFlatIP",
            ),
        }[name]  # fmt: skip
        (saved / f"{name}.xz").write_bytes(lzma.compress(content))
        digest = hashlib.sha256(content).hexdigest()
        seal(saved, lambda manifest: manifest["files"].update({name: digest}))
        assert said in self.refused(saved)

    def test_altered_manifest(self, saved: Path) -> None:
        file = saved / "manifest.json"
        file.write_text(file.read_text().replace('"toy"', '"TOY"'))
        assert "was altered: its content hash does not fit" in self.refused(saved)


class TestFind:
    def test_the_artefact_of_a_version_is_found_alone_or_among_others(self) -> None:
        for name in ("sticks", "toy"):
            path = INDEXES / name
            version = load_index(path).version
            assert find_artefact(INDEXES, version) == path
            assert find_artefact(path, version) == path

    def test_what_is_not_there_or_not_whole_is_not_found(self, saved: Path, tmp_path: Path) -> None:
        version = json.loads((saved / "manifest.json").read_text())["version"]
        for folder, wanted in ((tmp_path, "sha256:0"), (tmp_path / "nowhere", version)):
            with pytest.raises(ArtefactError, match=f"of version {wanted} in .*, found none"):
                find_artefact(folder, wanted)
        (saved / "manifest.json").write_text("{")
        with pytest.raises(ArtefactError, match="found none"):
            find_artefact(tmp_path, version)


@pytest.fixture
def with_network(saved: Path) -> Path:
    """The index with the networks of the one that ships."""
    for name in (RERANKING_JSON, RERANKING_NPZ):
        shutil.copy(DEFAULT_PATH / name, saved)
    return saved


def altered(content: bytes) -> bytes:
    return content[:1000] + bytes([content[1000] ^ 1]) + content[1001:]


def manifest_with(**changed: object) -> Callable[[bytes], bytes]:
    return lambda content: json.dumps({**json.loads(content), **changed}).encode()


@pytest.mark.parametrize(
    ("file", "change", "said"),
    [
        (RERANKING_NPZ, altered, "reranking.npz was altered: its SHA-256 does not fit"),
        (RERANKING_NPZ, None, "reranking.npz cannot be read: No such file"),
        (RERANKING_JSON, None, "lacks its manifest reranking.json"),
        *((RERANKING_JSON, lambda _, text=text: text, "reranking.json")
          for text in (b"", b"[]", b"{}", b'{"format_version": 2}')),
        (RERANKING_JSON, manifest_with(format_version=9), "this service reads format 2"),
        (RERANKING_JSON,
         manifest_with(confidence={"features": ["shoe_size"], "weights": [1], "bias": 0}),
         "expected a calibration over"),
    ],
)  # fmt: skip
def test_damaged_network_is_refused_in_one_sentence(
    with_network: Path, file: str, change: Callable[[bytes], bytes] | None, said: str
) -> None:
    if change is None:
        (with_network / file).unlink()
    else:
        (with_network / file).write_bytes(change((with_network / file).read_bytes()))
    with pytest.raises(ArtefactError, match=said) as error:
        load_index(with_network)
    assert "\n" not in str(error.value)


def npy_bytes(array: NDArray[np.generic]) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def written(folder: Path, array: NDArray[np.generic], *, compressed: bool) -> tuple[Path, str]:
    content = npy_bytes(array)
    file = folder / ("array.npy.xz" if compressed else "array.npy")
    file.write_bytes(lzma.compress(content) if compressed else content)
    return file, hashlib.sha256(content).hexdigest()


@pytest.mark.parametrize("compressed", [True, False])
@pytest.mark.parametrize(
    "array",
    [
        np.arange(600_000, dtype=np.float32).reshape(2, 3, -1),
        np.zeros(7, ENTRY_DTYPE),
        np.empty((0, 5), np.uint8),
        np.array(3.5),
    ],
    ids=["large", "records", "empty", "scalar"],
)
def test_round_trip(tmp_path: Path, array: NDArray[np.generic], compressed: bool) -> None:
    read = read_array(*written(tmp_path, array, compressed=compressed))
    assert read.dtype == array.dtype and read.shape == array.shape
    assert_array_equal(read, array)


@pytest.mark.parametrize(
    "content",
    [b"", b"PK", npy_bytes(np.arange(10, dtype=np.uint8))[:-4], pickle.dumps("an object")],
    ids=["empty", "no array", "too short", "pickle"],
)
def test_other_content_is_refused(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "array.npy"
    file.write_bytes(content)
    with pytest.raises(ArtefactError, match=r"array\.npy is no array"):
        read_array(file, hashlib.sha256(content).hexdigest())


@pytest.fixture
def threads_take_turns_often() -> Iterator[None]:
    """Have threads change in the middle of whatever allocates memory."""

    def pause(*_: object) -> None:
        time.sleep(1e-5)

    interval, threshold = sys.getswitchinterval(), gc.get_threshold()
    sys.setswitchinterval(1e-6)
    gc.set_threshold(20)
    gc.callbacks.append(pause)
    yield
    gc.callbacks.remove(pause)
    gc.set_threshold(*threshold)
    sys.setswitchinterval(interval)


@pytest.mark.usefixtures("threads_take_turns_often")
def test_many_threads_read_at_once(tmp_path: Path) -> None:
    array = np.arange(32, dtype=np.uint8)
    file, sha256 = written(tmp_path, array, compressed=False)
    with ThreadPoolExecutor(8) as pool:
        for read in pool.map(lambda _: read_array(file, sha256), range(100)):
            assert_array_equal(read, array)


@pytest.mark.usefixtures("threads_take_turns_often")
def test_indexes_and_networks_are_read_at_once(tmp_path: Path) -> None:
    array = np.arange(32, dtype=np.uint8)
    file, sha256 = written(tmp_path, array, compressed=False)
    network = tmp_path / "network.npz"
    np.savez(network, weights=array)
    with ThreadPoolExecutor(8) as pool:
        entries = [pool.submit(read_array, file, sha256) for _ in range(50)]
        networks = [pool.submit(load_arrays, network) for _ in range(50)]
    assert all(np.array_equal(read.result(), array) for read in entries)
    assert all(np.array_equal(read.result()["weights"], array) for read in networks)
