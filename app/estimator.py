"""The one use case: a frame in, persons with hypotheses out. Knows images, not HTTP."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from app.estimates import (
    Estimate,
    Evidence,
    Found,
    Person,
    PlacedHypothesis,
    Scene,
    Source,
    Stopwatch,
    Upload,
    UploadError,
)
from app.reranking import rank_by_keypoints, rank_by_silhouette
from app.settings import Settings, cores
from app.upright import UprightPerson
from app.vision.decoding.decode import (
    ImageError,
    ImageTooLargeError,
    LabelImage,
    decode_image,
    decode_mask,
)
from app.vision.detection.detector import Detector, HogDetector, NetworkDetector
from app.vision.keypoints.movenet import MoveNet
from app.vision.keypoints.reader import KeypointReader
from app.vision.people import Box, ObservedKeypoints, Silhouette
from app.vision.segmentation.background import BackgroundSegmenter
from app.vision.segmentation.body_network import BodyNetwork
from app.vision.segmentation.segment import NetworkSegmenter, Segmenter, silhouettes_from_labels
from app.vision.segmentation.truncation import end_beyond_border
from app.vision.turning import (
    turned_box,
    turned_keypoints,
    turned_shape,
    turned_silhouette,
    turns_upright,
)
from app.vision.weights import network_path
from app.workers import Workers
from index.matching import Hypothesis, match, match_with_spares
from index.store import Label, PoseIndex

T = TypeVar("T")
Check = Callable[[], None]
"""Called between steps; raises where the work is no longer wanted."""

# Two threads share a pass of a network nearly without loss; more do not.
_NETWORK_THREADS = 2


class Estimator:
    """Frames to poses; holds what is loaded once, and changes nothing afterwards.

    Parameters
    ----------
    index : PoseIndex
    detector : Detector
    segmenter : Segmenter
    keypoint_reader : KeypointReader
    min_person_px : float
        Height of the smallest person wanted, where a background is given.
    max_pixels : int
        Of each image.
    max_persons : int
        Detections beyond are dropped, the least sure first; a caller who names more people
        is refused.
    threads : int
        That share the decoding and the people of frames.
    """

    def __init__(
        self,
        index: PoseIndex,
        detector: Detector,
        segmenter: Segmenter,
        keypoint_reader: KeypointReader,
        *,
        min_person_px: float,
        max_pixels: int,
        max_persons: int,
        threads: int = 1,
    ) -> None:
        self.index = index
        self.detector = detector
        self.segmenter = segmenter
        self._reader = keypoint_reader
        self._min_person_px = min_person_px
        self._max_pixels = max_pixels
        self._max_persons = max_persons
        self._workers = Workers(threads)

    @classmethod
    def load(cls, settings: Settings) -> Estimator:
        """Load index and networks.

        Raises
        ------
        ArtefactError
            If the index cannot be used.
        NetworkError
            If a network of the package is missing or altered.
        """
        threads = min(_NETWORK_THREADS, cores())
        copies = max(1, cores() // threads)
        movenet = MoveNet(network_path("movenet"), threads=threads, copies=copies)
        body = BodyNetwork(network_path("body_mask"), threads=threads, copies=copies)
        smallest = settings.min_person_px
        detector: Detector = (
            HogDetector(min_person_px=smallest)
            if settings.detector == "hog"
            else NetworkDetector(movenet, min_person_px=smallest)
        )
        return cls(
            PoseIndex.load(settings.index),
            detector,
            NetworkSegmenter(body),
            KeypointReader(movenet),
            min_person_px=smallest,
            max_pixels=settings.max_pixels,
            max_persons=settings.max_persons,
            threads=cores(),
        )

    def warm_up(self) -> None:
        """Do once what is slow the first time, so that the first caller does not wait for it."""
        frame = np.full((240, 320, 3), 127, np.uint8)
        box = Box(120.0, 40.0, 60.0, 160.0)
        self.detector.detect(frame)
        self.segmenter.segment(frame, [box])
        self._reader.read(frame, box)
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
            ``photograph``: what it shows counts beside the silhouettes; ``silhouette``: they
            alone, as in the paper.

        Raises
        ------
        UploadError
            If the images or boxes cannot be used.
        """
        watch = Stopwatch()
        scene = self.find_people(upload, check, watch, evidence)
        if evidence == "photograph" and upload.frame is not None:
            scene = self.with_keypoints(scene, check, watch)
        persons = self.with_hypotheses(scene, n, check, watch)
        return Estimate(scene.frame, persons, {**watch.milliseconds, "total": watch.total()})

    def find_people(
        self, upload: Upload, check: Check, watch: Stopwatch, evidence: Evidence = "photograph"
    ) -> Scene:
        """Find the people of a frame with their silhouettes; raises as :meth:`estimate` does."""
        check()
        with watch.stage("decode"):
            frame, mask, background = self._decoded(upload)
        check()
        read = evidence == "photograph" and upload.frame is not None
        if mask is not None:
            people = self._in_mask(mask, frame, read, watch)
        elif upload.boxes is not None:
            people = self._in_boxes(upload.boxes, frame, background or self.segmenter, read, watch)
        elif background is not None:
            people = self._detected(frame, "background", background, background, check, watch)
        else:
            people = self._detected(frame, "detector", self.detector, self.segmenter, check, watch)
        return Scene(frame, tuple(sorted(people, key=lambda found: found.box.x)))

    def detect(self, frame: bytes, check: Check) -> tuple[Found, ...]:
        """Find the people of a frame by their boxes alone, the surest first."""
        check()
        pixels = self._decode("frame", frame, decode_image)
        check()
        detections = self.detector.detect(pixels)[: self._max_persons]
        return tuple(Found(d.box, "detector", d.score, None, turns=d.turns) for d in detections)

    def with_keypoints(self, scene: Scene, check: Check, watch: Stopwatch) -> Scene:
        """Read the keypoints of people with silhouettes from the photograph."""
        with watch.stage("keypoints"):
            people = []
            for found in scene.people:
                check()
                keypoints = self._read(scene.frame, found)
                people.append(_with_keypoints(found, keypoints, scene.frame.shape))
        return replace(scene, people=tuple(people))

    def with_hypotheses(
        self, scene: Scene, n: int, check: Check, watch: Stopwatch
    ) -> tuple[Person, ...]:
        """Find the poses that fit people's silhouettes and keypoints."""
        with watch.stage("describe"):
            upright = [
                UprightPerson.of(one.silhouette, one.turns, scene.frame.shape, one.keypoints)
                if one.silhouette is not None
                else None
                for one in scene.people
            ]

        def person(pair: tuple[Found, UprightPerson | None]) -> Person:
            check()
            return self._person(*pair, n)

        with watch.stage("search"):
            # One is matched here: another thread would only begin later.
            workers = self._workers if len(upright) > 1 else Workers()
            return tuple(workers.map(person, zip(scene.people, upright, strict=True)))

    def _person(self, found: Found, upright: UprightPerson | None, n: int) -> Person:
        if upright is None:
            return Person(found, None, ())
        keypoints = upright.keypoints()
        matched = match_with_spares(self.index, upright.normalised, n, keypoints)
        ranked = (
            rank_by_silhouette(matched, n) if keypoints is None else rank_by_keypoints(matched, n)
        )
        points_2d = upright.points_in_frame(
            np.array([one.points_normalised for one in ranked.hypotheses])
        )
        hypotheses = [upright.in_frame(one) for one in ranked.hypotheses]
        return Person(
            found,
            ranked.facing,
            tuple(
                PlacedHypothesis(one, distance, confidence, self._label(one), points)
                for one, distance, confidence, points in zip(
                    hypotheses, ranked.distances, ranked.confidences, points_2d, strict=True
                )
            ),
        )

    def _label(self, hypothesis: Hypothesis) -> Label:
        label = self.index.label(hypothesis.entry, mirrored=hypothesis.mirrored)
        if not hypothesis.lean_deg:
            return label
        return replace(label, roll_deg=label.roll_deg + hypothesis.lean_deg)

    def _detected(
        self,
        frame: NDArray[np.uint8],
        source: Source,
        detector: Detector | BackgroundSegmenter,
        segmenter: Segmenter,
        check: Check,
        watch: Stopwatch,
    ) -> list[Found]:
        with watch.stage("detect"):
            detections = detector.detect(frame)[: self._max_persons]
        check()
        with watch.stage("segment"):
            boxes, turns = [one.box for one in detections], [one.turns for one in detections]
            silhouettes = _segment_turned(segmenter, frame, boxes, turns)
        # Where no silhouette is found in a detection, it was hardly a person.
        return [
            Found(one.box, source, one.score, silhouette, turns=one.turns)
            for one, silhouette in zip(detections, silhouettes, strict=True)
            if silhouette is not None
        ]

    def _in_boxes(
        self,
        boxes: Sequence[Box],
        frame: NDArray[np.uint8],
        segmenter: Segmenter,
        read: bool,
        watch: Stopwatch,
    ) -> list[Found]:
        self._check_count("boxes", len(boxes))
        height, width = frame.shape[:2]
        inside = [_clip(box, width, height, position) for position, box in enumerate(boxes)]
        with watch.stage("keypoints"):
            turns = [self._turns(frame, box) if read else 0 for box in inside]
        with watch.stage("segment"):
            # What differs from a background is the same whichever way up.
            up = turns if segmenter is self.segmenter else [0] * len(turns)
            silhouettes = _segment_turned(segmenter, frame, inside, up)
        return [
            Found(box, "boxes", None, silhouette, turns=turn)
            for box, silhouette, turn in zip(inside, silhouettes, turns, strict=True)
        ]

    def _in_mask(
        self, mask: LabelImage, frame: NDArray[np.uint8], read: bool, watch: Stopwatch
    ) -> list[Found]:
        with watch.stage("segment"):
            silhouettes = silhouettes_from_labels(mask)
        self._check_count("mask", len(silhouettes))
        with watch.stage("keypoints"):
            return [
                Found(one.box, "mask", None, one, turns=self._turns(frame, one.box) if read else 0)
                for one in silhouettes
            ]

    def _turns(self, frame: NDArray[np.uint8], box: Box) -> int:
        """Quarter turns that set somebody upright in a caller's box, who may lie if it is wide."""
        if box.width <= box.height:
            return 0
        return turns_upright(self._reader.read(frame, box))

    def read_keypoints(self, frame: NDArray[np.uint8], box: Box) -> ObservedKeypoints | None:
        """Read the keypoints of the upright person in a box, in pixels of the frame."""
        return self._reader.read(frame, box)

    def _read(self, frame: NDArray[np.uint8], found: Found) -> ObservedKeypoints | None:
        """Keypoints of a person, read upright, in pixels of the frame as it came."""
        if found.silhouette is None:
            return None
        turned = np.rot90(frame, found.turns)
        box = turned_box(found.box, frame.shape, found.turns)
        keypoints = self._reader.read(turned, box)
        if keypoints is None or not found.turns:
            return keypoints
        return turned_keypoints(keypoints, turned_shape(frame.shape, found.turns), -found.turns)

    def _decoded(
        self, upload: Upload
    ) -> tuple[NDArray[np.uint8], LabelImage | None, BackgroundSegmenter | None]:
        """Decode an upload's images, at the same time where there are cores for it."""
        jobs: dict[str, Callable[[], object]] = {}
        for name, data, decode in (
            ("frame", upload.frame, decode_image),
            ("mask", upload.mask, decode_mask),
            ("background", upload.background, decode_image),
        ):
            if data is not None:
                jobs[name] = _decoding(self._decode, name, data, decode)
        workers = self._workers if len(jobs) > 1 else Workers()
        images = dict(zip(jobs, workers.map(lambda job: job(), jobs.values()), strict=True))
        frame, mask, background = (images.get(name) for name in ("frame", "mask", "background"))
        assert mask is None or isinstance(mask, LabelImage)
        if frame is None and mask is not None:
            frame = np.zeros((*mask.labels.shape, 3), np.uint8)
        assert isinstance(frame, np.ndarray)
        if mask is not None:
            _check_size("mask", mask.labels, frame)
        if background is None:
            return frame, mask, None
        assert isinstance(background, np.ndarray)
        _check_size("background", background, frame)
        plate = BackgroundSegmenter(background, min_person_px=self._min_person_px)
        return frame, mask, plate

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


def _decoding(
    decode: Callable[..., object], name: str, data: bytes, how: Callable[..., object]
) -> Callable[[], object]:
    return lambda: decode(name, data, how)


def _with_keypoints(
    found: Found, keypoints: ObservedKeypoints | None, frame_shape: tuple[int, ...]
) -> Found:
    """A person with keypoints, which tell of more people than silhouettes do that they are cut."""
    silhouette = found.silhouette
    if silhouette is None or keypoints is None:
        return found
    if end_beyond_border(found.box, keypoints, frame_shape, found.turns):
        silhouette = replace(silhouette, truncated=True)
    return replace(found, silhouette=silhouette, keypoints=keypoints)


def _segment_turned(
    segmenter: Segmenter,
    frame: NDArray[np.uint8],
    boxes: Sequence[Box],
    turns: Sequence[int],
) -> list[Silhouette | None]:
    """Cut people out, those who lie in a frame turned so that they are upright."""
    found: list[Silhouette | None] = [None] * len(boxes)
    for turn in sorted(set(turns)):
        rows = [i for i, other in enumerate(turns) if other == turn]
        upright = np.ascontiguousarray(np.rot90(frame, turn))
        silhouettes = segmenter.segment(
            upright, [turned_box(boxes[i], frame.shape, turn) for i in rows]
        )
        for i, silhouette in zip(rows, silhouettes, strict=True):
            found[i] = silhouette and turned_silhouette(silhouette, upright.shape, -turn)
    return found


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
