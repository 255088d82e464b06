"""A client generated from the document talks to a live server."""

from __future__ import annotations

import importlib
import io
import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import ROOT, Photo, Server
from tests.support.programs import run
from tests.support.videos import write_video

pytestmark = pytest.mark.slow
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
