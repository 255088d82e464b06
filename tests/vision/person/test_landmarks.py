"""The landmark network on walkers of a street: where they are, mirrored and turned."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from app.vision.people import LANDMARK_NAMES, Box, PersonWindow
from app.vision.person.landmarks import PIXELS, LandmarkNetwork, Reading
from app.vision.person.window import window_about, window_to_frame
from tests.support.rotation import rotate_points

LIMBS = [
    i
    for i, name in enumerate(LANDMARK_NAMES)
    if name.endswith(("shoulder", "elbow", "wrist", "hip", "knee", "ankle"))
]
NUMBERS = pytest.mark.parametrize("number", range(3))
TURNED_WITHIN = 0.02
"""Mean distance of limb joints, in heights of the body."""


def apart(one: NDArray[np.float64], other: NDArray[np.float64], height: float) -> float:
    """Mean distance of limb joints, as a share of a body's height."""
    return float(np.linalg.norm(one[LIMBS] - other[LIMBS], axis=-1).mean() / height)


def read(network: LandmarkNetwork, frame: NDArray[np.uint8], box: Box) -> Reading:
    return network.read(frame, window_about(box))


@NUMBERS
def test_a_walker_is_seen_inside_the_box(
    landmark_network: LandmarkNetwork, street: NDArray[np.uint8], walkers: list[Box], number: int
) -> None:
    box = walkers[number]
    reading = read(landmark_network, street, box)
    assert reading.presence > 0.9
    assert ((reading.landmarks.visibility >= 0) & (reading.landmarks.visibility <= 1)).all()
    room = 0.08 * box.height
    low, high = np.array([box.x, box.y]) - room, np.array([box.right, box.bottom]) + room
    x, y = reading.landmarks.positions.T
    assert ((x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])).all()
    parts = {
        part: reading.landmarks.positions[[LANDMARK_NAMES.index(f"{s}_{part}") for s in
                                           ("left", "right")], 1].mean()
        for part in ("ear", "shoulder", "hip", "knee", "ankle")
    }  # fmt: skip
    assert list(parts.values()) == sorted(parts.values())
    # In metres as well; y is down.
    heights = reading.landmarks.metres[:, 1]
    assert heights[LANDMARK_NAMES.index("nose")] < -0.3 < 0.3 < heights[-1]


@NUMBERS
def test_the_mask_is_of_the_walker(
    landmark_network: LandmarkNetwork, street: NDArray[np.uint8], walkers: list[Box], number: int
) -> None:
    box = walkers[number]
    reading = read(landmark_network, street, box)
    assert reading.probability.shape == (PIXELS, PIXELS)
    assert reading.probability.min() >= 0 and reading.probability.max() <= 1
    rows, columns = np.nonzero(reading.probability > 0.5)
    to_frame = window_to_frame(reading.window, PIXELS)
    x, y = (np.stack([columns, rows], axis=1) @ to_frame[:, :2].T + to_frame[:, 2]).T
    inside = (x > box.x - 2) & (x < box.right + 2) & (y > box.y - 2) & (y < box.bottom + 2)
    assert inside.mean() > 0.95
    area = len(x) * (reading.window.side / PIXELS) ** 2
    assert 0.25 < area / box.area < 0.75


@pytest.mark.parametrize("quarter_turns", [1, 2, 3])
@NUMBERS
def test_in_a_turned_street_the_landmarks_are_turned(
    landmark_network: LandmarkNetwork,
    street: NDArray[np.uint8],
    walkers: list[Box],
    number: int,
    quarter_turns: int,
) -> None:
    box = walkers[number]
    window = window_about(box)
    here = landmark_network.read(street, window)
    x, y = rotate_points(np.array([window.x, window.y]), street.shape, quarter_turns).tolist()
    there = landmark_network.read(
        np.ascontiguousarray(np.rot90(street, quarter_turns)),
        PersonWindow(x, y, window.side, -90.0 * quarter_turns),
    )
    expected = rotate_points(here.landmarks.positions, street.shape, quarter_turns)
    assert apart(there.landmarks.positions, expected, box.height) < TURNED_WITHIN
    turned = np.stack(
        [*rotate_points(here.landmarks.metres[:, :2], (1, 1), quarter_turns).T,
         here.landmarks.metres[:, 2]], axis=1,
    )  # fmt: skip
    assert apart(there.landmarks.metres, turned, 1.7) < TURNED_WITHIN
    assert there.drift == pytest.approx(here.drift, abs=0.05)


def test_nobody_is_in_an_empty_window(
    landmark_network: LandmarkNetwork, street: NDArray[np.uint8]
) -> None:
    """Asphalt and grass of `street`."""
    for box in (Box(100, 200, 30, 80), Box(60, 30, 30, 80)):
        assert read(landmark_network, street, box).presence < 0.5
    blank = np.full((50, 400, 3), 127, np.uint8)
    for window in (PersonWindow(-900, 30, 5), PersonWindow(200, 25, 1e-3), PersonWindow(0, 0, 1e5)):
        reading = landmark_network.read(blank, window)
        assert reading.presence < 0.5
        assert np.isfinite(reading.landmarks.positions).all()
