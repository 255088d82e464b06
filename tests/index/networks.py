"""Networks that have learned nothing."""

from __future__ import annotations

import numpy as np

from index.joint_network import BINS, CONVOLUTIONS, HIDDEN, JointNetwork
from index.skeleton import JOINTS


def random_network(seed: int) -> JointNetwork:
    """A network of random weights that keep values in the range of one."""
    generator = np.random.default_rng(seed)

    def layer(inputs: int, outputs: int) -> np.ndarray:
        weights = generator.normal(size=(inputs, outputs)) * np.sqrt(2 / inputs)
        return weights.astype(np.float32)

    kernels, biases, channels = [], [], 3
    for size, _, features in CONVOLUTIONS:
        kernels.append(layer(size * size * channels, features))
        biases.append(generator.normal(size=features).astype(np.float32) / 10)
        channels = features
    flat, outputs = 8 * 3 * channels, JOINTS * BINS
    return JointNetwork(
        tuple(kernels), tuple(biases), layer(flat, HIDDEN), np.zeros(HIDDEN, np.float32),
        layer(HIDDEN, outputs), np.zeros(outputs, np.float32),
    )  # fmt: skip
