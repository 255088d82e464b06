"""Silhouettes: from labels, by colour and by the network."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app.vision.body_shape import body_prior
from app.vision.decode import LabelImage
from app.vision.grabcut import GrabCutSegmenter
from app.vision.mask_cleaning import fill_small_holes, guided_filter, keep_components
from app.vision.networks import BODY_FILE, PERSON_FILE, Networks, load_networks
from app.vision.people import Box
from app.vision.segment import NetworkSegmenter, make_segmenter, silhouettes_from_labels
from app.vision.tflite import TfliteError


def figure(frame: NDArray[np.uint8], left: int, colour: tuple[int, int, int]) -> np.ndarray:
    """Paint a stick person, 100 px tall, and return its mask."""
    mask = np.zeros(frame.shape[:2], np.uint8)
    cv2.circle(mask, (left + 20, 28), 8, 1, -1)
    cv2.rectangle(mask, (left + 7, 38), (left + 33, 72), 1, -1)
    cv2.rectangle(mask, (left + 9, 72), (left + 17, 119), 1, -1)
    cv2.rectangle(mask, (left + 23, 72), (left + 31, 119), 1, -1)
    frame[mask > 0] = colour
    return mask > 0


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


@pytest.fixture
def scene() -> tuple[np.ndarray, list[np.ndarray], list[Box]]:
    """Two people, 20 px apart, on a noisy pavement."""
    noise = np.random.default_rng(1).normal(0, 4, (140, 160, 3))
    frame = np.full((140, 160, 3), (150, 155, 150), np.uint8)
    masks = [figure(frame, 20, (60, 40, 160)), figure(frame, 70, (160, 60, 30))]
    boxes = []
    for mask in masks:
        x, y, width, height = cv2.boundingRect(mask.astype(np.uint8))
        boxes.append(Box(x - 0.5, y - 0.5, width, height))
    return np.clip(frame + noise, 0, 255).astype(np.uint8), masks, boxes


def test_labels_become_silhouettes_from_left_to_right() -> None:
    labels = np.zeros((20, 30), np.uint16)
    labels[3:9, 20:25] = 1
    labels[2:9, 3:8] = 7
    people = silhouettes_from_labels(LabelImage.of(labels))
    assert [one.left for one in people] == [3, 20]
    assert [one.segmenter for one in people] == ["mask", "mask"]
    assert silhouettes_from_labels(LabelImage.of(labels * 0)) == []


def test_grabcut_finds_painted_people(scene: tuple[np.ndarray, list, list]) -> None:
    frame, masks, boxes = scene
    silhouettes = GrabCutSegmenter().segment(frame, boxes)
    for one, mask in zip(silhouettes, masks, strict=True):
        assert one is not None and one.segmenter == "grabcut" and not one.truncated
        assert iou(one.mask(frame.shape), mask) > 0.85


def test_grabcut_repeats_itself(scene: tuple[np.ndarray, list, list]) -> None:
    frame, _, boxes = scene
    first, second = (GrabCutSegmenter().segment(frame, boxes) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        assert one is not None and other is not None
        assert (one.crop == other.crop).all()


ODD_BOXES = [
    Box(-30, -20, 50, 60),
    Box(5, 5, 1, 1),
    Box(200, 200, 10, 10),
    Box(0, 0, 300, 2),
    Box(-0.5, -0.5, 298, 320),
]


@pytest.mark.parametrize("shape", [(320, 298, 3), (1, 1, 3), (3, 900, 3)])
def test_grabcut_survives_odd_boxes_and_blank_walls(shape: tuple[int, ...]) -> None:
    blank = np.full(shape, 127, np.uint8)
    assert len(GrabCutSegmenter().segment(blank, ODD_BOXES)) == len(ODD_BOXES)


@pytest.mark.parametrize("shape", [(320, 298, 3), (1, 1, 3), (3, 900, 3)])
def test_the_network_survives_odd_boxes_and_blank_walls(
    segmenter: NetworkSegmenter, shape: tuple[int, ...]
) -> None:
    blank = np.full(shape, 127, np.uint8)
    found = segmenter.segment(blank, ODD_BOXES)
    assert len(found) == len(ODD_BOXES)
    assert segmenter.segment(blank, []) == []


def test_the_network_cuts_out_walkers(
    segmenter: NetworkSegmenter, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    for one, box in zip(segmenter.segment(street, walkers), walkers, strict=True):
        assert one is not None and one.segmenter == "network" and not one.truncated
        assert one.box.iou(box) > 0.7
        assert 0.25 < one.area_px / box.area < 0.75


def test_a_walker_cut_by_the_frame_is_flagged(
    segmenter: NetworkSegmenter, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    frame = street[:215]
    one = segmenter.segment(frame, [walkers[1]])[0]
    assert one is not None and one.truncated


def test_threads_agree(
    segmenter: NetworkSegmenter, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    expected = segmenter.segment(street, walkers)
    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(lambda _: segmenter.segment(street, walkers), range(12)):
            for one, other in zip(found, expected, strict=True):
                assert one is not None and other is not None
                assert (one.crop == other.crop).all()


def test_without_a_network_grabcut_serves(tmp_path: Path) -> None:
    assert make_segmenter(load_networks(None)).name == "grabcut"
    assert make_segmenter(load_networks(tmp_path)).name == "grabcut"
    for file in (PERSON_FILE, BODY_FILE):
        (tmp_path / file).write_bytes(b"not a network" * 100)
    assert make_segmenter(load_networks(tmp_path)).name == "grabcut"
    with pytest.raises(TfliteError):
        Networks.load(tmp_path)


def test_without_one_of_the_networks_grabcut_serves(models: Path, tmp_path: Path) -> None:
    for file in (PERSON_FILE, BODY_FILE):
        (tmp_path / file).symlink_to(models / file)
        assert (load_networks(tmp_path) is None) == (file == PERSON_FILE)


def test_small_holes_are_filled_and_large_ones_kept() -> None:
    mask = np.ones((40, 40), bool)
    mask[5, 5] = False
    mask[10:30, 10:30] = False
    filled = fill_small_holes(mask, 0.02)
    assert filled[5, 5] and not filled[20, 20]
    assert fill_small_holes(mask, 1.0).all()
    assert (fill_small_holes(mask, 0) == mask).all()


def test_islands_are_dropped() -> None:
    mask = np.zeros((30, 30), bool)
    mask[2:20, 2:10] = True
    mask[25:27, 25:27] = True
    mask[2:20, 15:20] = True
    assert not keep_components(mask, 0.2)[25, 25] and keep_components(mask, 0.2)[3, 16]
    assert np.count_nonzero(keep_components(mask, 1)) == 18 * 8
    assert not keep_components(mask & False, 0.2).any()


def test_the_guided_filter_snaps_to_edges() -> None:
    guide = np.zeros((40, 40, 3), np.uint8)
    guide[:, 20:] = (200, 180, 160)
    rough = np.zeros((40, 40), np.float32)
    rough[:, 22:] = 1  # two columns off
    smooth = guided_filter(guide, rough, 6, 1e-4)
    assert ((smooth > 0.5) == (guide[..., 0] > 0)).mean() > 0.97
    constant = guided_filter(guide, np.full((40, 40), 0.3, np.float32), 6)
    assert np.allclose(constant, 0.3, atol=1e-4)


@pytest.mark.parametrize("size", [(1, 1), (128, 48), (40, 90)])
def test_the_prior_is_symmetric(size: tuple[int, int]) -> None:
    prior = body_prior(*size)
    assert prior.shape == size
    assert np.allclose(prior, prior[:, ::-1], atol=1e-6)
    assert prior.min() >= 0.02 - 1e-6 and prior.max() <= 0.98 + 1e-6
