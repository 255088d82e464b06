"""Measures of how well hypotheses fit: outline distance and the features of the confidence."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from descriptor.silhouette import HEIGHT, WIDTH
from index.candidates import Candidates
from index.confidence import RIGHT_BELOW_PX
from index.modes import Modes, candidate_weights
from index.skeleton import JOINTS

AGREEMENT_PX = (RIGHT_BELOW_PX, 2 * RIGHT_BELOW_PX)
"""Mean joint distances below which a candidate agrees with a mode."""

AGREEMENT_FALL_OFFS = (0.15, 0.5)
"""Fall-offs of the candidates' weights, as in :func:`index.modes.candidate_weights`."""


def match_features(
    candidates: Candidates, modes: Modes, outline_errors: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Compute :data:`index.confidence.FEATURES`.

    Parameters
    ----------
    modes : Modes
        M modes of the candidates, ordered by rank.
    outline_errors : (M,) array
        Outline distance between the query and the centre of each mode, pixels.

    Returns
    -------
    (M, F) float64 array
    """
    distances, votes = np.log(modes.distances + 1e-6), np.log(modes.votes + 1e-6)
    nearest = np.full(len(modes), np.log(candidates.distances[0] + 1e-6))
    return np.stack(
        [
            distances,
            distances - distances.min(),
            votes,
            votes - votes.max(),
            nearest,
            np.asarray(outline_errors, np.float64),
            np.log(np.arange(1, len(modes) + 1)),
            *np.log(_agreements(candidates, modes) + 1e-3),
        ],
        axis=-1,
    )


def _agreements(candidates: Candidates, modes: Modes) -> NDArray[np.float64]:
    """Weighted shares ``(4, M)`` of the candidates that agree with each mode.

    The share of candidates that agree with a hypothesis predicts better whether it is right than
    the fit of the hypothesis itself does.
    """
    mode_joints = modes.points_normalised[:, :JOINTS]
    joints = candidates.points_normalised[:, :JOINTS]
    # With candidates last, because NumPy is several times slower along short axes.
    joints = joints.transpose(2, 1, 0).copy()
    squares = (mode_joints[:, :, 0, None] - joints[0]) ** 2
    squares += (mode_joints[:, :, 1, None] - joints[1]) ** 2
    errors = np.sqrt(squares).sum(axis=1) / JOINTS
    agree = [(errors < px).astype(np.float64) for px in AGREEMENT_PX]
    weights = [candidate_weights(candidates.distances, f) for f in AGREEMENT_FALL_OFFS]
    return np.stack([a @ w / w.sum() for w in weights for a in agree])


def outline_distances(
    silhouette: NDArray[np.uint8], others: NDArray[np.uint8]
) -> NDArray[np.float64]:
    """Mean distance from each outline to the nearest point of the other, averaged both ways.

    Parameters
    ----------
    silhouette : (128, 48) uint8 array
    others : (B, 128, 48) uint8 array

    Returns
    -------
    (B,) float64 array
        Pixels.
    """
    silhouettes = np.concatenate([silhouette[None], others])
    # Shortest paths between two pixels stay within the bounding box of all silhouettes.
    left, top, width, height = cv2.boundingRect(silhouettes.max(axis=0))
    outlines = _outlines(silhouettes[:, top : top + max(1, height), left : left + max(1, width)])
    # Sums of float32 would depend on how many others there are, and on the processor.
    distances = _distance_transforms(outlines).reshape(len(outlines), -1).astype(np.float64)
    on_outline = outlines.reshape(len(outlines), -1).astype(np.float64)
    lengths = np.maximum(on_outline.sum(axis=1), 1)
    from_others = on_outline[1:] @ distances[0] / lengths[1:]
    to_others = distances[1:] @ on_outline[0] / lengths[0]
    return np.asarray((from_others + to_others) / 2)


def _outlines(silhouettes: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Outermost pixels of silhouettes ``(B, H, W)``, found in one tall picture."""
    count, height, width = silhouettes.shape
    # A row of background below each separates them.
    padded = np.zeros((count, height + 1, width), np.uint8)
    padded[:, :height] = silhouettes != 0
    eroded = cv2.erode(
        padded.reshape(-1, width),
        np.ones((3, 3), np.uint8),
        borderType=cv2.BORDER_CONSTANT,
        borderValue=0,
    ).reshape(padded.shape)
    return np.asarray((padded != eroded)[:, :height])


def _distance_transforms(outlines: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Distance ``(B, H, W)`` of each pixel to the outline; the frame's diagonal if it is empty."""
    distances = np.empty(outlines.shape, np.float32)
    for background, distance in zip((~outlines).view(np.uint8), distances, strict=True):
        cv2.distanceTransform(background, cv2.DIST_L2, 3, distance)
    distances[~outlines.any(axis=(1, 2))] = np.hypot(HEIGHT, WIDTH)
    return distances
