"""Detection: one box for each person, tiles, expected people, and the fitted probability."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.vision.blazepose import BlazePoseDetection, BlazePoseDetector, LandmarkNetwork
from app.vision.detector import (
    MAX_FINE_PX,
    MAX_FINE_SIDE_PX,
    MAX_TILE_PX,
    MIN_GAIN,
    MIN_PERSON_PX,
    MIN_SIDE_PX,
    OVERVIEW_PX,
    NetworkDetector,
    Tile,
    detection_odds,
    tiles_of,
)
from app.vision.geometry import Box
from app.vision.movenet import MoveNet
from app.vision.odds import sigmoid
from app.vision.rescoring import ObjectNetwork
from tests.app.vision.conftest import found_share, moved, scores_of

Make = Callable[..., NetworkDetector]


def test_walkers_are_detected_and_nothing_else(
    detector: NetworkDetector,
    street: NDArray[np.uint8],
    walkers: list[Box],
    far_walkers: list[Box],
) -> None:
    assert found_share(detector, street, walkers) == 1
    found = scores_of(detector, street)
    assert list(found.values()) == sorted(found.values(), reverse=True)
    for box in found:
        assert max(box.iou(person) for person in (*walkers, *far_walkers)) > 0.4


@pytest.mark.parametrize("shape", [(1, 1, 3), (60, 45, 3), (20, 900, 3), (700, 20, 3)])
@pytest.mark.parametrize("level", [0, 90, 255])
def test_blank_frames_hold_nobody(
    detector: NetworkDetector, shape: tuple[int, ...], level: int
) -> None:
    assert detector.detect(np.full(shape, level, np.uint8)) == []


def test_scores_below_the_minimum_are_left_out(
    make_network_detector: Make, street: NDArray[np.uint8]
) -> None:
    everyone = list(scores_of(make_network_detector(min_score=0.0), street).items())
    assert len(everyone) > 2
    some = make_network_detector(min_score=everyone[1][1])
    assert list(scores_of(some, street).items()) == everyone[:2]
    assert make_network_detector(min_score=1.0).detect(street) == []


def test_impossible_limits_are_refused(make_network_detector: Make) -> None:
    with pytest.raises(ValueError, match="min_person_px"):
        make_network_detector(min_person_px=0)
    with pytest.raises(ValueError, match="min_score"):
        make_network_detector(min_score=2)


def test_each_person_of_a_crowd_is_detected_once(
    make_network_detector: Make, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    """Eighteen walkers in a frame of 894x640, seen in tiles since small people are wanted."""
    height, width = street.shape[:2]
    people = [moved(box, x * width, y * height) for x in range(3) for y in range(2)
              for box in walkers]  # fmt: skip
    detector, frame = make_network_detector(min_person_px=40), np.tile(street, (2, 3, 1))
    assert found_share(detector, frame, people) > 0.9
    boxes = [one.box for one in detector.detect(frame) if one.certain]
    for number, box in enumerate(boxes):
        assert all(box.iou(other) < 0.4 for other in boxes[number + 1 :])


@pytest.mark.parametrize("x", range(380, 560, 20))
def test_person_across_two_tiles_is_detected_once(
    make_network_detector: Make, street: NDArray[np.uint8], walkers: list[Box], x: int
) -> None:
    """A walker moved across the seams of a frame of 1000x500 on plain asphalt."""
    left, top = round(walkers[1].x) - 12, round(walkers[1].y) - 12
    frame = np.full((500, 1000, 3), street[240:300, 90:130].mean(axis=(0, 1)), np.uint8)
    frame[200:330, x : x + 64] = street[top : top + 130, left : left + 64]
    found = make_network_detector(min_person_px=40).detect(frame)
    expected = moved(walkers[1], x - left, 200 - top)
    assert [one.box.iou(expected) > 0.6 for one in found] == [True]


def test_expected_person_is_detected_more_readily(
    detector: NetworkDetector, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    before = scores_of(detector, street)
    for expected in walkers:
        after = scores_of(detector, street, expected)
        raised = [box for box, score in after.items() if score > before.get(box, 0)]
        assert len(raised) == 1 and raised[0].iou(expected) > 0.5
        assert {box for box in after if box not in raised} == set(before) - set(raised)
    assert scores_of(detector, street, Box(0, 0, 10, 20)) == before


class SeesNobody(BlazePoseDetector):
    """Detects nobody, so that MoveNet is on its own."""

    def __init__(self) -> None:
        """Read no file."""

    def detect(self, frame: NDArray[np.uint8], min_score: float) -> list[BlazePoseDetection]:
        return []


def test_second_detector_only_adds(
    movenet: MoveNet,
    landmark_network: LandmarkNetwork,
    objects: ObjectNetwork,
    detector: NetworkDetector,
    street: NDArray[np.uint8],
) -> None:
    with_both = scores_of(detector, street)
    found = NetworkDetector(movenet, SeesNobody(), landmark_network, objects).detect(street)
    assert found
    for one in found:
        assert with_both[one.box] >= one.score
        assert one.windows == ()


@given(score=st.floats(0, 1), margin=st.floats(-5, 5), body=st.floats(0, 1), more=st.floats(0, 2))
def test_probability_never_falls_with_a_score(
    score: float, margin: float, body: float, more: float
) -> None:
    scores = [
        [score, margin, body],
        [score, margin + more, body],
        [min(1, score + more), margin, body],
        [score, margin, min(1, body + more)],
    ]
    first, *others = sigmoid(detection_odds(np.array(scores))).tolist()
    assert 0 <= first <= min(others) <= 1


people = st.integers(16, 400)
sides = st.integers(1, 6000)


def seen_px(tiles: list[Tile]) -> int:
    """Pixels that MoveNet sees."""
    return sum(math.prod(tile.size) for tile in tiles)


@given(width=sides, height=sides, min_person_px=people)
def test_tiles_cover_the_frame_and_stay_within_it(
    width: int, height: int, min_person_px: int
) -> None:
    tiles = tiles_of(width, height, min_person_px)
    assume(tiles)
    assert tiles[0].rect == (0, 0, width, height)
    for tile in tiles:
        left, top, columns, rows = tile.rect
        assert left >= 0 and top >= 0 and left + columns <= width and top + rows <= height
    # Tiles are a grid, so along each side their spans must leave no gap.
    for first, side in ((0, width), (1, height)):
        covered = 0
        for start, length in sorted({tile.rect[first::2] for tile in tiles[1:]}):
            assert start <= covered
            covered = max(covered, start + length)
        assert len(tiles) == 1 or covered == side


@given(width=sides, height=sides, min_person_px=people)
def test_overview_and_tiles_are_within_their_bounds(
    width: int, height: int, min_person_px: int
) -> None:
    whole, *tiles = tiles_of(width, height, min_person_px) or [Tile((0, 0, 1, 1), 1.0)]
    long_px, short_px = OVERVIEW_PX
    assert max(whole.size) <= long_px and min(whole.size) <= short_px
    for tile in tiles:
        columns, rows = tile.size
        # Tiles end on whole pixels of the frame: up to two more on each side after resizing.
        more = 2 * max(tile.factor, 1)
        assert (columns - more) * (rows - more) <= MAX_TILE_PX
        assert max(columns, rows) <= MAX_FINE_SIDE_PX + more


@given(width=sides, height=sides, min_person_px=people)
def test_smallest_wanted_person_is_seen_large_enough(
    width: int, height: int, min_person_px: int
) -> None:
    whole, tiles = tiles_of(width, height), tiles_of(width, height, min_person_px)
    assert tiles[:1] == whole
    assume(tiles)
    if min_person_px * whole[0].factor >= MIN_PERSON_PX:
        assert tiles == whole
    finest = max(tile.factor for tile in tiles)
    assert min(width, height) * finest >= MIN_SIDE_PX * (1 - 1e-9)
    wanted = min(
        MIN_PERSON_PX / min_person_px,
        MAX_FINE_SIDE_PX / max(width, height),
        math.sqrt(MAX_FINE_PX / (width * height)),
    )
    assert finest * MIN_GAIN >= wanted * (1 - 1e-9)
    # Nor finer than that, but for the overview.
    assert finest <= max(wanted, tiles[0].factor) * (1 + 1e-9)


@given(width=st.integers(1, 10**7), height=st.integers(1, 10**7), min_person_px=people)
def test_frames_of_any_size_take_a_bounded_time(
    width: int, height: int, min_person_px: int
) -> None:
    tiles = tiles_of(width, height, min_person_px)
    assert seen_px(tiles) <= 2 * MAX_FINE_PX + math.prod(OVERVIEW_PX)


@pytest.mark.parametrize("frame", [(2000, 2), (2, 2000), (10**6, 12), (1, 1), (7, 7)])
def test_thin_frames_are_not_searched(frame: tuple[int, int]) -> None:
    assert tiles_of(*frame, 50) == []
