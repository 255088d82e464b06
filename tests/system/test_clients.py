"""Programs that post a photograph in a way of their own: curl, Java and netcat."""

import json
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from tests.conftest import WALKERS, Server, running_server

QUERY = "/pose?n=1&joints=none"
POST_JAVA = Path(__file__).with_name("Post.java")


@pytest.fixture(scope="module")
def patient(index_path: Path) -> Iterator[Server]:
    """A server that finishes every frame, however busy the machine is."""
    with running_server(index_path, POSE_REQUEST_TIMEOUT_S="100", POSE_MAX_WAIT_S="60") as running:
        yield running


def needs(program: str) -> str:
    """The path of a program; skip the test without it."""
    path = shutil.which(program)
    if path is None:
        pytest.skip(f"needs {program}")
    return path


def said_by(*command: str | Path, given: bytes = b"") -> bytes:
    return subprocess.run(command, input=given, capture_output=True, check=True, timeout=120).stdout


def check(body: bytes | str) -> None:
    assert len(json.loads(body)["persons"]) == 5


def test_curl_asks_for_http_2(patient: Server) -> None:
    curl = needs("curl")
    if b"HTTP2" not in said_by(curl, "--version"):
        pytest.skip("needs curl with HTTP/2")
    options = ("--fail", "--silent", "--http2", "--header", "Content-Type: image/jpeg")
    check(said_by(curl, *options, "--data-binary", f"@{WALKERS}", patient.url + QUERY))
    # Without a length, in chunks.
    chunked = ("--header", "Transfer-Encoding: chunked")
    check(said_by(curl, *options, *chunked, "--data-binary", f"@{WALKERS}", patient.url + QUERY))


def test_javas_client_asks_for_http_2(patient: Server) -> None:
    needs("javac")  # A JRE alone does not run a source file.
    answers = said_by(needs("java"), POST_JAVA, patient.url + QUERY, WALKERS).decode().splitlines()
    assert len(answers) == 2
    for answer in answers:
        status, _, body = answer.partition(" ")
        assert status == "200"
        check(body)


def test_netcat_sends_no_more(patient: Server) -> None:
    netcat, address = needs("nc"), httpx.URL(patient.url)
    photograph = WALKERS.read_bytes()
    head = f"POST {QUERY} HTTP/1.1\r\nHost: x\r\nContent-Type: image/jpeg\r\n"
    head += f"Content-Length: {len(photograph)}\r\n\r\n"
    command = (netcat, "-N", address.host, str(address.port))
    head_of_answer, body = said_by(*command, given=head.encode() + photograph).split(b"\r\n\r\n")
    assert head_of_answer.startswith(b"HTTP/1.1 200")
    check(body)
