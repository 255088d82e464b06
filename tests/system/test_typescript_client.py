"""Types that openapi-typescript makes of the contract: they pass tsc --strict, and upload."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.conftest import ROOT, Photo, Server

pytestmark = pytest.mark.slow
SOURCES = Path(__file__).parent / "typescript"


def run(folder: Path, *command: str) -> str:
    """Run a program of Node.js in a folder; return what it writes."""
    ended = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, timeout=300
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The client, generated and compiled."""
    if shutil.which("npm") is None:
        pytest.skip("needs npm")
    copy = tmp_path_factory.mktemp("typescript") / "client"
    shutil.copytree(SOURCES, copy, ignore=shutil.ignore_patterns("node_modules"))
    installed = subprocess.run(
        ["npm", "install", "--no-audit", "--no-fund", "--no-package-lock"],
        cwd=copy,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    if installed.returncode != 0:
        pytest.skip(f"npm install failed: {installed.stderr.strip()[-200:]}")
    run(copy, "node", "generate.mjs", str(ROOT / "openapi.json"), "api.ts")
    run(copy, "npx", "--no-install", "tsc")
    return copy


def test_it_uploads_a_frame_and_reads_poses_problems_and_pictures(
    folder: Path, server: Server, photo: Photo
) -> None:
    (folder / "frame.png").write_bytes(photo.frame_png)
    (folder / "mask.png").write_bytes(photo.mask_png)
    said = json.loads(run(folder, "node", "client.js", server.url, "frame.png", "mask.png"))
    (entries,) = said["entries"]
    assert len(entries) == 3
    assert entries[0] == photo.entry
    assert said["x"] > 0
    assert said["field"] == "frame"
    assert said["picture"] > 1000


def test_optional_fields_are_optional_in_the_type(folder: Path) -> None:
    types = (folder / "api.ts").read_text()
    form = types.split("FrameUpload: {")[1].split("};")[0]
    for field in ("frame?: Blob;", "mask?: Blob;", "background?: Blob;", "boxes?: string;"):
        assert field in form
    assert "min_confidence?: number;" in types
