"""Cross-origin requests: only from origins that are allowed."""

from __future__ import annotations

from typing import Any

import pytest
from fastapi.testclient import TestClient

from tests.conftest import Serving

ORIGIN = "https://yard.example"


@pytest.fixture
def open_to_yard(serving: Serving) -> TestClient:
    return serving(cors_origins=(ORIGIN,))


def preflight(client: TestClient, origin: str = ORIGIN, **asked: str) -> Any:
    headers = {f"access-control-request-{name}": value for name, value in asked.items()}
    return client.options("/pose", headers={"origin": origin, **headers})


def test_only_allowed_origins_may_read_answers(
    open_to_yard: TestClient, client: TestClient
) -> None:
    for asked, origin, allowed in (
        (open_to_yard, ORIGIN, ORIGIN),
        (open_to_yard, "https://other.example", None),
        (client, ORIGIN, None),
    ):
        headers = asked.get("/healthz", headers={"Origin": origin}).headers
        assert headers.get("access-control-allow-origin") == allowed


def test_an_allowed_preflight_lists_the_methods(open_to_yard: TestClient) -> None:
    response = preflight(open_to_yard, method="POST", headers="x-api-key")
    assert response.status_code == 200
    assert response.headers["access-control-allow-origin"] == ORIGIN
    assert response.headers["access-control-allow-methods"] == "DELETE, GET, HEAD, POST, PUT"


@pytest.mark.parametrize(
    "asked",
    [
        {"method": "PATCH"},
        {"method": "POST", "origin": "https://other.example"},
        {"method": "POST", "headers": "x-other"},
    ],
)
def test_other_preflights_are_refused(open_to_yard: TestClient, asked: dict[str, str]) -> None:
    response = preflight(open_to_yard, **asked)
    assert response.status_code == 400
    assert response.text.startswith("Disallowed CORS ")
    assert "Origin" in response.headers["vary"]
