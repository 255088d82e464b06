"""Networks of our own: refused where they are not what is expected."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.vision.joints import JointReader
from app.vision.onnx import OnnxError, OnnxNetwork
from app.vision.refine import CHANNELS, COLUMNS, ROWS, WEIGHTS_PATH, Refiner

ENTERING = (CHANNELS, ROWS, COLUMNS)


def test_a_missing_or_broken_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(OnnxError, match="cannot read"):
        OnnxNetwork(tmp_path / "missing.onnx", ENTERING, (1, ROWS, COLUMNS))
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"not a network" * 100)
    with pytest.raises(OnnxError, match="OpenCV"):
        OnnxNetwork(broken, ENTERING, (1, ROWS, COLUMNS))
    for network in (Refiner, JointReader):
        with pytest.raises(OnnxError, match="OpenCV"):
            network(broken)


def test_another_network_is_told() -> None:
    with pytest.raises(OnnxError, match=r"shape \(2, 192, 128\), got \(1, 192, 128\)"):
        OnnxNetwork(WEIGHTS_PATH, ENTERING, (2, ROWS, COLUMNS))
    with pytest.raises(OnnxError, match=r"refiner\.onnx"):
        JointReader(WEIGHTS_PATH)
