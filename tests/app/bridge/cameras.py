"""Cameras that stream over RTSP and HTTP, for each client from the beginning."""

import io
import itertools
import socket
import struct
import threading
import time
from contextlib import suppress
from typing import ClassVar

import av
import cv2

from tests.support.videos import noisy_frames

_FPS = 25
_PACKET = 7 * 188  # Bytes of an MPEG transport stream in a packet of RTP.


class _Camera:
    """Listens on a port of this machine; the context is its address, by the name of the host."""

    scheme = ""

    def __enter__(self) -> str:
        self._server = socket.create_server(("127.0.0.1", 0))
        threading.Thread(target=self._accept, daemon=True).start()
        return f"{self.scheme}://me:pass@localhost:{self._server.getsockname()[1]}/stream"

    def __exit__(self, *_: object) -> None:
        self._server.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                client, _ = self._server.accept()
                threading.Thread(target=self._serve_client, args=(client,), daemon=True).start()

    def _serve_client(self, client: socket.socket) -> None:
        with suppress(OSError, ValueError), client, client.makefile("rb") as file:
            while head := _head(file):
                self.answer(client, head)

    def answer(self, client: socket.socket, head: list[str]) -> None:
        raise NotImplementedError


def _head(file: io.BufferedReader) -> list[str]:
    """The lines of a request's head."""
    lines = []
    while line := file.readline().strip():
        lines.append(line.decode())
    return lines


class MjpegCamera(_Camera):
    """JPEGs between boundaries, without end."""

    scheme = "http"

    def answer(self, client: socket.socket, head: list[str]) -> None:
        assert any(line.startswith("Host: localhost:") for line in head)
        kind = "multipart/x-mixed-replace; boundary=frame"
        client.sendall(f"HTTP/1.1 200 OK\r\nContent-Type: {kind}\r\n\r\n".encode())
        pictures = [cv2.imencode(".jpg", one)[1].tobytes() for one in noisy_frames(5)]
        for number in itertools.count():
            part = b"--frame\r\nContent-Type: image/jpeg\r\n\r\n"
            client.sendall(part + pictures[number % len(pictures)] + b"\r\n")
            time.sleep(1 / _FPS)


class RtspCamera(_Camera):
    """An MPEG transport stream in RTP, in the connection of RTSP."""

    scheme = "rtsp"
    _ANSWERS: ClassVar = {
        "OPTIONS": ("Public: DESCRIBE, SETUP, PLAY", ""),
        "DESCRIBE": (
            "Content-Type: application/sdp",
            "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=yard\r\nt=0 0\r\nm=video 0 RTP/AVP 33\r\n"
            "a=control:video\r\n",
        ),
        "SETUP": ("Session: 1\r\nTransport: RTP/AVP/TCP;unicast;interleaved=0-1", ""),
        "PLAY": ("Session: 1", ""),
    }

    def answer(self, client: socket.socket, head: list[str]) -> None:
        method = head[0].split()[0]
        fields, body = self._ANSWERS.get(method, ("Session: 1", ""))
        (number,) = (line for line in head if line.startswith("CSeq:"))
        lines = ("RTSP/1.0 200 OK", number, fields, f"Content-Length: {len(body)}", "", body)
        client.sendall("\r\n".join(lines).encode())
        if method == "PLAY":
            film = _transport_stream()
            for begin in range(0, len(film), _PACKET):
                head_of_packet = struct.pack(">BBHII", 0x80, 33, begin // _PACKET % 2**16, 0, 7)
                packet = head_of_packet + film[begin : begin + _PACKET]
                client.sendall(b"$\0" + struct.pack(">H", len(packet)) + packet)
                time.sleep(0.01)


def _transport_stream() -> bytes:
    """Some seconds of MPEG-2."""
    out = io.BytesIO()
    with av.open(out, "w", format="mpegts") as container:
        stream = container.add_stream("mpeg2video", rate=_FPS)
        frames = [*noisy_frames(100)]
        stream.height, stream.width = frames[0].shape[:2]
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="bgr24")))
        container.mux(stream.encode())
    return out.getvalue()
