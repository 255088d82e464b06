"""A frame of any proportions takes no more memory than a square one of as many pixels."""

import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest

from app.vision.detector import NetworkDetector
from app.vision.geometry import Box, PersonWindow
from app.vision.optics import PinholeCamera
from app.vision.person_reader import PersonReader
from app.vision.silhouettes import silhouettes_of

PIXELS = 1_000_000
# Inputs and outputs of the networks.
CONSTANT = 16 * 2**20


def peak_bytes(work: Callable[[], object]) -> int:
    """Peak memory of arrays; that inside the networks is the same for all."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("what", ["detector", "keypoints", "silhouette"])
def test_thin_frames_take_no_more_memory(
    detector: NetworkDetector, person_reader: PersonReader, what: str
) -> None:
    def work(width: int) -> object:
        height = PIXELS // width
        frame = np.full((height, width, 3), 90, np.uint8)
        box = Box(-0.5, -0.5, width, height)
        if what == "keypoints":
            return person_reader.keypoint_reader.read(frame, box)
        if what == "silhouette":
            camera = PinholeCamera.of_frame(frame.shape)
            reading = person_reader.judged(frame, camera, PersonWindow.about_box(box))
            masked = person_reader.with_mask(reading)
            return silhouettes_of([masked], [box], frame.shape, exact=True)
        return detector.detect(frame)

    square = peak_bytes(lambda: work(1000))
    for width in (1, 10, 100, 10_000, 100_000, 1_000_000):
        thin = peak_bytes(lambda width=width: work(width))  # type: ignore[misc]
        assert thin <= square + CONSTANT, f"{width} pixels wide: {thin} bytes, square: {square}"
