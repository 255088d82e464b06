"""Networks run by LiteRT: the same numbers in all threads, and clear errors for other files."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from app.networks.shipped import NetworkError, file_of
from app.networks.tflite import TfliteNetwork

INPUT, OUTPUTS = (224, 224, 3), [(2254, 12), (2254, 1)]
HEADS = [(None, None, channels) for channels in (1, 2, 2, 34, 17, 34)]


@pytest.fixture(scope="module")
def path() -> Path:
    return file_of("pose_detection")


def images(count: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(0).random((count, *shape), np.float32)


@pytest.mark.parametrize("copies", [1, 3])
def test_threads_agree(path: Path, copies: int) -> None:
    network = TfliteNetwork(path, [INPUT], OUTPUTS, copies=copies)
    inputs = images(8, *INPUT)
    expected = [network.run(image)[0] for image in inputs]
    with ThreadPoolExecutor(4) as pool:
        assert_array_equal([found[0] for found in pool.map(network.run, inputs)], expected)


def test_outputs_survive_the_next_run(path: Path) -> None:
    network = TfliteNetwork(path, [INPUT], OUTPUTS)
    first, second = images(2, *INPUT)
    output = network.run(first)[0]
    kept = output.copy()
    network.run(second)
    assert_array_equal(output, kept)


def test_failed_call_leaves_the_network_usable(path: Path) -> None:
    network = TfliteNetwork(path, [INPUT], OUTPUTS, copies=1)
    (image,) = images(1, *INPUT)
    expected = network.run(image)[0]
    for _ in range(2):
        with pytest.raises(ValueError, match="type"):
            network.run(image.astype(np.int8))  # type: ignore[arg-type]
    assert_array_equal(network.run(image)[0], expected)


def test_open_sizes_may_change_between_calls() -> None:
    path = file_of("movenet")
    network = TfliteNetwork(path, [(None, None, 3)], HEADS)
    for height, width in ((64, 96), (128, 32), (64, 96), (32, 32)):
        (image,) = 255 * images(1, height, width, 3)
        fresh = TfliteNetwork(path, [(None, None, 3)], HEADS)
        for ours, theirs in zip(network.run(image), fresh.run(image), strict=True):
            assert ours.shape[:2] == (height // 4, width // 4)
            assert_array_equal(ours, theirs)


def test_missing_and_broken_files_are_refused(path: Path, tmp_path: Path) -> None:
    with pytest.raises(NetworkError, match="cannot read"):
        TfliteNetwork(tmp_path / "missing.tflite", [INPUT], OUTPUTS)
    broken = tmp_path / "broken.tflite"
    half = path.read_bytes()[: path.stat().st_size // 2]
    for content in (b"", b"not a network" * 100, half):
        broken.write_bytes(content)
        with pytest.raises(NetworkError, match=r"broken\.tflite is not a network LiteRT can run"):
            TfliteNetwork(broken, [INPUT], OUTPUTS)


def test_another_network_is_refused(path: Path) -> None:
    with pytest.raises(NetworkError, match=r"outputs \[\(1, 2254, 2\)\], got .*2254, 12"):
        TfliteNetwork(path, [INPUT], [(2254, 2)])
    with pytest.raises(NetworkError, match=r"inputs \[\(1, None, None, 3\)\]"):
        TfliteNetwork(path, [(None, None, 3)], HEADS)
