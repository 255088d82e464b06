"""A person over time: from the first sighting to the last."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.estimation.facing import Facing
from app.estimation.posture_probability import EstimatedPosture
from app.estimation.results import ObservedPerson, Person
from app.tracking.actions import ActionRecogniser
from app.tracking.box_filter import MotionFilter
from app.tracking.events import EventDetector, Trust
from app.tracking.posture_filter import PostureFilter
from app.tracking.results import Event, RecognisedAction, SmoothedPose, TrackedPerson
from app.tracking.smoothing import PoseSmoother
from app.tracking.zones import Zone, is_rest, zones_of
from app.vision.geometry import PersonWindow

SURE_SCORE = 0.6
"""Somebody detected with this probability, or named by the caller, is confirmed at once, ..."""

CONFIRMING_SIGHTINGS = 3
"""... others when they have been seen in as many frames."""

LEAST_PRESENCE = 0.5
"""Presence from which the landmark network sees a person. It must have done so once in whom the
detector found: of tables and tripods it often stays near 0, and below 0.1 where somebody has
left."""

_APPEARANCE_GAIN = 0.1


@dataclass
class Sighting:
    """Where a person was seen in a frame, before it is known who it is.

    Parameters
    ----------
    observed : ObservedPerson
    appearance : (80,) float32 array or None
        None where there is no silhouette.
    followed : Track or None
        The track in whose window the person was read.
    """

    observed: ObservedPerson
    appearance: NDArray[np.float32] | None
    followed: Track | None = None


class Track:
    """One person of a camera session.

    Parameters
    ----------
    sighting : Sighting
        The first.
    timestamp : float
        Seconds.
    """

    def __init__(self, sighting: Sighting, timestamp: float) -> None:
        observed = sighting.observed
        self.track_id: int | None = None
        """None until the track is confirmed."""
        self.caller_id: str | None = None
        """The identity that the caller gave the person's box."""
        self.zones: tuple[Zone, ...] = ()
        """Those in which the person was seen last."""
        self.motion = MotionFilter(observed.box, timestamp)
        self.age_frames = 0
        self.sightings = 0
        self.score = 0.0
        """Highest probability of the detector that this is a person; 1 if the caller said so."""
        self.presence = 0.0
        """Highest presence by the landmark network; 1 where it does not decide."""
        self.seen_at = timestamp
        """When the track was last seen."""
        self.next_window: PersonWindow | None = observed.next_window
        """Where the person is looked for next."""
        self.appearance = sighting.appearance
        self._smoother = PoseSmoother()
        self._recogniser = ActionRecogniser()
        self._detector = EventDetector()
        self._facing: Facing | None = None
        self._posture: EstimatedPosture | None = None
        self._postures = PostureFilter()
        self._action: RecognisedAction | None = None
        self._events: list[Event] = []

    @property
    def is_confirmed(self) -> bool:
        """Whether enough speaks for a person."""
        return self.presence >= LEAST_PRESENCE and (
            self.score >= SURE_SCORE or self.sightings >= CONFIRMING_SIGHTINGS
        )

    def see(self, sighting: Sighting, timestamp: float, zones: Sequence[Zone] = ()) -> None:
        """Take in where the person is in this frame, in which of the camera's zones."""
        observed = sighting.observed
        self._locate(observed, zones)
        if self.sightings:
            whole = observed.silhouette is None or not observed.silhouette.truncated
            self.motion.update(observed.box, timestamp, whole=whole)
        self.sightings += 1
        self.seen_at = timestamp
        if observed.source not in ("background", "track"):
            score = 1.0 if observed.detection_score is None else observed.detection_score
            self.score = max(self.score, score)
        presence = observed.presence if observed.source == "detector" else None
        self.presence = max(self.presence, 1.0 if presence is None else presence)
        self.next_window = observed.next_window
        # People who overlap others in the picture would lend them their colours.
        clear = observed.silhouette is not None and not observed.silhouette.truncated
        if sighting.appearance is not None and self.appearance is None:
            self.appearance = sighting.appearance
        elif sighting.appearance is not None and self.appearance is not None and clear:
            self.appearance = self.appearance + _APPEARANCE_GAIN * (
                sighting.appearance - self.appearance
            )

    def update(self, person: Person, timestamp: float, zones: Sequence[Zone] = ()) -> TrackedPerson:
        """Take in the poses of this frame; the posture says what part of the body is in a zone."""
        smoothed = self._smoother.update(person, timestamp)
        if smoothed is None:
            return self.extrapolate(person.observed, timestamp)
        observed = person.observed
        presence = 1.0 if observed.presence is None else observed.presence
        self._facing = smoothed.facing
        self._posture, shares = self._postures.update(
            timestamp, smoothed.votes, observed.landmarks, presence, observed.whole_box
        )
        surer = self._posture if observed.landmarks is not None else None
        self._action = self._recogniser.update(timestamp, person, smoothed, surer)
        self._locate(person.observed, zones)
        if self.track_id is not None:
            told = self._detector.update(
                self.track_id,
                timestamp,
                shares,
                self._trust(observed, smoothed.pose),
                height_px=_height_px(observed),
                rests=is_rest(self.zones),
            )
            self._events += [self.told(event) for event in told]
        person = replace(person, facing=self._facing, posture=self._posture)
        return self._tracked(person, smoothed.pose)

    def _trust(self, observed: ObservedPerson, pose: SmoothedPose) -> Trust:
        """How far a frame is to be trusted: by the network, by silhouettes alone by the pose."""
        if observed.presence is None:
            return Trust(pose.confidence, pose.confidence)
        score = 1.0 if observed.detection_score is None else observed.detection_score
        return Trust(observed.presence, max(observed.presence, score))

    def extrapolate(self, observed: ObservedPerson, timestamp: float) -> TrackedPerson:
        """Keep the pose of the last frames, at the place where the person is now."""
        pose = self._smoother.extrapolate(observed, timestamp)
        if pose is None:
            return self._tracked(Person(observed, None, None, ()), None)
        return self._tracked(Person(observed, self._facing, self._posture, ()), pose)

    def told(self, event: Event) -> Event:
        """An event of this track with where it happened and to whom."""
        return replace(event, zones=self._zone_names(), caller_track_id=self.caller_id)

    def take_events(self) -> list[Event]:
        """Return what began or ended since this was called last."""
        events, self._events = self._events, []
        return events

    def _locate(self, observed: ObservedPerson, zones: Sequence[Zone]) -> None:
        label = self._posture.label if self._posture else None
        posture = None if label == "unclear" else label
        self.zones = zones_of(zones, observed.box, posture)

    def _zone_names(self) -> tuple[str, ...]:
        return tuple(zone.name for zone in self.zones)

    def _tracked(self, person: Person, pose: SmoothedPose | None) -> TrackedPerson:
        if self.track_id is None:
            raise ValueError("expected a confirmed track")
        return TrackedPerson(
            person,
            self.track_id,
            self.age_frames,
            pose,
            self._action,
            self._zone_names(),
            self.caller_id,
        )


def _height_px(observed: ObservedPerson) -> float | None:
    """Height of a person in the picture, None where not all of them is seen."""
    if observed.silhouette is None or observed.silhouette.truncated:
        return None
    return observed.silhouette.box.height
