"""The paper's protocol: what counts as recognised."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("pybvh", reason="needs the test extra: pybvh")

from index.build.simulate import Simulation
from index.build.writer import compress
from index.skeleton import POINTS
from index.store import ENTRY_DTYPE, SKELETON_DTYPE
from scripts.experiments.paper_data import joint_errors, recognised

FRAMES, BODIES, VIEWS = 12, 2, 3


@pytest.fixture
def filmed() -> Simulation:
    """Two clips of twelve frames on two bodies before three cameras; skeletons are points."""
    count = 2 * FRAMES * BODIES
    labels = np.zeros(count, SKELETON_DTYPE)
    labels["clip"] = np.arange(count) // (FRAMES * BODIES)
    labels["frame"] = np.arange(count) // BODIES % FRAMES * 2
    labels["subject"] = np.arange(count) % BODIES
    entries = np.zeros(count * VIEWS, ENTRY_DTYPE)
    entries["skeleton"] = np.repeat(np.arange(count), VIEWS)
    entries["distance"], entries["scale"] = 5, 60
    skeletons = np.zeros((count, POINTS, 3), np.float16)
    skeletons[:, :, 1] = 0.05 * np.arange(count)[:, None]
    silhouettes = compress(np.zeros((len(entries), 768), np.uint8))
    return Simulation(silhouettes, entries, skeletons, labels, ("a", "b"), ("x", "y"), ("walk",))


def test_joint_errors_are_distances_in_the_frame(filmed: Simulation) -> None:
    # Skeletons are 5 cm apart, 60 px a metre, all in the plane through the pelvis.
    own = np.arange(len(filmed))[:, None]
    assert joint_errors(filmed, filmed, own).max() < 1e-3
    errors = joint_errors(filmed, filmed, (own + VIEWS) % len(filmed))
    assert errors[0, 0] == pytest.approx(3.0, abs=0.01)


def test_recognised_counts_queries_with_one_of_n_under_5_px() -> None:
    errors = np.array([[4.9, 9.0], [5.0, 1.0], [9.0, np.inf], [0.0, 0.0]])
    assert recognised(errors, 1) == 50.0
    assert recognised(errors, 2) == 75.0
