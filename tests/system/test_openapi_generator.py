"""Clients of openapi-generator: made without warnings, and the Python one uploads a frame."""

from __future__ import annotations

import importlib
import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import ROOT, Photo, Server
from tests.support.programs import run

pytestmark = pytest.mark.slow

# The first it says of every document of OpenAPI 3.1; the second also of one reduced to a single
# route and two plain models, where no schema lacks a name.
ABOUT_ITSELF = ("OpenAPI 3.1 support is still in beta", "Failed to get the schema name: null")


def generate(generator: str, folder: Path) -> Path:
    program = shutil.which("openapi-generator-cli", path=str(Path(sys.executable).parent))
    if program is None:
        pytest.skip("needs the package openapi-generator-cli (extra contract)")
    if shutil.which("java") is None:
        pytest.skip("needs Java, which openapi-generator runs on")
    command = [program, "generate", "-i", str(ROOT / "openapi.json"), "-g", generator]
    result = run(*command, "-o", folder)
    said = result.stdout + result.stderr
    assert result.returncode == 0, said
    warnings = [line for line in said.splitlines() if re.search(r"\b(WARN|ERROR)\b", line)]
    assert [w for w in warnings if not any(known in w for known in ABOUT_ITSELF)] == []
    return folder


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    for needed in ("urllib3", "dateutil"):
        pytest.importorskip(needed, reason=f"needs {needed}, which the generated client uses")
    folder = generate("python", tmp_path_factory.mktemp("python"))
    sys.path.insert(0, str(folder))
    yield importlib.import_module("openapi_client")
    sys.path.remove(str(folder))


def test_the_python_client_uploads_a_frame(client: Any, server: Server, photo: Photo) -> None:
    with client.ApiClient(client.Configuration(host=server.url)) as connection:
        answer = client.PoseApi(connection).estimate_pose(
            frame=("frame.png", photo.frame_png), n=3, mask=("mask.png", photo.mask_png)
        )
    (person,) = answer.persons
    assert [h.rank for h in person.hypotheses] == [1, 2, 3]
    assert person.hypotheses[0].entry == photo.entry
    assert person.hypotheses[0].joints_3d[0].x == 0


def test_the_python_client_reads_problems(client: Any, server: Server) -> None:
    with client.ApiClient(client.Configuration(host=server.url)) as connection:
        with pytest.raises(client.ApiException) as caught:
            client.PoseApi(connection).estimate_pose(frame=("frame.png", b"?"))
        assert caught.value.status == 400
        assert client.HealthApi(connection).liveness().status == "ok"


def test_the_typescript_client_takes_a_frame_as_a_file(tmp_path: Path) -> None:
    folder = generate("typescript-fetch", tmp_path)
    code = (folder / "apis" / "PoseApi.ts").read_text()
    assert re.search(r"interface EstimatePoseRequest \{[^}]*\bframe\?: Blob;", code, re.DOTALL)
    assert "Promise<PoseResponse>" in code
    assert "joints3d: Array<Point3D" in (folder / "models" / "Hypothesis.ts").read_text()
