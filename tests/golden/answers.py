"""Answers: got from the service, stored as JSON, compared."""

import hashlib
import json
import re
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
from fastapi.testclient import TestClient
from pydantic import SecretStr

from app.main import create_app
from app.photograph import Estimator
from app.settings import Settings
from tests.golden.pictures import decode
from tests.golden.requests import Request, requests

FOLDER = Path(__file__).with_name("answers")

RELATIVE, ABSOLUTE = 1e-3, 1e-3
"""By how much a number of an inexact answer may differ: this share of it, this much (1 mm, 0.1 % of
probability), or one in the last digit that is written, whichever is largest.

Measured: one thread instead of two, one core, and libraries held to a processor without AVX moved
2e-9 at most, in the one number that is not rounded. The rest is for processors and releases of
OpenCV, FFmpeg and LiteRT that were not tried; what differs by more is another answer.
"""

HEADERS = ("content-type", "x-session", "retry-after", "allow", "www-authenticate")
_LOADED_WITHIN_S = 120
# What depends on the clock: of a frame, of a camera, of DeepStack's answer.
_TIMED = re.compile(r'("timings_ms":)\{[^}]*\}|("(?:age_s|idle_s|duration)":)[\d.e+-]+')
_WIDTH = 100


@contextmanager
def services(estimator: Estimator | None = None) -> Iterator[Mapping[str, TestClient]]:
    """Clients of the service over the shipped index, and of one that never loads an index.

    An estimator over the shipped index saves loading it.
    """
    # A busy machine may take its time.
    patient = Settings(max_wait_s=300, request_timeout_s=300, revision="golden")
    locked = Settings(api_keys=(SecretStr("golden"),))
    with TestClient(create_app(patient, estimator), raise_server_exceptions=False) as client:
        until = time.monotonic() + _LOADED_WITHIN_S
        while client.get("/readyz").status_code != 200:
            assert time.monotonic() < until, "expected the index to be loaded"
            time.sleep(0.05)
        # Without `with` nothing is started.
        yield {"open": client, "locked": TestClient(create_app(locked))}


class Conversation:
    """Requests to the services, each sent once, when its answer or a later one is asked for."""

    def __init__(self, clients: Mapping[str, TestClient]) -> None:
        self._clients = clients
        self._waiting = list(requests())
        self._answers: dict[str, dict[str, Any]] = {}

    def answer(self, request: Request) -> dict[str, Any]:
        """The answer to a request; earlier requests about the same camera are sent before it."""
        while request.name not in self._answers:
            first = next(one for one in self._waiting if one.camera == request.camera)
            self._waiting.remove(first)
            self._answers[first.name] = self._send(first)
        return self._answers[request.name]

    def _send(self, request: Request) -> dict[str, Any]:
        response = self._clients[request.service].request(
            request.method, request.path, params=request.params, **request.options
        )
        if request.kept:
            return answer_of(request, response)
        assert response.status_code == 200, response.text
        return {}


def answer_of(request: Request, response: Any) -> dict[str, Any]:
    """Describe a response in JSON: its status, headers and body, without what the clock decides."""
    headers = {name: response.headers[name] for name in HEADERS if name in response.headers}
    return {
        "status": response.status_code,
        "headers": headers,
        "body": _body_of(response, request.exact),
    }


def _body_of(response: Any, exact: bool) -> Any:
    kind = response.headers.get("content-type", "")
    if kind == "image/png":
        return _describe_picture(response.content, exact)
    if kind == "application/x-ndjson":
        return [_parse(line, exact) for line in response.text.splitlines()]
    return _parse(response.text, exact) if response.content else None


def _parse(text: str, exact: bool) -> Any:
    """Parse JSON, without timings; so that of an exact answer every byte counts."""
    timeless = _TIMED.sub(r"\1\2null", text)
    parsed = json.loads(timeless)
    if exact and compact(parsed) != timeless:
        raise AssertionError(f"expected JSON as Python writes it, got {timeless[:200]}")
    return parsed


def _describe_picture(content: bytes, exact: bool) -> dict[str, Any]:
    """Shape of a picture; its pixels' hash if they are exact, else the area of each label."""
    pixels = decode(content)
    described: dict[str, Any] = {"shape": list(pixels.shape)}
    if exact:
        described["sha256"] = hashlib.sha256(pixels.tobytes()).hexdigest()
    elif pixels.ndim == 2:
        described["areas_px"] = np.bincount(pixels.ravel()).astype(float).tolist()
    return described


def compact(value: Any) -> str:
    """Write JSON as the service does."""
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"))


def pretty(value: Any, indent: str = "") -> str:
    """Write JSON for reading: what fits stands in one line."""
    line = json.dumps(value, ensure_ascii=False)
    if not isinstance(value, (dict, list)) or not value or len(indent) + len(line) <= _WIDTH:
        return line
    inner = indent + " "
    if isinstance(value, dict):
        items = [f"{json.dumps(key)}: {pretty(item, inner)}" for key, item in value.items()]
    elif all(isinstance(item, (int, float, type(None))) for item in value):
        return _wrap(value, indent)
    else:
        items = [pretty(item, inner) for item in value]
    opening, closing = "{}" if isinstance(value, dict) else "[]"
    body = ",\n".join(f"{inner}{item}" for item in items)
    return f"{opening}\n{body}\n{indent}{closing}"


def _wrap(numbers: Iterable[float | None], indent: str) -> str:
    """Write a list of numbers over several full lines."""
    lines, line = [], f"{indent} "
    for number in numbers:
        text = f"{json.dumps(number)}, "
        if len(line) + len(text) > _WIDTH:
            lines.append(line.rstrip())
            line = f"{indent} "
        line += text
    return "\n".join(["[", *lines, line.rstrip(", "), f"{indent}]"])


def file_of(name: str) -> Path:
    """Return the file of an answer."""
    return FOLDER / f"{name}.json"


def read(name: str) -> Any:
    """Read a stored answer; None if there is none."""
    file = file_of(name)
    return json.loads(file.read_text()) if file.exists() else None


def differences(stored: Any, got: Any, exact: bool, place: str = "") -> Iterator[str]:
    """Yield in a sentence each what differs between two answers, the order of fields included."""
    if isinstance(stored, dict) and isinstance(got, dict):
        if list(stored) != list(got):
            yield f"{place or 'answer'}: fields {list(stored)} -> {list(got)}"
        for name in stored.keys() & got.keys():
            yield from differences(stored[name], got[name], exact, f"{place}.{name}".lstrip("."))
    elif isinstance(stored, list) and isinstance(got, list):
        if len(stored) != len(got):
            yield f"{place}: {len(stored)} items -> {len(got)}"
        for number, (one, other) in enumerate(zip(stored, got, strict=False)):
            yield from differences(one, other, exact, f"{place}[{number}]")
    elif not _equal(stored, got, exact):
        yield f"{place}: {compact(stored)} -> {compact(got)}"


def _equal(one: Any, other: Any, exact: bool) -> bool:
    if not exact and isinstance(one, float) and isinstance(other, float):
        digits = max(-int(Decimal(repr(number)).as_tuple().exponent) for number in (one, other))
        margin = max(ABSOLUTE, RELATIVE * abs(one), 10.0**-digits)
        return abs(one - other) <= 1.0001 * margin  # Decimals are not exact in binary.
    return type(one) is type(other) and bool(one == other)
