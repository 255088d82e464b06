"""Rendered people as the service reads them, beside their true limb joints."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from tqdm import tqdm

from app.estimation.results import Person
from app.estimation.upload import Upload
from app.photograph import Estimator, normalise_person
from app.scheduling.job import Job
from app.vision.optics import PinholeCamera
from index.confidence import RIGHT_BELOW_PX
from index.matching import DEFAULT_HYPOTHESES
from index.skeleton import LIMB_ROWS
from scripts.datasets import about_hips
from scripts.training.photograph_data import LIMBS as LIMB_LANDMARKS
from scripts.training.render.scene import Studio
from scripts.training.render.views import hide
from scripts.training.render_postures import camera_of, rough_box

HIDDEN = 0.35
"""Share of the people who are cut off by the frame, or covered, after the picture was taken."""


@dataclass(frozen=True)
class KnownPerson:
    """A person as read, without poses, and the true limb joints.

    ``limbs_2d`` ``(12, 2)`` are pixels of the frame, ``limbs_3d`` ``(12, 3)`` metres in camera axes
    about the middle of the hips, or None where unknown. ``counted`` ``(12,)`` are the joints that
    an error is a mean over: those that the frame shows.
    """

    person: Person
    camera: PinholeCamera
    limbs_2d: NDArray[np.float64]
    limbs_3d: NDArray[np.float64] | None
    counted: NDArray[np.bool_]


@dataclass(frozen=True)
class Answer:
    """A hypothesis of the ``person``-th person, judged by the true limb joints.

    ``error_px`` is the mean distance of those that count, in pixels of the normalised frame,
    ``distance_m`` that of all, in space, hips on hips; not a number where unknown.
    """

    person: int
    rank: int
    in_depth: bool
    features: NDArray[np.float64]
    presence: float
    confidence: float
    weight: float
    error_px: float
    distance_m: float

    @property
    def right(self) -> bool:
        """Whether the joints are right in the picture."""
        return self.error_px < RIGHT_BELOW_PX


def answers_about(estimator: Estimator, people: Iterable[KnownPerson]) -> Iterator[Answer]:
    """Yield the answers about people who are matched with landmarks."""
    for number, known in enumerate(people):
        normalised = normalise_person(known.person)
        if normalised is None or normalised.normalised_landmarks() is None:
            continue
        scale = float(np.sqrt(abs(np.linalg.det(normalised.to_frame[:, :2]))))
        (fitted,) = estimator.fit([known.person], known.camera, DEFAULT_HYPOTHESES, Job())
        person = fitted or known.person
        for rank, one in enumerate(person.hypotheses, start=1):
            apart = np.linalg.norm(one.points_2d[LIMB_ROWS] - known.limbs_2d, axis=1)
            distance_m = np.nan
            if known.limbs_3d is not None:
                away = about_hips(one.points_3d[LIMB_ROWS]) - known.limbs_3d
                distance_m = float(np.linalg.norm(away, axis=1).mean())
            yield Answer(
                number, rank, one.in_depth, one.features, person.presence, one.confidence,
                one.weight or 0.0, float(apart[known.counted].mean()) / scale, distance_m,
            )  # fmt: skip


def rendered_people(
    estimator: Estimator, studio: Studio, seed: int, count: int
) -> Iterator[KnownPerson]:
    """Yield the people of photographs that the service finds in them."""
    for number in tqdm(range(count), desc="rendered people"):
        generator = np.random.default_rng([seed, number])
        found = _rendered(estimator, studio, generator)
        if found is not None:
            yield found


def _rendered(estimator: Estimator, studio: Studio, generator: Generator) -> KnownPerson | None:
    photograph = studio.take(generator)
    if generator.random() < HIDDEN:
        photograph = hide(photograph, generator)
    upload = Upload(photograph.image, boxes=[rough_box(photograph, generator)])
    decoded = estimator.decode(upload, Job())
    decoded = replace(decoded, camera=camera_of(photograph, generator))
    limbs_2d = photograph.places[LIMB_LANDMARKS]
    counted = photograph.shown[LIMB_LANDMARKS] & inside(limbs_2d, photograph.image.shape)
    (person,) = estimator.finder.find(decoded, "photograph", Job())
    if person.silhouette is None or not counted.any():
        return None
    limbs_3d = about_hips(photograph.landmarks[LIMB_LANDMARKS])
    return KnownPerson(person, decoded.camera, limbs_2d, limbs_3d, counted)


def inside(places: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Which places ``(N, 2)`` lie inside a frame."""
    return np.asarray(((places > -0.5) & (places < np.array(shape[1::-1]) - 0.5)).all(axis=1))
