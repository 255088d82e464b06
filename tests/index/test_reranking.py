"""Hypotheses re-ranked by a network: their order, confidence, and the files beside an index."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from index.artefact import load_index, save_index
from index.candidates import Candidates, find_candidates
from index.confidence import Calibration
from index.files import ArtefactError
from index.keypoints import Keypoints
from index.matching import match
from index.modes import find_modes
from index.ranking import Ranking
from index.reranker import (
    FILES,
    MANIFEST,
    RERANKING_FEATURES,
    WEIGHTS,
    RankingModel,
    load_reranker,
    save_reranker,
)
from index.skeleton import JOINT_NAMES, JOINTS, NATIVE, pixels_per_metre
from index.store import PoseIndex
from tests.index.networks import random_network

ROOT = Path(__file__).resolve().parents[2]
HEAD = JOINT_NAMES.index("head")


def bone_lengths(skeleton: NDArray[np.float64]) -> NDArray[np.float64]:
    parents, children = np.array(NATIVE.bones).T
    return np.linalg.norm(skeleton[children] - skeleton[parents], axis=1)


@pytest.fixture(scope="module")
def reranker() -> RankingModel:
    count = len(RERANKING_FEATURES)
    calibration = Calibration((0.1,) * count, -0.2, RERANKING_FEATURES)
    return RankingModel(random_network(1), calibration, {"passes": 0})


@pytest.fixture(scope="module")
def reranked(toy_index: PoseIndex, reranker: RankingModel) -> PoseIndex:
    return dataclasses.replace(toy_index, reranker=reranker)


class TestRanking:
    @pytest.fixture
    def silhouette(self, toy_index: PoseIndex) -> NDArray[np.uint8]:
        """Near an entry, but none."""
        silhouette = toy_index.silhouette(5)
        silhouette[60:70, 20:28] = 1
        return silhouette

    @pytest.fixture
    def ranking(self, reranker: RankingModel, silhouette: NDArray[np.uint8]) -> Ranking:
        return Ranking.of(dataclasses.replace(reranker, support_weight=2.0), silhouette)

    @pytest.fixture
    def candidates(self, toy_index: PoseIndex, silhouette: NDArray[np.uint8]) -> Candidates:
        return find_candidates(toy_index, silhouette, 60)

    def test_the_likeliest_keeps_its_distance_and_the_others_become_farther(
        self, ranking: Ranking, candidates: Candidates
    ) -> None:
        modes = find_modes(candidates, 5)
        likelihoods, distances = ranking.log_likelihood(modes), ranking.distances(modes)
        others = np.arange(len(modes)) != likelihoods.argmax()
        assert distances[~others] == modes.distances[~others]
        assert (distances[others] > modes.distances[others]).all()
        # The less likely, the longer for its descriptor.
        longer = distances / modes.distances
        assert (np.argsort(longer) == np.argsort(-likelihoods)).all()

    def test_support_is_one_for_the_likeliest_and_less_for_others(
        self, ranking: Ranking, candidates: Candidates
    ) -> None:
        likelihoods, support = ranking.log_likelihood(candidates), ranking.support(candidates)
        assert support is not None
        assert support.max() == support[likelihoods.argmax()] == 1
        assert (np.argsort(support) == np.argsort(likelihoods)).all()

    def test_support_without_a_weight_changes_nothing(
        self, reranker: RankingModel, silhouette: NDArray[np.uint8], candidates: Candidates
    ) -> None:
        plain = dataclasses.replace(reranker, support_weight=0.0)
        assert Ranking.of(plain, silhouette).support(candidates) is None

    def test_a_fit_makes_joints_likelier_and_keeps_the_bones(
        self, ranking: Ranking, candidates: Candidates
    ) -> None:
        modes = find_modes(candidates, 5)
        fitted = ranking.fitted(modes)
        assert (ranking.log_likelihood(fitted) > ranking.log_likelihood(modes)).all()
        for before, after in zip(modes.points_3d, fitted.points_3d, strict=True):
            assert_allclose(bone_lengths(after), bone_lengths(before), rtol=1e-6)
            assert_allclose(after[JOINTS:] - after[HEAD], before[JOINTS:] - before[HEAD], atol=1e-9)

    def test_a_fit_moves_the_skeleton_and_its_picture_alike(
        self, ranking: Ranking, candidates: Candidates
    ) -> None:
        modes = find_modes(candidates, 5)
        fitted = ranking.fitted(modes)
        metres = (fitted.points_3d - modes.points_3d)[..., :2]
        pixels = fitted.points_normalised - modes.points_normalised
        scale = pixels_per_metre(modes.points_3d, modes.points_normalised)[:, None, None]
        assert_allclose(pixels - pixels[:, :1], metres * scale, atol=1e-9)


class TestMatch:
    def test_keypoints_are_matched_without_the_network(
        self, toy_index: PoseIndex, reranked: PoseIndex
    ) -> None:
        entry = toy_index.entry(5)
        rows = np.arange(JOINTS)
        keypoints = Keypoints(
            tuple(rows.tolist()), entry.points_normalised[:JOINTS], np.ones(JOINTS)
        )
        plain, other = (
            match(index, index.silhouette(5), 3, keypoints) for index in (toy_index, reranked)
        )
        assert_array_equal(plain.features, other.features)
        assert [h.distance for h in plain.hypotheses] == [h.distance for h in other.hypotheses]


@pytest.fixture
def saved(toy_index: PoseIndex, reranker: RankingModel, tmp_path: Path) -> Path:
    folder = tmp_path / "artefact"
    save_index(toy_index, folder)
    save_reranker(reranker, folder)
    return folder


class TestFiles:
    def test_loads_what_was_saved(self, saved: Path, reranker: RankingModel) -> None:
        back = load_index(saved).reranker
        assert back is not None
        assert back.calibration == reranker.calibration
        assert back.training == reranker.training
        assert_array_equal(back.network.layers[-1].offsets, reranker.network.layers[-1].offsets)

    def test_the_files_and_the_version_of_the_index_stay(
        self, toy_index: PoseIndex, reranker: RankingModel, tmp_path: Path
    ) -> None:
        version = save_index(toy_index, tmp_path / "index")
        before = {file: file.read_bytes() for file in (tmp_path / "index").iterdir()}
        save_reranker(reranker, tmp_path / "index")
        assert load_index(tmp_path / "index").version == version
        assert all(file.read_bytes() == content for file, content in before.items())

    def test_an_index_is_saved_with_its_network(
        self, reranked: PoseIndex, saved: Path, tmp_path: Path
    ) -> None:
        save_index(reranked, tmp_path / "again")
        assert all(
            (tmp_path / "again" / name).read_bytes() == (saved / name).read_bytes()
            for name in FILES
        )

    def test_an_index_may_have_none(self, toy_index: PoseIndex, tmp_path: Path) -> None:
        save_index(toy_index, tmp_path / "plain")
        assert load_reranker(tmp_path / "plain") is None
        assert load_index(tmp_path / "plain").reranker is None


def altered(content: bytes) -> bytes:
    return content[:1000] + bytes([content[1000] ^ 1]) + content[1001:]


def manifest_with(**changed: object) -> Callable[[bytes], bytes]:
    return lambda content: json.dumps({**json.loads(content), **changed}).encode()


@pytest.mark.parametrize(
    ("file", "change", "said"),
    [
        (WEIGHTS, altered, "reranking.npz was altered: its SHA-256 does not fit"),
        (WEIGHTS, None, "reranking.npz cannot be read: No such file"),
        (MANIFEST, None, "lacks its manifest reranking.json"),
        *((MANIFEST, lambda _, text=text: text, "reranking.json")
          for text in (b"", b"[]", b"{}", b'{"format_version": 2}')),
        (MANIFEST, manifest_with(format_version=9), "has format 9, this service reads format 2"),
        (MANIFEST, manifest_with(confidence={"features": ["shoe_size"], "weights": [1], "bias": 0}),
         "expected a calibration over"),
    ],
)  # fmt: skip
def test_a_damaged_network_is_refused_in_a_sentence(
    saved: Path, file: str, change: Callable[[bytes], bytes] | None, said: str
) -> None:
    if change is None:
        (saved / file).unlink()
    else:
        (saved / file).write_bytes(change((saved / file).read_bytes()))
    with pytest.raises(ArtefactError, match=said) as error:
        load_index(saved)
    assert "\n" not in str(error.value)


def test_threads_change_nothing(reranked: PoseIndex, tmp_path: Path) -> None:
    """Log-likelihoods on one thread and on two are the same but for their own sums."""
    save_index(reranked, tmp_path / "index")
    code = (
        "import sys, numpy as np\n"
        "from pathlib import Path\n"
        "from index.artefact import load_index\n"
        "from index.network import joint_positions\n"
        "index = load_index(Path(sys.argv[1]))\n"
        "seen = index.reranker.network.distributions(index.silhouette(3))\n"
        "positions = joint_positions(*index.points(np.arange(50)))\n"
        "print(*seen.log_likelihood(positions).tolist())\n"
    )
    answers = []
    for threads in ("1", "2"):
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": threads, "OMP_NUM_THREADS": threads}
        done = subprocess.run(
            [sys.executable, "-c", code, str(tmp_path / "index")],
            env=environment, cwd=ROOT, capture_output=True, text=True, check=True,
        )  # fmt: skip
        answers.append([float(word) for word in done.stdout.split()])
    assert_allclose(*answers, rtol=1e-12)
