"""Fit the confidences to rendered people and simulated silhouettes; no photograph teaches them.

Prints the constants of :data:`index.confidence.LANDMARK_CONFIDENCE`, and writes the calibrations of
silhouettes into the manifests of the shipped index and of its network. Clips and bodies are held
out from the network and from the index that is asked: every second held-out clip; the others are
for ``evaluate confidence``.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from app.photograph import load_estimator
from index import DEFAULT_PATH
from index.artefact import version_of
from index.confidence import LANDMARK_CONFIDENCE, RERANKING_FEATURES, Calibration, ConfidenceModel
from index.store import PoseIndex
from scripts.index.builder import (
    CALIBRATION_AVATARS,
    QueryCounts,
    entries_of,
    hold_out,
    simulate_queries,
)
from scripts.index.calibrate import Queries, calibrate
from scripts.index.garments import make_avatars
from scripts.index.motion import Segment, read_manifest
from scripts.results import SHARED
from scripts.training.confidence_data import Answer, answers_about, rendered_people
from scripts.training.held_out import part
from scripts.training.render_people import studio_of

PEOPLE, RENDERED, SEED = 12, 453, 78
"""Bodies, photographs, and the seed of both and of the silhouettes."""

ASKED = QueryCounts(upright=600, near_ground=300, laid_down=180)


def fit_landmarks(answers: Sequence[Answer]) -> ConfidenceModel:
    """The likeliest constants, given a sample for each person and hypothesis."""
    shape = (
        "landmarks_px", "reliability_power", "reprojection_share", "fitted_share", "sharpness"
    )  # fmt: skip
    right = [one for one in answers if not one.in_depth]
    model = _likeliest(LANDMARK_CONFIDENCE, shape, right, [one.right for one in right])
    first = {one.person: one for one in answers if one.rank == 1}
    deep = [one for one in answers if one.in_depth and first[one.person].right]
    truths = [one.distance_m < first[one.person].distance_m for one in deep]
    model = _likeliest(model, ("depth_offset", "depth_weight"), deep, truths)
    return replace(model, weight_power=_weight_power(model, answers))


def _likeliest(
    model: ConfidenceModel, names: tuple[str, ...], samples: Sequence[Answer], truths: list[bool]
) -> ConfidenceModel:
    """The model with some of its constants fitted; those of shares and powers are positive."""
    features = np.array([one.features for one in samples])
    presence = np.array([one.presence for one in samples])
    signs = np.where(truths, 1.0, -1.0)
    if "depth_offset" in names:
        # Given that the joints are right in the picture.
        features[:, :3] = 0.0, 0.0, 1.0
        presence = np.ones(len(samples))
    start = np.array([getattr(model, name) for name in names])
    positive = np.array([name != "depth_offset" for name in names])

    def constants(values: NDArray[np.float64]) -> dict[str, float]:
        found = np.where(positive, np.exp(np.minimum(values, 5)), values)
        return {name: round(float(one), 3) for name, one in zip(names, found, strict=True)}

    def loss(values: NDArray[np.float64]) -> float:
        found = np.where(positive, np.exp(np.minimum(values, 5)), values)
        tried = replace(model, **dict(zip(names, found.tolist(), strict=True)))
        chances = np.clip(presence * tried.probability(features), 1e-6, 1 - 1e-6)
        return float(-np.log(np.where(signs > 0, chances, 1 - chances)).sum())

    begin = np.where(positive, np.log(np.where(positive, start, 1.0)), start)
    found = minimize(loss, begin, method="Nelder-Mead", options={"maxiter": 4000, "maxfev": 4000})
    return replace(model, **constants(found.x))


def _weight_power(model: ConfidenceModel, answers: Sequence[Answer]) -> float:
    """The power by which confidences give the likeliest weights of the nearest hypotheses."""
    people: dict[int, list[Answer]] = {}
    for one in answers:
        people.setdefault(one.person, []).append(one)

    def loss(power: NDArray[np.float64]) -> float:
        tried, total = replace(model, weight_power=float(power[0])), 0.0
        for some in people.values():
            confidences = model.probability(np.array([one.features for one in some]))
            nearest = int(np.argmin([one.distance_m for one in some]))
            total -= float(np.log(tried.weights(confidences)[nearest] + 1e-9))
        return total

    found = minimize(loss, [1.0], method="L-BFGS-B", bounds=[(0.05, 5.0)]).x
    return round(float(found[0]), 3)


def held_out_queries(shared: Path, half: int, seed: int) -> tuple[list[Segment], Queries]:
    """The segments that an index may know, and silhouettes of one half of the other clips."""
    kept, held = hold_out(read_manifest(shared / "mocap"))
    clips = sorted({segment.clip for segment in held})[half::2]
    asked = [segment for segment in held if segment.clip in clips]
    avatars = make_avatars(CALIBRATION_AVATARS, shared / "garments")
    simulated = simulate_queries(shared / "mocap", asked, avatars, ASKED, seed)
    return kept, Queries.of(simulated).half_degraded(seed)


def fit_silhouettes(index: PoseIndex, shared: Path, folder: Path) -> None:
    """Fit the calibrations of an index, without the held-out clips, and write them."""
    kept, queries = held_out_queries(shared, 0, SEED)
    strict = part(index, entries_of(index, kept))
    plain = calibrate(replace(strict, reranker=None), queries)
    store_calibration(folder / "manifest.json", plain)
    if index.reranker is not None:
        calibration = calibrate(strict, queries, RERANKING_FEATURES)
        store_calibration(folder / "reranking.json", calibration)


def store_calibration(file: Path, calibration: Calibration) -> None:
    """Replace the confidence in a manifest, and its version where it has one."""
    document = json.loads(file.read_text())
    holder = document if "confidence" in document else document["parameters"]
    holder["confidence"] = calibration.parameters()
    if "version" in document:
        document["version"] = version_of(document)
    file.write_text(json.dumps(document, indent=1) + "\n")


def main(arguments: Sequence[str] | None = None) -> None:
    """Fit both, one after the other."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--shared", type=Path, default=SHARED)
    parser.add_argument("--index", type=Path, default=DEFAULT_PATH)
    options = parser.parse_args(arguments)
    estimator = load_estimator()
    fit_silhouettes(estimator.index, options.shared, options.index)
    studio = studio_of(options.shared, PEOPLE, SEED, held_out=False)
    people = rendered_people(estimator, studio, SEED, RENDERED)
    answers = list(answers_about(estimator, people))
    count = len({one.person for one in answers})
    print(f"Fitted to {count} rendered people: {fit_landmarks(answers)}")
