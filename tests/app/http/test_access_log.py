"""Every request has an id and a log line, unhandled errors too."""

import json
import logging

import anyio
import pytest
from fastapi.testclient import TestClient
from starlette.types import Message, Receive, Scope, Send

from app.http.access_log import AccessLogMiddleware, JsonFormatter
from app.http.metrics import Metrics
from app.http.routing import RouteTable
from app.photograph import Estimator
from tests.conftest import Photo, Serving
from tests.support.service import check_problem, sample


def test_logs_are_json_with_the_request_id_and_no_content(
    client: TestClient,
    photo: Photo,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(caplog.handler, "formatter", JsonFormatter())
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


def test_a_request_id_that_could_forge_log_lines_is_replaced(client: TestClient) -> None:
    response = client.get("/healthz", headers={"X-Request-ID": 'a"} {"b'})
    assert len(response.headers["x-request-id"]) == 32


def test_an_unhandled_error_is_a_problem_whose_id_is_in_the_log(
    serving: Serving,
    photo: Photo,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("secret")

    monkeypatch.setattr(Estimator, "estimate", fail)
    monkeypatch.setattr(caplog.handler, "formatter", JsonFormatter())
    with serving() as client:
        response = client.post(
            "/pose", files={"frame": photo.frame_png}, headers={"X-Request-ID": "camera-7.43"}
        )
        check_problem(response, 500)
        assert "secret" not in response.text
        assert response.headers["x-request-id"] == "camera-7.43"
        assert sample(client, "pose_requests_total", route="/pose", status="500") == 1
    lines = [json.loads(line) for line in caplog.text.splitlines()]
    (line,) = (line for line in lines if line["level"] == "error")
    assert line["request_id"] == "camera-7.43"
    assert "RuntimeError: secret" in line["exception"]


@pytest.mark.anyio
async def test_an_answer_that_fails_halfway_is_aborted(caplog: pytest.LogCaptureFixture) -> None:
    async def halfway(scope: Scope, receive: Receive, send: Send) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": []})
        raise RuntimeError("halfway")

    sent: list[Message] = []

    async def send(message: Message) -> None:
        sent.append(message)

    scope = {"type": "http", "method": "GET", "path": "/", "headers": []}
    app = AccessLogMiddleware(halfway, metrics=Metrics(), table=RouteTable(()))
    with pytest.raises(RuntimeError, match="halfway"):
        await app(scope, anyio.sleep_forever, send)
    assert [message["type"] for message in sent] == ["http.response.start"]
    assert "unhandled error" in caplog.text
