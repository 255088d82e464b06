"""Fit detection scores to frames of the street video and to rendered photographs.

Writes the parts `detection` and `objects` of ``app/networks/models/fitted.json``, in a few
minutes. Both sources may be used for products (``docs/data.md``). Rendering needs the environment
of ``docs/training.md``.
"""

import argparse
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from tqdm import tqdm

from app.networks.shipped import FOLDER
from app.photograph import Estimator, load_estimator
from app.settings import Settings
from app.vision.detector import NetworkDetector, detection_features
from app.vision.geometry import Box, Boxes, iou_matrix
from scripts.datasets import Marks, as_array, read_marks, read_vtest
from scripts.results import SHARED
from scripts.training.render.scene import Studio
from scripts.training.shipping import record_hash

COMMAND = "python -m scripts fit-people"
RENDERED, RENDERED_EMPTY, RENDERED_BODIES, RENDERED_SEED = 1000, 0.4, 24, 77
"""Rendered photographs, the share without people, the bodies, and the seed."""

RIDGE = 1e-3
"""Weight of the squared constants in the loss, for few samples that some score separates."""

SAME = 0.5
"""Overlap (IoU) from which a candidate is an annotated person."""


@dataclass
class Samples:
    """Features and truths of the candidates of one source."""

    features: list[NDArray[np.float64]] = field(default_factory=list)
    truths: list[bool] = field(default_factory=list)

    def add(self, features: NDArray[np.float64], truth: bool) -> None:
        """Add a candidate."""
        self.features.append(features)
        self.truths.append(truth)


def candidate_samples(
    detector: NetworkDetector, frame: NDArray[np.uint8], judge: Callable[[Box], bool | None]
) -> Iterator[tuple[NDArray[np.float64], bool]]:
    """Yield scores of the candidates of a frame, and whether they are people, where known.

    Each has the features of the detectors, then the log odds of objects.
    """
    found, scores, _ = detector.candidates(frame)
    for one, row in zip(found, detection_features(scores), strict=True):
        truth = judge(one.box)
        if truth is not None:
            yield np.append(row, detector.object_log_odds(frame, one)), truth


def box_overlap(box: Box, people: Boxes) -> float:
    """Return the largest overlap of a box with people."""
    return float(iou_matrix(as_array([box]), people).max(initial=0.0))


def subject(body: Boxes) -> Callable[[Box], bool | None]:
    """Judge candidates in rendered photographs: None for people beside the subject."""
    return lambda box: True if box_overlap(box, body) >= 0.3 else None


def walker(marks: Marks) -> Callable[[Box], bool | None]:
    """Judge candidates in the street video: None for barely visible people."""

    def judge(box: Box) -> bool | None:
        if box_overlap(box, as_array(marks.people)) >= SAME:
            return True
        return None if box_overlap(box, as_array(marks.ignored)) >= 0.3 else False

    return judge


def street_samples(estimator: Estimator, shared: Path) -> Samples:
    """Collect the candidates of the marked frames of the street video."""
    samples = Samples()
    marks = {one.frame: one for one in read_marks()}
    for number, frame in read_vtest(shared / "real" / "vtest", len(marks)):
        if number in marks:
            for sample in candidate_samples(
                estimator.models.detector, frame, walker(marks[number])
            ):
                samples.add(*sample)
    return samples


def rendered_samples(estimator: Estimator, shared: Path) -> Samples:
    """Collect the candidates of rendered photographs, of people in any posture and of things."""
    samples = Samples()
    studio = Studio.open(
        shared / "mocap", shared / "garments", RENDERED_BODIES, RENDERED_SEED, held_out=False
    )
    for number in tqdm(range(RENDERED), desc="rendered photographs"):
        generator = np.random.default_rng([RENDERED_SEED, number])
        empty = bool(generator.random() < RENDERED_EMPTY)
        photograph = studio.take(generator, empty=empty)
        judge = subject(photograph.box[None])
        for sample in candidate_samples(
            estimator.models.detector, photograph.image, (lambda _: False) if empty else judge
        ):
            samples.add(*sample)
    return samples


LOWERED = {"detection": 0.9, "objects": 0.4}
"""How much less likely candidates are than the fits say. The operating point, chosen on development
pictures: renders have few of the things a dozen pixels high in which the detectors see people."""


def fit_detection(sources: Sequence[Samples]) -> dict[str, float]:
    """Fit the weights of the detectors' scores, none negative; sources weigh the same."""
    features, truths = _joined(sources)
    weights = np.concatenate([np.full(len(one.truths), 1 / len(one.truths)) for one in sources])
    evidence = np.append(features[:, :-2], np.ones((len(features), 1)), axis=1)
    bounds = [(0.0, None)] * 3 + [(None, None)]
    fitted = _log_odds(evidence, truths, np.zeros(len(truths)), weights, bounds)
    return dict(zip(("movenet", "hog", "pose_detection", "offset"), fitted, strict=True))


def fit_objects(detection: dict[str, float], sources: Sequence[Samples]) -> dict[str, float]:
    """Fit what the log odds of objects add to those of the detectors.

    All candidates count, since few are doubtful.
    """
    features, truths = _joined(sources)
    odds = features[:, :-2] @ np.array([*detection.values()][:-1]) + detection["offset"]
    person, other = features[:, -2:].T
    evidence = np.stack([person, np.maximum(0, other - person), np.ones_like(person)], axis=1)
    fitted = _log_odds(evidence, truths, odds, np.ones(len(truths)))
    return dict(zip(("person", "excess", "offset"), fitted, strict=True))


def _joined(sources: Sequence[Samples]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    return (
        np.concatenate([np.array(one.features) for one in sources]),
        np.concatenate([np.array(one.truths) for one in sources]),
    )


def _log_odds(
    evidence: NDArray[np.float64],
    truths: NDArray[np.bool_],
    known: NDArray[np.float64],
    weights: NDArray[np.float64],
    bounds: Sequence[tuple[float | None, float | None]] | None = None,
) -> list[float]:
    """Fit the log odds ``(N,)`` that evidence ``(N, F)`` adds to those known."""
    signs, shares = np.where(truths, 1.0, -1.0), weights / weights.sum()

    def loss(constants: NDArray[np.float64]) -> float:
        odds = known + evidence @ constants
        return float(shares @ np.logaddexp(0, -signs * odds) + RIDGE * constants @ constants)

    fitted = minimize(loss, np.zeros(evidence.shape[1]), bounds=bounds).x
    return [round(value, 4) for value in fitted.tolist()]


def main(arguments: Sequence[str] | None = None) -> None:
    """Fit all parts, one after the other."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--shared", type=Path, default=SHARED)
    shared = parser.parse_args(arguments).shared
    if not (shared / "real").is_dir():
        parser.error(f"expected {shared}/real to hold the street video, it is not there")
    estimator = load_estimator(Settings())
    sources = {
        "vtest": street_samples(estimator, shared),
        "renders": rendered_samples(estimator, shared),
    }
    data = ", ".join(f"{len(one.truths)} candidates of {name}" for name, one in sources.items())
    samples = [*sources.values()]
    detection = fit_detection(samples)
    fits = {"detection": detection, "objects": fit_objects(detection, samples)}
    for part, less in LOWERED.items():
        fits[part]["offset"] = round(fits[part]["offset"] - less, 4)
    document = {
        part: {"command": COMMAND, "data": data, "constants": constants}
        for part, constants in fits.items()
    }
    fitted = FOLDER / "fitted.json"
    fitted.write_text(json.dumps(document, indent=1) + "\n")
    record_hash(fitted)
