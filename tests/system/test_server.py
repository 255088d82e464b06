"""The service as a process under overload."""

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import numpy as np
import pytest

from tests.conftest import HTTP, Server, running_server
from tests.support.service import sample, slow_frame


@pytest.fixture
def narrow(index_path: Path) -> Iterator[Server]:
    """A server that works on one frame at a time."""
    with running_server(index_path, POSE_CONCURRENCY="1", POSE_MAX_WAIT_S="1") as running:
        yield running


def test_overload_is_refused_at_once(narrow: Server) -> None:
    files = {"frame": slow_frame()}

    def ask(_: int) -> tuple[int, float, str | None]:
        started = time.perf_counter()
        response = HTTP.post(f"{narrow.url}/pose", files=files)
        seconds = time.perf_counter() - started
        return response.status_code, seconds, response.headers.get("retry-after")

    ask(0)  # From now on it knows what such a frame takes.
    # A fast machine serves a dozen within the second that a frame may wait.
    with ThreadPoolExecutor(30) as clients:
        answers = list(clients.map(ask, range(30)))
    accepted = [seconds for status, seconds, _ in answers if status == 200]
    refused = [(seconds, after) for status, seconds, after in answers if status == 503]
    assert len(accepted) + len(refused) == 30
    assert accepted
    assert len(refused) >= 10
    assert all(int(after or 0) >= 1 for _, after in refused)
    assert np.median([seconds for seconds, _ in refused]) < max(accepted)
    with httpx.Client(base_url=narrow.url, timeout=60) as client:
        assert sample(client, "pose_rejected_total", reason="overloaded") == len(refused)
