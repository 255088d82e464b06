"""The network that tells where joints may be: distributions, and what skeletons make of them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from index.joint_network import AXES, BINS, Distributions, JointNetwork, log_softmax, network_input
from index.skeleton import JOINTS, POINTS
from index.store import PoseIndex
from tests.index.networks import random_network


@pytest.fixture(scope="module")
def network() -> JointNetwork:
    return random_network(0)


def certain(columns: int, rows: int, depths: int) -> Distributions:
    """Every joint in the same bin, almost surely."""
    logits = np.zeros((JOINTS, BINS), np.float32)
    start = 0
    for axis, at in zip(AXES, (columns, rows, depths), strict=True):
        logits[:, start + at] = 12
        start += axis.bins
    return Distributions(log_softmax(logits))


def skeletons(
    columns: float, rows: float, depths: float, count: int = 1
) -> tuple[NDArray, NDArray]:
    points_3d, points_2d = np.zeros((count, POINTS, 3)), np.zeros((count, POINTS, 2))
    points_3d[..., 2] = AXES[2].first + AXES[2].step * depths
    points_2d[..., 0] = AXES[0].first + AXES[0].step * columns
    points_2d[..., 1] = AXES[1].first + AXES[1].step * rows
    return points_3d, points_2d


def test_probabilities_of_each_axis_sum_to_one(network: JointNetwork, toy_index: PoseIndex) -> None:
    seen = network.distributions(toy_index.silhouette(3)).log_probabilities
    assert seen.shape == (JOINTS, BINS)
    ends = np.cumsum([axis.bins for axis in AXES])[:-1]
    for part in np.split(np.exp(seen.astype(np.float64)), ends, axis=1):
        assert_allclose(part.sum(axis=1), 1, rtol=1e-5)


def test_convolutions_are_sums_over_windows(network: JointNetwork, toy_index: PoseIndex) -> None:
    """The same layers, written as plain sums over the pixels of each window."""
    planes = network_input(toy_index.silhouette(3)[None])[0].astype(np.float64)
    for kernel, bias, (size, stride) in zip(
        network.kernels, network.biases, ((5, 2), (3, 2), (3, 2), (3, 1)), strict=True
    ):
        margin = size // 2
        padded = np.pad(planes, ((margin, margin), (margin, margin), (0, 0)))
        weights = kernel.reshape(size, size, planes.shape[2], -1).astype(np.float64)
        rows, columns = -(-planes.shape[0] // stride), -(-planes.shape[1] // stride)
        sums = sum(
            padded[y : y + stride * rows : stride, x : x + stride * columns : stride]
            @ weights[y, x]
            for y in range(size)
            for x in range(size)
        )
        planes = np.maximum(sums + bias, 0)
    hidden = np.maximum(planes.ravel() @ network.hidden + network.hidden_bias, 0)
    logits = (hidden @ network.output + network.output_bias).reshape(JOINTS, BINS)
    seen = network.distributions(toy_index.silhouette(3)).log_probabilities
    assert_allclose(seen, log_softmax(logits.astype(np.float32)), atol=1e-4)


def test_sees_what_most_of_four_pixels_show(toy_index: PoseIndex) -> None:
    silhouette = toy_index.silhouette(3)
    doubled = np.repeat(np.repeat(silhouette[::2, ::2], 2, axis=0), 2, axis=1)
    assert_array_equal(network_input(doubled[None])[0, ..., 0], silhouette[::2, ::2])


def test_the_likeliest_place_is_where_the_network_sees_the_joints() -> None:
    seen = certain(10, 40, 16)
    (there,) = seen.log_likelihood(*skeletons(10, 40, 16))
    assert there == pytest.approx(seen.peak(), abs=1e-6)
    for other in ((12, 40, 16), (10, 43, 16), (10, 40, 11)):
        assert seen.log_likelihood(*skeletons(*other))[0] < there - 1


def test_likelihood_is_continuous_between_bins() -> None:
    seen = certain(10, 40, 16)
    values = [seen.log_likelihood(*skeletons(c, 40, 16))[0] for c in np.linspace(10, 11, 11)]
    steps = np.diff(values)
    assert_allclose(steps, steps[0], rtol=1e-3)


def test_places_beyond_the_bins_count_as_the_last_ones() -> None:
    seen = certain(0, 71, 31)
    ends, beyond = skeletons(0, 71, 31), skeletons(-20, 200, 90)
    assert_allclose(seen.log_likelihood(*ends), seen.log_likelihood(*beyond), rtol=1e-6)


def test_weights_survive_storing_but_for_their_rounding(network: JointNetwork) -> None:
    back = JointNetwork.restore(network.arrays())
    assert_allclose(back.kernels[0], network.kernels[0], rtol=1e-3, atol=1e-6)
    step = np.abs(network.hidden).max(axis=0) / 127
    assert (np.abs(back.hidden - network.hidden) <= 0.5001 * step).all()
    again = JointNetwork.restore(back.arrays())
    assert_allclose(again.output, back.output, atol=1e-7)


def test_layers_of_other_shapes_are_refused(network: JointNetwork) -> None:
    arrays = network.arrays()
    with pytest.raises(ValueError, match="expected layers of shapes"):
        JointNetwork.restore({**arrays, "bias1": np.zeros(3, np.float16)})
