"""Metrics: what is counted, under which names."""

import pytest
from fastapi.testclient import TestClient
from pydantic import SecretStr

from tests.conftest import Photo, Serving
from tests.support.service import sample, samples, send


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
        ("HEAD", "/healthz", "/healthz"),
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


def test_durations_are_counted_to_the_deadline_but_of_probes(serving: Serving) -> None:
    client = serving(request_timeout_s=4.0)
    client.get("/index")
    client.get("/healthz")
    client.post("/sequence", files={"video": b"?"})
    found = samples(client, "pose_request_seconds_bucket")
    assert [found[-2]["le"], found[-1]["le"]] == ["4.0", "+Inf"]
    assert {labels["route"] for labels in found} == {"/index"}
    # Videos take minutes.
    assert samples(client, "pose_sequence_seconds_bucket")[-2]["le"] == "3600.0"


def test_dropped_frames_are_counted_by_camera(client: TestClient, photo: Photo) -> None:
    yard = {"caller": "0", "camera": "yard"}
    assert send(client, photo, timestamp="1").status_code == 200
    assert send(client, photo, timestamp="1").status_code == 409
    assert client.post("/cameras/yard/frames", files={"frame": b"?"}).status_code == 400
    assert client.post("/cameras/gate/frames", files={"frame": b"?"}).status_code == 400
    # Neither a frame of the session nor a frame at all.
    client.post("/pose", files={"frame": b"?"}, headers={"X-Camera-ID": "yard"})
    client.get("/cameras/yard/frames")
    dropped = samples(client, "pose_camera_frames_dropped_total")
    assert dropped == [{**yard, "reason": reason} for reason in ("late_frame", "undecodable")]
    assert sample(client, "pose_camera_frames_dropped_total", reason="late_frame") == 1


def test_a_strangers_frames_do_not_count_for_a_camera(serving: Serving, photo: Photo) -> None:
    client = serving(api_keys=(SecretStr("first"), SecretStr("second")))
    owner = {"X-API-Key": "second"}
    assert send(client, photo, headers=owner, timestamp="1").status_code == 200
    assert send(client, photo).status_code == 401
    assert not samples(client, "pose_camera_frames_dropped_total")
    send(client, photo, headers=owner, timestamp="1")
    dropped = samples(client, "pose_camera_frames_dropped_total")
    assert dropped == [{"caller": "1", "camera": "yard", "reason": "late_frame"}]


def test_a_camera_has_series_as_long_as_its_session(client: TestClient, photo: Photo) -> None:
    age = "pose_camera_frame_age_seconds"
    assert not samples(client, age)
    for timestamp in ("1", "1"):
        send(client, photo, timestamp=timestamp)
    first = sample(client, age, caller="0", camera="yard")
    second = sample(client, age, caller="0", camera="yard")
    assert first is not None
    assert second is not None
    assert 0 <= first < second < 60
    client.delete("/cameras/yard")
    assert not samples(client, age)
    assert not samples(client, "pose_camera_frames_dropped_total")
