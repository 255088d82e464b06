"""Finds the people of a frame and observes each: silhouette, landmarks, depth and posture."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from app.estimation.results import Evidence, Person, Source
from app.estimation.upload import DecodedUpload
from app.scheduling.job import Job
from app.vision.detector import NetworkDetector
from app.vision.detectors.tiles import smallest_person_px, tiles_of
from app.vision.geometry import Box, PersonWindow
from app.vision.halved import Frame, whole
from app.vision.judgement import JudgedReading, PhotographModels
from app.vision.people import Detection, Silhouette
from app.vision.person_reader import PersonReader, Seen, agreement
from app.vision.same_person import first_of_body
from app.vision.silhouettes import (
    DrawnSilhouette,
    cut_out_changed,
    foreground,
    silhouettes_from_labels,
    silhouettes_of,
    upright_regions,
)
from app.vision.truncation import attenuate_visibility_at_border, end_beyond_border


@dataclass(frozen=True)
class Models:
    """The models that find, read and judge people."""

    detector: NetworkDetector
    reader: PersonReader
    judgement: PhotographModels


@dataclass(frozen=True)
class Target:
    """Where a person may be in a frame.

    Parameters
    ----------
    found : Detection
        As detected; for marked or tracked people, the box in which they are expected.
    expected : PersonWindow or JudgedReading or None
        Window in which a track expects the person, or the reading in it.
    followed : bool
        Whether only a track, and no detection, places the person there.
    least_trust, seen
        Those of :meth:`app.vision.person_reader.PersonReader.follow`.
    drawn : DrawnSilhouette or None
        As drawn last; it moves along with the landmarks unless it has to be drawn again.
    reading : JudgedReading or None
        The best reading, once the frame is read.
    beside : bool
        Whether the person was read while others were painted over.
    """

    found: Detection
    expected: PersonWindow | JudgedReading | None = None
    followed: bool = False
    least_trust: float = 0.0
    seen: Seen | None = None
    drawn: DrawnSilhouette | None = None
    reading: JudgedReading | None = None
    beside: bool = False

    @property
    def box(self) -> Box:
        """The person's box; for a person who is only followed, the box about the landmarks."""
        if self.followed and self.reading is not None:
            # Landmarks do not reach to the crown, fingers and toes.
            return self.reading.landmarks.box().grown(0.1)
        return self.found.box

    @property
    def place(self) -> Box:
        """The box about the landmarks; before the reading, that of the detection."""
        return self.found.box if self.reading is None else self.reading.landmarks.box()


Cut = Callable[[Sequence[Box]], Sequence[Silhouette | None]]


@dataclass(frozen=True)
class Found:
    """Whom a frame may show.

    Parameters
    ----------
    source : str
        How they were found. People marked by the caller stay, whatever is visible.
    perhaps_beside : sequence of Detection
        Possible people; they count if readings beside the targets' bodies show other bodies.
    cut : callable, optional
        Cuts people out of their boxes; by default, the masks of their readings do.
    """

    targets: Sequence[Target]
    source: Source = "detector"
    perhaps_beside: Sequence[Detection] = ()
    cut: Cut | None = None

    @property
    def marked(self) -> bool:
        """Whether the caller marked the people."""
        return self.source in ("boxes", "mask")


# Share of a job's time in which people are read: their masks and poses take as long again.
_READ_UNTIL = 0.4


@dataclass(frozen=True)
class PeopleFinder:
    """Finds people with the detector, or where the caller marks them.

    ``min_person_px`` is the height of the smallest person wanted, pixels; by default a share of the
    frame's height. At most ``max_persons`` people are found, those with the highest scores.
    """

    models: Models
    min_person_px: float | None
    max_persons: int

    def __post_init__(self) -> None:
        if self.min_person_px is not None and not self.min_person_px > 0:
            raise ValueError(f"expected a positive min_person_px, got {self.min_person_px}")

    def smallest_px(self, frame_shape: tuple[int, ...]) -> float:
        """Height of the smallest person wanted in a frame of this shape, pixels."""
        return smallest_person_px(frame_shape, self.min_person_px)

    def search_scale(self, frame_shape: tuple[int, ...]) -> float:
        """Scale at which a search sees a frame of this shape, that of the finest tile."""
        height, width = frame_shape[:2]
        tiles = tiles_of(width, height, self.min_person_px)
        return max((tile.factor for tile in tiles), default=1.0)

    def find(self, upload: DecodedUpload, evidence: Evidence, job: Job) -> list[Person]:
        """Find the people of a frame with their silhouettes, in no particular order.

        The evidence says whether to return landmarks. They may be read without being returned,
        because they also separate people from the background.
        """
        landmarks = evidence == "photograph" and upload.has_frame
        found = self._found(upload, job)
        people, _ = self.observe(upload, found, job, landmarks=landmarks)
        if found.marked:
            return people
        # Detectors cut off foreheads, feet and outstretched arms that the silhouette shows.
        return [replace(one, box=one.box.joined(one.whole_box)) for one in people]

    def _found(self, upload: DecodedUpload, job: Job) -> Found:
        frame = upload.frame
        if upload.mask is not None:
            with job.stage("segment"):
                silhouettes = silhouettes_from_labels(upload.mask)
            marked = [Target(Detection(one.box, 1.0)) for one in silhouettes]
            return Found(marked, "mask", cut=lambda _: silhouettes)
        changed = cut = None
        if upload.background is not None:
            with job.stage("segment"):
                changed = foreground(whole(frame), upload.background)
            cut = partial(cut_out_changed, changed, checkpoint=job.checkpoint)
        if upload.boxes is not None:
            return Found([Target(Detection(box, 1.0)) for box in upload.boxes], "boxes", cut=cut)
        if changed is None:
            people, beside = self.search(frame, job)
            return Found([*map(Target, people)], "detector", beside)
        with job.stage("detect"):
            people = self._most(upright_regions(changed, self.smallest_px(frame.shape)), job)
        job.checkpoint()
        return Found([*map(Target, people)], "background", cut=cut)

    def _most(self, found: list[Detection], job: Job) -> list[Detection]:
        """The people with the highest scores; the job counts the others."""
        job.left_out += max(0, len(found) - self.max_persons)
        return found[: self.max_persons]

    def search(
        self,
        frame: Frame,
        job: Job,
        lost: Sequence[Box] = (),
        known: Sequence[Box] = (),
    ) -> tuple[list[Detection], list[Detection]]:
        """Detect the people of a whole frame, and possible people beside them; best first.

        ``lost`` are boxes of people who were visible a moment ago and did not leave the frame,
        ``known`` the boxes of tracked people.
        """
        with job.stage("detect"):
            people, beside = self.models.detector.detect(frame, lost, known, self.min_person_px)
        job.checkpoint()
        return self._most(people, job), beside[: max(0, self.max_persons - len(people))]

    def read(
        self, upload: DecodedUpload, targets: Sequence[Target], job: Job
    ) -> list[JudgedReading | None]:
        """Read landmarks of people, without their masks.

        None stands for a track's window that no longer shows a person, and for targets left out.
        """
        reader, frame, camera = self.models.reader, upload.frame, upload.camera

        def read(target: Target) -> JudgedReading | None:
            expected, found = target.expected, target.found
            if target.followed and isinstance(expected, JudgedReading):
                return expected
            if target.followed and isinstance(expected, PersonWindow):
                known = target.least_trust, target.seen
                return reader.follow(frame, camera, found, expected, *known)
            return reader.read(frame, camera, found, expected)

        with job.stage("keypoints"):
            return job.map_until(_READ_UNTIL, read, targets)

    def observe(
        self,
        upload: DecodedUpload,
        found: Found,
        job: Job,
        *,
        landmarks: bool = True,
        tight: bool = False,
    ) -> tuple[list[Person], list[int | None]]:
        """Observe people: read each body once, cut out the silhouettes, judge the landmarks.

        Parameters
        ----------
        landmarks : bool
            Whether landmarks are wanted; otherwise they only separate people.
        tight : bool
            Whether people get the boxes of their silhouettes: a detector's box may include more
            than the body.

        Returns
        -------
        people : list of Person
            One for each visible body.
        shown : list of int or None
            For each target, the position of the person that it shows. None if it shows no person,
            or if a track's window shows the person of a nearer track.
        """
        marked, cut = found.marked, found.cut
        bodies: Sequence[Target] = found.targets
        shows: list[int | None] = [*range(len(bodies))]
        if cut is None or landmarks:
            bodies = self._with_readings(upload, bodies, job)
            if not marked:
                bodies, shows = self._distinct(upload, bodies, found.perhaps_beside, job)
        moved = [None if cut else _moved(body, bodies, upload.frame.shape) for body in bodies]
        to_draw = [body for body, one in zip(bodies, moved, strict=True) if one is None]
        if cut is None:
            with job.stage("keypoints"):
                to_draw = job.map(self._masked, to_draw)
        with job.stage("segment"):
            cut = cut or _by_masks(to_draw, upload.frame.shape, job, exact=marked)
            drawn = iter(cut([body.box for body in to_draw]))
        silhouettes = [one or next(drawn) for one in moved]
        # A detection without a silhouette is unlikely to be a person.
        kept = [row for row, one in enumerate(silhouettes) if marked or one is not None]
        people = []
        for row in kept:
            person = _person(bodies[row], silhouettes[row], found, tight=tight)
            person = self._with_reading(person, bodies[row], upload, landmarks=landmarks)
            people.append(_with_drawn(person, bodies[row], moved[row]))
        position: dict[int | None, int] = dict(zip(kept, range(len(kept)), strict=True))
        return people, [*map(position.get, shows)]

    def _with_readings(
        self, upload: DecodedUpload, targets: Sequence[Target], job: Job
    ) -> list[Target]:
        readings = self.read(upload, targets, job)
        return [replace(one, reading=read) for one, read in zip(targets, readings, strict=True)]

    def _distinct(
        self,
        upload: DecodedUpload,
        targets: Sequence[Target],
        perhaps_beside: Sequence[Detection],
        job: Job,
    ) -> tuple[list[Target], list[int | None]]:
        """Each body of targets that were read, once; for each target, the position of its body."""
        best = best_shown_by(targets)
        kept = [row for row in range(len(targets)) if best.get(row) == row]
        bodies = [targets[row] for row in kept]
        shows = [kept.index(best[row]) if row in best else None for row in range(len(targets))]
        # Two detections with readings of the same body may still be two people.
        hidden = [targets[row] for row in best if row not in kept and not targets[row].followed]
        # In rendered groups, the share of possible people beside others who are real, given that a
        # separate reading shows another body.
        hidden += [Target(replace(one, score=max(one.score, 0.8))) for one in perhaps_beside]
        return bodies + self._read_beside(upload, hidden, bodies, job), shows

    def _read_beside(
        self, upload: DecodedUpload, hidden: Sequence[Target], bodies: Sequence[Target], job: Job
    ) -> list[Target]:
        """New bodies that detections show when they are read beside known bodies.

        The network reads the most prominent person in a window. MoveNet's keypoints of the
        detection show whether there is another one.
        """
        known = [body.reading for body in bodies if body.reading]
        found = []
        for target in hidden:
            one = target.found
            if one.keypoints is None or job.is_late(_READ_UNTIL):
                continue
            with job.stage("keypoints"):
                reading = self.models.reader.read_beside(upload.frame, upload.camera, one, known)
            if reading is None or first_of_body([*known, reading])[-1] < len(known):
                continue
            known.append(reading)
            found.append(replace(target, reading=reading, beside=True))
        return found

    def _masked(self, body: Target) -> Target:
        """A body with its mask."""
        reading = body.reading and self.models.reader.with_mask(body.reading)
        return replace(body, reading=reading)

    def _with_reading(
        self, person: Person, body: Target, upload: DecodedUpload, *, landmarks: bool
    ) -> Person:
        """Add whether the body is truncated according to the reading, and landmarks if wanted."""
        reading = body.reading
        if reading is None:
            return person
        shape, silhouette = upload.frame.shape, person.silhouette
        visible = attenuate_visibility_at_border(reading, shape)
        if silhouette is not None and end_beyond_border(person.box, visible, shape):
            silhouette = replace(silhouette, truncated=True)
        person = replace(
            person,
            silhouette=silhouette,
            next_window=reading.next_window,
            seen_keypoints=Seen.of(reading),
            presence=reading.trust.person,
        )
        if not landmarks:
            return person
        metres = reading.body.along_sight(upload.camera, visible)
        covariance = self.models.judgement.depth.covariance(reading.body.sigmas)
        return replace(
            person,
            landmarks=replace(visible, metres=metres, depth_covariance=covariance),
            frame_posture=reading.posture,
            trust=reading.trust,
            hips=None if silhouette is None else reading.body.origin,
        )


def _moved(
    body: Target, bodies: Sequence[Target], frame_shape: tuple[int, ...]
) -> Silhouette | None:
    """The silhouette of a body as drawn last, if it moves along; None if it has to be drawn."""
    drawn, reading = body.drawn, body.reading
    if drawn is None or reading is None or not reading.trust.is_right:
        return None
    if any(body.place.intersection(other.place) for other in bodies if other is not body):
        return None
    return drawn.on_landmarks(reading, frame_shape)


def _with_drawn(person: Person, body: Target, moved: Silhouette | None) -> Person:
    """A person with the silhouette as drawn last, unless it has just moved along."""
    if moved is not None:
        return replace(person, drawn=body.drawn)
    if body.reading is None or person.silhouette is None:
        return person
    positions = body.reading.landmarks.positions
    return replace(person, drawn=DrawnSilhouette(person.silhouette, positions))


def _by_masks(
    bodies: Sequence[Target], frame_shape: tuple[int, ...], job: Job, *, exact: bool
) -> Cut:
    """Cuts bodies out by the masks of their readings."""
    readings = [body.reading for body in bodies if body.reading]
    return partial(
        silhouettes_of, readings, frame_shape=frame_shape, exact=exact, checkpoint=job.checkpoint
    )


def _person(body: Target, silhouette: Silhouette | None, found: Found, *, tight: bool) -> Person:
    """The person of a body, without the results of its reading."""
    box, reading = body.box, body.reading
    if tight and silhouette and reading and reading.trust.is_person:
        box = silhouette.box
    score = None if found.marked else body.found.score
    return Person(box, found.source, score, silhouette, beside=body.beside)


def best_shown_by(targets: Sequence[Target]) -> dict[int, int]:
    """For each row with a reading, the row whose reading of the same body is kept.

    A detection is kept rather than a track; of two detections, the one with keypoints that fit the
    reading better; of two tracks, the one with the box nearer to the body. The other track then
    shows no person.
    """
    read = {row: reading for row, one in enumerate(targets) if (reading := one.reading)}

    def rank(row: int) -> tuple[float, float]:
        target, reading = targets[row], read[row]
        if target.followed:
            return 1.0, -target.found.box.iou(reading.landmarks.box())
        return -agreement(reading, target.found.keypoints), 0.0

    order = sorted(read, key=rank)
    first = first_of_body([read[row] for row in order])
    best = {row: order[one] for row, one in zip(order, first, strict=True)}
    return {
        row: one
        for row, one in best.items()
        if row == one or not (targets[row].followed and targets[one].followed)
    }
