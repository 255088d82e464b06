"""The address of a camera's stream, so that a process which can open no file can open the stream.

A name is looked up with the help of files. The decoder therefore gets the address in numbers.
"""

import socket
from urllib.parse import urlsplit, urlunsplit

_PORTS = {"rtsp": 554, "rtsps": 322, "http": 80, "https": 443, "rtmp": 1935}

OPTIONS = {
    "rtsp_transport": "tcp",  # Streams over UDP lose parts of frames.
    "protocol_whitelist": "rtsp,rtsps,rtp,http,https,httpproxy,rtmp,tcp,tls,udp,srtp,crypto",
}
"""FFmpeg's, for opening a stream."""


def reachable(address: str, timeout_s: float) -> tuple[str, dict[str, str]]:
    """Return an address by the number of its host, and FFmpeg's options for it.

    The number is one at which the host answers. Addresses of other kinds are returned as they are.

    Raises
    ------
    OSError
        If the host is not known or does not answer.
    ValueError
        If this is no address.
    """
    parts = urlsplit(address)
    if parts.scheme not in _PORTS or not parts.hostname:
        return address, OPTIONS
    place = parts.hostname, parts.port or _PORTS[parts.scheme]
    with socket.create_connection(place, timeout_s) as connection:
        number = str(connection.getpeername()[0])
    user, _, named = parts.netloc.rpartition("@")
    host = f"[{number}]" if ":" in number else number
    numeric = parts._replace(netloc=f"{user}@"[not user :] + f"{host}:{place[1]}")
    options = OPTIONS
    if parts.scheme.startswith("http"):
        options = OPTIONS | {"headers": f"Host: {named}\r\n"}
    return urlunsplit(numeric), options
