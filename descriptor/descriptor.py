"""The paper's descriptor and the discriminant one, behind a common interface.

References
----------
.. [1] D. F. Atrevi, D. Vivet, F. Duculty, B. Emile, "3D Human Poses Estimation from a
   Single 2D Silhouette", VISAPP 2016.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from descriptor.krawtchouk import diagonal_moments, moments, weighted_polynomials
from descriptor.silhouette import HEIGHT, WIDTH

Arrays = dict[str, NDArray[np.generic]]


class Descriptor(Protocol):
    """Interface of a descriptor: describes silhouettes and can be saved."""

    @property
    def name(self) -> str:
        """Its name in a manifest."""

    @property
    def dimension(self) -> int:
        """Length of a described silhouette."""

    def describe(self, silhouettes: NDArray[np.generic]) -> NDArray[np.float32]:
        """Vectors ``(B, dimension)`` of silhouettes ``(B, 128, 48)`` of 0 and 1."""

    def mirror(self, vectors: NDArray[np.float32]) -> NDArray[np.float32]:
        """Vectors of the mirrored silhouettes, from those of the silhouettes ``(B, dimension)``."""

    def parameters(self) -> dict[str, object]:
        """JSON values from which, with :meth:`arrays`, :func:`restore` rebuilds it."""

    def arrays(self) -> Arrays:
        """Learned arrays, by name."""


@dataclass(frozen=True)
class DiagonalDescriptor:
    """The paper's 48 values [1]_: diagonal moments of orders 0 to 23, in two regions of the body.

    ``p1 = 0.5`` centres the polynomials horizontally; ``p2 = 0.1`` concentrates the first 24 values
    on the upper body and ``p2 = 0.95`` the last 24 on the lower body.
    """

    orders: int = 24
    p1: float = 0.5
    p2: tuple[float, ...] = (0.1, 0.95)
    name: str = field(default="krawtchouk-diagonal", init=False)

    def __post_init__(self) -> None:
        _check_p1(self.p1)

    @property
    def dimension(self) -> int:
        return self.orders * len(self.p2)

    def describe(self, silhouettes: NDArray[np.generic]) -> NDArray[np.float32]:
        _check(silhouettes)
        horizontal = weighted_polynomials(self.orders, WIDTH, self.p1)
        vertical = [weighted_polynomials(self.orders, HEIGHT, p) for p in self.p2]
        return diagonal_moments(
            silhouettes, np.concatenate(vertical), np.tile(horizontal, (len(self.p2), 1))
        )

    def mirror(self, vectors: NDArray[np.float32]) -> NDArray[np.float32]:
        """Flip the sign of moments of odd horizontal order; requires ``p1 = 0.5``."""
        return vectors * np.tile(_signs(self.orders), len(self.p2))

    def parameters(self) -> dict[str, object]:
        return {"name": self.name, "orders": self.orders, "p1": self.p1, "p2": list(self.p2)}

    def arrays(self) -> Arrays:
        return {}


@dataclass(frozen=True)
class DiscriminantDescriptor:
    """A linear projection, learned from simulation, of a block of Krawtchouk moments."""

    # (D, F): projection of ``F = len(p2) * vertical_orders * horizontal_orders`` moments to ``D``
    # values. Each row uses either even or odd horizontal orders, so that mirroring a silhouette
    # only flips signs.
    projection: NDArray[np.float32]
    # Moments ``Q[n, m]`` with ``n < vertical_orders`` and ``m < horizontal_orders``.
    vertical_orders: int = 28
    horizontal_orders: int = 14
    p1: float = 0.5  # horizontal centre of the polynomials
    p2: tuple[float, ...] = (0.5,)  # vertical centres; each has its own block of moments
    name: str = field(default="krawtchouk-discriminant", init=False)
    parity: NDArray[np.float32] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        _check_p1(self.p1)
        expected = len(self.p2) * self.vertical_orders * self.horizontal_orders
        if self.projection.ndim != 2 or self.projection.shape[1] != expected:
            raise ValueError(
                f"expected a projection of shape (D, {expected}), got {self.projection.shape}"
            )
        odd = np.tile(_signs(self.horizontal_orders) < 0, len(self.p2) * self.vertical_orders)
        uses_odd, uses_even = (
            self.projection[:, odd].any(axis=1),
            self.projection[:, ~odd].any(axis=1),
        )
        if (uses_odd & uses_even).any():
            raise ValueError(
                "expected rows of the projection that use even or odd horizontal orders, "
                f"row {int((uses_odd & uses_even).argmax())} uses both"
            )
        object.__setattr__(self, "parity", np.where(uses_odd, -1, 1).astype(np.float32))

    @property
    def dimension(self) -> int:
        return len(self.projection)

    def describe(self, silhouettes: NDArray[np.generic]) -> NDArray[np.float32]:
        features = moment_block(
            silhouettes, self.vertical_orders, self.horizontal_orders, self.p1, self.p2
        )
        # Features are summed in float64, like the moments.
        return np.asarray(features.astype(np.float64) @ self.projection.T, np.float32)

    def mirror(self, vectors: NDArray[np.float32]) -> NDArray[np.float32]:
        """Flip the sign of values computed from moments of odd horizontal order."""
        return vectors * self.parity

    def parameters(self) -> dict[str, object]:
        return {
            "name": self.name,
            "vertical_orders": self.vertical_orders,
            "horizontal_orders": self.horizontal_orders,
            "p1": self.p1,
            "p2": list(self.p2),
        }

    def arrays(self) -> Arrays:
        return {"projection": self.projection}


def moment_block(
    silhouettes: NDArray[np.generic],
    vertical_orders: int,
    horizontal_orders: int,
    p1: float,
    p2: tuple[float, ...],
) -> NDArray[np.float32]:
    """Moments ``Q[n, m]`` below two orders, for each vertical centre: ``(B, F)`` float32."""
    _check(silhouettes)
    horizontal = weighted_polynomials(horizontal_orders, WIDTH, p1)
    vertical = np.concatenate([weighted_polynomials(vertical_orders, HEIGHT, p) for p in p2])
    return moments(silhouettes, vertical, horizontal).reshape(len(silhouettes), -1)


def restore(
    parameters: Mapping[str, object], arrays: Mapping[str, NDArray[np.generic]]
) -> Descriptor:
    """The descriptor that a manifest names, from what its methods of these names returned.

    Raises
    ------
    ValueError
        If the name is unknown or the parameters do not fit it.
    """
    name = parameters.get("name")
    try:
        p2 = tuple(float(p) for p in cast("list[float]", parameters["p2"]))
        p1 = float(cast(float, parameters["p1"]))
        if name == "krawtchouk-diagonal":
            return DiagonalDescriptor(cast(int, parameters["orders"]), p1, p2)
        if name == "krawtchouk-discriminant":
            return DiscriminantDescriptor(
                np.asarray(arrays["projection"], np.float32),
                cast(int, parameters["vertical_orders"]),
                cast(int, parameters["horizontal_orders"]),
                p1,
                p2,
            )
    except (KeyError, TypeError) as error:
        raise ValueError(f"the descriptor {name!r} lacks or misstates {error}") from error
    raise ValueError(
        f"expected the descriptor krawtchouk-diagonal or krawtchouk-discriminant, got {name!r}"
    )


def _check_p1(p1: float) -> None:
    if p1 != 0.5:
        raise ValueError(f"expected p1 = 0.5, about which the polynomials are symmetric, got {p1}")


def _signs(orders: int) -> NDArray[np.float32]:
    """Factor by which mirroring changes the moment of each order, at ``p = 0.5``: 1, -1, 1, ..."""
    return np.where(np.arange(orders) % 2, -1, 1).astype(np.float32)


def _check(silhouettes: NDArray[np.generic]) -> None:
    if silhouettes.ndim != 3 or silhouettes.shape[1:] != (HEIGHT, WIDTH):
        raise ValueError(
            f"expected silhouettes of shape (B, {HEIGHT}, {WIDTH}), got {silhouettes.shape}"
        )
