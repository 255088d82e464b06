"""The one use case: a frame in, persons with hypotheses out. Knows images, not HTTP."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from pathlib import Path

import numpy as np

from app.estimation.finder import PeopleFinder
from app.estimation.normalise import NormalisedPerson
from app.estimation.ordering import rank_by_keypoints, rank_by_silhouette
from app.estimation.posture import estimate_posture, vote_posture
from app.estimation.results import (
    Estimate,
    Evidence,
    ObservedPerson,
    Person,
    ProjectedHypothesis,
    Scene,
)
from app.estimation.upload import DecodedUpload, Upload, UploadDecoder
from app.scheduling.job import Job
from app.scheduling.process import available_cores
from app.settings import Settings
from app.vision.blazepose import BlazePoseDetector, LandmarkNetwork
from app.vision.detector import Detector, HogDetector, NetworkDetector
from app.vision.geometry import Box
from app.vision.models import network_path
from app.vision.movenet import KeypointReader, MoveNet
from app.vision.person_reader import PersonReader
from index.artefact import load_index
from index.matching import (
    FIRST_HYPOTHESES,
    Hypothesis,
    match,
)
from index.store import Label, PoseIndex

# Two threads share a pass of a network with little loss; more do not.
_NETWORK_THREADS = 2


def network_threads(cores: int, concurrency: int) -> tuple[int, int]:
    """Threads of one pass of a network, and copies of it, that share the cores.

    Examples
    --------
    >>> network_threads(cores=8, concurrency=8)
    (2, 4)
    """
    threads = min(_NETWORK_THREADS, cores)
    return threads, max(1, min(concurrency, cores // threads))


def load_networks(settings: Settings) -> tuple[Detector, PersonReader]:
    """Load what finds people and what reads them.

    Raises
    ------
    NetworkError
        If a network of the package is missing or altered.
    """
    threads, copies = network_threads(available_cores(), settings.concurrency)
    share = {"threads": threads, "copies": copies}
    movenet = MoveNet(network_path("movenet"), threads=threads, copies=copies)
    landmarks = LandmarkNetwork(network_path("pose_landmarks"), **share)
    reader = PersonReader(landmarks, KeypointReader(movenet))
    smallest = settings.min_person_px
    if settings.detector == "hog":
        return HogDetector(min_person_px=smallest), reader
    pose_detection = BlazePoseDetector(network_path("pose_detection"), **share)
    return NetworkDetector(movenet, pose_detection, landmarks, min_person_px=smallest), reader


VOTERS = FIRST_HYPOTHESES
"""Hypotheses that vote for a posture, however many are asked for."""


def normalise_person(person: ObservedPerson) -> NormalisedPerson | None:
    """Normalise a person's silhouette; None where there is none."""
    if person.silhouette is None:
        return None
    return NormalisedPerson.of(person.silhouette, person.landmarks)


def fit_poses(
    index: PoseIndex,
    observed: ObservedPerson,
    normalised: NormalisedPerson | None,
    n: int,
) -> Person:
    """Find the ``n`` nearest distinct poses of a person.

    Parameters
    ----------
    index : PoseIndex
    observed : ObservedPerson
    normalised : NormalisedPerson or None
        The same person; None where there is no silhouette.
    n : int
    """
    if normalised is None:
        return Person(observed, None, None, ())
    keypoints = normalised.keypoints()
    found = match(
        index,
        normalised.silhouette,
        n,
        keypoints,
        roll_deg=normalised.roll_deg,
        whole=normalised.whole,
    )
    matched = found.hypotheses
    # Posture and facing do not depend on how many are asked for.
    most = max(n, VOTERS)
    ranked = (
        rank_by_silhouette(matched, most, VOTERS)
        if keypoints is None
        else rank_by_keypoints(matched, most, found.first_batch)
    )
    presence = 1.0 if observed.presence is None else observed.presence
    confidences = [presence * confidence for confidence in ranked.confidences]
    votes = vote_posture(
        [hypothesis.posture for hypothesis in ranked.hypotheses[:VOTERS]], confidences[:VOTERS]
    )
    points_2d = normalised.points_in_frame(
        np.array([hypothesis.points_normalised for hypothesis in ranked.hypotheses[:n]])
    )
    placed = [
        ProjectedHypothesis(hypothesis, distance, confidence, _label(index, hypothesis), points)
        for hypothesis, distance, confidence, points in zip(
            ranked.hypotheses[:n], ranked.distances[:n], confidences[:n], points_2d, strict=True
        )
    ]
    posture = estimate_posture(votes, observed.landmarks, presence)
    return Person(observed, ranked.facing, posture, tuple(placed))


def _label(index: PoseIndex, hypothesis: Hypothesis) -> Label:
    label = index.label(hypothesis.entry, mirrored=hypothesis.mirrored)
    return replace(label, roll_deg=hypothesis.tilt_deg)


class Estimator:
    """Frames to poses; immutable once loaded, so safe under several threads.

    Parameters
    ----------
    index : PoseIndex
    detector : Detector
    reader : PersonReader
    min_person_px : float or None
        Height of the smallest person wanted, if a background is given.
    max_pixels : int
        Of each image.
    max_persons : int
        Detections beyond are dropped, the least certain first; a caller who gives more people
        is refused.
    """

    def __init__(
        self,
        index: PoseIndex,
        detector: Detector,
        reader: PersonReader,
        *,
        min_person_px: float | None,
        max_pixels: int,
        max_persons: int,
    ) -> None:
        self.index = index
        self.detector = detector
        self._decoder = UploadDecoder(max_pixels, max_persons)
        self.finder = PeopleFinder(detector, reader, min_person_px, max_persons)

    @classmethod
    def load(cls, settings: Settings, index: PoseIndex | None = None) -> Estimator:
        """Load index and networks.

        Parameters
        ----------
        settings : Settings
        index : PoseIndex, optional
            By default loaded from the folder in the settings.

        Raises
        ------
        ArtefactError
            If the index cannot be used.
        NetworkError
            If a network of the package is missing or altered.
        """
        if index is None:
            assert isinstance(settings.index, Path), "an index in Milvus is loaded beforehand"
            index = load_index(settings.index)
        detector, reader = load_networks(settings)
        return cls(
            index,
            detector,
            reader,
            min_person_px=settings.min_person_px,
            max_pixels=settings.max_pixels,
            max_persons=settings.max_persons,
        )

    def with_index(self, index: PoseIndex) -> Estimator:
        """Return an estimator with the same networks and another index."""
        other = copy(self)
        other.index = index
        return other

    def warm_up(self) -> None:
        """Run everything once, since the first run is slow."""
        frame = np.full((240, 320, 3), 127, np.uint8)
        box = Box(120.0, 40.0, 60.0, 160.0)
        self.detector.detect(frame)
        self.finder.reader.read(frame, box)
        match(self.index, self.index.silhouette(0), 1)

    def estimate(
        self, upload: Upload, n: int, job: Job, evidence: Evidence = "photograph"
    ) -> Estimate:
        """Find the ``n`` nearest distinct poses of every person.

        Parameters
        ----------
        upload : Upload
        n : int
        job : Job
            Checked between steps.
        evidence : str
            ``photograph``: silhouettes and the landmarks that it shows; ``silhouette``: the
            silhouettes alone, as in the paper.

        Raises
        ------
        UploadError
            If the images or boxes cannot be used.
        """
        scene = self.find_people(upload, job, evidence)
        persons = self.with_hypotheses(scene, n, job)
        return Estimate(scene.frame, persons, job.timings_ms())

    def find_people(self, upload: Upload, job: Job, evidence: Evidence = "photograph") -> Scene:
        """Find the people of a frame with their silhouettes; raises as :meth:`estimate` does."""
        decoded = self.decode(upload, job)
        reads = evidence == "photograph" and upload.frame is not None
        people = self.finder.find(decoded, reads, job)
        return Scene(decoded.frame, tuple(sorted(people, key=lambda person: person.box.x)))

    def decode(self, upload: Upload, job: Job) -> DecodedUpload:
        """Decode the images of an upload; raises :class:`UploadError`."""
        job.checkpoint()
        with job.stage("decode"):
            decoded = self._decoder.decode(upload, job)
        job.checkpoint()
        return decoded

    def with_hypotheses(self, scene: Scene, n: int, job: Job) -> tuple[Person, ...]:
        """Find the poses that fit people's silhouettes and keypoints."""
        with job.stage("describe"):
            normalised = [normalise_person(person) for person in scene.people]
        with job.stage("search"):
            pairs = zip(scene.people, normalised, strict=True)
            return tuple(job.map(lambda pair: fit_poses(self.index, *pair, n), pairs))

    def detect(self, frame: bytes, job: Job) -> tuple[ObservedPerson, ...]:
        """Find the people of a frame by their boxes alone, the surest first."""
        job.checkpoint()
        pixels = self._decoder.decode_frame(frame)
        job.checkpoint()
        return self.finder.detect(pixels)
