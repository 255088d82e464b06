"""Depth of landmarks, corrected by a network trained on rendered people, with its uncertainty.

The landmark network's depth errs by 0.1 m and more. A small network reads its feature map at the
landmarks and predicts these errors, with the scale of a Laplace distribution for each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.vision.dense import DenseNetwork
from app.vision.geometry import PersonWindow
from app.vision.landmark_features import LANDMARKS
from app.vision.network_pass import NetworkPass
from app.vision.odds import sigmoid
from app.vision.people import LANDMARK_NAMES, landmark_rows
from app.vision.sight import PinholeCamera, roll_rotation

MAP_ROWS = [
    LANDMARK_NAMES.index("nose"),
    *landmark_rows("ear", "shoulder", "elbow", "wrist", "hip", "knee", "ankle", "foot_index"),
]
"""Landmarks at which the feature map is sampled."""

HIPS = landmark_rows("hip")

RESIDUAL_M = 0.1
"""Unit of the network's outputs."""

SIGMA_M = (0.005, 1.0)
"""Limits of sigmas."""

_WINDOW_PX = 256


@dataclass(frozen=True)
class Depths:
    """Depths of landmarks.

    Parameters
    ----------
    metres : (33,) float64 array
        Along the window's line of sight, about the middle of the hips.
    sigmas : (33,) float64 array
        Expected absolute error of each depth, metres.
    """

    metres: NDArray[np.float64]
    sigmas: NDArray[np.float64]


def network_depths(world: NDArray[np.floating]) -> NDArray[np.float64]:
    """The landmark network's own depths ``(N, 33)``, about the middle of the hips."""
    depths = world[:, :LANDMARKS, 2].astype(np.float64)
    return np.asarray(depths - depths[:, HIPS].mean(axis=1, keepdims=True))


def sight_features(
    windows: NDArray[np.float64], focal: NDArray[np.float64], centre: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Directions and sizes in which windows are seen: ``(N, 5)``.

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
        See :class:`app.vision.network_pass.NetworkPass`.
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
            (places[..., :2] / (_WINDOW_PX / 2) - 1).reshape(count, -1),
            places[..., 2] / (_WINDOW_PX / 2),
            sigmoid(odds),
            metres.reshape(count, -1),
            sight,
            sampled[:, MAP_ROWS].reshape(count, -1),
        ],
        axis=1,
    ).astype(np.float32)


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
    return depths, np.clip(sigmas, *SIGMA_M)


@dataclass(frozen=True)
class DepthModel:
    """Corrects depths.

    Parameters
    ----------
    network : DenseNetwork
    """

    network: DenseNetwork

    def correct(self, given: NetworkPass, window: PersonWindow, camera: PinholeCamera) -> Depths:
        """Correct the depths of one pass over a window."""
        places = np.array([[window.x, window.y, window.side, window.roll_deg]])
        sight = sight_features(places, camera.focal[None], camera.centre[None])
        features = depth_features(given.points[None], given.world[None], given.sampled[None], sight)
        metres, sigmas = decode_depths(self.network(features), network_depths(given.world[None]))
        return Depths(metres[0], sigmas[0])
