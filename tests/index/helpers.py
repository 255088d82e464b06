"""Builders and measures that several tests of the index share."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from index.artefact import version_of
from index.confidence import RERANKING_FEATURES, Calibration, signs
from index.landmarks import NormalisedLandmarks
from index.network import (
    INPUTS,
    LAYER_SHAPES,
    QUANT_MAX,
    UNITS,
    JointNetwork,
    Layer,
    PostureNetwork,
    RankingModel,
)
from index.posture import SILHOUETTE_GROUPS
from index.skeleton import JOINTS, LIMB_HIPS, LIMB_ROWS, mirror_3d, mirror_normalised
from index.store import PoseIndex


def random_network(seed: int) -> JointNetwork:
    """A network of random weights whose values use their range."""
    generator = np.random.default_rng(seed)
    layers = []
    for inputs, outputs in LAYER_SHAPES:
        weights = generator.normal(scale=QUANT_MAX / 4, size=(inputs, outputs))
        weights = np.rint(weights.clip(-QUANT_MAX, QUANT_MAX)).astype(np.float32)
        reached = QUANT_MAX if len(layers) + 1 < len(LAYER_SHAPES) else 4
        factor = reached / (QUANT_MAX / 4 * QUANT_MAX * np.sqrt(inputs))
        offsets = generator.normal(scale=reached / 10, size=outputs)
        layers.append(
            Layer(weights, np.full(outputs, factor, np.float32), offsets.astype(np.float32))
        )
    return JointNetwork(tuple(layers))


def random_reranker() -> RankingModel:
    """A network that has learned nothing, with its calibration."""
    weights = tuple((0.1 * signs(RERANKING_FEATURES)).tolist())
    calibration = Calibration(weights, -0.2, RERANKING_FEATURES)
    return RankingModel(random_network(1), calibration, {"passes": 0})


def random_postures(seed: int) -> PostureNetwork:
    """A network of postures of random weights."""
    generator = np.random.default_rng(seed)

    def layer(inputs: int, outputs: int, reached: float) -> Layer:
        weights = np.rint(generator.uniform(-40, 40, (inputs, outputs))).astype(np.float32)
        factors = np.full(outputs, reached / (QUANT_MAX * 12 * np.sqrt(inputs)), np.float32)
        return Layer(weights, factors, generator.normal(0, reached / 10, outputs).astype("f4"))

    layers = layer(INPUTS, UNITS, QUANT_MAX), layer(UNITS, len(SILHOUETTE_GROUPS), 4.0)
    return PostureNetwork(layers, 0.5)


def landmarks_of(
    points: NDArray[np.floating], points_3d: NDArray[np.floating], score: float = 0.9
) -> NormalisedLandmarks:
    """Landmarks on the limbs of a skeleton ``(P, 2)`` and ``(P, 3)``."""
    scores = np.full(len(LIMB_ROWS), score)
    limbs = np.asarray(points_3d, np.float64)[LIMB_ROWS]
    limbs = limbs - limbs[LIMB_HIPS].mean(axis=0)
    positions = np.asarray(points, np.float64)[LIMB_ROWS]
    covariance = 0.15**2 * np.eye(len(LIMB_ROWS))
    return NormalisedLandmarks(tuple(LIMB_ROWS), positions, scores, limbs, scores, covariance)


def points_of(
    index: PoseIndex, entry_id: int, *, mirrored: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Skeleton of an entry or of its mirror image: ``(24, 3)``, and normalised ``(24, 2)``."""
    entry = index.entry(entry_id)
    if not mirrored:
        return entry.points_3d, entry.points_normalised
    return mirror_3d(entry.points_3d), mirror_normalised(entry.points_normalised)


def joint_error(points: NDArray[np.floating], joints: NDArray[np.floating]) -> float:
    """Mean distance between the joints of two skeletons, in their unit."""
    return float(np.linalg.norm(points[:JOINTS] - joints[:JOINTS], axis=-1).mean())


def contents(folder: Path) -> dict[str, bytes]:
    """Contents of the files of a folder."""
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def seal(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change the manifest and give it the content hash that fits."""
    file = folder / "manifest.json"
    manifest = json.loads(file.read_text())
    change(manifest)
    manifest["version"] = version_of(manifest)
    file.write_text(json.dumps(manifest))
