"""What experiments ask the estimator about photographs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.estimation.estimator import Estimator
from app.estimation.results import ObservedPerson, Person
from app.estimation.upload import Upload
from app.scheduling.job import Job
from app.vision.geometry import Box

HYPOTHESES = 7


def estimate(
    estimator: Estimator, photograph: bytes | NDArray[np.uint8], *boxes: Box
) -> tuple[Person, ...]:
    """The people of a photograph, encoded or as BGR pixels, or those in some boxes."""
    upload = Upload(photograph, boxes=boxes or None)
    return estimator.estimate(upload, HYPOTHESES, Job()).persons


def found_in(
    estimator: Estimator, photograph: NDArray[np.uint8], *boxes: Box
) -> tuple[ObservedPerson, ...]:
    """The people whom the service finds in a photograph, or in some boxes of it, without poses."""
    upload = Upload(photograph, boxes=boxes or None)
    return estimator.find_people(upload, Job()).people
