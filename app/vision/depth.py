"""Landmarks in space: their depths, corrected by a network trained on rendered people.

The landmark network's depth errs by 0.1 m and more. A small network reads its feature map at the
landmarks and predicts these errors, with the scale of a Laplace distribution for each. The
landmarks are then placed on their lines of sight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.networks.dense import DenseNetwork
from app.networks.probabilities import sigmoid
from app.vision.blazepose import LANDMARK_PX, LANDMARKS, PoseReading
from app.vision.optics import (
    PinholeCamera,
    place_on_sight_lines,
    roll_rotation,
    to_line_of_sight,
    window_axes,
)
from app.vision.people import LANDMARK_NAMES, Landmarks, landmark_rows

HIPS = landmark_rows("hip")


@dataclass(frozen=True)
class Body3D:
    """Landmarks in three dimensions."""

    # (33, 3): metres about the middle of the hips, camera axes: x right, y down, z forward.
    points: NDArray[np.float64]
    sigmas: NDArray[np.float64]  # (33,): expected absolute error along the line of sight, metres
    # (3,): the middle of the hips, metres from the camera, estimated from the body's size.
    origin: NDArray[np.float64]

    def along_sight(self, camera: PinholeCamera, landmarks: Landmarks) -> NDArray[np.float64]:
        """The points ``(33, 3)`` in the axes of the line of sight to the hips."""
        hips = landmarks.positions[HIPS].mean(axis=0)
        return self.points @ to_line_of_sight(camera.rays(hips)).T


def body_of(reading: PoseReading, camera: PinholeCamera, depths: Depths) -> Body3D:
    """Put landmarks onto their lines of sight at corrected depths.

    A landmark's weight when the body is placed is the probability that it is visible.
    """
    axes = window_axes(camera, reading.window)
    metres = reading.network_pass.world[:LANDMARKS].astype(np.float64)
    metres = metres - metres[HIPS].mean(axis=0)
    metres[:, 2] = depths.metres
    # Least weight of a landmark when a body is placed.
    weights = np.maximum(reading.landmarks.visibility, 0.05)
    rays = camera.rays(reading.landmarks.positions)
    placed = place_on_sight_lines(metres, rays, axes, weights)
    hips = placed.points[HIPS].mean(axis=0)
    return Body3D(placed.points - hips, depths.sigmas, hips)


@dataclass(frozen=True)
class Depths:
    """Depths of landmarks."""

    # (33,): along the window's line of sight, about the middle of the hips.
    metres: NDArray[np.float64]
    sigmas: NDArray[np.float64]  # (33,): expected absolute error of each depth, metres


@dataclass(frozen=True)
class DepthModel:
    """Corrects depths with a network, see :func:`depth_features` and :func:`decode_depths`."""

    network: DenseNetwork
    # (33, 33): second moments of the errors, each divided by the standard deviation of its Laplace
    # distribution: the errors of a leaning body are correlated.
    moments: NDArray[np.float64]

    def covariance(self, sigmas: NDArray[np.float64]) -> NDArray[np.float64]:
        """Covariance ``(33, 33)`` of depths with expected absolute errors ``(33,)``."""
        return 2 * sigmas[:, None] * self.moments * sigmas

    def correct(self, reading: PoseReading, camera: PinholeCamera) -> Depths:
        """Correct the depths of a reading."""
        window, given = reading.window, reading.network_pass
        places = np.array([[window.x, window.y, window.side, window.roll_deg]])
        sight = sight_features(places, camera.focal[None], camera.centre[None])
        features = depth_features(given.points[None], given.world[None], given.sampled[None], sight)
        metres, sigmas = decode_depths(self.network(features), network_depths(given.world[None]))
        return Depths(metres[0], sigmas[0])


def network_depths(world: NDArray[np.floating]) -> NDArray[np.float64]:
    """The landmark network's own depths ``(N, 33)``, about the middle of the hips."""
    depths = world[:, :LANDMARKS, 2].astype(np.float64)
    return depths - depths[:, HIPS].mean(axis=1, keepdims=True)


def sight_features(
    windows: NDArray[np.float64], focal: NDArray[np.float64], centre: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Directions and angular sizes of windows, as the camera sees them: ``(N, 5)``.

    Parameters
    ----------
    windows : (N, 4) float64 array
        x, y, side, roll in degrees.
    focal, centre : (N, 2) float64 array
        Focal lengths and principal points of the cameras, pixels.

    Returns
    -------
    (N, 5) float64 array
        The ray to the middle along the window's sides, the window's angular size, cosine and sine
        of its roll.
    """
    ray = (windows[:, :2] - centre) / focal
    turned = np.einsum("nij,nj->ni", roll_rotation(windows[:, 3])[:, :2, :2], ray)
    size = windows[:, 2] / focal[:, 0] / np.sqrt(1 + (ray**2).sum(axis=1))
    roll = np.deg2rad(windows[:, 3])
    return np.column_stack([turned, size, np.cos(roll), np.sin(roll)])


# Landmarks at which the network reads the feature map.
_MAP_ROWS = [
    LANDMARK_NAMES.index("nose"),
    *landmark_rows("ear", "shoulder", "elbow", "wrist", "hip", "knee", "ankle", "foot_index"),
]


def depth_features(
    points: NDArray[np.floating],
    world: NDArray[np.floating],
    sampled: NDArray[np.floating],
    sight: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Inputs of the network: ``(N, F)``.

    Parameters
    ----------
    points : (N, 39, 5) array
    world : (N, 39, 3) array
        See :class:`app.vision.blazepose.NetworkPass`.
    sampled : (N, 33, 144) array
        The middle map at the landmarks.
    sight : (N, 5) float64 array
        See :func:`sight_features`.
    """
    count = len(points)
    places = points[:, :LANDMARKS].astype(np.float64)
    odds = np.clip(places[..., 3], -12, 12)
    metres = world[:, :LANDMARKS].astype(np.float64)
    return np.concatenate(
        [
            (places[..., :2] / (LANDMARK_PX / 2) - 1).reshape(count, -1),
            places[..., 2] / (LANDMARK_PX / 2),
            sigmoid(odds),
            metres.reshape(count, -1),
            sight,
            sampled[:, _MAP_ROWS].reshape(count, -1),
        ],
        axis=1,
    ).astype(np.float32)


RESIDUAL_M = 0.1
"""Unit of the network's outputs."""

_SIGMA_M = (0.005, 1.0)  # Limits of sigmas.


def decode_depths(
    outputs: NDArray[np.floating], own: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corrected depths and their sigmas, ``(N, 33)`` each, about the middle of the hips.

    Parameters
    ----------
    outputs : (N, 66) array
        Residuals in :data:`RESIDUAL_M`, then logarithms of sigmas in the same unit.
    own : (N, 33) float64 array
        See :func:`network_depths`.
    """
    residuals, logarithms = outputs[:, :LANDMARKS], outputs[:, LANDMARKS:]
    depths = own + RESIDUAL_M * residuals.astype(np.float64)
    depths -= depths[:, HIPS].mean(axis=1, keepdims=True)
    sigmas = RESIDUAL_M * np.exp(np.clip(logarithms.astype(np.float64), -6, 6))
    return depths, np.clip(sigmas, *_SIGMA_M)
