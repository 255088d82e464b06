"""Metrics: what is counted, under which names."""

from __future__ import annotations

import pytest
from fastapi.testclient import TestClient
from prometheus_client.parser import text_string_to_metric_families

from app.scheduling.queue import FairQueue, OverloadedError
from app.serving.runtime import VERSION
from tests.conftest import Photo, Serving
from tests.support.service import sample


def test_metrics_count_requests_and_their_results(client: TestClient, photo: Photo) -> None:
    assert client.post("/pose", files=photo.files).status_code == 200
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
def test_every_request_counts_for_its_route(
    client: TestClient, method: str, path: str, route: str
) -> None:
    status = str(client.request(method, path).status_code)
    assert sample(client, "pose_requests_total", route=route, status=status) == 1


def test_an_early_refusal_counts_for_its_route(
    serving: Serving, photo: Photo, monkeypatch: pytest.MonkeyPatch
) -> None:
    client = serving()

    def refuse(*_: object) -> None:
        raise OverloadedError("the service is working to capacity")

    monkeypatch.setattr(FairQueue, "check", refuse)
    assert client.post("/pose", files={"frame": photo.frame_png}).status_code == 503
    assert sample(client, "pose_requests_total", route="/pose", status="503") == 1
    assert sample(client, "pose_requests_total", route="other") is None
    assert sample(client, "pose_capacity_used_ratio") == 0


def test_histograms_of_durations_end_at_the_deadline(serving: Serving) -> None:
    client = serving(request_timeout_s=4.0)
    client.get("/healthz")
    bounds = [
        float(found.labels["le"])
        for family in text_string_to_metric_families(client.get("/metrics").text)
        for found in family.samples
        if found.name == "pose_request_seconds_bucket" and found.labels["route"] == "/healthz"
    ]
    assert bounds[-2:] == [4.0, float("inf")]
    assert bounds == sorted(set(bounds))


def test_metrics_name_the_build(serving: Serving) -> None:
    client = serving(revision="abc123", max_wait_s=5.0)
    found = sample(client, "pose_build_info", version=VERSION, revision="abc123", max_wait_s="5")
    assert found == 1


def test_events_of_cameras_are_counted(client: TestClient, photo: Photo) -> None:
    client.post("/cameras/yard/frames", files=photo.files)
    client.post("/cameras/gate/frames", files=photo.files)
    assert sample(client, "pose_events_total", event="entered") == 2
