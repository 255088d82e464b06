"""Where a silhouette's joints may be: a small convolutional network, run by NumPy.

For each joint it gives three distributions, over columns and rows of the normalised frame and over
depths [1]_. It is no estimator of its own: it tells how well a skeleton that was found otherwise
agrees with the silhouette, of which the descriptor keeps 48 values only.

References
----------
.. [1] Y. Li et al., "SimCC: A Simple Coordinate Classification Perspective for Human Pose
   Estimation", ECCV 2022.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from descriptor.silhouette import HEIGHT, WIDTH
from index.skeleton import JOINTS

Array = NDArray[np.float32]


@dataclass(frozen=True)
class Axis:
    """An axis divided into bins of the same width.

    Parameters
    ----------
    first : float
        Middle of the first bin.
    step : float
        Width of a bin.
    bins : int
    """

    first: float
    step: float
    bins: int


AXES = (Axis(-7.0, 2.0, 32), Axis(-7.0, 2.0, 72), Axis(-0.96875, 0.0625, 32))
"""Columns and rows in pixels of the normalised frame, 8 pixels of which beyond each border since a
degraded silhouette lacks limbs; metres behind the pelvis."""

BINS = sum(axis.bins for axis in AXES)

_FIRST = np.array([axis.first for axis in AXES], np.float32)
_STEP = np.array([axis.step for axis in AXES], np.float32)
_BINS_OF_AXIS = np.array([axis.bins for axis in AXES])
_FIRST_BIN = BINS * np.arange(JOINTS)[:, None] + np.cumsum(_BINS_OF_AXIS) - _BINS_OF_AXIS

CONVOLUTIONS = ((5, 2, 24), (3, 2, 48), (3, 2, 96), (3, 1, 64))
"""Size, stride and channels of each."""

HIDDEN = 384
"""Values of the layer between convolutions and distributions."""


_ROWS, _COLUMNS = HEIGHT // 2, WIDTH // 2
_COORDINATES = np.stack(
    np.meshgrid(np.linspace(-1, 1, _COLUMNS), np.linspace(-1, 1, _ROWS)), axis=-1
).astype(np.float32)


def network_input(silhouettes: NDArray[np.uint8]) -> Array:
    """Silhouettes ``(B, 128, 48)`` as the network sees them, ``(B, 64, 24, 3)``.

    At half the resolution, as an index stores them, with a column and a row coordinate, since what
    a limb looks like depends on where it is.
    """
    first = silhouettes[:, ::2, ::2]
    total = first + silhouettes[:, 1::2, ::2] + silhouettes[:, ::2, 1::2]
    total += silhouettes[:, 1::2, 1::2]
    # What most of four pixels show, and the first where they tie.
    return input_planes(2 * total + first > 4)


def input_planes(pictures: NDArray[np.uint8] | NDArray[np.bool_]) -> Array:
    """Pictures ``(B, 64, 24)`` of 0 and 1 with their coordinates, ``(B, 64, 24, 3)``."""
    planes = np.empty((*pictures.shape, 3), np.float32)
    planes[..., 0] = pictures
    planes[..., 1:] = _COORDINATES
    return planes


def places(positions: NDArray[np.floating]) -> NDArray[np.float32]:
    """Positions ``(..., 3)`` along the axes as fractional numbers of bins.

    Those beyond the bins are put at the nearest end.
    """
    return np.asarray(np.clip((positions - _FIRST) / _STEP, 0, _BINS_OF_AXIS - 1), np.float32)


@dataclass(frozen=True)
class Distributions:
    """Logarithms of the probabilities of each joint's bins.

    Parameters
    ----------
    log_probabilities : (19, 136) float32 array
        Columns, rows, depths: see :data:`AXES`.
    """

    log_probabilities: Array

    def log_likelihood(
        self, points_3d: NDArray[np.floating], points_normalised: NDArray[np.floating]
    ) -> NDArray[np.float64]:
        """Mean log probability ``(N,)`` of the joints of skeletons, over joints and axes.

        Parameters
        ----------
        points_3d : (N, P, 3) array
            Axes of the camera that saw the silhouette, metres, pelvis at the origin; the first 19
            points are the joints.
        points_normalised : (N, P, 2) array
            Pixels of the normalised frame.
        """
        positions = np.empty((len(points_3d), JOINTS, len(AXES)), np.float32)
        positions[..., :2] = points_normalised[:, :JOINTS]
        positions[..., 2] = points_3d[:, :JOINTS, 2]
        place = places(positions)
        lower = np.minimum(place.astype(np.int64), _BINS_OF_AXIS - 2)
        share = place - lower
        lower += _FIRST_BIN
        values = self.log_probabilities.ravel()
        near, far = values.take(lower), values.take(lower + 1)
        return np.asarray((near + share * (far - near)).mean(axis=(1, 2)), np.float64)

    def peak(self) -> float:
        """The same for the likeliest bin of each joint and axis: how sure the network is."""
        return float(np.mean([part.max(axis=1) for part in self._by_axis()]))

    def likeliest(self) -> NDArray[np.float64]:
        """Middles ``(19, 3)`` of the likeliest bins: column, row, depth, each joint by itself."""
        bins = np.stack([part.argmax(axis=1) for part in self._by_axis()], axis=1)
        return np.asarray(_FIRST + _STEP * bins, np.float64)

    def _by_axis(self) -> list[Array]:
        return np.split(self.log_probabilities, np.cumsum(_BINS_OF_AXIS)[:-1], axis=1)


@dataclass(frozen=True)
class JointNetwork:
    """The network; immutable, so safe under several threads.

    Parameters
    ----------
    kernels : tuple of (K * K * C, D) float32 array
        Of each convolution, rows in the order row, column, channel.
    biases : tuple of (D,) float32 array
    hidden : (F, 384) float32 array
    hidden_bias : (384,) float32 array
    output : (384, 2584) float32 array
    output_bias : (2584,) float32 array
    """

    kernels: tuple[Array, ...]
    biases: tuple[Array, ...]
    hidden: Array
    hidden_bias: Array
    output: Array
    output_bias: Array

    def __post_init__(self) -> None:
        channels, rows, columns = 3, _ROWS, _COLUMNS
        expected: list[tuple[int, ...]] = []
        for size, stride, features in CONVOLUTIONS:
            expected += [(size * size * channels, features), (features,)]
            channels, rows, columns = features, -(-rows // stride), -(-columns // stride)
        expected += [(rows * columns * channels, HIDDEN), (HIDDEN,)]
        expected += [(HIDDEN, JOINTS * BINS), (JOINTS * BINS,)]
        got = [layer.shape for layer in self._layers()]
        if got != expected:
            raise ValueError(f"expected layers of shapes {expected}, got {got}")

    def _layers(self) -> list[Array]:
        pairs = zip(self.kernels, self.biases, strict=True)
        dense = [self.hidden, self.hidden_bias, self.output, self.output_bias]
        return [layer for pair in pairs for layer in pair] + dense

    def distributions(self, silhouette: NDArray[np.uint8]) -> Distributions:
        """Where the joints of a silhouette ``(128, 48)`` may be."""
        planes = network_input(silhouette[None])[0]
        for (size, stride, _), kernel, bias in zip(
            CONVOLUTIONS, self.kernels, self.biases, strict=True
        ):
            planes = _convolve(planes, kernel, bias, size, stride)
        hidden = np.maximum(planes.ravel() @ self.hidden + self.hidden_bias, 0)
        logits = (hidden @ self.output + self.output_bias).reshape(JOINTS, BINS)
        return Distributions(log_softmax(logits))

    @classmethod
    def restore(cls, arrays: Mapping[str, NDArray[np.generic]]) -> JointNetwork:
        """Inverse of :meth:`arrays`; ``KeyError`` or ``ValueError`` if they do not fit."""

        def read(name: str) -> Array:
            values = arrays[name]
            if values.dtype == np.int8:
                return np.ascontiguousarray(values * arrays[f"{name}_scale"].astype(np.float32))
            return np.ascontiguousarray(values, np.float32)

        numbers = range(1, len(CONVOLUTIONS) + 1)
        return cls(
            tuple(read(f"kernel{number}") for number in numbers),
            tuple(read(f"bias{number}") for number in numbers),
            read("hidden"), read("hidden_bias"), read("output"), read("output_bias"),
        )  # fmt: skip

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """The weights as they are stored: large layers in 8 bits a weight, others in 16."""
        stored: dict[str, NDArray[np.generic]] = {}
        for number, (kernel, bias) in enumerate(zip(self.kernels, self.biases, strict=True), 1):
            stored |= {
                f"kernel{number}": kernel.astype(np.float16),
                f"bias{number}": bias.astype(np.float16),
            }
        for name in ("hidden", "output"):
            weights: Array = getattr(self, name)
            scale = (np.abs(weights).max(axis=0) / 127 + 1e-12).astype(np.float32)
            stored |= {
                name: np.rint(weights / scale).astype(np.int8),
                f"{name}_scale": scale,
                f"{name}_bias": getattr(self, f"{name}_bias").astype(np.float16),
            }
        return stored


def log_softmax(logits: Array) -> Array:
    """Logarithms of the probabilities ``(..., 136)``, axis by axis of :data:`AXES`."""
    result, start = np.empty_like(logits), 0
    for axis in AXES:
        part = logits[..., start : start + axis.bins]
        part = part - part.max(axis=-1, keepdims=True)
        result[..., start : start + axis.bins] = part - np.log(
            np.exp(part).sum(axis=-1, keepdims=True)
        )
        start += axis.bins
    return result


def _convolve(planes: Array, kernel: Array, bias: Array, size: int, stride: int) -> Array:
    """Convolution of planes ``(H, W, C)`` with zeros about them, and rectification."""
    margin = size // 2
    height, width, channels = planes.shape
    padded = np.zeros((height + 2 * margin, width + 2 * margin, channels), np.float32)
    padded[margin:-margin, margin:-margin] = planes
    rows, columns = -(-height // stride), -(-width // stride)
    down, right, along = padded.strides
    # NumPy's own function for windows takes as long as the sums.
    windows = np.lib.stride_tricks.as_strided(
        padded,
        (rows, columns, size, size, channels),
        (stride * down, stride * right, down, right, along),
        writeable=False,
    )
    features = windows.reshape(rows * columns, -1) @ kernel
    features += bias
    return np.maximum(features, 0, out=features).reshape(rows, columns, -1)
