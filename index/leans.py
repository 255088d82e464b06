"""People who lean, or whom an askew camera sees: candidates of the silhouette turned upright."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from descriptor.silhouette import HEIGHT, WIDTH, normalise
from index.candidates import Candidates, candidates_of, find_candidates_of_each
from index.keypoint_search import Nearest
from index.store import PoseIndex

STEP_DEG = 15.0
"""People lean by multiples of this, as far as candidates are looked for."""

LEANS, LEAST_SHARE = 5, 0.03
"""So many leans are looked at, upright among them: those that most entries near the keypoints
have, and at least such a share of them."""

FARTHEST_DEG = 60.0

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


def likely_leans(roll_deg: NDArray[np.float64]) -> tuple[float, ...]:
    """Upright, and the leans that most entries near the keypoints have.

    Parameters
    ----------
    roll_deg : (K,) float64 array
        Of :class:`index.keypoint_search.Nearest`.

    Returns
    -------
    tuple of float
        Ascending multiples of :data:`STEP_DEG`.
    """
    steps = np.clip(np.rint(roll_deg / STEP_DEG) * STEP_DEG, -FARTHEST_DEG, FARTHEST_DEG)
    leans, counts = np.unique(steps[steps != 0], return_counts=True)
    order = np.argsort(-counts, kind="stable")[: LEANS - 1]
    likeliest = leans[order][counts[order] >= LEAST_SHARE * len(steps)]
    return tuple(sorted({0.0, *likeliest.tolist()}))


def leaning_candidates_of(
    index: PoseIndex, leanings: Sequence[Leaning], nearest: Nearest
) -> Candidates:
    """Compare a silhouette with entries near its keypoints, each with the lean nearest to its own.

    Returns
    -------
    Candidates
        In ascending distance, as :func:`find_leaning_candidates` gives them.
    """
    leans = np.array([one.lean_deg for one in leanings])
    which = np.abs(nearest.roll_deg[:, None] - leans).argmin(axis=1)
    return Candidates.merged(
        [
            _turned_back(
                candidates_of(
                    index,
                    leaning.upright,
                    nearest.numbers[which == position],
                    nearest.mirrored[which == position],
                ),
                leaning,
            )
            for position, leaning in enumerate(leanings)
            if (which == position).any()
        ]
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
