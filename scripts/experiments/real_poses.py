"""Silhouettes and poses of real people, compared with their references."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.estimation.finder import Found, Target
from app.estimation.poses import NormalisedPerson
from app.estimation.results import Person
from app.estimation.upload import Upload
from app.photograph import Estimator, fit_poses
from app.scheduling.job import Job
from app.vision.geometry import Box
from app.vision.optics import PinholeCamera
from app.vision.people import Detection, Silhouette
from index.matching import DEFAULT_HYPOTHESES
from index.skeleton import LIMB_ROWS, wrap_degrees
from scripts.datasets import Reference, StreetPerson, VideoFrame, about_hips, azimuth_of_limbs
from scripts.metrics import percent

SILHOUETTE, LANDMARKS, BOTH = "silhouette_alone", "landmarks_alone", "silhouette_and_landmarks"
PAPER, PAPER_MASK = "paper_method", "paper_method_network_silhouettes"
"""What hypotheses rest on: the paper's method, with GrabCut's silhouettes or those of the network,
and the service's own by kind of evidence."""

NEAR = 0.1
"""A joint is right (PCK) within this share of the body's height."""


@dataclass(frozen=True)
class Trial:
    """One person's N hypotheses beside the reference; distances are means over 12 limb joints.

    ``odd``: the photograph is of the half that nothing was tuned on. ``near`` is the share of the
    joints within a tenth of the body height, ``distance_m`` the 3D distance, hips on hips,
    ``facing_right`` whether each is seen from the same side, front or back, as the reference,
    ``turned_deg`` the angle between their azimuths.
    """

    odd: bool
    near: NDArray[np.float64]
    distance_m: NDArray[np.float64]
    facing_right: NDArray[np.bool_]
    turned_deg: NDArray[np.float64]


@dataclass(frozen=True)
class Shown:
    """A person in a true box, the silhouette that the service cuts out, and the reference."""

    odd: bool
    frame: NDArray[np.uint8]
    box: Box
    silhouette: Silhouette
    reference: Reference


def cut_out(
    estimator: Estimator, frame: NDArray[np.uint8], boxes: Sequence[Box]
) -> list[Silhouette | None]:
    """Return the service's own silhouettes of people in given boxes."""
    decoded = estimator.decode(Upload(frame, boxes=boxes), Job())
    return [one.silhouette for one in estimator.finder.find(decoded, "silhouette", Job())]


def in_photographs(people: Sequence[StreetPerson], estimator: Estimator) -> list[Shown]:
    """Return the street people whose silhouettes are found."""
    known: dict[str, list[Silhouette | None]] = {}
    shown = []
    for person in people:
        photograph = person.photograph
        if photograph.name not in known:
            known[photograph.name] = cut_out(estimator, photograph.frame, photograph.boxes)
        silhouette = known[photograph.name][person.label - 1]
        if silhouette is not None:
            place = photograph.odd, photograph.frame, person.box
            shown.append(Shown(*place, silhouette, person.reference))
    return shown


def in_video(frames: Sequence[VideoFrame], estimator: Estimator) -> list[Shown]:
    """Return the frames of a video in which the person could be segmented."""
    shown = []
    for one in frames:
        (silhouette,) = cut_out(estimator, one.frame, [one.box])
        if silhouette is not None:
            shown.append(Shown(False, one.frame, one.box, silhouette, one.reference))
    return shown


class _NotWhole(NormalisedPerson):
    """A person whose silhouette is not searched for, since it counts as incomplete."""

    whole = False


def answer(estimator: Estimator, shown: Shown, way: str) -> Person | None:
    """Return seven hypotheses; None where landmarks alone are too few.

    Landmarks alone are used as for people who are not seen whole: candidates are the entries
    nearest to the landmarks, and the silhouette is the frame of reference.
    """
    person = Person(shown.box, "boxes", None, shown.silhouette)
    camera = PinholeCamera.of_frame(shown.frame.shape)
    if way in (PAPER, PAPER_MASK):
        return answer_by_paper(estimator.by("paper"), shown, person if way == PAPER_MASK else None)
    if way != SILHOUETTE:
        decoded = estimator.decode(Upload(shown.frame), Job())
        targets = [Target(Detection(shown.box, 1.0))]
        found = Found(targets, "boxes", cut=lambda _: [shown.silhouette])
        (person,), _ = estimator.finder.observe(decoded, found, Job())
    if way == LANDMARKS:
        normalised = _NotWhole.of(shown.silhouette, person.landmarks)
        if normalised.normalised_landmarks() is None:
            return None
        return fit_poses(estimator.index, person, normalised, camera, DEFAULT_HYPOTHESES)
    return estimator.fit([person], camera, DEFAULT_HYPOTHESES, Job())[0]


def answer_by_paper(paper: Estimator, shown: Shown, person: Person | None) -> Person | None:
    """Return the seven nearest entries of a person, by default as GrabCut cuts them out."""
    if person is None:
        decoded = paper.decode(Upload(shown.frame, boxes=[shown.box]), Job())
        (person,) = paper.finder.find(decoded, "silhouette", Job())
    camera = PinholeCamera.of_frame(shown.frame.shape)
    (found,) = paper.fit([person], camera, DEFAULT_HYPOTHESES, Job())
    return found if found is not None and found.hypotheses else None


def judge(shown: Shown, person: Person) -> Trial:
    """Compare a person's hypotheses with the reference."""
    reference = shown.reference
    points_2d = np.array([one.points_2d[LIMB_ROWS] for one in person.hypotheses])
    points_3d = about_hips(np.array([one.points_3d[LIMB_ROWS] for one in person.hypotheses]))
    apart = np.linalg.norm(points_2d - reference.joints_2d, axis=-1)
    azimuth = np.array([azimuth_of_limbs(one) for one in points_3d])
    front = np.cos(np.deg2rad(azimuth)) > 0
    turned = np.abs(wrap_degrees(azimuth - reference.azimuth_deg))
    return Trial(
        odd=shown.odd,
        near=(apart < NEAR * shown.box.height).mean(axis=1),
        distance_m=np.linalg.norm(points_3d - reference.joints_3d, axis=-1).mean(axis=-1),
        facing_right=front == (np.cos(np.deg2rad(reference.azimuth_deg)) > 0),
        turned_deg=turned,
    )


def pose_figures(trials: Sequence[Trial]) -> dict[str, float]:
    """Return means over people, of the first hypothesis and of the best of seven."""
    if not trials:
        return {"people": 0}
    return {
        "people": len(trials),
        "pck": percent([t.near[0] for t in trials]),
        "facing": percent([t.facing_right[0] for t in trials]),
        "facing_any": percent([t.facing_right.any() for t in trials]),
        "within_90": percent([t.turned_deg[0] < 90 for t in trials]),
        "first_mm": 1000 * float(np.mean([t.distance_m[0] for t in trials])),
        "best_mm": 1000 * float(np.mean([t.distance_m.min() for t in trials])),
    }
