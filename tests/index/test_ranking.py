"""The order of hypotheses by a network."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from index.candidates import Candidates, RotatedQuery, find_candidates
from index.landmark_matching import match_landmarks
from index.modes import candidate_weights, find_modes
from index.network import RankingModel
from index.silhouette_matching import NetworkRanking
from index.skeleton import JOINTS, bone_lengths, rows
from index.store import PoseIndex
from tests.index.helpers import landmarks_of

(HEAD,) = rows("head")


@pytest.fixture
def silhouette(toy_index: PoseIndex) -> NDArray[np.uint8]:
    """Near an entry, but none."""
    silhouette = toy_index.silhouette(5)
    silhouette[60:70, 20:28] = 1
    return silhouette


@pytest.fixture
def ranking(reranker: RankingModel, silhouette: NDArray[np.uint8]) -> NetworkRanking:
    return NetworkRanking.of(dataclasses.replace(reranker, support_weight=2.0), silhouette)


@pytest.fixture
def candidates(toy_index: PoseIndex, silhouette: NDArray[np.uint8]) -> Candidates:
    return find_candidates(toy_index, [RotatedQuery.of(silhouette, 0.0)], 60)


def test_the_less_likely_become_farther(ranking: NetworkRanking, candidates: Candidates) -> None:
    modes = find_modes(candidates, candidate_weights(candidates.distances), 5, candidates.offsets)
    ordered, distances = ranking.order(modes, 5)
    assert distances.tolist() == sorted(distances)
    longer, likelihoods = distances / ordered.distances, ranking.log_likelihood(ordered)
    assert (np.argsort(longer) == np.argsort(-likelihoods)).all()
    assert longer.min() == 1
    fewer, _ = ranking.order(modes, 3)
    assert fewer.centres.tolist() == ordered.centres[:3].tolist()


def test_fit_makes_joints_likelier_and_keeps_bone_lengths(
    ranking: NetworkRanking, candidates: Candidates
) -> None:
    modes = find_modes(candidates, candidate_weights(candidates.distances), 5, candidates.offsets)
    fitted = ranking.fit(modes)
    assert (ranking.log_likelihood(fitted) > ranking.log_likelihood(modes)).all()
    for before, after in zip(modes.points_3d, fitted.points_3d, strict=True):
        assert_allclose(bone_lengths(after), bone_lengths(before), rtol=1e-6)
        assert_allclose(after[JOINTS:] - after[HEAD], before[JOINTS:] - before[HEAD], atol=1e-9)


def test_network_is_not_used_with_landmarks(toy_index: PoseIndex, reranked: PoseIndex) -> None:
    entry = toy_index.entry(5)
    landmarks = landmarks_of(entry.points_normalised, entry.points_3d)
    plain, other = (
        match_landmarks(index, index.silhouette(5), 3, landmarks) for index in (toy_index, reranked)
    )
    for one, same in zip(plain.hypotheses, other.hypotheses, strict=True):
        assert one.silhouette_distance == same.silhouette_distance
