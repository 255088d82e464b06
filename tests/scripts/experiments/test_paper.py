"""Answers to the paper's queries: the nearest of some candidates, gathered into distinct poses."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("pybvh", reason="needs the test extra: pybvh")

from index.candidates import Candidates
from index.skeleton import POINTS
from scripts.experiments.paper import ranked_modes

CLUSTERS, EACH = 4, 5


@pytest.fixture
def candidates() -> Candidates:
    """Four poses a metre apart, five entries near each; the query is in the middle of the last."""
    rng = np.random.default_rng(0)
    pose = np.repeat(np.arange(CLUSTERS), EACH)
    points = np.zeros((len(pose), POINTS, 3))
    points[:, 1:, 0] = pose[:, None] + 0.01 * rng.standard_normal((len(pose), 1))
    vectors = np.zeros((len(pose), 8), np.float32)
    vectors[np.arange(len(pose)), pose] = 3.0
    vectors += rng.normal(0, 0.1, vectors.shape).astype(np.float32)
    query = vectors[pose == CLUSTERS - 1].mean(axis=0)
    distances = np.linalg.norm(vectors - query, axis=1).astype(np.float64)
    order = np.argsort(distances)
    return Candidates(
        pose[order], np.zeros(len(pose), bool), distances[order], vectors[order] - query,
        np.zeros(len(pose)), points[order], 10 * points[order][..., :2],
    )  # fmt: skip


def test_every_pose_is_answered_once_the_nearest_first(candidates: Candidates) -> None:
    modes = ranked_modes(candidates, 7)
    answered = candidates.entry_ids[modes.centres].tolist()
    assert answered[0] == CLUSTERS - 1
    assert sorted(answered) == list(range(CLUSTERS))
    assert np.diff(modes.distances).min() >= 0
    # Interpolated between the entries of the pose.
    assert modes.points_normalised[0, 5, 0] == pytest.approx(10 * (CLUSTERS - 1), abs=0.3)
