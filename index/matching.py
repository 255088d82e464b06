"""Parts shared by matching with and without landmarks: query, hypotheses, and their batches.

Entries near the query are candidates; modes are poses at which candidates gather; hypotheses are
modes in the order of their distances, with a confidence. :mod:`index.silhouette_matching` finds
them from a silhouette alone, :mod:`index.landmark_matching` from a silhouette and landmarks.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from descriptor.silhouette import outline_distances
from index.candidates import Candidates, RotatedQuery
from index.modes import Modes
from index.posture import (
    POSTURES,
    PostureName,
    azimuth_deg,
    camera_up,
    classify_postures,
    lying_elevation_deg,
    vote_posture,
)
from index.skeleton import POINTS, mean_joint_distance, rotate_clockwise, wrap_degrees
from index.store import Label, PoseIndex

DEFAULT_HYPOTHESES = 7
"""Hypotheses returned unless a caller asks for another number. The confidence is fitted for this
number, and this many decide posture and facing however many are requested. They are the first
batch; each later batch is twice as large, so that the first k of n hypotheses are those found when
k are requested."""

MIN_NEW_POSE_M = 0.055
"""Mean joint distance from all earlier hypotheses that makes one of a later batch new."""


SPARE_MODES = 4
"""Modes computed beyond those requested: a sparse mode may fit best."""

CANDIDATES_PER_HYPOTHESIS = 20
"""Fewest candidates of one kind for each hypothesis requested."""

MAX_CANDIDATE_GROWTH = 16
"""Factor by which the candidates may grow if they hold too few distinct poses."""


@dataclass(frozen=True)
class PoseHypothesis:
    """A skeleton that may have cast the silhouette, and how well it fits.

    Parameters
    ----------
    entry_id, mirrored
        The entry at the centre of those that agree on this pose (with landmarks, one with a near
        silhouette and the usual action among them), and whether this is its mirror image.
    silhouette_distance : float
        Euclidean distance from the query's descriptor to the interpolated one of these entries.
    confidence : float
        Probability that the hypothesis is right; see :mod:`index.confidence`.
    label : Label
        That of the entry; the roll is that of its camera in the picture of one that is not rolled.
    points_3d : (24, 3) float64 array
        Axes of the line of sight, metres, origin at the pelvis; rows are ``POINT_NAMES``. Once
        placed in a photograph, in the camera's axes and the person's size.
    points_2d : (24, 2) float64 array
        Pixels of the normalised frame; once placed, of the photograph.
    rotation_deg : float
        In-plane rotation of the entry, clockwise, in the picture of a camera that is not rolled,
        already applied to the points.
    distance : float
        The silhouette distance, shortened or lengthened by the agreement with landmarks or, without
        landmarks, lengthened if a network finds the joints unlikely; see
        :mod:`index.silhouette_matching`.
    adjusted_m : float
        Mean joint distance from the skeleton of the entry.
    weight : float or None
        Probability that this is nearer to the truth than all others of the first
        :data:`DEFAULT_HYPOTHESES`; 0 for later ones, None without landmarks.
    reprojection_error_px : float
        Mean distance, in pixels of the normalised frame, between the entry, scaled and placed on
        the person, and what was observed: from its points to their landmarks or, without landmarks,
        between the outlines, averaged both ways.
    in_depth : bool
        Whether this is the first hypothesis at other depths.
    twin : bool
        Whether this is the first hypothesis seen from behind: depth reversed, left and right
        exchanged. Its outline is the same; all fields about the entry are the first hypothesis's.
    features : (F,) float64 array
        What the confidence follows from; see :mod:`index.confidence`.
    """

    entry_id: int
    mirrored: bool
    silhouette_distance: float
    confidence: float
    label: Label
    points_3d: NDArray[np.float64]
    points_2d: NDArray[np.float64]
    posture: PostureName = "standing"
    rotation_deg: float = 0.0
    distance: float = 0.0
    adjusted_m: float = 0.0
    weight: float | None = None
    reprojection_error_px: float = math.nan
    in_depth: bool = False
    twin: bool = False
    features: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        if self.points_3d.shape != (POINTS, 3) or self.points_2d.shape != (POINTS, 2):
            raise ValueError(
                f"expected points of shapes ({POINTS}, 3) and ({POINTS}, 2), "
                f"got {self.points_3d.shape} and {self.points_2d.shape}"
            )


@dataclass(frozen=True)
class Match:
    """The hypotheses of a silhouette, in the order of their rank.

    Parameters
    ----------
    hypotheses : list of PoseHypothesis
        The likeliest first; see :func:`ranked`. The first ``k`` do not depend on how many were
        requested. At least :data:`DEFAULT_HYPOTHESES`, but fewer if few distinct poses fit. With
        landmarks, some of the first seven face the opposite way to the first.
    front_probability : float
        Probability that the camera sees the person from the front: the confidence of voters that
        face it, as a share of the confidence of all. It does not depend on how many were requested.
    voters : list of PoseHypothesis
        The hypotheses that decide the posture, however many were requested: modes, but no
        alternatives in depth and no twin.
    postures : (10,) float64 array
        Share of each of :data:`index.posture.POSTURES`: in the votes of the voters, weighted by
        confidence; of a silhouette alone, if there is a network, their probabilities.
    """

    hypotheses: list[PoseHypothesis]
    front_probability: float
    voters: list[PoseHypothesis]
    postures: NDArray[np.float64]


@dataclass(frozen=True)
class Query:
    """One normalised silhouette ``(128, 48)``, the roll of its camera, and the index to search.

    The roll is not 0 if the silhouette was rotated because it is wide; skeletons are returned in
    the axes of the camera without it.
    """

    index: PoseIndex
    silhouette: NDArray[np.uint8]
    roll_deg: float

    def rotations(self, entries: Candidates) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Rotations ``(M,)`` of entries for a camera that is not rolled, and their tilts."""
        rotation_deg = entries.rotation_deg - self.roll_deg
        entry_roll_deg = self.index.roll_deg(entries.entry_ids, entries.mirrored)
        return rotation_deg, wrap_degrees(rotation_deg + entry_roll_deg)

    def outline_distances(
        self,
        entry_ids: NDArray[np.int64],
        mirrored: NDArray[np.bool_],
        rotation_deg: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Outline distances ``(M,)`` of entries, as rotated in the frame of the silhouette."""
        silhouettes = self.index.silhouettes(entry_ids)
        silhouettes[mirrored] = silhouettes[mirrored, :, ::-1]
        distances = np.empty(len(entry_ids))
        for rotation in np.unique(rotation_deg).tolist():
            query, rows = RotatedQuery.of(self.silhouette, rotation), rotation_deg == rotation
            distances[rows] = outline_distances(query.silhouette, silhouettes[rows])
        return distances

    def hypotheses(
        self, candidates: Candidates, modes: Modes, **columns: NDArray[Any]
    ) -> list[PoseHypothesis]:
        """Modes of candidates as hypotheses; ``columns`` are their other fields, ``(M, ...)``."""
        entries = candidates.take(modes.centres)
        rotation_deg, tilt_deg = self.rotations(entries)
        points_3d = rotate_clockwise(modes.points_3d, -self.roll_deg)
        columns |= {
            "entry_id": entries.entry_ids,
            "mirrored": entries.mirrored,
            "silhouette_distance": modes.distances,
            "points_3d": points_3d,
            "points_2d": modes.points_normalised,
            "rotation_deg": rotation_deg,
            "adjusted_m": mean_joint_distance(modes.points_3d, entries.points_3d),
        }
        rows = zip(*(c.tolist() if c.ndim == 1 else c for c in columns.values()), strict=True)
        postures = self._postures(entries.entry_ids, points_3d, tilt_deg)
        labels = [
            replace(self.index.label(entry_id, mirrored=mirrored), roll_deg=roll_deg)
            for entry_id, mirrored, roll_deg in zip(
                entries.entry_ids.tolist(),
                entries.mirrored.tolist(),
                tilt_deg.tolist(),
                strict=True,
            )
        ]
        return [
            PoseHypothesis(posture=posture, label=label, **dict(zip(columns, row, strict=True)))
            for posture, label, row in zip(postures, labels, rows, strict=True)
        ]

    def _postures(
        self,
        entry_ids: NDArray[np.int64],
        points_3d: NDArray[np.float64],
        tilt_deg: NDArray[np.float64],
    ) -> list[PostureName]:
        """Postures of skeletons interpolated about entries, in a camera that is not rolled."""
        entries = self.index.entries[entry_ids]
        # A person tilted by more than this in the picture is lying rather than standing.
        tilted = np.abs(tilt_deg) > 30.0
        elevation_deg = np.where(tilted, lying_elevation_deg(points_3d), entries["elevation_deg"])
        speeds = self.index.skeleton_labels["speed"][entries["skeleton"]]
        return [
            POSTURES[row] for row in classify_postures(points_3d, camera_up(elevation_deg), speeds)
        ]


def with_later_batches(
    batch: Callable[[int, float], list[PoseHypothesis]], first: list[PoseHypothesis], n: int
) -> list[PoseHypothesis]:
    """The first batch, and the new poses of as many later ones as ``n`` hypotheses need.

    Parameters
    ----------
    batch : callable
        Finds about as many hypotheses as its first argument says; no distance is smaller than its
        second argument, the largest of earlier batches.
    """
    found, size = first, DEFAULT_HYPOTHESES
    while len(found) < n or size < n:
        size *= 2
        new = unlike(batch(size, max(one.distance for one in found)), found)
        # Stop once a batch of this many times the requested number adds no new pose: only a few
        # poses may fit a hardly visible person, and searching for 50 took seconds.
        if not new and size >= 4 * n:
            break
        found = found + likeliest_first(new)
    return found


def likeliest_first(hypotheses: Sequence[PoseHypothesis]) -> list[PoseHypothesis]:
    return sorted(hypotheses, key=lambda one: (-one.confidence, one.distance))


def ranked(
    hypotheses: Sequence[PoseHypothesis], weights: Sequence[float] = ()
) -> list[PoseHypothesis]:
    """The same hypotheses, none with a higher confidence or a smaller distance than those before.

    Batches are ordered one by one: this concerns the nearer ones of later batches, and distances.
    The first ones get these weights, all others 0; without weights, all keep theirs.
    """
    distances = np.maximum.accumulate([one.distance for one in hypotheses]).tolist()
    confidences = np.minimum.accumulate([one.confidence for one in hypotheses]).tolist()
    shares = [*weights, *([0.0 if weights else None] * len(hypotheses))]
    return [
        replace(one, distance=distance, confidence=confidence, weight=weight)
        for one, distance, confidence, weight in zip(
            hypotheses, distances, confidences, shares, strict=False
        )
    ]


def unlike(
    others: Sequence[PoseHypothesis], known: Sequence[PoseHypothesis]
) -> list[PoseHypothesis]:
    if not others:
        return []
    poses, earlier = (np.array([one.points_3d for one in some]) for some in (others, known))
    nearest = mean_joint_distance(poses[:, None], earlier).min(axis=1)
    return [one for one, m in zip(others, nearest, strict=True) if m >= MIN_NEW_POSE_M]


def votes_of(voters: Sequence[PoseHypothesis]) -> NDArray[np.float64]:
    """Shares ``(10,)`` of postures among hypotheses, weighted by their confidences."""
    return vote_posture([one.posture for one in voters], [one.confidence for one in voters])


def headings(hypotheses: Sequence[PoseHypothesis]) -> NDArray[np.float64]:
    """Azimuths ``(N,)`` of the camera about hypotheses; see :func:`index.posture.azimuth_deg`."""
    return azimuth_deg(np.array([one.points_3d for one in hypotheses]))
