"""Small networks of dense layers, run by NumPy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from app.networks.shipped import arrays_of


@dataclass(frozen=True)
class DenseNetwork:
    """A network with standardised inputs and with SiLU between its layers."""

    # (F,): means and scales of the inputs.
    means: NDArray[np.float32]
    scales: NDArray[np.float32]
    weights: tuple[NDArray[np.float32], ...]  # (I, O)
    biases: tuple[NDArray[np.float32], ...]  # (O,)

    def __post_init__(self) -> None:
        width = len(self.means)
        for weight, bias in zip(self.weights, self.biases, strict=True):
            if weight.shape != (width, len(bias)):
                raise ValueError(
                    f"expected weights of shape {(width, len(bias))}, got {weight.shape}"
                )
            width = len(bias)

    def __call__(self, features: NDArray[np.floating]) -> NDArray[np.float32]:
        """Outputs ``(N, O)`` of features ``(N, F)``."""
        values = ((features - self.means) / self.scales).astype(np.float32)
        for number, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            values = values @ weight + bias
            if number + 1 < len(self.weights):
                values = values / (1 + np.exp(-np.clip(values, -30, 30)))
        return values

    def arrays(self, name: str) -> dict[str, NDArray[np.float16 | np.float32]]:
        """Arrays that :meth:`of` reads: in half precision, except those of the standardisation."""
        stored: dict[str, NDArray[np.float16 | np.float32]] = {
            f"{name}.means": self.means,
            f"{name}.scales": self.scales,
        }
        for number, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            stored[f"{name}.weights.{number}"] = weight.astype(np.float16)
            stored[f"{name}.biases.{number}"] = bias.astype(np.float32)
        return stored

    @classmethod
    def of(cls, arrays: Mapping[str, NDArray[np.generic]], name: str) -> DenseNetwork:
        layers = sum(key.startswith(f"{name}.weights.") for key in arrays)

        def array(part: str) -> NDArray[np.float32]:
            return np.asarray(arrays[f"{name}.{part}"], np.float32)

        return cls(
            array("means"),
            array("scales"),
            tuple(array(f"weights.{number}") for number in range(layers)),
            tuple(array(f"biases.{number}") for number in range(layers)),
        )


@cache
def shipped_network(name: str) -> DenseNetwork:
    """The network of a file that ships and holds no other; raises like :func:`arrays_of`."""
    return DenseNetwork.of(arrays_of(name), name)
