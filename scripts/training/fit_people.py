"""Fit detection scores to photographs, since simulation cannot teach them.

Writes the parts `detection` and `objects` of ``app/vision/models/fitted.json``, within about ten
minutes. The data are
street photographs (Penn-Fudan), frames of the street video, sports photographs (LSP Extended) and,
for the part `objects`, rendered photographs, which need the environment of ``docs/training.md``.
Pose2Sim, UP-Fall, the falls and the homes are not used, so that they remain a test.
"""

import argparse
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from sklearn.linear_model import LogisticRegression
from tqdm import tqdm

from app.photograph import Estimator, load_estimator
from app.settings import Settings
from app.vision.detector import (
    DOUBTFUL,
    MIN_DETECTION_SCORE,
    NetworkDetector,
    detection_features,
)
from app.vision.geometry import Box, Boxes, iou_matrix
from app.vision.models import FITTED
from app.vision.odds import sigmoid
from scripts.datasets import (
    Marks,
    as_array,
    read_lsp,
    read_marks,
    read_pennfudan,
    read_vtest,
)
from scripts.results import SHARED
from scripts.training.render.scene import Studio
from scripts.training.render_people import PEOPLE

COMMAND = "python -m scripts fit-people"
RENDERED, RENDERED_EMPTY, RENDERED_SEED = 1500, 0.4, 77
"""Rendered photographs, the share without people, and the seed."""

SAME = 0.5
"""Overlap (IoU) from which a candidate is an annotated person."""


@dataclass
class Samples:
    """Features and truths of one source, and the photograph of each, its group."""

    features: list[NDArray[np.float64]] = field(default_factory=list)
    truths: list[bool] = field(default_factory=list)
    groups: list[str] = field(default_factory=list)

    def add(self, features: NDArray[np.float64], truth: bool, group: str) -> None:
        """Add a sample."""
        self.features.append(features)
        self.truths.append(truth)
        self.groups.append(group)


Source = Iterator[tuple[str, NDArray[np.uint8]]]


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


def pedestrian(people: Boxes) -> Callable[[Box], bool | None]:
    """Judge candidates in street photographs."""
    return lambda box: box_overlap(box, people) >= SAME


def athlete(body: Boxes) -> Callable[[Box], bool | None]:
    """Judge candidates in sports photographs, where only one person is annotated."""
    return lambda box: True if box_overlap(box, body) >= 0.3 else None


def walker(marks: Marks) -> Callable[[Box], bool | None]:
    """Judge candidates in the street video: None for barely visible people."""

    def judge(box: Box) -> bool | None:
        if box_overlap(box, as_array(marks.people)) >= SAME:
            return True
        return None if box_overlap(box, as_array(marks.ignored)) >= 0.3 else False

    return judge


def detection_samples(estimator: Estimator, shared: Path) -> dict[str, Samples]:
    """Collect the candidates of every source that has boxes or joints."""
    detector = estimator.models.detector
    sources = {name: Samples() for name in ("pennfudan", "vtest", "lsp")}
    street = read_pennfudan(shared / "real" / "pennfudan")
    for one in tqdm(street, desc="street photographs"):
        people = as_array(one.boxes)
        for sample in candidate_samples(detector, one.frame, pedestrian(people)):
            sources["pennfudan"].add(*sample, one.name)
    marks = {one.frame: one for one in read_marks()}
    for number, frame in read_vtest(shared / "real" / "vtest", len(marks)):
        if number in marks:
            for sample in candidate_samples(detector, frame, walker(marks[number])):
                sources["vtest"].add(*sample, str(number))
    for person in tqdm(read_lsp(shared / "real" / "lsp"), desc="sports photographs"):
        low, size = person.every_joint.min(axis=0), np.ptp(person.every_joint, axis=0)
        body = np.array([[*low, *np.maximum(size, 1)]])
        for sample in candidate_samples(detector, person.frame, athlete(body)):
            sources["lsp"].add(*sample, person.name)
    return sources


def rendered_samples(estimator: Estimator, shared: Path) -> Samples:
    """Collect the candidates of rendered photographs, of people in any posture and of things."""
    samples = Samples()
    studio = Studio.open(
        shared / "mocap", shared / "garments", PEOPLE, RENDERED_SEED, held_out=False
    )
    for number in tqdm(range(RENDERED), desc="rendered photographs"):
        generator = np.random.default_rng([RENDERED_SEED, number])
        empty = bool(generator.random() < RENDERED_EMPTY)
        photograph = studio.take(generator, empty=empty)
        judge = athlete(photograph.box[None])
        for sample in candidate_samples(
            estimator.models.detector, photograph.image, (lambda _: False) if empty else judge
        ):
            samples.add(*sample, str(number))
    return samples


def fit_detection(sources: dict[str, Samples]) -> dict[str, float]:
    """Fit the weights of the detectors' scores; none may be negative."""
    features = np.concatenate([np.array(one.features) for one in sources.values()])
    truths = np.concatenate([np.array(one.truths) for one in sources.values()])
    model = LogisticRegression(C=10.0).fit(features[:, :-2], truths)
    weights = zip(("movenet", "hog", "pose_detection"), model.coef_[0].tolist(), strict=True)
    constants = {name: max(0.0, weight) for name, weight in weights}
    constants["offset"] = float(model.intercept_[0])
    return _rounded(constants)


def fit_objects(
    detection: dict[str, float], sources: Sequence[Samples], rendered: Samples
) -> dict[str, float]:
    """Fit what the log odds of objects add to those of doubtful candidates that count as people.

    Photographs, which show hardly anybody who lies, and renders have the same weight in all.
    """
    weights = np.array([*detection.values()][:-1])
    kinds = []
    for kind in (sources, [rendered]):
        features = np.concatenate([np.array(one.features) for one in kind])
        signs = np.where(np.concatenate([np.array(one.truths) for one in kind]), 1.0, -1.0)
        odds = features[:, :-2] @ weights + detection["offset"]
        chances = sigmoid(odds)
        doubtful = (chances >= MIN_DETECTION_SCORE) & (chances < DOUBTFUL[1])
        person, other = features[doubtful, -2:].T
        evidence = np.stack([person, np.maximum(0, other - person), np.ones_like(person)], axis=1)
        kinds.append((signs[doubtful], odds[doubtful], evidence))

    def loss(constants: NDArray[np.float64]) -> float:
        return sum(
            float(np.logaddexp(0, -signs * (odds + evidence @ constants)).mean())
            for signs, odds, evidence in kinds
        )

    fitted = minimize(loss, np.zeros(3)).x.tolist()
    return _rounded(dict(zip(("person", "excess", "offset"), fitted, strict=True)))


def _rounded(constants: dict[str, float]) -> dict[str, float]:
    return {name: round(value, 4) for name, value in constants.items()}


def main(arguments: Sequence[str] | None = None) -> None:
    """Fit all parts, one after the other."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--shared", type=Path, default=SHARED)
    shared = parser.parse_args(arguments).shared
    if not (shared / "real").is_dir():
        parser.error(f"expected {shared}/real to hold the photographs, it is not there")
    estimator = load_estimator(Settings())
    sources = detection_samples(estimator, shared)
    rendered = rendered_samples(estimator, shared)
    data = ", ".join(f"{len(one.truths)} candidates of {name}" for name, one in sources.items())
    document = json.loads(FITTED.read_text())
    detection = fit_detection(sources)
    objects = fit_objects(detection, [*sources.values()], rendered)
    document["detection"] = {"command": COMMAND, "data": data, "constants": detection}
    data += f", {len(rendered.truths)} of renders"
    document["objects"] = {"command": COMMAND, "data": data, "constants": objects}
    FITTED.write_text(json.dumps(document, indent=1) + "\n")
