"""The program that decodes a video or a camera's stream.

It writes a message for each frame, with its BGR pixels, and another one at the end.
"""

import argparse
import os
import socket
import sys
from contextlib import suppress
from typing import BinaryIO
from urllib.parse import urlsplit, urlunsplit

from app.decoding.confinement import confine, write_message
from app.decoding.frames import TooLargeError, UnreadableError, Video

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
_MEMORY_BYTES = 640 * 1024**2
_NICENESS = 5


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
    os.nice(_NICENESS)
    missing = confine(options.max_seconds, _MEMORY_BYTES, network=options.stream)
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
