"""Talk to a service under test: problems, metrics, frames of cameras, and waiting for a state."""

import re
import time
from collections.abc import Callable
from typing import Any

import cv2
import httpx
import numpy as np
from fastapi.testclient import TestClient
from prometheus_client.parser import text_string_to_metric_families

from tests.conftest import Photo

Client = TestClient | httpx.Client


def eventually(reached: Callable[[], object], timeout_s: float = 60) -> None:
    """Wait until a condition holds; fail if it does not in time, on however busy a machine."""
    deadline = time.monotonic() + timeout_s
    while not reached():
        assert time.monotonic() < deadline, f"expected it within {timeout_s:g} s"
        time.sleep(0.02)


def slow_frame() -> bytes:
    """A large frame full of edges, which takes long to search for people."""
    coarse = np.random.default_rng(0).integers(0, 255, (90, 160, 3), np.uint8)
    frame = cv2.resize(coarse, (1280, 720), interpolation=cv2.INTER_NEAREST)
    return cv2.imencode(".jpg", frame)[1].tobytes()


def check_problem(response: Any, status: int, field: str | None = None) -> str:
    """The answer is a problem with this status; return its detail."""
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    problem = response.json()
    assert problem["status"] == status
    assert problem["type"] == "about:blank"
    assert problem["title"]
    assert problem["detail"]
    assert re.fullmatch("[a-z_]+", problem["reason"])
    assert problem.get("field") == field
    assert "Traceback" not in response.text
    if status == 503 and problem["reason"] not in ("not_ready", "superseded"):
        assert int(response.headers["retry-after"]) >= 1
    return str(problem["detail"])


def sample(client: Client, metric: str, /, **labels: str) -> float | None:
    """Value of a metric with these labels, None where there is none."""
    for family in text_string_to_metric_families(client.get("/metrics").text):
        for found in family.samples:
            if found.name == metric and labels.items() <= found.labels.items():
                return found.value
    return None


def samples(client: Client, metric: str, /, **labels: str) -> list[dict[str, str]]:
    """Labels of all samples of a metric that have these."""
    return [
        found.labels
        for family in text_string_to_metric_families(client.get("/metrics").text)
        for found in family.samples
        if found.name == metric and labels.items() <= found.labels.items()
    ]


def send(
    client: Client,
    photo: Photo,
    camera: str = "yard",
    query: dict[str, Any] | None = None,
    headers: dict[str, str] | None = None,
    **fields: str,
) -> Any:
    """Send a camera's frame with its mask."""
    return client.post(
        f"/cameras/{camera}/frames",
        files=photo.files,
        data=fields,
        params=query or {},
        headers=headers or {},
    )
