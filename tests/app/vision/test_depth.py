"""The depth of landmarks, and the small networks that correct it."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

from app.networks.dense import DenseNetwork
from app.vision.depth import HIPS, decode_depths, network_depths


def dense(seed: int, sizes: tuple[int, ...]) -> DenseNetwork:
    generator = np.random.default_rng(seed)
    pairs = list(pairwise(sizes))
    return DenseNetwork(
        generator.normal(size=sizes[0]).astype(np.float32),
        generator.uniform(0.5, 2, sizes[0]).astype(np.float32),
        tuple(generator.normal(size=pair).astype(np.float32) for pair in pairs),
        tuple(generator.normal(size=pair[1]).astype(np.float32) for pair in pairs),
    )


def test_a_network_comes_back_from_its_arrays() -> None:
    network = dense(1, (7, 5, 3))
    arrays = network.arrays("one") | dense(2, (4, 2)).arrays("other")
    features = np.random.default_rng(3).normal(size=(6, 7))
    again = DenseNetwork.of(arrays, "one")
    assert_allclose(again(features), network(features), atol=0.05)
    assert again(features).shape == (6, 3)


def test_layers_that_do_not_fit_are_refused() -> None:
    one, other = dense(1, (7, 5)), dense(1, (4, 3))
    with pytest.raises(ValueError, match="expected weights of shape"):
        DenseNetwork(one.means, one.scales, one.weights + other.weights, one.biases + other.biases)


def test_no_residual_leaves_the_networks_depth() -> None:
    own = network_depths(np.random.default_rng(0).normal(size=(4, 39, 3)))
    depths, sigmas = decode_depths(np.zeros((4, 66)), own)
    assert_allclose(depths, own, atol=1e-12)
    assert_allclose(depths[:, HIPS].mean(axis=1), 0, atol=1e-12)
    assert_allclose(sigmas, 0.1)
