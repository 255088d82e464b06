"""A service that answers as in the paper: over a socket, without a network."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.conftest import HTTP, WALKERS, Server, running_server

STREET = WALKERS.read_bytes()


@pytest.fixture(scope="module")
def paper(index_path: Path) -> Iterator[Server]:
    """The service over the tiny index, with the paper's method as its default."""
    with running_server(index_path, POSE_METHOD="paper") as running:
        yield running


def post(server: Server, path: str, **params: Any) -> httpx.Response:
    files = {"frame": ("walkers.jpg", STREET)}
    return HTTP.post(f"{server.url}{path}", files=files, params=params)


def test_people_have_seven_entries_by_default_and_no_network_is_loaded(paper: Server) -> None:
    named, default = (post(paper, "/pose", **one).json() for one in ({"method": "paper"}, {}))
    assert default["persons"] == named["persons"]
    assert len(named["persons"]) >= 3
    for person in named["persons"]:
        assert person["silhouette"]["segmenter"] == "grabcut"
        assert person["observed_keypoints"] is None
        assert person["facing"]["evidence"] == "none"
        distances = [one["distance"] for one in person["hypotheses"]]
        assert len(distances) == 7
        assert distances == sorted(distances)
        assert all(0 < one["confidence"] < 1 for one in person["hypotheses"])
        assert all(one["adjusted_mm"] == 0 for one in person["hypotheses"])
    for path in ("/pose/overlay", "/silhouette", "/cameras/yard/frames"):
        assert post(paper, path).status_code == 200
    assert "litert" not in Path(f"/proc/{paper.process.pid}/maps").read_text()


def test_networks_are_refused(paper: Server) -> None:
    for field, value in (("method", "networks"), ("evidence", "photograph")):
        problem = post(paper, "/pose", **{field: value})
        assert problem.status_code == 422
        assert problem.json()["field"] == field
        assert "expected" in problem.json()["detail"]
