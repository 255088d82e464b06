"""Tracks, each of one person over time, and the assignment of sightings to tracks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import lap
import numpy as np
from numpy.typing import NDArray

from app.estimation.posture import LANDMARK_GROUPS
from app.estimation.results import Person
from app.networks.probabilities import log_odds, probability_of
from app.tracking.body import Body, posture_weight
from app.tracking.events import Watches
from app.tracking.falls import observation, observation_of
from app.tracking.floor import Floor
from app.tracking.place import PREDICTED_FOR_S, LastEstimate, Place
from app.tracking.results import Event, SmoothedPose, TrackedPerson
from app.tracking.zones import Zone
from app.vision.geometry import Box
from app.vision.halved import Frame
from app.vision.same_person import KnownPerson, same_probabilities
from app.vision.truncation import may_have_left


class Confirmation:
    """Whether a track is a person.

    Without landmarks, the detector's score or the number of sightings decides. With them, the
    detector's highest score is the prior, and the mean of the windows' odds counts as a single
    observation, because furniture that looks like a person does so in every frame.
    """

    def __init__(self) -> None:
        self.score = 0.0
        """Highest probability of a person given by the detector; 1 if the caller marked them."""
        self.sightings = self._windows = 0
        self._shown_odds: float | None = None  # Mean log odds that the windows show a person.

    @property
    def holds(self) -> bool:
        """Whether the track counts as a person."""
        if self._shown_odds is not None:
            return probability_of(log_odds(self.score) + self._shown_odds) >= 0.9
        # Enough at once, and always enough.
        return self.score >= 0.6 or self.sightings >= 3

    def see(self, person: Person, elapsed: float) -> None:
        """Add a sighting, so many seconds after the one before."""
        self.sightings += 1
        if person.source not in ("background", "track"):
            score = 1.0 if person.detection_score is None else person.detection_score
            self.score = max(self.score, score)
        if person.source == "detector" and person.trust is not None:
            self._windows += 1
            # Averaged over 3 s: a person may sit down on a chair that was tracked as one.
            gain = 1 - math.exp(-elapsed / 3.0)
            odds, mean = log_odds(person.trust.person), self._shown_odds or 0.0
            self._shown_odds = mean + max(1 / self._windows, gain) * (odds - mean)


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
        self.age_frames = 0
        self.confirmation = Confirmation()
        self.place = Place(person, timestamp)
        self.last = person
        """The last sighting."""
        self.drawn_at = timestamp
        """When the silhouette was last drawn, not moved along, seconds."""
        self.colours = person.colours
        self.last_estimate = LastEstimate(timestamp)
        self._body, self._watches = Body(), Watches(watched_from)

    @property
    def trusted(self) -> bool:
        """Whether the last reading was trusted."""
        return self.last.trust is not None and self.last.trust.is_right

    def see(self, person: Person, timestamp: float) -> None:
        """Add the person's place and appearance in this frame."""
        truncated = person.silhouette is not None and person.silhouette.truncated
        if self.confirmation.sightings:
            self.place.update(person.box, timestamp, whole=not truncated)
        self.confirmation.see(person, timestamp - self.place.seen_at)
        self.place.see(person, timestamp)
        self.last = person
        if not person.moved_along:
            self.drawn_at = timestamp
        if self.colours is None:
            self.colours = person.colours
        # A partly hidden person would take on the colours of the person in front.
        elif person.colours is not None and not truncated:
            self.colours = self.colours + 0.1 * (person.colours - self.colours)

    def known(self, timestamp: float) -> KnownPerson:
        """The person as expected in a frame, for comparison with the people found there."""
        boxes = self.place.predict(timestamp), self.place.seen
        return KnownPerson(*boxes, timestamp - self.place.seen_at, self.colours)

    def confirm(self, track_id: int, timestamp: float, zones: Sequence[Zone]) -> Event:
        """Give the track an identity; return the event ``entered``."""
        self.track_id = track_id
        entered = self._watches.enter(timestamp, zones, self.place.seen, self.confirmation.score)
        return self._named([entered])[0]

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
        self.place.compare(person, frame, covered, timestamp)
        pose, shares = self._body.update(person, timestamp)
        if shares is not None and floor is not None and self.track_id is not None:
            floor.see(self.track_id, person, frame.shape)
            self._watches.rest.update(timestamp, person, self.track_id, floor)
        crossings: list[Event] = []
        if self.place.seen_at == timestamp:
            box, posture = self.place.seen, self._body.posture
            crossings = self._scored(self._watches.cross(timestamp, zones, box, posture))
        events: list[Event] = []
        if shares is not None:
            confidence = pose.confidence if pose else 0.0
            # The posture of the landmarks or, without any, that of the hypotheses.
            if person.frame_posture is None or person.landmarks is None:
                postures = LANDMARK_GROUPS.sums(shares)
                seen = observation(person.box, frame.shape, postures, confidence, covered=covered)
            else:
                seen = observation_of(person, frame.shape, covered)
            certain = posture_weight(person) * person.presence
            reliability = confidence if person.next_window is None else certain
            events = self._watches.update(timestamp, shares, reliability, seen)
        return self._tracked(person, pose, timestamp), self._named([*events, *crossings])

    def unconfirmed(self) -> list[Event]:
        """Events that had begun to show at the last frame but were not certain."""
        return self._named(self._watches.unconfirmed())

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
        if alone and not self.place.hidden:
            events = self._named(self._watches.lost(timestamp))
        stays = self.place.looks_the_same(frame, timestamp, falls=bool(events))
        if self._watches.has_fallen and stays:
            self.place.lies_at = self.place.seen
            return events, True
        return events + self.end(timestamp), False

    def end(self, timestamp: float) -> list[Event]:
        """End the track; return ``zone_left`` for the person's zones, and ``left``."""
        if self.track_id is None:
            return []
        score = self.confirmation.score
        return self._named(self._scored(self._watches.leave(timestamp, self.place.seen_at, score)))

    def _scored(self, events: Sequence[Event]) -> list[Event]:
        return [replace(event, probability=self.confirmation.score) for event in events]

    def _named(self, events: Sequence[Event]) -> list[Event]:
        return [
            replace(event, track_id=self.track_id, caller_track_id=self.caller_id)
            for event in events
        ]

    def _tracked(
        self, person: Person, pose: SmoothedPose | None, timestamp: float
    ) -> TrackedPerson:
        if self.track_id is None:
            raise ValueError("expected a confirmed track")
        lies = self._body.posture == "lying"
        return TrackedPerson(
            **vars(person) | self._body.known(timestamp),
            track_id=self.track_id,
            age_frames=self.age_frames,
            pose=pose,
            action=self._body.action,
            zones=self._watches.zones,
            caller_track_id=self.caller_id,
            still_s=self.place.still_s(timestamp),
            on_floor=self._watches.rest.on_floor if lies else None,
        )


class Tracks(list[Track]):
    """The tracks of one camera, ``most`` at most.

    ``watched_from`` is that of :class:`app.tracking.falls.FallWatch` for new ones.
    """

    def __init__(self, most: int) -> None:
        super().__init__()
        self._most, self._given_ids = most, 0
        self.watched_from = -math.inf

    def named_by_caller(
        self, people: Sequence[Person], caller_ids: Sequence[str], timestamp: float
    ) -> list[Track | None]:
        """The track of each person by the caller's identity for the person."""
        known = {track.caller_id: track for track in self}
        tracks = []
        for person, caller_id in zip(people, caller_ids, strict=True):
            track = known.get(caller_id) or self._begin(person, timestamp)
            if track is not None:
                track.caller_id = caller_id
            tracks.append(track)
        return tracks

    def see(
        self, people: Sequence[Person], known: Sequence[Track | None], timestamp: float
    ) -> list[tuple[Person, Track]]:
        """Begin tracks of people without one; return the people with their tracks."""
        seen = []
        for person, own in zip(people, known, strict=True):
            track = own or self._begin(person, timestamp)
            if track is not None:
                track.see(person, timestamp)
                seen.append((person, track))
        return seen

    def _begin(self, person: Person, timestamp: float) -> Track | None:
        """Begin the track of a new person; None if there are too many tracks."""
        if len(self) >= self._most:
            return None
        track = Track(person, timestamp, self.watched_from)
        self.append(track)
        return track

    def confirm(self, timestamp: float, zones: Sequence[Zone]) -> list[Event]:
        """Count a frame of each track, and give an identity to those that now count as people."""
        events = []
        for track in self:
            track.age_frames += 1
            if track.track_id is None and track.confirmation.holds:
                self._given_ids += 1
                events.append(track.confirm(self._given_ids, timestamp, zones))
        return events

    def hidden_people(self, shape: tuple[int, ...], timestamp: float) -> list[tuple[Person, Track]]:
        """Hidden people at their expected places, and fallen people where they lie."""
        return [
            (Person(box, "track"), track)
            for track in self
            if track.place.seen_at < timestamp
            and (box := track.place.lies_at or self._hidden_box(track, shape, timestamp))
        ]

    def _hidden_box(self, track: Track, shape: tuple[int, ...], timestamp: float) -> Box | None:
        others = [other.place for other in self]
        return track.place.hidden_box(others, shape, timestamp)

    def named_places(self) -> list[Place]:
        """Places of people with an identity, who cover others."""
        return [track.place for track in self if track.track_id is not None]

    def drop_unseen(self, frame: Frame, timestamp: float) -> list[Event]:
        """End the tracks of people who are no longer visible; return their events.

        A fallen person stays at the last place until the picture changes there. A person hidden
        behind another one is not reported as fallen.
        """
        kept, ended = [], list[Event]()
        for track in self:
            place, named = track.place.seen, track.track_id is not None
            hidden = named and self._hidden_box(track, frame.shape, timestamp) is not None
            track.place.hidden |= hidden
            # Found by the detector, and last seen where nobody leaves the frame.
            vanished = track.last.next_window is not None and not may_have_left(place, frame.shape)
            predicted = hidden or (named and vanished)
            # Time without a sighting after which a track is dropped; longer for people hidden
            # behind others and for people lost away from the frame's border.
            longest = PREDICTED_FOR_S if predicted else 0.5
            if timestamp - track.place.seen_at > longest:
                covered = track.place.covered_share(place, self.named_places(), timestamp)
                events, stays = track.lose(frame, timestamp, alone=covered == 0)
                ended += events
                if not stays:
                    continue
            kept.append(track)
        self[:] = kept
        return ended

    def end(self, timestamp: float) -> list[Event]:
        """End all tracks; return their events."""
        events = [event for track in self for event in track.end(timestamp)]
        self.clear()
        return events


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
