"""What the joint reader is trained on: samples that stay consistent as they are varied."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("torch", reason="needs the extras build and train: torch")

from app.vision.joints import CELL, CHANNELS, COLUMNS, OTHER_SIDE, READ, ROWS
from scripts.joints.samples import Samples
from scripts.joints.train import maps_of, vary


def test_other_sides_are_those_of_the_names() -> None:
    for row, other in enumerate(OTHER_SIDE):
        assert OTHER_SIDE[other] == row
        assert READ[row].split("_")[-1] == READ[other].split("_")[-1]
        assert (READ[row] == READ[other]) == ("_" not in READ[row])


def test_wanted_maps_are_distributions_about_the_points() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform((10, 10), (COLUMNS - 10, ROWS - 10), (5, len(READ), 2)).astype(np.float32)
    maps, inside = maps_of(points)
    assert maps.shape == (5, len(READ), ROWS // CELL, COLUMNS // CELL)
    assert inside.all()
    assert_allclose(maps.sum(axis=(2, 3)), 1, atol=1e-5)
    y, x = np.mgrid[: ROWS // CELL, : COLUMNS // CELL]
    means = np.stack([(maps * axis).sum(axis=(2, 3)) for axis in (x, y)], axis=-1)
    assert_allclose((means + 0.5) * CELL - 0.5, points, atol=0.3)


def test_points_outside_the_window_are_told() -> None:
    points = np.full((1, len(READ), 2), 20, np.float32)
    points[0, 3] = (-5, 20)
    points[0, 4] = (20, ROWS + 5)
    inside = maps_of(points)[1][0]
    assert not inside[3] and not inside[4] and inside.sum() == len(READ) - 2


def test_varied_samples_keep_their_points_on_what_they_mark() -> None:
    """The head is a green dot, the left ankle a blue one: both move and mirror with the picture."""
    head, ankle = READ.index("head"), READ.index("left_ankle")
    other = READ.index("right_ankle")
    seen = np.zeros((1, CHANNELS, ROWS, COLUMNS), np.uint8)
    points = np.full((1, len(READ), 2), 48, np.float32)
    points[0, head], points[0, ankle], points[0, other] = (40, 50), (55, 95), (30, 95)
    seen[0, 1, 48:53, 38:43] = 255
    seen[0, 0, 93:98, 53:58] = 255
    samples = Samples(seen, np.full((1, ROWS, COLUMNS), 255, np.uint8), points)
    generator = np.random.default_rng(1)
    mirrored = set()
    checked = 0
    for _ in range(60):
        picture, places = vary(samples, 0, generator)
        if np.ptp(picture[:3], axis=0).max() < 0.2:
            continue  # Grey: the dots cannot be told apart.
        for plane, number in ((1, head), (0, ankle)):
            dot = picture[plane] - picture[2]
            middle = np.argwhere(dot > 0.6 * dot.max()).mean(axis=0)[::-1]
            near = [np.linalg.norm(places[one] - middle) for one in (number, OTHER_SIDE[number])]
            assert min(near) < 1.5
            if number == ankle:
                mirrored.add(int(np.argmin(near)))
        checked += 1
    # Mirrored, the left ankle's dot is that of a right one.
    assert mirrored == {0, 1} and checked > 30
