"""Watch cameras: frames to a service, its events to a webhook and to MQTT.

    silhouette-pose-watch cameras.yaml
    silhouette-pose-watch SOURCE CAMERA_ID [--url URL] [--fps 10] [--api-key KEY]
        [--webhook URL] [--mqtt mqtt://user:password@host] [--queue FILE]

A file of cameras is read anew after SIGHUP. SOURCE is a video file, the number of a device (0) or
the URL of a stream (rtsp://...). The newest frame is posted whenever the service has answered the
last one. Each event is printed as a line of JSON, and delivered to each receiver: it waits, with a
queue even through a restart of this program, until it is taken. A receiver that gets an event
twice, because an acknowledgement was lost, recognises it by its ``id``. Everything else is printed
to standard error.
"""

import argparse
import contextlib
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from app.bridge import printable, say
from app.bridge.settings import Settings, SettingsError, Steps, read_file, settings_from
from app.bridge.watch import POLL_S, Cameras, end

PROGRAM = "silhouette-pose-watch"
_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows lacks the last.
_HANGUP = getattr(signal, "SIGHUP", None)


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run as a program, and end it without waiting for threads.

    One of them may be in the decoder for seconds, and Python aborts if it returns too late.
    """
    signals = list[int]()
    for name in _SIGNALS:
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), lambda number, _: signals.append(number))
    status = run(arguments, signals)
    with contextlib.suppress(OSError):
        sys.stdout.flush()
    os._exit(status)


def run(arguments: Sequence[str] | None = None, signals: list[int] | None = None) -> int:
    """Watch as the command line asks, until there are signals; return the exit status."""
    signals = [] if signals is None else signals
    read, is_only = _reader(arguments)
    try:
        cameras = Cameras(read(), is_only=is_only)
    except (SettingsError, OSError) as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        return 1
    while cameras.are_busy:
        if _HANGUP in signals and not is_only:
            signals.remove(_HANGUP)
            try:
                cameras.apply(read())
                say("the cameras are read anew")
            except (SettingsError, OSError) as error:
                say(f"the cameras stay as they are: {error}")
        if signals:
            say("stopped")
            break
        time.sleep(POLL_S)
    watches = cameras.watches.values()
    end(watches, signals)
    if waiting := sum(len(one.outbox) for one in watches):
        queue = next(one.settings.queue for one in watches)
        lost = f"{queue} cannot be written" if queue else "a queue keeps them"
        is_saved = all(one.outbox.save() for one in watches)
        say(f"{waiting} deliveries {f'wait in {queue}' if is_saved else f'are lost: {lost}'}")
    refusals = [one.refusal for one in watches if one.refusal]
    for refusal in refusals:
        print(f"{PROGRAM}: the service refuses: {printable(refusal)}", file=sys.stderr)
    return 1 if refusals else 0


def _reader(arguments: Sequence[str] | None) -> tuple[Callable[[], Settings], bool]:
    """Return what reads the settings, and whether they are those of the command line."""
    parser = argparse.ArgumentParser(
        prog=PROGRAM, description="Cameras' frames to a service, events from it."
    )
    add = parser.add_argument
    add("source", help="file of cameras (YAML); or video file, number of a device, URL of a stream;"
        " - for WATCH_SOURCE")  # fmt: skip
    add("camera_id", nargs="?", help="name of the camera for the service")
    add("--url", help="of the service, by default http://127.0.0.1:8000")
    add("--fps", help="frames a second at most, by default 10")
    add("--api-key", help="of the service")
    add("--webhook", help="URL for events")
    add("--mqtt", help="broker, mqtt://[user:password@]host[:port] or mqtts://")
    add("--queue", metavar="FILE", help="keeps events that wait")
    given = parser.parse_args(arguments)
    source, camera_id = vars(given).pop("source"), vars(given).pop("camera_id")
    options = {name: value for name, value in vars(given).items() if value is not None}
    if camera_id is None:
        if options:
            parser.error(f"expected a camera_id, or no --{min(options)} beside a file of cameras")
        return lambda: read_file(Path(source)), False
    camera = {name: options.pop(name) for name in ["fps"] if name in options}
    camera["source"] = os.environ.get("WATCH_SOURCE") if source == "-" else source
    return lambda: settings_from({**options, "cameras": {camera_id: camera}}, _option), True


def _option(steps: Steps) -> str:
    """Name the argument that steps in the settings come from."""
    if steps[0] == "cameras" and steps[-1] != "fps":
        return "source" if steps[-1] == "source" else "camera_id"
    return f"--{'fps' if steps[0] == 'cameras' else steps[0]}".replace("_", "-")


if __name__ == "__main__":
    main()
