"""The networks that ship: the files are those of models.json, or the service does not start."""

import hashlib
import json
import shutil
import sys
from pathlib import Path

import pytest

from app.vision import models
from app.vision.models import (
    FOLDER,
    MODELS,
    check_networks,
    network_path,
)
from app.vision.tflite import NetworkError
from tests.conftest import ROOT
from tests.support.ports import free_ports
from tests.support.programs import run

DOCUMENT = json.loads(MODELS.read_text())


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the folder, used in its place."""
    copy = tmp_path / "models"
    shutil.copytree(FOLDER, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(models, "FOLDER", copy)
    monkeypatch.setattr(models, "MODELS", copy / MODELS.name)
    return copy


def test_every_file_is_listed_with_its_hash() -> None:
    shipped = {path.name for path in FOLDER.iterdir() if path.suffix not in (".py", ".json", "")}
    assert shipped == {model["file"] for model in DOCUMENT.values()}
    for model in DOCUMENT.values():
        content = (FOLDER / model["file"]).read_bytes()
        assert model["sha256"] == hashlib.sha256(content).hexdigest()


@pytest.mark.parametrize("name", DOCUMENT)
def test_origin_and_conversion_of_a_network_are_given(name: str) -> None:
    model = DOCUMENT[name]
    assert set(model) == {"file", "sha256", "what", "source", "license", "made_by"}
    assert model["license"] == "Apache-2.0"
    assert (ROOT / model["made_by"]).is_file()
    assert network_path(name) == FOLDER / model["file"]


def spoil(file: Path, how: str) -> None:
    content = bytearray(file.read_bytes())
    if how == "missing":
        file.unlink()
        return
    if how == "altered":
        content[len(content) // 2] ^= 1
    file.write_bytes(content[: 1000 if how == "truncated" else None])


@pytest.mark.parametrize("how", ["missing", "altered", "truncated"])
@pytest.mark.parametrize("name", DOCUMENT)
def test_altered_file_is_refused_in_one_sentence(folder: Path, name: str, how: str) -> None:
    check_networks()
    spoil(folder / DOCUMENT[name]["file"], how)
    for check in (check_networks, lambda: network_path(name)):
        with pytest.raises(NetworkError) as caught:
            check()
        assert DOCUMENT[name]["file"] in str(caught.value)
        assert "\n" not in str(caught.value)


def test_service_does_not_start_with_an_altered_file(tmp_path: Path) -> None:
    for package in ("app", "descriptor", "index"):
        ignored = shutil.ignore_patterns("__pycache__", "data", "build")
        shutil.copytree(ROOT / package, tmp_path / package, ignore=ignored)
    file = DOCUMENT["movenet"]["file"]
    spoil(tmp_path / "app" / "vision" / "models" / file, "altered")
    ended = run(sys.executable, "-m", "app", cwd=tmp_path, PORT=str(free_ports(1)[0]))
    assert ended.returncode == 1
    assert ended.stdout == ""
    assert file in ended.stderr
    assert ended.stderr.count("\n") == 1
