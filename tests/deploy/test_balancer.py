"""Two service processes behind HAProxy with ``deploy/haproxy.cfg``."""

import json
import shutil
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.conftest import Photo
from tests.support.background import BackgroundLoop
from tests.support.balancer import CONFIGURATION, Balancer, Replica
from tests.support.programs import run
from tests.support.service import check_problem, eventually, send
from tests.support.upgrades import check_hidden_requests
from tests.support.videos import numbered_frames, write_video

pytestmark = pytest.mark.skipif(
    shutil.which("haproxy") is None, reason="needs HAProxy: apt-get install haproxy"
)

CAMERAS = [f"yard-{number}" for number in range(20)]


@dataclass(frozen=True)
class Deployment:
    """Two replicas behind a balancer."""

    replicas: tuple[Replica, Replica]
    balancer: Balancer
    folder: Path

    def client(self) -> httpx.Client:
        """A client of the balancer."""
        return httpx.Client(base_url=self.balancer.url, timeout=30)


@pytest.fixture(scope="module")
def deployment(index_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Deployment]:
    folder = tmp_path_factory.mktemp("deployment")
    with ExitStack() as stack:
        first, second = (
            stack.enter_context(Replica(index_path, folder / f"{number}.log")) for number in (1, 2)
        )
        balancer = Balancer(first.url, second.url, log=folder / "balancer.log")
        stack.enter_context(balancer)
        yield Deployment((first, second), balancer, folder)


@pytest.fixture
def client(deployment: Deployment) -> Iterator[httpx.Client]:
    with deployment.client() as client:
        yield client


def cameras_of(replica: Replica) -> set[str]:
    """The sessions that a replica itself lists."""
    cameras = httpx.get(f"{replica.url}/cameras").json()["cameras"]
    return {camera["camera_id"] for camera in cameras}


def logged(log: Path, identifier: str) -> dict[str, Any]:
    """The line of a log that names a request; it may come after the answer."""
    eventually(lambda: identifier in log.read_text())
    line = next(line for line in log.read_text().splitlines() if identifier in line)
    return dict(json.loads(line))


@pytest.mark.parametrize(
    "servers",
    [{"REPLICA_1": "127.0.0.1:1", "REPLICA_2": "127.0.0.1:2"}, {"REPLICAS_DNS": "replicas:8000"}],
    ids=["listed", "named"],
)
def test_the_configuration_is_valid_without_a_warning(servers: dict[str, str]) -> None:
    checked = run("haproxy", "-c", "-f", CONFIGURATION, **servers)
    assert checked.returncode == 0, checked.stderr
    assert "[WARNING]" not in checked.stderr


@pytest.mark.slow
class TestRouting:
    def test_a_camera_stays_on_one_replica(
        self, deployment: Deployment, client: httpx.Client, photo: Photo
    ) -> None:
        names = [f"stays-{number}" for number in range(20)]
        states = [[send(client, photo, name).headers["x-session"] for name in names]]
        held = [cameras_of(replica) & set(names) for replica in deployment.replicas]
        assert held[0] | held[1] == set(names)
        assert not held[0] & held[1]
        assert all(held)
        # Over any connection.
        with deployment.client() as other:
            states += [[send(c, photo, name).headers["x-session"] for name in names]
                       for c in (client, other)]  # fmt: skip
        assert states == [["new"] * 20, ["warm"] * 20, ["warm"] * 20]
        assert held == [cameras_of(replica) & set(names) for replica in deployment.replicas]

    @pytest.mark.parametrize(
        "path", ["/cameras/gate%2D2", "/cameras/%67ate-2", "/cameras%2Fgate-2", "/cameras/gate-2?"]
    )
    def test_every_spelling_of_a_path_finds_the_session(
        self, client: httpx.Client, photo: Photo, path: str
    ) -> None:
        send(client, photo, "gate-2")
        assert client.get(path).json()["camera_id"] == "gate-2"

    def test_a_camera_header_selects_a_replica(self, client: httpx.Client, photo: Photo) -> None:
        for name in CAMERAS:
            headers = {"X-Camera-ID": name}
            answers = [
                client.post("/pose", files=photo.files, headers=headers),
                client.post("/pose/overlay", files=photo.files, headers=headers),
                send(client, photo, name),
            ]
            assert [answer.status_code for answer in answers] == [200] * 3
            assert len({answer.headers["x-replica"] for answer in answers}) == 1

    def test_other_frames_are_spread(self, client: httpx.Client, photo: Photo) -> None:
        answers = [client.post("/pose", files=photo.files) for _ in range(8)]
        assert {answer.headers["x-replica"] for answer in answers} == {"pose-1", "pose-2"}


@pytest.mark.slow
class TestPassing:
    def test_both_logs_share_the_request_id(
        self, deployment: Deployment, client: httpx.Client
    ) -> None:
        answer = client.get("/index", headers={"X-Forwarded-For": "1.2.3.4"})
        identifier = answer.headers["x-request-id"]
        log = {"pose-1": "1.log", "pose-2": "2.log"}[answer.headers["x-replica"]]
        services = logged(deployment.folder / log, identifier)
        balancers = logged(deployment.folder / "balancer.log", identifier)
        assert services["request_id"] == balancers["request_id"] == identifier
        assert (balancers["path"], balancers["status"]) == ("/index", 200)
        assert balancers["replica"] == answer.headers["x-replica"]
        # The client's own claim is ignored.
        assert services["client"] == balancers["client"] == "127.0.0.1"

    def test_a_video_is_answered_line_by_line(
        self, deployment: Deployment, client: httpx.Client, tmp_path: Path
    ) -> None:
        video = write_video(tmp_path / "v.avi", numbered_frames(2, 240, 320) * 200)
        with client.stream("POST", "/sequence", files={"video": video}) as answer:
            lines = answer.iter_lines()
            assert json.loads(next(lines))["frame_index"] == 0
            metrics = [httpx.get(f"{replica.url}/metrics").text for replica in deployment.replicas]
            assert any("\npose_sequences 1.0\n" in text for text in metrics)
            *_, end = lines
            assert json.loads(end)["frames"] == 400

    def test_a_request_hidden_in_a_body_is_not_carried_out(
        self, client: httpx.Client, photo: Photo
    ) -> None:
        address = client.base_url
        check_hidden_requests(
            client, lambda: socket.create_connection((address.host, address.port)), photo
        )

    def test_metrics_come_from_each_replica(
        self, deployment: Deployment, client: httpx.Client
    ) -> None:
        for path in ("/metrics", "/%6Detrics"):
            check_problem(client.get(path), 404)
        metrics = httpx.get(f"{deployment.balancer.operations_url}/metrics").text
        assert 'haproxy_server_status{proxy="cameras",server="pose-1",state="UP"} 1' in metrics


@pytest.mark.slow
def test_one_replica_is_killed_and_comes_back(
    deployment: Deployment, client: httpx.Client, photo: Photo
) -> None:
    for name in CAMERAS:
        send(client, photo, name)
    survivor, killed = deployment.replicas
    kept, lost = (sorted(cameras_of(replica) & set(CAMERAS)) for replica in deployment.replicas)
    clients = 3
    senders = BackgroundLoop(
        deployment.balancer.url, lambda client: client.post("/pose", files=photo.files), clients
    )
    with senders:
        time.sleep(0.5)
        killed.kill()
        states = {name: send(client, photo, name).headers["x-session"] for name in CAMERAS}
        assert states == dict.fromkeys(kept, "warm") | dict.fromkeys(lost, "new")
        assert cameras_of(survivor) >= set(CAMERAS)
        assert {send(client, photo, name).headers["x-session"] for name in lost} == {"warm"}
        time.sleep(1.5)  # By now the health check has noticed.
    answers = senders.responses

    answered = [answer for answer in answers if answer.status_code == 200]
    # Only requests at the killed replica fail: HAProxy answers them with a 502 or, if the client's
    # connection has carried requests before, closes it.
    assert len(answers) + senders.broken - len(answered) <= clients
    for answer in answers:
        if answer not in answered:
            check_problem(answer, 502)
            assert answer.headers["retry-after"] == "1"
    assert len(answered) > 20
    entries = [answer.json()["persons"][0]["hypotheses"][0]["entry"] for answer in answered]
    assert set(entries) == {photo.entry}

    with killed:
        eventually(lambda: client.get(f"/cameras/{lost[0]}").headers["x-replica"] == "pose-2")
        states = {name: send(client, photo, name).headers["x-session"] for name in CAMERAS}
        assert states == dict.fromkeys(kept, "warm") | dict.fromkeys(lost, "new")
        assert cameras_of(killed) == set(lost)


@pytest.mark.slow
def test_without_replicas_a_503_has_retry_after(index_path: Path, photo: Photo) -> None:
    with (
        Replica(index_path) as replica,
        Balancer(replica.url, "http://127.0.0.1:1") as balancer,
        httpx.Client(base_url=balancer.url, timeout=30) as client,
    ):
        send(client, photo)
        replica.kill()
        for answer in (send(client, photo), client.post("/pose", files=photo.files)):
            check_problem(answer, 503)
            assert answer.headers["retry-after"] == "1"
        eventually(lambda: httpx.get(f"{balancer.operations_url}/readyz").status_code == 503)
