"""Smooth poses: the hypotheses of a track's frames are the states of a hidden Markov model.

The cost of a move between poses grows with the distance that joints move, that of a pose with its
distance from the person's heading over time. The forward-backward algorithm weights the states of
the last frames. Poses near the most probable state are averaged with these weights, and a line is
fitted to the averages of the last frames. Small people seen from the side keep the side that they
show.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.estimation.results import Person
from app.networks.probabilities import log_odds, probability_of, softmax
from app.tracking.motion import REFERENCE_HZ, Heading, Motion, posture_in_motion
from app.tracking.results import SmoothedPose
from app.tracking.seen_body import MAX_BODIES, clarity_of, log_likelihoods
from index.matching import PoseHypothesis
from index.posture import UPRIGHT, azimuth_deg, vote_posture
from index.skeleton import bone_lengths, mean_joint_distance, side_rows, with_bone_lengths

_SHOULDERS, _HIPS = side_rows("shoulder"), side_rows("hip")

COST_PER_M = 60.0
"""Cost in nats of each metre that joints move on average from frame to frame; up to twice as much
at higher rates, less at lower ones."""

EXTRAPOLATED_S = 1.0
"""A pose is kept this long without a silhouette."""


@dataclass(frozen=True)
class _States:
    """The N states of a frame, and their log probabilities, each up to a constant."""

    timestamp: float
    points_3d: NDArray[np.float64]  # (N, 24, 3): camera axes, metres, origin at the pelvis.
    confidences: NDArray[np.float64]  # (N,), of the hypotheses, best first.
    log_emission: NDArray[np.float64]  # (N,), given the frame.
    log_forward: NDArray[np.float64]  # (N,), given all frames up to this one.
    # (M, N), of moving from the states of the previous frame; None for the first frame.
    log_moves: NDArray[np.float64] | None


class PoseSmoother:
    """Smooths the poses of one track, frame by frame."""

    def __init__(self) -> None:
        self._states: deque[_States] = deque(maxlen=24)
        self._last: tuple[SmoothedPose, Person] | None = None

    def update(self, person: Person, timestamp: float, motion: Motion) -> SmoothedPose | None:
        """Add a frame of a person; return the pose at it, None without hypotheses."""
        if not person.hypotheses:
            return None
        hypotheses = person.voters[:MAX_BODIES]
        self._add_states(person, hypotheses, motion.heading, timestamp)
        pose = self._pose(person, hypotheses, motion)
        self._last = pose, person
        return pose

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
        # Log odds that a kept pose loses in a second; measured on the clips that the confidence was
        # fitted on.
        odds = log_odds(pose.confidence) - 5.0 * age_s
        return replace(
            pose,
            points_2d=pose.points_2d + _moved(before, person),
            confidence=probability_of(odds),
        )

    def _add_states(
        self,
        person: Person,
        hypotheses: Sequence[PoseHypothesis],
        heading: Heading,
        timestamp: float,
    ) -> None:
        """Add a frame's states from its hypotheses and the heading: the forward step."""
        points_3d = np.array([placed.points_3d for placed in hypotheses])
        log_emission = log_likelihoods(person)[: len(hypotheses)]
        if self._states:
            elapsed = timestamp - self._states[-1].timestamp
            log_emission = log_emission * min(1.0, REFERENCE_HZ * elapsed)
        log_emission = log_emission + heading.log_likelihood(azimuth_deg(points_3d))
        log_moves, log_forward = None, log_emission
        if self._states:
            last = self._states[-1]
            log_moves = self._log_moves(last, points_3d, timestamp)
            log_forward = log_emission + _log_sum_exp(last.log_forward[:, None] + log_moves, axis=0)
        log_forward = log_forward - log_forward.max()
        confidences = np.array([placed.confidence for placed in hypotheses])
        self._states.append(
            _States(timestamp, points_3d, confidences, log_emission, log_forward, log_moves)
        )
        clarity = clarity_of(person)
        # Time over which a line is fitted to the averages: landmarks follow quick limbs.
        line_s = clarity * 0.12 + (1 - clarity) * 0.35
        # The previous frame is kept, however long ago it was.
        while len(self._states) > 2 and timestamp - self._states[0].timestamp > line_s:
            self._states.popleft()

    def _log_moves(
        self, before: _States, points_3d: NDArray[np.float64], timestamp: float
    ) -> NDArray[np.float64]:
        """Log probabilities ``(M, N)``, up to a constant, of moving between all pairs of poses."""
        intervals = REFERENCE_HZ * (timestamp - before.timestamp)
        metres = mean_joint_distance(before.points_3d[:, None], points_3d[None])
        # No move is impossible, since detection and identity may be wrong.
        return np.asarray(-np.minimum(2 * COST_PER_M / (1 + intervals) * metres, 48.0))

    def _pose(
        self,
        person: Person,
        hypotheses: Sequence[PoseHypothesis],
        motion: Motion,
    ) -> SmoothedPose:
        """The pose at the newest frame."""
        points_3d, log_forward = self._states[-1].points_3d, self._states[-1].log_forward
        probabilities = softmax(log_forward)
        smoothed_3d, hypotheses_odds = self._smoothed()
        postures = [placed.posture for placed in hypotheses]
        upright = float(probabilities @ [posture in UPRIGHT for posture in postures])
        if person.landmarks is not None and upright * (1 - clarity_of(person)) > 0.5:
            smoothed_3d = self._kept_on_visible_side(smoothed_3d, motion.heading)
        agreement_odds = log_odds(float(probabilities @ self._nearness(points_3d, log_forward)))
        # From the log odds of the hypotheses near the pose, and of the share of probability near
        # it; fitted by `evaluate tracking --fit-tracks` at 701c017c.
        odds = -0.46 + 1.39 * hypotheses_odds + 0.39 * agreement_odds
        weights = self._weights_near_best(points_3d, log_forward)
        return SmoothedPose(
            smoothed_3d,
            np.einsum("n,npd->pd", weights, np.array([placed.points_2d for placed in hypotheses])),
            probability_of(odds),
            hypotheses[int(probabilities.argmax())].entry_id,
            vote_posture(
                [posture_in_motion(posture, motion.velocity) for posture in postures],
                probabilities.tolist(),
            ),
        )

    def _smoothed(self) -> tuple[NDArray[np.float64], float]:
        """The skeleton ``(24, 3)`` at the newest frame, from the last frames: the backward step.

        Also the log odds of the hypotheses near it, averaged over these frames.
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
        ages = self._states[-1].timestamp - np.array(
            [states.timestamp for states in reversed(self._states)]
        )
        weights = 1 - ages / (ages.max() + 1 / REFERENCE_HZ)
        smoothed = _line_at_zero(ages, np.array(averages), weights)
        return with_bone_lengths(smoothed, np.mean(lengths, axis=0)), float(np.mean(odds))

    def _weights_near_best(
        self, points_3d: NDArray[np.float64], log_probabilities: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Weights ``(N,)``, of sum 1, of the states near the most probable one."""
        relative = log_probabilities - log_probabilities.max()
        # Exponent of probabilities: frames are not independent.
        softened = np.exp(0.5 * relative)
        weights = softened * self._nearness(points_3d, log_probabilities)
        return np.asarray(weights / weights.sum())

    def _nearness(
        self, points_3d: NDArray[np.float64], log_probabilities: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """How near states ``(N,)`` are to the most probable one, 0 to 1."""
        apart = mean_joint_distance(points_3d, points_3d[log_probabilities.argmax()])
        # Poses at this distance from the most probable one weigh 60 % of it.
        return np.asarray(np.exp(-((apart / 0.25) ** 2) / 2))

    def _kept_on_visible_side(
        self, points_3d: NDArray[np.float64], heading: Heading
    ) -> NDArray[np.float64]:
        """A skeleton ``(24, 3)`` turned just far enough to show the visible side."""
        right, _, away = points_3d[_SHOULDERS[0]] - points_3d[_SHOULDERS[1]]
        shoulders_deg = float(np.rad2deg(np.arctan2(-away, right)))
        wanted_deg = heading.on_visible_side(shoulders_deg)
        return _turned(points_3d, wanted_deg - shoulders_deg)


def _moved(before: Person, now: Person) -> NDArray[np.float64]:
    """How far ``(2,)`` a person has moved: the silhouette's centroid, or the foot of the box.

    Swinging limbs move a box more than the body.
    """
    if now.silhouette is None or before.silhouette is None:
        return now.whole_box.foot - before.whole_box.foot
    return now.silhouette.centroid - before.silhouette.centroid


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
