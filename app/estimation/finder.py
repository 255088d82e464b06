"""Finds the people of a frame: boxes, and in one pass each their silhouettes and landmarks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.estimation.results import ObservedPerson, Source
from app.estimation.upload import DecodedUpload
from app.scheduling.job import Job
from app.vision.background import BackgroundSegmenter
from app.vision.blazepose import PoseReading
from app.vision.detector import Detector, smallest_person_px
from app.vision.geometry import Box
from app.vision.images import LabelImage
from app.vision.people import Detection, Silhouette
from app.vision.person_reader import PersonReader, attenuate_visibility_at_border
from app.vision.silhouettes import silhouettes_from_labels, silhouettes_of
from app.vision.truncation import end_beyond_border

SAME_BODY = 0.12
"""Mean distance of landmarks, in sizes of the body, below which two readings are of one person."""


@dataclass(frozen=True)
class PeopleFinder:
    """Finds people by detection, or where the caller says they are.

    Parameters
    ----------
    detector : Detector
    reader : PersonReader
    min_person_px : float or None
        Height of the smallest person wanted, where a background is given.
    max_persons : int
        Detections beyond are dropped, the least sure first.
    """

    detector: Detector
    reader: PersonReader
    min_person_px: float | None
    max_persons: int

    def find(self, upload: DecodedUpload, reads: bool, job: Job) -> list[ObservedPerson]:
        """Find the people of a frame with their silhouettes, in no particular order.

        Parameters
        ----------
        upload : DecodedUpload
        reads : bool
            Whether landmarks count, else the silhouettes alone.
        job : Job
        """
        frame = upload.frame
        background = upload.background is not None and BackgroundSegmenter(
            upload.background, min_person_px=smallest_person_px(frame.shape, self.min_person_px)
        )
        if upload.mask is not None:
            people = self._in_mask(upload.mask, frame, reads, job)
        elif upload.boxes is not None:
            found = [Detection(box, 1.0) for box in upload.boxes]
            people = self._read("boxes", found, frame, background or None, reads, job)
            people = [replace(person, detection_score=None) for person in people]
        else:
            with job.stage("detect"):
                detections = (background or self.detector).detect(frame)[: self.max_persons]
            job.checkpoint()
            source: Source = "background" if background else "detector"
            people = self._read(source, detections, frame, background or None, reads, job)
            # A detection without a silhouette was hardly a person.
            people = [person for person in people if person.silhouette is not None]
        if reads:
            return people
        return [replace(person, landmarks=None) for person in people]

    def detect(self, frame: NDArray[np.uint8]) -> tuple[ObservedPerson, ...]:
        """Find people by their boxes alone, the surest first."""
        return tuple(
            ObservedPerson(found.box, "detector", found.score, None)
            for found in self.detector.detect(frame)[: self.max_persons]
        )

    def read(
        self, frame: NDArray[np.uint8], found: Sequence[Detection], job: Job
    ) -> list[PoseReading]:
        """Read each person of a frame."""
        return job.map(
            lambda one: self.reader.read(frame, one.box, one.keypoints, one.windows), found
        )

    def _read(
        self,
        source: Source,
        found: Sequence[Detection],
        frame: NDArray[np.uint8],
        background: BackgroundSegmenter | None,
        reads: bool,
        job: Job,
    ) -> list[ObservedPerson]:
        boxes = [one.box for one in found]
        readings: Sequence[PoseReading | None] = [None] * len(found)
        if reads or background is None:
            with job.stage("keypoints"):
                read = self.read(frame, found, job)
            if source != "boxes":
                kept = distinct_bodies(read)
                found, read = [found[i] for i in kept], [read[i] for i in kept]
                boxes = [boxes[i] for i in kept]
            readings = read
        with job.stage("segment"):
            silhouettes = (
                silhouettes_of(read, boxes, frame.shape, exact=source == "boxes")
                if background is None
                else background.segment(frame, boxes)
            )
        return [
            observed(frame, one.box, source, one.score, silhouette, reading)
            for one, silhouette, reading in zip(found, silhouettes, readings, strict=True)
        ]

    def _in_mask(
        self,
        mask: LabelImage,
        frame: NDArray[np.uint8],
        reads: bool,
        job: Job,
    ) -> list[ObservedPerson]:
        with job.stage("segment"):
            silhouettes = silhouettes_from_labels(mask)
        if not reads:
            return [ObservedPerson(one.box, "mask", None, one) for one in silhouettes]
        with job.stage("keypoints"):
            readings = self.read(frame, [Detection(one.box, 1.0) for one in silhouettes], job)
        return [
            observed(frame, one.box, "mask", None, one, reading)
            for one, reading in zip(silhouettes, readings, strict=True)
        ]


def observed(
    frame: NDArray[np.uint8],
    box: Box,
    source: Source,
    score: float | None,
    silhouette: Silhouette | None,
    reading: PoseReading | None,
) -> ObservedPerson:
    """What is seen of a person; landmarks show truncation that the silhouette may not show."""
    if reading is None:
        return ObservedPerson(box, source, score, silhouette)
    landmarks = attenuate_visibility_at_border(reading, frame.shape)
    if silhouette is not None and end_beyond_border(box, landmarks.keypoints(), frame.shape):
        silhouette = replace(silhouette, truncated=True)
    return ObservedPerson(
        box, source, score, silhouette, landmarks, reading.presence, reading.next_window
    )


def distinct_bodies(readings: Sequence[PoseReading]) -> list[int]:
    """Rows of readings that are not of the same body as one before them."""
    kept: list[int] = []
    for row, reading in enumerate(readings):
        if all(_apart(reading, readings[other]) >= SAME_BODY for other in kept):
            kept.append(row)
    return kept


def _apart(first: PoseReading, second: PoseReading) -> float:
    """Mean distance between the landmarks of two readings, in sizes of the body."""
    offsets = first.landmarks.positions - second.landmarks.positions
    weights = first.landmarks.visibility * second.landmarks.visibility + 1e-3
    distance = float(weights @ np.linalg.norm(offsets, axis=1) / weights.sum())
    return distance / min(first.body_px, second.body_px)
