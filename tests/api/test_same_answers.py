"""Equal requests have equal answers; mirrored or rotated frames have such answers."""

import importlib
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import httpx
import numpy as np
import pytest
from fastapi.testclient import TestClient
from numpy.typing import NDArray

from app.estimation.upload import Upload
from app.networks.tflite import TfliteNetwork
from app.photograph import Estimator, load_estimator
from app.scheduling.executor import Executor
from app.scheduling.job import Job
from app.settings import Settings
from app.vision.geometry import Box
from index.skeleton import NATIVE, other_side
from index.store import PoseIndex
from tests.conftest import ROOT, WALKERS, Photo, Server, photograph, png, running_server
from tests.golden.pictures import decode
from tests.support.rotation import rotate_points
from tests.support.service import Client

STREET = WALKERS.read_bytes()
YARD = ROOT / "tests" / "data" / "yard.jpg"
MASKS = (ROOT / "tests" / "data" / "walkers-mask.png").read_bytes()
BOTH = {"frame": STREET, "mask": MASKS}
SENT = {"mask": {"mask": MASKS}, "both": BOTH, "frame": {"frame": STREET}}
WALKER_PX = 70
"""The three walkers of the street are taller, the two distant people smaller."""

OTHER_SIDE = [NATIVE.names.index(other_side(name)) for name in NATIVE.names]
PHOTOS = (24, 72)


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
def processors(shipped_server: Server) -> Iterator[list[Client]]:
    """Clients of servers over the shipped index, on this processor and as on an older one."""
    with ExitStack() as stack:
        older = stack.enter_context(running_server(None, **older_processor()))
        yield [
            stack.enter_context(httpx.Client(base_url=server.url, timeout=60))
            for server in (shipped_server, older)
        ]


@pytest.fixture
def service(processors: list[Client]) -> Client:
    """A client of a service over the shipped index."""
    return processors[0]


def persons(
    client: Client, files: dict[str, bytes], path: str = "/pose", **params: Any
) -> list[dict[str, Any]]:
    """The people of an answer, from left to right."""
    response = client.post(path, files=files, params=params)
    assert response.status_code == 200, response.text
    answer: list[dict[str, Any]] = response.json()["persons"]
    return sorted(answer, key=lambda person: person["box"]["x"])


@pytest.mark.parametrize("sent", ["mask", "frame"])
def test_every_processor_gives_the_same_answer(processors: list[Client], sent: str) -> None:
    one, other = (persons(client, SENT[sent], n=14) for client in processors)
    assert one
    assert one == other


def test_one_thread_and_two_give_the_same_answer(
    settings: Settings, tiny_index: PoseIndex, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One for each pass of a network and one for the people of a frame, or two."""
    answers = []
    executor = Executor(frames=2, max_wait_s=60, timeout_s=60)
    for threads, job in ((1, Job()), (2, Job(parallel_map=executor.map))):
        monkeypatch.setattr("app.photograph.available_cores", lambda t=threads: t)
        estimator = load_estimator(settings, lambda: tiny_index)
        people = estimator.estimate(Upload(STREET), 7, job).persons
        answers.append([(h.entry_id, h.distance, *h.points_2d.ravel())
                        for person in people for h in person.hypotheses])  # fmt: skip
    executor.shut_down()
    assert len(answers[0]) >= 3 * 7
    np.testing.assert_allclose(answers[0], answers[1], rtol=1e-3)


def test_the_rounding_of_networks_changes_no_first_hypothesis(
    shipped: Estimator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Processors sum in another order, which changes the last digits of what a network gives."""
    photographs = [WALKERS.read_bytes(), YARD.read_bytes()]

    def first() -> list[tuple[int, bool]]:
        found = [shipped.estimate(Upload(one), 1, Job()).persons for one in photographs]
        best = [person.hypotheses[0] for people in found for person in people]
        return [(one.entry_id, one.mirrored) for one in best]

    before, run, rng = first(), TfliteNetwork.run, np.random.default_rng(0)

    def rounded(self: TfliteNetwork, *images: NDArray[np.float32]) -> list[NDArray[np.float32]]:
        outputs = run(self, *images)
        return [np.float32(one * rng.choice([1 - 3e-7, 1 + 3e-7], one.shape)) for one in outputs]

    monkeypatch.setattr(TfliteNetwork, "run", rounded)
    assert len(before) >= 5
    for _ in range(2):
        assert first() == before


@pytest.mark.parametrize(
    ("sent", "evidence"), [("mask", "photograph"), ("both", "silhouette"), ("frame", "photograph")]
)
def test_a_sessions_first_frame_has_the_hypotheses_of_a_photograph(
    service: Client, sent: str, evidence: str
) -> None:
    path = f"/cameras/{sent}-{evidence}"
    options = {"evidence": evidence}
    alone = persons(service, SENT[sent], **options)
    tracked = persons(service, SENT[sent], f"{path}/frames", **options)
    service.delete(path)
    for one, other in zip(alone, tracked, strict=True):
        for name in ("source", "silhouette", "observed_keypoints", "hypotheses"):
            assert one[name] == other[name], name
        if sent == "frame" and evidence == "photograph":
            # A tracked person has the box of the body, not the detector's.
            assert Box(**one["box"]).iou(Box(**other["box"])) > 0.6
        else:
            assert one["box"] == other["box"]


def test_the_count_of_hypotheses_changes_nothing_else(client: TestClient) -> None:
    many = persons(client, {"frame": STREET}, n=14)
    for n in (1, 7):
        for few, person in zip(persons(client, {"frame": STREET}, n=n), many, strict=True):
            # Nothing else depends on the count either.
            assert few == {**person, "hypotheses": person["hypotheses"][:n]}


def changed(image: bytes, change: Any) -> bytes:
    return png(np.ascontiguousarray(change(decode(image))))


def joints(hypothesis: dict[str, Any], axes: int) -> NDArray[np.float64]:
    places = hypothesis[f"joints_{axes}d"]
    return np.array([[joint[axis] for axis in "xyz"[:axes]] for joint in places])


def apart(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(one - other, axis=1).mean())


# By the silhouette alone only rounding differs; the networks are only nearly symmetric.
@pytest.mark.parametrize(
    ("sent", "heights", "metres"), [("mask", 0.005, 0.01), ("frame", 0.06, 0.15)]
)
def test_a_mirrored_photograph_has_the_mirrored_answer(
    service: Client, sent: str, heights: float, metres: float
) -> None:
    here = persons(service, SENT[sent])
    width = 298
    flipped = {name: changed(image, lambda p: p[:, ::-1]) for name, image in SENT[sent].items()}
    there = persons(service, flipped)
    assert len(here) == len(there)

    def mirrored_middle(person: dict[str, Any]) -> float:
        return float(width - 1 - person["box"]["x"] - person["box"]["width"] / 2)

    for one in (one for one in here if one["box"]["height"] > WALKER_PX):
        middle = one["box"]["x"] + one["box"]["width"] / 2
        other = min(there, key=lambda person: abs(mirrored_middle(person) - middle))
        assert abs(mirrored_middle(other) - middle) < 3
        assert other["box"]["height"] == pytest.approx(one["box"]["height"], rel=0.05)
        fronts = [person["facing"]["front_probability"] > 0.5 for person in (one, other)]
        assert fronts[0] == fronts[1]
        best, same = (person["hypotheses"][0] for person in (one, other))
        picture = joints(same, 2)[OTHER_SIDE] * [-1, 1] + [width - 1, 0]
        assert apart(joints(best, 2), picture) < heights * one["box"]["height"]
        assert apart(joints(best, 3), joints(same, 3)[OTHER_SIDE] * [-1, 1, 1]) < metres
        if sent == "mask":
            assert same["entry"] == best["entry"]
            assert same["source"]["mirrored"] != best["source"]["mirrored"]


# A silhouette does not show which end is the head: upside down it has other poses.
@pytest.mark.parametrize(("sent", "quarter_turns"), [("mask", 1), ("frame", 1), ("frame", 2)])
def test_a_rotated_photograph_has_the_rotated_answer(
    service: Client, sent: str, quarter_turns: int
) -> None:
    """The seven hypotheses of a clearly detected person include the best of the upright person."""
    here = persons(service, SENT[sent])
    turned = {
        name: changed(image, lambda p: np.rot90(p, quarter_turns))
        for name, image in SENT[sent].items()
    }
    there = [
        one
        for one in persons(service, turned)
        if max(one["box"]["width"], one["box"]["height"]) > WALKER_PX
        and (one["detection_score"] is None or one["detection_score"] > 0.5)
    ]
    assert len(there) >= 2
    for person in there:
        gaps = [
            apart(rotate_points(joints(one["hypotheses"][0], 2), (320, 298), quarter_turns),
                  joints(hypothesis, 2)) / one["box"]["height"]
            for one in here for hypothesis in person["hypotheses"]
        ]  # fmt: skip
        assert min(gaps) < 0.04


@pytest.mark.parametrize("entry", PHOTOS)
def test_other_people_in_the_frame_do_not_matter(
    client: TestClient, tiny_index: PoseIndex, photo: Photo, entry: int
) -> None:
    other = photograph(tiny_index, entry, left=20)
    (alone,) = persons(client, {"mask": png(other.mask)})
    first, second = persons(client, {"mask": png(other.mask + 2 * photo.mask)})
    assert first == alone
    assert second["hypotheses"][0]["entry"] == photo.entry
