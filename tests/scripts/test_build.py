"""What a build would delete is refused before anything is read."""

from pathlib import Path

import pytest

from scripts import build

Files = dict[str, bytes]


def files_in(folder: Path) -> Files:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A folder with motion capture, garments, photographs, and a hidden folder beside them."""
    for name in (
        "mocap/manifest.csv", "mocap/bvh/walk.bvh", "garments/shirt.obj", "photographs/1.jpg",
        ".photographs-2024/1.jpg",
    ):  # fmt: skip
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(name)
    return tmp_path


def refusal(home: Path, monkeypatch: pytest.MonkeyPatch, *options: str) -> str:
    """Build in ``home``; return the sentence that refuses it, with every file where it was."""
    before = files_in(home)
    monkeypatch.chdir(home)
    monkeypatch.setattr(build, "build", lambda *_, **__: pytest.fail("it has begun"))
    with pytest.raises(ValueError, match="expected") as refused:
        build.main(["--mocap", "mocap", *options])
    assert files_in(home) == before
    return str(refused.value)


@pytest.mark.parametrize(
    ("out", "other"),
    [
        *((out, "--mocap") for out in ("mocap", "mocap/", "mocap/bvh", "mocap/new", ".", "x/..")),
        *((out, "--garments") for out in ("garments", "garments/index")),
    ],
)
def test_an_input_is_no_place_for_the_index(
    home: Path, monkeypatch: pytest.MonkeyPatch, out: str, other: str
) -> None:
    said = refusal(home, monkeypatch, "--out", out, "--garments", "garments")
    assert f"expected a folder apart from {other}" in said


def test_a_link_to_an_input_is_none_either(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (home / "link").symlink_to(home / "mocap")
    assert "apart from --mocap" in refusal(home, monkeypatch, "--out", "link")
