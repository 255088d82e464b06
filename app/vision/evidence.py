"""What speaks for a person in a box: the network's presence map inside and around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.body_shape import body_prior
from app.vision.box_arrays import Boxes, iou_matrix
from app.vision.presence import SUITED, PresenceMap

# Boxes are sampled at this many rows, with a margin in shares of their height.
_ROWS = 64
_ASIDE = round(0.3 * _ROWS)
_ABOVE = round(0.15 * _ROWS)
# A presence map judges best the people of this share of its windows' side.
_BEST_SHARE = 0.6

NAMES = (
    "trunk", "beside", "above", "below", "head", "feet", "shape",
    "trunk_other", "beside_other", "above_other", "below_other",
    "hog", "hog_support", "aspect",
)  # fmt: skip


@dataclass(frozen=True)
class _Patch:
    """A presence map resampled around a box, 64 rows to the box's height."""

    values: NDArray[np.float32]
    columns: int

    @property
    def inner(self) -> NDArray[np.float32]:
        """The part inside the box, ``(64, columns)``."""
        return self.values[_ABOVE : _ABOVE + _ROWS, _ASIDE : _ASIDE + self.columns]


def _sample(probability: NDArray[np.float32], box: NDArray[np.float64]) -> _Patch:
    x, y, width, height = box
    columns = max(8, 2 * round(width / height * _ROWS / 2))
    across, down = width / columns, height / _ROWS
    matrix = np.array(
        [
            [across, 0, x - _ASIDE * across + across / 2],
            [0, down, y - _ABOVE * down + down / 2],
        ]
    )
    size = (columns + 2 * _ASIDE, _ROWS + 2 * _ABOVE)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return _Patch(
        cv2.warpAffine(probability, matrix, size, flags=flags).astype(np.float32), columns
    )


def by_fitness(maps: Sequence[PresenceMap], person_px: float) -> list[PresenceMap]:
    """Sort presence maps by how well their windows suit people of a height."""

    def misfit(presence: PresenceMap) -> float:
        share = person_px / presence.side
        return abs(float(np.log(share / _BEST_SHARE))) + (share > 0.95)

    return sorted(maps, key=misfit)


def suited(maps: Sequence[PresenceMap], person_px: float) -> list[PresenceMap]:
    """Maps whose windows suit people of a height, at least one.

    What windows too large for such people make of them is of no use.
    """
    chosen = [one for one in maps if SUITED[0] < person_px / one.side < SUITED[1]]
    return chosen or by_fitness(maps, person_px)[:1]


def tightened(presence: PresenceMap, box: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Box around the presence that hangs together with the middle of a box.

    Parameters
    ----------
    presence : PresenceMap
    box : (4,) float64 array
        A rough box: x, y, width, height.

    Returns
    -------
    (4,) float64 array or None
        None where nobody is in the box's middle.
    """
    patch = _sample(presence.probability, box)
    region = patch.values > 0.5
    middle = _ASIDE + patch.columns // 2
    core = np.zeros_like(region)
    core[_ABOVE + 3 : _ABOVE + round(0.6 * _ROWS), middle - 6 : middle + 6] = True
    core &= region
    if np.count_nonzero(core) < 10:
        return None
    count, labels = cv2.connectedComponents(region.astype(np.uint8))
    chosen = np.bincount(labels[core], minlength=count) > 5
    chosen[0] = False
    own = chosen[labels]
    # A neighbour may hang on: no further than a tenth of the height beyond the rough box.
    reach = round(0.1 * _ROWS)
    own[:, : _ASIDE - reach] = False
    own[:, _ASIDE + patch.columns + reach :] = False
    rows = np.flatnonzero(np.count_nonzero(own, axis=1) >= 2)
    columns = np.flatnonzero(np.count_nonzero(own, axis=0) >= 2)
    if rows.size == 0 or columns.size == 0:
        return None
    across, down = box[2] / patch.columns, box[3] / _ROWS
    return np.array(
        [
            box[0] + (columns[0] - _ASIDE) * across,
            box[1] + (rows[0] - _ABOVE) * down,
            (columns[-1] - columns[0] + 1) * across,
            (rows[-1] - rows[0] + 1) * down,
        ]
    )


def evidence(
    maps: Sequence[PresenceMap],
    boxes: Boxes,
    windows: Boxes,
    window_scores: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Measure the features of candidate boxes.

    Parameters
    ----------
    maps : sequence of PresenceMap
    boxes : (N, 4) float64 array
        Candidates.
    windows, window_scores : (M, 4) and (M,) float64 arrays
        All that the gradient detector found.

    Returns
    -------
    (N, 14) float64 array
        In the order of ``NAMES``.
    """
    features = np.zeros((len(boxes), len(NAMES)))
    for row, box in enumerate(boxes):
        fitting = by_fitness(maps, box[3])
        best, other = fitting[0], fitting[min(1, len(fitting) - 1)]
        patch = _sample(best.probability, box)
        features[row, :7] = _surroundings(patch) + _body(patch)
        features[row, 7:11] = _surroundings(_sample(other.probability, box))
    if len(boxes) and len(windows):
        overlaps = iou_matrix(boxes, windows)
        # A window counts by how well it agrees with the box; 0 where none does.
        features[:, 11] = np.where(overlaps > 0.5, window_scores * overlaps, -np.inf).max(axis=1)
        features[~np.isfinite(features[:, 11]), 11] = 0
        features[:, 12] = np.log1p(np.count_nonzero(overlaps > 0.6, axis=1))
    features[:, 13] = boxes[:, 2] / boxes[:, 3]
    return features


@lru_cache(maxsize=256)
def _expected(
    columns: int,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return the usual body in a box, and weights that take the mean on its trunk and beside it."""
    prior = body_prior(_ROWS, columns)
    trunk, beside = prior > 0.6, prior < 0.2
    return prior, _mean_over(trunk), _mean_over(beside)


def _mean_over(region: NDArray[np.bool_]) -> NDArray[np.float32]:
    return (region / max(1, int(np.count_nonzero(region)))).astype(np.float32)


def _surroundings(patch: _Patch) -> list[float]:
    """Presence on the trunk, beside it, above and below the box."""
    _, trunk, beside = _expected(patch.columns)
    columns = slice(_ASIDE, _ASIDE + patch.columns)
    return [
        float(np.vdot(patch.inner, trunk)),
        float(np.vdot(patch.inner, beside)),
        float(patch.values[: _ABOVE - 2, columns].max(axis=1).mean()),
        float(patch.values[_ABOVE + _ROWS + 2 :, columns].max(axis=1).mean()),
    ]


def _body(patch: _Patch) -> list[float]:
    """Presence of head and feet, and likeness to a body."""
    inner, prior = patch.inner, _expected(patch.columns)[0]
    middle = slice(max(0, patch.columns // 2 - 5), patch.columns // 2 + 5)
    return [
        float(inner[: round(0.12 * _ROWS), middle].mean()),
        float(inner[round(0.9 * _ROWS) :].max(axis=1).mean()),
        float(np.minimum(inner, prior).sum() / np.maximum(inner, prior).sum()),
    ]
