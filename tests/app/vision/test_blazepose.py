"""BlazePose's detector and landmark network, however the frame is rotated."""

import numpy as np
import pytest
from numpy.typing import NDArray

from app.vision.blazepose import LANDMARK_PX, LandmarkNetwork, MaskNetwork
from app.vision.geometry import Box, PersonWindow, transform_points
from app.vision.people import LANDMARK_NAMES

WALKER = pytest.mark.parametrize("number", range(3))


@WALKER
def test_landmarks_and_mask_are_the_walkers(
    landmark_network: LandmarkNetwork,
    mask_network: MaskNetwork,
    street: NDArray[np.uint8],
    walkers: list[Box],
    number: int,
) -> None:
    box = walkers[number]
    reading = mask_network.read(landmark_network.read(street, PersonWindow.about_box(box)))
    assert reading.presence > 0.9
    landmarks = reading.landmarks
    assert ((landmarks.visibility >= 0) & (landmarks.visibility <= 1)).all()
    margin = 0.08 * box.height
    assert (landmarks.positions > [box.x - margin, box.y - margin]).all()
    assert (landmarks.positions < [box.right + margin, box.bottom + margin]).all()
    # From ear to ankle, in pixels and in metres.
    names = [[f"{side}_{part}" for side in ("left", "right")]
             for part in ("ear", "shoulder", "hip", "knee", "ankle")]  # fmt: skip
    rows = [[LANDMARK_NAMES.index(name) for name in pair] for pair in names]
    assert (np.diff(landmarks.positions[rows, 1].mean(axis=1)) > 0).all()
    heights = landmarks.metres[:, 1]
    assert heights[LANDMARK_NAMES.index("nose")] < -0.3 < 0.3 < heights[-1]
    assert reading.probability is not None
    assert reading.probability.shape == (LANDMARK_PX, LANDMARK_PX)
    assert reading.probability.min() >= 0 and reading.probability.max() <= 1
    y, x = np.nonzero(reading.probability > 0.5)
    to_frame = reading.window.to_frame(LANDMARK_PX)
    x, y = transform_points(to_frame, np.stack([x, y], axis=1)).T
    inside = (x > box.x - 2) & (x < box.right + 2) & (y > box.y - 2) & (y < box.bottom + 2)
    assert inside.mean() > 0.95
    area = len(x) * (reading.window.side / LANDMARK_PX) ** 2
    assert 0.25 < area / box.area < 0.75
