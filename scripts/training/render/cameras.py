"""Cameras in rooms and streets: where they hang, what they are aimed at, how wide they see."""

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

ASPECTS = (4 / 3, 4 / 3, 16 / 9, 16 / 9, 16 / 9, 3 / 4, 9 / 16, 1.0)
"""Width over height."""

OVERHEAD = 0.08
"""Share of the cameras of photographs that hang above their target."""

FOV_DEG = (40.0, 110.0)
"""Horizontal, of frames that are wider than high."""


@dataclass(frozen=True)
class Camera:
    """A pinhole camera; lengths in halves of the frame's longer side.

    Its place ``(3,)`` is in metres and world axes, its rotation ``(3, 3)`` leads from these to
    camera axes; ``half`` is half of the frame's width and height.
    """

    place: NDArray[np.float64]
    rotation: NDArray[np.float64]
    focal: float
    half: NDArray[np.float64]

    def seen(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Points ``(..., 3)`` in world axes to camera axes."""
        return np.asarray((points - self.place) @ self.rotation.T)

    def elevation_deg(self, target: NDArray[np.float64]) -> float:
        """The camera's elevation above the horizon of a target ``(3,)`` in world axes."""
        away = self.place - target
        return float(np.rad2deg(np.arctan2(away[1], np.hypot(away[0], away[2]))))

    @property
    def fov_deg(self) -> float:
        """Horizontal field of view."""
        return float(np.rad2deg(2 * np.arctan(self.half[0] / self.focal)))


def sample_camera(
    target: NDArray[np.float64],
    floor: float,
    generator: Generator,
    *,
    close: bool,
    azimuth: float | None = None,
    overhead: float = OVERHEAD,
) -> Camera:
    """A camera that sees a target ``(3,)`` somewhere in its frame.

    At eye level, below a ceiling, near the floor, high above a street, or overhead; off axis as
    often as not; one in eight holds the target at its border. ``close`` cameras stand within arm's
    reach to two metres, as on a desk or a shelf. The azimuth about the target is a given one, or
    any; a share of the cameras is ``overhead``.
    """
    chance = generator.random()
    if close:
        height, distance = generator.uniform(0.4, 2.0), np.exp(generator.uniform(-0.5, 0.7))
    elif generator.random() < overhead:
        height, distance = generator.uniform(2.2, 4.5), generator.uniform(0.0, 1.3)
    elif chance < 0.42:
        height, distance = generator.uniform(0.8, 1.9), np.exp(generator.uniform(0.25, 2.1))
    elif chance < 0.80:
        height, distance = generator.uniform(1.8, 3.2), np.exp(generator.uniform(0.0, 2.0))
    elif chance < 0.92:
        height, distance = generator.uniform(0.08, 0.8), np.exp(generator.uniform(0.3, 2.0))
    else:
        height, distance = generator.uniform(3.0, 8.0), np.exp(generator.uniform(1.0, 2.9))
    if azimuth is None:
        azimuth = generator.uniform(0, 2 * np.pi)
    away = distance * np.array([np.sin(azimuth), 0.0, np.cos(azimuth)])
    place = np.array([target[0] + away[0], floor + height, target[2] + away[2]])
    aspect = float(generator.choice(ASPECTS))
    half = np.array([1.0, 1 / aspect]) if aspect >= 1 else np.array([aspect, 1.0])
    wide = generator.random() < 0.35
    fov = generator.uniform(75, FOV_DEG[1]) if wide else generator.uniform(FOV_DEG[0], 75)
    # As wide along the longer side of frames that stand.
    focal = 1 / np.tan(np.deg2rad(fov) / 2)
    if generator.random() < 0.125:
        reach = generator.uniform(0.75, 1.1, 2) * generator.choice([-1, 1], 2)
        at = half * reach * generator.permutation([1.0, generator.uniform(0, 0.5)])
    else:
        spread = generator.random(2) ** 0.4
        at = half * generator.uniform([-0.85, -0.6], [0.85, 0.6]) * spread
    roll = generator.normal(0, 3) if generator.random() < 0.92 else generator.uniform(-30, 30)
    rotation = aimed_at(target - place, at / focal, float(np.deg2rad(roll)))
    return Camera(place, rotation, float(focal), half)


def aimed_at(
    direction: NDArray[np.float64], at: NDArray[np.float64], roll: float
) -> NDArray[np.float64]:
    """Rotation from world to camera axes that shows a direction ``(3,)`` at about a place.

    The place ``(2,)``, before the roll in radians, is to the right and down of the axis, over the
    focal length.
    """
    yaw, pitch = np.arctan2(at[0], 1.0), np.arctan2(at[1], np.hypot(1.0, at[0]))
    level = np.hypot(direction[0], direction[2])
    azimuth = np.arctan2(direction[0], direction[2]) + yaw
    elevation = np.clip(np.arctan2(direction[1], level) + pitch, -1.5, 1.3)
    forward = np.array(
        [
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
            np.cos(azimuth) * np.cos(elevation),
        ]
    )
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    cosine, sine = np.cos(roll), np.sin(roll)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(turn @ np.stack([right, down, forward]))
