"""Videos of many kinds, whole, cut off and damaged, become the frames that their maker meant."""

import io
import re
from collections.abc import Callable
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.decoding import MIN_STEP_S, Frame
from app.decoding.video_program import Clock, TooLargeError, UnreadableError, Video
from tests.conftest import WALKERS
from tests.support.videos import Picture, Scan, numbered_frames, with_display_matrix, write_video

INTERLACED = {"flags": "+ildct+ilme"}
FAST = {"libvpx": {"deadline": "realtime"}, "libvpx-vp9": {"deadline": "realtime"}}


def pan(count: int = 8, height: int = 288, width: int = 360) -> list[Picture]:
    """Grey frames of a street over which the camera pans by eight pixels a frame."""
    street = cv2.cvtColor(np.asarray(cv2.imread(str(WALKERS)), np.uint8), cv2.COLOR_BGR2GRAY)
    # A field has no detail of a single line.
    grey = cv2.blur(cv2.resize(street, (width, height)), (1, 3))
    return [np.repeat(np.roll(grey, 8 * n, 1)[..., None], 3, 2) for n in range(count)]


def frames_of(video: bytes) -> list[Frame]:
    """The frames of a video, up to where it cannot be read."""
    frames: list[Frame] = []
    with suppress(UnreadableError):
        frames.extend(Video(io.BytesIO(video)).frames())
    return frames


def difference(got: Picture, expected: Picture) -> float:
    return float(np.abs(got.astype(float) - expected).mean())


@pytest.mark.parametrize(
    ("codec", "name", "scans"),
    [
        ("libx264", "v.ts", ("prog", "tff", "bff")),
        ("mpeg2video", "v.mpg", ("prog", "tff", "bff")),
        ("mpeg4", "v.avi", ("prog", "tff", "bff")),
        ("dvvideo", "v.dv", ("prog", "tff", "bff")),
        ("prores_ks", "v.mov", ("prog", "tff", "bff")),
        ("ffv1", "v.mkv", ("prog", "tff", "bff")),
        ("libx265", "v.mp4", ("prog",)),
        ("mjpeg", "v.avi", ("prog",)),
        ("libvpx", "v.webm", ("prog",)),
        ("libvpx-vp9", "v.webm", ("prog",)),
        ("libsvtav1", "v.mkv", ("prog",)),
    ],
)
def test_every_codec_shows_the_frames_without_interlacing(
    tmp_path: Path, codec: str, name: str, scans: tuple[Scan, ...]
) -> None:
    film = pan(8, 576, 720) if codec == "dvvideo" else pan()
    for scan in scans:
        options = FAST.get(codec, {}) if scan == "prog" else INTERLACED
        video = write_video(tmp_path / name, film, codec, 25, scan=scan, options=options)
        frames = frames_of(video)
        shown = film if scan == "prog" else film[::2]
        assert [round(frame.timestamp * 25) for frame in frames] == [*range(len(shown))]
        assert not any(frame.damaged for frame in frames)
        # Colours are rounded by up to 3; two moments in one picture differ by 6 at least.
        assert max(map(difference, (frame.pixels for frame in frames), shown)) < 4, scan


@pytest.mark.parametrize("across", [1, -1])
@pytest.mark.parametrize("down", [1, -1])
@pytest.mark.parametrize("crossed", [False, True])
def test_pictures_are_shown_as_the_display_matrix_says(
    tmp_path: Path, across: int, down: int, crossed: bool
) -> None:
    """Each pixel goes where the matrix sends it, relative to the middle."""
    matrix = np.array([[0, down], [across, 0]] if crossed else [[across, 0], [0, down]])
    stored = write_video(tmp_path / "v.mp4", pan(1), "libx264")
    (frame,) = frames_of(with_display_matrix(stored, matrix))
    rows, columns = np.indices(pan(1)[0].shape[:2])
    places = np.stack([columns, rows], axis=-1) - (np.array(rows.shape[::-1]) - 1) / 2
    places = places @ matrix + (np.array(frame.pixels.shape[1::-1]) - 1) / 2
    there = places.round().astype(int)
    assert difference(frame.pixels[there[..., 1], there[..., 0]], pan(1)[0]) < 4


@pytest.mark.parametrize("first", ["black", "small", "one frame"])
def test_the_main_track_is_shown(tmp_path: Path, first: str) -> None:
    film = pan(6)
    other = {
        "black": [0 * frame for frame in film],
        "small": [frame[:48, :80] for frame in film],
        "one frame": film[:1],
    }[first]
    tracks = [
        write_video(tmp_path / f"{n}.mp4", one, "libx264") for n, one in enumerate((other, film))
    ]
    with av.open(str(tmp_path / "v.mp4"), "w") as out:
        sources = [av.open(io.BytesIO(track)) for track in tracks]
        copies = [out.add_stream_from_template(source.streams.video[0]) for source in sources]
        for source, copy in zip(sources, copies, strict=True):
            for packet in source.demux():
                if packet.size:
                    packet.stream = copy
                    out.mux(packet)
    frames = frames_of((tmp_path / "v.mp4").read_bytes())
    assert len(frames) == 6
    assert max(map(difference, (frame.pixels for frame in frames), film)) < 4


@pytest.mark.parametrize("start", [b"", b"\r\n"])
@pytest.mark.parametrize("length", [False, True])
def test_jpegs_between_boundaries_are_a_video(start: bytes, length: bool) -> None:
    parts = b""
    for frame in pan(4):
        jpeg = cv2.imencode(".jpg", frame)[1].tobytes()
        said = f"Content-Length: {len(jpeg)}\r\n".encode() if length else b""
        parts += b"--frame\r\nContent-Type: image/jpeg\r\n" + said + b"\r\n" + jpeg + b"\r\n"
    frames = frames_of(start + parts + b"--frame--\r\n")
    assert len(frames) == 4
    assert max(map(difference, (frame.pixels for frame in frames), pan(4))) < 4


@pytest.mark.parametrize(
    ("pixels", "full_range", "black", "white"),
    [("yuv420p", True, 0, 255), ("yuv420p", False, 16, 235), ("yuv420p10le", False, 64, 940)],
)
def test_black_and_white_are_those_of_the_video(
    tmp_path: Path, pixels: str, full_range: bool, black: int, white: int
) -> None:
    grey = 128 if white < 256 else 512
    planes = np.full((96, 64), grey, np.uint8 if white < 256 else np.uint16)
    planes[:64] = np.where(np.arange(64) < 32, black, white)
    picture = av.VideoFrame.from_ndarray(planes, pixels)
    picture.color_range = 2 if full_range else 1
    with av.open(str(tmp_path / "v.mkv"), "w") as out:
        stream = out.add_stream("ffv1", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 64, pixels
        stream.codec_context.color_range = picture.color_range
        out.mux([*stream.encode(picture), *stream.encode()])
    (frame,) = frames_of((tmp_path / "v.mkv").read_bytes())
    assert frame.pixels[32, [0, 63]].tolist() == [[0] * 3, [255] * 3]


@pytest.mark.parametrize("name", ["v.avi", "v.mkv", "v.mp4"])
def test_times_are_those_of_the_video(tmp_path: Path, name: str) -> None:
    times_s = [0.0, 0.1, 0.2, 0.9, 1.0, 1.5]
    video = write_video(tmp_path / name, pan(6), "mpeg4", times_s=times_s)
    assert [frame.timestamp for frame in frames_of(video)] == pytest.approx(times_s)


def without_the_first(video: bytes, path: Path, cut_s: float) -> bytes:
    """Copy a video without what comes before a time."""
    with av.open(io.BytesIO(video)) as source, av.open(str(path), "w") as out:
        pictures = source.streams.video[0]
        copy = out.add_stream_from_template(pictures)
        for packet in source.demux(pictures):
            if packet.dts is not None:
                packet.pts -= round(cut_s / packet.time_base)
                packet.dts -= round(cut_s / packet.time_base)
                packet.stream = copy
                out.mux(packet)
    return path.read_bytes()


def test_what_an_edit_list_hides_is_not_shown(tmp_path: Path) -> None:
    whole = write_video(tmp_path / "v.mp4", numbered_frames(12), "libx264")
    frames = list(Video(io.BytesIO(without_the_first(whole, tmp_path / "cut.mp4", 0.5))).frames())
    assert [frame.pixels.mean().round(-1) for frame in frames] == [*range(50, 120, 10)]
    assert frames[0].timestamp == 0


@pytest.mark.parametrize("data", [b"", b"?", b"RIFF\xff\xff\xff\xffAVI LIST", b"\x00" * 5000])
def test_other_bytes_are_not_a_video(data: bytes) -> None:
    with pytest.raises(UnreadableError, match="something else or a broken one"):
        next(Video(io.BytesIO(data)).frames())


def test_frames_of_too_many_pixels_are_not_decoded(tmp_path: Path) -> None:
    video = write_video(tmp_path / "v.avi", numbered_frames(3))
    assert len(list(Video(io.BytesIO(video)).frames(max_pixels=48 * 64))) == 3
    with pytest.raises(TooLargeError, match="64x48"):
        next(Video(io.BytesIO(video)).frames(max_pixels=48 * 64 - 1))


def cut_off(video: bytes, tenth: int) -> str:
    """What is found in a video of which the rest is missing."""
    with pytest.raises(UnreadableError) as raised:
        list(Video(io.BytesIO(video[: len(video) * tenth // 11])).frames())
    return str(raised.value)


@pytest.mark.parametrize(
    ("name", "codec", "container"),
    [
        ("v.avi", "mjpeg", ""),
        ("v.mkv", "libx264", ""),
        ("v.webm", "libvpx", ""),
        ("v.flv", "libx264", ""),
        ("v.mp4", "libx264", "faststart"),
        ("v.mp4", "libx264", "frag_keyframe+empty_moov"),
        ("v.mov", "prores_ks", "faststart"),
    ],
)
def test_a_video_that_is_cut_off_says_so(
    tmp_path: Path, name: str, codec: str, container: str
) -> None:
    flags = {"movflags": container} if container else {}
    video = write_video(tmp_path / name, pan(12), codec, options=FAST.get(codec), container=flags)
    assert len(list(Video(io.BytesIO(video)).frames())) == 12
    found = [cut_off(video, tenth) for tenth in range(1, 11)]
    places = [re.fullmatch(r"one that is cut off or damaged (\D+)(\d*).*", one) for one in found]
    assert {place and place[1] for place in places} <= {"after ", "before its first frame"}, found
    counts = [int(place[2] or 0) for place in places if place]
    assert counts == sorted(counts) and 12 > counts[-1] > counts[0]


def test_an_mp4_without_its_index_says_so(tmp_path: Path) -> None:
    video = write_video(tmp_path / "v.mp4", pan(12), "libx264")
    assert {cut_off(video, tenth) for tenth in range(1, 11)} == {
        "an MP4 or MOV whose index (moov) is missing: the file is incomplete"
    }


def flipped(video: bytes, seed: int) -> bytes:
    """Flip eight bits, none of them in the first twentieth, where headers are."""
    rng, data = np.random.default_rng(seed), np.frombuffer(video, np.uint8).copy()
    data[rng.integers(len(data) // 20, len(data), 8)] ^= np.uint8(1) << rng.integers(
        8, size=8, dtype=np.uint8
    )
    return data.tobytes()


def thinned(video: bytes, seed: int) -> bytes:
    """Lose a twentieth of the packets of a transport stream, none of the first ten."""
    packets = np.frombuffer(video, np.uint8).reshape(-1, 188)
    kept = np.random.default_rng(seed).random(len(packets)) > 0.05
    kept[:10] = True
    return packets[kept].tobytes()


@pytest.mark.parametrize(
    ("codec", "name", "damage"),
    [
        ("libx264", "v.mp4", flipped),
        ("mpeg4", "v.mp4", flipped),
        ("ffv1", "v.mkv", flipped),
        ("libx264", "v.ts", thinned),
        ("mpeg2video", "v.ts", thinned),
    ],
)
def test_frames_that_look_wrong_are_damaged(
    tmp_path: Path, codec: str, name: str, damage: Callable[[bytes, int], bytes]
) -> None:
    video = write_video(tmp_path / name, pan(24), codec)
    whole = {round(frame.timestamp, 3): frame.pixels for frame in frames_of(video)}
    wrong = [
        frame.damaged
        for seed in range(4)
        for frame in frames_of(damage(video, seed))
        if (expected := whole.get(round(frame.timestamp, 3))) is None
        or difference(frame.pixels, expected) > 2
    ]
    # A flipped bit is not always an error to the codec.
    assert len(wrong) > 10 and np.mean(wrong) > 0.8


def test_damage_ends_with_a_picture_that_builds_on_no_other(tmp_path: Path) -> None:
    video = write_video(tmp_path / "v.ts", pan(24), "libx264", options={"g": "8", "bf": "0"})
    packets = np.frombuffer(video, np.uint8).reshape(-1, 188)
    lost = np.delete(packets, len(packets) // 2, axis=0).tobytes()
    damaged = "".join("!" if frame.damaged else "." for frame in frames_of(lost))
    assert re.fullmatch(r"\.{7,}!{1,9}\.{8}", damaged), damaged


@given(st.lists(st.none() | st.floats(allow_nan=False), min_size=1), st.floats(-1, 2000))
def test_timestamps_always_ascend(reported: list[float | None], fps: float) -> None:
    clock = Clock(fps)
    times = [clock.timestamp(one) for one in reported]
    assert times[0] == 0
    assert all(second >= first + MIN_STEP_S * (1 - 1e-6) for first, second in pairwise(times))


@pytest.mark.parametrize("interval_s", [0.0, 0.1, 0.25, 1.0])
def test_frames_come_at_most_once_an_interval(tmp_path: Path, interval_s: float) -> None:
    write_video(tmp_path / "v.avi", numbered_frames(25), fps=10)
    times = [one.timestamp for one in Video(str(tmp_path / "v.avi")).frames(interval_s=interval_s)]
    assert times[0] == 0
    wanted = 25 if interval_s <= 0.1 else 2.5 / interval_s
    assert len(times) == pytest.approx(wanted, abs=1)
    assert all(later - one >= interval_s - 0.11 for one, later in pairwise(times))
