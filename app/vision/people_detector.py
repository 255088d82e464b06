"""The detector that serves: people who stand, bend and lie."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.vision.detect import CascadeDetector, Detector, HogDetector
from app.vision.joints import JointReader
from app.vision.lying import find_lying
from app.vision.networks import Networks, PersonNetwork
from app.vision.people import Detection
from app.vision.second_look import DOUBTED, believed
from app.vision.segment import NetworkSegmenter, Segmenter
from app.vision.workers import Workers

MIN_SCORE = 0.3
"""Least probability that is reported where nothing else is asked for."""


class PeopleDetector:
    """Gradients and presence, a second look at whom they doubt, and a look for people who lie.

    Safe under several threads.

    Parameters
    ----------
    network : PersonNetwork
    cascade : CascadeDetector
        Reports boxes from a score of :data:`app.vision.second_look.DOUBTED` on.
    segmenter : NetworkSegmenter
    reader : JointReader
    min_score : float
        Least probability reported.
    """

    def __init__(
        self,
        network: PersonNetwork,
        cascade: CascadeDetector,
        segmenter: NetworkSegmenter,
        reader: JointReader,
        *,
        min_score: float = MIN_SCORE,
    ) -> None:
        self._network = network
        self._cascade = cascade
        self._segmenter = segmenter
        self._reader = reader
        self._min_score = min_score

    def detect(self, frame: NDArray[np.uint8]) -> list[Detection]:
        """Find the people; see :class:`app.vision.detect.Detector`."""
        found, presence = self._cascade.look(frame)
        upright = believed(self._segmenter, self._reader, frame, found, self._min_score)
        boxes = [one.box for one in upright]
        lying = find_lying(self._network, self._reader, frame, presence, boxes, self._min_score)
        return sorted([*upright, *lying], key=lambda one: -one.score)


def make_detector(
    networks: Networks | None,
    segmenter: Segmenter,
    reader: JointReader,
    *,
    min_person_px: float = 50,
    workers: Workers | None = None,
) -> Detector:
    """The service's detector if there are networks, else gradients alone."""
    if networks is None or not isinstance(segmenter, NetworkSegmenter):
        return HogDetector(min_person_px=min_person_px)
    cascade = CascadeDetector(
        networks.person, min_person_px=min_person_px, min_score=DOUBTED[0], workers=workers
    )
    return PeopleDetector(networks.person, cascade, segmenter, reader)
