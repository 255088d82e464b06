"""The one use case: a frame in, persons with hypotheses out. Knows images, not HTTP."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from app.estimates import (
    Estimate,
    Found,
    Person,
    PlacedHypothesis,
    Scene,
    Source,
    Stopwatch,
    Upload,
    UploadError,
)
from app.process import give_way
from app.settings import Settings
from app.vision.background import BackgroundSegmenter
from app.vision.decode import ImageError, ImageTooLargeError, decode_image, decode_mask
from app.vision.detect import Detector
from app.vision.facing_evidence import AzimuthBelief, FacingReader, FacingView
from app.vision.joints import JointReader
from app.vision.lying import is_wide, segment_either_way, segment_people, which_way_up
from app.vision.networks import load_networks
from app.vision.people import Box, Silhouette
from app.vision.people_detector import make_detector
from app.vision.segment import Segmenter, make_segmenter, silhouettes_from_labels
from app.vision.turning import turned_points, turned_shape, turned_silhouette
from app.vision.workers import Workers
from app.weighing import weigh, weigh_by_image
from descriptor.silhouette import Placement, normalise
from index.joint_maps import JointMaps
from index.matching import Hypothesis, leaning_further, match, match_with_spares
from index.store import Label, PoseIndex

T = TypeVar("T")
Check = Callable[[], None]
"""Called between steps; raises where the work is no longer wanted."""


@dataclass(frozen=True)
class Look:
    """What is asked about a person, while the photograph is looked at.

    Parameters
    ----------
    silhouette : Silhouette
        In the frame turned so that the person is upright.
    normalised : (128, 48) uint8 array
    placement : Placement
        From the silhouette's crop to the normalised frame.
    maps : Future of JointMaps, optional
        Where joints are, where they are read.
    belief : Future of AzimuthBelief or None
        Which way the person faces, if anything shows it.
    """

    silhouette: Silhouette
    normalised: NDArray[np.uint8]
    placement: Placement
    maps: Future[JointMaps] | None
    belief: Future[AzimuthBelief | None]


class Estimator:
    """Frames to poses; holds what is loaded once, and changes nothing afterwards.

    Parameters
    ----------
    index : PoseIndex
    detector : Detector
    segmenter : Segmenter
    min_person_px : float
        Height of the smallest person wanted, where a background is given.
    max_pixels : int
        Of each image.
    max_persons : int
        Detections beyond are dropped, the least sure first; a caller who names more people
        is refused.
    facing_reader : FacingReader, optional
        Tells from the photograph which way a person faces; without it, nothing does.
    joint_reader : JointReader, optional
        Tells from the photograph where the joints of a person are whom the service cut out itself.
        A caller's mask is taken at its word, and answered sooner.
    concurrency : int
        Frames that are worked on at once.
    """

    def __init__(
        self,
        index: PoseIndex,
        detector: Detector,
        segmenter: Segmenter,
        *,
        min_person_px: float,
        max_pixels: int,
        max_persons: int,
        facing_reader: FacingReader | None = None,
        joint_reader: JointReader | None = None,
        concurrency: int = 1,
    ) -> None:
        self.index = index
        self.detector = detector
        self.segmenter = segmenter
        self._min_person_px = min_person_px
        self._max_pixels = max_pixels
        self._max_persons = max_persons
        self._facing_reader = facing_reader
        self._joint_reader = joint_reader
        self._concurrency = concurrency
        # What one request can do at the same time: the photograph is decoded and looked at while
        # its mask is decoded and matched; several people are matched. Images, search and much of
        # the arithmetic let go of the interpreter.
        self._aside = ThreadPoolExecutor(
            concurrency, thread_name_prefix="photograph", initializer=give_way
        )
        self._matchers = Workers(concurrency)

    @classmethod
    def load(cls, settings: Settings) -> Estimator:
        """Load index and networks.

        Raises
        ------
        ArtefactError
            If the index cannot be used.
        OnnxError
            If a network of the package is missing or broken.
        FaceError
            If OpenCV lacks its cascade for faces.
        """
        workers = Workers(settings.concurrency)
        networks = load_networks(settings.models, workers)
        segmenter = make_segmenter(networks, workers)
        reader = JointReader(workers=workers)
        smallest = settings.min_person_px
        return cls(
            PoseIndex.load(settings.index),
            make_detector(networks, segmenter, reader, min_person_px=smallest, workers=workers),
            segmenter,
            min_person_px=smallest,
            max_pixels=settings.max_pixels,
            max_persons=settings.max_persons,
            facing_reader=FacingReader(),
            joint_reader=reader,
            concurrency=settings.concurrency,
        )

    def warm_up(self) -> None:
        """Do once what is slow the first time, so that the first caller does not wait for it."""
        frame = np.full((240, 320, 3), 127, np.uint8)
        self.detector.detect(frame)
        self.segmenter.segment(frame, [Box(120.0, 40.0, 60.0, 160.0)])
        silhouette = self.index.silhouette(0)
        match(self.index, silhouette, 1)
        if self._facing_reader is not None:
            body = Silhouette(np.ones((160, 60), bool), 120, 40, "mask", False)
            frame[::2] = 0  # A blank head is not looked at.
            # As many at once as there are threads: each has a network of its own to set up.
            looks = [
                self._aside.submit(self._facing_reader.read, frame, body)
                for _ in range(self._concurrency)
            ]
            for look in looks:
                look.result()

    def estimate(self, upload: Upload, n: int, check: Check) -> Estimate:
        """Find the ``n`` nearest distinct poses of every person.

        Parameters
        ----------
        upload : Upload
        n : int
        check : callable
            Called between steps; raises where the work is no longer wanted.

        Raises
        ------
        UploadError
            If the images or boxes cannot be used.
        """
        watch = Stopwatch()
        scene = self.find_people(upload, check, watch)
        persons = self.with_hypotheses(scene, n, check, watch)
        with watch.stage("decode"):
            frame = scene.frame
        return Estimate(frame, persons, {**watch.milliseconds, "total": watch.total()})

    def find_people(self, upload: Upload, check: Check, watch: Stopwatch) -> Scene:
        """Find the people of a frame with their silhouettes; raises as :meth:`estimate` does."""
        check()
        if upload.mask is not None:
            return self._from_mask(upload.frame, upload.mask, watch)
        with watch.stage("decode"):
            frame = self._decode("frame", upload.frame, decode_image)
        check()
        scene = self._background(upload.background, frame, watch)
        check()
        if upload.boxes is not None:
            people = self._in_boxes(upload.boxes, frame, scene or self.segmenter, watch)
        elif scene is not None:
            people = self._detected(frame, "background", scene, scene, check, watch)
        else:
            people = self._detected(frame, "hog", self.detector, self.segmenter, check, watch)
        return Scene(lambda: frame, _left_to_right(people))

    def detect(self, frame: bytes, check: Check) -> tuple[Found, ...]:
        """Find the people of a frame by their boxes alone, the surest first."""
        check()
        pixels = self._decode("frame", frame, decode_image)
        check()
        detections = self.detector.detect(pixels)[: self._max_persons]
        return tuple(Found(d.box, "hog", d.score, None) for d in detections)

    def _detected(
        self,
        frame: NDArray[np.uint8],
        source: Source,
        detector: Detector,
        segmenter: Segmenter,
        check: Check,
        watch: Stopwatch,
    ) -> list[Found]:
        with watch.stage("detect"):
            detections = detector.detect(frame)[: self._max_persons]
        check()
        with watch.stage("segment"):
            silhouettes = segment_people(segmenter, frame, detections)
            # Where no silhouette is found in a detection, it was hardly a person.
            found = [
                Found(detection.box, source, detection.score, silhouette, detection.turns)
                for detection, silhouette in zip(detections, silhouettes, strict=True)
                if silhouette is not None
            ]
            return [self._either_way(one, lambda: frame, segmenter) for one in found]

    def _in_boxes(
        self,
        boxes: Sequence[Box],
        frame: NDArray[np.uint8],
        segmenter: Segmenter,
        watch: Stopwatch,
    ) -> list[Found]:
        self._check_count("boxes", len(boxes))
        height, width = frame.shape[:2]
        inside = [_clip(box, width, height, position) for position, box in enumerate(boxes)]
        with watch.stage("segment"):
            silhouettes = segmenter.segment(frame, inside)
            return [
                self._either_way(Found(box, "boxes", None, silhouette), lambda: frame, segmenter)
                for box, silhouette in zip(inside, silhouettes, strict=True)
            ]

    def _from_mask(self, frame_data: bytes, mask_data: bytes, watch: Stopwatch) -> Scene:
        """Find people without waiting for the frame, which is decoded meanwhile."""
        later = self._aside.submit(self._decode, "frame", frame_data, decode_image)
        try:
            with watch.stage("decode"):
                image = self._decode("mask", mask_data, decode_mask)
            with watch.stage("segment"):
                silhouettes = silhouettes_from_labels(image)
            self._check_count("mask", len(silhouettes))
        except UploadError:
            # Where both are broken, it is the frame that the caller hears of.
            later.result()
            raise

        def decoded() -> NDArray[np.uint8]:
            frame = later.result()
            _check_size("mask", image.labels, frame)
            return frame

        found = [Found(s.box, "mask", None, s) for s in silhouettes]
        with watch.stage("segment"):
            found = [self._either_way(one, decoded) for one in found]
        return Scene(decoded, _left_to_right(found))

    def _either_way(
        self,
        found: Found,
        frame: Callable[[], NDArray[np.uint8]],
        segmenter: Segmenter | None = None,
    ) -> Found:
        """Tell which way up somebody is whose box is wide."""
        reader, silhouette = self._joint_reader, found.silhouette
        if reader is None or found.turns or not is_wide(found.box):
            return found
        if segmenter is self.segmenter:
            silhouette, turns = segment_either_way(
                segmenter, reader, frame(), found.box, silhouette
            )
        elif silhouette is None:
            return found
        else:
            # A mask, and what differs from the empty scene, are the same whichever way.
            _, turns = which_way_up(reader, frame(), silhouette)
        return replace(found, silhouette=silhouette, turns=turns)

    def _background(
        self, data: bytes | None, frame: NDArray[np.uint8], watch: Stopwatch
    ) -> BackgroundSegmenter | None:
        if data is None:
            return None
        with watch.stage("decode"):
            background = self._decode("background", data, decode_image)
        _check_size("background", background, frame)
        return BackgroundSegmenter(background, min_person_px=self._min_person_px)

    def with_hypotheses(
        self, scene: Scene, n: int, check: Check, watch: Stopwatch
    ) -> tuple[Person, ...]:
        """Find the poses that fit people's silhouettes, ordered by what the photograph shows."""
        with watch.stage("describe"):
            looks = [self._look_at(scene, found, check) for found in scene.people]
            for look in looks:
                check()
                if look is not None and look.maps is not None:
                    wait([look.maps])

        def person(pair: tuple[Found, Look | None]) -> Person:
            check()
            return self._person(scene, *pair, n)

        with watch.stage("search"):
            # One is matched here: another thread would only begin later.
            workers = self._matchers if len(looks) > 1 else Workers()
            return tuple(workers.map(person, zip(scene.people, looks, strict=True)))

    def _look_at(self, scene: Scene, found: Found, check: Check) -> Look | None:
        """Begin to look at the photograph of a person whose silhouette is known."""
        silhouette = found.silhouette
        if silhouette is None:
            return None
        if found.turns:
            silhouette = turned_silhouette(silhouette, scene.frame.shape, found.turns)
            scene = scene.turned(found.turns)
        normalised, placement = normalise(silhouette.crop)

        def aside(read: Callable[..., T], *arguments: object) -> Future[T]:
            def work() -> T:
                check()
                return read(*arguments)

            return self._aside.submit(work)

        reader, maps = self._joint_reader, None
        if reader is not None and found.source != "mask":
            maps = aside(reader.read, scene.frame, silhouette, placement)
        belief = aside(self._read_facing, scene, FacingView.of(silhouette))
        return Look(silhouette, normalised, placement, maps, belief)

    def _person(self, scene: Scene, found: Found, look: Look | None, n: int) -> Person:
        if look is None:
            return Person(found, None, ())
        maps = None if look.maps is None else look.maps.result()
        candidates = match_with_spares(self.index, look.normalised, n, maps)
        belief = look.belief.result()
        if belief is None and maps is None:
            weighed = weigh(candidates, n)
        else:
            weighed = weigh_by_image(candidates, belief, n)
        hypotheses = weighed.hypotheses
        points_2d = look.placement.to_image(np.array([one.points_normalised for one in hypotheses]))
        points_2d += (look.silhouette.left, look.silhouette.top)
        if found.turns:
            shape = turned_shape(scene.frame.shape, found.turns)
            points_2d = turned_points(points_2d, shape, -found.turns)
            lean_deg = 90.0 if found.turns == 1 else -90.0
            hypotheses = tuple(leaning_further(one, lean_deg) for one in hypotheses)
        return Person(
            found,
            weighed.facing,
            tuple(
                PlacedHypothesis(one, distance, confidence, self._label(one), points)
                for one, distance, confidence, points in zip(
                    hypotheses, weighed.distances, weighed.confidences, points_2d, strict=True
                )
            ),
        )

    def _label(self, hypothesis: Hypothesis) -> Label:
        label = self.index.label(hypothesis.entry, mirrored=hypothesis.mirrored)
        if not hypothesis.lean_deg:
            return label
        return replace(label, roll_deg=label.roll_deg + hypothesis.lean_deg)

    def _read_facing(self, scene: Scene, view: FacingView | None) -> AzimuthBelief | None:
        reader = self._facing_reader
        return None if reader is None or view is None else reader.look(scene.frame, view)

    def _decode(self, name: str, data: bytes, decode: Callable[..., T]) -> T:
        try:
            return decode(data, max_pixels=self._max_pixels)
        except ImageTooLargeError as error:
            raise UploadError(name, "too_large", f"{name}: {error}") from error
        except ImageError as error:
            raise UploadError(name, "undecodable", f"{name}: {error}") from error

    def _check_count(self, name: str, count: int) -> None:
        if count > self._max_persons:
            raise UploadError(
                name, "misfit", f"expected at most {self._max_persons} persons, got {count}"
            )


def _left_to_right(people: Sequence[Found]) -> tuple[Found, ...]:
    return tuple(sorted(people, key=lambda found: found.box.x))


def _check_size(name: str, image: NDArray[np.generic], frame: NDArray[np.uint8]) -> None:
    if image.shape[:2] != frame.shape[:2]:
        (height, width), (other_height, other_width) = frame.shape[:2], image.shape[:2]
        raise UploadError(
            name,
            "misfit",
            f"expected a {name} of {width}x{height} pixels like the frame, "
            f"got {other_width}x{other_height}",
        )


def _clip(box: Box, width: int, height: int, position: int) -> Box:
    """Cut a caller's box to the frame."""
    inside = box.clip(width, height)
    if inside is None:
        raise UploadError(
            "boxes",
            "misfit",
            f"expected boxes inside the frame of {width}x{height} pixels, "
            f"got box {position}: {[box.x, box.y, box.width, box.height]}",
        )
    return inside
