"""A street video becomes an annotated video."""

from itertools import islice
from pathlib import Path

import av
import cv2
import pytest

from app.decoding.video_program import Video
from scripts import track_video
from tests.conftest import SHARED
from tests.support.videos import Picture, write_video

STREET = SHARED / "real" / "vtest" / "vtest.avi"


def run(*arguments: object) -> None:
    track_video.main(list(map(str, arguments)))


def frames_of(video: Path) -> list[Picture]:
    return [frame.pixels for frame in Video(str(video)).frames()]


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if not STREET.exists():
        pytest.skip(f"needs {STREET}")
    frames = [frame.pixels for frame in islice(Video(str(STREET)).frames(), 8)]
    path = tmp_path_factory.mktemp("street") / "street.avi"
    write_video(path, frames)
    return path


def test_people_are_drawn_into_a_video(
    street: Path, index_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out" / "street.mp4"
    run(street, out, "--stride", 2, "--max-frames", 3, "--index", index_path)
    assert f"3 frames in {out}" in capsys.readouterr().out
    # What browsers play, and before the whole file is there.
    with av.open(str(out)) as written:
        assert written.streams.video[0].codec_context.name == "h264"
        assert written.streams.video[0].codec_context.pix_fmt == "yuv420p"
    content = out.read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")
    drawn, filmed = frames_of(out), frames_of(street)
    assert len(drawn) == 3
    changed = cv2.absdiff(drawn[0], filmed[0]).max(axis=-1) > 100
    assert changed[60:400].sum() > 1000  # Boxes, skeletons and words.
    assert not changed[500:, 500:].any()


def test_a_file_that_is_no_video_is_refused(index_path: Path, tmp_path: Path) -> None:
    (tmp_path / "notes.avi").write_bytes(b"no video")
    with pytest.raises(SystemExit, match="expected a video, got something else"):
        run(tmp_path / "notes.avi", tmp_path / "out.mp4", "--index", index_path)
