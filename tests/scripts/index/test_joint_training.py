"""Training the network of joints: examples that stay true, and a loss that falls."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

pytest.importorskip("torch", reason="needs the build extra: torch")

from index.network import AXES, joint_positions, network_input
from index.store import PoseIndex
from scripts.training.train_reranker import Examples, TrainingConfig, in_whole_numbers, train


@pytest.fixture(scope="module")
def examples(body_index: PoseIndex) -> Examples:
    return Examples.of(body_index, np.arange(0, len(body_index), 4), np.random.default_rng(0))


def test_joints_lie_on_the_silhouettes_however_they_are_shown(examples: Examples) -> None:
    """Mirrored, turned, degraded or not: nearly every joint is on the person."""
    rows = np.arange(len(examples))
    planes, truth = examples.take(rows, np.random.default_rng(1))
    columns, lines = (
        np.rint((axis.first + axis.step * truth[..., position] - 0.5) / 2).astype(int)
        for position, axis in enumerate(AXES[:2])
    )
    inside = (columns >= 0) & (columns < 24) & (lines >= 0) & (lines < 64)
    columns, lines = columns.clip(0, 23), lines.clip(0, 63)
    on_person = planes[rows[:, None], lines, columns, 0] == 1
    assert (on_person & inside).mean() > 0.9


@pytest.mark.slow
def test_training_finds_the_joints_likelier_and_gives_the_same_twice(body_index: PoseIndex) -> None:
    rows = np.arange(len(body_index))
    trained, again = (
        train(body_index, rows, TrainingConfig(passes=4.0, batch=32)) for _ in range(2)
    )
    for ours, theirs in zip(trained.parameters(), again.parameters(), strict=True):
        assert_array_equal(ours.detach(), theirs.detach())
    untrained = train(body_index, rows, TrainingConfig(passes=0.01, batch=32))
    likelihoods = [
        np.mean(
            [
                network.read(body_index.silhouette(row)).joints.log_likelihood(
                    joint_positions(*body_index.points(np.array([row])))
                )
                for row in range(0, len(body_index), 20)
            ]
        )
        for network in (
            in_whole_numbers(layers, network_input(body_index.silhouettes(rows[:100])))
            for layers in (trained, untrained)
        )
    ]
    assert likelihoods[0] > likelihoods[1] + 0.3
