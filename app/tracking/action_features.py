"""Numbers that tell actions apart: how a skeleton moves within a few seconds.

Lengths are in legs, and joints are looked at from the person: outward (towards their own side), up
and forward of the pelvis. Limbs are told apart as the one that does more and the one that does
less, not as left and right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.tracking.smoothing import Smoothed
from index.skeleton import JOINT_NAMES, JOINTS, POINT_NAMES, wrap_degrees

LEAST_SINE = 0.35
"""Sine of the lowest elevation from which steps towards the camera are measured in the picture."""

_PELVIS = POINT_NAMES.index("pelvis")


@dataclass(frozen=True)
class Measured:
    """A pose at a moment.

    Parameters
    ----------
    timestamp : float
        Seconds.
    points_3d : (24, 3) float64 array
        Camera axes, metres, origin at the pelvis.
    pelvis_px : (2,) float64 array
        In the frame.
    pixels_per_metre : float
        At the person's distance.
    elevation_deg : float
        Of the camera above the person.
    """

    timestamp: float
    points_3d: NDArray[np.float64]
    pelvis_px: NDArray[np.float64]
    pixels_per_metre: float
    elevation_deg: float

    @classmethod
    def of(cls, timestamp: float, smoothed: Smoothed) -> Measured:
        """Measure a smoothed pose."""
        pose = smoothed.pose
        spread_px, spread_m = (
            float(np.linalg.norm(points - points[_PELVIS], axis=1).sum())
            for points in (pose.points_2d, pose.points_3d[:, :2])
        )
        return cls(
            timestamp,
            pose.points_3d - pose.points_3d[_PELVIS],
            pose.points_2d[_PELVIS],
            max(spread_px, 1e-6) / max(spread_m, 1e-6),
            smoothed.elevation_deg,
        )


def ground_path(
    pelvis_px: NDArray[np.float64], pixels_per_metre: float, elevation_deg: float
) -> NDArray[np.float64]:
    """Way of the pelvis over the ground.

    Somebody who walks away from a raised camera moves up in the picture, by the sine of its
    elevation.

    Parameters
    ----------
    pelvis_px : (T, 2) float64 array
    pixels_per_metre : float
    elevation_deg : float

    Returns
    -------
    (T, 2) float64 array
        Metres across the picture and towards the camera.
    """
    sine = max(float(np.sin(np.deg2rad(elevation_deg))), LEAST_SINE)
    return np.asarray(pelvis_px / pixels_per_metre / np.array([1.0, sine]))


RATE_HZ = 10.0
"""Of the poses that features are computed from."""

SPEED_BANDS = ((0.0, 0.3), (0.3, 0.6), (0.6, 1.0), (1.5, 3.0))
"""Metres a second: on the spot, hardly going, going, and faster than people walk. A linear model
tells from them that who goes steadily walks or runs."""

_TRUNK = ("spine", "chest", "head")
_LIMBS = ("elbow", "wrist", "knee", "ankle")
_OUTWARD = {"left": np.array([1.0, 1.0, 1.0]), "right": np.array([-1.0, 1.0, 1.0])}


def action_features(
    points_3d: NDArray[np.float64], up: NDArray[np.float64], path: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Describe a motion.

    Parameters
    ----------
    points_3d : (T, P, 3) float64 array
        Camera axes, metres, ``RATE_HZ`` poses a second; the first 19 points are the joints.
    up : (3,) float64 array
        Away from the ground, in the same axes.
    path : (T, 2) float64 array
        Of the pelvis, metres; see :func:`app.tracking.action_features.ground_path`.

    Returns
    -------
    (D,) float64 array
    """
    joints, left = _in_body_axes(points_3d, up)
    at = {name: joints[:, row] for row, name in enumerate(JOINT_NAMES)}
    parts: list[NDArray[np.float64]] = []
    for name in _TRUNK:
        parts.append(_statistics(np.abs(at[name]) * (1, 0, 0) + at[name] * (0, 1, 1)))
    for name in _LIMBS:
        sides = [at[f"{side}_{name}"] * signs for side, signs in _OUTWARD.items()]
        parts += [*_more_and_less(*(_statistics(side) for side in sides)), *_together(*sides)]
    height = joints[:, 0, 1] - joints[..., 1].min(axis=1)
    apart = [at[f"left_{name}"] - at[f"right_{name}"] for name in ("wrist", "ankle")]
    parts += [_statistics(height), *(_statistics(np.linalg.norm(d, axis=1)) for d in apart)]
    parts += [_turning(at, left), _travel(path)]
    features = np.concatenate([part.ravel() for part in parts])
    # Roots bring the long tails of speeds nearer to a normal distribution.
    return np.asarray(np.sign(features) * np.sqrt(np.abs(features)))


def _in_body_axes(
    points_3d: NDArray[np.float64], up: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Joints ``(T, 19, 3)`` to the left, up and forward of the pelvis, in legs; and the left."""
    joints = points_3d[:, :JOINTS] - points_3d[:, :1]
    at = {name: joints[:, row] for row, name in enumerate(JOINT_NAMES)}
    across = sum(at[f"left_{name}"] - at[f"right_{name}"] for name in ("hip", "shoulder"))
    left = across - np.multiply.outer(across @ up, up)
    left /= np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-6)
    axes = np.stack([left, np.broadcast_to(up, left.shape), np.cross(left, up)], axis=1)
    bones = [
        at[f"{side}_{start}"] - at[f"{side}_{end}"]
        for side in _OUTWARD
        for start, end in (("hip", "knee"), ("knee", "ankle"))
    ]
    leg = np.linalg.norm(bones, axis=-1).mean() * 2
    return np.einsum("tij,tpj->tpi", axes, joints) / leg, left


def _statistics(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean, deviation, least, most, and two means of speed: ``(6, ...)`` of ``(T, ...)``."""
    speeds = RATE_HZ * np.abs(np.diff(values, axis=0))
    return np.stack([
        values.mean(axis=0), values.std(axis=0), values.min(axis=0), values.max(axis=0),
        speeds.mean(axis=0), np.sqrt((speeds**2).mean(axis=0)),
    ])  # fmt: skip


def _more_and_less(
    left: NDArray[np.float64], right: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return np.maximum(left, right), np.minimum(left, right)


def _together(
    left: NDArray[np.float64], right: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Whether both sides move together or in turn, and how far apart they are."""
    return (
        np.mean((left - left.mean(axis=0)) * (right - right.mean(axis=0)), axis=0),
        np.abs(left - right).mean(axis=0),
    )


def _turning(at: dict[str, NDArray[np.float64]], left: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shoulders against hips, and the whole body; radians and radians a second."""
    yaw = {}
    for name in ("shoulder", "hip"):
        across = at[f"left_{name}"] - at[f"right_{name}"]
        yaw[name] = np.rad2deg(np.arctan2(across[:, 2], across[:, 0]))
    twist = np.deg2rad(wrap_degrees(yaw["shoulder"] - yaw["hip"]))
    # The camera's x and z span the ground closely enough for a turn's speed.
    heading = np.unwrap(np.arctan2(left[:, 2], left[:, 0]))
    return np.array([
        twist.std(), np.ptp(twist), RATE_HZ * np.abs(np.diff(twist)).mean(),
        RATE_HZ * abs(heading[-1] - heading[0]) / (len(heading) - 1),
        RATE_HZ * np.abs(np.diff(heading)).mean(),
    ])  # fmt: skip


def _travel(path: NDArray[np.float64]) -> NDArray[np.float64]:
    """Metres a second, from start to end, band by band, and from pose to pose."""
    steps = RATE_HZ * np.diff(path, axis=0)
    speed = np.linalg.norm(steps.mean(axis=0))
    return np.array([
        speed, *(np.clip(speed, low, high) - low for low, high in SPEED_BANDS),
        np.linalg.norm(steps, axis=1).mean(), *np.abs(steps).mean(axis=0), steps[:, 1].std(),
    ])  # fmt: skip
