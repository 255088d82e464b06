"""The service with its index in a real Milvus server."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import httpx
import pytest

from app import __main__ as main
from app.serving import milvus as remote_index
from index.artefact import load_index, save_index
from index.store import PoseIndex
from tests.conftest import Photo, Server, build_tiny_index, start_server, wait_until
from tests.support.background import BackgroundLoop, Reply
from tests.support.milvus_server import MilvusProcess, why_milvus_cannot_run
from tests.support.ports import free_ports
from tests.support.service import check_problem, eventually, send
from tests.system.test_server import value

if why_milvus_cannot_run() is None or TYPE_CHECKING:
    from index.milvus import Milvus, publish

needs_milvus = pytest.mark.skipif(
    why_milvus_cannot_run() is not None, reason=str(why_milvus_cannot_run())
)

ALIAS = "served"


@pytest.fixture(scope="module")
def artefacts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two versions whose answers differ in the subject."""
    folder = tmp_path_factory.mktemp("artefacts")
    save_index(build_tiny_index(), folder / "sticks")
    save_index(replace(build_tiny_index(seed=2), subjects=("other",)), folder / "others")
    return folder


@pytest.fixture(scope="module")
def sticks(artefacts: Path) -> PoseIndex:
    return load_index(artefacts / "sticks")


@pytest.fixture(scope="module")
def others(artefacts: Path) -> PoseIndex:
    return load_index(artefacts / "others")


@contextmanager
def serving(milvus_process: MilvusProcess, artefacts: Path, **environment: str) -> Iterator[Server]:
    """A server whose index is in Milvus; it may not be ready yet."""
    running = start_server(
        None,
        POSE_INDEX=f"milvus://{milvus_process.address}/{ALIAS}",
        POSE_ARTEFACTS=str(artefacts),
        POSE_SEARCH_TIMEOUT_S="1",
        **environment,
    )
    try:
        yield running
    finally:
        assert running.stop() == 0


@pytest.fixture(scope="module")
def server(
    milvus: Milvus, milvus_process: MilvusProcess, artefacts: Path, sticks: PoseIndex
) -> Iterator[Server]:
    publish(milvus, sticks, ALIAS)
    with serving(milvus_process, artefacts) as running:
        wait_until(f"{running.url}/readyz")
        yield running


@pytest.fixture
def load(server: Server, photo: Photo) -> BackgroundLoop:
    """Two clients that send one frame after the other."""
    return BackgroundLoop(server.url, lambda client: client.post("/pose", files=photo.files))


def all_refusals_have_retry_after(load: BackgroundLoop) -> bool:
    refusals = (reply.response for reply in load.replies if reply.status == 503)
    return all(int(refusal.headers["retry-after"]) >= 1 for refusal in refusals)


def versions_in(reply: Reply, versions: dict[str, str]) -> set[str]:
    """Versions of the index in an answer: the named one, and those with its subjects."""
    body = reply.response.json()
    (person,) = body["persons"]
    subjects = {hypothesis["source"]["subject"] for hypothesis in person["hypotheses"]}
    return {body["index"]["version"], *(versions[subject] for subject in subjects)}


@needs_milvus
@pytest.mark.slow  # Half a minute to begin with; tests/index/test_milvus.py asks a server in CI.
class TestServing:
    def test_it_answers_as_with_the_index_in_a_folder(
        self, server: Server, photo: Photo, sticks: PoseIndex
    ) -> None:
        answer = httpx.post(f"{server.url}/pose", files=photo.files).json()
        assert answer["persons"][0]["hypotheses"][0]["entry"] == photo.entry
        assert answer["index"]["version"] == sticks.version

    def test_searches_in_a_silent_milvus_time_out_and_succeed_later(
        self, milvus_process: MilvusProcess, server: Server, load: BackgroundLoop
    ) -> None:
        with load:
            load.wait_for(200)
            milvus_process.freeze()
            try:
                load.wait_for(503)
                assert httpx.get(f"{server.url}/healthz").status_code == 200
                # Every frame tries again, and each gets its own answer in time.
                failures = "pose_search_failures_total"
                eventually(lambda: value(server, failures, reason="deadline") >= 4)
                assert value(server, "pose_search_breaker_open") == 1
                assert httpx.get(f"{server.url}/readyz").status_code == 200
            finally:
                milvus_process.thaw()
            load.wait_for(200)
        assert load.broken == 0
        assert {reply.status for reply in load.replies} == {200, 503}
        assert all_refusals_have_retry_after(load)
        assert value(server, "pose_search_breaker_open") == 0

    def test_it_switches_to_another_version_without_a_mixed_or_failed_answer(
        self, milvus: Milvus, server: Server, load: BackgroundLoop, photo: Photo, sticks: PoseIndex,
        others: PoseIndex,
    ) -> None:  # fmt: skip
        with load, httpx.Client(base_url=server.url) as client:
            assert [send(client, photo).headers["x-session"] for _ in range(2)] == ["new", "warm"]
            publish(milvus, others, ALIAS)
            eventually(lambda: client.get("/index").json()["version"] == others.version)
            load.wait_for(200)
            assert send(client, photo).headers["x-session"] == "new"
        assert load.broken == 0
        assert {reply.status for reply in load.replies} == {200}
        versions = {"stick": sticks.version, "other": others.version}
        served = [versions_in(reply, versions) for reply in load.replies]
        assert all(len(named) == 1 for named in served)
        assert served[0] == {sticks.version}
        assert served[-1] == {others.version}
        assert value(server, "pose_index_info", name=others.name, version=others.version) == 1
        assert value(server, "pose_camera_sessions_ended_total", reason="index") == 1
        publish(milvus, sticks, ALIAS)


@needs_milvus
@pytest.mark.slow
def test_searches_recover_after_milvus_was_killed(
    milvus_process: MilvusProcess,
    milvus: Milvus,
    server: Server,
    load: BackgroundLoop,
    artefacts: Path,
) -> None:
    with load:
        load.wait_for(200)
        milvus_process.kill()
        with serving(milvus_process, artefacts) as later:
            load.wait_for(503)
            wait_for_detail(later, "cannot be reached")
            assert httpx.get(f"{later.url}/healthz").status_code == 200
            milvus_process.start()
            milvus_process.wait_until_healthy()
            wait_until_searched(milvus)
            load.wait_for(200)
            wait_until(f"{later.url}/readyz", timeout_s=10)
    assert load.broken == 0
    assert {reply.status for reply in load.replies} == {200, 503}
    assert all_refusals_have_retry_after(load)


def wait_until_searched(milvus: Milvus) -> None:
    """Wait until Milvus, which is healthy earlier, has loaded its collections again."""
    from index.search import UnavailableError

    def searched() -> bool:
        with suppress(UnavailableError):
            milvus.count(milvus.resolve(ALIAS), 0, 1)
            return True
        return False

    eventually(searched, timeout_s=60)


def wait_for_detail(server: Server, expected: str) -> str:
    """Wait until a service reports why it is not ready; return the sentence."""
    wait_until(f"{server.url}/healthz")

    def detail() -> str:
        return check_problem(httpx.get(f"{server.url}/readyz"), 503)

    eventually(lambda: expected in detail())
    return detail()


def test_a_missing_package_ends_the_start_with_one_sentence(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("POSE_INDEX", "milvus://vectors/poses")
    monkeypatch.setenv("PORT", str(free_ports(1)[0]))
    monkeypatch.setattr(remote_index.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(SystemExit, match=r"^POSE_INDEX: expected the packages of the extra milvus"):
        main.main()
