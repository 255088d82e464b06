"""People who lie, as far as street photographs show them: turned by a quarter.

Light and shadow come from a side then, and the ground stands upright; what is measured is whether
bodies that lie are found, and the right way up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.estimation.estimator import Estimator
from app.estimation.results import ObservedPerson
from app.vision.geometry import Box
from index.skeleton import wrap_degrees
from scripts.experiments.asking import estimate, found_in
from scripts.experiments.real_data import Photograph, as_array
from scripts.experiments.real_detection_scores import rightness
from scripts.experiments.real_silhouettes import overlap
from scripts.experiments.rotation import rotate_box

UPRIGHT = ("standing", "walking")


@dataclass(frozen=True)
class Turned:
    """A photograph turned by a quarter, and where the heads of people who stood are."""

    frame: NDArray[np.uint8]
    labels: NDArray[np.uint16]
    boxes: list[Box]
    roll_deg: float


def is_turned(person: ObservedPerson, roll_deg: float) -> bool:
    """Whether somebody's head is found in a direction, to 45 degrees."""
    window = person.next_window
    return window is not None and bool(abs(wrap_degrees(window.roll_deg - roll_deg)) < 45)


def turned(photograph: Photograph) -> Turned:
    """The odd photographs turned to the left, the others to the right."""
    quarter_turns = 1 if photograph.odd else 3
    frame = np.ascontiguousarray(np.rot90(photograph.frame, quarter_turns))
    boxes = [rotate_box(box, photograph.frame.shape, quarter_turns) for box in photograph.boxes]
    return Turned(frame, np.rot90(photograph.labels, quarter_turns), boxes, -90.0 * quarter_turns)


def measure_lying(photographs: Sequence[Photograph], estimator: Estimator) -> dict[str, float]:
    """Who is found among people who lie, and whether the right way up."""
    people = found = right_way = taken = boxed_right = 0
    overlaps: list[float] = []
    wrongly_turned = upright = 0
    lies: list[bool] = []
    stands: list[bool] = []
    for photograph in tqdm(photographs, desc="lying", unit="photograph"):
        lying = turned(photograph)
        detections = found_in(estimator, lying.frame)
        boxes = as_array([detection.box for detection in detections])
        right = rightness((boxes, -np.arange(float(len(boxes)))), as_array(lying.boxes))
        people += len(lying.boxes)
        taken += len(detections)
        found += int(right.sum())
        right_way += sum(
            is_turned(detection, lying.roll_deg)
            for detection, one in zip(detections, right.tolist(), strict=True)
            if one
        )
        answers = estimate(estimator, lying.frame, *lying.boxes)
        lies.extend(person.posture.label == "lying" for person in answers if person.posture)
        as_taken = estimate(estimator, photograph.frame, *photograph.boxes)
        stands.extend(person.posture.label in UPRIGHT for person in as_taken if person.posture)
        by_box = {person.observed.box: person.observed for person in answers}
        for label, box in enumerate(lying.boxes, start=1):
            person = by_box.get(box)
            if person is None or person.silhouette is None:
                overlaps.append(0.0)
                continue
            boxed_right += is_turned(person, lying.roll_deg)
            truth = lying.labels == label
            overlaps.append(overlap(person.silhouette.mask(truth.shape), truth))
        for detection in found_in(estimator, photograph.frame):
            upright += 1
            wrongly_turned += not is_turned(detection, 0.0)
    return {
        "photographs": len(photographs),
        "people": people,
        "found": found / people,
        "precision": found / max(1, taken),
        "right_way_up": right_way / max(1, found),
        "by_box": boxed_right / people,
        "posture_lying": float(np.mean(lies)),
        "posture_upright": float(np.mean(stands)),
        "overlap_mean": float(np.mean(overlaps)),
        "overlap_median": float(np.median(overlaps)),
        "upright_taken_for_lying": wrongly_turned / max(1, upright),
    }
