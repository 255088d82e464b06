"""Silhouettes: each pixel is one person's, within the box and the frame."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.vision.geometry import Box
from app.vision.masks import LabelImage
from app.vision.optics import PinholeCamera
from app.vision.people import Detection, Silhouette
from app.vision.person_reader import PersonReader
from app.vision.same_person import first_of_body
from app.vision.silhouettes import DrawnSilhouette, silhouettes_from_labels, silhouettes_of
from tests.app.painted import painted

SHAPE = (240, 320, 3)


def mask_of(one: Silhouette | None, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    assert one is not None
    return one.mask(shape)


def cut_out(boxes: list[Box], *, exact: bool = True) -> list[Silhouette | None]:
    return silhouettes_of([painted(box) for box in boxes], boxes, SHAPE, exact=exact)


some_boxes = st.lists(
    st.builds(
        Box, st.floats(-30, 280), st.floats(-30, 200), st.floats(15, 120), st.floats(30, 200)
    ),
    min_size=1,
    max_size=4,
)


@given(boxes=some_boxes, exact=st.booleans())
@example(boxes=[Box(0.0, 0.0, 15.0, 44.0), Box(1.0, 0.0, 15.0, 31.0)], exact=False)
def test_pixels_are_not_shared(boxes: list[Box], exact: bool) -> None:
    readings = [painted(box) for box in boxes]
    assume(first_of_body(readings) == [*range(len(boxes))])
    found = silhouettes_of(readings, boxes, SHAPE, exact=exact)
    masks = [one.mask(SHAPE) for one in found if one is not None]
    claimed = np.sum(masks, axis=0) if masks else np.zeros(SHAPE[:2])
    # Holes of less than a hundredth of a mask are filled, even where another person shows in them.
    shared = (claimed > 1).astype(np.uint8)
    _, _, stats, _ = cv2.connectedComponentsWithStats(shared, connectivity=4)
    holes = stats[1:, cv2.CC_STAT_AREA]
    assert (holes <= 0.01 * sum(mask.sum() for mask in masks)).all()


@given(boxes=some_boxes)
@example(boxes=[Box(0.0, 239.0, 2.0, 2.0)])
@example(boxes=[Box(319.0, 0.0, 2.0, 2.0)])
def test_silhouettes_lie_in_an_exact_box_and_in_the_frame(boxes: list[Box]) -> None:
    for one, box in zip(cut_out(boxes), boxes, strict=True):
        if one is None:
            continue
        rows, columns = one.crop.shape
        assert one.left + columns <= SHAPE[1] and one.top + rows <= SHAPE[0]
        # Boxes that end just short of the frame's edge are cut by it.
        edges = (0, 0, SHAPE[1], SHAPE[0])
        found = (one.left, one.top, one.left + columns, one.top + rows)
        for side, (inner, outer, edge) in enumerate(zip(found, box.pixels(), edges, strict=True)):
            beyond = outer - inner if side < 2 else inner - outer
            assert beyond <= 0 or (inner == edge and beyond <= 6)


@given(
    width=st.integers(20, 120), height=st.integers(40, 200), x=st.integers(10, 150),
    y=st.integers(5, 30), roll_deg=st.floats(-180, 180),
)  # fmt: skip
def test_silhouette_is_what_the_mask_marks_in_any_orientation(
    width: int, height: int, x: int, y: int, roll_deg: float
) -> None:
    box = Box(x - 0.5, y - 0.5, width, height)
    (one,) = silhouettes_of([painted(box, roll_deg=roll_deg)], [box], SHAPE, exact=True)
    found = mask_of(one, SHAPE)
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    across = 2 * (columns - box.x - box.width / 2) / box.width
    down = 2 * (rows - box.y - box.height / 2) / box.height
    expected = 0.95 * (1.3 - across**2 - down**2) >= 0.5
    # Half a pixel along the outline.
    assert np.count_nonzero(found ^ expected) <= 0.5 * 2 * (width + height)


def test_pixel_claimed_by_two_goes_to_the_surer() -> None:
    left, right = Box(49.5, 29.5, 80, 180), Box(99.5, 29.5, 80, 180)
    masks = [mask_of(one, SHAPE) for one in cut_out([left, right])]
    both = [mask_of(*cut_out([box]), SHAPE) for box in (left, right)]
    shared = both[0] & both[1]
    columns = np.broadcast_to(np.arange(SHAPE[1]), SHAPE[:2])
    middle = (left.x + right.x + left.width) / 2
    middling = shared & (np.abs(columns - middle) > 2)
    assert middling.any()
    assert (masks[0] == (both[0] & (columns < middle)))[middling].all()
    assert (masks[1] == (both[1] & (columns > middle)))[middling].all()


def test_inexact_box_is_widened_to_visible_limbs() -> None:
    body, found = Box(99.5, 19.5, 80, 200), Box(119.5, 59.5, 40, 120)
    reading = painted(body)
    (exact,) = silhouettes_of([reading], [found], SHAPE, exact=True)
    (wider,) = silhouettes_of([reading], [found], SHAPE, exact=False)
    assert exact is not None and wider is not None
    assert exact.box.height <= 121 < 170 < wider.box.height
    unseen = replace(reading.landmarks, visibility=np.zeros(33))
    blind = replace(reading, landmarks=unseen)
    (same,) = silhouettes_of([blind], [found], SHAPE, exact=False)
    assert (mask_of(same, SHAPE) == mask_of(exact, SHAPE)).all()


@pytest.mark.parametrize(("gap", "is_cut"), [(0, True), (5, True), (14, False)])
@pytest.mark.parametrize("edge", ["left", "top", "right", "bottom"])
def test_box_just_short_of_the_frames_edge_is_extended_to_it(
    edge: str, gap: int, is_cut: bool
) -> None:
    """If the body goes on beyond the edge."""
    bottom, right = SHAPE[0] - 0.5, SHAPE[1] - 0.5
    body, visible = {
        "left": ((-50.5, 19.5, 89.5, 219.5), (gap - 0.5, 19.5, 89.5, 219.5)),
        "top": ((99.5, -60.5, 189.5, 139.5), (99.5, gap - 0.5, 189.5, 139.5)),
        "right": ((229.5, 19.5, 369.5, 219.5), (229.5, 19.5, right - gap, 219.5)),
        "bottom": ((99.5, 99.5, 189.5, 299.5), (99.5, 99.5, 189.5, bottom - gap)),
    }[edge]
    reading = painted(Box.from_edges(*body))
    (found,) = silhouettes_of([reading], [Box.from_edges(*visible)], SHAPE, exact=True)
    mask = mask_of(found, SHAPE)
    border = {"left": mask[:, 0], "top": mask[0], "right": mask[:, -1], "bottom": mask[-1]}[edge]
    assert border.any() == is_cut
    assert found is not None and found.truncated == is_cut


ODD_BOXES = [Box(-30, -20, 50, 60), Box(5, 5, 1, 1), Box(200, 200, 10, 10), Box(0, 0, 300, 2),
             Box(-0.5, -0.5, 298, 320)]  # fmt: skip


def own(
    reader: PersonReader, frame: NDArray[np.uint8], boxes: list[Box]
) -> list[Silhouette | None]:
    camera = PinholeCamera.of_frame(frame.shape)
    found = [reader.read(frame, camera, Detection(box, 1.0)) for box in boxes]
    readings = [reader.with_mask(one) for one in found]
    return silhouettes_of(readings, boxes, frame.shape, exact=True)


@pytest.mark.parametrize("shape", [(320, 298, 3), (1, 1, 3), (3, 900, 3)])
def test_odd_boxes_and_blank_walls_raise_nothing(
    person_reader: PersonReader, shape: tuple[int, ...]
) -> None:
    blank = np.full(shape, 127, np.uint8)
    assert len(own(person_reader, blank, ODD_BOXES)) == len(ODD_BOXES)
    assert silhouettes_of([], [], shape, exact=True) == []


def test_walkers_are_cut_out(
    person_reader: PersonReader, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    for one, box in zip(own(person_reader, street, walkers), walkers, strict=True):
        assert one is not None and one.segmenter == "network" and not one.truncated
        assert one.box.iou(box) > 0.7
        assert 0.25 < one.area_px / box.area < 0.75


def test_a_drawn_silhouette_moves_along_with_the_landmarks_of_the_same_shape() -> None:
    reading = painted(Box(100.0, 60.0, 60.0, 120.0))
    (silhouette,) = silhouettes_of([reading], [Box(100.0, 60.0, 60.0, 120.0)], SHAPE, exact=True)
    assert silhouette is not None
    positions = reading.landmarks.positions
    drawn = DrawnSilhouette(silhouette, positions)

    def moved(to: NDArray[np.float64]) -> Silhouette | None:
        landmarks = replace(reading.landmarks, positions=to)
        return drawn.on_landmarks(replace(reading, landmarks=landmarks), SHAPE)

    away = moved(positions + np.array([30.0, -20.0]))
    assert away is not None
    assert np.array_equal(away.crop, silhouette.crop)
    assert (away.left, away.top) == (silhouette.left + 30, silhouette.top - 20)
    middle = positions.mean(axis=0)
    larger = moved(middle + 1.05 * (positions - middle))
    assert larger is not None
    assert larger.area_px == pytest.approx(1.05**2 * silhouette.area_px, rel=0.05)
    turned = (positions - middle) @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    assert moved(middle + turned) is None
    assert moved(positions - np.array([120.0, 0.0])) is None  # Beyond the border.
    cut = DrawnSilhouette(replace(silhouette, truncated=True), positions)
    assert cut.on_landmarks(reading, SHAPE) is None


def test_labels_become_silhouettes_from_left_to_right() -> None:
    labels = np.zeros((20, 30), np.uint16)
    labels[3:9, 20:25] = 1
    labels[2:9, 3:8] = 7
    people = silhouettes_from_labels(LabelImage.of(labels))
    assert [one.left for one in people] == [3, 20]
    for one, label in zip(people, (7, 1), strict=True):
        assert one.segmenter == "mask"
        assert (one.mask(labels.shape) == (labels == label)).all()
    assert silhouettes_from_labels(LabelImage.of(labels * 0)) == []
