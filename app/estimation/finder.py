"""Finds the people of a frame: boxes, silhouettes and landmarks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.estimation.results import Evidence, Person, Source
from app.estimation.upload import DecodedUpload
from app.scheduling.job import Job
from app.vision.background import BackgroundSegmenter
from app.vision.blazepose import PoseReading
from app.vision.detector import NetworkDetector, smallest_person_px
from app.vision.geometry import Box
from app.vision.images import LabelImage
from app.vision.judgement import PhotographModels
from app.vision.optics import PinholeCamera
from app.vision.people import Detection, Silhouette
from app.vision.person_reader import PersonReader, attenuate_visibility_at_border
from app.vision.silhouettes import end_beyond_border, silhouettes_from_labels, silhouettes_of


@dataclass(frozen=True)
class Models:
    """What people are found, read and judged with."""

    detector: NetworkDetector
    reader: PersonReader
    judgement: PhotographModels


@dataclass(frozen=True)
class PeopleFinder:
    """Finds people with the detector, or where the caller marks them.

    Parameters
    ----------
    min_person_px : float or None
        Height of the smallest person to find with a background, pixels.
    max_persons : int
        Largest number of people; further detections are dropped, those with the lowest scores
        first.
    """

    models: Models
    min_person_px: float | None
    max_persons: int

    def find(self, upload: DecodedUpload, evidence: Evidence, job: Job) -> list[Person]:
        """Find the people of a frame with their silhouettes, in no particular order.

        Parameters
        ----------
        evidence : str
            Whether to return landmarks. They may be read without being returned, because they also
            separate people from the background.
        """
        landmarks = evidence == "photograph" and upload.has_frame
        if upload.mask is not None:
            return self._people_in_mask(upload.mask, upload, landmarks, job)
        background = self._background(upload)
        source, detections = self._detect(upload, background, job)
        people = self._observe(source, detections, upload, background, landmarks, job)
        if source != "boxes":
            # A detection without a silhouette is unlikely to be a person. Detectors cut off
            # foreheads, feet and outstretched arms that the silhouette shows.
            people = [
                replace(person, box=person.box.joined(person.silhouette.box))
                for person in people
                if person.silhouette is not None
            ]
        return people if landmarks else [without_landmarks(person) for person in people]

    def read(
        self, frame: NDArray[np.uint8], found: Sequence[Detection], job: Job
    ) -> list[PoseReading]:
        """Read the landmarks and the body mask of each person of a frame."""
        return job.map(
            lambda one: self.models.reader.read(frame, one.box, one.keypoints, one.windows), found
        )

    def _background(self, upload: DecodedUpload) -> BackgroundSegmenter | None:
        if upload.background is None:
            return None
        smallest = smallest_person_px(upload.frame.shape, self.min_person_px)
        return BackgroundSegmenter(upload.background, min_person_px=smallest)

    def _detect(
        self, upload: DecodedUpload, background: BackgroundSegmenter | None, job: Job
    ) -> tuple[Source, Sequence[Detection]]:
        """Boxes of people, and how they were found."""
        if upload.boxes is not None:
            return "boxes", [Detection(box, 1.0) for box in upload.boxes]
        with job.stage("detect"):
            found = (background or self.models.detector).detect(upload.frame)
        job.checkpoint()
        return "background" if background else "detector", found[: self.max_persons]

    def _observe(
        self,
        source: Source,
        found: Sequence[Detection],
        upload: DecodedUpload,
        background: BackgroundSegmenter | None,
        landmarks: bool,
        job: Job,
    ) -> list[Person]:
        """Read detections, drop repeated ones of the same body, and cut out the silhouettes."""
        frame = upload.frame
        readings: list[PoseReading] = []
        if landmarks or background is None:
            with job.stage("keypoints"):
                readings = self.read(frame, found, job)
            if source != "boxes":
                kept = distinct_bodies(readings)
                found, readings = [found[i] for i in kept], [readings[i] for i in kept]
        boxes = [one.box for one in found]
        with job.stage("segment"):
            silhouettes = (
                silhouettes_of(
                    readings,
                    boxes,
                    frame.shape,
                    exact=source == "boxes",
                    checkpoint=job.checkpoint,
                )
                if background is None
                else background.segment(frame, boxes, job.checkpoint)
            )
        shown: Sequence[PoseReading | None] = readings or [None] * len(found)
        return [
            self.make_observation(
                frame,
                upload.camera,
                one.box,
                source,
                None if source == "boxes" else one.score,
                silhouette,
                reading,
            )
            for one, silhouette, reading in zip(found, silhouettes, shown, strict=True)
        ]

    def _people_in_mask(
        self, mask: LabelImage, upload: DecodedUpload, landmarks: bool, job: Job
    ) -> list[Person]:
        with job.stage("segment"):
            silhouettes = silhouettes_from_labels(mask)
        if not landmarks:
            return [Person(one.box, "mask", None, one) for one in silhouettes]
        with job.stage("keypoints"):
            marked = [Detection(one.box, 1.0) for one in silhouettes]
            readings = self.read(upload.frame, marked, job)
        return [
            self.make_observation(upload.frame, upload.camera, one.box, "mask", None, one, reading)
            for one, reading in zip(silhouettes, readings, strict=True)
        ]

    def make_observation(
        self,
        frame: NDArray[np.uint8],
        camera: PinholeCamera,
        box: Box,
        source: Source,
        score: float | None,
        silhouette: Silhouette | None,
        reading: PoseReading | None,
    ) -> Person:
        """Combine what is known about a person; landmarks may show that the body is truncated."""
        if reading is None:
            return Person(box, source, score, silhouette)
        landmarks = attenuate_visibility_at_border(reading, frame.shape)
        if silhouette is not None and end_beyond_border(box, landmarks, frame.shape):
            silhouette = replace(silhouette, truncated=True)
        seen = Person(
            box, source, score, silhouette, landmarks, reading.presence, reading.next_window
        )
        if reading.network_pass is None:
            return seen
        judged = self.models.judgement.judge(reading, camera)
        body = judged.body
        metres = body.along_sight(camera, landmarks)
        return replace(
            seen,
            landmarks=replace(landmarks, metres=metres, depth_sd=body.depth_sd),
            frame_posture=judged.posture,
            trust=judged.trust,
        )


def without_landmarks(person: Person) -> Person:
    """A person without landmarks and what is judged from them."""
    return replace(person, landmarks=None, frame_posture=None, trust=None)


DUPLICATE_BODY_DISTANCE = 0.12
"""Mean distance between landmarks, in sizes of the body, below which two readings show the same
person."""


def distinct_bodies(readings: Sequence[PoseReading]) -> list[int]:
    """Rows of readings that do not show the same body as an earlier one."""
    kept: list[int] = []
    for row, reading in enumerate(readings):
        if all(_apart(reading, readings[other]) >= DUPLICATE_BODY_DISTANCE for other in kept):
            kept.append(row)
    return kept


def _apart(first: PoseReading, second: PoseReading) -> float:
    """Mean distance between the landmarks of two readings, in sizes of the smaller body."""
    offsets = first.landmarks.positions - second.landmarks.positions
    weights = first.landmarks.visibility * second.landmarks.visibility + 1e-3
    distance = float(weights @ np.linalg.norm(offsets, axis=1) / weights.sum())
    return distance / min(first.body_px, second.body_px)
