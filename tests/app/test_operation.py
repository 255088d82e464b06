"""What operators rely on: keys, limits, metrics, logs, CORS."""

from __future__ import annotations

import json
import logging
import shutil
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest
from fastapi.testclient import TestClient
from prometheus_client.parser import text_string_to_metric_families
from starlette.types import Message, Receive, Scope, Send

from app.estimates import Upload
from app.estimator import Estimator
from app.logs import JsonFormatter
from app.main import create_app
from app.settings import Settings
from app.version import VERSION
from app.vision import weights
from tests.conftest import Photo


def sample(client: TestClient, metric: str, /, **labels: str) -> float | None:
    for family in text_string_to_metric_families(client.get("/metrics").text):
        for found in family.samples:
            if found.name == metric and labels.items() <= found.labels.items():
                return found.value
    return None


@pytest.fixture
def locked(settings: Settings, estimator: Estimator, monkeypatch: pytest.MonkeyPatch) -> TestClient:
    monkeypatch.setenv("POSE_API_KEYS", "first, second")
    keys = Settings().api_keys
    return TestClient(create_app(settings.model_copy(update={"api_keys": keys}), estimator))


@pytest.mark.parametrize("key", ["first", "second"])
def test_each_key_opens(locked: TestClient, key: str) -> None:
    assert locked.get("/index", headers={"X-API-Key": key}).status_code == 200
    assert locked.get("/index", headers={"Authorization": f"Bearer {key}"}).status_code == 200


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"X-API-Key": ""},
        {"X-API-Key": "firs"},
        {"X-API-Key": "first, second"},
        {"Authorization": "Basic first"},
        {"Authorization": "Bearer"},
        {"X-API-Key": "\u00e9".encode()},
    ],
)
def test_anything_else_does_not(locked: TestClient, headers: dict[str, str], photo: Photo) -> None:
    for response in (
        locked.get("/index", headers=headers),
        locked.post("/pose", files={"frame": photo.frame_png}, headers=headers),
        locked.post("/v1/vision/detection", files={"image": photo.frame_png}, headers=headers),
    ):
        assert response.status_code == 401
        assert response.headers["content-type"] == "application/problem+json"
        assert response.headers["www-authenticate"] == "Bearer"
        assert "first" not in response.text


def test_without_a_key_nothing_of_an_upload_is_read(locked: TestClient) -> None:
    received = []
    app = locked.app

    async def watching(scope: Scope, receive: Receive, send: Send) -> None:
        async def watched() -> Message:
            received.append(await receive())
            return received[-1]

        await app(scope, watched, send)

    response = TestClient(watching).post("/pose", files={"frame": b"a photograph"})
    assert response.status_code == 401
    assert received == []


def test_probes_and_pages_need_no_key(locked: TestClient) -> None:
    for path in ("/healthz", "/readyz", "/metrics", "/docs", "/openapi.json"):
        assert locked.get(path).status_code == 200, path


def test_deepstack_takes_its_form_field(locked: TestClient, photo: Photo) -> None:
    response = locked.post(
        "/v1/vision/detection", files={"image": photo.frame_png}, data={"api_key": "second"}
    )
    assert response.status_code == 200
    assert response.json()["success"] is True


def test_keys_do_not_show_in_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POSE_API_KEYS", "first")
    assert "first" not in repr(Settings())


def test_metrics_tell_what_happened(client: TestClient, photo: Photo) -> None:
    files = {"frame": photo.frame_png, "mask": photo.mask_png}
    assert client.post("/pose", files=files).status_code == 200
    assert client.post("/pose", files={"frame": b"?"}).status_code == 400
    assert client.get("/nothing/of/this/name").status_code == 404
    assert sample(client, "pose_requests_total", route="/pose", status="200") == 1
    assert sample(client, "pose_requests_total", route="other", status="404") == 1
    assert sample(client, "pose_rejected_total", reason="undecodable") == 1
    assert sample(client, "pose_stage_seconds_count", stage="search") == 1
    assert sample(client, "pose_stage_seconds_count", stage="detect") is None
    assert sample(client, "pose_stage_seconds_bucket", le="0.0005") is not None
    assert sample(client, "pose_persons_sum") == 1
    assert sample(client, "pose_confidence_count") == 1
    assert sample(client, "pose_in_flight") == 0
    assert sample(client, "pose_index_info", name="sticks") == 1


@pytest.mark.parametrize(
    ("method", "path", "route"),
    [
        ("GET", "/", "/"),
        ("GET", "/docs", "/docs"),
        ("GET", "/openapi.json", "/openapi.json"),
        ("HEAD", "/healthz", "/healthz"),
        ("GET", "/static/page.js", "/static"),
        ("GET", "/static/none.js", "/static"),
        ("GET", "/docs/assets/favicon.png", "/docs/assets"),
        ("GET", "/index/entries/7", "/index/entries/{entry}"),
        ("GET", "/pose", "/pose"),
        ("GET", "/metrics", "/metrics"),
        ("GET", "/poses", "other"),
    ],
)
def test_every_request_counts_under_a_name_of_its_own(
    client: TestClient, method: str, path: str, route: str
) -> None:
    status = str(client.request(method, path).status_code)
    assert sample(client, "pose_requests_total", route=route, status=status) == 1


def test_what_is_refused_early_counts_for_the_route_it_was_meant_for(
    settings: Settings, estimator: Estimator, photo: Photo
) -> None:
    client = TestClient(create_app(settings, estimator))
    pool = client.app.state.runtime.pool
    pool.inside = pool.capacity
    assert client.post("/pose", files={"frame": photo.frame_png}).status_code == 503
    assert sample(client, "pose_requests_total", route="/pose", status="503") == 1
    assert sample(client, "pose_requests_total", route="other") is None
    assert sample(client, "pose_capacity_used_ratio") == 1
    pool.inside = 0
    assert sample(client, "pose_capacity_used_ratio") == 0


def test_histograms_of_times_reach_to_the_deadline(
    settings: Settings, estimator: Estimator
) -> None:
    hurried = settings.model_copy(update={"request_timeout_s": 4.0})
    client = TestClient(create_app(hurried, estimator))
    client.get("/healthz")
    bounds = [
        float(found.labels["le"])
        for family in text_string_to_metric_families(client.get("/metrics").text)
        for found in family.samples
        if found.name == "pose_request_seconds_bucket" and found.labels["route"] == "/healthz"
    ]
    assert bounds[-2:] == [4.0, float("inf")]
    assert bounds == sorted(set(bounds))


def test_metrics_tell_which_build_serves(settings: Settings, estimator: Estimator) -> None:
    chosen = settings.model_copy(update={"revision": "abc123", "queue_length": 5})
    client = TestClient(create_app(chosen, estimator))
    found = sample(client, "pose_build_info", version=VERSION, revision="abc123", queue_length="5")
    assert found == 1


def test_logs_are_json_with_the_request_id_and_no_content(
    client: TestClient, photo: Photo, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.handler.setFormatter(JsonFormatter())
    with caplog.at_level(logging.INFO, logger="app"):
        response = client.post(
            "/pose",
            files={"frame": ("secret-name.png", photo.frame_png)},
            headers={"X-Request-ID": "camera-7.42"},
        )
    assert response.headers["x-request-id"] == "camera-7.42"
    line = json.loads(caplog.text.splitlines()[-1])
    assert line["request_id"] == "camera-7.42"
    assert line["path"] == "/pose"
    assert line["status"] == 200
    assert line["ms"] > 0
    assert "secret" not in caplog.text


def test_a_request_id_that_could_forge_logs_is_replaced(client: TestClient) -> None:
    response = client.get("/healthz", headers={"X-Request-ID": 'a"} {"b'})
    assert len(response.headers["x-request-id"]) == 32


def test_cors_only_where_it_is_set(settings: Settings, estimator: Estimator) -> None:
    ask = {"Origin": "https://yard.example"}
    origins = settings.model_copy(update={"cors_origins": ("https://yard.example",)})
    with TestClient(create_app(origins, estimator)) as client:
        answer = client.get("/healthz", headers=ask)
        assert answer.headers["access-control-allow-origin"] == "https://yard.example"
        other = client.get("/healthz", headers={"Origin": "https://other.example"})
        assert "access-control-allow-origin" not in other.headers
    with TestClient(create_app(settings, estimator)) as client:
        assert "access-control-allow-origin" not in client.get("/healthz", headers=ask).headers


def test_more_people_than_allowed(settings: Settings, estimator: Estimator) -> None:
    few = Estimator(
        estimator.index,
        estimator.detector,
        estimator.segmenter,
        estimator._reader,
        min_person_px=50,
        max_pixels=10**6,
        max_persons=2,
    )
    labels = np.zeros((90, 90), np.uint8)
    for person in range(3):
        labels[10:80, 10 + 20 * person : 20 + 20 * person] = person + 1
    mask = cv2.imencode(".png", labels)[1].tobytes()
    frame = cv2.imencode(".png", np.zeros((90, 90, 3), np.uint8))[1].tobytes()
    with TestClient(create_app(settings, few)) as client:
        response = client.post("/pose", files={"frame": frame, "mask": mask})
        assert response.status_code == 422
        assert response.json()["field"] == "mask"


@pytest.mark.parametrize("count", [1, 3])
def test_no_more_threads_beside_the_work_than_cores(
    settings: Settings, photo: Photo, monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    monkeypatch.setattr("app.estimator.cores", lambda: count)
    before = set(threading.enumerate())
    estimator = Estimator.load(settings)
    estimator.warm_up()
    upload = Upload(frame=photo.frame_png, mask=photo.mask_png)
    with ThreadPoolExecutor(6) as callers:
        answers = list(
            callers.map(lambda _: estimator.estimate(upload, 1, lambda: None), range(12))
        )
        list(callers.map(lambda _: estimator.detect(photo.frame_png, lambda: None), range(6)))
    # The callers' own are gone.
    beside = set(threading.enumerate()) - before
    assert len(beside) <= count
    assert bool(beside) == (count > 1)
    assert all(len(answer.persons) == 1 for answer in answers)


def test_whatever_goes_wrong_while_loading_is_told_to_probes(
    settings: Settings, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(_: Settings) -> Estimator:
        raise ZeroDivisionError("an inside matter")

    monkeypatch.setattr(Estimator, "load", fail)
    with TestClient(create_app(settings)) as client:
        while "not ready" not in caplog.text:
            assert client.get("/healthz").status_code == 200
        response = client.get("/readyz")
        assert response.status_code == 503
        assert "inside" not in response.text
        assert "ZeroDivisionError" in caplog.text


def test_a_network_that_is_not_the_one_that_ships_is_told_not_served(
    settings: Settings, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """``python -m app`` ends at once (tests/vision/weights); started otherwise, probes tell."""
    folder = tmp_path / "weights"
    shutil.copytree(weights.FOLDER, folder)
    network = folder / "movenet_multipose.tflite"
    network.write_bytes(network.read_bytes()[:1000])
    monkeypatch.setattr(weights, "FOLDER", folder)
    expected = "movenet_multipose.tflite to have the SHA-256"
    with TestClient(create_app(settings)) as client:
        deadline, detail = time.monotonic() + 10, ""
        while expected not in detail:
            assert time.monotonic() < deadline, detail
            response = client.get("/readyz")
            assert response.status_code == 503
            detail = response.json()["detail"]
        assert client.post("/pose", files={"frame": b"x"}).status_code == 503
