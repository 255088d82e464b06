"""How far the poses of real people are from their references."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.estimation.estimates import Evidence, ObservedPerson, Person, Scene
from app.estimation.estimator import Estimator
from app.estimation.finder import observed
from app.estimation.stopwatch import Stopwatch
from app.vision.people import LANDMARK_NAMES, Box, Silhouette
from descriptor.silhouette import normalise
from index.skeleton import LIMBS, POINT_NAMES, wrap_degrees
from scripts.experiments.real_data import (
    HIPS,
    Photograph,
    Reference,
    StreetPerson,
    VideoFrame,
    azimuth_of_limbs,
)
from scripts.experiments.real_peer import ask, room_about
from scripts.experiments.real_silhouettes import cut_out

HYPOTHESES = 7
NEAR = 0.1
"""A joint is right (PCK) within this share of the body's height."""

LIMBS_RIGHT_BELOW_PX = 5.9
"""What a mean error of 5 px over all 19 joints, as a confidence means it, comes to over the 12
limb joints: ``docs/results/strict.md`` measures it."""

_ROWS = [POINT_NAMES.index(name) for name in LIMBS]


@dataclass(frozen=True)
class Trial:
    """One person's hypotheses beside the reference; distances are means over 12 limb joints.

    Parameters
    ----------
    name : str
    odd : bool
        Whether the photograph is of the half that nothing was tuned on.
    near : (N,) float64 array
        Share of the joints within a tenth of the body height, of each hypothesis.
    distance_m : (N,) float64 array
        3D distance, hips on hips, metres.
    procrustes_m : (N,) float64 array
        The same after the best similarity transform.
    facing_right : (N,) bool array
        Whether the camera sees each from the same side, front or back, as the reference.
    turned_deg : (N,) float64 array
        Angle between the azimuths of each and of the reference, 0 to 180.
    confidence : (N,) float64 array
    apart_px : (N, 12, 2) float64 array
        From each reference joint to the hypothesis's, in pixels of the normalised frame.
    """

    name: str
    odd: bool
    near: NDArray[np.float64]
    distance_m: NDArray[np.float64]
    procrustes_m: NDArray[np.float64]
    facing_right: NDArray[np.bool_]
    turned_deg: NDArray[np.float64]
    confidence: NDArray[np.float64]
    apart_px: NDArray[np.float64]

    @property
    def error_px(self) -> NDArray[np.float64]:
        """Mean 2D distance of each hypothesis in the normalised frame, ``(N,)``."""
        return np.asarray(np.linalg.norm(self.apart_px, axis=-1).mean(axis=-1))

    @property
    def right(self) -> NDArray[np.bool_]:
        """Whether each hypothesis is right as its confidence means it."""
        return self.error_px < LIMBS_RIGHT_BELOW_PX


def estimate(
    estimator: Estimator,
    frame: NDArray[np.uint8],
    box: Box,
    silhouette: Silhouette,
    evidence: Evidence = "photograph",
    n: int = HYPOTHESES,
) -> Person:
    """Hypotheses of one silhouette, and of the landmarks in a box if the photograph is asked."""
    person = ObservedPerson(box, "boxes", None, silhouette)
    if evidence == "photograph":
        person = with_landmarks(estimator, frame, box, silhouette)
    scene = Scene(frame, (person,))
    return estimator.with_hypotheses(scene, n, lambda: None, Stopwatch())[0]


def with_landmarks(
    estimator: Estimator, frame: NDArray[np.uint8], box: Box, silhouette: Silhouette
) -> ObservedPerson:
    """A person whose silhouette is known, with the landmarks that are read in a box."""
    reading = estimator.finder.reader.read(frame, box)
    return observed(frame, box, "boxes", None, silhouette, reading)


def judge(
    name: str, person: Person, reference: Reference, height_px: float, *, odd: bool = False
) -> Trial:
    """Compare a person's hypotheses with the reference; ``height_px`` is the body's."""
    silhouette = person.observed.silhouette
    assert silhouette is not None
    placement = normalise(silhouette.crop)[1]
    scale = placement.scale
    points_2d = np.array([one.points_2d[_ROWS] for one in person.hypotheses])
    points_3d = np.array([one.hypothesis.points_3d[_ROWS] for one in person.hypotheses])
    points_3d = points_3d - points_3d[:, list(HIPS)].mean(axis=1, keepdims=True)
    apart = points_2d - reference.joints_2d
    azimuth = np.array([azimuth_of_limbs(one) for one in points_3d])
    front = np.cos(np.deg2rad(azimuth)) > 0
    turned = np.abs(wrap_degrees(azimuth - reference.azimuth_deg))
    return Trial(
        name=name,
        odd=odd,
        near=(np.linalg.norm(apart, axis=-1) < NEAR * height_px).mean(axis=1),
        distance_m=_distances(points_3d, reference.joints_3d),
        procrustes_m=np.array([procrustes(one, reference.joints_3d) for one in points_3d]),
        facing_right=front == (np.cos(np.deg2rad(reference.azimuth_deg)) > 0),
        turned_deg=turned,
        confidence=np.array([one.confidence for one in person.hypotheses]),
        apart_px=scale * apart,
    )


def _distances(
    points_3d: NDArray[np.float64], reference: NDArray[np.float64]
) -> NDArray[np.float64]:
    return np.asarray(np.linalg.norm(points_3d - reference, axis=-1).mean(axis=-1))


def procrustes(points: NDArray[np.float64], reference: NDArray[np.float64]) -> float:
    """Mean distance after the similarity transform of least squares (no reflection).

    Parameters
    ----------
    points, reference : (J, 3) float64 array
        Of the same joints.
    """
    moved, target = points - points.mean(axis=0), reference - reference.mean(axis=0)
    left, spread, right = np.linalg.svd(moved.T @ target)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    turned = moved @ (left * sign) @ right * float((spread * sign).sum() / (moved**2).sum())
    return float(np.linalg.norm(turned - target, axis=-1).mean())


def street_trials(
    people: Sequence[StreetPerson],
    estimator: Estimator,
    silhouette_of: Callable[[StreetPerson], Silhouette | None],
    evidence: Evidence = "photograph",
) -> list[Trial]:
    """Judge the street people.

    Those without a silhouette are left out; callers say how many.
    """
    trials = []
    for person in tqdm(people, desc="street people", unit="person"):
        silhouette = silhouette_of(person)
        if silhouette is None:
            continue
        box = person.photograph.boxes[person.label - 1]
        found = estimate(estimator, person.photograph.frame, box, silhouette, evidence)
        height = box.height
        name = f"{person.photograph.name}-{person.label}"
        trials.append(judge(name, found, person.reference, height, odd=person.photograph.odd))
    return trials


def segmented(estimator: Estimator) -> Callable[[StreetPerson], Silhouette | None]:
    """The service's own silhouettes, in the true boxes of the photograph."""
    known: dict[str, list[Silhouette | None]] = {}

    def silhouette(person: StreetPerson) -> Silhouette | None:
        photograph: Photograph = person.photograph
        if photograph.name not in known:
            known[photograph.name] = cut_out(estimator, photograph.frame, photograph.boxes)
        return known[photograph.name][person.label - 1]

    return silhouette


@dataclass(frozen=True)
class VideoTrials:
    """One camera's trials, and how many of its frames gave none because nobody was found."""

    trials: list[Trial]
    frames: int


def video_trials(
    frames: Sequence[VideoFrame],
    estimator: Estimator,
    *,
    own_detection: bool,
    evidence: Evidence = "photograph",
) -> VideoTrials:
    """Judge the person of a video, in the true box or in the detection that overlaps it most."""
    trials = []
    for one in tqdm(frames, desc=frames[0].name.split("/")[0], unit="frame"):
        box: Box | None = one.box
        if own_detection:
            boxes = [d.box for d in estimator.detector.detect(one.frame)]
            box = max(boxes, key=one.box.iou, default=None)
            if box is None or box.iou(one.box) < 0.3:
                continue
        assert box is not None
        (silhouette,) = cut_out(estimator, one.frame, [box])
        if silhouette is None:
            continue
        person = estimate(estimator, one.frame, box, silhouette, evidence)
        trials.append(judge(one.name, person, one.reference, one.box.height))
    return VideoTrials(trials, len(frames))


def figures(trials: Sequence[Trial]) -> dict[str, float]:
    """Means over people, of the first hypothesis and of the best of seven."""
    if not trials:
        return {"people": 0}
    return {
        "people": len(trials),
        "pck": 100 * _mean([t.near[0] for t in trials]),
        "pck_best": 100 * _mean([t.near.max() for t in trials]),
        "facing": 100 * _mean([t.facing_right[0] for t in trials]),
        "facing_any": 100 * _mean([t.facing_right.any() for t in trials]),
        "within_90": 100 * _mean([t.turned_deg[0] < 90 for t in trials]),
        "first_mm": 1000 * _mean([t.distance_m[0] for t in trials]),
        "best_mm": 1000 * _mean([t.distance_m.min() for t in trials]),
        "first_procrustes_mm": 1000 * _mean([t.procrustes_m[0] for t in trials]),
        "best_procrustes_mm": 1000 * _mean([t.procrustes_m.min() for t in trials]),
        "error_px": _mean([t.error_px[0] for t in trials]),
        "stated": 100 * _mean([t.confidence[0] for t in trials]),
        "right": 100 * _mean([t.right[0] for t in trials]),
    }


def _mean(values: Sequence[float | np.floating | np.bool_]) -> float:
    return float(np.mean(np.asarray(values, np.float64)))


def peer_on_video(frames: Sequence[VideoFrame], python: Path) -> dict[str, float]:
    """MediaPipe's 3D distances, on true boxes with room about them."""
    crops = {}
    for one in frames:
        left, top, right, bottom = room_about(one.box, one.frame.shape)
        crops[one.name.replace("/", "-")] = one.frame[top:bottom, left:right]
    answers = ask(python, crops)
    distances, aligned = [], []
    for one in frames:
        points = answers[one.name.replace("/", "-")].points_3d
        if points is None:
            continue
        points = points - points[list(HIPS)].mean(axis=0)
        distances.append(float(_distances(points[None], one.reference.joints_3d)[0]))
        aligned.append(procrustes(points, one.reference.joints_3d))
    return {
        "people": len(distances),
        "first_mm": 1000 * _mean(distances),
        "first_procrustes_mm": 1000 * _mean(aligned),
        "milliseconds": _mean([answer.milliseconds for answer in answers.values()]),
    }


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
