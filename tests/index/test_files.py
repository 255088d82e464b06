"""Files of an index: what is read is what was written, also by many threads at once."""

from __future__ import annotations

import gc
import hashlib
import lzma
import pickle
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from index.build.writer import npy_bytes
from index.files import ArtefactError, read_array
from index.store import ENTRY_DTYPE


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
