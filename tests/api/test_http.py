"""HTTP behaviour that all routes share."""

import gzip
import json

import httpx
import pytest
from fastapi.testclient import TestClient

from tests.conftest import Photo


@pytest.mark.parametrize(
    "path",
    [
        "/",
        "/docs",
        "/openapi.json",
        "/healthz",
        "/readyz",
        "/metrics",
        "/index",
        "/index/entries/3",
        "/index/entries/3/silhouette.png",
        "/static/page.js",
    ],
)
def test_head_works_wherever_get_does(client: TestClient, path: str) -> None:
    head, get = client.head(path), client.get(path)
    assert head.status_code == get.status_code == 200
    assert head.content == b""
    assert head.headers["content-type"] == get.headers["content-type"]
    if path != "/metrics":  # It counts the request before.
        assert head.headers["content-length"] == get.headers["content-length"]


@pytest.mark.parametrize("path", ["/index", "/index/entries/3", "/healthz", "/cameras/yard"])
def test_a_slash_at_the_end_changes_no_answer(client: TestClient, path: str) -> None:
    with_slash, without = client.get(f"{path}/"), client.get(path)
    assert with_slash.status_code == without.status_code
    assert with_slash.json() == without.json()


@pytest.mark.parametrize("path", ["//evil.example/", "/static/", "//", "/nothing/", "/pose//"])
def test_nothing_else_is_redirected(client: TestClient, path: str) -> None:
    response = client.get(f"http://testserver{path}", follow_redirects=False)
    assert response.status_code in (200, 404)
    assert "location" not in response.headers


def test_answers_are_compressed_on_request(client: TestClient, photo: Photo) -> None:
    def ask(encoding: str) -> httpx.Response:
        headers = {"accept-encoding": encoding}
        with client.stream("POST", "/pose", files=photo.files, headers=headers) as response:
            response.raw = b"".join(response.iter_raw())
        return response

    packed, plain = ask("gzip, br"), ask("identity")
    assert packed.headers["content-encoding"] == "gzip"
    assert "content-encoding" not in plain.headers
    assert "Accept-Encoding" in packed.headers["vary"]
    assert len(packed.raw) < len(plain.raw) / 2
    answers = [json.loads(text) for text in (gzip.decompress(packed.raw), plain.raw)]
    assert answers[0]["persons"] == answers[1]["persons"]
