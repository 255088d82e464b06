"""The network that reads joints: what it is shown, and where its maps lie."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from app.vision.joints import (
    CELL,
    CHANNELS,
    COLUMNS,
    OTHER_SIDE,
    READ,
    ROWS,
    JointReader,
    joints_input,
    joints_window,
)
from app.vision.people import Box, Silhouette
from app.vision.workers import Workers
from descriptor.silhouette import normalise

sides = st.floats(1, 900)
places = st.floats(-300, 900)


@pytest.fixture(scope="module")
def reader() -> JointReader:
    return JointReader()


@pytest.fixture
def figure() -> Silhouette:
    """A person of two strokes: wide shoulders, and legs."""
    crop = np.zeros((200, 80), bool)
    crop[20:60] = True
    crop[:, 30:50] = True
    return Silhouette(crop, 60, 30, "network", False)


@given(places, places, sides, sides)
def test_the_window_holds_the_box_and_keeps_its_shape(
    x: float, y: float, width: float, height: float
) -> None:
    box = Box(x, y, width, height)
    left, top, columns, rows = joints_window(box)
    assert left - 1.5 <= box.x and box.right <= left + columns + 1.5
    assert top - 1.5 <= box.y and box.bottom <= top + rows + 1.5
    assert columns * ROWS == rows * COLUMNS


def test_the_silhouette_lies_on_the_photograph(figure: Silhouette) -> None:
    frame = np.zeros((300, 240, 3), np.uint8)
    frame[figure.mask(frame.shape)] = 255
    planes = joints_input(frame, figure, joints_window(figure.box))
    assert planes.shape == (CHANNELS, ROWS, COLUMNS) and planes.dtype == np.uint8
    assert_allclose(planes[3].astype(int), planes[0].astype(int), atol=1)
    assert planes[3].max() == 255


def test_maps_lie_where_the_window_is(reader: JointReader, figure: Silhouette) -> None:
    """A pixel of the frame is found in the same cell by way of the normalised frame."""
    frame = np.full((300, 240, 3), 90, np.uint8)
    placement = normalise(figure.crop)[1]
    maps = reader.read(frame, figure, placement)
    left, top, width, height = joints_window(figure.box)
    for x, y in ((70.0, 40.0), (130.0, 222.0), (99.5, 100.25)):
        normalised = placement.to_normalised(np.array([x - figure.left, y - figure.top]))
        cell = np.array([(x + 0.5 - left) / width, (y + 0.5 - top) / height])
        expected = cell * (COLUMNS / CELL, ROWS / CELL) - 0.5
        assert_allclose(normalised * maps.scale + maps.offset, expected, atol=1e-6)


def test_each_map_is_a_distribution(reader: JointReader, figure: Silhouette) -> None:
    frame = np.random.default_rng(1).integers(0, 255, (300, 240, 3), np.uint8)
    maps = reader.read(frame, figure, normalise(figure.crop)[1]).maps
    assert maps.shape == (len(READ), ROWS // CELL, COLUMNS // CELL)
    assert maps.min() >= 0
    assert_allclose(maps.sum(axis=(1, 2)), 1, atol=1e-4)


@pytest.mark.parametrize("shape", [(1, 1), (2, 300), (300, 2)])
def test_odd_silhouettes_are_survived(reader: JointReader, shape: tuple[int, int]) -> None:
    body = Silhouette(np.ones(shape, bool), 0, 0, "network", True)
    maps = reader.read(np.zeros((300, 300, 3), np.uint8), body, normalise(body.crop)[1])
    assert np.isfinite(maps.maps).all()


def test_threads_agree(reader: JointReader, figure: Silhouette) -> None:
    frame = np.random.default_rng(2).integers(0, 255, (300, 240, 3), np.uint8)
    placement = normalise(figure.crop)[1]
    expected = reader.read(frame, figure, placement).maps
    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(lambda _: reader.read(frame, figure, placement).maps, range(8)):
            assert (found == expected).all()


def test_heads_are_above_feet(reader: JointReader, figure: Silhouette) -> None:
    frame = np.full((300, 240, 3), 200, np.uint8)
    frame[figure.mask(frame.shape)] = (60, 50, 40)
    maps = reader.read(frame, figure, normalise(figure.crop)[1]).maps
    rows = (maps.sum(axis=2) * np.arange(ROWS // CELL)).sum(axis=1)
    found = dict(zip(READ, rows, strict=True))
    assert found["head"] < found["left_hip"] < found["left_ankle"]
    assert found["head"] < found["right_hip"] < found["right_ankle"]


def test_the_mirror_image_has_the_mirrored_joints(reader: JointReader) -> None:
    planes = np.random.default_rng(2).integers(0, 256, (CHANNELS, ROWS, COLUMNS)).astype(np.uint8)
    mirrored = reader.maps(np.ascontiguousarray(planes[..., ::-1]))
    assert_allclose(mirrored[OTHER_SIDE, :, ::-1], reader.maps(planes), atol=1e-5)


def test_with_workers_the_maps_are_the_same(reader: JointReader) -> None:
    planes = np.random.default_rng(3).integers(0, 256, (CHANNELS, ROWS, COLUMNS)).astype(np.uint8)
    assert (JointReader(workers=Workers(2)).maps(planes) == reader.maps(planes)).all()
