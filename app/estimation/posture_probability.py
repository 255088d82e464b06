"""How likely a person is in each posture: votes of hypotheses, corrected by landmarks.

Each hypothesis has a posture by the rules of :mod:`index.posture` and votes with its confidence. If
there are landmarks, two bent knees take votes from standing postures, and a logistic model of the
body's geometry gives the probability that the person is on the ground; the votes then only divide
that probability, and the rest, among the postures. The probability of the likeliest is calibrated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.estimation.parameters import POSTURE
from app.vision.models import fitted_constants
from app.vision.odds import log_odds, probability_of
from app.vision.people import LANDMARK_NAMES, Landmarks
from index.posture import ON_THE_GROUND, POSTURES, UPRIGHT, Posture
from index.skeleton import rows, side_rows

GROUPS: tuple[tuple[Posture, ...], ...] = (
    ON_THE_GROUND,
    UPRIGHT,
    tuple(posture for posture in POSTURES if posture not in (*ON_THE_GROUND, *UPRIGHT)),
)
"""Postures on the ground, on straight legs, and between the two."""

_ON_THE_GROUND, _UPRIGHT, _BETWEEN = (
    np.array([posture in group for posture in POSTURES]) for group in GROUPS
)
_LYING = np.array([posture == "lying" for posture in POSTURES])
_SITTING = np.array([posture == "sitting" for posture in POSTURES])
_SEATED = POSTURE.seated_share * _SITTING + (1 - POSTURE.seated_share) * (_BETWEEN & ~_SITTING) / (
    _BETWEEN.sum() - 1
)

_SHOULDERS, _HIPS, _KNEES, _ANKLES = (
    side_rows(joint, among=LANDMARK_NAMES) for joint in ("shoulder", "hip", "knee", "ankle")
)
_HEAD = rows("nose", "left_ear", "right_ear", among=LANDMARK_NAMES)


@dataclass(frozen=True)
class EstimatedPosture:
    """How likely a person is in each posture.

    Parameters
    ----------
    label : str
        The likeliest posture, or ``unclear`` if its probability is too small.
    probability : float
        Calibrated probability of the likeliest posture.
    shares : (10,) float64 array
        Share of each of ``POSTURES``; they sum to 1.
    """

    label: Posture | Literal["unclear"]
    probability: float
    shares: NDArray[np.float64] = field(default_factory=lambda: np.zeros(len(POSTURES)))

    def share(self, postures: Sequence[Posture]) -> float:
        """Sum of the shares of the given postures."""
        return float(sum(self.shares[POSTURES.index(posture)] for posture in postures))


def vote_posture(postures: Sequence[Posture], weights: Sequence[float]) -> NDArray[np.float64]:
    """Let at least one hypothesis vote.

    Parameters
    ----------
    postures : sequence of str
        Posture of each hypothesis.
    weights : sequence of float
        Confidence of each hypothesis.

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
    """Estimate the posture of a person.

    Parameters
    ----------
    votes : (10,) float64 array
        From :func:`vote_posture`.
    presence : float
        Probability that there is a person at all.
    """
    if landmarks is not None:
        votes = with_on_ground(
            with_bent_legs(votes, landmarks, presence), on_ground_probability(landmarks)
        )
    return posture_of(votes, presence)


def posture_of(shares: NDArray[np.float64], presence: float = 1.0) -> EstimatedPosture:
    """The likeliest of the postures with shares ``(10,)``, and its probability.

    The probability that its group is right is calibrated on photographs whose people are known to
    be on the ground, upright, or between the two; within the group the shares decide. Those
    photographs do not distinguish lying from crawling, so on the ground the probability is that of
    either.
    """
    best = int(shares.argmax())
    group = next(group for group in GROUPS if POSTURES[best] in group)
    in_group = float(shares[[POSTURES.index(posture) for posture in group]].sum())
    probability = presence * group_probability(in_group)
    if group is not ON_THE_GROUND:
        probability *= float(shares[best]) / in_group
    label = POSTURES[best] if probability >= POSTURE.min_probability else "unclear"
    return EstimatedPosture(label, probability, shares)


def group_probability(share: float) -> float:
    """Calibrated probability that a group of postures with this share is right."""
    constants = fitted_constants("posture")
    return probability_of(constants["slope"] * log_odds(share) + constants["offset"])


def with_bent_legs(
    votes: NDArray[np.float64], landmarks: Landmarks, presence: float
) -> NDArray[np.float64]:
    """Move votes ``(10,)`` from straight legs to bent ones, as far as both knees look bent.

    They go to the postures between upright and on the ground in proportion to their votes. Without
    such votes, a person with upright trunk and shanks is mostly sitting; otherwise sitting,
    crouching and kneeling stay equally likely.
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
    return bool(min(-trunk[1], np.mean(shanks, axis=0)[1]) >= POSTURE.min_seat_cosine)


def bent_probability(landmarks: Landmarks) -> float:
    """Probability that both knees are bent; 0 if a leg is not visible."""
    if landmarks.visibility[[*_HIPS, *_KNEES, *_ANKLES]].min() < POSTURE.min_leg_visibility:
        return 0.0
    hips, knees, ankles = (landmarks.metres[joint] for joint in (_HIPS, _KNEES, _ANKLES))
    cosines = [
        _unit(knee - hip) @ _unit(ankle - knee)
        for hip, knee, ankle in zip(hips, knees, ankles, strict=True)
    ]
    straighter_deg = np.rad2deg(np.arccos(np.clip(max(cosines), -1, 1)))
    return probability_of(float(straighter_deg - POSTURE.bent_from_deg) / POSTURE.bent_slope_deg)


def with_on_ground(votes: NDArray[np.float64], probability: float) -> NDArray[np.float64]:
    """Scale votes ``(10,)`` so that the postures on the ground have this probability."""
    # If all hypotheses are lying and the landmarks are not, the other posture stays open.
    lying = _within(votes, _ON_THE_GROUND, _LYING)
    others = _within(votes, ~_ON_THE_GROUND, _BETWEEN)
    return np.asarray(probability * lying + (1 - probability) * others)


def _within(
    votes: NDArray[np.float64],
    group: NDArray[np.bool_],
    stand_in: NDArray[np.bool_] | NDArray[np.float64],
) -> NDArray[np.float64]:
    """Shares ``(10,)`` within a group; if it has hardly any votes, mostly those of stand-ins."""
    shares = np.where(group, votes, 0.0)
    if shares.sum() < POSTURE.min_group_share:
        shares = shares + POSTURE.min_group_share * stand_in / stand_in.sum()
    return np.asarray(shares / shares.sum())


def on_ground_probability(landmarks: Landmarks) -> float:
    """Probability that a person is lying or on all fours, by the landmarks alone."""
    constants = fitted_constants("grounded")
    features = (body_features(landmarks) - constants["means"]) / constants["scales"]
    odds = float(features @ np.array(constants["weights"]) + constants["offset"])
    return probability_of(odds)


def body_features(landmarks: Landmarks) -> NDArray[np.float64]:
    """Features ``(22,)`` of a body that separate lying from other postures.

    Directions of trunk, body, thighs and shanks against the vertical, heights of head, shoulders
    and hips, extent, and visibility of some parts; exchanging left and right changes nothing.
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


def _middle(points: NDArray[np.float64], joints: list[int]) -> NDArray[np.float64]:
    return np.asarray(points[joints].mean(axis=0))


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-6))
