"""``python -m app``: serve on ``HOST``:``PORT`` with ``WORKERS`` processes.

After SIGTERM or Ctrl-C it finishes the accepted requests and exits with status 0. If a setting is
invalid or the address cannot be used, it exits at once with status 1 and one sentence.
"""

import argparse
import errno
import os
import signal
import socket
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial

# NumPy and OpenCV read these when they are imported: frames are worked on in parallel already, a
# broken image is answered with a 400, and a decoder may disagree with the header that was checked.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OPENCV_LOG_LEVEL", "OFF")
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(2**27))

from app import VERSION
from app.scheduling.process import configure_process
from app.settings import Settings, SettingsError, read_settings
from index.artefact import load_index
from index.store import PoseIndex

SHUTDOWN_GRACE_S = 15


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m app",
        description="Serve on HOST:PORT, by default 127.0.0.1:8000. Environment variables "
        "configure everything; docs/running.md describes them.",
    )
    parser.add_argument("--version", action="version", version=VERSION)
    parser.parse_args()
    try:
        settings = read_settings()
        check_address(settings.host, settings.port)
    except SettingsError as error:
        sys.exit(str(error))
    configure_process()
    # While this thread imports the rest of the service, another one reads the index.
    with ThreadPoolExecutor(1) as pool:
        own = settings.workers == 1 and settings.milvus is None
        serve(settings, pool.submit(load_index, settings.index).result if own else None)


def serve(settings: Settings, read_index: Callable[[], PoseIndex] | None = None) -> None:
    """Check the files of the service and run the server."""
    import uvicorn

    from app.http.access_log import log_config
    from app.http.protocol import HttpProtocol
    from app.main import create_app
    from app.networks.shipped import NetworkError, check_files
    from app.serving import read_cameras

    try:
        check_files()
        read_cameras(settings.cameras_file)
    except (SettingsError, NetworkError) as error:
        sys.exit(str(error))
    # Once it has shut down, uvicorn raises the signal again for the handlers that it found here.
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: None)
    # Python would take `::` for IPv6 alone, `""` for both; the parent of several workers takes `::`
    # for both.
    host = "" if settings.host == "::" and settings.workers == 1 else settings.host
    create = partial(create_app, settings, read_index=read_index)
    # This is longer than the interval of a camera that sends a frame a minute.
    uvicorn.run(
        create if settings.workers == 1 else "app.main:create_app",
        factory=True,
        host=host,
        port=settings.port,
        workers=settings.workers,
        http=HttpProtocol,
        ws="none",
        timeout_graceful_shutdown=SHUTDOWN_GRACE_S,
        timeout_keep_alive=65,
        server_header=False,
        log_config=log_config(settings.log_level),
    )


def check_address(host: str, port: int) -> None:
    """Raise SettingsError unless the service can listen on an address.

    uvicorn would report that only in its log, after everything else has been loaded.
    """
    try:
        addresses = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except OSError:
        raise SettingsError(f"HOST: expected an address of this machine, got {host!r}") from None
    for family, kind, protocol, _, address in addresses:
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(address)
            except OSError as error:
                raise SettingsError(_cannot_listen(host, port, error)) from None


def _cannot_listen(host: str, port: int, error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return f"PORT: expected a free port, got {port}, which another program uses on {host}"
    if error.errno == errno.EACCES:
        return f"PORT: expected a port this user may listen on, got {port}"
    if error.errno == errno.EADDRNOTAVAIL:
        return f"HOST: expected an address of this machine, got {host!r}"
    return f"HOST, PORT: cannot listen on {host}:{port}: {error.strerror}"


if __name__ == "__main__":
    main()
