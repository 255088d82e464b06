"""Drawn photographs to measure with: no picture of a real person is needed, or shipped."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from index.store import PoseIndex


def street(
    index: PoseIndex, *, width: int = 768, height: int = 576, person_px: int = 200, seed: int = 0
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Draw a blurred scene ``(height, width, 3)`` with one dark person in it, and their mask.

    The silhouette is that of entry ``seed`` of the index.
    """
    rng = np.random.default_rng(seed)
    coarse = rng.integers(90, 200, (height // 16, width // 16, 3), np.uint8)
    frame = np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC), np.uint8)
    mask = np.zeros((height, width), np.uint8)
    scale = person_px / 128
    person = cv2.resize(index.silhouette(seed % len(index)), None, fx=scale, fy=scale)
    top, left = (height - person.shape[0]) // 2, (width - person.shape[1]) // 2
    mask[top : top + person.shape[0], left : left + person.shape[1]] = person
    frame[mask == 1] = (60, 50, 45)
    return frame, mask


def encode(extension: str, picture: NDArray[Any], *parameters: int) -> bytes:
    """Encode a picture; ``extension`` as in ``.png``."""
    return cv2.imencode(extension, picture, list(parameters))[1].tobytes()


def encoded_streets(index: PoseIndex, width: int, height: int) -> tuple[list[bytes], list[bytes]]:
    """Return eight scenes as JPEG, and their masks as PNG."""
    scenes = [street(index, width=width, height=height, seed=seed) for seed in range(8)]
    frames = [encode(".jpg", frame) for frame, _ in scenes]
    return frames, [encode(".png", mask) for _, mask in scenes]
