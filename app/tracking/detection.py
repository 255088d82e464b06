"""Finds the people of a camera's frame: each track by its own window, newcomers by a search.

Everybody who is tracked is read on every frame, in the window that their last landmarks point to.
Every so often, and where a track's window no longer shows anybody, the whole frame is searched, for
newcomers and to check the tracks: MoveNet, which needs no window, says where one has gone astray.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from app.estimation.finder import PeopleFinder, distinct_bodies, make_observation
from app.estimation.results import ObservedPerson
from app.scheduling.job import Job
from app.tracking.track import LEAST_PRESENCE, Track
from app.vision.blazepose import Reading
from app.vision.geometry import Box, Detection
from app.vision.person_reader import fuse
from app.vision.silhouettes import silhouettes_of

SEARCH_EVERY_S = 0.4
"""Time between two searches of the whole frame."""

FOLLOWED_FOR_S = 0.5
"""How long after it was read a track's window still says where the person is."""

MOST_DRIFT = 0.35
"""How far a window may be from the next: one that drifts farther has lost the body."""

PLACED_FROM_PX = 200.0
"""Size of a body from which MoveNet's keypoints place joints in a track's window too. It takes as
long as the reading; smaller people's poses are averaged over more frames in its stead."""

BODY_ROOM = 0.1
"""Room about the landmarks in which a body is cut out, as a share of their box."""

SAME_PERSON = 0.3
"""Overlap (IoU) of a detection with the place expected of a track, from which it is the track's."""


class TrackedPeopleDetector:
    """Finds people frame by frame; one frame at a time.

    Parameters
    ----------
    finder : PeopleFinder
    """

    def __init__(self, finder: PeopleFinder) -> None:
        self._finder = finder
        self._searched_at = self._read_at = -math.inf

    def find(
        self,
        frame: NDArray[np.uint8],
        timestamp: float,
        tracks: Sequence[Track],
        job: Job,
    ) -> list[tuple[ObservedPerson, Track | None]]:
        """Find the people of a frame with their silhouettes and landmarks.

        Parameters
        ----------
        frame : (H, W, 3) uint8 array
            BGR.
        timestamp : float
            Seconds.
        tracks : sequence of Track
        job : Job

        Returns
        -------
        list of (ObservedPerson, Track or None)
            The track in whose window the person was read, None where the search found them.
        """
        wanted, owners, readings = self._read_people(frame, timestamp, tracks, job)
        self._read_at = timestamp
        found, rows = _distinct(readings, wanted)
        boxes = [
            _body_box(found[i]) if wanted[row].score == 0 else wanted[row].box
            for i, row in enumerate(rows)
        ]
        with job.stage("segment"):
            silhouettes = silhouettes_of(found, boxes, frame.shape, exact=False)
        people = []
        for row, box, reading, silhouette in zip(rows, boxes, found, silhouettes, strict=True):
            if silhouette is None:
                continue
            owner = owners[row]
            score = owner.score if owner else wanted[row].score
            # A detector's box may hold more than the body that is read in it.
            place = silhouette.box if reading.presence >= LEAST_PRESENCE else box
            person = make_observation(frame, place, "detector", score, silhouette, reading)
            people.append((person, owner))
        return people

    def _read_people(
        self,
        frame: NDArray[np.uint8],
        timestamp: float,
        tracks: Sequence[Track],
        job: Job,
    ) -> tuple[list[Detection], list[Track | None], list[Reading | None]]:
        """Read the tracks by their windows or, where that does not do, whoever a search finds.

        Who was lost at the frame before, or is lost at this one, is believed more easily.
        """
        recent = [track for track in tracks if timestamp - track.seen_at <= FOLLOWED_FOR_S]
        followed = [
            (track, track.motion.predict(timestamp)) for track in recent if track.next_window
        ]
        lost = [track for track in tracks if track.seen_at < self._read_at]
        due = timestamp - self._searched_at >= SEARCH_EVERY_S
        if followed and len(followed) == len(recent) and not due:
            wanted, owners = _assign((), followed)
            readings = self._read_all(frame, wanted, owners, job)
            if None not in readings:
                return wanted, owners, readings
            lost += [
                owner
                for owner, reading in zip(owners, readings, strict=True)
                if reading is None and owner is not None and owner not in lost
            ]
        with job.stage("detect"):
            places = [track.motion.seen for track in lost]
            detections = self._finder.detector.detect(frame, places)[: self._finder.max_persons]
        self._searched_at = timestamp
        wanted, owners = _assign(detections, followed)
        return wanted, owners, self._read_all(frame, wanted, owners, job)

    def _read_all(
        self,
        frame: NDArray[np.uint8],
        wanted: Sequence[Detection],
        owners: Sequence[Track | None],
        job: Job,
    ) -> list[Reading | None]:
        job.checkpoint()
        with job.stage("keypoints"):
            return job.map(lambda pair: self._read(frame, *pair), zip(wanted, owners, strict=True))

    def _read(
        self, frame: NDArray[np.uint8], one: Detection, owner: Track | None
    ) -> Reading | None:
        """Read a person; None where a track's window no longer shows anybody."""
        if one.score > 0 or owner is None:
            return self._finder.reader.read(frame, one.box, one.keypoints, one.windows)
        reading = self._finder.reader.network.read(frame, one.windows[0])
        if reading.presence < LEAST_PRESENCE or reading.drift > MOST_DRIFT:
            return None
        if reading.body_px < PLACED_FROM_PX:
            return reading
        keypoints = self._finder.reader.keypoint_reader.read(frame, reading.landmarks.box())
        return reading if keypoints is None else fuse(reading, keypoints)


def _body_box(reading: Reading) -> Box:
    """The box about a body, whose landmarks end short of the crown, hands and feet."""
    box = reading.landmarks.box()
    room = BODY_ROOM * max(box.width, box.height)
    return Box(box.x - room, box.y - room, box.width + 2 * room, box.height + 2 * room)


def _distinct(
    readings: Sequence[Reading | None], wanted: Sequence[Detection]
) -> tuple[list[Reading], list[int]]:
    """Readings of different bodies, and their rows.

    Of two in the windows of tracks, that is kept whose track is expected nearer to the body.
    """
    rows = [row for row, one in enumerate(readings) if one is not None]
    found = [one for one in readings if one is not None]
    order = sorted(
        range(len(rows)),
        key=lambda i: (-wanted[rows[i]].score, -wanted[rows[i]].box.iou(found[i].landmarks.box())),
    )
    kept = sorted(order[i] for i in distinct_bodies([found[i] for i in order]))
    return [found[i] for i in kept], [rows[i] for i in kept]


def _assign(
    detections: Sequence[Detection], followed: Sequence[tuple[Track, Box]]
) -> tuple[list[Detection], list[Track | None]]:
    """Who is read: detections, with the windows of the tracks they are about, and other tracks.

    A track that no detection is about has a score of 0.
    """
    wanted: list[Detection] = []
    owners: list[Track | None] = []
    free = list(followed)
    for one in detections:
        about = max(free, key=lambda pair: pair[1].iou(one.box), default=None)
        if about is not None and about[1].iou(one.box) >= SAME_PERSON:
            free.remove(about)
            window = about[0].next_window
            assert window is not None
            one = Detection(one.box, one.score, one.keypoints, (*one.windows, window))
        wanted.append(one)
        owners.append(None)
    for track, box in free:
        assert track.next_window is not None
        wanted.append(Detection(box, 0.0, None, (track.next_window,)))
        owners.append(track)
    return wanted, owners
