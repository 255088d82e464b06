"""What a tracked person does: a linear model on the motion of the last seconds."""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.estimation.parameters import POSTURE
from app.estimation.posture_probability import EstimatedPosture
from app.estimation.results import Person, ProjectedHypothesis
from app.tracking.action_features import RATE_HZ, Measured, action_features, ground_path
from app.tracking.results import RecognisedAction
from app.tracking.smoothing import SURE_PX, Smoothed
from index.posture import Posture, camera_up

WINDOW_S, LEAST_S = 3.0, 1.0
"""Seconds of motion that are looked at, and from which an action is told."""

EVERY_S = 0.5
"""Time from one answer to the next: what somebody does changes slowly."""

LEAST_STEP_S = 1 / 40
"""Frames nearer than this add nothing to a motion that is sampled at ten a second, but memory."""

MOST_GAP_S = 1.0
"""Longer without a pose, and the motion begins anew."""

LEAST_SHARE = 0.02
"""Of the hypotheses' votes, for actions that no hypothesis shows."""

SHOWN_BY: dict[str, tuple[Posture, ...]] = {
    "lie": ("lying", "crawling"),
    "sit": ("sitting",),
    "squat": ("crouching", "kneeling", "sitting", "bending"),
    "jump": ("standing", "arms_raised", "bending", "crouching", "running"),
    "walk": ("walking",),
    "run": ("running",),
}
"""Postures in which an action is seen; the others are done on the spot, upright."""

EVERYDAY = ("lie", "sit", "stand", "walk", "run")
"""What most people do whom a camera sees ..."""

EVERYDAY_LOG_ODDS = math.log(10)
"""... rather than exercises, where the motion of their limbs does not tell."""

ON_THE_SPOT: tuple[Posture, ...] = ("standing", "arms_raised", "bending")

LEAST_POSTURE = 0.1
"""What a posture that contradicts an action leaves of its probability: it may be a moment's."""

MODEL = Path(__file__).parent / "models" / "actions.json"


@dataclass(frozen=True)
class ActionModel:
    """Linear discriminants of motions, and what the hypotheses' labels count beside them.

    Parameters
    ----------
    actions : tuple of str
        Labels of the index.
    weights : (A, D) float64 array
    offsets : (A,) float64 array
        Log odds of the actions are ``weights @ features + offsets``.
    vote_weight : float
        What the log of the hypotheses' votes counts beside them.
    """

    actions: tuple[str, ...]
    weights: NDArray[np.float64]
    offsets: NDArray[np.float64]
    vote_weight: float

    def __post_init__(self) -> None:
        if self.weights.ndim != 2 or not (
            len(self.actions) == len(self.weights) == len(self.offsets)
        ):
            raise ValueError(
                f"expected weights and an offset for each of {len(self.actions)} actions, "
                f"got {self.weights.shape} and {self.offsets.shape}"
            )

    def probabilities(
        self, features: NDArray[np.float64], votes: NDArray[np.float64], sure: float = 1.0
    ) -> NDArray[np.float64]:
        """Tell actions apart.

        Parameters
        ----------
        features : (..., D) float64 array
        votes : (..., A) float64 array
            Of :meth:`votes`.
        sure : float
            How surely the motion of limbs is seen, 0 to 1. As far as it is not, what people mostly
            do counts.

        Returns
        -------
        (..., A) float64 array
            Probabilities.
        """
        everyday = EVERYDAY_LOG_ODDS * np.isin(self.actions, EVERYDAY)
        odds = sure * (features @ self.weights.T + self.offsets) + (1 - sure) * everyday
        odds = odds + self.vote_weight * np.log(np.maximum(votes, LEAST_SHARE))
        odds = np.exp(odds - odds.max(axis=-1, keepdims=True))
        return np.asarray(odds / odds.sum(axis=-1, keepdims=True))

    def votes(self, hypotheses: Sequence[ProjectedHypothesis]) -> NDArray[np.float64]:
        """Share of each action ``(A,)`` in the confidence of one frame's hypotheses."""
        votes = np.zeros(len(self.actions))
        total = 1e-9
        for hypothesis in hypotheses:
            total += hypothesis.confidence
            if hypothesis.label.action in self.actions:
                votes[self.actions.index(hypothesis.label.action)] += hypothesis.confidence
        return np.asarray(votes / total)

    @classmethod
    def load(cls, file: Path = MODEL) -> ActionModel:
        """Read what ``python -m scripts.train_actions`` wrote."""
        values = json.loads(file.read_text())
        return cls(
            tuple(values["actions"]),
            np.array(values["weights"], np.float64),
            np.array(values["offsets"], np.float64),
            float(values["vote_weight"]),
        )


@lru_cache(maxsize=1)
def shipped_model() -> ActionModel:
    """The model in the package."""
    return ActionModel.load()


class ActionRecogniser:
    """Tells from the last seconds of a track what the person does.

    Parameters
    ----------
    model : ActionModel, optional
        The shipped one by default.
    """

    def __init__(self, model: ActionModel | None = None) -> None:
        self._model = shipped_model() if model is None else model
        self._seen: deque[tuple[Measured, NDArray[np.float64]]] = deque()
        self._told: RecognisedAction | None = None
        self._told_at = -math.inf

    def update(
        self,
        timestamp: float,
        person: Person,
        smoothed: Smoothed,
        posture: EstimatedPosture | None = None,
    ) -> RecognisedAction | None:
        """Take in a frame of the track.

        Parameters
        ----------
        timestamp : float
            Seconds, after those of the frames before.
        person : Person
            With at least one hypothesis.
        smoothed : Smoothed
            The track's pose at this frame.
        posture : EstimatedPosture, optional
            The track's, where it is surer than the motion: with landmarks.

        Returns
        -------
        RecognisedAction or None
            None until the person was seen for a second, and where no action is likely.
        """
        if self._seen and timestamp - self._seen[-1][0].timestamp > MOST_GAP_S:
            self._seen.clear()
            self._told = None
        if not self._seen or timestamp - self._seen[-1][0].timestamp >= LEAST_STEP_S:
            measured = Measured.of(timestamp, smoothed)
            self._seen.append((measured, self._model.votes(person.hypotheses)))
        while timestamp - self._seen[0][0].timestamp > WINDOW_S:
            self._seen.popleft()
        if timestamp - self._seen[0][0].timestamp < LEAST_S:
            return None
        if timestamp - self._told_at < EVERY_S:
            return self._told
        features = window_features([measured for measured, _ in self._seen])
        votes = np.mean([votes for _, votes in self._seen], axis=0)
        if posture is None:
            probabilities = self._model.probabilities(features, votes)
        else:
            sure = min(1.0, person.observed.whole_box.height / SURE_PX)
            probabilities = self._model.probabilities(features, votes, sure)
            probabilities = probabilities * posture_factors(self._model.actions, posture)
            probabilities /= probabilities.sum()
        best = int(probabilities.argmax())
        self._told_at = timestamp
        self._told = None
        if probabilities[best] >= POSTURE.min_probability:
            self._told = RecognisedAction(self._model.actions[best], float(probabilities[best]))
        return self._told


def posture_factors(actions: Sequence[str], posture: EstimatedPosture) -> NDArray[np.float64]:
    """How well a posture goes with each action, ``(A,)``."""
    shown = [posture.share(SHOWN_BY.get(action, ON_THE_SPOT)) for action in actions]
    return LEAST_POSTURE + np.array(shown)


def window_features(measured: Sequence[Measured]) -> NDArray[np.float64]:
    """Features of poses at any, also uneven, rate.

    Parameters
    ----------
    measured : sequence of Measured
        In order of time, over at least two intervals of ``RATE_HZ``.
    """
    times = np.array([m.timestamp for m in measured])
    wanted = np.arange(times[-1], times[0] - 1e-9, -1 / RATE_HZ)[::-1]

    def resampled(values: NDArray[np.float64]) -> NDArray[np.float64]:
        columns = values.reshape(len(values), -1).T
        at_rate = np.stack([np.interp(wanted, times, column) for column in columns], axis=1)
        return at_rate.reshape(len(wanted), *values.shape[1:])

    elevation_deg = float(np.mean([m.elevation_deg for m in measured]))
    scale = float(np.median([m.pixels_per_metre for m in measured]))
    pelvis_px = resampled(np.array([m.pelvis_px for m in measured]))
    return action_features(
        resampled(np.array([m.points_3d for m in measured])),
        camera_up(elevation_deg),
        ground_path(pelvis_px, scale, elevation_deg),
    )
