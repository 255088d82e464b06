"""Have a service track the people before a camera: an example of a client.

    python -m scripts watch-camera SOURCE CAMERA_ID [--url URL] [--fps 10] [--api-key KEY]

SOURCE is a video file, the number of a device (0) or the URL of a stream (rtsp://...). The newest
frame is posted whenever the service has answered the last one. Events are printed as they come, and
the people present every ten seconds. Needs OpenCV and the standard library.
"""

from __future__ import annotations

import argparse
import http.client
import json
import os
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote, urlencode, urlsplit

import cv2
import numpy as np
from numpy.typing import NDArray

STATUS_EVERY_S = 10.0
RECONNECT_AFTER_S = (1.0, 2.0, 5.0, 10.0)
RETRY_AFTER_S = 1.0
_TIMEOUT_S = 20.0


class Frame(NamedTuple):
    """How many frames came before it, seconds of the video or of this machine's clock, and BGR."""

    number: int
    timestamp: float
    pixels: NDArray[np.uint8]


class Source:
    """Reads frames in a thread of its own and keeps the newest alone."""

    def __init__(self, source: str) -> None:
        self._source = source
        self.is_file = Path(source).is_file()
        self._newest: Frame | None = None
        self._number = 0
        self._ended = False
        self._changed = threading.Condition()
        threading.Thread(target=self._read, daemon=True).start()

    def frames(self) -> Iterator[Frame]:
        """Yield the newest frame whenever there is one; ends with a file, never with a stream."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._newest is not None or self._ended)
                frame, self._newest = self._newest, None
            if frame is None:
                return
            yield frame

    def _read(self) -> None:
        attempt = 0
        while True:
            capture = self._open()
            before = self._number
            self._read_from(capture)
            capture.release()
            if self.is_file:
                break
            attempt = 0 if self._number > before else attempt + 1
            wait_s = RECONNECT_AFTER_S[min(attempt, len(RECONNECT_AFTER_S) - 1)]
            say(f"{self._source} gives no frame; trying again in {wait_s:g} s")
            time.sleep(wait_s)
        with self._changed:
            self._ended = True
            self._changed.notify()

    def _open(self) -> cv2.VideoCapture:
        if self._source.isdecimal():
            return cv2.VideoCapture(int(self._source))
        timeouts = (cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, 10_000, cv2.CAP_PROP_READ_TIMEOUT_MSEC, 10_000)
        return cv2.VideoCapture(self._source, cv2.CAP_FFMPEG, timeouts)

    def _read_from(self, capture: cv2.VideoCapture) -> None:
        interval_s = 1 / (capture.get(cv2.CAP_PROP_FPS) or 25.0)
        began = time.monotonic()
        while True:
            read, pixels = capture.read()
            if not read:
                return
            timestamp = time.monotonic()
            if self.is_file:
                # As fast as it was filmed.
                timestamp = self._number * interval_s
                time.sleep(max(0.0, began + timestamp - time.monotonic()))
            with self._changed:
                self._newest = Frame(self._number, timestamp, np.asarray(pixels, np.uint8))
                self._changed.notify()
            self._number += 1


class RefusedError(Exception):
    """The service refuses a frame; the message says why."""

    def __init__(self, status: int, detail: str, retry_after_s: float) -> None:
        super().__init__(detail)
        self.status, self.retry_after_s = status, retry_after_s


class Camera:
    """A camera session of a service."""

    def __init__(self, url: str, camera_id: str, api_key: str | None) -> None:
        parts = urlsplit(url)
        kind = (
            http.client.HTTPSConnection if parts.scheme == "https" else http.client.HTTPConnection
        )
        self._connection = kind(parts.netloc, timeout=_TIMEOUT_S)
        self._path = f"{parts.path.rstrip('/')}/cameras/{quote(camera_id, safe='')}"
        self._headers = {"X-API-Key": api_key} if api_key else {}

    def track(self, frame: Frame) -> tuple[bool, dict[str, Any]]:
        """Return whether the session is new, and the service's answer."""
        encoded = cv2.imencode(".jpg", frame.pixels, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()
        query = urlencode({"timestamp": f"{frame.timestamp:.4f}", "n": 1, "joints": "none"})
        headers, body = self._send("POST", f"{self._path}/frames?{query}", encoded)
        return headers["X-Session"] == "new", json.loads(body)

    def forget(self) -> None:
        """End the session."""
        try:
            self._send("DELETE", self._path)
        except RefusedError as refusal:
            if refusal.status != 404:
                raise

    def _send(
        self, method: str, path: str, body: bytes | None = None
    ) -> tuple[http.client.HTTPMessage, bytes]:
        headers = self._headers | ({"Content-Type": "image/jpeg"} if body else {})
        try:
            self._connection.request(method, path, body, headers)
            response = self._connection.getresponse()
            content = response.read()
        except BaseException:
            self._connection.close()  # The next request opens another one.
            raise
        if response.status < 300:
            return response.headers, content
        try:
            detail = json.loads(content)["detail"]
        except (ValueError, KeyError, TypeError):
            detail = response.reason
        after = response.headers.get("Retry-After", "")
        raise RefusedError(
            response.status, str(detail), float(after) if after.isdecimal() else RETRY_AFTER_S
        )


def watch(source: Source, camera: Camera, fps: float) -> None:
    """Post frames until a file ends, and print what happens; raise where none can be accepted."""
    answered = 0
    first, last_status = True, time.monotonic()
    for frame in source.frames():
        began = time.monotonic()
        try:
            is_new, answer = camera.track(frame)
        except (OSError, http.client.HTTPException) as error:
            say(f"the service does not answer ({error}); trying again in {RETRY_AFTER_S:g} s")
            time.sleep(RETRY_AFTER_S)
            continue
        except RefusedError as refusal:
            if refusal.status == 409:
                # The session has frames of an earlier run, by a clock that was ahead of this one.
                camera.forget()
            elif refusal.status in (408, 429, 502, 503, 504):
                say(f"{refusal}; trying again in {refusal.retry_after_s:g} s")
                time.sleep(refusal.retry_after_s)
            else:
                raise
            continue
        answered += 1
        if is_new and not first:
            say("the service had forgotten this camera: people are numbered anew")
        first = False
        if answer["reset"]:
            say(f"people are followed anew: {answer['reset']}")
        for event in answer["events"]:
            say(
                f"person {event['track_id']}: {event['event']} {event['state']} at "
                f"{event['timestamp']:.1f} s ({event['probability']:.0%})"
            )
        if time.monotonic() - last_status >= STATUS_EVERY_S:
            last_status = time.monotonic()
            say(f"{status(answer)}; {answered} of {frame.number + 1} frames")
        time.sleep(max(0.0, began + 1 / fps - time.monotonic()))
    say(f"the end: {answered} frames were answered")


def status(answer: dict[str, Any]) -> str:
    """Return who is there and how long the service took."""
    people = ", ".join(
        f"{person['track_id']} {(person['posture'] or {'label': 'unclear'})['label']}"
        for person in answer["persons"]
    )
    return f"{people or 'no people'}; {answer['timings_ms']['total']:.0f} ms"


def say(text: str) -> None:
    """Print a line with the time of day."""
    print(time.strftime("%H:%M:%S"), text, flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Watch as the command line asks."""
    parser = argparse.ArgumentParser(description="Post the frames of a camera to a service.")
    parser.add_argument("source", help="file, number of a device, or URL of a stream")
    parser.add_argument("camera_id", help="name of the camera for the service")
    parser.add_argument("--url", default="http://127.0.0.1:8000", help="of the service")
    parser.add_argument("--fps", type=float, default=10.0, help="frames a second at most")
    parser.add_argument("--api-key")
    options = parser.parse_args(arguments)
    source = str(options.source)
    if not (source.isdecimal() or "://" in source or Path(source).is_file()):
        parser.error(f"source: expected a file, a number or a URL, got {source}")
    # Streams over UDP lose parts of frames.
    os.environ.setdefault("OPENCV_FFMPEG_CAPTURE_OPTIONS", "rtsp_transport;tcp")
    camera = Camera(options.url, options.camera_id, options.api_key)
    try:
        watch(Source(source), camera, options.fps)
        camera.forget()
    except KeyboardInterrupt:
        say("stopped")
        # Else it forgets a camera that sends nothing by itself.
        with suppress(OSError, http.client.HTTPException, RefusedError):
            camera.forget()
    except RefusedError as refusal:
        print(f"watch-camera: the service refuses: {refusal}", file=sys.stderr)
        return 1
    return 0
