"""Tracks, each of one person over time, and the assignment of sightings to tracks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import lap
import numpy as np
from numpy.typing import NDArray

from app.configuration import EventName
from app.estimation.posture import (
    LANDMARK_GROUPS,
    EstimatedPosture,
    PostureFilter,
)
from app.estimation.results import Facing, FacingSource, Person
from app.networks.probabilities import log_odds, probability_of
from app.scene import Patch
from app.tracking.actions import ActionRecogniser, PoseSample
from app.tracking.body import SeenBody
from app.tracking.events import EventDetector
from app.tracking.falls import Observation
from app.tracking.floor import Floor, Rest
from app.tracking.last_estimate import LastEstimate
from app.tracking.motion import Motion, MotionFilter, posture_in_motion
from app.tracking.results import Event, RecognisedAction, SmoothedPose, TrackedPerson
from app.tracking.smoothing import EXTRAPOLATED_S, PoseSmoother, Smoothed
from app.tracking.zones import Zone, ZoneWatch, is_rest
from app.vision.geometry import Box, PersonWindow
from app.vision.halved import Frame
from app.vision.same_person import KnownPerson, same_probabilities
from index.posture import (
    POSTURES,
    SILHOUETTE_GROUPS,
    PostureName,
    camera_up,
    classify_postures,
    vote_posture,
)

# With landmarks: the probability of a person from which a track counts as one.
_MIN_PROBABILITY = 0.9
# Time over which windows are averaged: a person may sit down on a chair that was tracked as one.
_WINDOW_MEAN_S = 3.0
# Without landmarks: the detector's score that is enough at once, and the number of sightings that
# is always enough.
_CONFIRMING_SCORE, _CONFIRMING_SIGHTINGS = 0.6, 3
# Exponent of the probability that landmarks are right, in the weight of a frame's posture. On
# held-out renders postures are right in 39, 58, 69, 77, 82 and 89 % where that probability is
# 0.005, 0.03, 0.1, 0.3, 0.55 and 0.85.
_RELIABILITY_EXPONENT = 0.25
# Time in which a person lost while falling comes to rest.
_COMES_TO_REST_S = 2.0
# Time without a change after which the picture of a person may show a statue or a poster.
_STILL_FROM_S = 600.0
# Share of the difference that corrects the known colours.
_COLOUR_GAIN = 0.1


class Track:
    """One person of a camera session.

    For each frame that shows the person, :meth:`see` adds the place. Once the track is confirmed,
    :meth:`update` adds the poses, also for a frame in which the person is hidden and has no pose.
    ``watched_from`` is that of :class:`app.tracking.falls.FallWatch`.
    """

    def __init__(self, person: Person, timestamp: float, watched_from: float = math.inf) -> None:
        self.track_id: int | None = None
        """None until the track is confirmed."""
        self.caller_id: str | None = None
        """The identity that the caller gave the person's box."""
        self.box_filter = BoxFilter(person.box, timestamp)
        self.age_frames = 0
        self.sightings = self._windows = 0
        self._shown_odds: float | None = None  # Mean log odds that the windows show a person.
        self.score = 0.0
        """Highest probability of a person given by the detector; 1 if the caller marked them."""
        self.seen_at = timestamp
        """Time of the last sighting, seconds."""
        self.lies_at: Box | None = None
        """Where the person lies after a fall, once no longer visible; otherwise None."""
        self.hidden = False
        """Whether another person was at the expected place since the last sighting."""
        self._patch, self._rests_from = person.patch, -math.inf
        self._still, self._still_from = person.patch, timestamp
        self.last_estimate = LastEstimate(timestamp)
        self.next_window: PersonWindow | None = person.next_window
        """Window in which the next frame is read."""
        self.trusted = False
        """Whether the last reading was trusted."""
        self.seen_keypoints = person.seen_keypoints
        """MoveNet's keypoints of the last look, relative to the landmarks."""
        self.drawn = person.drawn
        """The silhouette as drawn last."""
        self.drawn_at = timestamp
        self.beside = person.beside
        """Whether others hid the person, so that the next window hardly shows them."""
        self.colours = person.colours
        self._motion_filter, self._smoother = MotionFilter(), PoseSmoother()
        self._recogniser = ActionRecogniser()
        self._event_detector = EventDetector(watched_from)
        self._zone_watch, self._rest = ZoneWatch(), Rest()
        self._posture_filter = PostureFilter()
        self._body_at = -math.inf
        """Time of the last frame that showed the body."""
        self._facing: Facing | None = None
        self._posture: EstimatedPosture | None = None
        self._action: RecognisedAction | None = None

    @property
    def is_confirmed(self) -> bool:
        if self._shown_odds is not None:
            return self._probability(self._shown_odds) >= _MIN_PROBABILITY
        return self.score >= _CONFIRMING_SCORE or self.sightings >= _CONFIRMING_SIGHTINGS

    def _probability(self, shown_odds: float) -> float:
        """Probability that the track is a person, by Bayes' rule.

        The detector's highest score is the prior. The mean of the windows' odds counts as a single
        observation, because furniture that looks like a person does so in every frame.
        """
        return probability_of(log_odds(self.score) + shown_odds)

    def see(self, person: Person, timestamp: float) -> None:
        """Add the person's place and appearance in this frame."""
        truncated = person.silhouette is not None and person.silhouette.truncated
        if self.sightings:
            self.box_filter.update(person.box, timestamp, whole=not truncated)
        self.sightings += 1
        elapsed, self.seen_at = timestamp - self.seen_at, timestamp
        if person.source not in ("background", "track"):
            score = 1.0 if person.detection_score is None else person.detection_score
            self.score = max(self.score, score)
        if person.source == "detector" and person.trust is not None:
            self._windows += 1
            gain = 1 - math.exp(-elapsed / _WINDOW_MEAN_S)
            odds, mean = log_odds(person.trust.person), self._shown_odds or 0.0
            self._shown_odds = mean + max(1 / self._windows, gain) * (odds - mean)
        self.next_window, self.beside = person.next_window, person.beside
        self.trusted = person.trust is not None and person.trust.is_right
        self.seen_keypoints, self.drawn = person.seen_keypoints, person.drawn
        if not person.moved_along:
            self.drawn_at = timestamp
        self._patch, self.lies_at, self.hidden = person.patch, None, False
        if self.colours is None:
            self.colours = person.colours
        # A partly hidden person would take on the colours of the person in front.
        elif person.colours is not None and not truncated:
            self.colours = self.colours + _COLOUR_GAIN * (person.colours - self.colours)

    def known(self, timestamp: float) -> KnownPerson:
        """The person as expected in a frame, for comparison with the people found there."""
        boxes = self.box_filter.predict(timestamp), self.box_filter.seen
        return KnownPerson(*boxes, timestamp - self.seen_at, self.colours)

    def confirm(self, track_id: int, timestamp: float, zones: Sequence[Zone]) -> Event:
        self.track_id = track_id
        self._zone_watch.locate(zones, self.box_filter.seen, None)
        return self._moment("entered", timestamp)

    def update(
        self,
        person: Person,
        timestamp: float,
        zones: Sequence[Zone] = (),
        *,
        frame: Frame,
        covered: float = 0.0,
        floor: Floor | None = None,
    ) -> tuple[TrackedPerson, list[Event]]:
        """Add what a frame shows of the body; if it shows none, the last pose moves along.

        The person is as estimated from this frame ``(H, W, 3)`` alone. With landmarks, everything
        except the pose follows from these, so hypotheses are not needed. ``covered`` is the share
        of the person's box that another person's box covers. The ``floor`` of the camera learns
        from the person. The events of the frame are returned as well.
        """
        self.last_estimate.update(person, timestamp)
        self._compare(person, frame, covered, timestamp)
        body, shares, smoothed = SeenBody.of(person), None, None
        if body is not None:
            motion = self._motion_filter.update(timestamp, person.whole_box, body)
            smoothed = self._smoother.update(person, timestamp, motion)
            shares = self._add_body(person, body, motion, smoothed, timestamp)
            if floor is not None and self.track_id is not None:
                floor.see(self.track_id, person, frame.shape)
                self._rest.update(timestamp, person, self.track_id, floor)
        crossings: list[Event] = []
        if self.seen_at == timestamp:
            # The posture says which part of the body has to be in a zone.
            crossings = self._zone_watch.update(
                timestamp, zones, self.box_filter.seen, self._known_posture()
            )
        if body is None or shares is None:
            pose = self._smoother.extrapolate(person, timestamp)
            return self._tracked(person, pose, timestamp), self._crossed(crossings)
        pose = smoothed.pose if smoothed else None
        confidence = pose.confidence if pose else 0.0
        events = self._event_detector.update(
            timestamp,
            shares,
            _reliability(person, confidence),
            _observation(person, shares, confidence, frame.shape, covered),
            rests=is_rest(self._zone_watch.zones),
        )
        tracked = self._tracked(person, pose, timestamp)
        return tracked, [*map(self._annotated, events), *self._crossed(crossings)]

    def _compare(self, person: Person, frame: Frame, covered: float, timestamp: float) -> None:
        """Keep the first picture since the person last changed; people in front do not count."""
        if person.patch is None or covered > 0:
            return
        if self._still is None or not self._still.is_shown_by(frame):
            self._still, self._still_from = person.patch, timestamp

    def _add_body(
        self,
        person: Person,
        body: SeenBody,
        motion: Motion,
        smoothed: Smoothed | None,
        timestamp: float,
    ) -> NDArray[np.float64]:
        """Update facing, posture and action; return the shares of postures of this frame."""
        self._body_at = timestamp
        evidence: FacingSource = "none" if body.skeleton is None else "image"
        self._facing = Facing(
            motion.heading.front_probability, "motion" if motion.walks else evidence
        )
        if body.skeleton is not None:
            votes = _vote_of(body.skeleton, motion)
            sample = PoseSample(
                timestamp, body.skeleton, body.hips_px, body.px_per_m, motion.elevation_deg
            )
        elif smoothed is not None:
            votes = smoothed.votes
            if person.posture is not None and person.frame_posture is None:
                sums = SILHOUETTE_GROUPS.sums(person.posture.shares)
                votes = SILHOUETTE_GROUPS.split(sums, votes)
            sample = PoseSample.of(timestamp, smoothed.pose, motion.elevation_deg)
        self._posture, shares = self._posture_filter.update(
            timestamp,
            votes,
            person.frame_posture,
            1.0 if person.presence is None else person.presence,
            person.whole_box,
            _weight(person),
        )
        posture = self._posture if person.landmarks is not None else None
        self._action = self._recogniser.update(sample, person, posture)
        return shares

    def unconfirmed(self) -> list[Event]:
        return [*map(self._annotated, self._event_detector.unconfirmed())]

    def lose(
        self, frame: Frame, timestamp: float, *, alone: bool = True
    ) -> tuple[list[Event], bool]:
        """The events of a person who is no longer visible, and whether the track goes on.

        The track goes on if the person fell and the picture at their place has not changed. Losing
        a person counts as a fall only if the person is ``alone`` and has not been hidden since the
        last sighting: another tracked person at the place may be the same or hide them.
        """
        if self.track_id is None:
            return [], False
        events: list[Event] = []
        if alone and not self.hidden:
            events += map(self._annotated, self._event_detector.lost(timestamp))
        if events:
            self._rests_from = timestamp + _COMES_TO_REST_S
        if timestamp <= self._rests_from:
            self._patch = Patch.of(frame, self.box_filter.seen)
        stays = self._patch is not None and self._patch.is_shown_by(frame)
        if self._event_detector.has_fallen and stays:
            self.lies_at = self.box_filter.seen
            return events, True
        return events + self.end(timestamp), False

    def end(self, timestamp: float) -> list[Event]:
        """End the track; return ``zone_left`` for the person's zones, and ``left``."""
        if self.track_id is None:
            return []
        crossings = self._zone_watch.end(timestamp, self.seen_at)
        return [*self._crossed(crossings), self._moment("left", timestamp)]

    def _moment(self, name: EventName, timestamp: float) -> Event:
        return self._annotated(Event(name, "instant", timestamp, self.score))

    def _annotated(self, event: Event) -> Event:
        return replace(
            event,
            track_id=self.track_id,
            caller_track_id=self.caller_id,
            zones=self._zone_names(),
            on_floor=self._rest.on_floor if event.event in ("lying", "fell") else None,
        )

    def _crossed(self, events: Sequence[Event]) -> list[Event]:
        """Events of zones with the track's identities and probability."""
        return [
            replace(self._annotated(event), zones=event.zones, probability=self.score)
            for event in events
        ]

    def _known_posture(self) -> PostureName | None:
        label = self._posture.label if self._posture else None
        return None if label == "unclear" else label

    def _zone_names(self) -> tuple[str, ...]:
        return tuple(zone.name for zone in self._zone_watch.zones)

    def _tracked(
        self, person: Person, pose: SmoothedPose | None, timestamp: float
    ) -> TrackedPerson:
        if self.track_id is None:
            raise ValueError("expected a confirmed track")
        still_s = timestamp - self._still_from if self._still is not None else 0.0
        known = {"facing": self._facing, "posture": self._posture}
        if timestamp - self._body_at > EXTRAPOLATED_S:
            known = {}
        return TrackedPerson(
            **vars(person) | known,
            track_id=self.track_id,
            age_frames=self.age_frames,
            pose=pose,
            action=self._action,
            zones=self._zone_names(),
            caller_track_id=self.caller_id,
            still_s=still_s if still_s >= _STILL_FROM_S else None,
            on_floor=self._rest.on_floor if self._known_posture() == "lying" else None,
        )


def _vote_of(skeleton: NDArray[np.float64], motion: Motion) -> NDArray[np.float64]:
    """The vote ``(10,)`` of a skeleton ``(24, 3)`` for its posture."""
    up = camera_up(motion.elevation_deg)
    posture = POSTURES[int(classify_postures(skeleton[None], up)[0])]
    return vote_posture([posture_in_motion(posture, motion.velocity)], [1.0])


def _weight(person: Person) -> float:
    """Weight of a frame's posture: how likely the posture is right, given the landmarks."""
    presence = 1.0 if person.presence is None else person.presence
    right = 1.0 if person.trust is None else person.trust.right
    right = math.pow(right, _RELIABILITY_EXPONENT)
    return 1 - presence * (1 - right)


def _reliability(person: Person, confidence: float) -> float:
    """Weight of a frame, from the landmark network or, without landmarks, from the pose."""
    return confidence if person.presence is None else _weight(person) * person.presence


def _observation(
    person: Person,
    shares: NDArray[np.float64],
    confidence: float,
    frame_shape: tuple[int, ...],
    covered: float,
) -> Observation:
    """The input of the fall model from one frame, with landmarks if any were read.

    Without landmarks, the posture is that of the hypotheses, whose shares ``(10,)`` are given, and
    the confidence is that of the smooth pose.
    """
    if person.frame_posture is None or person.landmarks is None:
        return Observation(
            person.box, frame_shape, LANDMARK_GROUPS.sums(shares), confidence, covered=covered
        )
    return Observation.of(person, frame_shape, covered)


# Least probability that two sightings are the same person. In pairs of held-out films, one person
# is taken for two in 1.3 % (1.2 by the earlier rules), and two people for one in 11 % (23) if no
# other fits better.
_LEAST_SAME = 0.25
_MAX_COST = -math.log(_LEAST_SAME)


def associate(
    tracks: Sequence[Track],
    people: Sequence[Person],
    timestamp: float,
    in_window: Mapping[int, Track] | None = None,
) -> list[Track | None]:
    """The track of each person of a frame, None for a new one.

    The pairs have the highest joint probability, and each has at least :data:`_LEAST_SAME`.
    ``in_window`` maps a person's position to the track whose window the person was read in.
    """
    shown, pairs, features = in_window or {}, list[tuple[int, int]](), list[NDArray[np.float64]]()
    for row, track in enumerate(tracks):
        known = track.known(timestamp)
        for column, person in enumerate(people):
            is_there = shown.get(column) is track
            if is_there or known.may_be(person.box):
                pairs.append((row, column))
                features.append(known.features(person.box, person.colours, in_window=is_there))
    if not pairs:
        return [None] * len(people)
    costs = np.full((len(tracks), len(people)), 10 * _MAX_COST)
    found = -np.log(same_probabilities(np.array(features)))
    costs[tuple(np.transpose(pairs))] = np.minimum(found, 10 * _MAX_COST)
    _, _, rows = lap.lapjv(costs, extend_cost=True, cost_limit=_MAX_COST)
    return [tracks[row] if row >= 0 else None for row in rows]


# Shares of the difference between prediction and observation that correct place, velocity, size.
_PLACE_GAIN, _VELOCITY_GAIN, _SIZE_GAIN = 0.7, 0.3, 0.3
# Time in which an unseen person's velocity falls to 1/e.
_DRIFT_S = 1.0
# Least elapsed time: a frame that is sent again has the same time.
_MIN_ELAPSED_S = 1e-3


class BoxFilter:
    """Predicts a person's box, assuming a constant velocity.

    The place is the middle of the lower edge, where the person stands.
    """

    def __init__(self, box: Box, timestamp: float) -> None:
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
        """Correct the prediction by an observed box; it shrinks only for a whole person."""
        elapsed = max(timestamp - self._timestamp, _MIN_ELAPSED_S)
        predicted = self._predicted_place(elapsed)
        growth = np.array([box.width, box.height]) - self._size
        error = box.foot - predicted
        self._place = predicted + _PLACE_GAIN * error
        # The longer the gap, the more of the error is due to the velocity alone.
        gain = _VELOCITY_GAIN / elapsed if elapsed < 1 else 1 / elapsed
        self.velocity = self.velocity + gain * error
        growth = growth if whole else np.maximum(growth, 0)
        self._size = self._size + _SIZE_GAIN * growth
        self._timestamp = timestamp
        self.seen = box

    def _predicted_place(self, elapsed: float) -> NDArray[np.float64]:
        travel = _DRIFT_S * (1 - math.exp(-elapsed / _DRIFT_S))
        return np.asarray(self._place + travel * self.velocity)
