"""Smooth poses: the hypotheses of a track's frames are the states of a hidden Markov model.

Moving from one pose to another costs what the joints have to move, and facing another way than the
person is turned over time costs as well. The forward-backward algorithm weighs the states of the
last frames by all frames so far. Poses near the most probable state are averaged by these weights,
and a line is fitted to the averages of the last frames. Small people who are seen from the side
keep the side that they show.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.estimation.facing import Facing, azimuth_deg
from app.estimation.posture_probability import vote_posture
from app.estimation.results import ObservedPerson, Person
from app.tracking.ground_motion import GroundMotion, GroundVelocity
from app.tracking.heading import HeadingFilter, Turn, going
from app.tracking.results import SmoothedPose
from app.vision.odds import log_odds, probability_of
from index.parameters import POSTURE_RULES
from index.posture import UPRIGHT, Posture
from index.skeleton import (
    JOINTS,
    NATIVE,
    POINT_NAMES,
    POINTS,
    mean_joint_distance,
)

STATES = 12
"""Most hypotheses of a frame that are states; 30 are no better."""

CONFIDENCE_WEIGHT = 1.5
"""Weight of the log of a hypothesis's confidence, at ``RATE`` frames a second or fewer."""

COST_PER_M = 60.0
"""Of the joints' mean way between frames ``1 / RATE`` seconds apart; twice that between frames
without any time between, and the less the more time passed."""

LANDMARK_WEIGHT = 40.0
"""Weight of the log of the distance by silhouette and landmarks, where there are landmarks: the
confidences of all hypotheses that agree with them are near 1."""

MOST_COST = 48.0
"""Nothing is impossible: detection and identity may be wrong."""

SURE_PX = 256.0
"""Height from which landmarks weigh in full, that of the network's window; of smaller people they
jump, and motion counts more."""

RATE = 10.0
"""Frames a second that other costs are given for."""

TURN_WEIGHT = 1.0
"""Weight of the way somebody is turned over time."""

NEARBY_M = 0.25
"""Poses at this mean distance of their joints from the most probable one weigh 60 % of it."""

SHARPNESS = 0.5
"""Exponent of the states' probabilities in the average: frames are no independent evidence."""

EXTRAPOLATED_S = 1.0
"""How long a pose is kept where the person is seen but not searched for."""

LOST_PER_S = 5.0
"""Log odds of a pose's confidence lost in every second in which it is kept; from the clips that
the confidence was fitted on."""

LINE_S, LANDMARK_LINE_S, MOST_LINE_FRAMES = 0.35, 0.12, 24
"""Seconds through whose averages a line is fitted, by silhouettes alone and where landmarks are
read, and the most frames."""

CONFIDENCE_OFFSET, OF_HYPOTHESES, OF_AGREEMENT = -0.46, 1.39, 0.39
"""Log odds of a smooth pose: an offset, and weights of the log odds of the hypotheses near it and
of the share of probability near it. Fitted by ``python -m scripts.evaluate tracking
--fit-tracks``."""

_SHOULDERS, _HIPS = (
    [POINT_NAMES.index(f"{side}_{joint}") for side in ("left", "right")]
    for joint in ("shoulder", "hip")
)


@dataclass(frozen=True)
class Smoothed:
    """A track's pose at its newest frame, and what follows from it.

    Parameters
    ----------
    pose : SmoothedPose
    facing : Facing
    votes : (10,) float64 array
        Share of each of ``POSTURES``: of the states, by their probabilities.
    velocity : GroundVelocity
    elevation_deg : float
        Of the camera above the person, averaged over the track.
    confidence_features : (float, float)
        Log odds, whose weighted sum gives the pose's confidence: of the hypotheses near the pose,
        and of the share of probability near it.
    """

    pose: SmoothedPose
    facing: Facing
    votes: NDArray[np.float64]
    velocity: GroundVelocity
    elevation_deg: float
    confidence_features: tuple[float, float]


@dataclass(frozen=True)
class _States:
    """The states of a frame and their emission log likelihoods.

    Parameters
    ----------
    timestamp : float
    points_3d : (N, 24, 3) float64 array
    confidences : (N,) float64 array
    log_emission : (N,) float64 array
    log_forward : (N,) float64 array
        Log probabilities given all frames up to this one, less a constant.
    log_moves : (M, N) float64 array or None
        From each state of the frame before; None for the first.
    """

    timestamp: float
    points_3d: NDArray[np.float64]
    confidences: NDArray[np.float64]
    log_emission: NDArray[np.float64]
    log_forward: NDArray[np.float64]
    log_moves: NDArray[np.float64] | None


@dataclass(frozen=True)
class _Place:
    """Where a person is in a frame: the foot of the box, the silhouette's centroid if there is one.

    Limbs that swing move a box more than the body.
    """

    foot: NDArray[np.float64]
    centroid: NDArray[np.float64] | None

    @classmethod
    def of(cls, observed: ObservedPerson) -> _Place:
        silhouette = observed.silhouette
        return cls(observed.whole_box.foot, None if silhouette is None else silhouette.centroid)

    def minus(self, before: _Place) -> NDArray[np.float64]:
        """How far ``(2,)`` the person has moved since."""
        if self.centroid is None or before.centroid is None:
            return self.foot - before.foot
        return self.centroid - before.centroid


class PoseSmoother:
    """Smooths the poses of one track, frame by frame.

    Parameters
    ----------
    states : int
        See :data:`STATES`, as the others by their names.
    cost_per_m, turn_weight : float
    line_s : float
    """

    def __init__(
        self,
        *,
        states: int = STATES,
        cost_per_m: float = COST_PER_M,
        turn_weight: float = TURN_WEIGHT,
        line_s: float = LINE_S,
    ) -> None:
        self._states = states
        self._cost_per_m = cost_per_m
        self._turn_weight = turn_weight
        self._ground = GroundMotion()
        self._turns = HeadingFilter()
        self._line_s = line_s
        self._frames: deque[_States] = deque(maxlen=MOST_LINE_FRAMES)
        self._last: tuple[SmoothedPose, _Place] | None = None

    def update(self, person: Person, timestamp: float) -> Smoothed | None:
        """Take in the track's next frame and return the pose at it.

        Parameters
        ----------
        person : Person
        timestamp : float
            Seconds, later than the last one.

        Returns
        -------
        Smoothed or None
            None if the person has no hypotheses in this frame.
        """
        if not person.hypotheses or person.facing is None:
            return None
        hypotheses = person.hypotheses[: self._states]
        points_3d = np.array([placed.points_3d for placed in hypotheses])
        points_2d = np.array([placed.points_2d for placed in hypotheses])
        confidences = np.array([placed.confidence for placed in hypotheses])
        elevations_deg = np.array([placed.label.elevation_deg for placed in hypotheses])
        weights = (confidences + 1e-6) / (confidences + 1e-6).sum()
        box = person.observed.whole_box
        velocity = self._ground.update(
            timestamp,
            box,
            float(weights @ _px_per_m(points_3d, points_2d)),
            float(weights @ elevations_deg),
        )
        log_emission = CONFIDENCE_WEIGHT * np.log(confidences + 1e-3)
        line_s, sure = self._line_s, 0.0
        if person.facing.evidence == "image":
            sure = min(1.0, box.height / SURE_PX) ** 2
            line_s = sure * LANDMARK_LINE_S + (1 - sure) * line_s
            distances = np.array([placed.distance for placed in hypotheses])
            log_emission = log_emission - sure * LANDMARK_WEIGHT * np.log(
                (distances + 1e-9) / (distances.min() + 1e-9)
            )
        if self._frames:
            log_emission *= min(1.0, RATE * (timestamp - self._frames[-1].timestamp))
        shares = np.exp(log_emission - log_emission.max())
        azimuths_deg = azimuth_deg(points_3d)
        turn = self._turns.update(timestamp, azimuths_deg, shares / shares.sum(), sure, velocity)
        log_emission = log_emission + self._turn_weight * turn.log_likelihood(azimuths_deg)
        self._append(timestamp, points_3d, confidences, log_emission)
        # The frame before stays, however long ago it was.
        while len(self._frames) > 2 and timestamp - self._frames[0].timestamp > line_s:
            self._frames.popleft()

        log_probabilities = self._frames[-1].log_forward
        probabilities = np.exp(log_probabilities)
        probabilities /= probabilities.sum()
        near = _weights_near_best(points_3d, log_probabilities)
        smoothed_3d, odds = self._smoothed(timestamp)
        upright = float(probabilities @ [one.posture in UPRIGHT for one in hypotheses])
        if person.facing.evidence == "image" and upright * (1 - sure) > 0.5:
            smoothed_3d = _kept_beside(smoothed_3d, turn)
        agreement = float(probabilities @ _nearness(points_3d, log_probabilities))
        features = odds, log_odds(agreement)
        pose = SmoothedPose(
            smoothed_3d,
            np.einsum("n,npd->pd", near, points_2d),
            _confidence(*features),
            hypotheses[int(probabilities.argmax())].entry_id,
        )
        self._last = pose, _Place.of(person.observed)
        votes = vote_posture(
            [_posture(placed.posture, velocity) for placed in hypotheses],
            probabilities.tolist(),
        )
        return Smoothed(
            pose,
            Facing(
                turn.front_probability,
                "motion" if going(velocity) > 0 else person.facing.evidence,
            ),
            votes,
            velocity,
            self._ground.elevation_deg,
            features,
        )

    def extrapolate(self, observed: ObservedPerson, timestamp: float) -> SmoothedPose | None:
        """The last pose, moved to where the person is in a later frame without hypotheses.

        Parameters
        ----------
        observed : ObservedPerson
            The person in that frame.
        timestamp : float
            Seconds.

        Returns
        -------
        SmoothedPose or None
            None if the last pose is older than :data:`EXTRAPOLATED_S`, or there is none.
        """
        if self._last is None:
            return None
        age_s = timestamp - self._frames[-1].timestamp
        if age_s > EXTRAPOLATED_S:
            return None
        pose, before = self._last
        odds = log_odds(pose.confidence) - LOST_PER_S * age_s
        return replace(
            pose,
            points_2d=pose.points_2d + _Place.of(observed).minus(before),
            confidence=probability_of(odds),
        )

    def _append(
        self,
        timestamp: float,
        points_3d: NDArray[np.float64],
        confidences: NDArray[np.float64],
        log_emission: NDArray[np.float64],
    ) -> None:
        """Add a frame's states: the forward step."""
        log_moves, log_forward = None, log_emission
        if self._frames:
            last = self._frames[-1]
            tenths = RATE * (timestamp - last.timestamp)
            log_moves = _log_moves(last.points_3d, points_3d, 2 * self._cost_per_m / (1 + tenths))
            log_forward = log_emission + _log_sum_exp(last.log_forward[:, None] + log_moves, axis=0)
        log_forward = log_forward - log_forward.max()
        self._frames.append(
            _States(timestamp, points_3d, confidences, log_emission, log_forward, log_moves)
        )

    def _smoothed(self, timestamp: float) -> tuple[NDArray[np.float64], float]:
        """The skeleton ``(24, 3)`` at the newest frame by the last frames: the backward step.

        And the log odds of the hypotheses near it, averaged over these frames.
        """
        log_backward = np.zeros(len(self._frames[-1].log_forward))
        averages, lengths, odds = [], [], []
        later: _States | None = None
        for states in reversed(self._frames):
            if later is not None and later.log_moves is not None:
                log_backward = _log_sum_exp(
                    later.log_moves + (later.log_emission + log_backward)[None], axis=1
                )
                log_backward -= log_backward.max()
            weights = _weights_near_best(states.points_3d, states.log_forward + log_backward)
            averages.append(np.einsum("n,npd->pd", weights, states.points_3d))
            lengths.append(weights @ _bone_lengths(states.points_3d))
            odds.append(log_odds(float(weights @ states.confidences)))
            later = states
        ages = timestamp - np.array([states.timestamp for states in reversed(self._frames)])
        smoothed = _line_at_zero(ages, np.array(averages))
        return _with_bone_lengths(smoothed, np.mean(lengths, axis=0)), float(np.mean(odds))


def _posture(posture: Posture, velocity: GroundVelocity) -> Posture:
    """The posture of a state; how fast somebody goes is seen rather than taken from its clip."""
    if posture not in ("standing", "walking", "running"):
        return posture
    if velocity.sure_speed >= POSTURE_RULES.min_running_speed:
        return "running"
    return "walking" if velocity.sure_speed >= POSTURE_RULES.min_walking_speed else "standing"


def _px_per_m(
    points_3d: NDArray[np.float64], points_2d: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Scales ``(N,)`` at which skeletons appear in the picture."""
    metres = points_3d[..., :2] - points_3d[..., :2].mean(axis=-2, keepdims=True)
    pixels = points_2d - points_2d.mean(axis=-2, keepdims=True)
    return np.asarray(
        (metres * pixels).sum(axis=(-2, -1)) / np.maximum((metres**2).sum(axis=(-2, -1)), 1e-9)
    )


def _kept_beside(points_3d: NDArray[np.float64], turn: Turn) -> NDArray[np.float64]:
    """A skeleton ``(24, 3)`` turned no farther than needed to show the side that is seen."""
    right, _, away = points_3d[_SHOULDERS[0]] - points_3d[_SHOULDERS[1]]
    shoulders_deg = float(np.rad2deg(np.arctan2(-away, right)))
    return _turned(points_3d, turn.on_its_side(shoulders_deg) - shoulders_deg)


def _turned(points_3d: NDArray[np.float64], angle_deg: float) -> NDArray[np.float64]:
    """A skeleton ``(24, 3)`` turned about its trunk in the picture, the azimuth growing."""
    axis = points_3d[_SHOULDERS].sum(axis=0) - points_3d[_HIPS].sum(axis=0)
    axis[2] = 0
    axis /= max(float(np.linalg.norm(axis)), 1e-9)
    along = np.outer(points_3d @ axis, axis)
    across = points_3d - along
    angle = np.deg2rad(angle_deg)
    return np.asarray(along + np.cos(angle) * across + np.sin(angle) * np.cross(across, axis))


def _log_moves(
    before: NDArray[np.float64], after: NDArray[np.float64], cost_per_m: float
) -> NDArray[np.float64]:
    """Log probabilities ``(M, N)``, less a constant, of moving from each pose to each."""
    ways = mean_joint_distance(before[:, None], after[None])
    return np.asarray(-np.minimum(cost_per_m * ways, MOST_COST))


def _weights_near_best(
    points_3d: NDArray[np.float64], log_probabilities: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Weights ``(N,)``, of sum 1, of the states near the most probable one."""
    softened = np.exp(SHARPNESS * (log_probabilities - log_probabilities.max()))
    weights = softened * _nearness(points_3d, log_probabilities)
    return np.asarray(weights / weights.sum())


def _nearness(
    points_3d: NDArray[np.float64], log_probabilities: NDArray[np.float64]
) -> NDArray[np.float64]:
    """How near states ``(N,)`` are to the most probable one, 0 to 1."""
    apart = mean_joint_distance(points_3d, points_3d[log_probabilities.argmax()])
    return np.asarray(np.exp(-((apart / NEARBY_M) ** 2) / 2))


def _confidence(odds: float, agreement_odds: float) -> float:
    """Probability that a smooth pose is right."""
    return probability_of(CONFIDENCE_OFFSET + OF_HYPOTHESES * odds + OF_AGREEMENT * agreement_odds)


def _line_at_zero(ages: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Value at age 0 of the line through values ``(K, ...)``, of which the newest count most."""
    weights = 1 - ages / (ages.max() + 1 / RATE)
    weights /= weights.sum()
    centre = weights @ ages
    spread = weights @ (ages - centre) ** 2
    mean = np.tensordot(weights, values, axes=1)
    if spread <= 0:
        return np.asarray(mean)
    slope = np.tensordot(weights * (ages - centre), values, axes=1) / spread
    return np.asarray(mean - slope * centre)


def _bone_lengths(points_3d: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths ``(..., B)`` of the bones of skeletons, in the order of ``NATIVE.bones``."""
    parents, children = np.array(NATIVE.bones).T
    return np.asarray(
        np.linalg.norm(points_3d[..., children, :] - points_3d[..., parents, :], axis=-1)
    )


def _with_bone_lengths(
    points_3d: NDArray[np.float64], lengths: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The skeleton ``(24, 3)`` with bones of these lengths, in the same directions."""
    result = points_3d.copy()
    for (parent, child), length in zip(NATIVE.bones, lengths, strict=True):
        bone = points_3d[child] - points_3d[parent]
        result[child] = result[parent] + bone * (length / max(float(np.linalg.norm(bone)), 1e-9))
    head = POINT_NAMES.index("head")
    result[JOINTS:POINTS] += result[head] - points_3d[head]
    return result


def _log_sum_exp(values: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    sums: NDArray[np.float64] = np.logaddexp.reduce(values, axis=axis)
    return sums
