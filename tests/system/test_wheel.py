"""``pip install .`` serves what a checkout does, from an empty folder."""

import json
import shutil
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from app import VERSION
from app.networks.shipped import LIST
from index import DEFAULT_PATH
from tests.conftest import ROOT, WALKERS, Server, running_server
from tests.support.programs import output_of

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"  # A build leaves files beside what it builds.
    source.mkdir()
    for file in ("LICENSE", "NOTICE", "README.md", "pyproject.toml"):
        shutil.copy(ROOT / file, source)
    for package in ("app", "descriptor", "index"):
        shutil.copytree(ROOT / package, source / package)
    output_of(sys.executable, "-m", "pip", "wheel", "--no-deps", "--quiet", "-w", folder, source)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """The service as a fresh environment has it, started in an empty folder."""
    folder = tmp_path_factory.mktemp("installed")
    output_of(sys.executable, "-m", "venv", folder / "venv")
    python = folder / "venv" / "bin" / "python"
    output_of(python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", wheel)
    empty = folder / "empty"
    empty.mkdir()
    with running_server(None, root=empty, python=python) as server:
        yield server
    assert not any(empty.iterdir())


@pytest.fixture(scope="module")
def checkout() -> Iterator[Server]:
    with running_server(None) as server:
        yield server


def test_the_wheel_holds_what_serving_needs_and_no_builder(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        (metadata,) = (name for name in names if name.endswith(".dist-info/METADATA"))
        assert "License-Expression: Apache-2.0" in archive.read(metadata).decode()
    licences = {name.rsplit("/", 1)[1] for name in names if ".dist-info/licenses/" in name}
    assert licences == {"LICENSE", "NOTICE"}
    learned = {model["file"] for model in json.loads(LIST.read_text()).values()}
    needed = {f"app/networks/models/{file}" for file in (*learned, "models.json")}
    needed |= {f"index/data/{path.name}" for path in DEFAULT_PATH.iterdir()}
    needed |= {f"app/static/{path.name}" for path in (ROOT / "app" / "static").iterdir()}
    assert needed <= names
    folders = {name.split("/")[0] for name in names if ".dist-info/" not in name}
    assert folders == {"app", "descriptor", "index"}


def test_the_wheel_serves_like_a_checkout(installed: Server, checkout: Server) -> None:
    for path in ("/", "/static/page.js", "/docs", "/index", "/index/entries/7"):
        there, here = (httpx.get(server.url + path) for server in (installed, checkout))
        assert there.status_code == 200
        assert there.content == here.content
    assert httpx.get(f"{installed.url}/openapi.json").json()["info"]["version"] == VERSION
    there, here = (
        httpx.post(f"{server.url}/pose", files={"frame": WALKERS.read_bytes()}, timeout=30).json()
        for server in (installed, checkout)
    )
    assert len(here["persons"]) >= 3
    assert there["persons"] == here["persons"]
