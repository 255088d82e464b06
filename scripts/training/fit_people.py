"""Fit detection scores, lying bodies, postures and confidences to photographs.

Writes the parts `detection`, `grounded`, `posture` and `confidence` of
``app/vision/models/fitted.json`` within about ten minutes.

The data are street photographs (Penn-Fudan), frames of the street video, sports photographs (LSP
Extended: detection and confidence), photographs with and without a fallen person (Ambianic), and
simulated bodies of the index, since few people bend or crouch in photographs. Pose2Sim, UP-Fall and
the fall videos are not used, so that they remain a test; frames of UP-Fall among the fall
photographs are left out.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from sklearn.linear_model import LogisticRegression
from tqdm import tqdm

from app.estimation.estimator import Estimator, normalise_person
from app.estimation.posture_probability import GROUPS, body_features
from app.estimation.results import Person
from app.serving.loading import load_estimator
from app.settings import Settings
from app.vision.detector import HogDetector, NetworkDetector, detection_features
from app.vision.geometry import Box, Boxes, iou_matrix
from app.vision.models import write_fitted
from app.vision.odds import log_odds
from app.vision.people import LANDMARK_NAMES, Landmarks
from index.confidence import RIGHT_BELOW_PX
from index.parameters import RANKING
from index.posture import ON_THE_GROUND, POSTURES, UPRIGHT, camera_up, classify_postures
from index.skeleton import LIMB_ROWS, LIMBS, POINT_NAMES, camera_rotation, rotate_clockwise
from index.store import PoseIndex
from scripts.datasets import (
    Marks,
    Photograph,
    as_array,
    read_lsp,
    read_marks,
    read_pennfudan,
    read_street_people,
    read_vtest,
)
from scripts.helpers import estimate
from scripts.metrics import rightness
from scripts.results import SHARED

COMMAND = "python -m scripts fit-people"
UPFALL_SHAPE = (352, 640)
"""Fall photographs of this size are frames of UP-Fall."""

FOLDS = 10
SAME = 0.5
"""Overlap (IoU) from which a candidate is an annotated person."""

SIMULATED_FROM, SIMULATED_EACH, SIMULATED_WEIGHT = 40_000, 400, 100.0
"""Entries from which simulated bodies are drawn, how many of each posture, and the number of
photographed people that all of them together count for."""

NOISE_M, ROLL_DEG, PX_PER_M = (0.03, 0.03, 0.08), 6.0, 200.0

_STRENGTH = 0.1


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


def photographs(folder: Path) -> Source:
    """Yield names and pixels of the photographs of a folder, in order."""
    for file in sorted(folder.glob("*.jpg")):
        frame = cv2.imread(str(file))
        if frame is not None and frame.shape[:2] != UPFALL_SHAPE:
            yield file.name, np.asarray(frame, np.uint8)


def candidate_samples(
    detector: NetworkDetector, frame: NDArray[np.uint8], judge: Callable[[Box], bool | None]
) -> Iterator[tuple[NDArray[np.float64], bool]]:
    """Yield scores of the candidates of a frame, and whether they are people, where known."""
    found, scores = detector.candidates(frame)
    for one, row in zip(found, detection_features(scores), strict=True):
        truth = judge(one.box)
        if truth is not None:
            yield row, truth


def overlap(box: Box, people: Boxes) -> float:
    """Return the largest overlap of a box with people."""
    return float(iou_matrix(as_array([box]), people).max(initial=0.0))


def pedestrian(people: Boxes) -> Callable[[Box], bool | None]:
    """Judge candidates in street photographs."""
    return lambda box: overlap(box, people) >= SAME


def athlete(body: Boxes) -> Callable[[Box], bool | None]:
    """Judge candidates in sports photographs, where only one person is annotated."""
    return lambda box: True if overlap(box, body) >= 0.3 else None


def walker(marks: Marks) -> Callable[[Box], bool | None]:
    """Judge candidates in the street video: None for barely visible people."""

    def judge(box: Box) -> bool | None:
        if overlap(box, as_array(marks.people)) >= SAME:
            return True
        return None if overlap(box, as_array(marks.ignored)) >= 0.3 else False

    return judge


def detection_samples(estimator: Estimator, shared: Path) -> dict[str, Samples]:
    """Collect the candidates of every source that has boxes or joints."""
    detector = estimator.detector
    assert isinstance(detector, NetworkDetector)
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


def posture_samples(
    estimator: Estimator, shared: Path
) -> tuple[dict[str, Samples], dict[str, list[tuple[Person, tuple[str, ...]]]]]:
    """Collect bodies that lie or do not, and people with the postures that are right for them."""
    grounded = {name: Samples() for name in ("fall", "not-fall", "street")}
    people: dict[str, list[tuple[Person, tuple[str, ...]]]] = {name: [] for name in grounded}
    real = shared / "real"
    for kind in ("fall", "not-fall"):
        for name, frame in tqdm([*photographs(real / "falls" / kind)], desc=kind):
            found = [one for one in estimate(estimator, frame) if one.observed.landmarks]
            if kind == "fall":
                # The fallen person is the subject of the picture; helpers are smaller.
                found = sorted(found, key=lambda one: -one.observed.box.area)[:1]
            for one in found:
                grounded[kind].add(_body(one), kind == "fall", name)
                if kind == "fall":
                    people[kind].append((one, ON_THE_GROUND))
    frames = [(one.name, one.frame) for one in read_pennfudan(real / "pennfudan")]
    frames += [(str(number), frame) for number, frame in read_vtest(real / "vtest", 20)]
    for name, frame in tqdm(frames, desc="street"):
        for one in estimate(estimator, frame):
            if one.observed.landmarks:
                grounded["street"].add(_body(one), False, name)
                people["street"].append((one, UPRIGHT))
    return grounded, people


def _body(person: Person) -> NDArray[np.float64]:
    landmarks = person.observed.landmarks
    assert isinstance(landmarks, Landmarks)
    return body_features(landmarks)


def fit_detection(sources: dict[str, Samples]) -> dict[str, float]:
    """Fit the weights of the detectors' scores; none may be negative."""
    features = np.concatenate([np.array(one.features) for one in sources.values()])
    truths = np.concatenate([np.array(one.truths) for one in sources.values()])
    model = LogisticRegression(C=10.0).fit(features, truths)
    weights = zip(("movenet", "hog", "pose_detection"), model.coef_[0].tolist(), strict=True)
    constants = {name: max(0.0, weight) for name, weight in weights}
    constants["offset"] = float(model.intercept_[0])
    return {name: round(value, 4) for name, value in constants.items()}


def fit_hog(street: Sequence[Photograph]) -> dict[str, float]:
    """Fit the constants that turn HOG's margins alone into probabilities."""
    right, margins = [], []
    alone = HogDetector(min_score=0.0)
    for photograph in street:
        boxes, found = alone.people(photograph.frame)
        right.append(rightness((boxes, found), as_array(photograph.boxes)))
        margins.append(found)
    model = LogisticRegression().fit(np.concatenate(margins)[:, None], np.concatenate(right))
    return {
        "hog_alone": round(float(model.coef_[0, 0]), 4),
        "hog_alone_offset": round(float(model.intercept_[0]), 4),
    }


def simulated_samples(index: PoseIndex) -> Samples:
    """Draw bodies of the index in every posture, with landmarks as a network would read them."""
    rng = np.random.default_rng(0)
    rows = np.sort(rng.permutation(len(index))[:SIMULATED_FROM])
    entries = index.entries[rows]
    rotations = camera_rotation(entries["azimuth_deg"], entries["elevation_deg"])
    points = index.skeletons[entries["skeleton"]].astype(np.float64)
    points = points @ rotations.swapaxes(1, 2)
    postures = classify_postures(points, camera_up(entries["elevation_deg"]))
    samples = Samples()
    for number, posture in enumerate(POSTURES):
        for row in np.flatnonzero(postures == number)[:SIMULATED_EACH]:
            metres = points[row][_POINT_OF_LANDMARK] + rng.normal(0, NOISE_M, (33, 3))
            metres = rotate_clockwise(metres, float(rng.normal(0, ROLL_DEG)))
            landmarks = Landmarks(PX_PER_M * metres[:, :2], np.full(33, 0.95), metres)
            samples.add(body_features(landmarks), posture in ON_THE_GROUND, "simulated")
    return samples


def _point_of_landmark(name: str) -> int:
    """Return the point of the index that is nearest to a landmark."""
    side, _, part = name.rpartition("_") if name.startswith("mouth") else name.partition("_")
    if part in ("inner", "outer") or "eye" in name:
        return POINT_NAMES.index(f"{side}_eye")
    part = {"pinky": "wrist", "index": "wrist", "thumb": "wrist", "heel": "ankle"}.get(part, part)
    if name == "nose" or name.startswith("mouth"):
        return POINT_NAMES.index("nose")
    return POINT_NAMES.index(f"{side}_{'toe' if part == 'foot_index' else part}")


_POINT_OF_LANDMARK = [_point_of_landmark(name) for name in LANDMARK_NAMES]


def fit_grounded(sources: dict[str, Samples], simulated: Samples) -> dict[str, Any]:
    """Fit a logistic model of lying, on features standardised by those of photographs."""
    photographed = np.concatenate([np.array(one.features) for one in sources.values()])
    truths = np.concatenate(
        [*(np.array(one.truths) for one in sources.values()), np.array(simulated.truths)]
    )
    weights = np.ones(len(truths))
    weights[len(photographed) :] = SIMULATED_WEIGHT / len(simulated.truths)
    means, scales = photographed.mean(axis=0), photographed.std(axis=0) + 1e-6
    features = np.concatenate([photographed, np.array(simulated.features)])
    model = LogisticRegression(C=_STRENGTH, max_iter=5000)
    model.fit((features - means) / scales, truths, sample_weight=weights)
    return {
        "means": means.round(4).tolist(),
        "scales": scales.round(4).tolist(),
        "weights": model.coef_[0].round(4).tolist(),
        "offset": round(float(model.intercept_[0]), 4),
    }


def cross_validated(
    sources: dict[str, Samples], simulated: Samples
) -> dict[str, NDArray[np.float64]]:
    """Return the probability of lying of each sample, by models that did not see its photograph."""
    names = sorted({group for one in sources.values() for group in one.groups})
    order = np.random.default_rng(0).permutation(len(names)) % FOLDS
    fold = dict(zip(names, order.tolist(), strict=True))
    result = {name: np.zeros(len(one.truths)) for name, one in sources.items()}
    for held in range(FOLDS):
        known = {}
        for name, one in sources.items():
            rows = [i for i, group in enumerate(one.groups) if fold[group] != held]
            known[name] = Samples(
                [one.features[i] for i in rows],
                [one.truths[i] for i in rows],
                [one.groups[i] for i in rows],
            )
        model = fit_grounded(known, simulated)
        for name, one in sources.items():
            for i, group in enumerate(one.groups):
                if fold[group] == held:
                    result[name][i] = probability(one.features[i], model)
    return result


def probability(features: NDArray[np.float64], model: dict[str, Any]) -> float:
    """Apply a model of :func:`fit_grounded`."""
    standardised = (features - np.array(model["means"])) / np.array(model["scales"])
    odds = standardised @ np.array(model["weights"]) + model["offset"]
    return float(1 / (1 + np.exp(-odds)))


def by_photograph(samples: Samples, probabilities: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the highest probability of each photograph."""
    highest: dict[str, float] = {}
    for group, one in zip(samples.groups, probabilities.tolist(), strict=True):
        highest[group] = max(highest.get(group, 0.0), one)
    return np.array(list(highest.values()))


def fit_posture(
    people: dict[str, list[tuple[Person, tuple[str, ...]]]],
) -> dict[str, float]:
    """Fit the log odds that the group of the likeliest posture is right."""
    shares, right, weights = [], [], []
    for people_of_kind in people.values():
        for person, postures in people_of_kind:
            assert person.posture is not None
            likeliest = POSTURES[int(person.posture.shares.argmax())]
            group = next(group for group in GROUPS if likeliest in group)
            shares.append(log_odds(person.posture.share(group)))
            right.append(likeliest in postures)
            weights.append(1 / len(people_of_kind))
    model = LogisticRegression().fit(
        np.array(shares)[:, None], right, np.array(weights) * len(shares) / sum(weights)
    )
    return {
        "slope": round(float(model.coef_[0, 0]), 4),
        "offset": round(float(model.intercept_[0]), 4),
    }


def confidence_samples(
    estimator: Estimator, shared: Path
) -> tuple[list[tuple[float, float]], list[bool]]:
    """Collect agreement and adjustment of the hypotheses of people in sport and in the street.

    The second list says whether each is right: over the limbs annotated as visible, or those of
    MediaPipe's landmarks where its mask agrees with the true one.
    """
    features: list[tuple[float, float]] = []
    right: list[bool] = []

    def add(person: Person, joints: NDArray[np.float64], seen: NDArray[np.bool_]) -> None:
        normalised = normalise_person(person.observed)
        if normalised is None:
            return
        to_frame = float(np.sqrt(abs(np.linalg.det(normalised.to_frame[:, :2]))))
        for placed in person.hypotheses:
            errors = np.linalg.norm(placed.points_2d[LIMB_ROWS] - joints, axis=1)[seen]
            agreement = -RANKING.distance_weight * float(np.log(max(placed.distance, 1e-9)))
            features.append((agreement, placed.adjusted_m))
            right.append(bool(errors.mean() / to_frame < RIGHT_BELOW_PX))

    for one in tqdm(read_lsp(shared / "real" / "lsp"), desc="sports people"):
        middle = one.limbs.mean(axis=0)
        people = [
            person
            for person in estimate(estimator, one.frame)
            if _holds(person.observed.whole_box, middle) and person.hypotheses
        ]
        if people and one.visible.any():
            largest = max(people, key=lambda other: other.observed.whole_box.area)
            add(largest, one.limbs, one.visible)
    folder = shared / "real" / "pennfudan"
    for street in tqdm(read_street_people(folder, read_pennfudan(folder)), desc="street people"):
        (person,) = estimate(estimator, street.photograph.frame, street.box)
        add(person, street.reference.joints_2d, np.ones(len(LIMBS), bool))
    return features, right


def _holds(box: Box, place: NDArray[np.float64]) -> bool:
    return bool(box.x <= place[0] <= box.right and box.y <= place[1] <= box.bottom)


def fit_confidence(features: list[tuple[float, float]], right: list[bool]) -> dict[str, float]:
    """Fit the log odds that a hypothesis is right."""
    model = LogisticRegression(C=100.0).fit(np.array(features), right)
    slope, adjusted_m = model.coef_[0].tolist()
    return {
        "slope": round(slope, 4),
        "adjusted_m": round(adjusted_m, 4),
        "offset": round(float(model.intercept_[0]), 4),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Fit all parts, one after the other."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--shared", type=Path, default=SHARED)
    shared = parser.parse_args(arguments).shared
    if not (shared / "real").is_dir():
        parser.error(f"expected {shared}/real to hold the photographs, it is not there")
    estimator = load_estimator(Settings())
    detection = detection_samples(estimator, shared)
    data = ", ".join(f"{len(one.truths)} candidates of {name}" for name, one in detection.items())
    street = read_pennfudan(shared / "real" / "pennfudan")
    write_fitted("detection", COMMAND, data, {**fit_detection(detection), **fit_hog(street)})
    grounded, _ = posture_samples(estimator, shared)
    simulated = simulated_samples(estimator.index)
    probabilities = cross_validated(grounded, simulated)
    for name, samples in grounded.items():
        share = (by_photograph(samples, probabilities[name]) >= 0.5).mean()
        print(f"{name}: lying or crawling in {100 * share:.1f} % of photographs, cross-validated")
    data = ", ".join(f"{len(one.truths)} people of {name}" for name, one in grounded.items())
    write_fitted("grounded", COMMAND, data, fit_grounded(grounded, simulated))
    # Shares depend on the model above.
    _, people = posture_samples(estimator, shared)
    write_fitted("posture", COMMAND, "people who fell or walk", fit_posture(people))
    features, right = confidence_samples(estimator, shared)
    data = (
        f"{len(right)} hypotheses of people in sport and in the street, "
        f"{100 * np.mean(right):.0f} % of them right"
    )
    write_fitted("confidence", COMMAND, data, fit_confidence(features, right))
