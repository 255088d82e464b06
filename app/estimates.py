"""What the estimator takes and gives: uploads, scenes, persons, and the time they took."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.facing import Facing
from app.vision.people import Box, ObservedKeypoints, Silhouette
from index.matching import Hypothesis
from index.store import Label

Source = Literal["detector", "mask", "boxes", "background"]

Evidence = Literal["photograph", "silhouette"]
"""What poses are estimated from: silhouettes and what the photograph shows, or they alone."""

STAGES = ("decode", "detect", "segment", "keypoints", "describe", "search")


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
    frame : bytes, optional
        Encoded photograph; may be missing where there is a mask.
    mask : bytes, optional
        Encoded label image of the same size: 0 background, k = person k.
    background : bytes, optional
        Encoded photograph of the empty scene, of the same size.
    boxes : sequence of Box, optional
        In pixels of the frame. A mask says all, so neither of the others may come with it.
    """

    frame: bytes | None = None
    mask: bytes | None = None
    background: bytes | None = None
    boxes: Sequence[Box] | None = None

    def __post_init__(self) -> None:
        if self.frame is None and self.mask is None:
            raise UploadError("frame", "misfit", "frame: expected an image file, got none")
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
        Of the frame as it came; None where a caller's box holds none.
    keypoints : ObservedKeypoints or None
        Pixels of the frame; None where none were read.
    turns : int
        Quarter turns that set the person upright; see :class:`app.vision.people.Detection`.
    """

    box: Box
    source: Source
    detection_score: float | None
    silhouette: Silhouette | None
    keypoints: ObservedKeypoints | None = None
    turns: int = 0


@dataclass(frozen=True)
class PlacedHypothesis:
    """A hypothesis, the label of its entry, and its skeleton laid over the photograph.

    Parameters
    ----------
    hypothesis : Hypothesis
    distance, confidence : float
        From all that is known of the person; see :class:`app.reranking.Ranked`.
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
    frame : (H, W, 3) uint8 array
        BGR; black where the caller sent a mask alone.
    people : tuple of Found
    """

    frame: NDArray[np.uint8]
    people: tuple[Found, ...]


@dataclass(frozen=True)
class Estimate:
    """A decoded frame, its persons ordered left to right, and where the time went."""

    frame: NDArray[np.uint8]
    persons: tuple[Person, ...]
    timings_ms: dict[str, float]
