"""TLS in front of the service, by nginx and Caddy as ``deploy/`` configures them."""

import json
import os
import shutil
import ssl
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import httpx
import pytest

from app.settings import Settings
from tests.conftest import HTTP, ROOT, Photo, Server
from tests.support.ports import free_ports

NGINX = (ROOT / "deploy" / "nginx.conf").read_text()
CADDY = (ROOT / "deploy" / "Caddyfile").read_text()

_NGINX_MAIN = """
daemon off;
worker_processes 1;
pid {folder}/nginx.pid;
error_log stderr warn;
events {{ worker_connections 256; }}
http {{
    access_log off;
    client_body_temp_path {folder}/body;
    proxy_temp_path {folder}/proxy;
    fastcgi_temp_path {folder}/fastcgi;
    uwsgi_temp_path {folder}/uwsgi;
    scgi_temp_path {folder}/scgi;
    include {folder}/pose.conf;
}}
"""


@dataclass(frozen=True)
class Proxy:
    """A proxy with TLS before a service, and what trusts its certificate."""

    url: str
    context: ssl.SSLContext

    def client(self) -> httpx.Client:
        """A client of the proxy."""
        return httpx.Client(base_url=self.url, verify=self.context, timeout=60)


def certificate(folder: Path) -> tuple[Path, Path]:
    """A certificate for localhost, signed by itself, and its key."""
    paths = folder / "pose.crt", folder / "pose.key"
    arguments = ["-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost"]
    arguments += ["-addext", "subjectAltName=DNS:localhost"]
    subprocess.run(
        ["openssl", "req", "-x509", *arguments, "-out", paths[0], "-keyout", paths[1]],
        check=True,
        capture_output=True,
    )
    return paths


@contextmanager
def running(command: list[str], url: str, context: ssl.SSLContext) -> Iterator[None]:
    """Run a proxy until it is no longer needed, once it answers."""
    environment = {**os.environ, "XDG_DATA_HOME": "/tmp", "XDG_CONFIG_HOME": "/tmp"}
    process = subprocess.Popen(command, env=environment)
    try:
        deadline = time.monotonic() + 60
        while True:
            try:
                httpx.get(f"{url}/readyz", verify=context)
                break
            except httpx.TransportError:
                assert process.poll() is None, "the proxy has ended"
                assert time.monotonic() < deadline
                time.sleep(0.02)
        yield
    finally:
        process.terminate()
        process.wait(timeout=60)


def replaced(text: str, *changes: tuple[str, str]) -> str:
    """The text with changes, each of which has to apply."""
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    return text


@contextmanager
def proxied(name: str, backend: str, folder: Path) -> Iterator[Proxy]:
    """Run a proxy as its file in deploy/ says, but for addresses and certificate."""
    program = shutil.which(name, path=f"{os.environ['PATH']}:/usr/sbin")
    if program is None or shutil.which("openssl") is None:
        pytest.skip(f"needs {name} and openssl: apt-get install {name} openssl")
    (port,) = free_ports(1)
    url = f"https://localhost:{port}"
    crt, key = certificate(folder)
    address = backend.removeprefix("http://")
    if name == "nginx":
        text = replaced(
            NGINX,
            ("127.0.0.1:8000", address),
            ("listen 443", f"listen 127.0.0.1:{port}"),
            ("pose.example", "localhost"),
            ("/etc/ssl/pose.crt", str(crt)),
            ("/etc/ssl/pose.key", str(key)),
        )
        (folder / "pose.conf").write_text(text)
        main = folder / "nginx.conf"
        main.write_text(_NGINX_MAIN.format(folder=folder))
        command = [program, "-c", str(main), "-p", str(folder)]
    else:
        text = replaced(
            CADDY,
            ("127.0.0.1:8000", address),
            ("pose.example {\n", f"{url} {{\n\tbind 127.0.0.1\n\ttls {crt} {key}\n"),
            ("{\n\tservers", "{\n\tadmin off\n\tauto_https disable_redirects\n\tservers"),
        )
        main = folder / "Caddyfile"
        main.write_text(text)
        command = [program, "run", "--config", str(main), "--adapter", "caddyfile"]
    context = ssl.create_default_context(cafile=str(crt))
    with running(command, url, context):
        yield Proxy(url, context)


PROXIES = ["nginx", "caddy"]


@pytest.fixture(scope="module", params=PROXIES)
def proxy(
    server: Server, request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Proxy]:
    folder = tmp_path_factory.mktemp(request.param)
    with proxied(request.param, server.url, folder) as proxy:
        yield proxy


@pytest.fixture
def client(proxy: Proxy) -> Iterator[httpx.Client]:
    with proxy.client() as client:
        yield client


def test_a_frame_is_answered_as_without_it(
    client: httpx.Client, server: Server, photo: Photo
) -> None:
    # As the page sends it: the service compares the origin with the host.
    there = client.post(
        "/pose", files=photo.files, headers={"Origin": str(client.base_url).rstrip("/")}
    )
    here = HTTP.post(f"{server.url}/pose", files=photo.files)
    assert there.status_code == 200
    assert there.json()["persons"] == here.json()["persons"]
    assert client.get("/metrics").status_code == 404
    # As large as the service takes it; of a form a little is not the file.
    video = bytes(Settings.model_fields["max_video_bytes"].default - 1000)
    large = client.post("/sequence", files={"video": ("clip.mp4", video)})
    assert large.json()["reason"] == "undecodable"


class Echo(BaseHTTPRequestHandler):
    """Answers with the headers that reach it."""

    def do_GET(self) -> None:
        body = json.dumps(dict(self.headers.items())).encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)


@pytest.mark.parametrize("name", PROXIES)
def test_a_client_cannot_pose_as_another(name: str, tmp_path: Path) -> None:
    with ThreadingHTTPServer(("127.0.0.1", 0), Echo) as backend:
        Thread(target=backend.serve_forever, args=(0.01,), daemon=True).start()
        with proxied(name, f"127.0.0.1:{backend.server_port}", tmp_path) as proxy:
            forged = {"X-Forwarded-For": "203.0.113.9", "X-API-Key": "first"}
            with proxy.client() as client:
                received = client.get("/index", headers=forged).json()
        backend.shutdown()
    headers = {header.lower(): value for header, value in received.items()}
    assert headers["x-forwarded-for"] == "127.0.0.1"
    assert headers["x-forwarded-proto"] == "https"
    assert headers["x-api-key"] == "first"
