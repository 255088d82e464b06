"""A person over time: from the first sighting to the last."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.estimation.facing import Facing
from app.estimation.posture_probability import EstimatedPosture
from app.estimation.results import ObservedPerson, Person
from app.tracking.actions import ActionRecogniser
from app.tracking.events import EventDetector, HipHeight, Reliability
from app.tracking.parameters import DEFAULTS, BoxParameters, TrackingParameters
from app.tracking.posture_filter import PostureFilter
from app.tracking.results import Event, RecognisedAction, SmoothedPose, TrackedPerson
from app.tracking.smoothing import PoseSmoother, Smoothed
from app.tracking.zones import Zone, ZoneWatch, is_rest, zones_of
from app.vision.geometry import Box, PersonWindow
from app.vision.odds import log_odds, probability_of
from index.posture import Posture
from index.skeleton import side_rows

_HIPS = side_rows("hip")


@dataclass(frozen=True)
class Sighting:
    """A person seen in a frame, not yet matched to a track.

    Parameters
    ----------
    observed : ObservedPerson
    appearance : (80,) float32 array or None
        Colours; None where there is no photograph or no silhouette.
    track : Track or None
        The track in whose window the person was read, or that the caller named.
    """

    observed: ObservedPerson
    appearance: NDArray[np.float32] | None = None
    track: Track | None = None


class BoxFilter:
    """Predicts a person's box, assuming a constant velocity.

    The place is the middle of the lower edge, where the person stands.

    Parameters
    ----------
    box : Box
        The first.
    timestamp : float
        Seconds.
    """

    def __init__(
        self, box: Box, timestamp: float, parameters: BoxParameters = DEFAULTS.box
    ) -> None:
        self._parameters = parameters
        self._place = box.foot
        self._size = np.array([box.width, box.height])
        self._timestamp = timestamp
        self.velocity = np.zeros(2)
        """Pixels a second, right and down."""
        self.seen = box
        """The last observed box."""

    def predict(self, timestamp: float) -> Box:
        """Box at a later time; it may lie outside the frame."""
        place = self._predicted_place(timestamp - self._timestamp)
        width, height = self._size.tolist()
        return Box(float(place[0]) - width / 2, float(place[1]) - height, width, height)

    def update(self, box: Box, timestamp: float, *, whole: bool) -> None:
        """Correct the prediction using an observed box.

        Parameters
        ----------
        box : Box
            As observed.
        timestamp : float
            Seconds.
        whole : bool
            Whether all of the person was seen; otherwise the size does not shrink.
        """
        parameters = self._parameters
        elapsed = max(timestamp - self._timestamp, parameters.min_step_s)
        predicted = self._predicted_place(elapsed)
        growth = np.array([box.width, box.height]) - self._size
        error = box.foot - predicted
        self._place = predicted + parameters.place_gain * error
        # The longer the gap, the more of the error is due to the velocity alone.
        gain = parameters.velocity_gain / elapsed if elapsed < 1 else 1 / elapsed
        self.velocity = self.velocity + gain * error
        growth = growth if whole else np.maximum(growth, 0)
        self._size = self._size + parameters.size_gain * growth
        self._timestamp = timestamp
        self.seen = box

    def _predicted_place(self, elapsed: float) -> NDArray[np.float64]:
        drift_s = self._parameters.drift_s
        travel = drift_s * (1 - math.exp(-elapsed / drift_s))
        return np.asarray(self._place + travel * self.velocity)


class Track:
    """One person of a camera session.

    In each frame that shows the person, :meth:`see` adds the place, then :meth:`update` the poses.
    If there are no poses, :meth:`extrapolate` keeps the last one.

    Parameters
    ----------
    sighting : Sighting
        The first.
    timestamp : float
        Seconds.
    """

    def __init__(
        self, sighting: Sighting, timestamp: float, parameters: TrackingParameters = DEFAULTS
    ) -> None:
        observed = sighting.observed
        self._parameters = parameters.track
        self.track_id: int | None = None
        """None until the track is confirmed."""
        self.caller_id: str | None = None
        """The identity that the caller gave the person's box."""
        self.zones: tuple[Zone, ...] = ()
        """Zones in which the person was last seen."""
        self.box_filter = BoxFilter(observed.box, timestamp, parameters.box)
        self.age_frames = 0
        self.sightings = self._windows = 0
        self._shown_odds: float | None = None  # Mean log odds that the windows show a person.
        self.score = 0.0
        """Highest probability of a person given by the detector; 1 if the caller said so."""
        self.seen_at = timestamp
        """Time of the last sighting, seconds."""
        self.next_window: PersonWindow | None = observed.next_window
        """Window in which the person is looked for next."""
        self.appearance = sighting.appearance
        self._smoother = PoseSmoother(parameters)
        self._recogniser = ActionRecogniser(parameters=parameters)
        self._event_detector = EventDetector(parameters.events)
        self._zone_watch = ZoneWatch(parameters.zones)
        self._posture_filter = PostureFilter(parameters.posture)
        self._facing: Facing | None = None
        self._posture: EstimatedPosture | None = None
        self._action: RecognisedAction | None = None

    @property
    def is_confirmed(self) -> bool:
        """Whether the track counts as a person."""
        if self._shown_odds is not None:
            return self._probability(self._shown_odds) >= self._parameters.min_probability
        return (
            self.score >= self._parameters.confirming_score
            or self.sightings >= self._parameters.confirming_sightings
        )

    def _probability(self, shown_odds: float) -> float:
        """Probability that a person is tracked, by Bayes' rule.

        The detector's highest score is the prior. The windows' odds include the share of people in
        the training data, so its log odds are subtracted. Their mean counts as a single
        observation, because furniture that looks like a person does so in every frame.
        """
        in_training = log_odds(self._parameters.people_share)
        return probability_of(log_odds(self.score) + shown_odds - in_training)

    def see(self, sighting: Sighting, timestamp: float, zones: Sequence[Zone] = ()) -> None:
        """Add where the person is in this frame, and in which of the camera's zones."""
        observed = sighting.observed
        truncated = observed.silhouette is not None and observed.silhouette.truncated
        self._locate(observed, zones)
        if self.sightings:
            self.box_filter.update(observed.box, timestamp, whole=not truncated)
        self.sightings += 1
        elapsed, self.seen_at = timestamp - self.seen_at, timestamp
        if observed.source not in ("background", "track"):
            self.score = max(self.score, _score(observed))
        if observed.source == "detector" and observed.doubt is not None:
            self._windows += 1
            gain = 1 - math.exp(-elapsed / self._parameters.window_mean_s)
            odds, mean = log_odds(observed.doubt.person), self._shown_odds or 0.0
            self._shown_odds = mean + max(1 / self._windows, gain) * (odds - mean)
        self.next_window = observed.next_window
        if self.appearance is None:
            self.appearance = sighting.appearance
        # A partly hidden person would take on the colours of the person in front.
        elif sighting.appearance is not None and not truncated:
            difference = sighting.appearance - self.appearance
            self.appearance = self.appearance + self._parameters.appearance_gain * difference

    def update(
        self, person: Person, timestamp: float, zones: Sequence[Zone] = ()
    ) -> tuple[TrackedPerson, tuple[Event, ...]]:
        """Add the poses of this frame; return the person and what begins or ends with it."""
        observed = person.observed
        smoothed = self._smoother.update(person, timestamp)
        if smoothed is None:
            return self.extrapolate(observed, timestamp), ()
        presence = 1.0 if observed.presence is None else observed.presence
        weight = self._weight(observed)
        self._facing = smoothed.facing
        self._posture, shares = self._posture_filter.update(
            timestamp,
            smoothed.votes,
            observed.frame_posture,
            presence,
            observed.whole_box,
            weight,
        )
        posture = self._posture if observed.landmarks is not None else None
        self._action = self._recogniser.update(timestamp, person, smoothed, posture)
        # The posture says which part of the body has to be in a zone.
        self._locate(observed, zones)
        events: tuple[Event, ...] = ()
        if self.track_id is not None:
            events = self._event_detector.update(
                self.track_id,
                timestamp,
                shares,
                _reliability(observed, smoothed.pose, weight),
                hip_height(person, smoothed),
                rests=is_rest(self.zones),
            )
        person = replace(person, facing=self._facing, posture=self._posture)
        return self._tracked(person, smoothed.pose), tuple(map(self.annotated, events))

    def _weight(self, observed: ObservedPerson) -> float:
        """Weight of a frame's posture: how likely the posture is right, given the landmarks."""
        presence = 1.0 if observed.presence is None else observed.presence
        right = 1.0 if observed.doubt is None else observed.doubt.right
        right = math.pow(right, self._parameters.reliability_exponent)
        return 1 - presence * (1 - right)

    def extrapolate(self, observed: ObservedPerson, timestamp: float) -> TrackedPerson:
        """Keep the pose of the last frames, at the place where the person is now."""
        pose = self._smoother.extrapolate(observed, timestamp)
        if pose is None:
            return self._tracked(Person(observed, None, None, ()), None)
        return self._tracked(Person(observed, self._facing, self._posture, ()), pose)

    def unconfirmed(self) -> tuple[Event, ...]:
        """Events that had begun to show at the last frame but were not certain."""
        if self.track_id is None:
            return ()
        return tuple(map(self.annotated, self._event_detector.unconfirmed(self.track_id)))

    def cross_zones(self, timestamp: float, zones: Sequence[Zone]) -> list[Event]:
        """Add a frame in which the person was seen; return the zones entered and left."""
        if self.track_id is None:
            return []
        crossings = self._zone_watch.update(
            self.track_id, timestamp, zones, self.box_filter.seen, self._known_posture()
        )
        return self._crossings(crossings)

    def leave_zones(self, timestamp: float) -> list[Event]:
        """Leave all zones because the track ends."""
        if self.track_id is None:
            return []
        return self._crossings(self._zone_watch.end(self.track_id, timestamp, self.seen_at))

    def annotated(self, event: Event) -> Event:
        """An event of this track with the person's zones and the caller's identity."""
        return replace(event, zones=self._zone_names(), caller_track_id=self.caller_id)

    def _crossings(self, events: Sequence[Event]) -> list[Event]:
        """Events of zones with the track's probability and the caller's identity."""
        return [
            replace(event, probability=self.score, caller_track_id=self.caller_id)
            for event in events
        ]

    def _known_posture(self) -> Posture | None:
        label = self._posture.label if self._posture else None
        return None if label == "unclear" else label

    def _locate(self, observed: ObservedPerson, zones: Sequence[Zone]) -> None:
        self.zones = zones_of(zones, observed.box, self._known_posture())

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


def _reliability(observed: ObservedPerson, pose: SmoothedPose, weight: float) -> Reliability:
    """Weight of a frame, from the landmark network or, without landmarks, from the pose."""
    if observed.presence is None:
        return Reliability(pose.confidence, pose.confidence)
    presence = max(observed.presence, _score(observed))
    return Reliability(weight * observed.presence, weight * presence)


def _score(observed: ObservedPerson) -> float:
    """The detector's probability of a person; 1 if the caller said where people are."""
    return 1.0 if observed.detection_score is None else observed.detection_score


def hip_height(person: Person, smoothed: Smoothed) -> HipHeight:
    """Height of a person's hips, from the best hypothesis."""
    y_px = float(person.hypotheses[0].points_2d[_HIPS, 1].mean())
    return HipHeight.seen(y_px, smoothed.px_per_m, smoothed.elevation_deg)
