"""Finds the people of a camera's frame: tracked people in their windows, new people by a search.

Landmarks of tracked people are read on every frame, in the windows that their last landmarks point
to. Now and then, and if a track's window no longer shows anybody, the whole frame is searched, to
find new people and to check the tracks: MoveNet, which needs no window, finds people whose windows
have drifted off.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.estimation.finder import PeopleFinder, distinct_bodies
from app.estimation.upload import DecodedUpload
from app.scheduling.job import Job
from app.tracking.track import Sighting, Track
from app.vision.blazepose import PoseReading
from app.vision.geometry import Box, PersonWindow
from app.vision.people import Detection
from app.vision.person_reader import fuse, sides_exchanged
from app.vision.silhouettes import ends_at_border, silhouettes_of

SEARCH_EVERY_S = 0.4
"""Time between two searches of the whole frame."""

# A track's window is read for this long after a sighting.
WINDOW_LASTS_S = 0.5
# A window has lost its person if the landmark network's presence is below the first number, or if
# the next window would be farther away than the second, as a share of the window's side.
MIN_PRESENCE, MAX_DRIFT = 0.5, 0.35
# Size of a body from which MoveNet also reads keypoints in a track's window. That takes as long as
# the reading itself; poses of smaller people are averaged over more frames instead.
MOVENET_FROM_PX = 200.0
# Margin around a body's landmarks, as a share of their box.
BODY_MARGIN = 0.1
# Overlap of a detection with the predicted box of its track.
MIN_TRACK_IOU = 0.3


@dataclass(frozen=True)
class _Target:
    """A person to read: a detection, or a track whose person no detection shows."""

    detection: Detection  # For a track, it has the predicted box.
    track: Track | None  # None for a detection.
    window: PersonWindow | None  # Window of the track, even if a detection shows its person.
    tracked: PoseReading | None = None  # Reading in that window, if it has been read already.


class TrackedPeopleDetector:
    """Finds people frame by frame; one frame at a time.

    Parameters
    ----------
    finder : PeopleFinder
        Its models are used.
    """

    def __init__(self, finder: PeopleFinder) -> None:
        self._finder = finder
        self._searched_at = self._read_at = -math.inf

    def find(
        self,
        upload: DecodedUpload,
        timestamp: float,
        tracks: Sequence[Track],
        job: Job,
    ) -> list[Sighting]:
        """Find the people of a frame with their silhouettes and landmarks.

        Parameters
        ----------
        upload : DecodedUpload
            Of the frame.
        timestamp : float
            Seconds.
        tracks : sequence of Track
            All tracks of the session.
        job : Job
            Charged with the time of each stage.

        Returns
        -------
        list of Sighting
            Each has the track in whose window the person was read, or None after a search.
        """
        frame = upload.frame
        read = self._read_people(frame, timestamp, tracks, job)
        self._read_at = timestamp
        found = _distinct([(target, reading) for target, reading in read if reading is not None])
        boxes = [
            target.detection.box if target.track is None else self._body_box(reading)
            for target, reading in found
        ]
        with job.stage("segment"):
            readings = [reading for _, reading in found]
            silhouettes = silhouettes_of(
                readings, boxes, frame.shape, exact=False, checkpoint=job.checkpoint
            )
        sightings = []
        for (target, reading), box, silhouette in zip(found, boxes, silhouettes, strict=True):
            if silhouette is None:
                continue
            score = target.track.score if target.track else target.detection.score
            # A detector's box may include more than the person's body.
            place = silhouette.box if reading.presence >= MIN_PRESENCE else box
            person = self._finder.make_observation(
                frame, upload.camera, place, "detector", score, silhouette, reading
            )
            sightings.append(Sighting(person, track=target.track))
        return sightings

    def _read_people(
        self, frame: NDArray[np.uint8], timestamp: float, tracks: Sequence[Track], job: Job
    ) -> list[tuple[_Target, PoseReading | None]]:
        """Read the tracks in their windows or, if that is not enough, all people found by a search.

        The search uses a lower threshold near people who have been lost, until their tracks end. A
        lost track that was not confirmed, or whose person has left the frame, does not cause a
        search before the next one is due.
        """
        recent = [track for track in tracks if timestamp - track.seen_at <= WINDOW_LASTS_S]
        with_window = [
            (track, track.box_filter.predict(timestamp)) for track in recent if track.next_window
        ]
        people = [track for track in tracks if track.track_id is not None]
        lost = [track for track in people if track.seen_at < self._read_at]
        due = timestamp - self._searched_at >= SEARCH_EVERY_S
        shown: dict[Track | None, PoseReading] = {}
        if with_window and len(with_window) == len(recent) and not due:
            read = self._read_all(frame, self._targets((), with_window, shown), job)
            shown = {target.track: reading for target, reading in read if reading is not None}
            newly_lost = [track for track in people if track in recent and track not in shown]
            if all(ends_at_border(track.box_filter.seen, frame.shape) for track in newly_lost):
                return read
            lost += [track for track in newly_lost if track not in lost]
            with_window = [(track, box) for track, box in with_window if track in shown]
        with job.stage("detect"):
            places = [track.box_filter.seen for track in lost]
            found = self._finder.models.detector.detect(frame, places)[: self._finder.max_persons]
        self._searched_at = timestamp
        return self._read_all(frame, self._targets(found, with_window, shown), job)

    def _targets(
        self,
        detections: Iterable[Detection],
        with_window: Iterable[tuple[Track, Box]],
        shown: Mapping[Track | None, PoseReading],
    ) -> list[_Target]:
        """Detections, with the windows of the tracks that they show, then all other tracks.

        ``shown`` are the readings in windows that have been read already.
        """
        targets: list[_Target] = []
        unseen = dict(with_window)
        for detection in detections:
            overlap = {track: box.iou(detection.box) for track, box in unseen.items()}
            track = max(overlap, key=lambda one: overlap[one], default=None)
            if track is None or overlap[track] < MIN_TRACK_IOU:
                targets.append(_Target(detection, None, None))
            else:
                del unseen[track]
                targets.append(_Target(detection, None, track.next_window, shown.get(track)))
        for track, box in unseen.items():
            alone = Detection(box, 0.0)
            targets.append(_Target(alone, track, track.next_window, shown.get(track)))
        return targets

    def _read_all(
        self, frame: NDArray[np.uint8], targets: Sequence[_Target], job: Job
    ) -> list[tuple[_Target, PoseReading | None]]:
        job.checkpoint()
        with job.stage("keypoints"):
            readings = job.map(lambda target: self._read(frame, target), targets)
        return list(zip(targets, readings, strict=True))

    def _read(self, frame: NDArray[np.uint8], target: _Target) -> PoseReading | None:
        """Read a person; None where a track's window no longer shows anybody."""
        detection, reader, reading = target.detection, self._finder.models.reader, target.tracked
        if reading is None and target.window is not None:
            reading = reader.network.read(frame, target.window)
        if target.track is None or reading is None:
            return reader.read(
                frame, detection.box, detection.keypoints, detection.windows, reading
            )
        if reading is target.tracked:
            return reading
        if reading.presence < MIN_PRESENCE or reading.drift > MAX_DRIFT:
            return None
        if reading.body_px < MOVENET_FROM_PX:
            return reading
        box = reading.landmarks.box()
        keypoints = reader.keypoint_reader.read(frame, box)
        if keypoints is None:
            return reading
        if sides_exchanged(reading, keypoints):
            # The track's window may have led the network astray.
            return reader.read(frame, box, keypoints)
        return fuse(reading, keypoints)

    def _body_box(self, reading: PoseReading) -> Box:
        """The box about a body; its landmarks do not reach to the crown, fingers and toes."""
        box = reading.landmarks.box()
        margin = BODY_MARGIN * max(box.width, box.height)
        return Box(box.x - margin, box.y - margin, box.width + 2 * margin, box.height + 2 * margin)


def _distinct(found: Sequence[tuple[_Target, PoseReading]]) -> list[tuple[_Target, PoseReading]]:
    """One reading of each body, in their order: a detection's rather than a track's.

    Of two tracks, the one whose predicted box is nearer to the body is kept.
    """

    def rank(row: int) -> tuple[float, float]:
        target, reading = found[row]
        return -target.detection.score, -target.detection.box.iou(reading.landmarks.box())

    order = sorted(range(len(found)), key=rank)
    kept = distinct_bodies([found[row][1] for row in order])
    return [found[row] for row in sorted(order[i] for i in kept)]
