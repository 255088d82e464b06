"""The program that decodes a video or a camera's stream, by FFmpeg (PyAV).

It writes a message for each frame as its maker meant it, with its BGR pixels, and another one at
the end.
"""

import argparse
import math
import os
import socket
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from itertools import groupby
from typing import IO, Any, BinaryIO
from urllib.parse import urlsplit, urlunsplit

import av

# PyAV imports these once a file has subtitles, when a confined process can import no more.
import av.subtitles.codeccontext
import av.subtitles.stream
import numpy as np
from av.filter import Graph
from av.stream import Disposition
from av.video.frame import VideoFrame
from av.video.reformatter import VideoReformatter
from av.video.stream import VideoStream
from numpy.typing import NDArray

from app.decoding import MIN_STEP_S, Frame
from app.decoding.confinement import confine, write_message
from app.vision.files import HEAD_BYTES, kind_of

_MIN_PIXEL_ASPECT = 0.25
# FFmpeg's messages. Containers other than MP4 and Matroska mark the last packet as corrupt.
_CUT_OFF = ("partial file", "File ended prematurely")
_NO_INDEX = "moov atom not found"
_UNFINISHED = "an MP4 or MOV whose index (moov) is missing: the file is incomplete"


class UnreadableError(ValueError):
    """A video, or the rest of it, cannot be read; the message says what was found."""


class TooLargeError(ValueError):
    """A frame has too many pixels; the message is its size."""


class Video:
    """A video that is open for decoding, on one thread; raises UnreadableError if it is none.

    The source is a path, an address or a file; ``options`` are FFmpeg's for opening it. An address
    may keep it waiting for ``timeout_s``.
    """

    def __init__(
        self,
        source: str | IO[bytes],
        options: dict[str, str] | None = None,
        timeout_s: float | None = None,
    ) -> None:
        av.logging.set_level(av.logging.ERROR)
        av.logging.set_skip_repeated(False)
        with av.logging.Capture() as messages:
            try:
                self._container = av.open(
                    source,
                    "r",
                    format=_format(source),
                    options=options or {},
                    timeout=timeout_s,
                    # Titles and names of cameras come in any encoding.
                    metadata_errors="replace",
                )
            except av.FFmpegError as error:
                unfinished = any(_NO_INDEX in text for *_, text in messages)
                found = _UNFINISHED if unfinished else _found(source)
                raise UnreadableError(found) from error
        streams = [one for one in self._container.streams.video if one.codec_context is not None]
        if not streams:
            raise UnreadableError("a file without pictures")
        self._source, self._stream = source, _main_stream(streams)
        self._stream.codec_context.thread_count = 1
        self._is_cut_off = _ended_early(messages)
        self._to_bgr = VideoReformatter()

    def close(self) -> None:
        """Close the source."""
        self._container.close()

    def frames(
        self, stride: int = 1, max_pixels: float = math.inf, interval_s: float = 0.0
    ) -> Iterator[Frame]:
        """Decode the video and yield every ``stride``-th frame, and at most one each interval.

        Raises UnreadableError if the video, or the rest of it, cannot be read, and TooLargeError if
        a frame has more than ``max_pixels``.
        """
        codec, count, due_s = self._stream.codec_context, 0, 0.0
        clock = Clock(float(self._stream.average_rate or 0))
        _check_size(codec.width, codec.height, max_pixels)
        pictures = self._pictures()
        # The fields of HEVC come one by one, as pictures of half the height.
        for picture in pictures if codec.name == "hevc" else _deinterlaced(pictures):
            timestamp, number, count = clock.timestamp(picture.time), count, count + 1
            if number % stride == 0 and timestamp + MIN_STEP_S >= due_s:
                due_s = max(due_s + interval_s, timestamp)
                _check_size(picture.width, picture.height, max_pixels)
                aspect, pixels = self._aspect(picture), self._upright(picture)
                yield Frame(number, timestamp, pixels, aspect, picture.opaque == [True])
        if self._is_cut_off:
            where = f"after {count} frames" if count else "before its first frame"
            raise UnreadableError(f"one that is cut off or damaged {where}")
        if not count:
            raise UnreadableError(_found(self._source))

    def _upright(self, picture: VideoFrame) -> NDArray[np.uint8]:
        """Return the pixels of a picture, BGR."""
        stored = self._to_bgr.reformat(picture, format="bgr24", threads=1)
        rows = np.frombuffer(memoryview(stored.planes[0]), np.uint8).reshape(stored.height, -1)
        pixels = rows[:, : 3 * stored.width].reshape(stored.height, stored.width, 3)
        return _shown(pixels, _display_matrix(picture))

    def _aspect(self, picture: VideoFrame) -> float:
        """Width over height of an upright pixel; 1 unless the file announces a plausible one."""
        aspect = float(self._stream.sample_aspect_ratio or 1)
        if not _MIN_PIXEL_ASPECT <= aspect <= 1 / _MIN_PIXEL_ASPECT:
            aspect = 1.0
        if picture.interlaced_frame:  # A field of HEVC.
            aspect /= 2
        return 1 / aspect if _is_transposed(_display_matrix(picture)) else aspect

    def _pictures(self) -> Iterator[VideoFrame]:
        """Yield pictures as stored; ``opaque`` holds whether they are damaged."""
        incomplete = failed = damaged = False
        with av.logging.Capture() as messages:
            try:
                for packet in self._container.demux(self._stream):
                    self._is_cut_off |= _ended_early(messages)
                    messages.clear()
                    if packet.size:
                        incomplete = packet.is_corrupt
                    pictures: list[VideoFrame] = []
                    try:
                        pictures = packet.decode()
                    except av.FFmpegError:
                        failed = True
                    failed |= packet.is_corrupt or bool(messages)
                    for picture in pictures:
                        # Damage lasts until a picture that builds on no other.
                        damaged &= not picture.key_frame
                        damaged |= failed or picture.is_corrupt
                        failed = False
                        # The deinterlacer passes `opaque` on. PyAV tells these objects apart by
                        # identity, so each picture gets a list of its own.
                        picture.opaque = [damaged]
                        yield picture
            except av.FFmpegError:
                incomplete = True
        self._is_cut_off |= incomplete or failed


def _ended_early(messages: list[tuple[int, str, str]]) -> bool:
    """Whether FFmpeg has said that the file ends before its container does."""
    return any(words in text for *_, text in messages for words in _CUT_OFF)


def _check_size(width: int, height: int, max_pixels: float) -> None:
    if width * height > max_pixels:
        raise TooLargeError(f"{width}x{height}")


def _head(source: str | IO[bytes]) -> bytes:
    """The first bytes of a file; none of an address."""
    if isinstance(source, str):
        return b""
    source.seek(0)
    head = source.read(HEAD_BYTES)
    source.seek(0)
    return head


def _found(source: str | IO[bytes]) -> str:
    """Name what is no video, or a broken one."""
    kind = kind_of(_head(source))
    return "a broken one" if kind == "a video" else kind


def _format(source: str | IO[bytes]) -> str | None:
    """A format that FFmpeg does not recognise: JPEGs between multipart boundaries."""
    return "mjpeg" if _head(source).lstrip().startswith(b"--") else None


def _main_stream(streams: list[VideoStream]) -> VideoStream:
    """The largest track: not a cover picture, which may lack its mark, nor a black one."""
    most = max(one.bit_rate or 0 for one in streams)

    def rank(stream: VideoStream) -> tuple[float, ...]:
        rate = stream.bit_rate or 0
        # Among tracks of one size, a track is empty if its bit rate is below this share of the
        # highest.
        return (
            not stream.disposition & Disposition.attached_pic,
            stream.frames != 1,
            stream.width * stream.height,
            rate >= 0.1 * most,
            bool(stream.disposition & Disposition.default),
            rate,
        )

    return max(streams, key=rank)


def _display_matrix(picture: VideoFrame) -> NDArray[np.int64]:
    """How a picture is to be turned and mirrored: a row ``(x, y)`` of it becomes ``row @ matrix``.

    The matrix ``(2, 2)`` has one number in each row and column that is not 0: 1 or -1.
    """
    stored: Any = picture.side_data.get("DISPLAYMATRIX")
    if stored is None:
        return np.eye(2, dtype=np.int64)
    matrix = np.frombuffer(bytes(stored), np.int32).reshape(3, 3)[:2, :2].astype(np.int64)
    straight, crossed = np.eye(2, dtype=bool), ~np.eye(2, dtype=bool)
    is_crossed = abs(matrix[crossed]).sum() > abs(matrix[straight]).sum()
    signs = np.where(matrix < 0, -1, 1)
    return signs * (crossed if is_crossed else straight)


def _is_transposed(matrix: NDArray[np.int64]) -> bool:
    return matrix[0, 0] == 0


def _shown(pixels: NDArray[np.uint8], matrix: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Turn and mirror pixels ``(H, W, 3)`` as a display matrix says."""
    if _is_transposed(matrix):
        pixels = pixels.transpose(1, 0, 2)
    across, down = matrix.sum(axis=0)
    return np.ascontiguousarray(pixels[::down, ::across])


def _deinterlaced(pictures: Iterable[VideoFrame]) -> Iterator[VideoFrame]:
    """Replace each interlaced picture by one of the moment of its first field."""
    # A filter takes pictures of one size and format.
    for _, alike in groupby(pictures, lambda one: (one.width, one.height, one.format.name)):
        graph = None
        for picture in alike:
            if graph is None and picture.interlaced_frame:
                graph = _deinterlacer(picture)
            if graph is None:
                yield picture
            else:
                graph.vpush(picture)
                yield from _filtered(graph)
        if graph is not None:
            graph.vpush(None)
            yield from _filtered(graph)


def _deinterlacer(picture: VideoFrame) -> Graph:
    """Make a filter of pictures like this one; those that are not interlaced pass unchanged."""
    graph = Graph()
    graph.threads = 1
    alike = {name: getattr(picture, name) for name in ("width", "height", "format", "time_base")}
    source = graph.add_buffer(**alike)
    bwdif = graph.add("bwdif", "mode=send_frame:deint=interlaced")
    graph.link_nodes(source, bwdif, graph.add("buffersink")).configure()
    return graph


def _filtered(graph: Graph) -> Iterator[VideoFrame]:
    """Take out the pictures that are ready."""
    with suppress(BlockingIOError, EOFError):
        while True:
            yield graph.vpull()


class Clock:
    """Ascending timestamps: the video's own or, where they do not ascend, from its frame rate."""

    def __init__(self, fps: float) -> None:
        # A higher frame rate is wrong.
        self._interval_s = 1 / (fps if 0 < fps <= 1000 else 25.0)
        self._began_s = 0.0
        self._last_s: float | None = None

    def timestamp(self, reported_s: float | None) -> float:
        """Seconds of a frame since the first one, given the time that the video states."""
        if self._last_s is None:
            self._began_s, self._last_s = reported_s or 0.0, 0.0
            return 0.0
        elapsed_s = -math.inf if reported_s is None else reported_s - self._began_s
        if self._last_s < elapsed_s < 1e9:
            self._last_s = max(elapsed_s, self._last_s + MIN_STEP_S)
        else:
            self._last_s += self._interval_s
        return self._last_s


# Playlists and image sequences are left out: they make FFmpeg open other files.
_FORMATS = (
    "mov,matroska,avi,mpegts,mpeg,mpegvideo,flv,ogg,asf,h264,hevc,m4v,ivf,mjpeg,jpeg_pipe,gif,dv"
)
_FILE_OPTIONS = {"format_whitelist": _FORMATS}
_STREAM_OPTIONS = {
    "rtsp_transport": "tcp",  # Streams over UDP lose parts of frames.
    "protocol_whitelist": "rtsp,rtsps,rtp,http,https,httpproxy,rtmp,tcp,tls,udp,srtp,crypto",
}
_PORTS = {"rtsp": 554, "rtsps": 322, "http": 80, "https": 443, "rtmp": 1935}
_STREAM_TIMEOUT_S = 10.0  # Longest time for which a stream may send nothing.


def main() -> None:
    """Write the frames of standard input, or of the stream whose address it holds."""
    parser = argparse.ArgumentParser(description="Decode a video for the service.")
    parser.add_argument("--stream", action="store_true", help="the address of a stream is given")
    parser.add_argument("--stride", type=int, default=1, help="take every n-th frame")
    parser.add_argument("--interval", type=float, default=0.0, help="least time between two frames")
    parser.add_argument("--max-pixels", type=int, required=True, help="of a frame")
    parser.add_argument("--max-seconds", type=int, required=True, help="of processor time")
    options = parser.parse_args()
    stdin = sys.stdin.buffer
    source: str | BinaryIO = os.fdopen(stdin.fileno(), "rb", buffering=0, closefd=False)
    opening = _FILE_OPTIONS
    if options.stream:
        # Not an argument, which other users of the machine see: it may hold a password.
        try:
            source, opening = reachable(stdin.readline().decode().rstrip("\n"), _STREAM_TIMEOUT_S)
        except (OSError, ValueError):  # Which may name a part of the address.
            sys.exit(1)
    os.nice(5)
    missing = confine(options.max_seconds, 640 * 1024**2, network=options.stream)
    if missing:
        print(f"a video is decoded without seccomp: {missing}", file=sys.stderr)
    with suppress(BrokenPipeError), os.fdopen(sys.stdout.fileno(), "wb", closefd=False) as out:
        wanted = options.stride, options.max_pixels, options.interval
        write_frames(source, wanted, out, opening)


def write_frames(
    source: str | BinaryIO,
    wanted: tuple[int, float, float],
    out: BinaryIO,
    opening: dict[str, str] = _FILE_OPTIONS,
) -> None:
    """Decode a file, or a stream by its address; ``wanted`` is what ``Video.frames`` takes.

    The message of a frame has ``width``, ``height``, and the other fields of
    :class:`app.decoding.Frame`. The last one has ``end``: null if the video is complete, what was
    found if not; and whether it is the size of a frame that ``is_too_large``.
    """
    end, is_too_large = None, False
    try:
        timeout_s = _STREAM_TIMEOUT_S if isinstance(source, str) else None
        for frame in Video(source, opening, timeout_s).frames(*wanted):
            fields = frame._asdict()
            height, width = fields.pop("pixels").shape[:2]
            write_message(out, {"width": width, "height": height, **fields}, frame.pixels.data)
    except (TooLargeError, UnreadableError) as error:
        end, is_too_large = str(error), isinstance(error, TooLargeError)
    write_message(out, {"end": end, "is_too_large": is_too_large})


def reachable(address: str, timeout_s: float) -> tuple[str, dict[str, str]]:
    """Return an address by the number at which its host answers, and FFmpeg's options for it.

    A process that can open no file cannot look up a name. Addresses of other kinds stay as they
    are. Raises OSError if the host does not answer, ValueError if this is no address.
    """
    parts = urlsplit(address)
    if parts.scheme not in _PORTS or not parts.hostname:
        return address, _STREAM_OPTIONS
    place = parts.hostname, parts.port or _PORTS[parts.scheme]
    with socket.create_connection(place, timeout_s) as connection:
        number = str(connection.getpeername()[0])
    user, _, named = parts.netloc.rpartition("@")
    host = f"[{number}]" if ":" in number else number
    numeric = parts._replace(netloc=f"{user}@"[not user :] + f"{host}:{place[1]}")
    options = _STREAM_OPTIONS
    if parts.scheme.startswith("http"):
        options = options | {"headers": f"Host: {named}\r\n"}
    return urlunsplit(numeric), options


if __name__ == "__main__":
    main()
