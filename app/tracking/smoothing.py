"""Smooth poses: the hypotheses of a track's frames are the states of a hidden Markov model.

The cost of a move between poses grows with the distance that joints move. The cost of a pose grows
with its distance from the person's heading over time. The forward-backward algorithm weights the
states of the last frames using all frames so far. Poses near the most probable state are averaged
with these weights, and a line is fitted to the averages of the last frames. Small people seen from
the side keep the side that they show.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.estimation.posture import vote_posture
from app.estimation.results import Facing, Person, ProjectedHypothesis
from app.tracking.motion import GroundMotion, GroundVelocity, Heading, HeadingFilter
from app.tracking.results import SmoothedPose
from app.vision.blazepose import LANDMARK_PX
from app.vision.odds import log_odds, probability_of
from index.facing import azimuth_deg
from index.posture import MIN_RUNNING_SPEED_M_S, MIN_WALKING_SPEED_M_S, UPRIGHT, PostureName
from index.skeleton import (
    POINT_NAMES,
    POINTS,
    bone_lengths,
    mean_joint_distance,
    pixels_per_metre,
    with_bone_lengths,
)

_SHOULDERS, _HIPS = (
    [POINT_NAMES.index(f"{side}_{joint}") for side in ("left", "right")]
    for joint in ("shoulder", "hip")
)

# Frame rate for which the weights and costs below are given.
_REFERENCE_HZ = 10.0
# Weight of the log of a hypothesis's confidence.
_CONFIDENCE_WEIGHT = 1.5
# Weight of the log of the distance by silhouette and landmarks, if landmarks were read: the
# confidences of all hypotheses that agree with them are near 1.
_LANDMARK_WEIGHT = 40.0
# Height from which landmarks have their full weight: the side of the network's window. Those of
# smaller people jitter, so motion counts more.
_FULL_WEIGHT_PX = LANDMARK_PX
# Largest cost of a move: none is impossible, since detection and identity may be wrong.
_MAX_COST = 48.0
# Poses at this distance from the most probable one weigh 60 % of it.
_NEARBY_M = 0.25
# Exponent of probabilities: frames are not independent.
_SHARPNESS = 0.5
# Time over which a line is fitted to the averages for landmarks of full weight, which follow quick
# limbs; and the largest number of frames in any line.
_LANDMARK_LINE_S, _MAX_LINE_FRAMES = 0.12, 24
EXTRAPOLATED_S = 1.0
"""A pose is kept this long without a silhouette."""
# Log odds that a kept pose loses in a second; measured on the clips that the confidence was fitted
# on.
_LOST_PER_S = 5.0
# Log odds of a smooth pose: an offset, and weights of the log odds of the hypotheses near it and of
# the share of probability near it; `python -m scripts evaluate tracking --fit-tracks`.
_CONFIDENCE_OFFSET, _HYPOTHESES_WEIGHT, _AGREEMENT_WEIGHT = -0.46, 1.39, 0.39


@dataclass(frozen=True)
class Smoothing:
    """What the tracking experiment varies.

    Parameters
    ----------
    max_states : int
        Hypotheses of a frame that become states; 30 are no better.
    cost_per_m : float
        Cost in nats of each metre that joints move on average from frame to frame; up to twice as
        much at higher rates, less at lower ones.
    heading_weight : float
        Weight of the log of the heading's probability.
    line_s : float
        Time over which a line is fitted to the averages for silhouettes alone.
    """

    max_states: int = 12
    cost_per_m: float = 60.0
    heading_weight: float = 1.0
    line_s: float = 0.35


SMOOTHING = Smoothing()


@dataclass(frozen=True)
class Smoothed:
    """A track's pose at its newest frame, and what follows from it.

    ``votes`` ``(10,)`` are the shares of ``POSTURES`` among the states, weighted by their
    probabilities. The elevation of the camera above the person is averaged over the track, the
    scale is that of this frame. The pose's confidence follows from a weighted sum of the log odds
    of the hypotheses near it, and of those of the share of probability near it.
    """

    pose: SmoothedPose
    facing: Facing
    votes: NDArray[np.float64]
    velocity: GroundVelocity
    elevation_deg: float
    px_per_m: float
    confidence_features: tuple[float, float]


@dataclass(frozen=True)
class _Frame:
    """A frame's N hypotheses as arrays, best first, and how clearly they are seen."""

    hypotheses: Sequence[ProjectedHypothesis]
    points_3d: NDArray[np.float64]  # (N, 24, 3): camera axes, metres, origin at the pelvis.
    points_2d: NDArray[np.float64]  # (N, 24, 2): pixels of the frame.
    confidences: NDArray[np.float64]  # (N,)
    # (N,), from silhouette and landmarks; None if no landmarks were read.
    distances: NDArray[np.float64] | None
    clarity: float  # Weight of landmarks, 0 to 1; 0 if none were read.

    def weights(self) -> NDArray[np.float64]:
        """Weights ``(N,)`` of the hypotheses by their confidences; they sum to 1."""
        weights = self.confidences + 1e-6
        return np.asarray(weights / weights.sum())

    def px_per_m(self) -> float:
        """Scale of the person."""
        return float(self.weights() @ pixels_per_metre(self.points_3d, self.points_2d, POINTS))

    @classmethod
    def of(cls, person: Person, max_states: int) -> _Frame:
        hypotheses = person.hypotheses[:max_states]
        distances, clarity = None, 0.0
        if person.facing is not None and person.facing.evidence == "image":
            distances = np.array([placed.distance for placed in hypotheses])
            height = person.whole_box.height
            clarity = min(1.0, height / _FULL_WEIGHT_PX) ** 2
        return cls(
            hypotheses,
            np.array([placed.points_3d for placed in hypotheses]),
            np.array([placed.points_2d for placed in hypotheses]),
            np.array([placed.confidence for placed in hypotheses]),
            distances,
            clarity,
        )

    def log_likelihoods(self) -> NDArray[np.float64]:
        """Log likelihoods ``(N,)`` of the states, up to a constant, for the reference rate."""
        result = _CONFIDENCE_WEIGHT * np.log(self.confidences + 1e-3)
        if self.distances is not None:
            result = result - self.clarity * _LANDMARK_WEIGHT * np.log(
                (self.distances + 1e-9) / (self.distances.min() + 1e-9)
            )
        return result


@dataclass(frozen=True)
class _States:
    """The N states of a frame, and their log probabilities, each up to a constant."""

    timestamp: float
    points_3d: NDArray[np.float64]  # (N, 24, 3), as those of the frame.
    confidences: NDArray[np.float64]  # (N,), of the hypotheses.
    log_emission: NDArray[np.float64]  # (N,), given the frame.
    log_forward: NDArray[np.float64]  # (N,), given all frames up to this one.
    # (M, N), of moving from the states of the previous frame; None for the first frame.
    log_moves: NDArray[np.float64] | None


@dataclass(frozen=True)
class _Place:
    """Where a person is in a frame: the foot of the box, and the silhouette's centroid.

    Swinging limbs move a box more than the body.
    """

    foot: NDArray[np.float64]
    centroid: NDArray[np.float64] | None

    @classmethod
    def of(cls, person: Person) -> _Place:
        silhouette = person.silhouette
        return cls(person.whole_box.foot, None if silhouette is None else silhouette.centroid)

    def minus(self, before: _Place) -> NDArray[np.float64]:
        """How far ``(2,)`` the person has moved since."""
        if self.centroid is None or before.centroid is None:
            return self.foot - before.foot
        return self.centroid - before.centroid


class PoseSmoother:
    """Smooths the poses of one track, frame by frame."""

    def __init__(self, smoothing: Smoothing = SMOOTHING) -> None:
        self._smoothing = smoothing
        self._ground = GroundMotion()
        self._headings = HeadingFilter()
        self._states: deque[_States] = deque(maxlen=_MAX_LINE_FRAMES)
        self._last: tuple[SmoothedPose, _Place] | None = None

    def update(self, person: Person, timestamp: float) -> Smoothed | None:
        """Add a frame of a person; return the pose at it, None without hypotheses."""
        if not person.hypotheses or person.facing is None:
            return None
        frame = _Frame.of(person, self._smoothing.max_states)
        velocity = self._velocity(frame, person, timestamp)
        px_per_m = frame.px_per_m()
        heading = self._add_states(frame, velocity, timestamp)
        states = self._states[-1]
        probabilities = np.exp(states.log_forward)
        probabilities /= probabilities.sum()
        pose, features = self._pose(frame, heading, probabilities, timestamp)
        self._last = pose, _Place.of(person)
        walks = self._headings.walking_weight(velocity) > 0
        return Smoothed(
            pose,
            Facing(heading.front_probability, "motion" if walks else person.facing.evidence),
            vote_posture(
                [_posture(placed.posture, velocity) for placed in frame.hypotheses],
                probabilities.tolist(),
            ),
            velocity,
            self._ground.elevation_deg,
            px_per_m,
            features,
        )

    def extrapolate(self, person: Person, timestamp: float) -> SmoothedPose | None:
        """The last pose, moved to where the person is in a later frame without hypotheses.

        None if the last pose is too old, or there is none.
        """
        if self._last is None:
            return None
        age_s = timestamp - self._states[-1].timestamp
        if age_s > EXTRAPOLATED_S:
            return None
        pose, before = self._last
        odds = log_odds(pose.confidence) - _LOST_PER_S * age_s
        return replace(
            pose,
            points_2d=pose.points_2d + _Place.of(person).minus(before),
            confidence=probability_of(odds),
        )

    def _velocity(self, frame: _Frame, person: Person, timestamp: float) -> GroundVelocity:
        """Measure the velocity using the scales and elevations of the hypotheses."""
        weights = frame.weights()
        elevations_deg = np.array([placed.label.elevation_deg for placed in frame.hypotheses])
        return self._ground.update(
            timestamp,
            person.whole_box,
            frame.px_per_m(),
            float(weights @ elevations_deg),
        )

    def _add_states(self, frame: _Frame, velocity: GroundVelocity, timestamp: float) -> Heading:
        """Add a frame's states from its hypotheses and the heading: the forward step."""
        log_emission = frame.log_likelihoods()
        if self._states:
            elapsed = timestamp - self._states[-1].timestamp
            log_emission *= min(1.0, _REFERENCE_HZ * elapsed)
        shares = np.exp(log_emission - log_emission.max())
        azimuths_deg = azimuth_deg(frame.points_3d)
        heading = self._headings.update(
            timestamp, azimuths_deg, shares / shares.sum(), frame.clarity, velocity
        )
        log_emission = log_emission + self._smoothing.heading_weight * heading.log_likelihood(
            azimuths_deg
        )
        log_moves, log_forward = None, log_emission
        if self._states:
            last = self._states[-1]
            log_moves = self._log_moves(last, frame.points_3d, timestamp)
            log_forward = log_emission + _log_sum_exp(last.log_forward[:, None] + log_moves, axis=0)
        log_forward = log_forward - log_forward.max()
        points_3d, confidences, clarity = frame.points_3d, frame.confidences, frame.clarity
        self._states.append(
            _States(timestamp, points_3d, confidences, log_emission, log_forward, log_moves)
        )
        line_s = clarity * _LANDMARK_LINE_S + (1 - clarity) * self._smoothing.line_s
        # The previous frame is kept, however long ago it was.
        while len(self._states) > 2 and timestamp - self._states[0].timestamp > line_s:
            self._states.popleft()
        return heading

    def _log_moves(
        self, before: _States, points_3d: NDArray[np.float64], timestamp: float
    ) -> NDArray[np.float64]:
        """Log probabilities ``(M, N)``, up to a constant, of moving between all pairs of poses."""
        intervals = _REFERENCE_HZ * (timestamp - before.timestamp)
        cost_per_m = 2 * self._smoothing.cost_per_m / (1 + intervals)
        metres = mean_joint_distance(before.points_3d[:, None], points_3d[None])
        return np.asarray(-np.minimum(cost_per_m * metres, _MAX_COST))

    def _pose(
        self,
        frame: _Frame,
        heading: Heading,
        probabilities: NDArray[np.float64],
        timestamp: float,
    ) -> tuple[SmoothedPose, tuple[float, float]]:
        """The pose at the newest frame, and the features of its confidence."""
        log_forward = self._states[-1].log_forward
        smoothed_3d, hypotheses_odds = self._smoothed(timestamp)
        postures = [placed.posture for placed in frame.hypotheses]
        upright = float(probabilities @ [posture in UPRIGHT for posture in postures])
        if frame.distances is not None and upright * (1 - frame.clarity) > 0.5:
            smoothed_3d = self._kept_on_visible_side(smoothed_3d, heading)
        nearness = self._nearness(frame.points_3d, log_forward)
        agreement_odds = log_odds(float(probabilities @ nearness))
        odds = (
            _CONFIDENCE_OFFSET
            + _HYPOTHESES_WEIGHT * hypotheses_odds
            + _AGREEMENT_WEIGHT * agreement_odds
        )
        weights = self._weights_near_best(frame.points_3d, log_forward)
        pose = SmoothedPose(
            smoothed_3d,
            np.einsum("n,npd->pd", weights, frame.points_2d),
            probability_of(odds),
            frame.hypotheses[int(probabilities.argmax())].entry_id,
        )
        return pose, (hypotheses_odds, agreement_odds)

    def _smoothed(self, timestamp: float) -> tuple[NDArray[np.float64], float]:
        """The skeleton ``(24, 3)`` at the newest frame, from the last frames: the backward step.

        Also returns the log odds of the hypotheses near it, averaged over these frames.
        """
        log_backward = np.zeros(len(self._states[-1].log_forward))
        averages, lengths, odds = [], [], []
        later: _States | None = None
        for states in reversed(self._states):
            if later is not None and later.log_moves is not None:
                log_backward = _log_sum_exp(
                    later.log_moves + (later.log_emission + log_backward)[None], axis=1
                )
                log_backward -= log_backward.max()
            weights = self._weights_near_best(states.points_3d, states.log_forward + log_backward)
            averages.append(np.einsum("n,npd->pd", weights, states.points_3d))
            lengths.append(weights @ bone_lengths(states.points_3d))
            odds.append(log_odds(float(weights @ states.confidences)))
            later = states
        ages = timestamp - np.array([states.timestamp for states in reversed(self._states)])
        weights = 1 - ages / (ages.max() + 1 / _REFERENCE_HZ)
        smoothed = _line_at_zero(ages, np.array(averages), weights)
        return with_bone_lengths(smoothed, np.mean(lengths, axis=0)), float(np.mean(odds))

    def _weights_near_best(
        self, points_3d: NDArray[np.float64], log_probabilities: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Weights ``(N,)``, of sum 1, of the states near the most probable one."""
        relative = log_probabilities - log_probabilities.max()
        softened = np.exp(_SHARPNESS * relative)
        weights = softened * self._nearness(points_3d, log_probabilities)
        return np.asarray(weights / weights.sum())

    def _nearness(
        self, points_3d: NDArray[np.float64], log_probabilities: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """How near states ``(N,)`` are to the most probable one, 0 to 1."""
        apart = mean_joint_distance(points_3d, points_3d[log_probabilities.argmax()])
        return np.asarray(np.exp(-((apart / _NEARBY_M) ** 2) / 2))

    def _kept_on_visible_side(
        self, points_3d: NDArray[np.float64], heading: Heading
    ) -> NDArray[np.float64]:
        """A skeleton ``(24, 3)`` turned no farther than needed to show the side that is seen."""
        right, _, away = points_3d[_SHOULDERS[0]] - points_3d[_SHOULDERS[1]]
        shoulders_deg = float(np.rad2deg(np.arctan2(-away, right)))
        wanted_deg = heading.on_visible_side(shoulders_deg)
        return _turned(points_3d, wanted_deg - shoulders_deg)


def _posture(posture: PostureName, velocity: GroundVelocity) -> PostureName:
    """The posture of a state, using the measured speed rather than that of its clip."""
    if posture not in ("standing", "walking", "running"):
        return posture
    if velocity.reliable_speed >= MIN_RUNNING_SPEED_M_S:
        return "running"
    return "walking" if velocity.reliable_speed >= MIN_WALKING_SPEED_M_S else "standing"


def _turned(points_3d: NDArray[np.float64], angle_deg: float) -> NDArray[np.float64]:
    """A skeleton ``(24, 3)`` turned about its trunk in the picture; the azimuth increases."""
    axis = points_3d[_SHOULDERS].sum(axis=0) - points_3d[_HIPS].sum(axis=0)
    axis[2] = 0
    axis /= max(float(np.linalg.norm(axis)), 1e-9)
    along = np.outer(points_3d @ axis, axis)
    across = points_3d - along
    angle = np.deg2rad(angle_deg)
    return np.asarray(along + np.cos(angle) * across + np.sin(angle) * np.cross(across, axis))


def _line_at_zero(
    ages: NDArray[np.float64], values: NDArray[np.float64], weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Value at age 0 of the line through values ``(K, ...)`` with weights ``(K,)``."""
    weights = weights / weights.sum()
    centre = weights @ ages
    spread = weights @ (ages - centre) ** 2
    mean = np.tensordot(weights, values, axes=1)
    if spread <= 0:
        return np.asarray(mean)
    slope = np.tensordot(weights * (ages - centre), values, axes=1) / spread
    return np.asarray(mean - slope * centre)


def _log_sum_exp(values: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    sums: NDArray[np.float64] = np.logaddexp.reduce(values, axis=axis)
    return sums
