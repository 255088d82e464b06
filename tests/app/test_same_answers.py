"""The same request has the same answer: whatever is asked beside it, and on every processor."""

from __future__ import annotations

import importlib
import json
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import httpx
import numpy as np
import pytest
from fastapi.testclient import TestClient

from index.store import PoseIndex
from tests.conftest import ROOT, Photo, Server, photograph, png, start_server, wait_until

WALKERS = (ROOT / "tests" / "data" / "walkers.jpg").read_bytes()
MASKS = (ROOT / "tests" / "data" / "walkers-mask.png").read_bytes()

PHOTOS = range(0, 96, 7)
IDENTITY = ("entry", "source", "camera")
"""What tells hypotheses of one person apart."""

AMONG_OTHERS = {"rank", "confidence"}
"""What a hypothesis is given in comparison with the others."""


def older_processor() -> dict[str, str]:
    """Environment in which the libraries choose the code for a processor without AVX."""
    numpy_core = importlib.import_module("numpy._core._multiarray_umath")
    return {
        "NPY_DISABLE_CPU_FEATURES": " ".join(
            feature
            for feature in numpy_core.__cpu_dispatch__
            if numpy_core.__cpu_features__.get(feature)
        ),
        "OPENBLAS_CORETYPE": "Nehalem",
        "FAISS_OPT_LEVEL": "generic",
        "OPENCV_CPU_DISABLE": "AVX,AVX2,FMA3,FP16",
        "OPENCV_IPP": "disabled",
    }


@pytest.fixture(scope="module")
def processors() -> Iterator[list[Server]]:
    """Servers over the shipped index, on this processor and as on an older one."""
    with ExitStack() as stack:
        servers = []
        for environment in ({}, older_processor()):
            servers.append(start_server(None, **environment))
            stack.callback(servers[-1].stop)
        for server in servers:
            wait_until(f"{server.url}/readyz", timeout_s=60)
        yield servers


@pytest.mark.parametrize(
    "files",
    [{"mask": MASKS}, {"frame": WALKERS, "mask": MASKS}, {"frame": WALKERS}],
    ids=["mask", "both", "frame"],
)
@pytest.mark.parametrize("n", [1, 7, 30])
def test_every_processor_gives_the_same_answer(
    processors: list[Server], files: dict[str, bytes], n: int
) -> None:
    one, other = (
        httpx.post(f"{server.url}/pose", files=files, params={"n": n}, timeout=60).json()
        for server in processors
    )
    assert one["persons"]
    assert one["persons"] == other["persons"]


def persons(client: TestClient, path: str = "/pose", **files: bytes) -> list[dict[str, Any]]:
    response = client.post(path, files=files)
    assert response.status_code == 200, response.text
    answer: list[dict[str, Any]] = response.json()["persons"]
    return answer


@pytest.mark.parametrize("entry", PHOTOS)
def test_a_camera_session_gives_the_numbers_of_a_photograph(
    client: TestClient, tiny_index: PoseIndex, entry: int
) -> None:
    photo = photograph(tiny_index, entry)
    files = {"frame": photo.frame_png, "mask": photo.mask_png}
    (alone,), (tracked,) = persons(client, **files), persons(client, "/cameras/a/frames", **files)
    for name in ("box", "source", "silhouette", "observed_keypoints"):
        assert tracked[name] == alone[name]
    if alone["observed_keypoints"]:
        assert tracked["hypotheses"] == alone["hypotheses"]
    # Without keypoints a session compares more poses: others may be among its nearest.
    ours, theirs = (
        {json.dumps([one[name] for name in IDENTITY]): one for one in person["hypotheses"]}
        for person in (alone, tracked)
    )
    shared = ours.keys() & theirs.keys()
    assert len(shared) >= 4
    for key in shared:
        for name in ours[key].keys() - AMONG_OTHERS:
            assert theirs[key][name] == ours[key][name], name


@pytest.mark.parametrize("entry", PHOTOS)
def test_who_else_is_in_the_frame_does_not_matter(
    client: TestClient, tiny_index: PoseIndex, photo: Photo, entry: int
) -> None:
    other = photograph(tiny_index, entry, left=20)
    (alone,) = persons(client, mask=png(other.mask))
    first, second = persons(client, mask=png(other.mask + 2 * photo.mask))
    assert first == alone
    assert second["hypotheses"][0]["entry"] == photo.entry
    assert json.dumps(first) != json.dumps(second)


@pytest.mark.parametrize("entry", PHOTOS)
def test_where_in_the_frame_somebody_stands_does_not_matter(
    client: TestClient, tiny_index: PoseIndex, entry: int
) -> None:
    (here,), (there,) = (
        persons(client, mask=png(np.asarray(photograph(tiny_index, entry, *place).mask)))
        for place in ((150, 40), (33, 91))
    )
    for one, other in zip(here["hypotheses"], there["hypotheses"], strict=True):
        for name in one.keys() - {"joints_2d"}:
            assert one[name] == other[name], name
