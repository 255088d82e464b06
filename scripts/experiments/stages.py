"""What each step of the method adds: the same people, answered with and without it.

People are given in true boxes, so that all ways answer about the same ones; how well they are found
is measured beside that. Rendered people ship. Of ``../shared/real`` what lies there is used: street
people (compared with MediaPipe's reading), a balancing person before three cameras (triangulated)
and sports photographs (marked by hand).
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.estimation.results import Person
from app.photograph import Estimator, load_estimator
from app.settings import Settings
from index.skeleton import LIMB_ROWS
from scripts.datasets import (
    Reference,
    padded_box,
    read_lsp,
    read_pennfudan,
    read_pose2sim,
    read_street_people,
)
from scripts.experiments.people import NEAR_OF_TRUNK
from scripts.experiments.permutation import permuted
from scripts.experiments.real_detection import measure_detection, measure_hog
from scripts.experiments.real_poses import (
    BOTH,
    LANDMARKS,
    PAPER,
    PAPER_MASK,
    SILHOUETTE,
    Shown,
    answer,
    cut_out,
    in_photographs,
    in_video,
    judge,
    pose_figures,
)
from scripts.experiments.rendered_people import read_rendered_people
from scripts.metrics import percent

CAMERAS = ("cam01", "cam02", "cam03")
FRAME_STEP, SPORT_STEP = 4, 2
"""Every so many-th frame of a film, and photograph of sport, is asked."""

SEED = 76
DEFAULT = "silhouette_and_landmarks"
Way = Callable[[Shown], Person | None]
"""How a person is answered; None where that cannot be."""

Figures = dict[str, float]


def run(options: argparse.Namespace) -> dict[str, object]:
    """Run the experiment."""
    cv2.setNumThreads(1)
    estimator, real = load_estimator(Settings()), options.shared / "real"
    ways = ways_of(estimator)
    stages: dict[str, dict[str, Figures]] = {name: {} for name in ways}
    for source, people in sources(real, estimator):
        for name, way in ways.items():
            answered = [(one, way(one)) for one in tqdm(people, desc=f"{source}: {name}")]
            stages[name][source] = figures_of(answered)
    return {
        "stages": stages,
        "people": {
            source: stages[DEFAULT].get(source, {}).get("people")
            for source in ("rendered", "street", *CAMERAS, "lsp")
        },
        "detection": detection(real / "pennfudan", estimator),
        "seed": SEED,
    }


def ways_of(estimator: Estimator) -> dict[str, Way]:
    """Return how people are answered, step by step."""
    index = estimator.index
    not_reranked = estimator.with_index(replace(index, reranker=None, searched_by=None))
    at_random = estimator.with_index(permuted(index, SEED))
    return {
        PAPER: lambda shown: answer(estimator, shown, PAPER),
        PAPER_MASK: lambda shown: answer(estimator, shown, PAPER_MASK),
        "silhouette_not_reranked": lambda shown: answer(not_reranked, shown, SILHOUETTE),
        "silhouette": lambda shown: answer(estimator, shown, SILHOUETTE),
        "silhouette_permuted": lambda shown: answer(at_random, shown, SILHOUETTE),
        "landmarks": lambda shown: answer(estimator, shown, LANDMARKS),
        DEFAULT: lambda shown: answer(estimator, shown, BOTH),
        "silhouette_and_landmarks_permuted": lambda shown: answer(at_random, shown, BOTH),
    }


def sources(real: Path, estimator: Estimator) -> Iterator[tuple[str, list[Shown]]]:
    """Yield the people that ship, and those of the data that lies there, by source."""
    yield "rendered", in_video(read_rendered_people(), estimator)
    if (real / "pennfudan").is_dir():
        photographs = read_pennfudan(real / "pennfudan")
        people = read_street_people(real / "pennfudan", photographs)
        yield "street", in_photographs(people, estimator)
    for camera in CAMERAS:
        if (real / "pose2sim" / f"{camera}.mp4").is_file():
            frames = read_pose2sim(real / "pose2sim", camera, FRAME_STEP)
            yield camera, in_video(frames, estimator)
    if (real / "lsp").is_dir():
        yield "lsp", in_sport(real / "lsp", estimator)


@dataclass(frozen=True)
class ShownAthlete(Shown):
    """A person in sport; ``visible`` ``(12,)`` are the joints of the reference that count."""

    visible: NDArray[np.bool_]


def in_sport(folder: Path, estimator: Estimator) -> list[Shown]:
    """Return the people of sports photographs whose silhouettes are found."""
    shown: list[Shown] = []
    for one in list(read_lsp(folder))[::SPORT_STEP]:
        height, width = one.frame.shape[:2]
        box = padded_box(one.every_joint).clip(width, height)
        silhouette = None if box is None else cut_out(estimator, one.frame, [box])[0]
        if box is not None and silhouette is not None and one.visible.any():
            reference = Reference(one.limbs, np.full((len(one.limbs), 3), np.nan))
            place = False, one.frame, box, silhouette, reference
            shown.append(ShownAthlete(*place, one.visible))
    return shown


def figures_of(answered: Sequence[tuple[Shown, Person | None]]) -> Figures:
    """Compare answers with references; people in sport have none in three dimensions."""
    known = [(shown, person) for shown, person in answered if person is not None]
    sport = [
        right_joints(shown, person) for shown, person in known if isinstance(shown, ShownAthlete)
    ]
    if sport:
        return {"people": len(sport), "pck": percent(sport)}
    return pose_figures([judge(*one) for one in known])


def right_joints(shown: ShownAthlete, person: Person) -> float:
    """Share of visible limb joints within a fifth of the trunk, as in ``evaluate people``."""
    limbs = shown.reference.joints_2d
    # Across, from each shoulder to the other side's hip.
    trunk = np.linalg.norm(limbs[[0, 1]] - limbs[[7, 6]], axis=1).max()
    apart = np.linalg.norm(person.hypotheses[0].points_2d[LIMB_ROWS] - limbs, axis=1)
    return float((apart[shown.visible] < NEAR_OF_TRUNK * trunk).mean())


def detection(folder: Path, estimator: Estimator) -> dict[str, Figures]:
    """Return how well people are found in street photographs; nothing where they do not lie."""
    if not folder.is_dir():
        return {}
    photographs = read_pennfudan(folder)
    own = measure_detection(photographs, estimator.models.detector)
    return {"hog": measure_hog(photographs), **own}
