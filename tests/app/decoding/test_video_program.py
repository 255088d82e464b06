"""The program that decodes: what it writes, and what it cannot do."""

import io
import subprocess
import sys
from pathlib import Path

import av
import numpy as np
import pytest

from app.decoding.confinement import read_message
from app.decoding.video_program import write_frames
from tests.conftest import ROOT
from tests.support.videos import noisy_frames, numbered_frames, write_video


def decode(video: bytes, stride: int = 1, max_pixels: int = 10_000) -> list[dict[str, object]]:
    """The messages that the program writes, with the mean brightness of each frame."""
    out = io.BytesIO()
    write_frames(io.BytesIO(video), (stride, max_pixels, 0.0), out)
    out.seek(0)
    messages = []
    while message := read_message(out):
        head, data = message
        if "number" in head:
            assert len(data) == head["width"] * head["height"] * 3
            head["mean"] = int(np.frombuffer(data, np.uint8).mean().round(-1))
        messages.append(head)
    return messages


def ending(text: str | None, *, is_too_large: bool = False) -> dict[str, object]:
    return {"end": text, "is_too_large": is_too_large}


def test_every_nth_frame_is_written(tmp_path: Path) -> None:
    lines = decode(write_video(tmp_path / "v.avi", numbered_frames(8)), stride=3)
    size = {"width": 64, "height": 48, "pixel_aspect": 1.0, "damaged": False}
    assert lines == [
        *({"number": n, "timestamp": n / 10, "mean": 10 * n, **size} for n in (0, 3, 6)),
        ending(None),
    ]


def test_the_last_line_says_what_was_found(tmp_path: Path) -> None:
    video = write_video(tmp_path / "v.avi", noisy_frames(8))
    assert decode(b"?") == [ending("something else or a broken one")]
    cut_off = decode(video[: len(video) // 2], max_pixels=320 * 240)[-1]
    assert cut_off == ending("one that is cut off or damaged after 5 frames")
    assert decode(video, max_pixels=320 * 240 - 1) == [ending("320x240", is_too_large=True)]


def test_playlists_are_not_followed(tmp_path: Path) -> None:
    other = tmp_path / "other.avi"
    write_video(other, numbered_frames(3))
    playlist = f"ffconcat version 1.0\nfile {other}\n".encode()
    assert decode(playlist) == [ending("a playlist (ffconcat)")]


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (b"#EXTM3U\n#EXTINF:2,\none.ts\n", "a playlist (M3U)"),
        (b'<?xml version="1.0"?><MPD xmlns="urn">', "a playlist (DASH)"),
        (b"PK\x03\x04" + bytes(40), "a ZIP archive"),
        (bytes(257) + b"ustar" + bytes(300), "a tar archive"),
        (b"\x89PNG\r\n\x1a\n" + bytes(40), "a PNG image"),
        (b"RIFF\x40\0\0\0WEBPVP8X\x0a\0\0\0\2" + bytes(9) + b"ANIM", "an animated WebP image"),
    ],
)
def test_what_is_no_video_is_named(data: bytes, kind: str) -> None:
    assert decode(data) == [ending(kind)]


def with_subtitles(video: bytes, folder: Path) -> bytes:
    (folder / "v.srt").write_text("1\n00:00:00,000 --> 00:00:01,000\nhello\n")
    with (
        av.open(io.BytesIO(video)) as source,
        av.open(str(folder / "v.srt")) as subtitles,
        av.open(str(folder / "subtitles.mkv"), "w") as out,
    ):
        streams = (source.streams[0], subtitles.streams[0])
        copies = [out.add_stream_from_template(stream) for stream in streams]
        for container, copy in zip((source, subtitles), copies, strict=True):
            for packet in container.demux():
                if packet.size:
                    packet.stream = copy
                    out.mux(packet)
    return (folder / "subtitles.mkv").read_bytes()


def start(
    file: Path, code: str = "from app.decoding.video_program import main; main()"
) -> subprocess.Popen:
    """Run code in a process that has a video as its standard input."""
    command = [sys.executable, "-c", code, "--max-pixels", "400000", "--max-seconds", "20"]
    with file.open() as video:
        return subprocess.Popen(
            command, cwd=ROOT, stdin=video, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )


def test_it_decodes_within_its_confinement(tmp_path: Path) -> None:
    """Subtitles make PyAV import more of itself."""
    video = write_video(tmp_path / "v.mkv", numbered_frames(3))
    (tmp_path / "v.mkv").write_bytes(with_subtitles(video, tmp_path))
    with start(tmp_path / "v.mkv") as process:
        out, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (0, b"")
    assert out.count(b'"number"') == 3 and out.endswith(b'{"end": null, "is_too_large": false}')


ATTEMPTS = """
import os, signal, socket, subprocess
from app.decoding import confinement, video_program
def attempt(file, *_):
    for name, call in {
        "read a file": lambda: open("/etc/passwd"),
        "list a folder": lambda: os.listdir("/"),
        "connect": lambda: socket.socket(),
        "send": lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM),
        "talk to a local service": lambda: socket.socket(socket.AF_UNIX),
        "fork": os.fork,
        "run": lambda: os.execv("/bin/true", ["true"]),
        "end the service": lambda: os.kill(os.getppid(), 0),
        "delete": lambda: os.unlink("SOME_FILE"),
    }.items():
        try:
            call()
        except OSError:
            continue
        print(name)
    print("decoded", len(file.read(4)))
video_program.write_frames = attempt
video_program.main()
"""


@pytest.mark.skipif(sys.platform != "linux", reason="needs seccomp")
def test_code_of_a_hostile_file_can_reach_nothing(tmp_path: Path) -> None:
    file = tmp_path / "v"
    file.write_bytes(b"data")
    with start(file, ATTEMPTS.replace("SOME_FILE", str(file))) as process:
        out, errors = process.communicate(timeout=60)
    assert (out, errors) == (b"decoded 4\n", b"")
    assert file.exists()


NEED_NO_DESCRIPTOR = ('"fork"', '"run"', '"end the service"', '"delete"')


def test_without_seccomp_nothing_can_be_opened_either(tmp_path: Path) -> None:
    """Other systems, and kernels that refuse it, still have limits."""
    refused = "def refused(**_):\n    raise OSError('no seccomp')\n"
    refused += "confinement.forbid_system_calls = refused"
    code = ATTEMPTS.replace("video_program.main()", refused)
    lines = [
        line for line in code.splitlines() if not any(one in line for one in NEED_NO_DESCRIPTOR)
    ]
    file = tmp_path / "v"
    file.write_bytes(b"data")
    with start(file, "\n".join([*lines, "video_program.main()"])) as process:
        out, errors = process.communicate(timeout=60)
    assert b"without seccomp: no seccomp" in errors
    assert out == b"decoded 4\n"
