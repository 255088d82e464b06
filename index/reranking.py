"""The networks of an index that read silhouettes; :mod:`index.artefact` reads their files.

The joint network (:mod:`index.network`) ranks hypotheses, and another one reads postures:
hypotheses are near the silhouette in the picture, but squatting, kneeling and sitting people look
alike there, and few entries of the index have these postures. A small network therefore reads the
posture from the hidden layer of the joint network, which has processed the silhouette already. The
votes of the hypotheses are added to its logits. Sums are exact, as in :mod:`index.network`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from index.confidence import RERANKING_FEATURES, Calibration
from index.network import (
    HIDDEN,
    QUANT_MAX,
    Array,
    JointNetwork,
    Layer,
    quantised_relu,
    stored_layers,
)
from index.posture import SILHOUETTE_GROUPS

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
        """The weight and the layers as they are stored; see :func:`index.network.stored_layers`."""
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
