"""Files of cameras: one sentence that names line and field for each mistake, and no password."""

from pathlib import Path

import pytest

from app.bridge.settings import Settings, SettingsError, read_file
from app.configuration import CameraConfiguration
from app.serving import read_cameras
from tests.conftest import ROOT

TEXT = """\
api_key: 00s3cret
webhook: http://user:s3cret@hook/a
cameras:
  yard: &first
    source: rtsp://admin:s3cret@10.0.0.1/s3cret
    name: Back yard
    fov_deg: 72
    zones:
      - {name: bed, kind: rest, polygon: [[210, 300], [420, 290], [440, 470]]}
  hall: {<<: *first, source: 0}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "cameras.yaml").write_text(TEXT)
    return tmp_path / "cameras.yaml"


def test_a_camera_has_what_the_services_file_of_cameras_has(file: Path) -> None:
    settings = read_file(file)
    yard, hall = settings.cameras["yard"], settings.cameras["hall"]
    assert (hall.source, hall.name, hall.fps, hall.zones) == ("0", "Back yard", 10, yard.zones)
    assert yard.configuration == yard.model_dump(include={"zones", "fov_deg"})
    json = CameraConfiguration.model_validate(yard.configuration).model_dump_json()
    file.with_suffix(".json").write_text(f'{{"yard": {json}}}')
    assert read_cameras(file.with_suffix(".json"))["yard"].zones == yard.zones
    file.write_text("cameras: {yard: {source: 0}}")
    assert read_file(file).cameras["yard"].configuration is None  # The service knows it.


def test_cameras_differ_where_their_settings_or_those_of_all_do(file: Path) -> None:
    def settings(text: str) -> Settings:
        file.write_text(text)
        return read_file(file)

    before = settings(TEXT)
    assert settings(f"# new\n{TEXT}").of("yard") == before.of("yard")
    changed = settings(TEXT.replace("source: 0", "source: 1"))
    assert changed.of("yard") == before.of("yard")
    assert changed.of("hall") != before.of("hall")
    assert settings(f"mqtt: mqtt://broker\n{TEXT}").of("yard") != before.of("yard")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("kind: rest", "kind: sleep", "line 9: cameras.yard.zones[0].kind: expected 'rest' or"),
        ("zones:", "zone:", "line 8: cameras.yard.zone: expected one of the fields zones, "),
        ("cameras:", "camera:", "line 3: camera: expected one of the fields url, "),
        ("source: 0", "source: x@no.avi", "line 10: cameras.hall.source: expected a file, a num"),
        ("source: 0", "fps: 0", "line 10: cameras.hall.fps: expected more than 0.0, got 0"),
        ("fov_deg: 72", "fov_deg: wide", "line 7: cameras.yard.fov_deg: expected a number, got 'w"),
        (
            "72",
            "72\n\t",
            "line 8: expected YAML: found character '\\t' that cannot start any token",
        ),
        ("hall:", "yard:", "line 4: expected YAML: yard is there twice"),
        ("hall:", "back hall:", "line 10: cameras.back hall: expected text of the form ^["),
        ("{<<: *first, source: 0}", "rtsp://u:s3cret@h", "line 10: cameras.hall: expected fields"),
        ("http://user", "ftp://user", "line 2: webhook[0]: expected http://HOST[:PORT] or https"),
        ("00s3cret", "[s3cret]", "line 1: api_key: expected text"),
        ("cameras:", "mqtt: s3cret@x\ncameras:", "line 3: mqtt: expected mqtt://HOST[:PORT] or m"),
        (TEXT, "", "line 1: cameras: expected a value, got none"),
        (TEXT, "yard", ": expected fields such as cameras, got none"),
        (TEXT, "cameras: {}", "line 1: cameras: expected at least 1 values, got 0"),
        (TEXT, "a: &a [*a]", ": expected a text of YAML, got something else"),
        (TEXT, "\0", ": expected a text of YAML, got something else"),
    ],
)
def test_a_mistake_is_one_sentence(old: str, new: str, expected: str, file: Path) -> None:
    file.write_text(TEXT.replace(old, new))
    with pytest.raises(SettingsError) as error:
        read_file(file)
    assert expected in str(error.value)
    assert str(error.value).startswith(str(file))
    assert "\n" not in str(error.value) and "s3cret" not in str(error.value)


def test_the_environment_has_what_a_file_leaves_out(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WATCH_URL", "http://pose:8000")
    monkeypatch.setenv("WATCH_API_KEY", "other")
    settings = read_file(file)
    assert settings.url.hostname == "pose"
    assert settings.api_key is not None and settings.api_key.get_secret_value() == "00s3cret"
    monkeypatch.setenv("WATCH_MQTT", "broker")
    with pytest.raises(SettingsError, match=r"^WATCH_MQTT: expected mqtt://"):
        read_file(file)


def test_the_documented_file_is_one(file: Path) -> None:
    text = (ROOT / "docs" / "connecting.md").read_text()
    file.write_text(text.split("```yaml\n# cameras.yaml\n")[1].split("```")[0])
    assert {"yard", "ward"} <= read_file(file).cameras.keys()
