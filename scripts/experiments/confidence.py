"""The confidences as they ship: how often hypotheses are right that are said to be.

Nothing is fitted here. Street people are in their true boxes, people in sport are found; rendered
people and silhouettes are of clips, bodies and clothes that nothing was fitted to.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from app.estimation.upload import Upload
from app.photograph import Estimator, load_estimator
from app.scheduling.job import Job
from app.settings import Settings
from index.skeleton import LIMBS
from scripts.datasets import read_lsp, read_pennfudan, read_street_people
from scripts.index.builder import entries_of
from scripts.index.calibrate import expected_calibration_error, run_trial
from scripts.metrics import percent, reliability
from scripts.training.confidence_data import Answer, KnownPerson, answers_about, rendered_people
from scripts.training.fit_confidence import held_out_queries
from scripts.training.held_out import part
from scripts.training.render_people import studio_of

PEOPLE, RENDERED, SEED = 12, 192, 79
"""Bodies, photographs, and the seed of both and of the silhouettes."""

Figures = dict[str, Any]


def run(options: argparse.Namespace) -> Figures:
    """Run the experiment."""
    cv2.setNumThreads(1)
    estimator, real = load_estimator(Settings()), options.shared / "real"
    studio = studio_of(options.shared, PEOPLE, SEED, held_out=True)
    sources = {
        "street_people": street_people(estimator, real / "pennfudan"),
        "people_in_sport": people_in_sport(estimator, real / "lsp"),
        "rendered_people": rendered_people(estimator, studio, SEED, RENDERED),
    }
    answers = {name: list(answers_about(estimator, one)) for name, one in sources.items()}
    kept, queries = held_out_queries(options.shared, 1, SEED)
    strict = part(estimator.index, entries_of(estimator.index, kept))
    trial = run_trial(strict, queries)
    offered = np.isfinite(trial.error_px)
    confidences = {name: stated_and_met(some) for name, some in answers.items()}
    confidences["silhouettes"] = figures_of(trial.confidence[offered], trial.right[offered])
    return {"confidence": confidences, "weight": weight_figures(answers["rendered_people"])}


def street_people(estimator: Estimator, folder: Path) -> Iterator[KnownPerson]:
    """Yield the people of Penn-Fudan that have references, in their true boxes."""
    for one in read_street_people(folder, read_pennfudan(folder)):
        decoded = estimator.decode(Upload(one.photograph.frame, boxes=[one.box]), Job())
        (person,) = estimator.finder.find(decoded, "photograph", Job())
        every = np.ones(len(LIMBS), bool)
        reference = one.reference
        yield KnownPerson(person, decoded.camera, reference.joints_2d, reference.joints_3d, every)


def people_in_sport(estimator: Estimator, folder: Path) -> Iterator[KnownPerson]:
    """Yield the annotated people of LSP that are found; the joints annotated as visible count."""
    for one in read_lsp(folder):
        decoded = estimator.decode(Upload(one.frame), Job())
        x, y = one.limbs.mean(axis=0)
        holding = [
            person
            for person in estimator.finder.find(decoded, "photograph", Job())
            if person.whole_box.x <= x <= person.whole_box.right
            and person.whole_box.y <= y <= person.whole_box.bottom
        ]
        if holding and one.visible.any():
            largest = max(holding, key=lambda person: person.whole_box.area)
            yield KnownPerson(largest, decoded.camera, one.limbs, None, one.visible)


def stated_and_met(answers: list[Answer]) -> Figures:
    """Return the figures of all hypotheses whose truth is known.

    Where no depths are, those are not known that are alternatives in depth.
    """
    first = {one.person: one for one in answers if one.rank == 1}
    known = [one for one in answers if not one.in_depth or np.isfinite(one.distance_m)]
    right = [
        one.right and (not one.in_depth or one.distance_m < first[one.person].distance_m)
        for one in known
    ]
    stated = np.array([one.confidence for one in known])
    leading = np.array([one.rank == 1 for one in known])
    figures = figures_of(stated, np.array(right))
    own = figures_of(stated[leading], np.array(right)[leading])
    return {**figures, "people": len(first), "first": {k: v for k, v in own.items() if k != "bins"}}


def figures_of(stated: NDArray[np.float64], right: NDArray[np.bool_]) -> Figures:
    """Return the calibration error, means, and five bins."""
    return {
        "hypotheses": len(stated),
        "ece": expected_calibration_error(stated, right),
        "stated": percent(stated),
        "right": percent(right),
        "bins": reliability(stated, right, 5),
    }


def weight_figures(answers: list[Answer]) -> Figures:
    """Return how often the nearest of seven is the first, and the calibration of weights."""
    people: dict[int, list[Answer]] = {}
    for one in answers:
        people.setdefault(one.person, []).append(one)
    nearest = np.concatenate(
        [
            np.arange(len(some)) == np.argmin([one.distance_m for one in some])
            for some in people.values()
        ]
    )
    weights = np.array([one.weight for one in answers])
    first = np.array([one.rank == 1 for one in answers])
    return {
        "ece": expected_calibration_error(weights, nearest),
        "first_stated": percent(weights[first]),
        "first_nearest": percent(nearest[first]),
    }
