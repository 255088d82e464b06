"""Finds the people of a frame and observes each: silhouette, landmarks and what these show."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from app.estimation.results import Evidence, Person, Source
from app.estimation.upload import DecodedUpload
from app.scheduling.job import Job
from app.vision.background import BackgroundSegmenter
from app.vision.blazepose import PoseReading
from app.vision.detector import NetworkDetector, smallest_person_px
from app.vision.geometry import Box, PersonWindow
from app.vision.judgement import Judgement, PhotographModels
from app.vision.people import Detection, Silhouette
from app.vision.person_reader import (
    MIN_PRESENCE,
    PersonReader,
    attenuate_visibility_at_border,
    reading_quality,
)
from app.vision.silhouettes import end_beyond_border, silhouettes_from_labels, silhouettes_of


@dataclass(frozen=True)
class Models:
    """What people are found, read and judged with."""

    detector: NetworkDetector
    reader: PersonReader
    judgement: PhotographModels


@dataclass(frozen=True)
class Target:
    """Where a person may be in a frame.

    Parameters
    ----------
    box : Box
        As marked, detected or expected, pixels.
    score : float or None
        Probability of a person; None if the caller marked them.
    detection : Detection or None
        None if no detector has found the person.
    expected : PersonWindow or PoseReading or None
        Window in which a track expects the person, or the reading in it.
    """

    box: Box
    score: float | None = None
    detection: Detection | None = None
    expected: PersonWindow | PoseReading | None = None


Cut = Callable[[Sequence[Box]], Sequence[Silhouette | None]]

_MARKED: tuple[Source, ...] = ("boxes", "mask")
"""Sources in which the caller says who is a person."""

# Share of the detections that were not certain but were read beside others that show a person, in
# rendered groups.
_READ_BESIDE_SCORE = 0.8
# Margin around a body's landmarks, as a share of their box: they do not reach to the crown, fingers
# and toes.
_BODY_MARGIN = 0.1


@dataclass(frozen=True)
class PeopleFinder:
    """Finds people with the detector, or where the caller marks them.

    People at least ``min_person_px`` high are found with a background, and at most ``max_persons``,
    those with the highest scores.
    """

    models: Models
    min_person_px: float | None
    max_persons: int

    def find(self, upload: DecodedUpload, evidence: Evidence, job: Job) -> list[Person]:
        """Find the people of a frame with their silhouettes, in no particular order.

        The evidence says whether to return landmarks. They may be read without being returned,
        because they also separate people from the background.
        """
        landmarks = evidence == "photograph" and upload.has_frame
        source, targets, cut = self._targets(upload, job)
        people = self.observe(upload, targets, job, source, landmarks=landmarks, cut=cut)
        if source in _MARKED:
            return [person for person in people if person is not None]
        # Detectors cut off foreheads, feet and outstretched arms that the silhouette shows.
        return [replace(one, box=one.box.joined(one.whole_box)) for one in people if one]

    def _targets(self, upload: DecodedUpload, job: Job) -> tuple[Source, list[Target], Cut | None]:
        """Where people are, who says so, and how they are cut out if not by their readings."""
        frame = upload.frame
        if upload.mask is not None:
            with job.stage("segment"):
                silhouettes = silhouettes_from_labels(upload.mask)
            return "mask", [Target(one.box) for one in silhouettes], lambda _: silhouettes
        scene = cut = None
        if upload.background is not None:
            smallest = smallest_person_px(frame.shape, self.min_person_px)
            scene = BackgroundSegmenter(upload.background, min_person_px=smallest)
            cut = partial(scene.segment, frame, checkpoint=job.checkpoint)
        if upload.boxes is not None:
            return "boxes", [Target(box) for box in upload.boxes], cut
        if scene is None:
            found = self.search(frame, job)
        else:
            with job.stage("detect"):
                found = scene.detect(frame)[: self.max_persons]
            job.checkpoint()
        targets = [Target(one.box, one.score, one) for one in found]
        return "detector" if scene is None else "background", targets, cut

    def search(
        self,
        frame: NDArray[np.uint8],
        job: Job,
        lost: Sequence[Box] = (),
        known: Sequence[Box] = (),
    ) -> list[Detection]:
        """Detect the people of a whole frame, best first.

        ``lost`` are boxes of people who were there a moment ago and were not seen to leave,
        ``known`` those of people who are followed.
        """
        with job.stage("detect"):
            found = self.models.detector.detect(frame, lost, known)[: self.max_persons]
        job.checkpoint()
        return found

    def read(
        self, frame: NDArray[np.uint8], targets: Sequence[Target], job: Job
    ) -> list[PoseReading | None]:
        """Read landmarks of people, without their masks.

        None stands where a track's window shows nobody any more, and for detections that are not
        certain.
        """
        reader = self.models.reader

        def read(target: Target) -> PoseReading | None:
            expected, found = target.expected, target.detection
            if found is not None and not found.certain:
                return None
            if found is None and isinstance(expected, PoseReading):
                return expected
            if found is None and isinstance(expected, PersonWindow):
                return reader.follow(frame, expected)
            found = found or Detection(target.box, 1.0)
            return reader.read(frame, found.box, found.keypoints, found.windows, expected)

        with job.stage("keypoints"):
            return job.map(read, targets)

    def observe(
        self,
        upload: DecodedUpload,
        targets: Sequence[Target],
        job: Job,
        source: Source = "detector",
        *,
        landmarks: bool = True,
        cut: Cut | None = None,
        tight: bool = False,
    ) -> list[Person | None]:
        """Observe people: read each body once, cut out the silhouettes, judge the landmarks.

        Parameters
        ----------
        source : str
            Who found the people. Those whom the caller marked stay, whatever is seen of them.
        landmarks : bool
            Whether landmarks are wanted; otherwise they only separate people.
        cut : callable, optional
            Cuts people out of their boxes; by default, the masks of their readings do.
        tight : bool
            Whether people get the boxes of their silhouettes: a detector's box may include more
            than the body.

        Returns
        -------
        list of Person or None
            One for each target; None where nobody is seen, or a body that another target shows. A
            track whose window shows a detected body that no track expected has its person as well.
        """
        frame, marked, reads = upload.frame, source in _MARKED, landmarks or cut is None
        readings: list[PoseReading | None] = [None] * len(targets)
        if reads:
            readings = self.read(frame, targets, job)
        rows, beside, shown_by = [*range(len(targets))], list[int](), dict[int, int]()
        if reads and not marked:
            shown_by = best_shown_by(targets, readings)
            rows = [row for row in rows if shown_by.get(row) == row]
            beside = self._read_beside(frame, targets, readings, rows, job)
            rows = sorted(rows + beside)
        boxes = [_box(targets[row], readings[row]) for row in rows]

        def look(row: int) -> tuple[PoseReading | None, Judgement | None]:
            """A reading, with its mask if that is wanted, and the judgement of its landmarks."""
            reading, judged = readings[row], None
            if reading and cut is None:
                reading = self.models.reader.with_mask(reading)
            if reading and landmarks and reading.network_pass is not None:
                judged = self.models.judgement.judge(reading, upload.camera)
            return reading, judged

        with job.stage("keypoints"):
            seen = job.map(look, rows)
        with job.stage("segment"):
            silhouettes = (
                silhouettes_of(
                    [reading for reading, _ in seen if reading],
                    boxes,
                    frame.shape,
                    exact=marked,
                    checkpoint=job.checkpoint,
                )
                if cut is None
                else cut(boxes)
            )
        people: list[Person | None] = [None] * len(targets)
        for row, box, silhouette, (reading, judged) in zip(
            rows, boxes, silhouettes, seen, strict=True
        ):
            if silhouette is None and not marked:
                continue  # A detection without a silhouette is unlikely to be a person.
            if tight and silhouette and reading and reading.presence >= MIN_PRESENCE:
                box = silhouette.box
            score, detection = targets[row].score, targets[row].detection
            if score is not None and detection is not None and not detection.certain:
                score = max(score, _READ_BESIDE_SCORE)
            person = Person(box, source, score, silhouette, beside=row in beside)
            people[row] = self._with_reading(person, reading, judged, upload, landmarks)
        for row, best in shown_by.items():
            unexpected = targets[best].detection is not None and targets[best].expected is None
            if targets[row].detection is None and unexpected:
                people[row] = people[best]
        return people

    def _read_beside(
        self,
        frame: NDArray[np.uint8],
        targets: Sequence[Target],
        readings: list[PoseReading | None],
        kept: Sequence[int],
        job: Job,
    ) -> list[int]:
        """Read detections that are not certain, and those whose readings show the bodies of others.

        The network looks at the person who is most apparent in a window. MoveNet's keypoints of the
        detection show whether there is another one. Returns the rows of new bodies.
        """
        bodies = [reading for row in kept if (reading := readings[row])]
        rows = []
        for row, target in enumerate(targets):
            detection = target.detection
            if row in kept or detection is None or detection.keypoints is None:
                continue
            with job.stage("keypoints"):
                reading = self.models.reader.read_beside(
                    frame, target.box, detection.keypoints, bodies
                )
                if reading is None or first_of_body([*bodies, reading])[-1] < len(bodies):
                    continue
            readings[row] = reading
            bodies.append(reading)
            rows.append(row)
        return rows

    def _with_reading(
        self,
        person: Person,
        reading: PoseReading | None,
        judged: Judgement | None,
        upload: DecodedUpload,
        landmarks: bool,
    ) -> Person:
        """Add whether the reading shows that the body is truncated, and landmarks if wanted."""
        if reading is None:
            return person
        shape, silhouette = upload.frame.shape, person.silhouette
        visible = attenuate_visibility_at_border(reading, shape)
        if silhouette is not None and end_beyond_border(person.box, visible, shape):
            silhouette = replace(silhouette, truncated=True)
        person = replace(
            person,
            silhouette=silhouette,
            presence=reading.presence,
            next_window=reading.next_window,
        )
        if not landmarks:
            return person
        if judged is None:
            return replace(person, landmarks=visible)
        metres = judged.body.along_sight(upload.camera, visible)
        return replace(
            person,
            landmarks=replace(
                visible,
                metres=metres,
                depth_covariance=self.models.judgement.depth.covariance(judged.body.sigmas),
            ),
            frame_posture=judged.posture,
            trust=judged.trust,
        )


def _box(target: Target, reading: PoseReading | None) -> Box:
    """The target's own box or, where only a track expects the person, one about the landmarks."""
    if target.detection is not None or target.expected is None or reading is None:
        return target.box
    box = reading.landmarks.box()
    margin = _BODY_MARGIN * max(box.width, box.height)
    return Box(box.x - margin, box.y - margin, box.width + 2 * margin, box.height + 2 * margin)


def best_shown_by(
    targets: Sequence[Target], readings: Sequence[PoseReading | None]
) -> dict[int, int]:
    """For each row with a reading, the row whose reading of the same body is kept.

    A detection's is kept rather than a track's; of two detections, the one whose keypoints fit the
    reading better; of two tracks, the one whose box is nearer to the body.
    """
    read = {row: reading for row, reading in enumerate(readings) if reading is not None}

    def rank(row: int) -> tuple[float, float]:
        target = targets[row]
        if target.detection is not None:
            return -reading_quality(read[row], target.detection.keypoints), 0.0
        return 1.0, -target.box.iou(read[row].landmarks.box())

    order = sorted(read, key=rank)
    first = first_of_body([read[row] for row in order])
    return {row: order[best] for row, best in zip(order, first, strict=True)}


DUPLICATE_BODY_DISTANCE = 0.12
"""Mean distance between landmarks, in sizes of the body, below which two readings show the same
person."""


def first_of_body(readings: Sequence[PoseReading]) -> list[int]:
    """For each reading, the first one that shows the same body: its own row if none does."""
    first: list[int] = []
    for row, reading in enumerate(readings):
        same = (
            other
            for other in dict.fromkeys(first)
            if _apart(reading, readings[other]) < DUPLICATE_BODY_DISTANCE
        )
        first.append(next(same, row))
    return first


def _apart(first: PoseReading, second: PoseReading) -> float:
    """Mean distance between the landmarks of two readings, in sizes of the smaller body."""
    offsets = first.landmarks.positions - second.landmarks.positions
    weights = first.landmarks.visibility * second.landmarks.visibility + 1e-3
    distance = float(weights @ np.linalg.norm(offsets, axis=1) / weights.sum())
    return distance / min(first.body_px, second.body_px)
