"""What the estimator takes and gives: uploads, scenes, persons, and the time they took."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.facing import Facing
from app.vision.people import Box, Silhouette
from index.matching import Hypothesis
from index.store import Label

Source = Literal["hog", "mask", "boxes", "background"]

STAGES = ("decode", "detect", "segment", "describe", "search")


class UploadError(ValueError):
    """What a caller sent cannot be used.

    Parameters
    ----------
    field : str
        ``frame``, ``mask``, ``background`` or ``boxes``.
    reason : str
        ``undecodable``, ``too_large``, or ``misfit``: sound, but not for this frame.
    message : str
        One sentence.
    """

    def __init__(
        self, field: str, reason: Literal["undecodable", "too_large", "misfit"], message: str
    ) -> None:
        super().__init__(message)
        self.field = field
        self.reason = reason


@dataclass(frozen=True)
class Upload:
    """What a caller sends: encoded images, and where people are if that is known.

    Parameters
    ----------
    frame : bytes
        Encoded photograph.
    mask : bytes, optional
        Encoded label image of the same size: 0 background, k = person k.
    background : bytes, optional
        Encoded photograph of the empty scene, of the same size.
    boxes : sequence of Box, optional
        In pixels of the frame. A mask says all, so neither of the others may come with it.
    """

    frame: bytes
    mask: bytes | None = None
    background: bytes | None = None
    boxes: Sequence[Box] | None = None

    def __post_init__(self) -> None:
        for name in ("background", "boxes"):
            if self.mask is not None and getattr(self, name) is not None:
                raise UploadError(name, "misfit", f"expected a mask or {name}, got both")


@dataclass(frozen=True)
class Found:
    """A person found in a frame.

    Parameters
    ----------
    box : Box
        Pixels of the frame.
    source : str
    detection_score : float or None
        None where nothing was detected because the caller said where people are.
    silhouette : Silhouette or None
        None where a caller's box holds none.
    turns : int
        Quarter turns that set the person upright; see :class:`app.vision.people.Detection`.
    """

    box: Box
    source: Source
    detection_score: float | None
    silhouette: Silhouette | None
    turns: int = 0


@dataclass(frozen=True)
class PlacedHypothesis:
    """A hypothesis, the label of its entry, and its skeleton laid over the photograph.

    Parameters
    ----------
    hypothesis : Hypothesis
    distance, confidence : float
        From all that is known of the person; see :class:`app.weighing.Weighed`.
    label : Label
    points_2d : (24, 2) float64 array
        Pixels of the frame; rows are ``POINT_NAMES``.
    """

    hypothesis: Hypothesis
    distance: float
    confidence: float
    label: Label
    points_2d: NDArray[np.float64]


@dataclass(frozen=True)
class Person:
    """A person found and the poses that fit; without a silhouette there are none."""

    found: Found
    facing: Facing | None
    hypotheses: tuple[PlacedHypothesis, ...]


@dataclass
class Stopwatch:
    """Milliseconds spent in each of :data:`STAGES`, and in all since its making."""

    milliseconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(STAGES, 0.0))
    _started: float = field(default_factory=time.perf_counter, repr=False)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time spent inside to a stage."""
        started = time.perf_counter()
        try:
            yield
        finally:
            self.milliseconds[name] += (time.perf_counter() - started) * 1000

    def total(self) -> float:
        """Return the milliseconds since its making."""
        return (time.perf_counter() - self._started) * 1000


@dataclass(frozen=True)
class Scene:
    """A frame and the people in it, ordered left to right.

    Parameters
    ----------
    decoded : callable
        Gives the frame, (H, W, 3) uint8, BGR; it may have to wait for it.
    people : tuple of Found
    """

    decoded: Callable[[], NDArray[np.uint8]]
    people: tuple[Found, ...]

    def turned(self, turns: int) -> Scene:
        """The same scene turned counterclockwise by so many quarters, without the people."""
        return Scene(lambda: np.rot90(self.frame, turns), ())

    @property
    def frame(self) -> NDArray[np.uint8]:
        """The decoded frame.

        Raises
        ------
        UploadError
            If people were found without it, and it cannot be used.
        """
        return self.decoded()


@dataclass(frozen=True)
class Estimate:
    """A decoded frame, its persons ordered left to right, and where the time went."""

    frame: NDArray[np.uint8]
    persons: tuple[Person, ...]
    timings_ms: dict[str, float]
