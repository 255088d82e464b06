"""Small videos for tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray


def write_video(
    path: Path, frames: Sequence[NDArray[np.uint8]], codec: str = "MJPG", fps: float = 10.0
) -> bytes:
    """Write frames of one size to a file and return its content."""
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(
        str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*codec), fps, (width, height)
    )
    assert writer.isOpened()
    for frame in frames:
        writer.write(frame)
    writer.release()
    return path.read_bytes()


def numbered_frames(count: int, height: int = 48, width: int = 64) -> list[NDArray[np.uint8]]:
    """Grey frames, each brighter than the one before it by 10."""
    return [np.full((height, width, 3), 10 * number, np.uint8) for number in range(count)]


def noisy_frames(count: int, height: int = 240, width: int = 320) -> list[NDArray[np.uint8]]:
    """Frames that no codec compresses."""
    rng = np.random.default_rng(count)
    return [rng.integers(0, 255, (height, width, 3), np.uint8) for _ in range(count)]
