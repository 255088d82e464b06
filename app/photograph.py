"""One photograph: decode it, find its people, match each, place the skeletons."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import replace
from functools import partial

import numpy as np

from app.decoding.pictures import Workers
from app.estimation.finder import Models, PeopleFinder
from app.estimation.poses import NormalisedPerson, PlacedSkeletons, place_skeletons
from app.estimation.posture import LANDMARK_GROUPS, EstimatedPosture, as_standing, likeliest_posture
from app.estimation.results import (
    Estimate,
    Evidence,
    Facing,
    Matched,
    Person,
)
from app.estimation.upload import DecodedUpload, Upload, UploadDecoder, check_bodies
from app.networks.dense import shipped_network
from app.networks.shipped import constants_of, file_of
from app.paper import NoNetworks, PaperFinder
from app.scheduling.job import Job
from app.scheduling.process import available_cores
from app.settings import Method, Segmenter, Settings
from app.tracking import actions, falls
from app.vision.blazepose import LandmarkNetwork, MaskNetwork
from app.vision.detector import NetworkDetector, ObjectNetwork
from app.vision.detectors.blazepose import BlazePoseDetector
from app.vision.geometry import Box
from app.vision.images import ImageWarning
from app.vision.judgement import load_photograph_models
from app.vision.movenet import KeypointReader, MoveNet, MoveNetDetector
from app.vision.optics import PinholeCamera
from app.vision.people import Detection
from app.vision.person_reader import PersonReader
from index.artefact import load_index
from index.landmark_matching import match_landmarks, moved_along
from index.matching import DEFAULT_HYPOTHESES, Match, PoseHypothesis
from index.nearest import match_nearest
from index.silhouette_matching import match_silhouette
from index.store import PoseIndex


class MethodError(ValueError):
    """A method cannot be used; the message is one sentence, ``field`` names the faulty choice."""

    def __init__(self, field: str, message: str) -> None:
        super().__init__(message)
        self.field = field


_SEGMENTERS: dict[Method, Segmenter] = {"networks": "network", "paper": "grabcut"}
"""What cuts people out by default."""


class Estimator:
    """Estimates the poses of the people in a frame; immutable and therefore thread-safe.

    Parameters
    ----------
    min_person_px, max_persons
        Those of :class:`app.estimation.finder.PeopleFinder`; an upload that marks more people is
        refused.
    max_pixels : int
        Largest image accepted, width times height.

    Examples
    --------
    >>> from pathlib import Path
    >>> from app import Upload, load_estimator
    >>> estimator = load_estimator()
    >>> walkers = Upload(Path("tests/data/walkers.jpg").read_bytes())
    >>> people = estimator.estimate(walkers).persons
    >>> [round(person.box.x) for person in people]
    [25, 133, 207, 223, 233]
    >>> people[0].hypotheses[0].points_3d.shape  # Metres in the axes of the camera.
    (24, 3)
    >>> estimator.by("paper").segmenter
    'grabcut'
    """

    def __init__(
        self,
        index: PoseIndex,
        models: Models,
        *,
        min_person_px: float | None,
        max_pixels: int,
        max_persons: int,
    ) -> None:
        self.index = index
        self.models = models
        self.method: Method = "networks"
        self.segmenter: Segmenter = "network"
        self._decoder = UploadDecoder(max_pixels, max_persons)
        self.finder = PeopleFinder(models, min_person_px, max_persons)
        self._base = self
        self._variants = self._all_variants()

    def with_index(self, index: PoseIndex) -> Estimator:
        """Return an estimator with the same models and method, and another index."""
        return self._with(index=index)

    def by(self, method: Method | None = None, segmenter: Segmenter | None = None) -> Estimator:
        """Return the estimator of a method over the same index; by default, of this one's.

        The segmenter is what cuts people out where the caller gives no mask and no background; by
        default the method's own.

        Raises
        ------
        MethodError
            If there is no such method, or it needs networks that were not loaded.
        """
        method = method or self.method
        found = self._variants.get((method, segmenter or _SEGMENTERS[method]))
        if found is not None:
            return found
        if method == "networks" and segmenter == "grabcut":
            raise MethodError("segmenter", "expected network with method=networks, got grabcut")
        field = "method" if method == "networks" else "segmenter"
        raise MethodError(
            field,
            f"expected {'paper' if field == 'method' else 'grabcut'}, since this service has "
            "loaded no network",
        )

    def _all_variants(self) -> dict[tuple[Method, Segmenter], Estimator]:
        variants: dict[tuple[Method, Segmenter], Estimator] = {
            ("paper", "grabcut"): self._by_paper("grabcut")
        }
        if not isinstance(self.models, NoNetworks):
            variants["networks", "network"] = self
            variants["paper", "network"] = self._by_paper("network")
        for one in variants.values():
            one._variants = variants
        return variants

    def _by_paper(self, segmenter: Segmenter) -> Estimator:
        """An estimator by the paper's method; see :mod:`app.paper`."""
        other = copy(self)
        other.method, other.segmenter = "paper", segmenter
        if segmenter == "grabcut":
            other.models = NoNetworks()
        other.finder = PaperFinder(
            index=self.index,
            models=other.models,
            min_person_px=self.finder.min_person_px,
            max_persons=self.finder.max_persons,
            segmenter=segmenter,
        )
        return other

    def with_workers(self, workers: Workers) -> Estimator:
        """Return an estimator with the same models that has expensive images decoded by workers."""
        return self._with(_decoder=replace(self._decoder, workers=workers))

    def _with(self, **changed: object) -> Estimator:
        base = copy(self._base)
        vars(base).update(changed, _base=base)
        return base._all_variants()[self.method, self.segmenter]

    def evidence(self, wanted: Evidence) -> Evidence:
        """What poses are estimated from: as wanted, or silhouettes alone as in the paper."""
        return "silhouette" if self.method == "paper" else wanted

    def estimate(
        self,
        upload: Upload,
        n: int = DEFAULT_HYPOTHESES,
        job: Job | None = None,
        evidence: Evidence = "photograph",
        *,
        shown: bool = False,
    ) -> Estimate:
        """Find the ``n`` likeliest poses of every person; the job is checked between steps.

        Of people whom the service finds, those with the highest scores come first. As the job's
        deadline comes near, the others are left out, with the warning ``crowded``.

        The evidence ``photograph`` is silhouettes and the landmarks in the photograph,
        ``silhouette`` silhouettes alone, as in the paper. ``shown`` is whether the frame is needed
        after that, to draw on it.

        Raises
        ------
        UploadError
            If the images or boxes cannot be used.
        """
        job = job or Job()
        evidence = self.evidence(evidence)
        unseen = upload.mask is not None and evidence == "silhouette" and not shown
        job.some_suffice = upload.mask is None and upload.boxes is None
        decoded = self.decode(upload, job, blank=unseen)
        people = self.finder.find(decoded, evidence, job)
        fitted = self.fit(people, decoded.camera, n, job)
        return _answer(decoded, [person for person in fitted if person is not None], job)

    def find_people(self, upload: Upload, job: Job, evidence: Evidence = "photograph") -> Estimate:
        """Find the people of a frame without their poses; raises like :meth:`estimate`."""
        decoded = self.decode(upload, job)
        return _answer(decoded, self.finder.find(decoded, evidence, job), job)

    def decode(
        self,
        upload: Upload,
        job: Job,
        *,
        blank: bool = False,
        half_of: tuple[int, ...] | None = None,
    ) -> DecodedUpload:
        """Decode the images of an upload, as :meth:`UploadDecoder.decode` does.

        With ``half_of``, the shape of a frame of which half the size suffices, that if possible.
        """
        job.checkpoint()
        with job.stage("decode"):
            half = half_of and DecodedUpload.halved(upload, half_of, job.checkpoint)
            decoded = half or self._decoder.decode(upload, job, blank=blank)
        job.checkpoint()
        if decoded.mask is not None:
            check_bodies(decoded.mask, self.index)
        return decoded

    def fit(
        self,
        people: Sequence[Person],
        camera: PinholeCamera,
        n: int,
        job: Job,
    ) -> list[Person | None]:
        """Find the ``n`` likeliest distinct poses of people; none without a silhouette.

        None stands for people left out.
        """
        with job.stage("describe"):
            normalised = job.map(normalise_person, people)

        match = match_nearest if self.method == "paper" else match_silhouette

        def fitted(pair: tuple[Person, NormalisedPerson | None]) -> Person:
            return fit_poses(self.index, *pair, camera, n, match)

        with job.stage("search"):
            # The answer has to be written as well.
            return job.map_until(0.9, fitted, zip(people, normalised, strict=True))


def _answer(decoded: DecodedUpload, people: Sequence[Person], job: Job) -> Estimate:
    from_left = sorted(people, key=lambda person: person.box.x)
    crowded: tuple[ImageWarning, ...] = ("crowded",) if job.left_out else ()
    return Estimate(
        frame=decoded.sent,
        camera=decoded.rectification.camera_sent(decoded.camera),
        warnings=tuple(sorted((*decoded.warnings, *crowded))),
        persons=tuple(job.map(lambda one: one.as_sent(decoded.rectification), from_left)),
        timings_ms=job.timings_ms(),
    )


def normalise_person(person: Person) -> NormalisedPerson | None:
    if person.moved_along and person.matched is not None:
        return replace(person.matched.normalised, landmarks=person.landmarks)
    if person.silhouette is None:
        return None
    return NormalisedPerson.of(person.silhouette, person.landmarks)


def fit_poses(
    index: PoseIndex,
    person: Person,
    normalised: NormalisedPerson | None,
    camera: PinholeCamera,
    n: int,
    match: Callable[..., Match] = match_silhouette,
) -> Person:
    """Find the ``n`` likeliest distinct poses of a person; none without a normalised silhouette.

    See :meth:`Estimator.fit`. ``match`` is what finds them from a silhouette alone.
    """
    if normalised is None:
        return person
    landmarks, roll_deg = normalised.normalised_landmarks(), normalised.roll_deg
    if landmarks is None:
        found = match(index, normalised.silhouette, n, roll_deg=roll_deg)
    elif person.moved_along and person.matched is not None:
        found = moved_along(person.matched.found, landmarks, roll_deg)
    else:
        right = 0.5 if person.trust is None else person.trust.right
        found = match_landmarks(
            index, normalised.silhouette, n, landmarks, roll_deg=roll_deg, reliability=right
        )
        person = replace(person, matched=Matched(normalised, found))
    chosen = found.hypotheses[:n]
    placed = place_skeletons(
        np.array([one.points_3d for one in chosen]),
        normalised.points_in_frame(np.array([one.points_2d for one in chosen])),
        None if landmarks is None else person.landmarks,
        camera,
    )
    return replace(
        person,
        hips=placed.pelvis[0],
        facing=Facing(found.front_probability, "none" if landmarks is None else "image"),
        posture=_posture(person, found, feet_visible=normalised.feet_visible),
        hypotheses=_placed(person, chosen, placed),
    )


def _posture(person: Person, found: Match, *, feet_visible: bool) -> EstimatedPosture:
    shares = found.postures
    if not feet_visible:  # Nothing shows whether a person upright walks.
        shares = as_standing(shares)
    if person.frame_posture is not None:
        shares = LANDMARK_GROUPS.split(person.frame_posture.probabilities, shares)
    best = max(one.confidence for one in found.hypotheses)
    return likeliest_posture(shares, person.presence, person.presence * best)


def _placed(
    person: Person, chosen: Sequence[PoseHypothesis], placed: PlacedSkeletons
) -> tuple[PoseHypothesis, ...]:
    """The hypotheses at their places; no confidence exceeds that of the person."""
    return tuple(
        replace(
            one,
            confidence=person.presence * one.confidence,
            points_3d=placed.points_3d[row],
            points_2d=placed.points_2d[row],
        )
        for row, one in enumerate(chosen)
    )


def network_threads(cores: int, concurrency: int) -> tuple[int, int]:
    """Threads of a pass over a whole frame, and copies of the network, that share the cores.

    Examples
    --------
    >>> network_threads(cores=8, concurrency=8)
    (2, 4)
    """
    # They share a pass over a whole frame with little loss; more do not.
    threads = min(2, cores)
    return threads, max(1, min(concurrency, cores // threads))


def load_estimator(
    settings: Settings | None = None, read_index: Callable[[], PoseIndex] | None = None
) -> Estimator:
    """Load the networks and the index, by default from the folder in the settings.

    With the method ``paper`` in the settings, no network is loaded.

    Without settings, those of the environment apply, as for the service.

    Raises
    ------
    ArtefactError
        If the index cannot be used.
    NetworkError
        If a network file shipped with the package is missing or has been modified.

    Examples
    --------
    >>> from app import Settings, load_estimator
    >>> load_estimator(Settings(method="paper")).method
    'paper'
    """
    settings = settings or Settings()
    estimator_of = partial(
        Estimator,
        min_person_px=settings.min_person_px,
        max_pixels=settings.max_pixels,
        max_persons=settings.max_persons,
    )
    if settings.method == "paper":
        plain = partial(load_index, settings.index, reranked=False, in_bytes=False)
        index = read_index() if read_index else plain()
        match_nearest(index, index.silhouette(0), 1)
        return estimator_of(index, NoNetworks()).by("paper")
    with ThreadPoolExecutor(1) as pool:  # The networks get ready while the index is read.
        models = pool.submit(load_models, settings.concurrency)
        index = read_index() if read_index else load_index(settings.index)
    match_silhouette(index, index.silhouette(0), 1)  # The first search is slow.
    return estimator_of(index, models.result())


def load_models(concurrency: int) -> Models:
    """Load all that was learned: what finds, reads, judges and follows people.

    Nothing is left to be read when the first frames come. Networks run once, because the first run
    is slow. The ``concurrency`` of frames processed at once share the cores.

    Raises
    ------
    NetworkError
        If a file shipped with the package is missing or has been modified.
    """
    cores = available_cores()
    threads, copies = network_threads(cores, concurrency)
    share = {"threads": threads, "copies": copies}
    # A second thread would wait for the first, and take a tenth more in all, in small networks.
    alone = {"threads": 1, "copies": min(concurrency, cores)}
    movenet, small_movenet = (
        MoveNet(file_of("movenet"), **share),
        MoveNet(file_of("movenet"), **alone),
    )
    landmarks = LandmarkNetwork(file_of("pose_landmarks"), **alone)
    masks = MaskNetwork(file_of("pose_mask"), **alone)
    judgement = load_photograph_models()
    reader = PersonReader(landmarks, masks, KeypointReader(small_movenet), judgement)
    pose_detection = BlazePoseDetector(file_of("pose_detection"), **share)
    objects = ObjectNetwork(file_of("objects"), **share)
    detectors = MoveNetDetector(movenet, small_movenet), pose_detection
    detector = NetworkDetector(detectors, landmarks, objects)
    frame = np.full((240, 320, 3), 127, np.uint8)
    box = Box(120.0, 40.0, 60.0, 160.0)
    detector.detect(frame)
    detector.object_log_odds(frame, Detection(box, 0.5))
    reader.read(frame, PinholeCamera.of_frame(frame.shape), Detection(box, 0.5))
    # Kept where they are used: a track needs no estimator.
    falls.shipped_models()
    actions.shipped_model()
    for name in ("identity", "elevation"):
        shipped_network(name)
    for part in ("detection", "objects"):
        constants_of(part)
    return Models(detector, reader, judgement)
