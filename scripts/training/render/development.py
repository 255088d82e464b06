"""From linear light to the bytes of a photograph: exposure, lens, sensor, compression."""

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

DARK, INFRARED, GREY, SOFT = 0.08, 0.06, 0.06, 0.15
"""Shares of pictures that are dark, taken in infrared, grey, or enlarged from fewer pixels."""


def develop(
    light: NDArray[np.float32], size: tuple[int, int], generator: Generator
) -> NDArray[np.uint8]:
    """Turn linear light into an 8-bit photograph: random blur, exposure, tone curve, noise.

    Light ``(H, W, 3)`` is linear RGB, about 1 where it is bright; the picture is BGR, of a width
    and height.
    """
    picture = np.asarray(cv2.resize(light, size, interpolation=cv2.INTER_AREA), np.float32)
    if generator.random() < 0.25:
        blur = generator.uniform(0.3, 0.9)
        picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), blur), np.float32)
    if generator.random() < 0.15:
        picture = _smeared(picture, generator)
    level = float(np.quantile(picture, 0.92)) + 1e-3
    gain = generator.uniform(0.35, 1.0) / level
    chance = generator.random()
    if chance < DARK:
        gain *= generator.uniform(0.06, 0.4)
    if DARK < chance < DARK + INFRARED:
        mixed = picture @ np.array([0.5, 0.3, 0.2], np.float32)
        mixed = mixed ** generator.uniform(0.6, 0.9)
        picture = np.repeat((mixed / mixed.max())[..., None] * level, 3, axis=2)
    colour = generator.uniform(0.9, 1.1, 3)
    bent = picture * (gain * colour).astype(np.float32)
    # The shoulder of the film: highlights are rounded off.
    bent = np.where(bent > 0.7, 0.7 + 0.3 * np.tanh((bent - 0.7) / 0.3), bent)
    tones = 255 * np.clip(bent, 0, 1) ** (1 / generator.uniform(1.9, 2.5))
    contrast = generator.uniform(0.85, 1.15)
    tones = (tones - 110) * contrast + 110 + generator.uniform(-8, 8)
    noise = generator.standard_normal(tones.shape, np.float32)
    tones = tones + np.float32(generator.choice([0.5, 2, 5, 9])) * noise
    if generator.random() < 0.25:
        tones = np.asarray(cv2.GaussianBlur(tones, (0, 0), 0.5), tones.dtype)
    image = np.clip(tones, 0, 255).astype(np.uint8)[..., ::-1]
    if chance < DARK + INFRARED + GREY and chance > DARK + INFRARED:
        image = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    if generator.random() < 0.8:
        image = _compressed(np.ascontiguousarray(image), int(generator.integers(25, 96)))
    if generator.random() < SOFT:
        image = _enlarged(image, generator)
    return np.ascontiguousarray(image)


def _enlarged(image: NDArray[np.uint8], generator: Generator) -> NDArray[np.uint8]:
    """As a film of fewer pixels that was enlarged, its compression as well."""
    rows, columns = image.shape[:2]
    smaller = generator.uniform(1.3, 2.5)
    size = (max(8, round(columns / smaller)), max(8, round(rows / smaller)))
    small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    small = _compressed(small, int(generator.integers(20, 80)))
    return np.asarray(cv2.resize(small, (columns, rows), interpolation=cv2.INTER_LINEAR), np.uint8)


def _compressed(image: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR), np.uint8)


def _smeared(picture: NDArray[np.float32], generator: Generator) -> NDArray[np.float32]:
    """Motion blur."""
    reach = int(generator.integers(2, 6))
    size = (reach, 1) if generator.random() < 0.7 else (1, reach)
    return np.asarray(cv2.blur(picture, size), np.float32)
