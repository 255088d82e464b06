"""Types that openapi-typescript makes of the contract: they pass tsc --strict, and upload."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.conftest import ROOT, Photo, Server
from tests.support.programs import output_of, run

pytestmark = pytest.mark.slow
SOURCES = Path(__file__).parent / "typescript"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The client, generated and compiled."""
    if shutil.which("npm") is None:
        pytest.skip("needs npm")
    copy = tmp_path_factory.mktemp("typescript") / "client"
    shutil.copytree(SOURCES, copy, ignore=shutil.ignore_patterns("node_modules"))
    installed = run("npm", "install", "--no-audit", "--no-fund", "--no-package-lock", cwd=copy)
    if installed.returncode != 0:
        pytest.skip(f"npm install failed: {installed.stderr.strip()[-200:]}")
    output_of("node", "generate.mjs", ROOT / "openapi.json", "api.ts", cwd=copy)
    output_of("npx", "--no-install", "tsc", cwd=copy)
    return copy


def test_it_uploads_a_frame_and_reads_poses_problems_and_pictures(
    folder: Path, server: Server, photo: Photo
) -> None:
    (folder / "frame.png").write_bytes(photo.frame_png)
    (folder / "mask.png").write_bytes(photo.mask_png)
    command = ("node", "client.js", server.url, "frame.png", "mask.png")
    said = json.loads(output_of(*command, cwd=folder))
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
