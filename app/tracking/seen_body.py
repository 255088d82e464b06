"""What a frame shows of a tracked person's body: scale, elevation, heading, and a skeleton.

Landmarks show one body directly, so postures and actions need no search of the index. Without
landmarks, the hypotheses of the silhouette are likely bodies.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.estimation.results import Person
from app.networks.dense import shipped_network
from app.tracking.results import SmoothedPose
from app.vision.blazepose import LANDMARK_PX
from app.vision.people import LANDMARK_NAMES, Landmarks
from index.posture import azimuth_deg
from index.skeleton import (
    FACE_NAMES,
    LIMB_HIPS,
    LIMBS,
    POINT_NAMES,
    POINTS,
    SIDES,
    pixels_per_metre,
    rows,
    side_rows,
)

MAX_BODIES = 12
"""Hypotheses that count as likely bodies; 30 are no better."""

# Height from which landmarks have their full weight: the side of the network's window. Landmarks of
# smaller people jitter, so motion counts more.
_FULL_WEIGHT_PX = LANDMARK_PX


@dataclass(frozen=True)
class SeenBody:
    """What one frame shows of a body: N candidate skeletons, one of them right."""

    azimuths_deg: NDArray[np.float64]  # (N,): azimuths of the camera about them
    # (N,): up to a constant, for frames a tenth of a second apart.
    log_likelihoods: NDArray[np.float64]
    clarity: float  # how clearly landmarks show the body, 0 to 1; 0 if none were read
    px_per_m: float  # scale at the person's distance
    elevation_deg: float  # elevation of the camera above the person
    hips_px: NDArray[np.float64]  # (2,): middle of the hips, pixels of the frame
    # (24, 3): the landmarks' skeleton, metres about the hips, axes of the line of sight to them;
    # None without landmarks, until :meth:`in_pose`.
    skeleton: NDArray[np.float64] | None

    @classmethod
    def of(cls, person: Person) -> SeenBody | None:
        """What the frame shows of a person; None without landmarks and hypotheses."""
        if person.landmarks is not None and person.silhouette is not None:
            return cls._by_landmarks(person, person.landmarks)
        return cls._by_hypotheses(person) if person.hypotheses else None

    @classmethod
    def _by_landmarks(cls, person: Person, landmarks: Landmarks) -> SeenBody:
        skeleton, places = _points_of(landmarks.metres), _points_of(landmarks.positions)
        # Hidden points are guesses, in the picture and in space alike.
        scale = pixels_per_metre(skeleton[None], places[None])[0]
        return cls(
            azimuth_deg(skeleton[None]),
            np.zeros(1),
            clarity_of(person),
            max(float(scale), 1e-6),
            elevation_deg(landmarks.metres),
            places[_HIPS].mean(axis=0),
            skeleton,
        )

    @classmethod
    def _by_hypotheses(cls, person: Person) -> SeenBody:
        hypotheses = person.voters[:MAX_BODIES]
        points_3d = np.array([one.points_3d for one in hypotheses])
        points_2d = np.array([one.points_2d for one in hypotheses])
        weights = np.array([one.confidence for one in hypotheses]) + 1e-6
        weights /= weights.sum()
        elevations = np.array([one.label.elevation_deg for one in hypotheses])
        return cls(
            azimuth_deg(points_3d),
            log_likelihoods(person)[:MAX_BODIES],
            clarity_of(person),
            float(weights @ pixels_per_metre(points_3d, points_2d, POINTS)),
            float(weights @ elevations),
            hypotheses[0].points_2d[_HIPS].mean(axis=0),
            None,
        )

    def in_pose(self, pose: SmoothedPose) -> SeenBody:
        """The body with the skeleton, the scale and the place of a smooth pose."""
        # The scale is a ratio of sizes rather than the least squares of
        # index.skeleton.pixels_per_metre, since a smoothed skeleton may be turned away from the
        # points in the picture.
        spread_px, spread_m = (
            float(np.linalg.norm(points - points[_PELVIS], axis=1).sum())
            for points in (pose.points_2d, pose.points_3d[:, :2])
        )
        return replace(
            self,
            px_per_m=max(spread_px, 1e-6) / max(spread_m, 1e-6),
            hips_px=pose.points_2d[_PELVIS],
            skeleton=pose.points_3d,
        )


def log_likelihoods(person: Person) -> NDArray[np.float64]:
    """Log likelihoods ``(N,)`` of a person's hypotheses, see :class:`SeenBody`."""
    hypotheses = person.voters
    result = 1.5 * np.log(np.array([one.confidence for one in hypotheses]) + 1e-3)
    distances = np.array([one.distance for one in hypotheses]) + 1e-9
    # With landmarks, the confidences of all hypotheses that agree with these are near 1.
    weight = clarity_of(person) * 40.0
    return np.asarray(result - weight * np.log(distances / distances.min()))


def clarity_of(person: Person) -> float:
    """How clearly landmarks show a body, see :class:`SeenBody`."""
    if person.landmarks is None:
        return 0.0
    return min(1.0, person.whole_box.height / _FULL_WEIGHT_PX) ** 2


# Points of the trunk, as shares of the way from the middle of the hips to that of the shoulders in
# the skeletons of the index. All other points of a skeleton have landmarks. The head is
# between the ears.
_TRUNK = {"pelvis": 0.03, "spine": 0.46, "chest": 0.72, "neck": 1.06}
_SEEN = [*LIMBS, *FACE_NAMES, *(f"{side}_toe" for side in SIDES)]
_POINT_ROWS = rows(*_SEEN)
_LANDMARK_ROWS = rows(*(name.replace("toe", "foot_index") for name in _SEEN), among=LANDMARK_NAMES)
_TRUNK_ROWS, _TRUNK_SHARES = rows(*_TRUNK), np.array([*_TRUNK.values()])[:, None]
_HEAD, _PELVIS = POINT_NAMES.index("head"), POINT_NAMES.index("pelvis")
_HIPS, _SHOULDERS, _EARS = (side_rows(part) for part in ("hip", "shoulder", "ear"))


def _points_of(landmarks: NDArray[np.float64]) -> NDArray[np.float64]:
    """The points of a skeleton ``(24, D)`` where landmarks ``(33, D)`` show them."""
    points = np.empty((POINTS, landmarks.shape[1]))
    points[_POINT_ROWS] = landmarks[_LANDMARK_ROWS]
    hips, shoulders = points[_HIPS].mean(axis=0), points[_SHOULDERS].mean(axis=0)
    points[_TRUNK_ROWS] = hips + _TRUNK_SHARES * (shoulders - hips)
    points[_HEAD] = points[_EARS].mean(axis=0)
    return points


_LIMB_LANDMARKS = rows(*LIMBS, among=LANDMARK_NAMES)


def elevation_deg(metres: NDArray[np.float64]) -> float:
    """Elevation of the camera above a person with landmarks ``(33, 3)``, as an index has them."""
    features = elevation_features(metres[None, _LIMB_LANDMARKS])
    return float(shipped_network("elevation")(features)[0, 0])


def elevation_features(limbs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Inputs ``(N, 30)`` of the network of elevations, which mirroring does not change.

    The middle of each pair of ``LIMBS`` ``(N, 12, 3)``, in axes of the line of sight, in height and
    depth, and the distances between both sides.
    """
    limbs = limbs - limbs[:, LIMB_HIPS].mean(axis=1, keepdims=True)
    limbs = limbs / np.linalg.norm(limbs, axis=2).mean(axis=1)[:, None, None]
    left, right = limbs[:, 0::2], limbs[:, 1::2]
    parts = ((left + right)[..., 1:] / 2, np.abs(left - right))
    return np.concatenate([part.reshape(len(limbs), -1) for part in parts], axis=1)
