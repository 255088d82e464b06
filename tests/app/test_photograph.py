"""The estimator, with real networks on a real photograph."""

from copy import copy
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app import photograph
from app.estimation.results import Person
from app.estimation.upload import Upload, UploadError
from app.photograph import Estimator, fit_poses, network_threads, normalise_person
from app.scheduling.job import DeadlineError, Job
from app.vision.blazepose import MaskNetwork, PoseReading
from app.vision.geometry import Box
from app.vision.optics import Optics, PinholeCamera
from app.vision.people import LANDMARK_NAMES, Landmarks
from app.vision.person_reader import PersonReader
from index.landmark_matching import match_landmarks
from index.matching import Match
from index.posture import LOW, vote_posture
from tests.conftest import Photo, png
from tests.support.jobs import LateJob, ShortJob
from tests.support.rotation import rotate_box, rotate_points

WALKER = Box(135, 162, 40, 105)


@pytest.fixture(scope="module")
def walker(estimator: Estimator, street: NDArray[np.uint8]) -> Person:
    """The walker in `WALKER`."""
    (person,) = persons(estimator, Upload(png(street), boxes=(WALKER,)))
    return person


def persons(estimator: Estimator, upload: Upload, evidence: str = "photograph") -> list[Person]:
    return list(estimator.estimate(upload, 5, Job(), evidence).persons)  # type: ignore[arg-type]


def mask_of(person: Person, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    assert person.silhouette is not None
    return person.silhouette.mask(shape).astype(np.uint8)


def landmarks_of(person: Person) -> Landmarks:
    assert person.landmarks is not None
    return person.landmarks


@pytest.mark.parametrize("concurrency", [1, 2, 3, 64])
@pytest.mark.parametrize("cores", [1, 2, 3, 8, 64])
def test_network_passes_share_the_cores(cores: int, concurrency: int) -> None:
    threads, copies = network_threads(cores, concurrency)
    assert threads == min(2, cores)
    assert threads * copies <= cores
    # No more copies than frames, and no core idle while there are frames for it.
    assert copies == concurrency or threads * (copies + 1) > cores


class Unread:
    """A reader that must not read anybody."""

    def read(self, *_: object) -> PoseReading:
        raise AssertionError("expected nothing to be read, got a call of the reader")


class Blind:
    """Reads people, but the masks of its readings are empty."""

    def __init__(self, reader: PersonReader) -> None:
        self.reader = reader

    def read(self, *where: Any) -> PoseReading:
        return self.reader.read(*where)

    def with_mask(self, reading: PoseReading) -> PoseReading:
        reading = self.reader.with_mask(reading)
        return replace(reading, probability=np.zeros_like(reading.probability))


def reading_with(estimator: Estimator, reader: object) -> Estimator:
    """An estimator with another reader."""
    models = replace(estimator.models, reader=reader)  # type: ignore[arg-type]
    limits = {"min_person_px": None, "max_pixels": 10**6, "max_persons": 9}
    return Estimator(estimator.index, models, **limits)  # type: ignore[arg-type]


def test_of_a_photograph_beside_a_mask_silhouette_evidence_needs_the_size_alone(
    estimator: Estimator, street: NDArray[np.uint8], walker: Person
) -> None:
    jpeg = cv2.imencode(".jpg", street)[1].tobytes()
    mask = png(mask_of(walker, street.shape))
    for frame in (jpeg, jpeg[:2000]):
        (person,) = persons(estimator, Upload(frame, mask=mask), "silhouette")
        (alone,) = persons(estimator, Upload(mask=mask), "silhouette")
        assert [one.entry_id for one in person.hypotheses] == [
            one.entry_id for one in alone.hypotheses
        ]
    for reason, other in (("undecodable", jpeg[:100]), ("misfit", png(street[1:]))):
        with pytest.raises(UploadError) as error:
            persons(estimator, Upload(other, mask=mask), "silhouette")
        assert error.value.reason == reason


@pytest.mark.parametrize("source", ["detector", "boxes", "mask", "background"])
def test_silhouette_evidence_ignores_the_photograph(
    estimator: Estimator, street: NDArray[np.uint8], walker: Person, source: str
) -> None:
    if source in ("mask", "background"):  # Else what is read cuts people out.
        estimator = reading_with(estimator, Unread())
    wide = (WALKER, Box(100, 150, 120, 100))
    empty = street.copy()
    empty[150:270, 120:185] = street[30:150, 60:125]
    upload = {
        "detector": Upload(png(street)),
        "boxes": Upload(png(street), boxes=wide),
        "mask": Upload(png(street), mask=png(mask_of(walker, street.shape))),
        "background": Upload(png(street), background=png(empty)),
    }[source]
    found = persons(estimator, upload, "silhouette")
    assert found
    for person in found:
        assert person.source == source
        assert person.landmarks is None
        if person.silhouette is None:
            continue
        assert person.facing is not None and person.facing.evidence == "none"
        for placed in person.hypotheses:
            assert placed.adjusted_m < 0.2
            assert placed.distance >= placed.silhouette_distance


@pytest.mark.parametrize("source", ["detector", "boxes", "mask"])
def test_masks_are_drawn_for_those_who_are_kept_alone(
    estimator: Estimator,
    street: NDArray[np.uint8],
    walker: Person,
    monkeypatch: pytest.MonkeyPatch,
    source: str,
) -> None:
    drawn: list[PoseReading] = []
    draw = MaskNetwork.read

    def count(network: MaskNetwork, reading: PoseReading) -> PoseReading:
        drawn.append(reading)
        return draw(network, reading)

    monkeypatch.setattr(MaskNetwork, "read", count)
    upload = {
        "detector": Upload(png(street)),
        "boxes": Upload(png(street), boxes=(WALKER,)),
        "mask": Upload(png(street), mask=png(mask_of(walker, street.shape))),
    }[source]
    found = persons(estimator, upload)
    assert found
    assert len(drawn) == (0 if source == "mask" else len(found))


LEAN_DEG = {1: 90.0, 2: 180.0, 3: -90.0}
"""Clockwise rotation of a picture that so many clockwise quarter turns make."""


# A person upside down in a box is not read: MoveNet, which finds the head, does not recognise them.
@pytest.mark.parametrize("quarter_turns", [1, 3])
def test_boxes_and_masks_of_lying_people_are_read(
    estimator: Estimator, street: NDArray[np.uint8], walker: Person, quarter_turns: int
) -> None:
    frame = np.ascontiguousarray(np.rot90(street, -quarter_turns))
    box = rotate_box(WALKER, street.shape, -quarter_turns)
    (by_box,) = persons(estimator, Upload(png(frame), boxes=(box,)))
    expected = np.rot90(mask_of(walker, street.shape), -quarter_turns)
    ours = mask_of(by_box, frame.shape)
    assert (expected & ours).sum() / (expected | ours).sum() > 0.9
    (by_mask,) = persons(estimator, Upload(png(frame), mask=png(ours)))
    there = rotate_points(landmarks_of(walker).positions, street.shape, -quarter_turns)
    for person in (by_box, by_mask):
        apart = np.linalg.norm(landmarks_of(person).positions - there, axis=1)
        assert apart.mean() < 0.05 * WALKER.height
        roll_deg = person.hypotheses[0].label.roll_deg - LEAN_DEG[quarter_turns]
        assert abs((roll_deg + 180) % 360 - 180) <= 45
        assert person.hypotheses[0].posture in LOW


def test_a_window_that_may_show_nobody_has_less_confidence(
    estimator: Estimator, walker: Person, street: NDArray[np.uint8]
) -> None:
    camera = PinholeCamera.of_frame(street.shape[:2])
    sure, doubtful = (
        fit_poses(
            estimator.index, replace(walker, presence=presence), normalise_person(walker), camera, 5
        )
        for presence in (1.0, 0.4)
    )
    assert [one.confidence for one in doubtful.hypotheses] == pytest.approx(
        [0.4 * one.confidence for one in sure.hypotheses]
    )
    assert doubtful.posture is not None
    # That of the likeliest group, such as all who are upright.
    assert doubtful.posture.probability <= 0.4
    assert doubtful.posture.label == "unclear"


@pytest.mark.parametrize("feet", [True, False])
def test_people_whose_feet_are_not_seen_do_not_walk(
    estimator: Estimator, walker: Person, monkeypatch: pytest.MonkeyPatch, feet: bool
) -> None:
    def match_walkers(*args: Any, **options: Any) -> Match:
        found = match_landmarks(*args, **options)
        return replace(found, postures=vote_posture(["walking"], [1.0]))

    monkeypatch.setattr(photograph, "match_landmarks", match_walkers)
    visibility = landmarks_of(walker).visibility.copy()
    for name in ("left_ankle", "right_ankle"):
        visibility[LANDMARK_NAMES.index(name)] = 0.9 if feet else 0.0
    one = replace(walker, landmarks=replace(landmarks_of(walker), visibility=visibility))
    camera = PinholeCamera.of_frame((576, 536))
    posture = fit_poses(estimator.index, one, normalise_person(one), camera, 5).posture
    assert posture is not None
    assert (posture.share(["walking"]) > 0.5) == feet


def test_box_without_a_silhouette_has_no_poses(
    estimator: Estimator, street: NDArray[np.uint8]
) -> None:
    estimator = reading_with(estimator, Blind(estimator.models.reader))
    (person,) = persons(estimator, Upload(png(street), boxes=(WALKER,)))
    assert person.box == WALKER
    assert person.silhouette is None
    assert (person.facing, person.hypotheses) == (None, ())
    # What the detector finds without one was hardly a person.
    assert persons(estimator, Upload(png(street))) == []


def test_cancelled_job_stops(estimator: Estimator, photo: Photo) -> None:
    for steps in range(4):
        with pytest.raises(DeadlineError):
            estimator.estimate(Upload(photo.frame_png, mask=photo.mask_png), 1, ShortJob(steps))


def test_people_beyond_the_deadline_are_left_out_with_a_warning(
    estimator: Estimator, street: NDArray[np.uint8]
) -> None:
    """Those with the highest scores stay, unless the caller says who the people are."""
    upload = Upload(png(street))
    everyone = estimator.estimate(upload, 1, LateJob(1000))
    assert everyone.warnings == ()
    scores = sorted((one.detection_score or 0 for one in everyone.persons), reverse=True)
    for in_time in (0, 2):
        some = estimator.estimate(upload, 1, LateJob(in_time))
        assert 1 <= len(some.persons) < len(scores)
        assert some.warnings == ("crowded",)
        kept = sorted((one.detection_score or 0 for one in some.persons), reverse=True)
        assert kept == scores[: len(kept)]
        assert all(one.hypotheses for one in some.persons)
    marked = Upload(png(street), boxes=tuple(one.box for one in everyone.persons))
    answer = estimator.estimate(marked, 1, LateJob(0))
    assert (len(answer.persons), answer.warnings) == (len(scores), ())


def test_too_many_people_are_left_out_with_a_warning(
    estimator: Estimator, street: NDArray[np.uint8]
) -> None:
    finder = replace(estimator.finder, max_persons=1)
    few = copy(estimator)
    few.finder = finder
    answer = few.estimate(Upload(png(street)), 1)
    assert (len(answer.persons), answer.warnings) == (1, ("crowded",))


def flags(estimator: Estimator, frame: NDArray[np.uint8], box: Box) -> tuple[bool, bool]:
    """Whether the person in a box is flagged as cut: by the silhouette alone, by keypoints too."""
    found = []
    for evidence in ("silhouette", "photograph"):
        (person,) = persons(estimator, Upload(png(frame), boxes=(box,)), evidence)
        assert person.silhouette is not None
        found.append(person.silhouette.truncated)
    return found[0], found[1]


# With more of the head and chest cut off, the network makes out a smaller person.
@pytest.mark.parametrize(
    ("edge", "hidden"),
    [("left", 0.3), ("right", 0.4), ("bottom", 0.3), ("bottom", 0.6), ("top", 0.3)],
)
def test_person_cut_by_the_frame_is_flagged(
    estimator: Estimator, street: NDArray[np.uint8], edge: str, hidden: float
) -> None:
    left, top, right, bottom = WALKER.pixels()
    across, down = round(hidden * (right - left)), round(hidden * (bottom - top))
    rows, columns = {
        "left": (slice(None), slice(left + across, None)),
        "top": (slice(top + down, None), slice(None)),
        "right": (slice(None), slice(None, right - across)),
        "bottom": (slice(None, bottom - down), slice(None)),
    }[edge]
    frame = np.ascontiguousarray(street[rows, columns])
    box = Box(WALKER.x - (columns.start or 0), WALKER.y - (rows.start or 0), 40, 105)
    visible = box.clip(frame.shape[1], frame.shape[0])
    assert visible is not None
    assert flags(estimator, frame, visible)[1]


def test_whole_person_is_not_flagged(estimator: Estimator, street: NDArray[np.uint8]) -> None:
    assert flags(estimator, street, WALKER) == (False, False)
    for room in (8, 30):
        left, top, right, bottom = WALKER.pixels()
        loose = np.ascontiguousarray(street[top - room : bottom + room, left - room : right + room])
        assert flags(estimator, loose, Box(room - 0.5, room - 0.5, 40, 105)) == (False, False)


@pytest.mark.parametrize("quarter_turns", [1, 2])
def test_a_turned_camera_sees_the_people_of_an_upright_one(
    estimator: Estimator, street: NDArray[np.uint8], quarter_turns: int
) -> None:
    """A camera that was rotated clockwise turns its picture counterclockwise."""
    turned = np.rot90(street, quarter_turns).copy()
    upright = persons(estimator, Upload(street))
    rolled = persons(estimator, Upload(turned, optics=Optics(roll_deg=90 * quarter_turns)))
    boxes = [rotate_box(one.box, street.shape, quarter_turns) for one in upright]
    assert len(rolled) == len(boxes) >= 2
    for person in rolled:
        nearest = max(range(len(boxes)), key=lambda i: boxes[i].iou(person.box))
        same = upright[nearest]
        assert vars(person.box) == pytest.approx(vars(boxes[nearest]), abs=1e-6)
        assert person.posture and same.posture and person.posture.label == same.posture.label
        there = rotate_points(landmarks_of(same).positions, street.shape, quarter_turns)
        assert landmarks_of(person).positions == pytest.approx(there, abs=1e-6)
        mask = np.rot90(mask_of(same, street.shape), quarter_turns)
        assert (mask_of(person, turned.shape) == mask).all()


def test_a_person_half_behind_another_is_found(
    estimator: Estimator, street: NDArray[np.uint8], walker: Person
) -> None:
    """Both networks look at the person in front, so the first reading of both may be the same."""
    for size, shift in [(1, -14), (1, 16), (3, -18), (3, 24)]:
        frame, mask = (
            cv2.resize(image, None, fx=size, fy=size, interpolation=cv2.INTER_NEAREST)
            for image in (street, mask_of(walker, street.shape))
        )
        there = np.roll(mask, shift * size, axis=1) > 0
        both = np.where(there[..., None], np.roll(frame, shift * size, axis=1), frame)
        people = persons(estimator, Upload(png(both)))
        boxes = [
            Box(size * left, size * WALKER.y, size * WALKER.width, size * WALKER.height)
            for left in (WALKER.x, WALKER.x + shift)
        ]
        assert all(sum(box.iou(one.box) > 0.6 for one in people) == 1 for box in boxes)
