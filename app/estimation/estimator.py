"""The one use case: a frame in, persons with hypotheses out. Knows images, not HTTP."""

from __future__ import annotations

from copy import copy
from pathlib import Path

import numpy as np

from app.estimation.estimates import Estimate, Evidence, ObservedPerson, Person, Scene
from app.estimation.finder import Check, PeopleFinder
from app.estimation.hypotheses import fit_poses, normalise_person
from app.estimation.networks import load_networks
from app.estimation.normalised_person import NormalisedPerson
from app.estimation.stopwatch import Stopwatch
from app.estimation.upload import DecodedUpload, Upload, UploadDecoder
from app.settings import Settings
from app.vision.detection.detector import Detector
from app.vision.people import Box
from app.vision.person.reader import PersonReader
from app.work.executor import Map, map_serially
from index.artefact import load_index
from index.matching import match
from index.store import PoseIndex


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
    map_parts : callable
        Works on the parts of a frame; see :class:`app.work.executor.Map`.
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
        map_parts: Map = map_serially,
    ) -> None:
        self.index = index
        self.detector = detector
        self._decoder = UploadDecoder(max_pixels, max_persons, map_parts)
        self.finder = PeopleFinder(detector, reader, min_person_px, max_persons, map_parts)
        self.map_parts = map_parts

    @classmethod
    def load(
        cls,
        settings: Settings,
        map_parts: Map = map_serially,
        index: PoseIndex | None = None,
    ) -> Estimator:
        """Load index and networks.

        Parameters
        ----------
        settings : Settings
        map_parts : callable
            As in :class:`Estimator`.
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
            map_parts=map_parts,
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
        self, upload: Upload, n: int, check: Check, evidence: Evidence = "photograph"
    ) -> Estimate:
        """Find the ``n`` nearest distinct poses of every person.

        Parameters
        ----------
        upload : Upload
        n : int
        check : callable
            Called between steps; raises where the work is no longer wanted.
        evidence : str
            ``photograph``: silhouettes and the landmarks that it shows; ``silhouette``: the
            silhouettes alone, as in the paper.

        Raises
        ------
        UploadError
            If the images or boxes cannot be used.
        """
        stopwatch = Stopwatch()
        scene = self.find_people(upload, check, stopwatch, evidence)
        persons = self.with_hypotheses(scene, n, check, stopwatch)
        return Estimate(
            scene.frame, persons, {**stopwatch.milliseconds, "total": stopwatch.total()}
        )

    def find_people(
        self, upload: Upload, check: Check, stopwatch: Stopwatch, evidence: Evidence = "photograph"
    ) -> Scene:
        """Find the people of a frame with their silhouettes; raises as :meth:`estimate` does."""
        check()
        with stopwatch.stage("decode"):
            decoded = self.decode(upload)
        check()
        reads = evidence == "photograph" and upload.frame is not None
        people = self.finder.find(decoded, reads, check, stopwatch)
        return Scene(decoded.frame, tuple(sorted(people, key=lambda person: person.box.x)))

    def decode(self, upload: Upload) -> DecodedUpload:
        """Decode the images of an upload; raises :class:`UploadError`."""
        return self._decoder.decode(upload)

    def with_hypotheses(
        self, scene: Scene, n: int, check: Check, stopwatch: Stopwatch
    ) -> tuple[Person, ...]:
        """Find the poses that fit people's silhouettes and keypoints."""

        def fit(person: ObservedPerson, normalised: NormalisedPerson | None) -> Person:
            check()
            return fit_poses(self.index, person, normalised, n)

        with stopwatch.stage("describe"):
            normalised = [normalise_person(person) for person in scene.people]
        with stopwatch.stage("search"):
            pairs = zip(scene.people, normalised, strict=True)
            return tuple(self.map_parts(lambda pair: fit(*pair), pairs))

    def detect(self, frame: bytes, check: Check) -> tuple[ObservedPerson, ...]:
        """Find the people of a frame by their boxes alone, the surest first."""
        check()
        pixels = self._decoder.decode_frame(frame)
        check()
        return self.finder.detect(pixels)
