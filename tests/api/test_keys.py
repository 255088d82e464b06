"""API keys: what opens, what does not, and what needs none."""

from typing import Any

import pytest
from fastapi.testclient import TestClient
from starlette.types import Message, Receive, Scope, Send

from app.settings import Settings
from tests.conftest import Photo, Serving
from tests.support.service import check_problem


@pytest.fixture
def locked(serving: Serving, monkeypatch: pytest.MonkeyPatch) -> TestClient:
    monkeypatch.setenv("POSE_API_KEYS", "first, second")
    return serving(api_keys=Settings().api_keys)


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
def test_anything_else_is_refused(
    locked: TestClient, headers: dict[str, str], photo: Photo
) -> None:
    for response in (
        locked.get("/index", headers=headers),
        locked.post("/pose", files={"frame": photo.frame_png}, headers=headers),
        locked.post("/v1/vision/detection", files={"image": photo.frame_png}, headers=headers),
    ):
        wrong = headers.get("X-API-Key")
        assert ("got another one" if wrong else "got none") in check_problem(response, 401)
        assert response.headers["www-authenticate"] == "Bearer"
        assert "first" not in response.text


def test_without_a_key_the_upload_is_not_read(locked: TestClient) -> None:
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


def test_deepstack_accepts_a_key_in_the_form(locked: TestClient, photo: Photo) -> None:
    response = locked.post(
        "/v1/vision/detection", files={"image": photo.frame_png}, data={"api_key": "second"}
    )
    assert response.status_code == 200
    assert response.json()["success"] is True


@pytest.mark.parametrize(
    "request_",
    [
        {"content": b"unread", "headers": {"X-API-Key": "wrong"}},
        {"content": b"unread", "headers": {"Authorization": "Bearer wrong"}},
        {"files": {"image": b"no image", "unknown": b""}, "data": {"api_key": "wrong"}},
        {"files": {"image": b"no image", "unknown": b""}},
    ],
)
def test_deepstack_checks_the_key_first(locked: TestClient, request_: dict[str, Any]) -> None:
    refused = locked.post("/v1/vision/detection", **request_)
    given = "wrong" in str(request_)
    assert ("got another one" if given else "got none") in check_problem(refused, 401)


def test_settings_do_not_reveal_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POSE_API_KEYS", "first")
    assert "first" not in repr(Settings())
