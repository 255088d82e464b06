"""Whether the labels of a mask that touch are bodies, or the parts of one."""

import cv2
import numpy as np
from numpy.typing import NDArray

from app.estimation.poses import NormalisedPerson
from app.estimation.upload import UploadError
from app.vision.masks import LabelImage
from app.vision.people import silhouette_from_mask
from index.silhouette_matching import match_silhouette
from index.store import PoseIndex

_LEAST_LABELS = 3  # Two that touch may well embrace.
_COMPARED = 4  # The largest labels of a group; each takes as long as a person's search.


def check_bodies(mask: LabelImage, index: PoseIndex) -> None:
    """Refuse labels of body parts, each of which would be answered as a person who lies.

    The index judges: parts resemble its silhouettes less than the body that they make up.

    Raises
    ------
    UploadError
        If labels that touch are likelier to be one body than a body each.
    """
    if len(mask.present) < _LEAST_LABELS:
        return
    marked = np.asarray(mask.part != 0).view(np.uint8)
    count, groups, stats, _ = cv2.connectedComponentsWithStats(marked)
    for group in range(1, count):
        left, top, width, height = stats[group, : cv2.CC_STAT_AREA].tolist()
        within = slice(top, top + height), slice(left, left + width)
        one = np.where(groups[within] == group, mask.part[within], 0)
        labels, areas = np.unique(one[one > 0], return_counts=True)
        if len(labels) < _LEAST_LABELS:
            continue
        largest = np.argsort(-areas, kind="stable")[:_COMPARED]
        each = [_likelihood(one == label, index) for label in labels[largest]]
        if _likelihood(one > 0, index) > np.average(each, weights=areas[largest]):
            raise UploadError(
                "mask",
                "mask: expected a label for each person (1, 2, ...; 0 is background), got "
                f"{len(labels)} labels that together look like one body, from {labels[0]} to "
                f"{labels[-1]}: parts of a body, or its soft edges, need one label",
            )


def _likelihood(mask: NDArray[np.bool_], index: PoseIndex) -> float:
    """Confidence of the nearest pose of a mask ``(H, W)``."""
    silhouette = silhouette_from_mask(mask, segmenter="mask")
    assert silhouette is not None
    person = NormalisedPerson.of(silhouette, None)
    found = match_silhouette(index, person.silhouette, 1, roll_deg=person.roll_deg)
    return found.hypotheses[0].confidence
