"""The joint network: its distributions, their exactness, and the likelihood of skeletons."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from index.network import (
    AXES,
    JOINT_BINS,
    Distributions,
    JointNetwork,
    Layer,
    log_softmax,
    network_input,
)
from index.skeleton import JOINTS
from index.store import PoseIndex
from tests.index.helpers import random_network


@pytest.fixture(scope="module")
def network() -> JointNetwork:
    return random_network(0)


def joints(columns: float, rows: float, depths: float, count: int = 1) -> NDArray[np.float64]:
    """Every joint at the same place, counted in bins."""
    places = zip(AXES, (columns, rows, depths), strict=True)
    return np.tile([axis.first + axis.step * at for axis, at in places], (count, JOINTS, 1))


def test_equals_plain_sums_bit_for_bit(network: JointNetwork, toy_index: PoseIndex) -> None:
    """The same layers, written as plain sums over the pixels of each window, twice as precise.

    Not a bit differs: whatever the order of its sums, a processor gives this.
    """
    silhouette = toy_index.silhouette(3)
    planes, mirrored = network_input(np.stack([silhouette, silhouette[:, ::-1]]))
    expected = summed(network, planes).mean(summed(network, mirrored).mirrored())
    seen = network.read(silhouette).joints
    assert_array_equal(seen.log_probabilities, expected.log_probabilities)


def summed(network: JointNetwork, planes: NDArray[np.float32]) -> Distributions:
    values = np.rint(127 * planes).astype(np.float64)
    *convolutions, hidden, output = network.layers
    for layer, (size, stride) in zip(convolutions, ((5, 2), (3, 2), (3, 2), (3, 1)), strict=True):
        margin = size // 2
        padded = np.pad(values, ((margin, margin), (margin, margin), (0, 0)))
        weights = layer.weights.reshape(size, size, values.shape[2], -1).astype(np.float64)
        rows, columns = -(-values.shape[0] // stride), -(-values.shape[1] // stride)
        sums = sum(
            padded[y : y + stride * rows : stride, x : x + stride * columns : stride]
            @ weights[y, x]
            for y in range(size)
            for x in range(size)
        )
        values = whole(scaled(layer, sums))
    sums = values.ravel() @ hidden.weights.astype(np.float64)
    sums = whole(scaled(hidden, sums)) @ output.weights.astype(np.float64)
    return Distributions(log_softmax(scaled(output, sums).reshape(JOINTS, JOINT_BINS)))


def scaled(layer: Layer, sums: NDArray[np.float64]) -> NDArray[np.float32]:
    return sums.astype(np.float32) * layer.factors + layer.offsets


def whole(values: NDArray[np.float32]) -> NDArray[np.float64]:
    return np.rint(values).clip(0, 127).astype(np.float64)


class TestPosteriorMeans:
    def test_product_of_two_normal_distributions(self) -> None:
        """In closed form: the product of two normal distributions."""
        logits = np.zeros((JOINTS, JOINT_BINS), np.float32)
        start = 0
        for axis in AXES:
            apart = np.arange(axis.bins) - axis.bins / 2
            logits[:, start : start + axis.bins] = -(apart**2) / (2 * 1.5**2)
            start += axis.bins
        prior = joints(14, 38, 15)
        steps = np.array([axis.step for axis in AXES])
        means = Distributions(log_softmax(logits)).posterior_means(prior, tuple(2 * steps))
        share = 2**2 / (2**2 + 1.5**2)
        expected = prior + share * (joints(16, 36, 16) - prior)
        assert_allclose(means, expected, atol=2e-3)


def test_expected_errors_equal_those_of_random_draws(
    network: JointNetwork, toy_index: PoseIndex
) -> None:
    seen, generator = network.read(toy_index.silhouette(3)).joints, np.random.default_rng(2)
    place = joints(14, 38, 15)
    columns, rows = (
        np.stack([generator.choice(axis.centres, 20_000, p=p / p.sum()) for p in np.exp(part)])
        for axis, part in zip(AXES[:2], seen.by_axis()[:2], strict=True)
    )
    squares = (columns - place[0, :, :1]) ** 2 + (rows - place[0, :, 1:2]) ** 2
    drawn = np.sqrt(squares.mean(axis=1)).mean()
    assert seen.expected_errors(place) == pytest.approx(drawn, rel=0.01)


def test_layers_of_other_shapes_are_refused(network: JointNetwork) -> None:
    with pytest.raises(ValueError, match="expected layers of shapes"):
        JointNetwork(network.layers[1:])
    with pytest.raises(ValueError, match="expected factors and offsets of shape"):
        JointNetwork.restore({**network.arrays(), "offsets1": np.zeros(3, np.float32)})


def test_layers_with_inexact_sums_are_refused() -> None:
    weights, ones = np.full((1100, 2), 127, np.float32), np.ones(2, np.float32)
    with pytest.raises(ValueError, match="expected sums below 16777216, got up to 17741900"):
        Layer(weights, ones, ones)
    weights[::2] *= -1
    Layer(weights, ones, ones)
