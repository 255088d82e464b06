"""The document clients are generated from."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from app.main import create_app
from app.settings import Settings
from tests.conftest import ROOT


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    return create_app(Settings()).openapi()


def operations(document: dict[str, Any]) -> list[dict[str, Any]]:
    return [operation for path in document["paths"].values() for operation in path.values()]


def test_the_committed_document_is_not_stale(document: dict[str, Any]) -> None:
    committed = Path(ROOT / "openapi.json").read_text()
    assert committed == json.dumps(document, indent=2) + "\n", (
        "run `make openapi` and commit openapi.json"
    )


def test_every_operation_and_field_is_described(document: dict[str, Any]) -> None:
    for operation in operations(document):
        assert operation["description"]
    for name, schema in document["components"]["schemas"].items():
        assert schema["description"], name
        for field, value in schema.get("properties", {}).items():
            target = value.get("$ref") or next(
                (part["$ref"] for part in value.get("anyOf", ()) if "$ref" in part), None
            )
            assert value.get("description") or target, f"{name}.{field}"


def test_headers_of_answers_are_declared(document: dict[str, Any], client: TestClient) -> None:
    for operation in operations(document):
        for status, response in operation["responses"].items():
            assert "X-Request-ID" in response["headers"]
            assert ("Retry-After" in response["headers"]) == (status == "503")
            tracks = operation["operationId"] == "track_frame"
            assert ("X-Session" in response["headers"]) == tracks
    for name in document["components"]["headers"]:
        assert f'"#/components/headers/{name}"' in json.dumps(document)
    assert client.get("/healthz").headers["x-request-id"]


def test_optional_fields_of_forms_are_optional_for_generators(document: dict[str, Any]) -> None:
    # openapi-typescript takes a field with a default for one that must be there.
    for name in ("FrameUpload", "TrackUpload", "VideoUpload", "DeepstackUpload"):
        schema = document["components"]["schemas"][name]
        for field, value in schema["properties"].items():
            assert "default" not in value, f"{name}.{field}"
            assert "anyOf" not in value, f"{name}.{field}"
    assert document["components"]["schemas"]["DeepstackUpload"]["required"] == ["image"]
    for value in document["components"]["schemas"]["CameraConfiguration"]["properties"].values():
        assert "default" not in value


def test_errors_are_documented_as_problems(document: dict[str, Any]) -> None:
    pose = document["paths"]["/pose"]["post"]["responses"]
    assert set(pose) == {"200", "400", "401", "403", "408", "413", "415", "422", "500", "503"}
    assert all("500" in operation["responses"] for operation in operations(document))
    for status in set(pose) - {"200"}:
        schema = pose[status]["content"]["application/problem+json"]["schema"]
        assert schema == {"$ref": "#/components/schemas/Problem"}
    assert "HTTPValidationError" not in document["components"]["schemas"]


def test_every_number_is_a_double(document: dict[str, Any]) -> None:
    # Without a format, a Go client rounds Unix time to 128 s.
    text = json.dumps(document)
    assert text.count('"type": "number"') == text.count('"format": "double"') > 50


def test_every_reference_has_a_target(document: dict[str, Any]) -> None:
    references = set(re.findall(r'"#/components/schemas/([^"]+)"', json.dumps(document)))
    assert references == set(document["components"]["schemas"])


def test_the_docs_page_loads_nothing_from_elsewhere(client: TestClient) -> None:
    page = client.get("/docs").text
    assert "http://" not in page
    assert "https://" not in page
    for asset in ("swagger-ui-bundle.js", "swagger-ui.css", "favicon.png"):
        assert f'"docs/assets/{asset}"' in page
        assert client.get(f"/docs/assets/{asset}").status_code == 200
