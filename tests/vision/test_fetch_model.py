"""Fetching the model: whole and verified, or not at all."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from scripts import fetch_model


def wheel(folder: Path, content: bytes | None) -> Path:
    path = folder / "mediapipe-test.whl"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("mediapipe/__init__.py", "")
        if content is not None:
            archive.writestr(fetch_model.MEMBER, content)
    return path


def test_a_verified_model_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fetch_model, "is_the_model", lambda data: data == b"weights")
    output = tmp_path / "models" / "net.tflite"
    arguments = ["--output", str(output), "--wheel", str(wheel(tmp_path, b"weights"))]
    assert fetch_model.main(arguments) == 0
    assert output.read_bytes() == b"weights"
    assert [path.name for path in output.parent.iterdir()] == ["net.tflite"]
    # Once there, nothing is downloaded.
    assert fetch_model.main(["--output", str(output), "--wheel", "nowhere"]) == 0


@pytest.mark.parametrize("content", [b"other weights", None])
def test_a_wrong_wheel_leaves_nothing_behind(
    tmp_path: Path, content: bytes | None, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "models" / "net.tflite"
    arguments = ["--output", str(output), "--wheel", str(wheel(tmp_path, content))]
    assert fetch_model.main(arguments) == 1
    assert not output.exists()
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_a_failed_download_says_so_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(fetch_model, "REQUIREMENT", "no such requirement")
    assert fetch_model.main(["--output", str(tmp_path / "net.tflite")]) == 1
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
