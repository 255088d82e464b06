"""Networks run by LiteRT: the same numbers as OpenCV's, and a clear word on other files."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app.vision.networks import SIZE, PersonNetwork
from app.vision.tflite import TfliteError, TfliteNetwork

ENTERING, LEAVING = (SIZE, SIZE, 3), (SIZE, SIZE, 1)


def test_opencv_sees_the_same(
    person_model: Path, network: PersonNetwork, street: NDArray[np.uint8]
) -> None:
    net = cv2.dnn.readNetFromTFLite(str(person_model))
    small = cv2.resize(street, (SIZE, SIZE))
    net.setInput(cv2.dnn.blobFromImage(small, 1 / 255, swapRB=True))
    np.testing.assert_allclose(network.of_images([small])[0], net.forward()[0, 0], atol=1e-3)


def test_threads_agree(person_model: Path) -> None:
    network = TfliteNetwork(person_model, ENTERING, LEAVING)
    images = np.random.default_rng(0).random((8, *ENTERING), np.float32)
    expected = [network.run(image) for image in images]
    with ThreadPoolExecutor(4) as pool:
        for found, wanted in zip(pool.map(network.run, images), expected, strict=True):
            np.testing.assert_array_equal(found, wanted)


def test_a_missing_or_broken_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(TfliteError, match="cannot read"):
        TfliteNetwork(tmp_path / "missing.tflite", ENTERING, LEAVING)
    broken = tmp_path / "broken.tflite"
    for content in (b"", b"not a network" * 100):
        broken.write_bytes(content)
        with pytest.raises(TfliteError, match=r"broken\.tflite is not a network LiteRT can run"):
            TfliteNetwork(broken, ENTERING, LEAVING)


def test_half_a_network_is_told(person_model: Path, tmp_path: Path) -> None:
    half = tmp_path / "half.tflite"
    content = person_model.read_bytes()
    half.write_bytes(content[: len(content) // 2])
    with pytest.raises(TfliteError, match="LiteRT"):
        TfliteNetwork(half, ENTERING, LEAVING)


def test_another_network_is_told(person_model: Path) -> None:
    with pytest.raises(TfliteError, match=r"one output \(256, 256, 2\), got .*256, 256, 1"):
        TfliteNetwork(person_model, ENTERING, (SIZE, SIZE, 2))
