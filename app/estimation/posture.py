"""A person's posture: what the hypotheses vote, and what the landmarks say of lying.

Hypotheses vote with their confidences. Where landmarks are read, a logistic model of the body's
geometry says how likely the person lies or is on all fours; the votes only share out that
probability, and the rest. How far the largest shares can be trusted is calibrated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.vision.models import fitted_constants
from app.vision.odds import log_odds, probability_of
from app.vision.people import LANDMARK_NAMES, Landmarks
from index.posture import ON_THE_GROUND, POSTURES, UPRIGHT, Posture

GROUPS: tuple[tuple[Posture, ...], ...] = (
    ON_THE_GROUND,
    UPRIGHT,
    tuple(posture for posture in POSTURES if posture not in (*ON_THE_GROUND, *UPRIGHT)),
)
"""Postures on the ground, on straight legs, and between the two."""

CLEAR_FROM = 0.5
"""Probability from which a posture is told."""

BENT_FROM_DEG, BENT_SLOPE_DEG = 45.0, 5.0
"""Bend of the straighter knee from which legs do not stand, and how surely it tells. Thighs that
point at the camera look like those of somebody who stands; of who walks, one knee is straight."""

SEAT_UPRIGHT, SEATED = 0.85, 0.8
"""Cosines of the angles of trunk and shanks with the vertical from which two bent knees rather sit
than crouch or kneel, and how often they do: of simulated bodies, 78 %."""

_LEAST_SHARE = 0.02
_ON_THE_GROUND, _UPRIGHT, _BETWEEN = (
    np.array([posture in group for posture in POSTURES]) for group in GROUPS
)
_LYING = np.array([posture == "lying" for posture in POSTURES])
_SITTING = np.array([posture == "sitting" for posture in POSTURES])
_SEATED = SEATED * _SITTING + (1 - SEATED) * (_BETWEEN & ~_SITTING) / (_BETWEEN.sum() - 1)


def _rows(*joints: str) -> list[int]:
    return [LANDMARK_NAMES.index(f"{side}_{joint}") for joint in joints for side in _SIDES]


_SIDES = ("left", "right")
_SHOULDERS, _HIPS, _KNEES, _ANKLES = (
    _rows(joint) for joint in ("shoulder", "hip", "knee", "ankle")
)
_HEAD = [LANDMARK_NAMES.index("nose"), *_rows("ear")]


@dataclass(frozen=True)
class EstimatedPosture:
    """How likely a person is in each posture.

    Parameters
    ----------
    label : str
        The likeliest, ``unclear`` below :data:`CLEAR_FROM`.
    probability : float
        Calibrated probability of the likeliest.
    shares : (10,) float64 array
        Of each of ``POSTURES``; they sum to 1.
    """

    label: Posture | Literal["unclear"]
    probability: float
    shares: NDArray[np.float64] = field(default_factory=lambda: np.zeros(len(POSTURES)))

    def share(self, postures: Sequence[Posture]) -> float:
        """Sum of the shares of some postures."""
        return float(sum(self.shares[POSTURES.index(posture)] for posture in postures))


def vote_posture(postures: Sequence[Posture], weights: Sequence[float]) -> NDArray[np.float64]:
    """Let hypotheses vote.

    Parameters
    ----------
    postures : sequence of str
        Of at least one hypothesis.
    weights : sequence of float

    Returns
    -------
    (10,) float64 array
        Share of each of ``POSTURES``.
    """
    votes = np.zeros(len(POSTURES))
    for posture, weight in zip(postures, weights, strict=True):
        votes[POSTURES.index(posture)] += weight + 1e-9  # Equal votes if all weights are 0.
    return np.asarray(votes / votes.sum())


def estimate_posture(
    votes: NDArray[np.float64], landmarks: Landmarks | None, presence: float = 1.0
) -> EstimatedPosture:
    """Tell a posture.

    Parameters
    ----------
    votes : (10,) float64 array
        Of :func:`vote_posture`.
    landmarks : Landmarks or None
        None where none were read.
    presence : float
        Probability that there is a person at all.
    """
    if landmarks is not None:
        votes = with_grounded(
            with_bent_legs(votes, landmarks, presence), grounded_probability(landmarks)
        )
    return posture_of(votes, presence)


def posture_of(shares: NDArray[np.float64], presence: float = 1.0) -> EstimatedPosture:
    """The likeliest posture of shares ``(10,)``.

    The probability that its group is right is calibrated on photographs, where it is known who
    lies, and who is on their legs; within the group the shares decide. Of who is on the ground,
    photographs do not tell whether they lie or crawl: the probability is that of either.
    """
    best = int(shares.argmax())
    group = next(group for group in GROUPS if POSTURES[best] in group)
    in_group = float(shares[[POSTURES.index(posture) for posture in group]].sum())
    probability = presence * group_probability(in_group)
    if group is not ON_THE_GROUND:
        probability *= float(shares[best]) / in_group
    label = POSTURES[best] if probability >= CLEAR_FROM else "unclear"
    return EstimatedPosture(label, probability, shares)


def group_probability(share: float) -> float:
    """Probability that the group of the likeliest posture is right, by the group's share."""
    constants = fitted_constants("posture")
    return probability_of(constants["slope"] * log_odds(share) + constants["offset"])


def with_bent_legs(
    votes: NDArray[np.float64], landmarks: Landmarks, presence: float
) -> NDArray[np.float64]:
    """Votes ``(10,)`` without those for straight legs, as far as both knees are seen to be bent.

    Where no vote is for bent legs, who holds trunk and shanks upright mostly sits; else it stays
    open whether they sit, crouch or kneel.
    """
    bent = presence * bent_probability(landmarks)
    kept = np.where(_UPRIGHT, 1 - bent, 1.0) * votes
    stand_in = _SEATED if _sits_upright(landmarks) else _BETWEEN
    return np.asarray(kept + bent * votes[_UPRIGHT].sum() * _within(votes, _BETWEEN, stand_in))


def _sits_upright(landmarks: Landmarks) -> bool:
    """Whether trunk and shanks are upright."""
    metres = landmarks.metres
    trunk = _unit(_middle(metres, _SHOULDERS) - _middle(metres, _HIPS))
    shanks = [_unit(bone) for bone in metres[_ANKLES] - metres[_KNEES]]
    return bool(min(-trunk[1], np.mean(shanks, axis=0)[1]) >= SEAT_UPRIGHT)


def bent_probability(landmarks: Landmarks) -> float:
    """Probability that both knees are bent; 0 where a leg is not seen."""
    hips, knees, ankles = (landmarks.metres[rows] for rows in (_HIPS, _KNEES, _ANKLES))
    if landmarks.visibility[[*_HIPS, *_KNEES, *_ANKLES]].min() < 0.5:
        return 0.0
    cosines = [_unit(knee - hip) @ _unit(ankle - knee)
               for hip, knee, ankle in zip(hips, knees, ankles, strict=True)]  # fmt: skip
    straighter_deg = np.rad2deg(np.arccos(np.clip(max(cosines), -1, 1)))
    return probability_of(float(straighter_deg - BENT_FROM_DEG) / BENT_SLOPE_DEG)


def with_grounded(votes: NDArray[np.float64], probability: float) -> NDArray[np.float64]:
    """Votes ``(10,)``, scaled so that those for the ground have this probability."""
    # Where all hypotheses lie and the landmarks do not, it stays open what they do.
    lying = _within(votes, _ON_THE_GROUND, _LYING)
    others = _within(votes, ~_ON_THE_GROUND, _BETWEEN)
    return np.asarray(probability * lying + (1 - probability) * others)


def _within(
    votes: NDArray[np.float64],
    group: NDArray[np.bool_],
    stand_in: NDArray[np.bool_] | NDArray[np.float64],
) -> NDArray[np.float64]:
    """Shares ``(10,)`` within a group; where hardly any vote is for it, those of stand-ins."""
    shares = np.where(group, votes, 0.0)
    if shares.sum() < _LEAST_SHARE:
        shares = shares + _LEAST_SHARE * stand_in / stand_in.sum()
    return np.asarray(shares / shares.sum())


def grounded_probability(landmarks: Landmarks) -> float:
    """Probability that a person lies or is on all fours."""
    constants = fitted_constants("grounded")
    features = (body_features(landmarks) - constants["means"]) / constants["scales"]
    odds = float(features @ np.array(constants["weights"]) + constants["offset"])
    return probability_of(odds)


def body_features(landmarks: Landmarks) -> NDArray[np.float64]:
    """Geometry of a body that tells lying from all else, ``(22,)``.

    Directions of trunk, body, thighs and shanks against the vertical, heights of head, shoulders
    and hips, spread, and which parts are seen; left and right count alike.
    """
    metres, places = landmarks.metres, landmarks.positions
    size = (
        np.linalg.norm(_middle(metres, _SHOULDERS) - _middle(metres, _HIPS))
        + np.linalg.norm(metres[_KNEES] - metres[_HIPS], axis=1).mean()
        + np.linalg.norm(metres[_ANKLES] - metres[_KNEES], axis=1).mean()
    )
    width, height = np.ptp(places, axis=0)
    extent = max(width, height) + 1e-6
    trunk = _unit(_middle(metres, _SHOULDERS) - _middle(metres, _HIPS))
    trunk_2d = _unit(_middle(places, _SHOULDERS) - _middle(places, _HIPS))
    body_2d = _unit(_middle(places, _SHOULDERS) - _middle(places, _ANKLES))
    thighs = [float(_unit(bone)[1]) for bone in metres[_KNEES] - metres[_HIPS]]
    shanks = [float(_unit(bone)[1]) for bone in metres[_ANKLES] - metres[_KNEES]]

    def rise(points: NDArray[np.float64], above: list[int], below: list[int]) -> float:
        return float(_middle(points, below)[1] - _middle(points, above)[1])

    return np.array(
        [
            -trunk[1], abs(trunk[2]), trunk[2], -trunk_2d[1], abs(trunk_2d[0]), -body_2d[1],
            np.mean(thighs), max(thighs), np.mean(shanks), max(shanks), min(shanks),
            rise(metres, _HEAD, _HIPS) / size,
            rise(metres, _HIPS, _ANKLES) / size,
            rise(metres, _SHOULDERS, _KNEES) / size,
            rise(places, _HEAD, _ANKLES) / extent,
            rise(places, _HIPS, _ANKLES) / extent,
            rise(places, _SHOULDERS, _HIPS) / extent,
            np.log((width + 1) / (height + 1)),
            np.ptp(metres[:, 1]) / size,
            landmarks.visibility[_ANKLES].max(),
            landmarks.visibility[_KNEES].max(),
            landmarks.visibility[_HEAD].max(),
        ],
        np.float64,
    )  # fmt: skip


def _middle(points: NDArray[np.float64], rows: list[int]) -> NDArray[np.float64]:
    return np.asarray(points[rows].mean(axis=0))


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-6))
