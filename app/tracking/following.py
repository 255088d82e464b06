"""Finds the people of a camera's frame: tracked people in their windows, new people by a search.

Landmarks of tracked people are read on every frame, in the windows that their last landmarks point
to; people who do not move are read every 0.4 s. Every 0.2 s, and when a reading is not trusted,
MoveNet looks at them as well, and other windows are read. At intervals, and if a track's window no
longer shows a person, the whole frame is searched, to find new people and to check the tracks:
MoveNet, which needs no window, finds people whose windows have drifted off. While nothing changes
around tracked people, searches are rarer. In an empty scene, the coefficients of a JPEG show
whether anything changes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from app.estimation.finder import Found, PeopleFinder, Target
from app.estimation.results import Person
from app.estimation.upload import DecodedUpload
from app.scene import Scene
from app.scheduling.job import Job
from app.tracking.track import Track
from app.vision.blazepose import LANDMARK_PX
from app.vision.geometry import PersonWindow
from app.vision.halved import HALF, Frame
from app.vision.judgement import JudgedReading
from app.vision.people import Detection
from app.vision.same_person import is_expected
from app.vision.truncation import may_have_left

SEARCH_EVERY_S = 0.4
"""Time between two searches of the whole frame while it changes around the tracked people."""

LOOK_EVERY_S = 0.2
"""Time between two looks of MoveNet at a tracked person who is read surely. At 0.4 s, sides that
are exchanged stay so for too long: a balancing person, camera 2 of Pose2Sim at 30 frames a second,
is read with 105 instead of 95 mm."""

DRAWN_EVERY_S = 0.4
"""Time between two silhouettes of such a person, and between two matches of them, unless every one
is wanted or the body changes its shape."""

CALM_SEARCH_EVERY_S = 0.8
"""The same if all of them are read surely, so that a search only finds new people, or if nothing
has changed around them since the last search, so that it only checks them."""

STILL_SEARCH_EVERY_S = 3.0
"""Time between two searches while nothing changes around them."""

EMPTY_SEARCH_EVERY_S = 12.0
"""Time between two searches while nothing changes and no person is tracked. Such a search
finds only people who were missed on entering."""

# Trust below which other windows are read, if the reading before was likelier right than not.
_LOST_TRUST = 0.25

# A track's window is read for this long after a sighting.
_WINDOW_LASTS_S = 0.5

Expected = Mapping[Track, PersonWindow | JudgedReading]
"""Windows in which tracks expect their people, or the readings in them."""


class TrackedPeopleDetector:
    """Finds people frame by frame; one frame at a time."""

    def __init__(self, finder: PeopleFinder) -> None:
        self._finder = finder
        self._searched_at = self._read_at = -math.inf
        self._left_out = 0  # People whom the last search left out.
        self._looked_at: dict[Track, float] = {}  # When MoveNet looked at each tracked person.
        self._draws_all = True
        self.scene = Scene()

    def find(
        self,
        upload: DecodedUpload,
        timestamp: float,
        tracks: Sequence[Track],
        job: Job,
        *,
        drawn: bool = True,
    ) -> tuple[list[Person], dict[int, Track]]:
        """Find the people of a frame with their silhouettes and landmarks, given all tracks.

        Unless every silhouette is to be ``drawn``, some move along with the landmarks.

        Returns
        -------
        people : list of Person
        in_window : dict
            Maps the position of each person found in a track's window to that track.
        """
        self._draws_all = drawn
        self._looked_at = {one: self._looked_at.get(one, one.place.seen_at) for one in tracks}
        found, beside, followed, unchanged = self._targets(upload, timestamp, tracks, job)
        targets = [*found, *(self._followed(*one, timestamp) for one in followed.items())]
        wanted = Found(targets, perhaps_beside=beside)
        people, shown = self._finder.observe(upload, wanted, job, tight=True)
        self._read_at = timestamp
        # Where another track expects them, appearance and place decide.
        expected = {
            row for row, one in zip(shown[: len(found)], found, strict=True) if one.expected
        }
        in_window: dict[int, Track] = {}
        for row, track in zip(shown[len(found) :], followed, strict=True):
            if row is not None and row not in expected:
                in_window.setdefault(row, track)
        in_window |= dict(enumerate(unchanged, start=len(people)))
        everyone = [*people, *unchanged.values()]
        # Those whom a search left out may still be followed.
        followed_beyond = max(0, len(everyone) - self._finder.max_persons)
        job.left_out = max(0, self._left_out - followed_beyond)
        return everyone, in_window

    def half_suffices(self, shape: tuple[int, ...], tracks: Sequence[Track]) -> bool:
        """Whether half the size of a frame shows all that a search and the tracks need.

        For a small person who is new, all of the frame is decoded as well.
        """
        windows = [track.last.next_window for track in tracks]
        are_large = all(one is not None and HALF * one.side >= LANDMARK_PX for one in windows)
        return are_large and self._finder.search_scale(shape) <= HALF

    def shows_nothing_new(self, data: bytes, shape: tuple[int, ...], timestamp: float) -> bool:
        """Whether a JPEG file alone shows that a scene without tracks is still empty.

        The frame has the shape of those before. If the result is False, as when a search is due,
        the frame has to be decoded.
        """
        if timestamp - self._searched_at >= EMPTY_SEARCH_EVERY_S:
            return False
        smallest = self._finder.smallest_px(shape)
        return self.scene.is_still_in_file(data, shape, smallest, timestamp)

    def _targets(
        self, upload: DecodedUpload, timestamp: float, tracks: Sequence[Track], job: Job
    ) -> _Wanted:
        """What is to be read in a frame.

        If the windows show all people that a search could find, the frame is not searched. Then,
        people who do not move may stay as they were.
        """
        frame, state = upload.frame, _Followed.at(timestamp, tracks, self._read_at)
        smallest = self._finder.smallest_px(frame.shape)
        places = {one: (one.place.predict(timestamp), one.place.seen) for one in tracks}
        still = self.scene.is_still(frame, smallest, timestamp, places) and state.all_in_windows
        expected, lost = state.expected, state.lost
        interval = self._interval(timestamp, state, is_still=still)
        if timestamp - self._searched_at < interval and (still or state.may_suffice):
            shown = self._in_windows(upload, timestamp, expected, job)
            seen = {*shown.followed, *shown.unchanged}
            gone = [one for one in expected if one.track_id is not None and one not in seen]
            if not any(_may_be_there(one, frame.shape) for one in gone):
                return shown
            unread = {track: expected[track] for track in shown.unchanged}
            expected = {**shown.followed, **unread}
            lost = list(dict.fromkeys([*lost, *gone]))
        return self._searched(frame, timestamp, expected, lost, job)

    def _interval(self, timestamp: float, state: _Followed, *, is_still: bool) -> float:
        """Time from one search to the next; 0 while a person enters an empty scene."""
        if is_still:
            return STILL_SEARCH_EVERY_S if state.tracks else EMPTY_SEARCH_EVERY_S
        if not state.tracks:
            return 0.0 if self.scene.has_just_changed(timestamp) else SEARCH_EVERY_S
        unchanged = not self.scene.has_changed_since(self._searched_at)
        calm = unchanged or all(track.trusted for track in state.tracks)
        return CALM_SEARCH_EVERY_S if state.all_in_windows and calm else SEARCH_EVERY_S

    def _searched(
        self,
        frame: Frame,
        timestamp: float,
        expected: Expected,
        lost: Sequence[Track],
        job: Job,
    ) -> _Wanted:
        """Search a frame, with a lower threshold near lost people until their tracks end.

        A detection is read in the window of the track that expects a person there; a window is
        read once.
        """
        places = {track: track.place.predict(timestamp) for track in expected}
        known = [box for track, box in places.items() if track.track_id is not None]
        lost_at = [track.place.seen for track in lost if track not in places]
        people, beside = self._finder.search(frame, job, lost_at, known)
        self._searched_at, self._left_out = timestamp, job.left_out
        self.scene.restart()
        targets, unseen = [], dict(expected)
        for one in people:
            near = max(unseen, key=lambda track: places[track].iou(one.box), default=None)
            is_there = near is not None and is_expected(one.box, places[near])
            targets.append(Target(one, unseen.pop(near) if near and is_there else None))
            if near and is_there:
                self._looked_at[near] = timestamp
        return _Wanted(targets, beside, unseen, {})

    def _in_windows(
        self, upload: DecodedUpload, timestamp: float, expected: Expected, job: Job
    ) -> _Wanted:
        """The tracks whose windows still show their person, with readings, and unchanged people."""
        unchanged = _unchanged(upload.frame, timestamp, expected)
        moving = {track: window for track, window in expected.items() if track not in unchanged}
        targets = [self._followed(*one, timestamp) for one in moving.items()]
        readings = zip(moving, self._finder.read(upload, targets, job), strict=True)
        shown = {track: reading for track, reading in readings if reading is not None}
        return _Wanted([], [], shown, unchanged)

    def _followed(
        self, track: Track, window: PersonWindow | JudgedReading, timestamp: float
    ) -> Target:
        """The target of a track at its predicted box."""
        place = Detection(track.place.predict(timestamp), track.confirmation.score)
        # That trust wavers is no reason to read other windows.
        least_trust = _LOST_TRUST if track.trusted else 0.0
        is_new = timestamp - track.drawn_at < DRAWN_EVERY_S
        drawn = track.last.drawn if is_new and not self._draws_all else None
        if timestamp - self._looked_at[track] < LOOK_EVERY_S:
            return Target(place, window, True, least_trust, track.last.seen_keypoints, drawn)
        self._looked_at[track] = timestamp
        return Target(place, window, True, least_trust, drawn=drawn)


class _Wanted(NamedTuple):
    """What is to be read in a frame, and people who are as they were."""

    found: list[Target]  # by a search
    beside: list[Detection]  # perhaps beside them
    followed: Expected  # tracks in their windows
    unchanged: dict[Track, Person]


def _unchanged(frame: Frame, timestamp: float, expected: Expected) -> dict[Track, Person]:
    """The tracked people in whose places nothing has changed, and no other person is expected."""
    places = {track: track.place.predict(timestamp) for track in expected}
    unchanged = {}
    for track, place in places.items():
        alone = not any(place.intersection(places[other]) for other in places if other != track)
        if alone and (person := track.last_estimate.still_holds(frame, timestamp)) is not None:
            unchanged[track] = person
    return unchanged


@dataclass(frozen=True)
class _Followed:
    """The tracks before a frame."""

    tracks: Sequence[Track]
    people: list[Track]  # tracks that are confirmed
    lost: list[Track]  # people missing in the frame before
    recent: list[Track]  # tracks seen a moment ago
    expected: Expected  # their windows

    @classmethod
    def at(cls, timestamp: float, tracks: Sequence[Track], read_at: float) -> _Followed:
        recent = [track for track in tracks if timestamp - track.place.seen_at <= _WINDOW_LASTS_S]
        expected = {one: one.last.next_window for one in recent if one.last.next_window}
        people = [track for track in tracks if track.track_id is not None]
        lost = [track for track in people if track.place.seen_at < read_at]
        return cls(tracks, people, lost, recent, expected)

    @property
    def all_in_windows(self) -> bool:
        """Whether all people are confirmed and have windows."""
        return len(self.expected) == len(self.people) == len(self.tracks) and not self.lost

    @property
    def may_suffice(self) -> bool:
        """Whether the windows may show all people of the scene.

        After a fall, a person who is no longer visible is assumed at the last place and causes no
        search before the next regular one.
        """
        some = self.expected or not self.tracks or any(track.place.lies_at for track in self.tracks)
        return len(self.expected) == len(self.recent) and bool(some)


def _may_be_there(track: Track, frame_shape: tuple[int, ...]) -> bool:
    """Whether an immediate search may find a person who is not in their window.

    It cannot if the person has left the frame, or was hardly visible behind others.
    """
    return not (track.last.beside or may_have_left(track.place.seen, frame_shape))
