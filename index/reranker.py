"""What re-ranks the hypotheses of an index: a network, and the constants fitted with it.

It ships beside the index: ``reranking.npz`` with its weights, and ``reranking.json`` with their
SHA-256 and the constants. An index without them is matched by distance alone.
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
from index.files import ArtefactError, npy_bytes
from index.network import JointNetwork

FILES = MANIFEST, WEIGHTS = "reranking.json", "reranking.npz"

FORMAT_VERSION = 2

ORDER_WEIGHT, SUPPORT_WEIGHT = 3.0, 1.0
"""Chosen on clips and bodies that neither the network nor the strict experiment has."""

SPREAD = (3.0, 3.0, 0.04)
"""How far a joint may be from where a mode has it, one standard deviation: columns and rows in
pixels, depth in metres. Chosen on every second clip of the strict experiment; 2 to 4 pixels do."""

RERANKING_FEATURES = (
    *FEATURES,
    "log_likelihood",
    "log_likelihood_below_best",
    "log_likelihood_below_peak",
    "log_share",
    "log_expected_error_px",
    "log_expected_error_px_squared",
)
"""Features of a hypothesis where there is a network: those of the match, and

- the log-likelihood of its joints, what it lacks of the likeliest hypothesis, and what it lacks of
  the likeliest places of the joints, each by itself;
- logarithm of its share of the probability; see :data:`index.ranking.SHARE_POWER`;
- logarithm of its joint error, expected by the network alone, and the square of that logarithm.
"""


@dataclass(frozen=True)
class RankingModel:
    """The network and the confidence that was fitted with it.

    Parameters
    ----------
    network : JointNetwork
    calibration : Calibration
        Over :data:`RERANKING_FEATURES`.
    training : dict
        JSON values that say what it was trained on.
    order_weight, support_weight : float
        What a unit of the joints' log-likelihood counts, beside the logarithm of the distance, in
        the order of hypotheses, and in the weights of the candidates that they are made of.
    spread : (float, float, float)
        How far joints may move to where the network sees them; see :data:`SPREAD`. Zeros: not at
        all.
    """

    network: JointNetwork
    calibration: Calibration
    training: dict[str, Any] = field(default_factory=dict)
    order_weight: float = ORDER_WEIGHT
    support_weight: float = SUPPORT_WEIGHT
    spread: tuple[float, float, float] = SPREAD

    def __post_init__(self) -> None:
        if self.calibration.features != RERANKING_FEATURES:
            raise ValueError(
                f"expected a calibration over {', '.join(RERANKING_FEATURES)}, "
                f"got one over {', '.join(self.calibration.features)}"
            )

    @classmethod
    def of(cls, network: JointNetwork) -> RankingModel:
        """A network with which no confidence has been fitted yet: it is 0.5 for all."""
        count = len(RERANKING_FEATURES)
        return cls(network, Calibration((0.0,) * count, 0.0, RERANKING_FEATURES))


def reranker_files(reranker: RankingModel) -> dict[str, bytes]:
    """What is stored beside an index, by file name; the same network gives the same bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, array in reranker.network.arrays().items():
            # Without the time of writing.
            member = zipfile.ZipInfo(f"{name}.npy")
            archive.writestr(member, npy_bytes(array), zipfile.ZIP_DEFLATED)
    weights = buffer.getvalue()
    manifest = {
        "format_version": FORMAT_VERSION,
        "sha256": hashlib.sha256(weights).hexdigest(),
        "order_weight": reranker.order_weight,
        "support_weight": reranker.support_weight,
        "spread": list(reranker.spread),
        "confidence": reranker.calibration.parameters(),
        "training": reranker.training,
    }
    return {WEIGHTS: weights, MANIFEST: (json.dumps(manifest, indent=1) + "\n").encode()}


def save_reranker(reranker: RankingModel, folder: Path) -> None:
    """Write the network beside an index, whose own files stay as they are."""
    for name, content in reranker_files(reranker).items():
        (folder / name).write_bytes(content)


def load_reranker(folder: Path) -> RankingModel | None:
    """Read and verify the network beside an index; None where there is none.

    Raises
    ------
    ArtefactError
        If it is incomplete, altered, or not a network of this format.
    """
    file, weights = folder / MANIFEST, folder / WEIGHTS
    if not file.exists():
        if weights.exists():
            raise ArtefactError(f"the network {weights} lacks its manifest {file.name} beside it")
        return None
    try:
        manifest = json.loads(file.read_bytes())
        version = manifest["format_version"]
        if version != FORMAT_VERSION:
            raise ArtefactError(
                f"{file} has format {version}, this service reads format {FORMAT_VERSION}"
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
    """The spread that a manifest names; ``ValueError`` if it is none."""
    columns, rows, depths = (float(value) for value in values)
    if not min(columns, rows, depths) >= 0:
        raise ValueError(f"expected a spread of 0 or more, got {values}")
    return columns, rows, depths
