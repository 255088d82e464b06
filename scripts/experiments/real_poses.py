"""How far the poses of real people are from their references."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from sklearn.linear_model import LogisticRegression
from tqdm import tqdm

from app.estimation.estimator import Estimator, fit_poses
from app.estimation.finder import make_observation
from app.estimation.normalise import NormalisedPerson
from app.estimation.results import ObservedPerson, Person, Scene
from app.scheduling.job import Job
from app.vision.geometry import Box
from app.vision.models import fitted_constants as constants_of
from app.vision.people import LANDMARK_NAMES, Silhouette
from descriptor.silhouette import normalise
from index.skeleton import LIMBS, POINT_NAMES, wrap_degrees
from scripts.experiments.real_data import (
    HIPS,
    Reference,
    StreetPerson,
    VideoFrame,
    azimuth_of_limbs,
)
from scripts.experiments.real_silhouettes import cut_out

HYPOTHESES = 7

Way = Literal["silhouette alone", "landmarks alone", "silhouette and landmarks"]
"""What hypotheses rest on."""

SILHOUETTE: Way = "silhouette alone"
LANDMARKS: Way = "landmarks alone"
BOTH: Way = "silhouette and landmarks"
WAYS: tuple[Way, ...] = (SILHOUETTE, LANDMARKS, BOTH)

NEAR = 0.1
"""A joint is right (PCK) within this share of the body's height."""

LIMBS_RIGHT_BELOW_PX = 5.9
"""What a mean error of 5 px over all 19 joints, as a confidence means it, comes to over the 12
limb joints: ``docs/results/simulation.md`` measures it."""

_ROWS = [POINT_NAMES.index(name) for name in LIMBS]


@dataclass(frozen=True)
class Trial:
    """One person's N hypotheses beside the reference; distances are means over 12 limb joints.

    ``odd``: the photograph is of the half that nothing was tuned on. ``near`` is the share of the
    joints within a tenth of the body height, ``distance_m`` the 3D distance, hips on hips,
    ``facing_right`` whether the camera sees each from the same side, front or back, as the
    reference, ``turned_deg`` the angle between their azimuths, ``error_px`` the 2D distance in the
    normalised frame.
    """

    odd: bool
    near: NDArray[np.float64]
    distance_m: NDArray[np.float64]
    facing_right: NDArray[np.bool_]
    turned_deg: NDArray[np.float64]
    confidence: NDArray[np.float64]
    error_px: NDArray[np.float64]

    @property
    def right(self) -> NDArray[np.bool_]:
        """Whether each hypothesis is right as its confidence means it."""
        return self.error_px < LIMBS_RIGHT_BELOW_PX


@dataclass(frozen=True)
class Asked:
    """Somebody in a true box, cut out by the service, and where their joints are."""

    odd: bool
    frame: NDArray[np.uint8]
    box: Box
    silhouette: Silhouette
    reference: Reference


def in_photographs(people: Sequence[StreetPerson], estimator: Estimator) -> list[Asked]:
    """The street people, but those who are not made out."""
    known: dict[str, list[Silhouette | None]] = {}
    asked = []
    for person in people:
        photograph, row = person.photograph, person.label - 1
        if photograph.name not in known:
            known[photograph.name] = cut_out(estimator, photograph.frame, photograph.boxes)
        silhouette = known[photograph.name][row]
        if silhouette is not None:
            frame, box = photograph.frame, photograph.boxes[row]
            asked.append(Asked(photograph.odd, frame, box, silhouette, person.reference))
    return asked


def in_video(frames: Sequence[VideoFrame], estimator: Estimator) -> list[Asked]:
    """The person of a video, where they are made out."""
    asked = []
    for one in frames:
        (silhouette,) = cut_out(estimator, one.frame, [one.box])
        if silhouette is not None:
            asked.append(Asked(False, one.frame, one.box, silhouette, one.reference))
    return asked


class _NotWhole(NormalisedPerson):
    """Somebody whose silhouette is not searched for: it is said not to show all of the body."""

    whole = False


def estimate(estimator: Estimator, asked: Asked, way: Way) -> Person | None:
    """Seven hypotheses; None where they rest on landmarks alone and too few are seen.

    By landmarks alone as the service does for people who are not seen whole: the entries nearest
    to the landmarks are the only ones, and the silhouette is the frame of reference.
    """
    person = ObservedPerson(asked.box, "boxes", None, asked.silhouette)
    if way != SILHOUETTE:
        reading = estimator.finder.reader.read(asked.frame, asked.box)
        person = make_observation(asked.frame, asked.box, "boxes", None, asked.silhouette, reading)
    if way == LANDMARKS:
        normalised = _NotWhole.of(asked.silhouette, person.landmarks)
        if normalised.keypoints() is None:
            return None
        return fit_poses(estimator.index, person, normalised, HYPOTHESES)
    scene = Scene(asked.frame, (person,))
    return estimator.with_hypotheses(scene, HYPOTHESES, Job())[0]


def trials_of(people: Sequence[Asked], estimator: Estimator, way: Way) -> list[Trial]:
    """Judge what is answered about people."""
    trials = []
    for asked in tqdm(people, desc=f"by {way}", unit="person"):
        person = estimate(estimator, asked, way)
        if person is not None:
            trials.append(judge(asked, person))
    return trials


def judge(asked: Asked, person: Person) -> Trial:
    """Compare a person's hypotheses with the reference."""
    reference = asked.reference
    scale = normalise(asked.silhouette.crop)[1].scale
    points_2d = np.array([one.points_2d[_ROWS] for one in person.hypotheses])
    points_3d = np.array([one.points_3d[_ROWS] for one in person.hypotheses])
    points_3d = points_3d - points_3d[:, list(HIPS)].mean(axis=1, keepdims=True)
    apart = np.linalg.norm(points_2d - reference.joints_2d, axis=-1)
    azimuth = np.array([azimuth_of_limbs(one) for one in points_3d])
    front = np.cos(np.deg2rad(azimuth)) > 0
    turned = np.abs(wrap_degrees(azimuth - reference.azimuth_deg))
    return Trial(
        odd=asked.odd,
        near=(apart < NEAR * asked.box.height).mean(axis=1),
        distance_m=np.linalg.norm(points_3d - reference.joints_3d, axis=-1).mean(axis=-1),
        facing_right=front == (np.cos(np.deg2rad(reference.azimuth_deg)) > 0),
        turned_deg=turned,
        confidence=np.array([one.confidence for one in person.hypotheses]),
        error_px=scale * apart.mean(axis=-1),
    )


def figures(trials: Sequence[Trial]) -> dict[str, float]:
    """Means over people, of the first hypothesis and of the best of seven."""
    if not trials:
        return {"people": 0}
    return {
        "people": len(trials),
        "pck": 100 * _mean([t.near[0] for t in trials]),
        "facing": 100 * _mean([t.facing_right[0] for t in trials]),
        "facing_any": 100 * _mean([t.facing_right.any() for t in trials]),
        "within_90": 100 * _mean([t.turned_deg[0] < 90 for t in trials]),
        "first_mm": 1000 * _mean([t.distance_m[0] for t in trials]),
        "best_mm": 1000 * _mean([t.distance_m.min() for t in trials]),
    }


def _mean(values: Sequence[float | np.floating | np.bool_]) -> float:
    return float(np.mean(np.asarray(values, np.float64)))


def observed_pck(people: Sequence[StreetPerson], estimator: Estimator) -> dict[str, float]:
    """How near the landmarks themselves are to the reference, in true boxes."""
    rows = [LANDMARK_NAMES.index(name) for name in LIMBS]
    other_side = [rows[i ^ 1] for i in range(len(rows))]
    near, sides = [], []
    for person in people:
        box = person.photograph.boxes[person.label - 1]
        seen = estimator.finder.reader.read(person.photograph.frame, box).landmarks
        own, exchanged = (
            np.linalg.norm(seen.positions[some] - person.reference.joints_2d, axis=-1)
            for some in (rows, other_side)
        )
        near.append(float((own < NEAR * box.height).mean()))
        sides.append(float(own.sum() <= exchanged.sum()))
    odd = np.array([person.photograph.odd for person in people])
    return {
        "pck": 100 * _mean(near),
        "odd_pck": 100 * float(np.array(near)[odd].mean()),
        "sides": 100 * _mean(sides),
    }


def fit_confidence(trials: Sequence[Trial]) -> tuple[float, float]:
    """Fit slope and bias that :mod:`app.estimation.ordering` makes a confidence with."""
    agreement = np.concatenate([_agreement(t) for t in trials])
    model = LogisticRegression(C=1e3).fit(
        agreement[:, None], np.concatenate([t.right for t in trials])
    )
    return float(model.coef_[0, 0]), float(model.intercept_[0])


def cross_validated(trials: Sequence[Trial]) -> list[Trial]:
    """The same trials with the confidences that people in the other half of the photographs give.

    Slope and bias of the service are fitted to both halves.
    """
    fitted = {odd: fit_confidence([t for t in trials if t.odd != odd]) for odd in (False, True)}

    def refitted(trial: Trial) -> Trial:
        slope, bias = fitted[trial.odd]
        confidence = 1 / (1 + np.exp(-slope * _agreement(trial) - bias))
        return replace(trial, confidence=confidence)

    return [refitted(trial) for trial in trials]


def _agreement(trial: Trial) -> NDArray[np.float64]:
    """What the confidences of the service, ``(N,)``, were made of."""
    confidence = np.clip(trial.confidence, 1e-9, 1 - 1e-9)
    constants = constants_of("confidence")
    odds = np.log(confidence / (1 - confidence))
    return np.asarray((odds - constants["offset"]) / constants["slope"])
