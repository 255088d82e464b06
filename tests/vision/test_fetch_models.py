"""Fetching the networks: whole and verified, or not at all."""

from __future__ import annotations

import hashlib
import sys
import zipfile
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from scripts import fetch_models
from scripts.fetch_models import Model


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


@pytest.fixture(autouse=True)
def small_models(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two networks to fetch, one of which is kept in part."""
    monkeypatch.setattr(
        fetch_models,
        "MODELS",
        (
            Model("net.tflite", "a/net.tflite", sha256(b"weights"), sha256(b"weights")),
            Model(
                "half.tflite", "b/whole.tflite", sha256(b"wholes"), sha256(b"who"), lambda w: w[:3]
            ),
        ),
    )


def wheel(folder: Path, **content: bytes) -> Path:
    path = folder / "mediapipe-test.whl"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("mediapipe/__init__.py", "")
        for name, data in content.items():
            archive.writestr(name.replace("_", "/") + ".tflite", data)
    return path


def test_verified_networks_are_written(tmp_path: Path) -> None:
    output = tmp_path / "models"
    source = wheel(tmp_path, a_net=b"weights", b_whole=b"wholes")
    arguments = ["--output", str(output), "--wheel"]
    assert fetch_models.main([*arguments, str(source)]) == 0
    found = {path.name: path.read_bytes() for path in output.iterdir()}
    assert found == {"net.tflite": b"weights", "half.tflite": b"who"}
    # Once there, nothing is downloaded.
    assert fetch_models.main([*arguments, "nowhere"]) == 0
    (output / "half.tflite").write_bytes(b"whx")
    assert fetch_models.main([*arguments, "nowhere"]) == 1
    assert fetch_models.main([*arguments, str(source)]) == 0
    assert (output / "half.tflite").read_bytes() == b"who"


@pytest.mark.parametrize(
    "content",
    [{"a_net": b"weights", "b_whole": b"others"}, {"a_net": b"weights"}, {"b_whole": b"wholes"}],
)
def test_a_wrong_wheel_leaves_nothing_behind(
    tmp_path: Path, content: dict[str, bytes], capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "models"
    arguments = ["--output", str(output), "--wheel", str(wheel(tmp_path, **content))]
    assert fetch_models.main(arguments) == 1
    assert not output.exists()
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_a_failed_download_says_so_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(fetch_models, "REQUIREMENT", "no such requirement")
    assert fetch_models.main(["--output", str(tmp_path / "models")]) == 1
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
