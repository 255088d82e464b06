"""Finding people."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app.vision.box_arrays import averaged, drop_parts, iou_matrix, suppress
from app.vision.detect import CascadeDetector, Detector, HogDetector
from app.vision.evidence import suited
from app.vision.hog import as_cells, person_windows
from app.vision.networks import PersonNetwork
from app.vision.people import Box
from app.vision.presence import PresenceMap


def found_share(detector: Detector, frame: NDArray[np.uint8], people: list[Box]) -> float:
    boxes = [one.box for one in detector.detect(frame)]
    return float(np.mean([max([p.iou(b) for b in boxes], default=0) >= 0.5 for p in people]))


def test_gradients_find_walkers(street: NDArray[np.uint8], walkers: list[Box]) -> None:
    assert found_share(HogDetector(), street, walkers) == 1


def test_the_cascade_finds_walkers_and_nothing_else(
    network: PersonNetwork, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    detector = CascadeDetector(network)
    assert found_share(detector, street, walkers) == 1
    known = [*walkers, Box(207, 0, 24, 55), Box(232, 0, 24, 57)]
    for one in detector.detect(street):
        assert max(one.box.iou(person) for person in known) > 0.4


def test_a_large_frame_is_searched_at_reduced_size(
    network: PersonNetwork, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    large = cv2.resize(street, None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC)
    people = [box.scaled(4) for box in walkers]
    for detector in (HogDetector(min_person_px=200), CascadeDetector(network, min_person_px=200)):
        assert found_share(detector, large, people) == 1


@pytest.mark.parametrize("shape", [(1, 1, 3), (60, 45, 3), (20, 900, 3), (700, 20, 3)])
def test_blank_frames_of_any_shape_hold_nobody(
    network: PersonNetwork, shape: tuple[int, ...]
) -> None:
    blank = np.full(shape, 90, np.uint8)
    assert HogDetector().detect(blank) == []
    assert CascadeDetector(network).detect(blank) == []


def test_threads_agree(network: PersonNetwork, street: NDArray[np.uint8]) -> None:
    detector = CascadeDetector(network)
    expected = detector.detect(street)
    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(lambda _: detector.detect(street), range(8)):
            assert found == expected


def test_impossible_limits_are_refused() -> None:
    with pytest.raises(ValueError, match="min_person_px"):
        HogDetector(min_person_px=0)
    with pytest.raises(ValueError, match="min_score"):
        HogDetector(min_score=2)


BOXES = np.array([[0, 0, 10, 30], [1, 1, 10, 30], [7, 0, 10, 30], [1, 0, 8, 14]], float)
SCORES = np.array([0.9, 0.8, 0.7, 0.6])


def test_two_people_walking_together_stay_two() -> None:
    kept = suppress(BOXES, SCORES, 0.4)
    assert kept == [0, 2, 3]
    assert drop_parts(BOXES, kept) == [0, 2]


def test_the_mean_box_leans_to_the_better() -> None:
    mean = averaged(BOXES, SCORES, [0])
    assert mean.shape == (1, 4)
    assert 0 < mean[0, 0] < 0.5 and mean[0, 2] == pytest.approx(10)


def test_iou_of_equal_and_disjoint_boxes() -> None:
    far = BOXES + np.array([100, 0, 0, 0])
    assert np.allclose(np.diag(iou_matrix(BOXES, BOXES)), 1)
    assert (iou_matrix(BOXES, far) == 0).all()


def test_windows_are_looked_at_only_where_people_may_be(
    street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    somebody = np.zeros(street.shape[:2], bool)
    left, top, right, bottom = walkers[1].pixels()
    somebody[top:bottom, left:right] = True
    everywhere, _ = person_windows(street, 50, 0.0)
    near, _ = person_windows(street, 50, 0.0, lambda _: as_cells(somebody))
    nowhere, _ = person_windows(street, 50, 0.0, lambda _: as_cells(np.zeros_like(somebody)))
    assert 0 < len(near) < len(everywhere)
    assert len(nowhere) == 0
    # A blob of one person's height says nothing of people a quarter as tall.
    assert near[:, 3].min() > walkers[1].height / 4


def test_maps_are_asked_about_people_who_suit_their_windows() -> None:
    empty = np.zeros((4, 4), np.float32)
    maps = [PresenceMap(empty, 800), PresenceMap(empty, 200)]
    assert [one.side for one in suited(maps, 60)] == [200]
    assert [one.side for one in suited(maps, 170)] == [800, 200]
    assert [one.side for one in suited(maps, 400)] == [800]
    assert [one.side for one in suited(maps, 20)] == [200]
