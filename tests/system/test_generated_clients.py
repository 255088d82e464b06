"""Clients that generators make of the document: they talk to a live server."""

from __future__ import annotations

import importlib
import io
import json
import os
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import ROOT, Photo, Server
from tests.support.programs import output_of, run
from tests.support.videos import write_video

pytestmark = pytest.mark.slow
SOURCES = Path(__file__).parent / "typescript"
# The first is what openapi-generator says of every document of OpenAPI 3.1; the second also of one
# reduced to a single route and two plain models, where no schema lacks a name.
ABOUT_ITSELF = ("OpenAPI 3.1 support is still in beta", "Failed to get the schema name: null")
PACKAGE = "silhouette_pose_client"


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Any:
    pytest.importorskip("openapi_python_client", reason="needs openapi-python-client")
    folder = tmp_path_factory.mktemp("client")
    command = [sys.executable, "-m", "openapi_python_client", "generate"]
    command += ["--path", str(ROOT / "openapi.json"), "--output-path", str(folder / "out")]
    # Its formatter, ruff, stands beside the interpreter.
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    result = run(*command, PATH=path)
    assert result.returncode == 0, result.stderr
    assert "WARNING" not in result.stdout + result.stderr, result.stdout + result.stderr
    sys.path.insert(0, str(folder / "out"))
    yield importlib.import_module(PACKAGE)
    sys.path.remove(str(folder / "out"))


def load(name: str) -> Any:
    return importlib.import_module(f"{PACKAGE}.{name}")


def image(content: bytes) -> Any:
    return load("types").File(io.BytesIO(content), "image.png", "image/png")


def upload(photo: Photo, model: str = "FrameUpload", **more: Any) -> Any:
    """A form of a photograph and its mask."""
    form = getattr(load("models"), model)
    return form(frame=image(photo.frame_png), mask=image(photo.mask_png), **more)


def test_it_uploads_a_frame_and_reads_the_poses(package: Any, server: Server, photo: Photo) -> None:
    client = package.Client(server.url)
    answer = load("api.pose.estimate_pose").sync(client=client, body=upload(photo), n=3)
    (person,) = answer.persons
    assert [h.rank for h in person.hypotheses] == [1, 2, 3]
    assert person.hypotheses[0].entry == photo.entry
    assert person.hypotheses[0].joints_2d[0].x > 0


def test_it_reads_problems_and_pictures(package: Any, server: Server, photo: Photo) -> None:
    client = package.Client(server.url)
    body = load("models").FrameUpload(frame=image(b"?"))
    problem = load("api.pose.estimate_pose").sync(client=client, body=body)
    assert problem.status == 400
    assert problem.field == "frame"
    picture = load("api.index.get_entry_silhouette").sync(entry=3, client=client)
    assert picture.payload.read().startswith(b"\x89PNG")


@pytest.mark.parametrize("operation", ["draw_pose", "extract_silhouettes"])
def test_it_gets_pictures_of_a_frame(
    package: Any, server: Server, photo: Photo, operation: str
) -> None:
    client = package.Client(server.url)
    picture = load(f"api.pose.{operation}").sync(client=client, body=upload(photo))
    assert picture.payload.read().startswith(b"\x89PNG")


def test_it_requests_boxes_like_deepstack(package: Any, server: Server, photo: Photo) -> None:
    body = load("models").DeepstackUpload(image=image(photo.frame_png), min_confidence=0.9)
    client = package.Client(server.url)
    answer = load("api.compatibility.detect_deepstack").sync(client=client, body=body)
    assert answer.success


def test_it_tracks_the_frames_of_a_camera(package: Any, server: Server, photo: Photo) -> None:
    client, models = package.Client(server.url), load("models")
    wall = [[0.0, 0.0], [320.0, 0.0], [320.0, 240.0], [0.0, 240.0]]
    zone = models.Zone(name="wall", kind=models.ZoneKind.WATCH, polygon=wall)
    state = load("api.cameras.configure_camera").sync(
        "generated", client=client, body=models.CameraConfiguration(zones=[zone])
    )
    assert (state.zones[0].polygon, state.frames, state.image) == (wall, 0, None)
    for index in range(2):
        body = upload(photo, "TrackUpload", timestamp=float(index))
        operation = load("api.cameras.track_frame")
        response = operation.sync_detailed("generated", client=client, body=body)
        assert response.headers["x-session"] == ("warm" if index else "new")
        assert response.parsed.frame_index == index
        assert response.parsed.persons[0].zones == ["wall"]
    (camera,) = load("api.cameras.list_cameras").sync(client=client).cameras
    assert (camera.camera_id, camera.frames) == ("generated", 2)
    forget = load("api.cameras.forget_camera")
    assert forget.sync_detailed("generated", client=client).status_code == 204


def test_it_gets_the_lines_of_a_video(
    package: Any, server: Server, photo: Photo, tmp_path: Path
) -> None:
    data = write_video(tmp_path / "v.avi", [photo.frame] * 3)
    video = load("types").File(io.BytesIO(data), "v.avi", "video/x-msvideo")
    body = load("models").VideoUpload(video=video)
    answer = load("api.cameras.analyse_sequence").sync(client=package.Client(server.url), body=body)
    *frames, end = (json.loads(line) for line in answer.payload.read().splitlines())
    assert [frame["type"] for frame in frames] == ["frame"] * 3
    assert load("models").SequenceEnd.from_dict(end).frames == 3


def generate(generator: str, folder: Path) -> Path:
    """Run openapi-generator, which may warn of itself alone."""
    program = shutil.which("openapi-generator-cli", path=str(Path(sys.executable).parent))
    if program is None or shutil.which("java") is None:
        pytest.skip("needs Java and the package openapi-generator-cli (extra contract)")
    command = [program, "generate", "-i", ROOT / "openapi.json", "-g", generator]
    result = run(*command, "-o", folder)
    said = result.stdout + result.stderr
    assert result.returncode == 0, said
    warnings = [line for line in said.splitlines() if re.search(r"\b(WARN|ERROR)\b", line)]
    assert [w for w in warnings if not any(known in w for known in ABOUT_ITSELF)] == []
    return folder


def test_openapi_generators_python_client_uploads_a_frame_and_reads_problems(
    server: Server, photo: Photo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for needed in ("urllib3", "dateutil"):
        pytest.importorskip(needed, reason=f"needs {needed}, which the generated client uses")
    monkeypatch.syspath_prepend(generate("python", tmp_path))
    client = importlib.import_module("openapi_client")
    with client.ApiClient(client.Configuration(host=server.url)) as connection:
        pose = client.PoseApi(connection)
        mask = ("mask.png", photo.mask_png)
        answer = pose.estimate_pose(frame=("frame.png", photo.frame_png), n=3, mask=mask)
        with pytest.raises(client.ApiException) as caught:
            pose.estimate_pose(frame=("frame.png", b"?"))
        assert client.HealthApi(connection).liveness().status == "ok"
    assert caught.value.status == 400
    (person,) = answer.persons
    assert [h.rank for h in person.hypotheses] == [1, 2, 3]
    assert person.hypotheses[0].entry == photo.entry
    assert person.hypotheses[0].joints_3d[0].x == 0


def test_openapi_generators_typescript_client_takes_a_frame_as_a_file(tmp_path: Path) -> None:
    folder = generate("typescript-fetch", tmp_path)
    code = (folder / "apis" / "PoseApi.ts").read_text()
    assert re.search(r"interface EstimatePoseRequest \{[^}]*\bframe\?: Blob;", code, re.DOTALL)
    assert "Promise<PoseResponse>" in code
    assert "joints3d: Array<Point3D" in (folder / "models" / "Hypothesis.ts").read_text()


@pytest.fixture(scope="module")
def typed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A client whose types openapi-typescript made: it passes ``tsc --strict``."""
    if shutil.which("npm") is None:
        pytest.skip("needs npm")
    copy = tmp_path_factory.mktemp("typescript") / "client"
    shutil.copytree(SOURCES, copy, ignore=shutil.ignore_patterns("node_modules"))
    installed = run("npm", "install", "--no-audit", "--no-fund", "--no-package-lock", cwd=copy)
    if installed.returncode != 0:
        pytest.skip(f"npm install failed: {installed.stderr.strip()[-200:]}")
    output_of("node", "generate.mjs", ROOT / "openapi.json", "api.ts", cwd=copy)
    output_of("npx", "--no-install", "tsc", cwd=copy)
    return copy


def test_typescript_uploads_a_frame_and_reads_poses_problems_and_pictures(
    typed: Path, server: Server, photo: Photo
) -> None:
    (typed / "frame.png").write_bytes(photo.frame_png)
    (typed / "mask.png").write_bytes(photo.mask_png)
    command = ("node", "client.js", server.url, "frame.png", "mask.png")
    said = json.loads(output_of(*command, cwd=typed))
    (entries,) = said["entries"]
    assert len(entries) == 3
    assert entries[0] == photo.entry
    assert said["x"] > 0
    assert said["field"] == "frame"
    assert said["picture"] > 1000


def test_optional_fields_are_optional_in_the_type(typed: Path) -> None:
    types = (typed / "api.ts").read_text()
    form = types.split("FrameUpload: {")[1].split("};")[0]
    for field in ("frame?: Blob;", "mask?: Blob;", "background?: Blob;", "boxes?: string;"):
        assert field in form
    assert "min_confidence?: number;" in types
