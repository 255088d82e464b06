"""The client that openapi-python-client makes of the document calls every route of a server."""

import importlib
import io
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import ROOT, Photo, Server
from tests.support.programs import run
from tests.support.videos import write_video

pytestmark = pytest.mark.slow
# Half a second apart, in Unix time, which 32 bits round to 128 s.
TIMES = [1795880000.25 + 0.5 * frame for frame in range(4)]
DOCUMENT = ROOT / "openapi.json"
PACKAGE = "silhouette_pose_client"
WALL = [[0.0, 0.0], [320.0, 0.0], [320.0, 240.0], [0.0, 240.0]]


def operations() -> dict[str, tuple[str, str]]:
    """Tag and path of every operation of the document."""
    paths = json.loads(DOCUMENT.read_text())["paths"]
    return {
        operation["operationId"]: (operation["tags"][0], path)
        for path, methods in paths.items()
        for operation in methods.values()
    }


@pytest.fixture(scope="module")
def calls(photo: Photo, tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Any, ...]]:
    """Parameters of a call of each operation, in order, and the model and fields of its body."""
    video = write_video(tmp_path_factory.mktemp("video") / "v.avi", [photo.frame] * 3)
    upload = {"frame": photo.frame_png, "mask": photo.mask_png}
    zone = {"name": "wall", "kind": "watch", "polygon": WALL}
    camera, entry = {"camera_id": "generated"}, {"entry": 3}
    return {
        "liveness": ({},),
        "readiness": ({},),
        "describe_index": ({},),
        "get_entry": (entry,),
        "get_entry_silhouette": (entry,),
        "estimate_pose": ({"n": 3}, "FrameUpload", upload),
        "draw_pose": ({}, "FrameUpload", upload),
        "extract_silhouettes": ({}, "FrameUpload", upload),
        "detect_deepstack": ({}, "DeepstackUpload", {"image": photo.frame_png}),
        "configure_camera": (camera, "CameraConfiguration", {"zones": [zone]}),
        "track_frame": (camera, "TrackUpload", {**upload, "timestamp": 1.0}),
        "get_camera": (camera,),
        "list_camera_events": (camera,),
        "replay_event": (camera,),
        "list_cameras": ({},),
        "forget_camera": (camera,),
        "analyse_sequence": ({}, "VideoUpload", {"video": video}),
    }


def check(answers: dict[str, Any], photo: Photo) -> None:
    """Every route has been called, and the answers are what was sent."""
    assert answers.keys() == operations().keys()
    assert answers["liveness"].status == answers["readiness"].status == "ok"
    assert answers["describe_index"].name == "sticks"
    assert answers["get_entry"].entry == 3
    (person,) = answers["estimate_pose"].persons
    assert [h.rank for h in person.hypotheses] == [1, 2, 3]
    assert person.hypotheses[0].entry == photo.entry
    assert person.hypotheses[0].joints_3d[0].x == 0
    assert answers["detect_deepstack"].success
    assert answers["configure_camera"].zones[0].polygon == WALL
    assert answers["track_frame"].persons[0].zones == ["wall"]
    assert answers["get_camera"].frames == 1
    assert answers["list_camera_events"].events[0].event == "entered"
    assert "generated" in [camera.camera_id for camera in answers["list_cameras"].cameras]
    for name in ("draw_pose", "extract_silhouettes", "get_entry_silhouette"):
        assert content(answers[name]).startswith(b"\x89PNG")
    replay = answers["replay_event"]
    assert (replay.event.event, replay.zones[0].name) == ("entered", "wall")
    sequence = answers["analyse_sequence"]
    assert (sequence.end.reason, sequence.end.frames) == ("complete", 3), sequence.end.detail
    assert [frame.video_frame for frame in sequence.frames] == [0, 1, 2]


def content(file: Any) -> bytes:
    return bytes(file.payload.read() if hasattr(file, "payload") else file)


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    pytest.importorskip("openapi_python_client", reason="needs openapi-python-client")
    folder = tmp_path_factory.mktemp("client")
    command = [sys.executable, "-m", "openapi_python_client", "generate"]
    command += ["--path", str(DOCUMENT), "--output-path", str(folder / "out")]
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


def test_openapi_python_client_calls_every_route(
    package: Any, server: Server, photo: Photo, calls: dict[str, tuple[Any, ...]]
) -> None:
    # It asks for no type of its own, and reads no lines of JSON.
    client, answers = package.Client(server.url, headers={"Accept": "application/json"}), {}
    for name, (parameters, *body) in calls.items():
        if body:
            model, fields = body
            fields = {k: image(v) if isinstance(v, bytes) else v for k, v in fields.items()}
            parameters = {**parameters, "body": getattr(load("models"), model)(**fields)}
            if model == "CameraConfiguration":
                parameters["body"] = load("models").CameraConfiguration.from_dict(fields)
        if name == "replay_event":
            event_id = answers["list_camera_events"].events[0].id
            parameters = {**parameters, "event_id": event_id}
        operation = load(f"api.{operations()[name][0]}.{name}")
        answer = operation.sync_detailed(client=client, **parameters)
        assert answer.status_code in (200, 204), name
        answers[name] = answer.parsed
        if name == "track_frame":
            assert answer.headers["x-session"] == "new"
    check(answers, photo)
    track = load("api.cameras.track_frame").sync
    form = load("models").TrackUpload
    for at in TIMES:  # In turn as a form, and as the body alone.
        if at % 1 == TIMES[0] % 1:
            body, more = form(frame=image(photo.frame_png), timestamp=at), {}
        else:
            body, more = image(photo.frame_png), {"timestamp": at}
        assert track("python", client=client, body=body, **more).timestamp == at
    load("api.cameras.forget_camera").sync_detailed("python", client=client)
    assert load("models").SequenceEnd
    broken = load("models").FrameUpload(frame=image(b"?"))
    problem = load("api.pose.estimate_pose").sync(client=client, body=broken)
    assert (problem.status, problem.field) == (400, "frame")
