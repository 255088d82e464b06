"""A street video becomes lines of JSON, an annotated video and a contact sheet."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app.api.tracking_schemas import SequenceEnd, SequenceFrame
from scripts import track_video
from tests.conftest import ROOT
from tests.videos import numbered_frames, write_video

SHARED = Path(os.environ.get("SHARED", ROOT / ".." / "shared"))
STREET = SHARED / "real" / "vtest" / "vtest.avi"


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["track_video", *map(str, arguments)])
    return track_video.main()


def frames_of(video: Path) -> list[NDArray[np.uint8]]:
    capture, frames = cv2.VideoCapture(str(video)), []
    while (read := capture.read())[0]:
        frames.append(np.asarray(read[1], np.uint8))
    return frames


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if not STREET.exists():
        pytest.skip(f"needs {STREET}")
    capture = cv2.VideoCapture(str(STREET))
    frames = [np.asarray(capture.read()[1], np.uint8) for _ in range(8)]
    path = tmp_path_factory.mktemp("street") / "street.avi"
    write_video(path, frames)
    return path


def test_a_video_is_tracked_annotated_and_summarised(
    street: Path, index_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prefix, sheet = tmp_path / "out" / "street", tmp_path / "sheet.png"
    options = ("--stride", 2, "--max-frames", 3, "--index", index_path, "--sheet", sheet)
    assert run(monkeypatch, street, prefix, *options) == 0

    *lines, last = Path(f"{prefix}.ndjson").read_text().splitlines()
    frames = [SequenceFrame.model_validate_json(line) for line in lines]
    assert [frame.video_frame for frame in frames] == [0, 2, 4]
    assert all(person.pose for person in frames[0].persons)
    end = SequenceEnd.model_validate_json(last)
    assert end.reason == "max_frames"
    assert end.frames == 3
    tracks = {person.track_id for frame in frames for person in frame.persons}
    assert {track.track_id for track in end.tracks} == tracks
    assert len(tracks) >= 3

    drawn, filmed = frames_of(Path(f"{prefix}.mp4")), frames_of(street)
    assert len(drawn) == 3
    box = frames[0].persons[0].box
    rows = slice(int(box.y), int(box.y + box.height))
    columns = slice(int(box.x), int(box.x + box.width))
    changed = cv2.absdiff(drawn[0], filmed[0])
    assert changed[rows, columns].mean() > 5 * changed[500:, 500:].mean()
    picture = cv2.imread(str(sheet))
    assert picture is not None
    assert picture.shape == (300, 3 * track_video.CELL_PX, 3)


def test_what_is_no_video_is_told(
    index_path: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "notes.avi").write_bytes(b"no video")
    assert run(monkeypatch, tmp_path / "notes.avi", tmp_path / "out", "--index", index_path) == 1
    assert "expected a video that FFmpeg can read" in capsys.readouterr().err
    assert json.loads((tmp_path / "out.ndjson").read_text())["reason"] == "broken"


def test_a_short_sheet_is_filled_up() -> None:
    cells = numbered_frames(4)
    sheet = track_video.contact_sheet(cells)
    assert sheet.shape == (96, 192, 3)
    assert (sheet[48:, :64] == cells[3]).all()
    assert not sheet[48:, 64:].any()
