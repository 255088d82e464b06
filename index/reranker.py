"""The file of the network that re-ranks hypotheses, with the constants fitted to it.

It ships beside the index: ``reranking.npz`` holds the weights, ``reranking.json`` their SHA-256 and
the constants. Without them, hypotheses are ordered by distance alone. The ranking itself is in
:mod:`index.ranking`.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from index.confidence import FEATURES, Calibration
from index.files import ArtefactError
from index.network import JointNetwork

RERANKING_JSON, RERANKING_NPZ = "reranking.json", "reranking.npz"
"""Names of the files."""

RERANKING_FORMAT_VERSION = 2

RERANKING_FEATURES = (
    *FEATURES,
    "log_likelihood",
    "log_likelihood_below_best",
    "log_likelihood_below_peak",
    "log_share",
    "log_expected_error_px",
    "log_expected_error_px_squared",
)
"""Features of a hypothesis if there is a network: those of the match, and

- the log-likelihood of its joints, and that log-likelihood relative to the likeliest hypothesis and
  to the likeliest position of each joint by itself;
- the logarithm of its share of the probability, by its distance relative to the others';
- the logarithm of its joint error as the network expects it, and the square of that logarithm.
"""


@dataclass(frozen=True)
class RankingModel:
    """The network and the confidence that was fitted with it.

    Parameters
    ----------
    calibration : Calibration
        Over :data:`RERANKING_FEATURES`.
    training : dict
        JSON values that describe the training data.
    order_weight : float
        Weight of the joints' log-likelihood relative to the logarithm of the distance, in the order
        of hypotheses.
    support_weight : float
        The same for the candidates from which hypotheses are made.
    spread : (float, float, float)
        Standard deviation of a joint from its place in a mode: columns and rows in pixels, depth in
        metres; with zeros, joints do not move.
    """

    network: JointNetwork
    calibration: Calibration
    training: dict[str, Any] = field(default_factory=dict)
    # Both weights were chosen on clips and bodies that neither the network nor the experiment on
    # simulated silhouettes has.
    order_weight: float = 3.0
    support_weight: float = 1.0
    # Chosen on every second clip of the experiment on simulated silhouettes; 2 to 4 pixels do
    # equally well.
    spread: tuple[float, float, float] = (3.0, 3.0, 0.04)

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


def load_reranker(folder: Path) -> RankingModel | None:
    """Read and verify the network beside an index; None if there is none.

    Raises
    ------
    ArtefactError
        If it is incomplete, altered, or not a network of this format.
    """
    file, weights = folder / RERANKING_JSON, folder / RERANKING_NPZ
    if not file.exists():
        if weights.exists():
            raise ArtefactError(f"the network {weights} lacks its manifest {file.name} beside it")
        return None
    try:
        manifest = json.loads(file.read_bytes())
        version = manifest["format_version"]
        if version != RERANKING_FORMAT_VERSION:
            raise ArtefactError(
                f"{file} has format {version}, this service reads format {RERANKING_FORMAT_VERSION}"
            )
        content = weights.read_bytes()
        if hashlib.sha256(content).hexdigest() != manifest["sha256"]:
            raise ArtefactError(f"the network {weights} was altered: its SHA-256 does not fit")
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            network = JointNetwork.restore(arrays)
        calibration = Calibration.restore(manifest["confidence"], RERANKING_FEATURES)
        return RankingModel(
            network,
            calibration,
            dict(manifest["training"]),
            float(manifest["order_weight"]),
            float(manifest["support_weight"]),
            _spread(manifest["spread"]),
        )
    except ArtefactError:
        raise
    except OSError as error:
        raise ArtefactError(f"the network {weights} cannot be read: {error.strerror}") from error
    except (KeyError, TypeError, ValueError, zipfile.BadZipFile) as error:
        raise ArtefactError(f"{file} and {weights.name} do not hold together: {error}") from error


def _spread(values: list[float]) -> tuple[float, float, float]:
    """The spread in a manifest; ``ValueError`` if it is not one."""
    columns, rows, depths = (float(value) for value in values)
    if not min(columns, rows, depths) >= 0:
        raise ValueError(f"expected a spread of 0 or more, got {values}")
    return columns, rows, depths
