"""The networks of an index that read silhouettes, in NumPy: of joints, and of postures.

A small convolutional network predicts where the joints may be, and ranks hypotheses. For each
joint it gives three distributions, over columns and rows of the normalised frame and over
depths [1]_, which measure how well a skeleton from the index agrees with the silhouette.

Hypotheses are near the silhouette in the picture, but squatting, kneeling and sitting people look
alike there, and few entries of the index have these postures. A second network therefore reads the
posture from the hidden layer of the first, which has processed the silhouette already. The votes of
the hypotheses are added to its logits.

Weights and activations are quantised to integers of seven bits plus sign, and sums of their
products stay below 2 to the 24th. The sums are therefore exact in 32-bit floats, whatever the order
of summation, and the networks give the same results on every processor.

References
----------
.. [1] Y. Li et al., "SimCC: A Simple Coordinate Classification Perspective for Human Pose
   Estimation", ECCV 2022.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from descriptor.silhouette import HEIGHT, WIDTH
from index.confidence import RERANKING_FEATURES, Calibration
from index.posture import SILHOUETTE_GROUPS
from index.skeleton import JOINTS, OTHER_SIDE

Array = NDArray[np.float32]


@dataclass(frozen=True)
class Axis:
    """An axis divided into bins of the same width, from the centre of the first one on."""

    first: float
    step: float
    bins: int

    @property
    def centres(self) -> NDArray[np.float64]:
        """Centres ``(bins,)`` of the bins."""
        return np.asarray(self.first + self.step * np.arange(self.bins), np.float64)


AXES = (Axis(-7.5, 2.0, 32), Axis(-7.0, 2.0, 72), Axis(-0.96875, 0.0625, 32))
"""Columns and rows in pixels of the normalised frame, symmetric about its middle, and depth in
metres behind the pelvis. Columns and rows reach 8 pixels beyond each border, because a degraded
silhouette may lack limbs."""

JOINT_BINS = sum(axis.bins for axis in AXES)
"""Bins of the three distributions of a joint."""

_FIRST = np.array([axis.first for axis in AXES], np.float32)
_STEP = np.array([axis.step for axis in AXES], np.float32)
_BINS_OF_AXIS = np.array([axis.bins for axis in AXES])
_FIRST_BIN = JOINT_BINS * np.arange(JOINTS)[:, None] + np.cumsum(_BINS_OF_AXIS) - _BINS_OF_AXIS

CONVOLUTIONS = ((5, 2, 32), (3, 2, 64), (3, 2, 128), (3, 1, 96))
"""Kernel size, stride and channels of each convolution."""

HIDDEN = 512
"""Width of the layer between convolutions and distributions."""

QUANT_MAX = 127
"""Largest quantised weight and activation."""

EXACT_BELOW = 2**24
"""Sums of whole numbers below this are exact in 32-bit floats."""

_ROWS, _COLUMNS = HEIGHT // 2, WIDTH // 2


def _layer_shapes() -> list[tuple[int, ...]]:
    """Numbers of inputs and outputs of each layer."""
    shapes, channels, rows, columns = [], 3, _ROWS, _COLUMNS
    for size, stride, features in CONVOLUTIONS:
        shapes.append((size * size * channels, features))
        channels, rows, columns = features, -(-rows // stride), -(-columns // stride)
    return [*shapes, (rows * columns * channels, HIDDEN), (HIDDEN, JOINTS * JOINT_BINS)]


LAYER_SHAPES = _layer_shapes()

_COORDINATES = np.stack(
    np.meshgrid(np.linspace(-1, 1, _COLUMNS), np.linspace(-1, 1, _ROWS)), axis=-1
).astype(np.float32)


def network_input(silhouettes: NDArray[np.uint8]) -> Array:
    """Input planes ``(B, 64, 24, 3)`` of silhouettes ``(B, 128, 48)``.

    The silhouette at half resolution, as an index stores it, and a column and a row coordinate,
    because the appearance of a limb depends on its place.
    """
    return input_planes(halve(silhouettes))


def halve(silhouettes: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Halve silhouettes ``(B, 128, 48)``: the majority of four pixels decides, or the first."""
    first = silhouettes[:, ::2, ::2]
    total = first + silhouettes[:, 1::2, ::2] + silhouettes[:, ::2, 1::2]
    total += silhouettes[:, 1::2, 1::2]
    return np.asarray(2 * total + first > 4)


def input_planes(pictures: NDArray[np.uint8] | NDArray[np.bool_]) -> Array:
    """Stack pictures ``(B, 64, 24)`` of 0 and 1 with their coordinates: ``(B, 64, 24, 3)``."""
    planes = np.empty((*pictures.shape, 3), np.float32)
    planes[..., 0] = pictures
    planes[..., 1:] = _COORDINATES
    return planes


def joint_positions(
    points_3d: NDArray[np.floating], points_normalised: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Columns, rows and depths ``(N, 19, 3)`` of the joints of skeletons; see :data:`AXES`.

    Skeletons ``(N, P, 3)``, metres about the pelvis, are in axes of the camera that saw the
    silhouette.
    """
    pairs = points_normalised[:, :JOINTS], points_3d[:, :JOINTS, 2:]
    return np.concatenate(pairs, axis=-1, dtype=np.float64)


def bin_positions(positions: NDArray[np.floating]) -> NDArray[np.float32]:
    """Positions ``(..., 3)`` along the axes as fractional bin numbers, clipped to the bins."""
    return np.asarray(np.clip((positions - _FIRST) / _STEP, 0, _BINS_OF_AXIS - 1), np.float32)


@dataclass(frozen=True)
class Distributions:
    """Logarithms ``(19, 136)`` of the probabilities of each joint's bins, along :data:`AXES`."""

    log_probabilities: NDArray[np.float64]

    def log_likelihood(self, positions: NDArray[np.floating]) -> NDArray[np.float64]:
        """Mean log probability ``(N,)`` of :func:`joint_positions`, over joints and axes."""
        fractional = bin_positions(positions)
        lower = np.minimum(fractional.astype(np.int64), _BINS_OF_AXIS - 2)
        share = fractional - lower
        lower += _FIRST_BIN
        values = self.log_probabilities.ravel()
        near, far = values.take(lower), values.take(lower + 1)
        return np.asarray((near + share * (far - near)).mean(axis=(1, 2)), np.float64)

    def expected_errors(self, positions: NDArray[np.floating]) -> NDArray[np.float64]:
        """Expected errors ``(N,)`` in the picture of joints ``(N, 19, 3)``, in pixels.

        Each is the mean over the joints of the root of the expected squared distance.
        """
        squares = np.zeros(positions.shape[:2])
        for number, (axis, log_probabilities) in enumerate(
            zip(AXES[:2], self.by_axis()[:2], strict=True)
        ):
            probabilities, centres = np.exp(log_probabilities), axis.centres
            mean = probabilities @ centres
            variance = probabilities @ centres**2 - mean**2
            squares += (positions[..., number] - mean) ** 2 + variance
        return np.sqrt(squares).mean(axis=1)

    def posterior_means(
        self, positions: NDArray[np.floating], spread: tuple[float, float, float]
    ) -> NDArray[np.float64]:
        """Posterior mean positions ``(N, 19, 3)`` of joints, with a normal prior about given ones.

        ``spread`` are the prior's standard deviations: columns and rows in pixels, depths in
        metres.
        """
        means = np.empty(positions.shape)
        for number, (axis, log_probabilities, sigma) in enumerate(
            zip(AXES, self.by_axis(), spread, strict=True)
        ):
            centres = axis.centres
            apart = (centres - positions[..., number, None]) / sigma
            log_weights = log_probabilities - apart**2 / 2
            weights = np.exp(log_weights - log_weights.max(axis=-1, keepdims=True))
            means[..., number] = weights @ centres / weights.sum(axis=-1)
        return means

    def mirrored(self) -> Distributions:
        """Distributions of the mirror image: columns reversed, left and right exchanged."""
        columns, rows, depths = (part[OTHER_SIDE[:JOINTS]] for part in self.by_axis())
        return Distributions(np.concatenate([columns[:, ::-1], rows, depths], axis=1))

    def mean(self, other: Distributions) -> Distributions:
        either = np.logaddexp(self.log_probabilities, other.log_probabilities)
        return Distributions(either - np.log(2))

    def by_axis(self) -> list[NDArray[np.float64]]:
        """Log probabilities ``(19, bins)`` along each of :data:`AXES`."""
        return np.split(self.log_probabilities, np.cumsum(_BINS_OF_AXIS)[:-1], axis=1)


@dataclass(frozen=True)
class Reading:
    """The network's result for a silhouette: the mean of those for it and its mirror image."""

    joints: Distributions
    hidden: Array  # (512,): whole numbers from 0 to 127, the values of the hidden layer


@dataclass(frozen=True)
class Layer:
    """A linear layer on quantised values."""

    # (F, D): whole numbers from -127 to 127; rows of a convolution are ordered by row, column,
    # channel.
    weights: Array
    # (D,): applied to the sums, so that outputs are in units of the next layer's quantisation
    # steps.
    factors: Array
    offsets: Array

    def __post_init__(self) -> None:
        outputs = self.weights.shape[1:]
        if self.factors.shape != outputs or self.offsets.shape != outputs:
            raise ValueError(
                f"expected factors and offsets of shape {outputs}, "
                f"got {self.factors.shape} and {self.offsets.shape}"
            )
        largest = largest_sums(self.weights).max()
        if not largest < EXACT_BELOW:
            raise ValueError(f"expected sums below {EXACT_BELOW}, got up to {largest:.0f}")

    @classmethod
    def restore(cls, arrays: Mapping[str, NDArray[np.generic]], number: int) -> Layer:
        """Layer ``number``, from 1, of :func:`stored_layers`."""
        names = (f"{name}{number}" for name in ("weights", "factors", "offsets"))
        return cls(*(np.ascontiguousarray(arrays[name], np.float32) for name in names))

    def __call__(self, values: Array) -> Array:
        """Outputs ``(..., D)`` of quantised inputs ``(..., F)``."""
        sums = values @ self.weights
        sums *= self.factors
        sums += self.offsets
        return np.asarray(sums, np.float32)


def stored_layers(layers: Sequence[Layer]) -> dict[str, NDArray[np.generic]]:
    """Layers as they are stored, numbered from 1: weights in 8 bits, without loss."""
    stored: dict[str, NDArray[np.generic]] = {}
    for number, layer in enumerate(layers, 1):
        stored |= {
            f"weights{number}": layer.weights.astype(np.int8),
            f"factors{number}": layer.factors,
            f"offsets{number}": layer.offsets,
        }
    return stored


def largest_sums(weights: NDArray[np.floating]) -> NDArray[np.float64]:
    """Upper bounds ``(D,)`` of sums of activations, in whatever order they are added.

    Activations are not negative, so no partial sum exceeds the largest activation times the sum of
    the weights of one sign. Coordinates may be negative, but the first layer has few inputs.
    """
    signs = [np.maximum(sign * weights, 0).sum(axis=0, dtype=np.float64) for sign in (1, -1)]
    return QUANT_MAX * np.maximum(*signs)


def quantised_relu(values: Array) -> Array:
    """Round to whole numbers from 0 to :data:`QUANT_MAX`, in place."""
    return np.clip(np.rint(values, out=values), 0, QUANT_MAX, out=values)


@dataclass(frozen=True)
class JointNetwork:
    """The network; immutable and therefore thread-safe."""

    # The :data:`CONVOLUTIONS`, the hidden layer, and the logits ``(2584,)``.
    layers: tuple[Layer, ...]

    def __post_init__(self) -> None:
        got = [layer.weights.shape for layer in self.layers]
        if got != LAYER_SHAPES:
            raise ValueError(f"expected layers of shapes {LAYER_SHAPES}, got {got}")

    def read(self, silhouette: NDArray[np.uint8]) -> Reading:
        """Predict where the joints of a silhouette ``(128, 48)`` may be.

        The mean for the silhouette and its mirror image is more accurate than one pass, and exactly
        symmetric under mirroring.
        """
        planes, mirrored = network_input(np.stack([silhouette, silhouette[:, ::-1]]))
        (joints, hidden), (others, other_hidden) = self.forward(planes), self.forward(mirrored)
        return Reading(joints.mean(others.mirrored()), np.rint((hidden + other_hidden) / 2))

    def forward(self, planes: Array) -> tuple[Distributions, Array]:
        """Distributions, and values ``(512,)`` of the hidden layer, for one silhouette's planes."""
        *inner, output = self.layers
        values = quantise(planes)
        for number, layer in enumerate(inner):
            values = quantised_relu(layer(layer_input(number, values)))
        logits = output(values).reshape(JOINTS, JOINT_BINS)
        return Distributions(log_softmax(logits)), values

    @classmethod
    def restore(cls, arrays: Mapping[str, NDArray[np.generic]]) -> JointNetwork:
        """Inverse of :meth:`arrays`; ``KeyError`` or ``ValueError`` if the arrays do not fit."""
        numbers = range(1, len(LAYER_SHAPES) + 1)
        return cls(tuple(Layer.restore(arrays, number) for number in numbers))

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """The layers as they are stored; see :func:`stored_layers`."""
        return stored_layers(self.layers)


def quantise(planes: Array) -> Array:
    """Quantise input planes ``(64, 24, 3)`` with values from -1 to 1."""
    return np.rint(QUANT_MAX * planes)


def log_softmax(logits: NDArray[np.floating]) -> NDArray[np.float64]:
    """Log probabilities ``(..., 136)`` of logits, normalised along each of :data:`AXES`."""
    result, start = np.empty(logits.shape), 0
    for axis in AXES:
        part = logits[..., start : start + axis.bins].astype(np.float64)
        part -= part.max(axis=-1, keepdims=True)
        part -= np.log(np.exp(part).sum(axis=-1, keepdims=True))
        result[..., start : start + axis.bins] = part
        start += axis.bins
    return result


def layer_input(number: int, values: Array) -> Array:
    """Input ``(..., F)`` of a layer, from the output of the previous one."""
    if number < len(CONVOLUTIONS):
        size, stride, _ = CONVOLUTIONS[number]
        return _windows(values, size, stride)
    return values.ravel()


def _windows(values: Array, size: int, stride: int) -> Array:
    """Windows ``(H / stride, W / stride, size * size * C)`` of zero-padded planes ``(H, W, C)``."""
    margin = size // 2
    height, width, channels = values.shape
    padded = np.zeros((height + 2 * margin, width + 2 * margin, channels), np.float32)
    padded[margin:-margin, margin:-margin] = values
    rows, columns = -(-height // stride), -(-width // stride)
    down, right, along = padded.strides
    # sliding_window_view takes as long as the sums.
    cut = np.lib.stride_tricks.as_strided(
        padded,
        (rows, columns, size, size, channels),
        (stride * down, stride * right, down, right, along),
        writeable=False,
    )
    return cut.reshape(rows, columns, -1)


INPUTS, UNITS = HIDDEN + 2, 128
"""Inputs, see :func:`posture_inputs`, and width of the layer between."""

MIN_VOTE = 0.01
"""Added to the share of the votes that each of ``SILHOUETTE_GROUPS`` has."""


def posture_inputs(hidden: Array, roll_deg: NDArray[np.floating] | float) -> Array:
    """Inputs ``(..., 514)``, whole numbers, from values of the hidden layer ``(..., 512)``.

    They include whether a wide silhouette was rotated upright, and how far, which distinguishes
    lying from standing people.
    """
    rolls_deg = np.abs(np.asarray(roll_deg, np.float32))
    rolls_deg = np.minimum(rolls_deg, 180 - rolls_deg)
    wide = np.stack([rolls_deg > 0, rolls_deg / 90], axis=-1)
    return np.concatenate([hidden, np.rint(QUANT_MAX * wide)], axis=-1, dtype=np.float32)


@dataclass(frozen=True)
class PostureNetwork:
    """The network and the weight of the logarithms of votes."""

    layers: tuple[Layer, Layer]  # the layer between, and logits of ``SILHOUETTE_GROUPS``
    vote_weight: float

    def __post_init__(self) -> None:
        shapes = [layer.weights.shape for layer in self.layers]
        if shapes != [(INPUTS, UNITS), (UNITS, len(SILHOUETTE_GROUPS))]:
            raise ValueError(f"expected a network of postures, got layers of shapes {shapes}")

    def logits(self, hidden: Array, roll_deg: float) -> NDArray[np.float64]:
        """Logits ``(7,)`` of ``SILHOUETTE_GROUPS``, without votes."""
        between, output = self.layers
        return output(quantised_relu(between(posture_inputs(hidden, roll_deg)))).astype(np.float64)

    def shares(
        self, hidden: Array, roll_deg: float, votes: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Probabilities ``(10,)`` of ``POSTURES``, given the shares of the votes ``(10,)``.

        ``roll_deg`` is not 0 if the silhouette was rotated upright.
        """
        of_groups = SILHOUETTE_GROUPS.sums(votes)
        logits = self.logits(hidden, roll_deg) + self.vote_weight * np.log(of_groups + MIN_VOTE)
        probabilities = np.exp(logits - logits.max())
        return SILHOUETTE_GROUPS.split(probabilities / probabilities.sum(), votes)

    @classmethod
    def restore(cls, arrays: Mapping[str, NDArray[np.generic]]) -> PostureNetwork:
        """Inverse of :meth:`arrays`; ``KeyError`` or ``ValueError`` if the arrays do not fit."""
        layers = Layer.restore(arrays, 1), Layer.restore(arrays, 2)
        return cls(layers, float(arrays["vote_weight"]))

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """The weight and the layers as they are stored; see :func:`stored_layers`."""
        return {"vote_weight": np.array(self.vote_weight)} | stored_layers(self.layers)


@dataclass(frozen=True)
class RankingModel:
    """The joint network, the confidence fitted with it, and the network of postures."""

    network: JointNetwork
    calibration: Calibration  # over :data:`index.confidence.RERANKING_FEATURES`
    # JSON values that describe the training data.
    training: dict[str, Any] = field(default_factory=dict)
    # Weight of the joints' log-likelihood relative to the logarithm of the distance, in the order
    # of hypotheses. Both weights were chosen on clips and bodies that neither the network nor the
    # experiment on simulated silhouettes has.
    order_weight: float = 3.0
    support_weight: float = 1.0  # the same for the candidates from which hypotheses are made
    # Standard deviation of a joint from its place in a mode: columns and rows in pixels, depth in
    # metres; with zeros, joints do not move. Chosen on every second clip of the experiment on
    # simulated silhouettes; 2 to 4 pixels do equally well.
    spread: tuple[float, float, float] = (3.0, 3.0, 0.04)
    postures: PostureNetwork | None = None  # without one, hypotheses vote on the posture

    def __post_init__(self) -> None:
        if self.calibration.features != RERANKING_FEATURES:
            raise ValueError(
                f"expected a calibration over {', '.join(RERANKING_FEATURES)}, "
                f"got one over {', '.join(self.calibration.features)}"
            )

    @classmethod
    def of(cls, network: JointNetwork) -> RankingModel:
        """A network without a fitted confidence: every hypothesis gets 0.5."""
        return cls(network, Calibration.none(RERANKING_FEATURES))
