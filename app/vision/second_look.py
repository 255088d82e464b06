"""A second look at boxes that the detector doubts: joints show in people only.

Gradients and the weights that judge them were fitted to people who walk or stand. Somebody who
leans, bends or stretches looks less like them than some trees do.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from app.vision.detect import log_odds, probability
from app.vision.joints import JointReader
from app.vision.people import Box, Detection
from app.vision.segment import NetworkSegmenter

DOUBTED = (0.06, 0.45)
"""Scores of the boxes that are looked at again. More than the last is believed at once."""

MOST = 4
"""Boxes of a frame that are looked at again, the likeliest first: each takes as long as a person
who is found."""

# Fitted to real/pennfudan by `python -m scripts.evaluate real --fit-detector`.
_ODDS, _CLARITY, _OFFSET = 1.21, 4.46, 3.61


def believed(
    segmenter: NetworkSegmenter,
    reader: JointReader,
    frame: NDArray[np.uint8],
    found: Sequence[Detection],
    min_score: float,
) -> list[Detection]:
    """Look again at whom the detector doubts, and leave those who are likely enough, best first.

    Parameters
    ----------
    segmenter : NetworkSegmenter
    reader : JointReader
    frame : (H, W, 3) uint8 array
        BGR.
    found : sequence of Detection
        Those of a score from :data:`DOUBTED` on.
    min_score : float
        Least probability of those who are left.
    """
    boxes, scores = [one.box for one in found], np.array([one.score for one in found])
    clarity = look_again(segmenter, reader, frame, boxes, scores)
    looked = ~np.isnan(clarity)
    odds = _ODDS * log_odds(scores[looked]) + _CLARITY * clarity[looked] + _OFFSET
    likely = looked | (scores > DOUBTED[1])
    scores[looked] = probability(odds)
    kept = [
        Detection(boxes[row], float(scores[row]))
        for row in np.flatnonzero(likely & (scores >= min_score))
    ]
    return sorted(kept, key=lambda one: -one.score)


def look_again(
    segmenter: NetworkSegmenter,
    reader: JointReader,
    frame: NDArray[np.uint8],
    boxes: Sequence[Box],
    scores: NDArray[np.float64],
) -> NDArray[np.float64]:
    """How clearly joints show in the boxes that are doubted.

    Parameters
    ----------
    segmenter : NetworkSegmenter
    reader : JointReader
    frame : (H, W, 3) uint8 array
        BGR.
    boxes : sequence of Box
    scores : (N,) float64 array
        Probability that each holds a person.

    Returns
    -------
    (N,) float64 array
        :meth:`index.joint_maps.JointMaps.clarity`; minus infinity where the network sees nobody,
        NaN where nobody looked.
    """
    sure = [boxes[row] for row in np.flatnonzero(scores > DOUBTED[1]).tolist()]
    doubted = np.flatnonzero((scores >= DOUBTED[0]) & (scores <= DOUBTED[1]))
    doubted = doubted[np.argsort(-scores[doubted], kind="stable")][:MOST]
    clarity = np.full(len(boxes), np.nan)
    silhouettes = segmenter.segment(frame, [boxes[row] for row in doubted.tolist()], sure)
    for row, silhouette in zip(doubted, silhouettes, strict=True):
        clarity[row] = -np.inf
        if silhouette is not None and silhouette.segmenter == "network":
            clarity[row] = reader.clarity(frame, silhouette)
    return clarity
