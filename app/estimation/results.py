"""Results of the estimator: people as observed, with the poses that fit them."""

from dataclasses import dataclass, replace
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from app.estimation.poses import NormalisedPerson
from app.estimation.posture import EstimatedPosture
from app.scene import Patch
from app.vision.geometry import Box, PersonWindow
from app.vision.images import ImageWarning
from app.vision.judgement import FramePosture, Trust
from app.vision.optics import PinholeCamera, Rectification
from app.vision.people import Landmarks, Silhouette
from app.vision.person_reader import Seen
from app.vision.silhouettes import DrawnSilhouette
from index.matching import Match, PoseHypothesis
from index.skeleton import wrap_degrees

Source = Literal["detector", "mask", "boxes", "background", "track"]
"""How a person was found: by the detector, in the caller's mask or boxes, as a difference from the
background, or where a track expected them."""

Evidence = Literal["photograph", "silhouette"]
"""What poses are estimated from: silhouette and landmarks, or the silhouette alone."""

FacingSource = Literal["image", "motion", "none"]
"""What shows which way a person faces: the photograph, the direction of walking, or only the
hypotheses themselves."""


@dataclass(frozen=True)
class Facing:
    """How likely it is that the camera sees a person from the front."""

    front_probability: float
    evidence: FacingSource


@dataclass(frozen=True)
class Matched:
    """What was found for a silhouette and its landmarks."""

    normalised: NormalisedPerson
    found: Match


@dataclass(frozen=True)
class Person:
    """A person of a frame: as observed and, once poses are fitted, with the poses.

    Positions are in pixels of the frame. The detection score is None if the caller marked the
    people, the silhouette if none was found in a caller's box. Landmarks and everything that
    follows from them, including ``trust`` and the frame's posture, are None if no landmarks were
    read. ``presence``, from the trust, is the probability that the window of the reading shows a
    person, 1 if none was read. ``next_window`` is to be read in the next frame, ``seen_keypoints``
    are MoveNet's relative to the landmarks, ``drawn`` is the silhouette as drawn last and
    ``matched`` what was found for it. ``beside`` says that the network saw the person only while
    others were painted over. ``patch`` and ``colours`` ``(80,)`` describe the looks of a tracked
    person. ``hips`` ``(3,)`` is their middle, metres from the camera in its axes. Hypotheses come
    best first; without a silhouette there are no hypotheses, colours, facing or posture.
    """

    box: Box
    source: Source
    detection_score: float | None = None
    silhouette: Silhouette | None = None
    landmarks: Landmarks | None = None
    presence: float = 1.0
    next_window: PersonWindow | None = None
    seen_keypoints: Seen | None = None
    drawn: DrawnSilhouette | None = None
    matched: Matched | None = None
    beside: bool = False
    patch: Patch | None = None
    colours: NDArray[np.float32] | None = None
    frame_posture: FramePosture | None = None
    trust: Trust | None = None
    hips: NDArray[np.float64] | None = None
    facing: Facing | None = None
    posture: EstimatedPosture | None = None
    hypotheses: tuple[PoseHypothesis, ...] = ()

    @property
    def whole_box(self) -> Box:
        return self.box if self.silhouette is None else self.silhouette.box

    @property
    def moved_along(self) -> bool:
        """Whether the silhouette is one of an earlier frame, moved along with the landmarks."""
        return self.drawn is not None and self.drawn.silhouette is not self.silhouette

    @property
    def window_empty(self) -> bool:
        """Whether the window about a caller's box shows no person."""
        if self.source != "boxes":
            return False
        return self.silhouette is None or self.presence < 0.5

    @property
    def voters(self) -> list[PoseHypothesis]:
        """Hypotheses that decide posture, facing and action over time: all but the twin."""
        return [one for one in self.hypotheses if not one.twin]

    def as_sent(self, rectification: Rectification) -> Self:
        """The same in pixels and axes of the frame as it was sent, for answers.

        The window for the next frame is not changed, since it is read in the rectified frame.
        """
        if not rectification.changes:
            return self
        landmarks = self.landmarks and replace(
            self.landmarks,
            positions=rectification.points_sent(self.landmarks.positions),
            metres=rectification.axes_sent(self.landmarks.metres),
        )
        return replace(
            self,
            box=rectification.box_sent(self.box),
            silhouette=self.silhouette and rectification.silhouette_sent(self.silhouette),
            landmarks=landmarks,
            hips=None if self.hips is None else rectification.axes_sent(self.hips),
            hypotheses=tuple(_as_sent(one, rectification) for one in self.hypotheses),
        )


def _as_sent(one: PoseHypothesis, rectification: Rectification) -> PoseHypothesis:
    """A hypothesis in pixels and axes of the frame as it was sent."""
    roll_deg = float(wrap_degrees(one.label.roll_deg - rectification.roll_deg))
    return replace(
        one,
        label=replace(one.label, roll_deg=roll_deg) if rectification.quarters else one.label,
        points_2d=rectification.points_sent(one.points_2d),
        points_3d=rectification.axes_sent(one.points_3d),
    )


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """The people of a frame, from left to right.

    The frame ``(H, W, 3)``, BGR, is as it was sent, black if the caller sent a mask alone; its
    camera has square pixels. ``timings_ms`` are the milliseconds by stage and in total.
    """

    frame: NDArray[np.uint8]
    camera: PinholeCamera
    warnings: tuple[ImageWarning, ...]
    persons: tuple[Person, ...]
    timings_ms: dict[str, float]
