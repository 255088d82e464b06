"""What an estimator asks of the photograph, and when."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from app.estimates import ObservedPerson, Person, Scene
from app.estimator import Estimator, network_threads
from app.settings import Settings
from app.stopwatch import Stopwatch
from app.upload import Upload
from app.vision.people import Box, ObservedKeypoints
from app.vision.rotation import rotate_box, rotate_keypoints, rotate_points, rotate_silhouette
from index.landmark_search import rotate_clockwise
from index.posture import LOW
from tests.conftest import ROOT, Photo, png

WALKER = Box(135, 162, 40, 105)


@pytest.fixture(scope="module")
def street() -> NDArray[np.uint8]:
    return cv2.imread(str(ROOT / "tests" / "data" / "walkers.jpg"))


@pytest.fixture(scope="module")
def walker(estimator: Estimator, street: NDArray[np.uint8]) -> Person:
    """The walker in `WALKER`."""
    (person,) = persons(estimator, Upload(png(street), boxes=(WALKER,)))
    return person


def persons(estimator: Estimator, upload: Upload, evidence: str = "photograph") -> list[Person]:
    return list(estimator.estimate(upload, 5, lambda: None, evidence).persons)  # type: ignore[arg-type]


def poses(person: Person) -> list[tuple[int, bool, float]]:
    """The hypotheses of a person."""
    return [
        (placed.hypothesis.entry, placed.hypothesis.mirrored, placed.hypothesis.distance)
        for placed in person.hypotheses
    ]


def mask_of(person: Person, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    assert person.observed.silhouette is not None
    return person.observed.silhouette.mask(shape).astype(np.uint8)


@pytest.mark.parametrize("concurrency", [1, 2, 3, 64])
@pytest.mark.parametrize("cores", [1, 2, 3, 8, 64])
def test_passes_of_a_network_share_the_cores(cores: int, concurrency: int) -> None:
    threads, copies = network_threads(cores, concurrency)
    assert threads == min(2, cores)
    assert threads * copies <= cores
    # No more copies than frames, and no core idle while there are frames for it.
    assert copies == concurrency or threads * (copies + 1) > cores


def test_the_photograph_is_evidence(walker: Person) -> None:
    assert walker.facing is not None and walker.facing.evidence == "image"
    assert walker.observed.keypoints is not None
    assert any(placed.hypothesis.log_likelihood < 0 for placed in walker.hypotheses)
    confidences = [placed.confidence for placed in walker.hypotheses]
    assert confidences == sorted(confidences, reverse=True)
    distances = [placed.distance for placed in walker.hypotheses]
    assert distances == sorted(distances)


def test_poses_lie_on_the_keypoints(walker: Person) -> None:
    """The stick figures of the index are no walkers, but their ankles are down."""
    keypoints = walker.observed.keypoints
    assert keypoints is not None
    best = walker.hypotheses[0].points_2d
    head, ankle = best[4], best[[13, 17]].mean(axis=0)
    assert np.linalg.norm(head - keypoints.positions[0]) < 0.2 * WALKER.height
    assert np.linalg.norm(ankle - keypoints.positions[15:].mean(axis=0)) < 0.2 * WALKER.height


@pytest.mark.parametrize("source", ["detector", "boxes", "mask", "background"])
def test_by_the_silhouette_alone_nothing_is_read(
    estimator: Estimator,
    street: NDArray[np.uint8],
    walker: Person,
    monkeypatch: pytest.MonkeyPatch,
    source: str,
) -> None:
    def fail(*_: object) -> None:
        raise AssertionError("expected nothing to be read, got a call of the reader")

    monkeypatch.setattr(estimator.finder.reader, "read", fail)
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
        assert person.observed.source == source
        assert person.observed.keypoints is None
        if person.observed.silhouette is None:
            continue
        assert person.facing is not None and person.facing.evidence == "none"
        for placed in person.hypotheses:
            assert placed.hypothesis.log_likelihood == 0
            assert placed.distance == placed.hypothesis.distance


def test_a_mask_with_its_photograph_is_answered_as_the_same_box(
    estimator: Estimator, street: NDArray[np.uint8], walker: Person
) -> None:
    mask = mask_of(walker, street.shape)
    (by_mask,) = persons(estimator, Upload(png(street), mask=png(mask)))
    assert by_mask.facing is not None and by_mask.facing.evidence == "image"
    # The box is now that of the silhouette, so what is read differs a little.
    ours, theirs = by_mask.observed.keypoints, walker.observed.keypoints
    assert ours is not None and theirs is not None
    apart = np.linalg.norm(ours.positions - theirs.positions, axis=1)
    assert np.median(apart) < 0.03 * WALKER.height
    assert_array_equal(mask_of(by_mask, street.shape), mask)


def test_a_mask_alone_is_answered_as_by_the_silhouette_alone(
    estimator: Estimator, street: NDArray[np.uint8], walker: Person
) -> None:
    mask = png(mask_of(walker, street.shape))
    alone = estimator.estimate(Upload(mask=mask), 5, lambda: None)
    assert alone.frame.shape == street.shape and not alone.frame.any()
    (expected,) = persons(estimator, Upload(png(street), mask=mask), "silhouette")
    for evidence in ("photograph", "silhouette"):
        (person,) = persons(estimator, Upload(mask=mask), evidence)
        assert poses(person) == poses(expected)
        assert person.facing == expected.facing
        assert person.observed.keypoints is None
        for ours, theirs in zip(person.hypotheses, expected.hypotheses, strict=True):
            assert_array_equal(ours.points_2d, theirs.points_2d)


def test_the_camera_of_somebody_who_leans_is_turned(estimator: Estimator, walker: Person) -> None:
    for placed in walker.hypotheses:
        one = placed.hypothesis
        label = estimator.index.label(one.entry, mirrored=one.mirrored)
        assert placed.label.roll_deg == pytest.approx(label.roll_deg + one.rotation_deg)
        assert placed.label.roll_deg == one.tilt_deg


# Upside down, silhouettes are not wide: only keypoints tell.
@pytest.mark.parametrize(
    ("quarter_turns", "seen"), [(1, True), (2, True), (3, True), (1, False), (3, False)]
)
def test_somebody_who_lies_has_the_poses_of_the_same_person_upright(
    estimator: Estimator, street: NDArray[np.uint8], walker: Person, quarter_turns: int, seen: bool
) -> None:
    shape = street.shape
    silhouette, keypoints = walker.observed.silhouette, walker.observed.keypoints
    assert silhouette is not None and keypoints is not None

    def answer(frame: NDArray[np.uint8], found: ObservedPerson) -> Person:
        scene = Scene(frame, (found,))
        return estimator.with_hypotheses(scene, 5, lambda: None, Stopwatch())[0]

    def read(back: int) -> ObservedKeypoints | None:
        return rotate_keypoints(keypoints, shape, back) if seen else None

    upright = answer(street, ObservedPerson(silhouette.box, "detector", 0.9, silhouette, read(0)))
    lies = rotate_silhouette(silhouette, shape, -quarter_turns)
    lying = answer(
        np.ascontiguousarray(np.rot90(street, -quarter_turns)),
        ObservedPerson(lies.box, "detector", 0.9, lies, read(-quarter_turns), quarter_turns),
    )
    assert upright.facing is not None and lying.facing is not None
    assert upright.facing.evidence == lying.facing.evidence
    if seen:
        ours, theirs = (one.facing.front_probability for one in (lying, upright))
        assert ours == pytest.approx(theirs, abs=0.1)
    lean = {1: 90, 2: 180, 3: -90}[quarter_turns]

    first = upright.hypotheses[0]
    body = rotate_clockwise(first.hypothesis.points_3d, lean)
    # Rotated to stand, the silhouette is a few degrees off and sampled anew; by the silhouette
    # alone, another may come first.
    gaps = [
        np.linalg.norm(other.hypothesis.points_3d - body, axis=1).mean()
        for other in lying.hypotheses[: 1 if seen else None]
    ]
    same = lying.hypotheses[int(np.argmin(gaps))]
    assert min(gaps) < 0.06
    picture = rotate_points(first.points_2d, shape, -quarter_turns)
    assert np.linalg.norm(same.points_2d - picture, axis=1).mean() < 3
    off = same.hypothesis.tilt_deg - first.hypothesis.tilt_deg - lean
    assert (off + 180) % 360 - 180 == pytest.approx(0, abs=15)
    assert {one.hypothesis.posture for one in upright.hypotheses} == {"standing"}
    assert same.hypothesis.posture in LOW


@pytest.mark.parametrize("quarter_turns", [1, 3])
def test_wide_boxes_and_masks_are_read_for_which_way_up_they_are(
    estimator: Estimator, street: NDArray[np.uint8], walker: Person, quarter_turns: int
) -> None:
    lying = np.ascontiguousarray(np.rot90(street, -quarter_turns))
    box = rotate_box(WALKER, street.shape, -quarter_turns)
    (by_box,) = persons(estimator, Upload(png(lying), boxes=(box,)))
    assert (walker.observed.quarter_turns, by_box.observed.quarter_turns) == (0, quarter_turns)
    # Cut out and read upright, both are what they were.
    expected = np.rot90(mask_of(walker, street.shape), -quarter_turns)
    ours = mask_of(by_box, lying.shape)
    assert (expected & ours).sum() / (expected | ours).sum() > 0.95
    keypoints = walker.observed.keypoints
    assert keypoints is not None and by_box.observed.keypoints is not None
    there = rotate_keypoints(keypoints, street.shape, -quarter_turns)
    assert_allclose(by_box.observed.keypoints.positions, there.positions, atol=2)
    (by_mask,) = persons(estimator, Upload(png(lying), mask=png(ours)))
    assert by_mask.observed.quarter_turns == quarter_turns
    for lying_person in (by_box, by_mask):
        assert abs(lying_person.hypotheses[0].label.roll_deg) >= 45
    (plain,) = persons(estimator, Upload(png(lying), boxes=(box,)), "silhouette")
    assert plain.observed.quarter_turns == 0, "only keypoints tell which way up somebody is"


def test_who_lies_is_found_by_the_detector(estimator: Estimator, street: NDArray[np.uint8]) -> None:
    lying = np.ascontiguousarray(np.rot90(street))
    truth = rotate_box(WALKER, street.shape, 1)
    found = persons(estimator, Upload(png(lying)))
    (person,) = (person for person in found if person.observed.box.iou(truth) > 0.5)
    assert person.observed.quarter_turns == 3
    assert person.facing is not None and person.facing.evidence == "image"
    boxes = estimator.detect(png(lying), lambda: None)
    assert {other.quarter_turns for other in boxes} == {3}


def test_people_come_left_to_right(estimator: Estimator, street: NDArray[np.uint8]) -> None:
    boxes = [person.observed.box.x for person in persons(estimator, Upload(png(street)))]
    assert len(boxes) >= 3
    assert boxes == sorted(boxes)


def test_a_box_without_a_silhouette_has_no_poses(
    estimator: Estimator, street: NDArray[np.uint8], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(estimator.segmenter, "segment", lambda _, boxes: [None] * len(boxes))
    (person,) = persons(estimator, Upload(png(street), boxes=(WALKER,)))
    assert person.observed.box == WALKER
    assert (person.observed.silhouette, person.observed.keypoints) == (None, None)
    assert (person.facing, person.hypotheses) == (None, ())
    # What the detector finds without one was hardly a person.
    assert persons(estimator, Upload(png(street))) == []


@pytest.mark.parametrize("name", ["network", "hog"])
def test_the_detector_is_the_one_that_is_set(
    settings: Settings, street: NDArray[np.uint8], name: str
) -> None:
    chosen = Estimator.load(settings.model_copy(update={"detector": name}))
    assert chosen.detector.name == name
    chosen.warm_up()
    found = chosen.estimate(Upload(png(street)), 1, lambda: None).persons
    assert any(person.observed.box.iou(WALKER) > 0.5 for person in found)
    assert {person.observed.source for person in found} == {"detector"}


def test_it_stops_where_the_work_is_no_longer_wanted(estimator: Estimator, photo: Photo) -> None:
    class GoneError(Exception):
        pass

    for steps in range(4):
        left = iter(range(steps))

        def check(left: object = left) -> None:
            if next(left, None) is None:  # type: ignore[call-overload]
                raise GoneError

        with pytest.raises(GoneError):
            estimator.estimate(Upload(photo.frame_png, mask=photo.mask_png), 1, check)


def test_all_stages_are_timed(estimator: Estimator, street: NDArray[np.uint8]) -> None:
    timings = estimator.estimate(Upload(png(street)), 1, lambda: None).timings_ms
    total = timings.pop("total")
    assert all(spent > 0 for spent in timings.values())
    assert sum(timings.values()) <= total


def flags(estimator: Estimator, frame: NDArray[np.uint8], box: Box) -> tuple[bool, bool]:
    """Whether the person in a box is flagged as cut: by the silhouette alone, by keypoints too."""
    scene = estimator.find_people(Upload(png(frame), boxes=(box,)), lambda: None, Stopwatch())
    read = estimator.with_keypoints(scene, lambda: None, Stopwatch())
    (before,), (after,) = scene.people, read.people
    assert before.silhouette is not None and after.silhouette is not None
    return before.silhouette.truncated, after.silhouette.truncated


@pytest.mark.parametrize("edge", ["left", "top", "right", "bottom"])
@pytest.mark.parametrize("hidden", [0.3, 0.4, 0.6])
def test_somebody_cut_by_an_edge_is_flagged(
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


def test_keypoints_tell_of_a_head_above_the_frame_where_the_box_ends_short_of_it(
    estimator: Estimator, street: NDArray[np.uint8]
) -> None:
    large = cv2.resize(street[192:, 110:200], None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
    assert flags(estimator, large, Box(75, 8.5, 120, 216)) == (False, True)


def test_whole_people_are_not_flagged(estimator: Estimator, street: NDArray[np.uint8]) -> None:
    assert flags(estimator, street, WALKER) == (False, False)
    for room in (8, 15, 30):
        left, top, right, bottom = WALKER.pixels()
        loose = np.ascontiguousarray(street[top - room : bottom + room, left - room : right + room])
        assert flags(estimator, loose, Box(room - 0.5, room - 0.5, 40, 105)) == (False, False)
