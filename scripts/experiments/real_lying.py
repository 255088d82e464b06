"""People who lie, as far as street photographs show them: turned by a quarter.

Light and shadow come from a side then, and the ground stands upright; what is measured is whether
bodies are found that lie, and whether anything else is taken for one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.vision.detect import CascadeDetector, probability
from app.vision.joints import JointReader
from app.vision.lying import lying_parts, seen_upright, segment_either_way, which_way_up
from app.vision.networks import PersonNetwork
from app.vision.people import Box, silhouette_from_mask
from app.vision.people_detector import MIN_SCORE
from app.vision.second_look import DOUBTED, believed
from app.vision.segment import NetworkSegmenter
from scripts.experiments.real_data import Photograph
from scripts.experiments.real_detection_fit import fit_logistic, folds
from scripts.experiments.real_silhouettes import overlap
from scripts.experiments.real_vtest import FOUND_FROM

RIDGE = 0.01

RARITY = 0.1
"""How much rarer people who lie are in use than where every second photograph is turned."""


@dataclass(frozen=True)
class Part:
    """What may be somebody who lies.

    Parameters
    ----------
    clarity : float
        How clearly joints show.
    right : bool
        Whether it overlaps somebody by half or more.
    right_way_up : bool
        Whether it is taken to be turned as the photograph is.
    """

    clarity: float
    right: bool
    right_way_up: bool


@dataclass(frozen=True)
class Trial:
    """Parts of one photograph as it is, and turned by a quarter; and how many people it shows."""

    upright: list[Part]
    turned: list[Part]
    people: int


def lying_trials(
    photographs: Sequence[Photograph],
    network: PersonNetwork,
    segmenter: NetworkSegmenter,
    reader: JointReader,
) -> list[Trial]:
    """Look for people who lie in photographs, and in the same turned to the left or the right."""
    cascade = CascadeDetector(network, min_score=DOUBTED[0])

    def parts(frame: NDArray[np.uint8], people: Sequence[Box], turns: int) -> list[Part]:
        found, presence = cascade.look(frame)
        boxes = [one.box for one in believed(segmenter, reader, frame, found, MIN_SCORE)]
        looked = [
            (part, *which_way_up(reader, frame, part, (1, 3)))
            for part in seen_upright(network, frame, lying_parts(presence, boxes, frame.shape))
        ]
        return [
            Part(
                clarity,
                max((part.box.iou(box) for box in people), default=0.0) >= FOUND_FROM,
                guessed == turns,
            )
            for part, clarity, guessed in looked
        ]

    trials = []
    for photograph in tqdm(photographs, desc="lying", unit="photograph"):
        upright, turned = parts(photograph.frame, [], 0), _turned(photograph)
        lying = parts(turned.frame, turned.boxes, _back(photograph))
        trials.append(Trial(upright, lying, len(turned.boxes)))
    return trials


def fitted_lying(trials: Sequence[Trial]) -> tuple[float, float]:
    """Weight of the clarity, and offset, that tell people who lie from all else."""
    parts = [part for trial in trials for part in [*trial.upright, *trial.turned]]
    clarity = np.array([[part.clarity] for part in parts])
    weights, offset = fit_logistic(clarity, np.array([part.right for part in parts]), ridge=RIDGE)
    return float(weights[0]), offset + float(np.log(RARITY))


def lying_figures(trials: Sequence[Trial]) -> dict[str, float]:
    """Who is found, and what else is, by weights that were fitted to other photographs."""
    fold = folds(len(trials), 0)
    found = wrong_way = false_turned = false_upright = 0
    for held in range(fold.max() + 1):
        weight, offset = fitted_lying([trials[i] for i in np.flatnonzero(fold != held).tolist()])

        def likely(part: Part, weight: float = weight, offset: float = offset) -> bool:
            return float(probability(np.array(weight * part.clarity + offset))) >= MIN_SCORE

        for index in np.flatnonzero(fold == held).tolist():
            reported = [part for part in trials[index].turned if likely(part)]
            found += sum(part.right for part in reported)
            wrong_way += sum(part.right and not part.right_way_up for part in reported)
            false_turned += sum(not part.right for part in reported)
            false_upright += sum(map(likely, trials[index].upright))
    people = sum(trial.people for trial in trials)
    return {
        "photographs": len(trials),
        "people": people,
        "reachable": sum(part.right for one in trials for part in one.turned) / people,
        "found": found / people,
        "wrong_way": wrong_way / max(1, found),
        "false_turned": false_turned / len(trials),
        "false_upright": false_upright / len(trials),
    }


def way_up_figures(
    photographs: Sequence[Photograph], segmenter: NetworkSegmenter, reader: JointReader
) -> dict[str, float]:
    """Share of the people in turned photographs whose way up is told, and how they are cut out.

    From their true boxes, and from their true masks.
    """
    by_box, by_mask, overlaps = [], [], []
    for photograph in tqdm(photographs, desc="way up", unit="photograph"):
        turned = _turned(photograph)
        for label, box in enumerate(turned.boxes, start=1):
            truth = turned.labels == label
            (upright,) = segmenter.segment(turned.frame, [box])
            silhouette, turns = segment_either_way(segmenter, reader, turned.frame, box, upright)
            by_box.append(turns == _back(photograph))
            overlaps.append(
                0.0 if silhouette is None else overlap(silhouette.mask(truth.shape), truth)
            )
            mask = silhouette_from_mask(truth, segmenter="mask", truncated=False)
            assert mask is not None
            by_mask.append(which_way_up(reader, turned.frame, mask)[1] == _back(photograph))
    return {
        "by_box": float(np.mean(by_box)),
        "by_mask": float(np.mean(by_mask)),
        "overlap_mean": float(np.mean(overlaps)),
        "overlap_median": float(np.median(overlaps)),
    }


def _turned(photograph: Photograph) -> Photograph:
    """An odd photograph turned to the left, another to the right."""
    turns = -_back(photograph)
    frame = np.ascontiguousarray(np.rot90(photograph.frame, turns))
    return Photograph(photograph.name, frame, np.rot90(photograph.labels, turns))


def _back(photograph: Photograph) -> int:
    """Quarter turns that set people in the turned photograph upright."""
    return 3 if photograph.odd else 1
