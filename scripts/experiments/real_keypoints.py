"""Poses by landmarks alone: what they tell without the silhouette, to hold both together against.

The service does the same for people who are not seen whole: the entries nearest to the landmarks
are the only ones, and the landmarks place them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.estimation.estimates import Person
from app.estimation.estimator import Estimator
from app.estimation.hypotheses import fit_poses
from app.estimation.normalised_person import NormalisedPerson
from app.vision.people import Box, Silhouette
from scripts.experiments.real_poses import with_landmarks


class _NotWhole(NormalisedPerson):
    """Somebody whose silhouette is not searched for."""

    @property
    def whole(self) -> bool:
        """Say that the silhouette does not show all of the body."""
        return False


def estimate_by_landmarks(
    estimator: Estimator, frame: NDArray[np.uint8], box: Box, silhouette: Silhouette, n: int
) -> Person | None:
    """Hypotheses by the landmarks in a box; None where too few are seen.

    The silhouette serves as the frame of reference, and ranks what the landmarks found.
    """
    person = with_landmarks(estimator, frame, box, silhouette)
    upright = _NotWhole.of(silhouette, person.landmarks)
    if upright.keypoints() is None:
        return None
    return fit_poses(estimator.index, person, upright, n)
