"""Where the silhouette of a hypothesis's entry lies in the photograph."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.estimation.normalise import NormalisedPerson
from index.matching import Hypothesis
from index.rotations import RotatedQuery
from index.store import PoseIndex


def placed_entry(
    index: PoseIndex, person: NormalisedPerson, hypothesis: Hypothesis
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """The entry's silhouette ``(128, 48)``, mirrored where its hypothesis is, and ``(2, 3)``.

    The affine transform leads from its pixels to pixels of the frame, rotated as the hypothesis is.
    """
    silhouette = index.silhouette(hypothesis.entry_id)
    if hypothesis.mirrored:
        silhouette = np.ascontiguousarray(silhouette[:, ::-1])
    query = RotatedQuery.of(person.silhouette, hypothesis.rotation_deg + person.roll_deg)
    to_frame = person.to_frame @ np.vstack([query.to_query, [0, 0, 1]])
    return silhouette, np.asarray(to_frame, np.float64)
