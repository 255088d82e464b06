"""Conversion of frames with non-square pixels to square pixels and back.

People are found, and their landmarks located, in a picture with square pixels; results are in
pixels of the frame as sent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from app.estimation.results import ObservedPerson, Person
from app.vision.geometry import Box
from app.vision.people import Silhouette, silhouette_from_mask

Pixels = TypeVar("Pixels", bound=NDArray[Any])


@dataclass(frozen=True)
class SquarePixels:
    """How a frame was resized so that its pixels are square.

    Parameters
    ----------
    sent, square : (int, int)
        Height and width of the frame as sent, and with square pixels.
    """

    sent: tuple[int, int]
    square: tuple[int, int]

    @classmethod
    def of_frame(cls, frame_shape: tuple[int, ...], pixel_aspect: float) -> SquarePixels:
        """Widen or heighten a frame, so that no detail is lost.

        Parameters
        ----------
        frame_shape : tuple of int
            Height and width first.
        pixel_aspect : float
            Width over height of a pixel.

        Examples
        --------
        >>> SquarePixels.of_frame((1080, 960), 2.0).square
        (1080, 1920)
        """
        height, width = frame_shape[:2]
        square = (
            round(height * max(1.0, 1 / pixel_aspect)),
            round(width * max(1.0, pixel_aspect)),
        )
        return cls((height, width), square)

    @property
    def changes(self) -> bool:
        """Whether the frame has to be resized at all."""
        return self.sent != self.square

    @property
    def scale(self) -> NDArray[np.float64]:
        """Square pixels ``(2,)`` across and down for each pixel as sent."""
        return np.asarray(np.array(self.square[::-1]) / np.array(self.sent[::-1]))

    def resize(self, image: Pixels, interpolation: int = cv2.INTER_LINEAR) -> Pixels:
        """Resize an image ``(H, W, ...)`` to square pixels."""
        if not self.changes:
            return image
        resized = cv2.resize(image, self.square[::-1], interpolation=interpolation)
        return cast(Pixels, resized)

    def points(self, sent: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points ``(..., 2)`` of the frame as sent, in square pixels."""
        return np.asarray((sent + 0.5) * self.scale - 0.5) if self.changes else sent

    def points_sent(self, square: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points ``(..., 2)`` in square pixels, in pixels of the frame as sent."""
        return np.asarray((square + 0.5) / self.scale - 0.5) if self.changes else square

    def boxes(self, sent: Sequence[Box]) -> list[Box]:
        """Boxes of the frame as sent, in square pixels."""
        return [_between(*self.points(_corners(box))) for box in sent] if self.changes else [*sent]

    def person_sent(self, person: Person) -> Person:
        """A person found in square pixels, in pixels of the frame as sent."""
        if not self.changes:
            return person
        hypotheses = [
            replace(one, points_2d=self.points_sent(one.points_2d)) for one in person.hypotheses
        ]
        observed = self.observed_sent(person.observed)
        return replace(person, observed=observed, hypotheses=tuple(hypotheses))

    def observed_sent(self, person: ObservedPerson) -> ObservedPerson:
        """An observed person in pixels of the frame as sent, for answers only.

        The window for the next frame stays in square pixels, since it is read in them.
        """
        if not self.changes:
            return person
        landmarks = person.landmarks and replace(
            person.landmarks, positions=self.points_sent(person.landmarks.positions)
        )
        silhouette = person.silhouette and self._silhouette_sent(person.silhouette)
        box = _between(*self.points_sent(_corners(person.box)))
        return replace(person, box=box, silhouette=silhouette, landmarks=landmarks)

    def _silhouette_sent(self, silhouette: Silhouette) -> Silhouette | None:
        mask = silhouette.mask(self.square).view(np.uint8)
        sent = cv2.resize(mask, self.sent[::-1], interpolation=cv2.INTER_NEAREST) > 0
        if not sent.any():
            # The silhouette is narrower than a pixel of the frame as sent.
            column, row = self.points_sent(silhouette.centroid).round().astype(int).tolist()
            sent[min(max(row, 0), self.sent[0] - 1), min(max(column, 0), self.sent[1] - 1)] = True
        return silhouette_from_mask(
            sent, segmenter=silhouette.segmenter, truncated=silhouette.truncated
        )


def _corners(box: Box) -> NDArray[np.float64]:
    return np.array([[box.x, box.y], [box.right, box.bottom]])


def _between(first: NDArray[np.float64], last: NDArray[np.float64]) -> Box:
    return Box.from_edges(*first.tolist(), *last.tolist())
