"""Watch a camera: frames to a service, its events to a webhook and to MQTT.

    silhouette-pose-watch SOURCE CAMERA_ID [--url URL] [--fps 10] [--api-key KEY]
        [--webhook URL] [--mqtt mqtt://user:password@host] [--queue FILE]

SOURCE is a video file, the number of a device (0) or the URL of a stream (rtsp://...). The newest
frame is posted whenever the service has answered the last one. Each event is printed as a line of
JSON, and delivered to each receiver: it waits, with ``--queue`` even through a restart of this
program, until it is taken. A receiver that gets an event twice, because an acknowledgement was
lost, recognises it by its ``id``. Everything else is printed to standard error.
"""

import argparse
import contextlib
import math
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import NoReturn
from urllib.parse import SplitResult, urlsplit

from app.bridge import RefusedError, printable, say
from app.bridge.bridge import Bridge
from app.bridge.home_assistant import HomeAssistant
from app.bridge.outbox import Outbox, deliver
from app.bridge.source import Source
from app.bridge.web import Camera, Webhook

PROGRAM = "silhouette-pose-watch"
STOPS_WITHIN_S = 5.0
_POLL_S = 0.1


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run as a program, and end it without waiting for threads.

    One of them may be in the decoder for seconds, and Python aborts if it returns too late.
    """
    signals = list[int]()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: signals.append(number))
    status = run(arguments, signals)
    with contextlib.suppress(OSError):
        sys.stdout.flush()
    os._exit(status)


def run(arguments: Sequence[str] | None = None, signals: Sequence[int] = ()) -> int:
    """Watch as the command line asks, until there are signals; return the exit status."""
    options = _options(arguments)
    stopping, closing = threading.Event(), threading.Event()
    receivers: dict[str, Sequence[Callable[..., None]]] = {}
    if options.webhook:
        receivers["webhook"] = [Webhook(options.webhook).send]
    home_assistant = HomeAssistant(options.mqtt, options.camera_id) if options.mqtt else None
    if home_assistant:
        receivers["mqtt"] = [home_assistant.send, home_assistant.keep]
    try:
        outbox = Outbox(options.camera_id, receivers, options.queue)
    except OSError as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        return 1
    for name, calls in receivers.items():
        work = (outbox, closing, name, *calls)
        threading.Thread(target=deliver, args=work, daemon=True).start()
    bridge = Bridge(Camera(options.url, options.camera_id, options.api_key), outbox, home_assistant)
    source = Source(options.source, options.fps)
    watching = ThreadPoolExecutor(1).submit(bridge.watch, source, options.fps, stopping)
    while not signals and (not watching.done() or (not watching.exception() and len(outbox))):
        time.sleep(_POLL_S)
    if signals:
        say("stopped")
    stopping.set()
    wait([watching], STOPS_WITHIN_S)
    _let_go(outbox, home_assistant, signals)
    closing.set()
    if len(outbox):
        say(f"{len(outbox)} deliveries {fate(options.queue, outbox.save())}")
    return _status(watching)


def _status(watching: Future[None]) -> int:
    """The exit status after the watching; says why the service refuses."""
    try:
        if watching.done():
            watching.result()
    except RefusedError as refusal:
        print(f"{PROGRAM}: the service refuses: {printable(str(refusal))}", file=sys.stderr)
        return 1
    return 0


def _let_go(outbox: Outbox, home_assistant: HomeAssistant | None, signals: Sequence[int]) -> None:
    """Wait a while until all is delivered; a second signal ends that."""
    if home_assistant:
        home_assistant.hide()
    deadline = time.monotonic() + STOPS_WITHIN_S
    while time.monotonic() < deadline and len(signals) < 2:
        if not len(outbox) and not (home_assistant and home_assistant.news()):
            break
        time.sleep(_POLL_S)


def fate(queue: Path | None, is_saved: bool) -> str:
    """Say what becomes of deliveries that still wait at the end."""
    if is_saved:
        return f"wait in {queue}"
    return f"are lost: {queue} cannot be written" if queue else "are lost: --queue keeps them"


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line; end the program if it cannot be followed."""
    parser = argparse.ArgumentParser(
        prog=PROGRAM, description="A camera's frames to a service, events from it."
    )
    add, given = parser.add_argument, os.environ.get
    add("source", type=_source, help="file, number of a device, or URL of a stream; - WATCH_SOURCE")
    add("camera_id", type=_camera_id, help="name of the camera for the service")
    web, broker = _address("http", "https"), _address("mqtt", "mqtts")
    add("--url", type=web, default="http://127.0.0.1:8000", help="of the service")
    add("--fps", type=_rate, default=10.0, help="frames a second at most")
    add("--api-key", default=given("WATCH_API_KEY"), help="of the service")
    add("--webhook", type=web, default=given("WATCH_WEBHOOK") or None, help="URL for events")
    add("--mqtt", type=broker, default=given("WATCH_MQTT") or None,
        help="broker, mqtt://[user:password@]host[:port] or mqtts://")  # fmt: skip
    add("--queue", metavar="FILE", type=Path, help="keeps events that wait")
    return parser.parse_args(arguments)


# None of these repeats an address, which may hold a password.
def _address(*schemes: str) -> Callable[[str], SplitResult]:
    def parse(text: str) -> SplitResult:
        try:
            address = urlsplit(text)
            is_sound = address.scheme in schemes and address.hostname and address.port != 0
        except ValueError:
            is_sound = False
        if not is_sound or not re.fullmatch("[!-~]+", text):
            expected = " or ".join(f"{scheme}://HOST[:PORT]" for scheme in schemes)
            raise argparse.ArgumentTypeError(f"expected {expected}, got something else")
        return address

    return parse


def _source(text: str) -> str:
    source = os.environ.get("WATCH_SOURCE", "") if text == "-" else text
    if not (source.isdecimal() or "://" in source or Path(source).is_file()):
        raise argparse.ArgumentTypeError(
            f"expected a file, a number or a URL, got {source.rpartition('@')[2] or 'nothing'}"
        )
    return source


def _camera_id(text: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,63}", text):
        raise argparse.ArgumentTypeError(f"expected 1 to 64 of A-Za-z0-9._-, got {text}")
    return text


def _rate(text: str) -> float:
    with contextlib.suppress(ValueError):
        if 0 < float(text) < math.inf:
            return float(text)
    raise argparse.ArgumentTypeError(f"expected a number above 0, got {text}")


if __name__ == "__main__":
    main()
