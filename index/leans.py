"""People who lean, or whom an askew camera sees: candidates of the silhouette turned upright."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from descriptor.silhouette import HEIGHT, WIDTH, normalise
from index.candidates import Candidates, find_candidates_of_each
from index.store import PoseIndex

_FINER = 2


@dataclass(frozen=True)
class Leaning:
    """A silhouette as if the person leant, set upright.

    Parameters
    ----------
    lean_deg : float
        How far, clockwise in the picture.
    upright : (128, 48) uint8 array
    back : (2, 3) float64 array
        From its pixels to those of the silhouette as it came.
    """

    lean_deg: float
    upright: NDArray[np.uint8]
    back: NDArray[np.float64]

    @classmethod
    def of(cls, silhouette: NDArray[np.uint8], lean_deg: float) -> Leaning:
        """Set a silhouette ``(128, 48)`` upright."""
        if lean_deg == 0:
            return cls(0.0, silhouette, np.eye(2, 3))
        return cls(lean_deg, *turned(silhouette, -lean_deg))


def find_leaning_candidates(index: PoseIndex, leanings: Sequence[Leaning], k: int) -> Candidates:
    """Find the ``k`` nearest to a silhouette for each of some leans, all together.

    An index holds hardly a camera that hangs askew; turning the query instead finds the same.

    Parameters
    ----------
    index : PoseIndex
    leanings : sequence of Leaning
        Of one silhouette; upright must be among them if wanted.
    k : int
        For each.

    Returns
    -------
    Candidates
        In ascending distance; points lie on the silhouette as it came, and skeletons lean.
    """
    found = find_candidates_of_each(index, np.stack([one.upright for one in leanings]), k)
    return Candidates.merged(
        [_turned_back(some, one) for some, one in zip(found, leanings, strict=True)]
    )


def turned(
    silhouette: NDArray[np.uint8], angle_deg: float
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Turn a silhouette clockwise and normalise it again.

    Returns
    -------
    turned : (128, 48) uint8 array
    back : (2, 3) float64 array
        From its pixels to those of the silhouette as it came.
    """
    sine, cosine = abs(np.sin(np.deg2rad(angle_deg))), abs(np.cos(np.deg2rad(angle_deg)))
    # Room for all of it, of even size.
    size = 2 * np.ceil(
        _FINER / 2 * np.array([WIDTH * cosine + HEIGHT * sine, WIDTH * sine + HEIGHT * cosine])
    )
    # Pixel p of the silhouette lies at _FINER * p + corner on the canvas.
    corner = (size - 1 - _FINER * np.array([WIDTH - 1, HEIGHT - 1])) / 2
    # OpenCV turns counterclockwise.
    turn = cv2.getRotationMatrix2D(((size - 1) / 2).tolist(), -angle_deg, 1.0)
    drawn = np.column_stack([_FINER * turn[:, :2], turn[:, :2] @ corner + turn[:, 2]])
    canvas = cv2.warpAffine(silhouette.astype(np.float32), drawn, size.astype(int).tolist())
    # A thin silhouette must not vanish: what covers most stays.
    upright, placement = normalise(canvas >= min(0.5, float(canvas.max())))
    offset = np.array([placement.offset_x, placement.offset_y])
    inverse = cv2.invertAffineTransform(drawn)
    linear = inverse[:, :2] / placement.scale
    return upright, np.column_stack([linear, inverse[:, 2] - linear @ offset])


def _turned_back(candidates: Candidates, leaning: Leaning) -> Candidates:
    if leaning.lean_deg == 0:
        return candidates
    back = leaning.back
    return replace(
        candidates,
        lean_deg=np.full(len(candidates), leaning.lean_deg),
        points_3d=turned_clockwise(candidates.points_3d, leaning.lean_deg),
        points_normalised=candidates.points_normalised @ back[:, :2].T + back[:, 2],
    )


def turned_clockwise(points_3d: NDArray[np.float64], angle_deg: float) -> NDArray[np.float64]:
    """Turn points ``(..., 3)`` in camera axes about the optical axis, clockwise in the picture."""
    angle = np.deg2rad(angle_deg)
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
    return np.asarray(points_3d @ turn)
