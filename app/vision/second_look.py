"""A second look at boxes that the detector doubts: joints show in people only.

Gradients and the weights that judge them were fitted to people who walk or stand. Somebody who
leans, bends or stretches looks less like them than some trees do.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from app.vision.detect import CascadeDetector, Detector, HogDetector, probability
from app.vision.joints import JointReader
from app.vision.network import PersonNetwork
from app.vision.people import Box, Detection
from app.vision.segment import NetworkSegmenter, Segmenter
from app.vision.workers import Workers
from descriptor.silhouette import normalise

DOUBTED = (0.06, 0.45)
"""Scores of the boxes that are looked at again. More than the last is believed at once."""

MOST = 4
"""Boxes of a frame that are looked at again, the likeliest first: each takes as long as a person
who is found."""

# Fitted to real/pennfudan by `python -m scripts.evaluate real --fit-detector`.
_ODDS, _CLARITY, _OFFSET = 1.21, 4.47, 3.77


class SecondLook:
    """A detector whose doubtful boxes are cut out and searched for joints before they count.

    Parameters
    ----------
    detector : Detector
        Reports boxes from a score of :data:`DOUBTED` on.
    segmenter : NetworkSegmenter
    reader : JointReader
    min_score : float
        Least probability reported.
    """

    def __init__(
        self,
        detector: Detector,
        segmenter: NetworkSegmenter,
        reader: JointReader,
        *,
        min_score: float = 0.3,
    ) -> None:
        self._detector = detector
        self._segmenter = segmenter
        self._reader = reader
        self._min_score = min_score

    def detect(self, frame: NDArray[np.uint8]) -> list[Detection]:
        """Find the people; see :class:`app.vision.detect.Detector`."""
        found = self._detector.detect(frame)
        sure = [one for one in found if one.score > DOUBTED[1]]
        doubted = [one for one in found if one.score <= DOUBTED[1]][:MOST]
        clear = clarities(
            self._segmenter, self._reader, frame, [d.box for d in doubted], [d.box for d in sure]
        )
        odds = [
            _ODDS * np.log(one.score / (1 - one.score)) + _CLARITY * clarity + _OFFSET
            for one, clarity in zip(doubted, clear, strict=True)
        ]
        again = [
            Detection(one.box, float(score))
            for one, score in zip(doubted, probability(np.array(odds)), strict=True)
        ]
        return sorted(
            (one for one in sure + again if one.score >= self._min_score),
            key=lambda one: -one.score,
        )


def clarities(
    segmenter: NetworkSegmenter,
    reader: JointReader,
    frame: NDArray[np.uint8],
    boxes: Sequence[Box],
    beside: Sequence[Box],
) -> list[float]:
    """How clearly joints show in some boxes; see :meth:`index.joint_maps.JointMaps.clarity`.

    Parameters
    ----------
    segmenter : NetworkSegmenter
    reader : JointReader
    frame : (H, W, 3) uint8 array
        BGR.
    boxes : sequence of Box
    beside : sequence of Box
        Of people known; they are kept out.

    Returns
    -------
    list of float
        Minus infinity where the network sees nobody.
    """
    found = []
    for silhouette in segmenter.segment(frame, boxes, beside):
        if silhouette is None or silhouette.segmenter != "network":
            found.append(-np.inf)
        else:
            _, placement = normalise(silhouette.crop)
            found.append(reader.read(frame, silhouette, placement).clarity())
    return found


def make_detector(
    network: PersonNetwork | None,
    segmenter: Segmenter,
    reader: JointReader,
    *,
    min_person_px: float = 50,
    workers: Workers | None = None,
) -> Detector:
    """The cascade and a second look if there is a network, else gradients alone."""
    if network is None or not isinstance(segmenter, NetworkSegmenter):
        return HogDetector(min_person_px=min_person_px)
    cascade = CascadeDetector(
        network, min_person_px=min_person_px, min_score=DOUBTED[0], workers=workers
    )
    return SecondLook(cascade, segmenter, reader)
