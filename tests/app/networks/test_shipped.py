"""What was learned: the files are those of models.json, or the service does not start."""

import hashlib
import json
import re
import shutil
import sys
from pathlib import Path

import pytest

from app.networks import shipped
from app.networks.shipped import FOLDER, LIST, NetworkError, check_files, file_of
from tests.conftest import ROOT
from tests.support.ports import free_ports
from tests.support.programs import output_of, run

DOCUMENT = json.loads(LIST.read_text())


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the folder, used in its place."""
    copy = tmp_path / "models"
    shutil.copytree(FOLDER, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(shipped, "FOLDER", copy)
    monkeypatch.setattr(shipped, "LIST", copy / LIST.name)
    monkeypatch.setattr(shipped, "file_of", file_of.__wrapped__)
    return copy


def test_every_file_is_listed_with_its_hash() -> None:
    files = {path.name for path in FOLDER.iterdir()} - {LIST.name}
    assert files == {model["file"] for model in DOCUMENT.values()}
    for model in DOCUMENT.values():
        content = (FOLDER / model["file"]).read_bytes()
        assert model["sha256"] == hashlib.sha256(content).hexdigest()


@pytest.mark.parametrize("name", DOCUMENT)
def test_origin_and_conversion_of_a_network_are_given(name: str) -> None:
    model = DOCUMENT[name]
    assert set(model) == {"file", "sha256", "what", "source", "license", "made_by"}
    assert model["license"] == "Apache-2.0"
    # What ran once is no longer there, and named with the revision that has it.
    script, at, revision = model["made_by"].partition(" of revision ")
    assert re.fullmatch("[0-9a-f]{8}", revision) if at else (ROOT / script).is_file()
    assert file_of(name) == FOLDER / model["file"]


def spoil(file: Path, how: str) -> None:
    content = bytearray(file.read_bytes())
    if how == "missing":
        file.unlink()
        return
    if how == "altered":
        content[len(content) // 2] ^= 1
    file.write_bytes(content[: 100 if how == "truncated" else None])


def test_altered_file_is_refused_in_one_sentence(folder: Path) -> None:
    check_files()
    spoilt = [
        *((name, "altered") for name in DOCUMENT),
        ("falls", "missing"),
        ("movenet", "truncated"),
    ]
    for name, how in spoilt:
        file = folder / DOCUMENT[name]["file"]
        sound = file.read_bytes()
        spoil(file, how)
        for check in (check_files, lambda name=name: shipped.file_of(name)):
            with pytest.raises(NetworkError) as caught:
                check()
            assert file.name in str(caught.value)
            assert "\n" not in str(caught.value)
        file.write_bytes(sound)


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy of the service."""
    for package in ("app", "descriptor", "index"):
        ignored = shutil.ignore_patterns("__pycache__", "data", "build")
        shutil.copytree(ROOT / package, tmp_path / package, ignore=ignored)
    return tmp_path


def test_service_does_not_start_with_an_altered_file(copy: Path) -> None:
    file = copy / "app" / "networks" / "models" / DOCUMENT["falls"]["file"]
    spoil(file, "altered")
    ended = run(sys.executable, "-m", "app", cwd=copy, PORT=str(free_ports(1)[0]))
    assert ended.returncode == 1
    assert ended.stdout == ""
    assert file.name in ended.stderr
    assert ended.stderr.count("\n") == 1


FRAMES = """
import sys
from pathlib import Path
from app import *
from app.networks.shipped import FOLDER
opened = set()
def watch(event, arguments):
    if event == "open" and str(arguments[0]).startswith(str(FOLDER)):
        opened.add(Path(arguments[0]).name)
sys.addaudithook(watch)
estimator = load_estimator(Settings(concurrency=1, index=Path("tests/data/indexes/sticks")))
print(*sorted(opened))
opened.clear()
session, frame = CameraSession(estimator), Upload(Path("tests/data/walkers.jpg").read_bytes())
people = [len(session.process(frame, time / 2).persons) for time in range(5)]
print(max(people), *opened)
"""


def test_all_is_loaded_before_the_first_frame() -> None:
    loaded, later = output_of(sys.executable, "-c", FRAMES, cwd=ROOT).splitlines()
    assert set(loaded.split()) == {LIST.name, *(model["file"] for model in DOCUMENT.values())}
    assert int(later) >= 3
