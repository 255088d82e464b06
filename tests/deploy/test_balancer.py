"""Two service processes behind HAProxy with ``deploy/haproxy.cfg``."""

import shutil
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest

from tests.conftest import Photo
from tests.support.balancer import CONFIGURATION, Balancer, Replica
from tests.support.programs import run
from tests.support.service import check_problem, eventually, send

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
def test_a_camera_stays_on_one_replica_until_it_is_killed(
    deployment: Deployment, client: httpx.Client, photo: Photo
) -> None:
    def states() -> dict[str, str]:
        return {name: send(client, photo, name).headers["x-session"] for name in CAMERAS}

    assert states() == dict.fromkeys(CAMERAS, "new")
    survivor, killed = deployment.replicas
    kept, lost = (cameras_of(replica) for replica in deployment.replicas)
    assert kept | lost == set(CAMERAS) and kept and lost and not kept & lost
    assert states() == dict.fromkeys(CAMERAS, "warm")
    for name in CAMERAS[:4]:
        named = client.post("/pose", files=photo.files, headers={"X-Camera-ID": name})
        assert named.headers["x-replica"] == ("pose-1" if name in kept else "pose-2")
    spread = [client.post("/pose", files=photo.files) for _ in range(8)]
    assert {answer.headers["x-replica"] for answer in spread} == {"pose-1", "pose-2"}
    killed.kill()
    assert states() == dict.fromkeys(kept, "warm") | dict.fromkeys(lost, "new")
    assert cameras_of(survivor) == set(CAMERAS)
    with killed:
        one = min(lost)
        eventually(lambda: client.get(f"/cameras/{one}").headers["x-replica"] == "pose-2")
        assert states() == dict.fromkeys(kept, "warm") | dict.fromkeys(lost, "new")
        metrics = httpx.get(f"{deployment.balancer.operations_url}/metrics").text
        assert 'haproxy_server_status{proxy="cameras",server="pose-1",state="UP"} 1' in metrics
        check_problem(client.get("/metrics"), 404)
        survivor.kill()
        killed.kill()
        check_problem(client.post("/pose", files=photo.files), 503)
