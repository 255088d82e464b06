"""A setting that makes no sense ends the start with one sentence that names it."""

import socket
import sys

import pytest

from app import VERSION
from app.settings import Settings, SettingsError, read_settings
from tests.support.programs import output_of, run


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("POSE_MAX_PIXELS", "abc", "expected a whole number, got 'abc'"),
        ("pose_max_pixels", "abc", "expected a whole number, got 'abc'"),
        ("POSE_MAX_PIXELS", "1.5", "expected a whole number, got '1.5'"),
        ("POSE_CONCURRENCY", "0", "expected at least 1, got '0'"),
        ("POSE_REQUEST_TIMEOUT_S", "soon", "expected a number, got 'soon'"),
        ("POSE_REQUEST_TIMEOUT_S", "inf", "expected a finite number, got 'inf'"),
        ("POSE_LOG_LEVEL", "loud", "expected 'debug', 'info', 'warning' or 'error', got 'loud'"),
        ("POSE_API_KEYS", ",", "expected values separated by commas, got an empty one"),
        ("POSE_API_KEYS", "secret,", "expected values separated by commas, got an empty one"),
        ("POSE_API_KEYS", " ", "expected values separated by commas, got an empty one"),
        (
            "POSE_CORS_ORIGINS",
            "yard.example",
            "expected origins of scheme and host such as https://yard.example, got 'yard.example'",
        ),
        (
            "POSE_CORS_ORIGINS",
            "https://yard.example/",
            "expected origins of scheme and host such as https://yard.example, "
            "got 'https://yard.example/'",
        ),
        ("PORT", "abc", "expected a whole number, got 'abc'"),
        ("PORT", "99999", "expected at most 65535, got '99999'"),
        ("PORT", "0", "expected at least 1, got '0'"),
        ("WORKERS", "0", "expected at least 1, got '0'"),
        # Networks ship with the package.
        ("POSE_MODELS", "models", "expected one of the settings in docs/running.md"),
        ("POSE_TYPO", "3", "expected one of the settings in docs/running.md"),
    ],
)
def test_an_invalid_value_is_reported_in_one_sentence(
    monkeypatch: pytest.MonkeyPatch, name: str, value: str, said: str
) -> None:
    monkeypatch.setenv(name, value)
    with pytest.raises(SettingsError) as caught:
        read_settings()
    assert str(caught.value).startswith(f"{name}: {said}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("POSE_MAX_PIXEL", "POSE_MAX_PIXELS"),
        ("POSE_API_KEY", "POSE_API_KEYS"),
        ("POSE_PORT", "PORT"),
        ("POSE_HOST", "HOST"),
    ],
)
def test_a_misspelt_setting_is_refused_with_a_suggestion(
    monkeypatch: pytest.MonkeyPatch, written: str, meant: str
) -> None:
    monkeypatch.setenv(written, "8001")
    with pytest.raises(SettingsError, match=rf"^{written}: .*; did you mean {meant}\?$"):
        read_settings()


def test_kubernetes_service_variables_are_no_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POSE_SERVICE_HOST", "10.0.0.7")
    monkeypatch.setenv("POSE_SERVICE_PORT_HTTP", "8000")
    monkeypatch.setenv("POSE_PORT", "tcp://10.0.0.7:8000")
    monkeypatch.setenv("POSE_PORT_8000_TCP_ADDR", "10.0.0.7")
    assert read_settings() == Settings()


def test_milvus_needs_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("app.settings.find_spec", lambda name: None)
    monkeypatch.setenv("POSE_MILVUS", "http://milvus:19530")
    with pytest.raises(SettingsError, match="POSE_MILVUS: expected the extra milvus"):
        read_settings()


def test_valid_values_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {
        "HOST": "0.0.0.0",
        "PORT": "8080",
        "WORKERS": "2",
        "POSE_MAX_CAMERAS": "0",
        "POSE_API_KEYS": "first, second",
        "POSE_CORS_ORIGINS": "https://yard.example,http://127.0.0.1:8000",
        "POSE_MAX_PIXELS": "",  # As compose.yaml passes on what is not set.
    }.items():
        monkeypatch.setenv(name, value)
    settings = read_settings()
    assert (settings.host, settings.port, settings.workers) == ("0.0.0.0", 8080, 2)
    assert [key.get_secret_value() for key in settings.api_keys] == ["first", "second"]
    assert settings.cors_origins == ("https://yard.example", "http://127.0.0.1:8000")
    assert settings.max_pixels == Settings.model_fields["max_pixels"].default


def test_several_workers_keep_no_camera_sessions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WORKERS", "2")
    with pytest.raises(
        SettingsError, match=r"POSE_MAX_CAMERAS: expected 0 with WORKERS=2, .* got 64"
    ):
        read_settings()


def test_an_invalid_list_of_keys_reveals_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POSE_API_KEYS", "secret,,")
    with pytest.raises(SettingsError) as caught:
        read_settings()
    assert "secret" not in str(caught.value)
    assert caught.value.__context__ is None


def test_reading_settings_loads_no_native_library() -> None:
    code = "import sys, app.settings; print(*sys.modules)"
    loaded = output_of(sys.executable, "-c", code).split()
    assert {"ai_edge_litert", "cv2", "faiss", "numpy"}.isdisjoint(loaded)


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [(["--version"], 0, VERSION), (["--bogus"], 2, "unrecognized arguments: --bogus")],
)
def test_arguments_do_not_start_the_server(arguments: list[str], status: int, said: str) -> None:
    ended = run(sys.executable, "-m", "app", *arguments, PORT="99999")
    assert ended.returncode == status
    assert said in (ended.stderr if status else ended.stdout)


@pytest.mark.parametrize(("name", "value"), [("PORT", "99999"), ("HOST", "nowhere.invalid")])
def test_an_invalid_setting_ends_the_start_with_one_sentence(name: str, value: str) -> None:
    ended = run(sys.executable, "-m", "app", **{name: value})
    assert ended.returncode == 1
    assert ended.stdout == ""
    assert ended.stderr.startswith(f"{name}: expected ")
    assert ended.stderr.count("\n") == 1


@pytest.mark.parametrize("workers", ["1", "2"])
def test_a_port_in_use_ends_the_start_with_one_sentence(workers: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        settings = {"PORT": str(port), "WORKERS": workers, "POSE_MAX_CAMERAS": "0"}
        ended = run(sys.executable, "-m", "app", HOST="127.0.0.1", **settings)
    assert ended.returncode == 1
    assert ended.stderr == (
        f"PORT: expected a free port, got {port}, which another program uses on 127.0.0.1\n"
    )
