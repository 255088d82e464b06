"""Networks that have learned nothing."""

from __future__ import annotations

import numpy as np

from index.network import LAYER_SHAPES, MOST, JointNetwork, Layer


def random_network(seed: int) -> JointNetwork:
    """A network of random weights whose values use their range."""
    generator = np.random.default_rng(seed)
    layers = []
    for inputs, outputs in LAYER_SHAPES:
        weights = generator.normal(scale=MOST / 4, size=(inputs, outputs))
        weights = np.rint(weights.clip(-MOST, MOST)).astype(np.float32)
        reached = MOST if len(layers) + 1 < len(LAYER_SHAPES) else 4
        factor = reached / (MOST / 4 * MOST * np.sqrt(inputs))
        offsets = generator.normal(scale=reached / 10, size=outputs)
        layers.append(
            Layer(weights, np.full(outputs, factor, np.float32), offsets.astype(np.float32))
        )
    return JointNetwork(tuple(layers))
