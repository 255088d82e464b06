"""Cross-origin requests: only from origins that are allowed."""

from __future__ import annotations

import httpx
import pytest
from fastapi.testclient import TestClient

from app.estimation.estimator import Estimator
from app.main import create_app
from app.settings import Settings

ORIGIN = "https://yard.example"


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


@pytest.fixture
def open_to_yard(settings: Settings, estimator: Estimator) -> TestClient:
    allowing = settings.model_copy(update={"cors_origins": (ORIGIN,)})
    return TestClient(create_app(allowing, estimator))


def preflight(client: TestClient, **asked: str) -> httpx.Response:
    headers = {f"access-control-request-{name}": value for name, value in asked.items()}
    origin = headers.pop("access-control-request-origin", ORIGIN)
    return client.options("/pose", headers={"origin": origin, **headers})


def test_an_allowed_preflight_says_what_there_is(open_to_yard: TestClient) -> None:
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
