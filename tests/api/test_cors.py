"""Cross-origin requests: only from origins that are allowed."""

from typing import Any

import pytest
from fastapi.testclient import TestClient

from tests.conftest import Serving
from tests.support.service import check_problem

ORIGIN = "https://yard.example"


@pytest.fixture
def open_to_yard(serving: Serving) -> TestClient:
    return serving(cors_origins=(ORIGIN,))


@pytest.mark.parametrize(
    ("headers", "is_foreign"),
    [
        ({}, False),
        ({"origin": "http://testserver"}, False),
        ({"origin": "https://cameras.example", "host": "cameras.example:443"}, False),
        ({"origin": "http://cameras.example:8000", "host": "Cameras.example:8000"}, False),
        ({"origin": "https://cameras.example", "sec-fetch-site": "same-origin"}, False),
        ({"origin": "http://hub", "host": "127.0.0.1:8000", "x-forwarded-host": "hub"}, False),
        ({"origin": "http://evil.example"}, True),
        ({"origin": "http://127.0.0.1:9000", "host": "127.0.0.1:8000"}, True),
        ({"origin": "http://testserver", "sec-fetch-site": "cross-site"}, True),
        # Of another port of this machine, or of a page beside it below one domain.
        ({"origin": "http://testserver:9000", "sec-fetch-site": "same-site"}, True),
        (
            {
                "origin": "https://evil.cameras.example",
                "host": "cameras.example",
                "sec-fetch-site": "same-site",
            },
            True,
        ),
        ({"origin": "null"}, True),
    ],
)
def test_pages_of_other_sites_may_not_send_uploads(
    client: TestClient, open_to_yard: TestClient, headers: dict[str, str], is_foreign: bool
) -> None:
    for response in (
        client.post("/pose", files={"frame": b"?"}, headers=headers),
        client.put("/cameras/yard", json={"zones": 1}, headers=headers),
        open_to_yard.post("/v1/vision/detection", files={"image": b"?"}, headers=headers),
    ):
        assert (response.status_code == 403) == is_foreign
        if is_foreign:
            assert f"got '{headers['origin']}'" in check_problem(response, 403)
            assert response.json()["reason"] == "foreign_origin"
    allowed = open_to_yard.post(
        "/pose", files={"frame": b"?"}, headers={"origin": ORIGIN, "sec-fetch-site": "cross-site"}
    )
    assert allowed.status_code == 400
    assert client.get("/healthz", headers=headers).status_code == 200


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
