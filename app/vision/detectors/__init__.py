"""Detectors of people: a file for each, all with the same method."""

from typing import Protocol

from app.vision.detectors.tiles import Picture
from app.vision.people import Detection


class Detector(Protocol):
    """Detects people; thread-safe.

    :class:`app.vision.detector.NetworkDetector` calls one after the other, and weights the score of
    each.
    """

    def detect(self, picture: Picture) -> list[Detection]:
        """Detect the people of a picture, best first; scores need not be probabilities.

        A detection of a person whom no other detector has found counts only if the landmark network
        confirms it, in the detection's window or the one about its box.
        """
        ...
