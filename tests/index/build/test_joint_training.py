"""Training the network of joints: examples that stay true, and a loss that falls."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

torch = pytest.importorskip("torch", reason="needs the build extra: torch")

from index.build.joint_training import (  # noqa: E402
    Course,
    Examples,
    _channels_first,
    _exported,
    _layers,
    _start_from,
    train,
)
from index.joint_network import AXES, BINS, log_softmax, network_input  # noqa: E402
from index.skeleton import JOINTS  # noqa: E402
from index.store import PoseIndex  # noqa: E402
from tests.index.networks import random_network  # noqa: E402


@pytest.fixture(scope="module")
def examples(toy_index: PoseIndex) -> Examples:
    return Examples.of(toy_index, np.arange(0, len(toy_index), 4), np.random.default_rng(0))


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


def test_half_of_the_examples_are_mirrored(examples: Examples) -> None:
    (one,) = np.flatnonzero(~examples.stood_up)[:1]
    _, truth = examples.take(np.full(400, one), np.random.default_rng(1))
    _, counts = np.unique(truth, axis=0, return_counts=True)
    assert len(counts) == 2
    assert counts.min() > 160


def test_the_exported_network_gives_what_the_trained_one_gives(toy_index: PoseIndex) -> None:
    torch.manual_seed(0)
    layers = _layers()
    planes = network_input(toy_index.silhouettes(np.arange(32)))
    # Statistics of the normalisations, which the export takes up.
    layers(_channels_first(planes))
    layers.eval()
    with torch.no_grad():
        logits = layers(_channels_first(planes[:1])).numpy().reshape(JOINTS, BINS)
    seen = _exported(layers).distributions(toy_index.silhouette(0))
    assert_allclose(seen.log_probabilities, log_softmax(logits), atol=1e-4)


def test_training_may_go_on_from_a_trained_network(examples: Examples) -> None:
    network, layers = random_network(4), _layers()
    planes, _ = examples.take(np.arange(64), np.random.default_rng(1))
    _start_from(layers, network, planes)
    back = _exported(layers)
    for ours, theirs in zip(
        (*back.kernels, *back.biases), (*network.kernels, *network.biases), strict=True
    ):
        assert_allclose(ours, theirs, atol=1e-4)
    assert_array_equal(back.hidden, network.hidden)
    assert_array_equal(back.output, network.output)


@pytest.mark.slow
def test_training_finds_the_joints_likelier_and_gives_the_same_twice(toy_index: PoseIndex) -> None:
    rows = np.arange(len(toy_index))
    trained, again = (train(toy_index, rows, Course(passes=4.0, batch=32)) for _ in range(2))
    assert_array_equal(trained.output, again.output)
    untrained = train(toy_index, rows, Course(passes=0.01, batch=32))
    likelihoods = [
        np.mean(
            [
                network.distributions(toy_index.silhouette(row)).log_likelihood(
                    *toy_index.points(np.array([row]))
                )
                for row in range(0, len(toy_index), 20)
            ]
        )
        for network in (trained, untrained)
    ]
    assert likelihoods[0] > likelihoods[1] + 0.3
