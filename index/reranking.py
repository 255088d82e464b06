"""The re-ranking network of an index, and its constants; :mod:`index.artefact` reads the files."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from index.confidence import RERANKING_FEATURES, Calibration
from index.network import JointNetwork
from index.silhouette_posture import PostureNetwork


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
