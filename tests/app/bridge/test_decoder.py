"""What the process that decodes a source writes; a hostile stream may have taken it over."""

import os
import threading
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from app.bridge import decoder as module
from app.bridge.decoder import Decoder
from app.video.frames import UnreadableError
from tests.support.videos import numbered_frames, write_video


def read(written: bytes, *, ends: bool = True) -> list[tuple[float, NDArray[np.uint8]]]:
    """The frames of what a decoder has written."""
    ours, theirs = os.pipe()

    def write() -> None:
        os.write(theirs, written)
        if ends:
            os.close(theirs)

    decoder = object.__new__(Decoder)
    decoder._out = ours
    thread = threading.Thread(target=write)
    thread.start()
    try:
        return list(decoder.frames())
    finally:
        thread.join()
        os.close(ours)


@pytest.mark.parametrize(
    ("written", "said"),
    [
        (b"", "gave up"),
        (b"x" * 1000, "does not describe"),
        *((line + b"\n", "does not describe") for line in (
            b"{", b"[]", b"7", b"\xff", b'{"timestamp": "soon", "width": 1, "height": 1}')),
        *((b'{"timestamp": %s, "width": %s, "height": %s}\n' % values, "too large") for values in (
            (b"0", b"-1", b"-1"), (b"0", b"0", b"9"), (b"0", b"1e3", b"9"), (b"NaN", b"1", b"1"),
            (b"0", b"true", b"1"), (b"0", b"99999", b"99999"), (b"Infinity", b"1", b"1"))),
        (b'{"width": 9}\n', "too large"),
        (b'{"timestamp": 0, "width": 2, "height": 1}\nabc', "gave up"),
        (b'{"end": "a ZIP archive"}\n', "a ZIP archive"),
    ],
)  # fmt: skip
def test_what_no_decoder_writes_is_an_error(written: bytes, said: str) -> None:
    with pytest.raises(UnreadableError, match=said):
        read(written)


def test_a_decoder_that_hangs_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_SILENT_S", 0.1)
    with pytest.raises(UnreadableError, match=r"no frame within 0\.1 seconds"):
        read(b'{"timestamp"', ends=False)


def test_frames_of_a_file_come_at_the_rate_that_is_wanted(tmp_path: Path) -> None:
    write_video(tmp_path / "v.avi", numbered_frames(8), fps=10)
    decoder = Decoder(tmp_path / "v.avi", interval_s=0.2)
    frames = list(decoder.frames())
    decoder.close()
    assert [round(time, 2) for time, _ in frames] == [0.0, 0.2, 0.4, 0.6]
    assert [round(float(pixels.mean()), -1) for _, pixels in frames] == [0, 20, 40, 60]
