"""Training samples: what the refiner sees of simulated scenes, and what it should answer."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.networks import Networks
from app.vision.refine import CHANNELS, COLUMNS, ROWS, refiner_input, refiner_window
from app.vision.resampling import cut, resize
from app.vision.segment import two_looks
from scripts.refinement.scenes import Scene, counted


def samples_of(
    scene: Scene, networks: Networks
) -> list[tuple[NDArray[np.uint8], NDArray[np.uint8]]]:
    """Inputs ``(6, 192, 128)`` and targets ``(192, 128)`` of everybody in a scene."""
    found = []
    for number, box in enumerate(scene.boxes):
        others = [other for other in scene.boxes if other is not box]
        window = refiner_window(box)
        probability = two_looks(networks, scene.frame, box, window)
        seen = refiner_input(scene.frame, window, box, others, probability)
        target = resize(cut(scene.covers[number], window), COLUMNS, ROWS)
        found.append((seen, np.rint(255 * target).astype(np.uint8)))
    return found


def make_samples(
    scenes: Iterable[Scene], networks: Networks, count: int
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Make ``count`` samples of scenes: inputs ``(N, 6, 192, 128)``, targets ``(N, 192, 128)``."""
    inputs = np.empty((count, CHANNELS, ROWS, COLUMNS), np.uint8)
    targets = np.empty((count, ROWS, COLUMNS), np.uint8)
    found = (one for scene in scenes for one in samples_of(scene, networks))
    for row, (seen, target) in enumerate(counted(found, count)):
        inputs[row], targets[row] = seen, target
    return inputs, targets


def spoil(
    probability: NDArray[np.uint8], generator: np.random.Generator, severity: float = 1.0
) -> NDArray[np.uint8]:
    """Give the first networks' answer the faults that it has before real people.

    Parts are lost, background sticks to the body, outlines blur and wander.

    Parameters
    ----------
    probability : (h, w) uint8 array
        255 is sure.
    generator : numpy.random.Generator
    severity : float
        0 blurs only.

    Returns
    -------
    (h, w) uint8 array
    """
    rows, columns = probability.shape
    odds: NDArray[np.floating] = probability.astype(np.float32) * (6 / 127.5) - 6
    grain = np.exp(generator.uniform(np.log(4), np.log(30)))
    small = generator.standard_normal((rows // 4, columns // 4), np.float32)
    coarse = cv2.GaussianBlur(small, (0, 0), grain / 4).astype(np.float32)
    field = resize(coarse / np.float32(float(coarse.std()) + 1e-6), columns, rows)
    odds += severity * (field * generator.uniform(0, 4) + generator.normal(0, 0.7))
    for _ in range(int(severity * generator.integers(0, 4))):
        blob = np.zeros((rows, columns), np.uint8)
        middle = (int(generator.integers(columns)), int(generator.integers(rows)))
        axes = (int(generator.integers(3, 22)), int(generator.integers(3, 22)))
        cv2.ellipse(blob, middle, axes, generator.uniform(0, 180), 0, 360, 1, -1)
        soft = cv2.GaussianBlur(blob.astype(np.float32), (0, 0), generator.uniform(1, 4))
        odds += soft * generator.choice([-11, 8])
    smooth = np.asarray(cv2.GaussianBlur(odds, (0, 0), generator.uniform(0.3, 2.5)), np.float32)
    return np.asarray(np.rint(255 / (1 + np.exp(-smooth))), np.uint8)
