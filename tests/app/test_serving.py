"""The application while its index is loading, and when loading fails."""

import shutil
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from app import serving
from app.main import create_app
from app.photograph import Estimator
from app.settings import Settings
from tests.support.service import check_problem, eventually


def test_while_the_index_is_loading_clients_get_a_503(settings: Settings) -> None:
    app = create_app(settings)  # Without its lifespan nothing is loaded.
    response = TestClient(app).get("/readyz")
    check_problem(response, 503)
    assert int(response.headers["retry-after"]) >= 1
    app.state.runtime.loading = False
    assert "retry-after" not in TestClient(app).get("/readyz").headers


def test_one_of_several_processes_takes_requests_once_it_is_ready(settings: Settings) -> None:
    several = settings.model_copy(update={"workers": 2, "max_cameras": 0})
    with TestClient(create_app(several)) as client:
        assert client.get("/readyz").status_code == 200


def test_probes_report_any_error_in_loading(
    settings: Settings, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(*_: object) -> Estimator:
        raise ZeroDivisionError("internals")

    monkeypatch.setattr(serving, "load_estimator", fail)
    with TestClient(create_app(settings)) as client:
        eventually(lambda: "not ready" in caplog.text)
        assert client.get("/healthz").status_code == 200
        response = client.get("/readyz")
        assert response.status_code == 503
        assert "internals" not in response.text
        assert "ZeroDivisionError" in caplog.text


def test_a_corrupted_index_is_reported_and_not_served(index_path: Path, tmp_path: Path) -> None:
    corrupted = shutil.copytree(index_path, tmp_path / "index")
    vectors = corrupted / "descriptors.faiss.xz"
    vectors.write_bytes(vectors.read_bytes()[:-10])
    with TestClient(create_app(Settings(index=corrupted))) as client:
        eventually(lambda: "truncated" in check_problem(client.get("/readyz"), 503))
        check_problem(client.post("/pose", files={"frame": b"x"}), 503)
