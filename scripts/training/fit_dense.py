"""Small fully connected networks, trained by PyTorch on one core."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.networks.dense import DenseNetwork
from scripts.training.loop import begin, optimise

Loss = Callable[[Any, Any], Any]
"""Outputs ``(B, O)`` and targets ``(B, T)`` as tensors to a mean."""


def fit_dense(
    features: NDArray[np.floating],
    targets: NDArray[np.floating],
    outputs: int,
    loss: Loss,
    *,
    hidden: tuple[int, ...],
    epochs: int,
    seed: int,
    batch: int = 256,
    rate: float = 1e-3,
    decay: float = 0.02,
    dropout: float = 0.1,
    noise: float = 0.1,
    initial: DenseNetwork | None = None,
) -> DenseNetwork:
    """Train a network; the same one for the same arguments.

    The loss is given targets ``(N, T)`` as they are. Layers between have the widths ``hidden``. The
    rate of AdamW rises and falls over the training. A share ``dropout`` of the hidden values is
    left out, and noise is added to the standardised features ``(N, F)``. An initial network of the
    same widths is trained on.
    """
    import torch

    begin(seed)
    if initial is None:
        means = features.mean(axis=0, dtype=np.float64).astype(np.float32)
        scales = np.maximum(features.std(axis=0, dtype=np.float64), 1e-4).astype(np.float32)
    else:
        means, scales = initial.means, initial.scales
    inputs = torch.from_numpy(((features - means) / scales).astype(np.float32))
    truth = torch.from_numpy(targets.astype(np.float32))
    layers: list[Any] = []
    width = features.shape[1]
    for size in hidden:
        layers += [torch.nn.Linear(width, size), torch.nn.SiLU(), torch.nn.Dropout(dropout)]
        width = size
    last = torch.nn.Linear(width, outputs)
    torch.nn.init.zeros_(last.weight)
    torch.nn.init.zeros_(last.bias)
    network = torch.nn.Sequential(*layers, last)
    linear = [layer for layer in network if isinstance(layer, torch.nn.Linear)]
    if initial is not None:
        for layer, weight, bias in zip(linear, initial.weights, initial.biases, strict=True):
            layer.weight.data = torch.from_numpy(weight.T.copy())
            layer.bias.data = torch.from_numpy(bias.copy())
    count = max(1, len(inputs) // batch)

    def batches() -> Iterator[Any]:
        for _ in range(epochs):
            yield from torch.randperm(len(inputs)).split(batch)[:count]

    def loss_of(some: Any) -> Any:
        given = inputs[some]
        return loss(network(given + noise * torch.randn_like(given)), truth[some])

    steps = epochs * count
    optimise(network, batches(), loss_of, steps=steps, rate=rate, decay=decay, rise=0.1)
    return DenseNetwork(
        means,
        scales,
        tuple(layer.weight.detach().numpy().T.copy() for layer in linear),
        tuple(layer.bias.detach().numpy().copy() for layer in linear),
    )


def with_outputs(
    network: DenseNetwork, factors: NDArray[np.float64], offsets: NDArray[np.float64]
) -> DenseNetwork:
    """The same network, its outputs multiplied by factors ``(O,)``, then offsets added."""
    *weights, weight = network.weights
    *biases, bias = network.biases
    by = factors.astype(np.float32)
    moved = (bias * by + offsets).astype(np.float32)
    return DenseNetwork(network.means, network.scales, (*weights, weight * by), (*biases, moved))


def averaged(networks: Sequence[DenseNetwork]) -> DenseNetwork:
    """One network that gives the mean of several with one hidden layer and the same inputs."""
    first = networks[0]
    if any(len(network.weights) != 2 for network in networks):
        raise ValueError("expected networks with one hidden layer")
    last = np.concatenate([network.weights[1] for network in networks])
    return DenseNetwork(
        first.means,
        first.scales,
        (
            np.concatenate([network.weights[0] for network in networks], axis=1),
            np.asarray(last / len(networks), np.float32),
        ),
        (
            np.concatenate([network.biases[0] for network in networks]),
            np.mean([network.biases[1] for network in networks], axis=0, dtype=np.float32),
        ),
    )


def half_way(one: DenseNetwork, other: DenseNetwork) -> DenseNetwork:
    """The network with the mean weights of two that scale their inputs alike."""
    weights, biases = midway(one.weights, other.weights), midway(one.biases, other.biases)
    return DenseNetwork(one.means, one.scales, weights, biases)


def midway(
    some: Sequence[NDArray[np.float32]], others: Sequence[NDArray[np.float32]]
) -> tuple[NDArray[np.float32], ...]:
    """The means of as many pairs of arrays."""
    return tuple(np.asarray((a + b) / 2, np.float32) for a, b in zip(some, others, strict=True))
