"""Small videos for tests."""

import os
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Literal

import av
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
Scan = Literal["prog", "tff", "bff"]
"""Whole pictures, or interlaced ones with the top or the bottom field first."""

_TICKS_S = 1000
# The others are yuv420p.
_PIXELS = {"mjpeg": "yuvj420p", "prores_ks": "yuv422p10le", "gif": "rgb8"}
_OPTIONS = {"libx265": {"x265-params": "log-level=none"}}


def write_video(
    path: Path,
    frames: Sequence[Picture],
    codec: str = "mjpeg",
    fps: float = 10.0,
    *,
    scan: Scan = "prog",
    times_s: Sequence[float] | None = None,
    quarter_turns: int = 0,
    options: Mapping[str, str] | None = None,
    container: Mapping[str, str] | None = None,
) -> bytes:
    """Write BGR frames of one size to a file and return its content.

    An interlaced video has a picture for each two frames, one of them in every other line.
    ``options`` are those of the codec.
    """
    if scan != "prog":
        frames = list(_woven(frames, scan))
    height, width = frames[0].shape[:2]
    with av.open(str(path), "w", options=dict(container or {})) as out:
        stream = out.add_stream(codec, rate=Fraction(fps), options=_OPTIONS.get(codec, {}))
        stream.options |= dict(options or {})
        stream.width, stream.height = width, height
        stream.pix_fmt = _PIXELS.get(codec, "yuv420p")
        stream.codec_context.bit_rate = 8_000_000
        stream.codec_context.thread_count = 1  # Others wait for one another in loops.
        tick_s = 1 / Fraction(fps) if times_s is None else Fraction(1, _TICKS_S)
        stream.codec_context.time_base = tick_s
        if quarter_turns:
            stream.set_display_rotation(90 * quarter_turns)
        for number, frame in enumerate(_flagged(frames, stream.pix_fmt, scan)):
            frame.time_base = tick_s
            frame.pts = number if times_s is None else round(times_s[number] / tick_s)
            out.mux(stream.encode(frame))
        out.mux(stream.encode())
    # SVT-AV1, run by root, makes the calling thread a realtime one, and all that this one begins.
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return path.read_bytes()


def with_display_matrix(video: bytes, matrix: NDArray[np.int64]) -> bytes:
    """An MP4 whose pictures are to be turned and mirrored: a row ``(x, y)`` becomes ``row @ m``."""
    place = video.index(b"tkhd") + 44  # In a box of version 0.
    affine = np.zeros((3, 3), ">i4")
    affine[:2, :2], affine[2, 2] = matrix << 16, 1 << 30
    return video[:place] + affine.tobytes() + video[place + 36 :]


def _woven(frames: Sequence[Picture], scan: Scan) -> Iterator[Picture]:
    for first, second in zip(frames[::2], frames[1::2], strict=True):
        woven = first.copy()
        late = 1 if scan == "tff" else 0
        woven[late::2] = second[late::2]
        yield woven


def _flagged(frames: Sequence[Picture], pixels: str, scan: Scan) -> Iterator[av.VideoFrame]:
    """Frames with a flag that says how they were scanned."""
    height, width = frames[0].shape[:2]
    graph = av.filter.Graph()
    source = graph.add_buffer(
        width=width, height=height, format=av.VideoFormat("bgr24"), time_base=Fraction(1, _TICKS_S)
    )
    steps = (graph.add("format", pixels), graph.add("setfield", scan), graph.add("buffersink"))
    graph.link_nodes(source, *steps).configure()
    for frame in frames:
        graph.vpush(av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), "bgr24"))
        yield graph.vpull()


def numbered_frames(count: int, height: int = 48, width: int = 64) -> list[Picture]:
    """Grey frames, each brighter than the one before it by 10."""
    return [np.full((height, width, 3), 10 * number, np.uint8) for number in range(count)]


def noisy_frames(count: int, height: int = 240, width: int = 320) -> list[Picture]:
    """Frames that no codec compresses."""
    rng = np.random.default_rng(count)
    return [rng.integers(0, 255, (height, width, 3), np.uint8) for _ in range(count)]
