"""From a silhouette to the entries nearest to it, as in the paper [1]_.

The vectors of all entries are compared with that of the silhouette, in FAISS's ``IndexFlatL2``. The
nearest entries are the hypotheses, in the order of their distances, with their skeletons as they
are. The confidence of each follows from its reprojection: how far its joints lie outside the
silhouette, and its outline from that of the silhouette.

References
----------
.. [1] D. F. Atrevi, D. Vivet, F. Duculty, B. Emile, "3D Human Poses Estimation from a
   Single 2D Silhouette", VISAPP 2016.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from index.candidates import Candidates, RotatedQuery, find_candidates, silhouette_rotations
from index.matching import DEFAULT_HYPOTHESES, Match, PoseHypothesis, Query, headings, votes_of
from index.modes import Modes
from index.posture import front_share
from index.skeleton import JOINTS
from index.store import PoseIndex

REPROJECTION = ("joints_outside_px", "outline_px")
"""The reprojection error of an entry, in pixels of the normalised frame: the mean distance of its
joints to the silhouette, 0 for joints inside, and the mean distance between the outlines."""

# Log odds that an entry is right (:data:`index.confidence.RIGHT_BELOW_PX`): the weights of the
# logarithms of its reprojection error, one pixel added to each, and the offset. No weight is
# positive. Fitted by `python -m scripts fit-paper` to 30,100 entries near 4,300 simulated
# silhouettes, every second one degraded, of clips and bodies that the index asked does not hold.
WEIGHTS, OFFSET = np.array([-0.842, -5.898]), 5.143


def match_nearest(
    index: PoseIndex, silhouette: NDArray[np.uint8], n: int, *, roll_deg: float = 0.0
) -> Match:
    """Find the ``n`` entries nearest to a silhouette, nearest first.

    Parameters are those of :func:`index.silhouette_matching.match_silhouette`.
    """
    count = max(n, DEFAULT_HYPOTHESES)
    entries = nearest_entries(index, silhouette, count, roll_deg=roll_deg)
    query = Query(index, silhouette, roll_deg)
    errors_px = reprojection_errors(query, entries)
    hypotheses = _hypotheses(query, entries, errors_px)
    voters = hypotheses[:DEFAULT_HYPOTHESES]
    votes = np.array([one.confidence for one in voters])
    return Match(hypotheses, front_share(headings(voters), votes), voters, votes_of(voters))


def nearest_entries(
    index: PoseIndex, silhouette: NDArray[np.uint8], n: int, *, roll_deg: float = 0.0
) -> Candidates:
    """The ``n`` entries or mirror images of entries nearest to a silhouette ``(128, 48)``.

    The search is exact; see :attr:`index.store.PoseIndex.exact`. Silhouettes that are wide, or
    nearly so, are searched in each rotation that the person may have.
    """
    rotations = silhouette_rotations(silhouette, roll_deg)
    queries = [RotatedQuery.of(silhouette, rotation) for rotation in rotations]
    return find_candidates(index.exact, queries, n).take(slice(n))


def reprojection_errors(query: Query, entries: Candidates) -> NDArray[np.float64]:
    """Reprojection errors ``(N, 2)`` of entries on a silhouette, see :data:`REPROJECTION`."""
    outline_px = query.outline_distances(entries.entry_ids, entries.mirrored, entries.rotation_deg)
    outside_px = distances_outside(query.silhouette, entries.points_normalised[:, :JOINTS])
    return np.stack([outside_px.mean(axis=1), outline_px], axis=1)


def distances_outside(
    silhouette: NDArray[np.uint8], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distances ``(...)`` in pixels of points ``(..., 2)`` to a silhouette, 0 inside it."""
    away = cv2.distanceTransform((silhouette == 0).view(np.uint8), cv2.DIST_L2, 5)
    inside = np.clip(points, 0, np.array(silhouette.shape[::-1]) - 1)
    columns, rows = np.rint(inside).astype(int).transpose(-1, *range(points.ndim - 1))
    return away[rows, columns] + np.linalg.norm(points - inside, axis=-1)


def reprojection_confidence(errors_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Probabilities ``(N,)`` that entries with reprojection errors ``(N, 2)`` are right."""
    return 1 / (1 + np.exp(-(np.log1p(errors_px) @ WEIGHTS + OFFSET)))


def _hypotheses(
    query: Query, entries: Candidates, errors_px: NDArray[np.float64]
) -> list[PoseHypothesis]:
    centres = np.arange(len(entries))
    each = Modes(centres, entries.distances, entries.points_3d, entries.points_normalised)
    return query.hypotheses(
        entries,
        each,
        distance=entries.distances,
        confidence=reprojection_confidence(errors_px),
        reprojection_error_px=errors_px[:, 1],
        features=errors_px,
    )
