"""Commands that write refuse to write over what they read."""

import importlib
from pathlib import Path

import pytest

from scripts.__main__ import COMMANDS
from scripts.helpers import check_outputs
from tests.conftest import WALKERS


def test_an_input_is_no_output(tmp_path: Path) -> None:
    check_outputs((tmp_path / "a", None), (tmp_path / "b", None))
    (tmp_path / "link").symlink_to(tmp_path / "b")
    for output in (tmp_path / "b", tmp_path / "x" / ".." / "b", tmp_path / "link"):
        with pytest.raises(ValueError, match="expected another place"):
            check_outputs((None, output), (tmp_path / "b",))


@pytest.mark.parametrize(
    ("command", "name", "options"),
    [
        ("track-video", "film.avi", ["film.avi"]),
        ("debug-frame", "person-1.png", ["--out", "."]),
    ],
)
def test_the_input_survives(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    command: str,
    name: str,
    options: list[str],
) -> None:
    content = WALKERS.read_bytes()
    (tmp_path / name).write_bytes(content)
    monkeypatch.chdir(tmp_path)
    module = importlib.import_module(COMMANDS[command][0])
    with pytest.raises(ValueError, match="expected another place"):
        module.main([name, *options])
    assert (tmp_path / name).read_bytes() == content
