"""What a tracked person does: a linear model on features of the motion of the last seconds.

Lengths are in legs, and joints are described from the person's point of view: outward (towards
their own side), up and forward of the pelvis. Of the two limbs of a pair, the larger and the
smaller value are used, rather than the left and the right one.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.estimation.posture import MIN_PROBABILITY, EstimatedPosture
from app.estimation.results import Person
from app.networks.probabilities import softmax
from app.networks.shipped import arrays_of
from app.tracking.motion import ground_path
from app.tracking.results import RecognisedAction
from app.tracking.seen_body import SeenBody
from app.vision.blazepose import LANDMARK_PX
from index.matching import PoseHypothesis
from index.posture import ON_THE_GROUND, PostureName, camera_up
from index.skeleton import JOINT_NAMES, JOINTS, wrap_degrees

_EVERYDAY = ("lie", "sit", "stand", "walk", "run")
"""Actions that are likelier than exercises if the limbs' motion is not visible."""

_SHOWN_BY: dict[str, tuple[PostureName, ...]] = {
    "lie": ON_THE_GROUND,
    "sit": ("sitting",),
    "squat": ("crouching", "kneeling", "sitting", "bending"),
    "jump": ("standing", "arms_raised", "bending", "crouching", "running"),
    "walk": ("walking",),
    "run": ("running",),
}
"""Postures that an action shows; all actions not listed show those of ``_ON_THE_SPOT``."""

_ON_THE_SPOT: tuple[PostureName, ...] = ("standing", "arms_raised", "bending")

RATE_HZ = 10.0
"""Poses a second from which features are computed."""

_SPEED_BANDS = ((0.0, 0.3), (0.3, 0.6), (0.6, 1.0), (1.5, 3.0))
"""Metres a second: on the spot, shifting, walking, and faster than a walk. With these bands a
linear model can recognise walking, which is a range of speeds."""

_TRUNK = ("spine", "chest", "head")
_LIMBS = ("elbow", "wrist", "knee", "ankle")
_OUTWARD = {"left": np.array([1.0, 1.0, 1.0]), "right": np.array([-1.0, 1.0, 1.0])}


MIN_VOTE = 0.02
"""Share of the votes for an action that no hypothesis shows."""


@dataclass(frozen=True)
class ActionModel:
    """Linear discriminants of motions, and the weight of the hypotheses' labels beside them."""

    actions: tuple[str, ...]  # labels of the index
    weights: NDArray[np.float64]  # (A, D)
    # (A,): log odds of the actions are ``weights @ features + offsets``.
    offsets: NDArray[np.float64]
    vote_weight: float  # weight of the log of the hypotheses' votes

    def __post_init__(self) -> None:
        if self.weights.ndim != 2 or not (
            len(self.actions) == len(self.weights) == len(self.offsets)
        ):
            raise ValueError(
                f"expected weights and an offset for each of {len(self.actions)} actions, "
                f"got {self.weights.shape} and {self.offsets.shape}"
            )

    @classmethod
    def of(cls, arrays: Mapping[str, NDArray[Any]]) -> ActionModel:
        return cls(
            tuple(arrays["actions"].tolist()),
            arrays["weights"],
            arrays["offsets"],
            float(arrays["vote_weight"]),
        )

    def probabilities(
        self,
        features: NDArray[np.float64],
        votes: NDArray[np.float64],
        limb_clarity: float = 1.0,
    ) -> NDArray[np.float64]:
        """Probabilities ``(..., A)`` of actions.

        They follow from :func:`window_features` ``(..., D)`` and :meth:`votes` ``(..., A)``. The
        less clearly the picture shows the limbs' motion, 0 to 1, the more weight everyday actions
        get.
        """
        # Their odds against exercises are ten if the motion of limbs is not seen.
        everyday = math.log(10) * np.isin(self.actions, _EVERYDAY)
        shown = features @ self.weights.T + self.offsets
        odds = limb_clarity * shown + (1 - limb_clarity) * everyday
        odds = odds + self.vote_weight * np.log(np.maximum(votes, MIN_VOTE))
        return softmax(odds)

    def votes(self, hypotheses: Sequence[PoseHypothesis]) -> NDArray[np.float64]:
        """Share of each action ``(A,)`` in the confidence of one frame's hypotheses."""
        votes = np.zeros(len(self.actions))
        total = 1e-9
        for hypothesis in hypotheses:
            total += hypothesis.confidence
            if hypothesis.label.action in self.actions:
                votes[self.actions.index(hypothesis.label.action)] += hypothesis.confidence
        return np.asarray(votes / total)


@cache
def shipped_model() -> ActionModel:
    return ActionModel.of(arrays_of("actions"))


WINDOW_S = 3.0
"""Motion from which an action is recognised."""

FULL_WEIGHT_PX = LANDMARK_PX
"""Height from which limbs' motion counts in full."""


class ActionRecogniser:
    """Recognises what the person of a track does, from the last seconds."""

    def __init__(self, model: ActionModel | None = None) -> None:
        self._model = shipped_model() if model is None else model
        self._window: deque[tuple[float, SeenBody, NDArray[np.float64]]] = deque()
        self._last_result: RecognisedAction | None = None
        self._last_at = -math.inf

    def update(
        self,
        timestamp: float,
        body: SeenBody,
        person: Person,
        posture: EstimatedPosture | None = None,
    ) -> RecognisedAction | None:
        """Add a frame of the track; None until a second has been seen, and if no action is likely.

        The body has a skeleton. The track's posture is given if it is more reliable than the
        motion, as with landmarks. The actions of hypotheses then do not vote, and there may be no
        hypotheses.
        """
        self._add(timestamp, body, () if posture else person.voters)
        # The shortest motion that suffices.
        if timestamp - self._window[0][0] < 1.0:
            return None
        # Time between two results: actions change slowly.
        if timestamp - self._last_at >= 0.5:
            self._last_at, self._last_result = timestamp, self._recognise(person, posture)
        return self._last_result

    def _add(self, timestamp: float, body: SeenBody, hypotheses: Sequence[PoseHypothesis]) -> None:
        elapsed = timestamp - self._window[-1][0] if self._window else math.inf
        if elapsed > 1.0:
            self._window.clear()
            self._last_result = None
        if elapsed >= 1 / 40:  # Closer poses only add memory: motion is sampled at 10 Hz.
            self._window.append((timestamp, body, self._model.votes(hypotheses)))
        while timestamp - self._window[0][0] > WINDOW_S:
            self._window.popleft()

    def _recognise(
        self, person: Person, posture: EstimatedPosture | None
    ) -> RecognisedAction | None:
        """The likeliest action of the window; None if it is unlikely or the posture unclear."""
        if posture is not None and posture.label == "unclear":
            return None
        times, bodies, given = zip(*self._window, strict=True)
        features, votes = window_features(times, bodies), np.mean(given, axis=0)
        limb_clarity, factors = 1.0, np.ones(len(self._model.actions))
        if posture is not None:
            limb_clarity = min(1.0, person.whole_box.height / FULL_WEIGHT_PX)
            factors = posture_factors(self._model.actions, posture)
        probabilities = factors * self._model.probabilities(features, votes, limb_clarity)
        probabilities /= probabilities.sum()
        best = int(probabilities.argmax())
        if probabilities[best] < MIN_PROBABILITY:
            return None
        return RecognisedAction(self._model.actions[best], float(probabilities[best]))


def posture_factors(actions: Sequence[str], posture: EstimatedPosture) -> NDArray[np.float64]:
    """Factors ``(A,)`` that say how well each action agrees with a posture."""
    shown = [posture.share(_SHOWN_BY.get(action, _ON_THE_SPOT)) for action in actions]
    # Factor of an action that the posture of the moment contradicts.
    return 0.1 + np.array(shown)


def window_features(times: Sequence[float], bodies: Sequence[SeenBody]) -> NDArray[np.float64]:
    """Features ``(D,)`` of bodies at any, even irregular, rate, over two intervals or more."""
    wanted = np.arange(times[-1], times[0] - 1e-9, -1 / RATE_HZ)[::-1]

    def resampled(values: NDArray[np.float64]) -> NDArray[np.float64]:
        columns = values.reshape(len(values), -1).T
        at_rate = np.stack([np.interp(wanted, times, column) for column in columns], axis=1)
        return at_rate.reshape(len(wanted), *values.shape[1:])

    elevation_deg = float(np.mean([body.elevation_deg for body in bodies]))
    scale = float(np.median([body.px_per_m for body in bodies]))
    hips_px = resampled(np.array([body.hips_px for body in bodies]))
    return action_features(
        resampled(np.array([body.skeleton for body in bodies])),
        camera_up(elevation_deg),
        ground_path(hips_px, scale, elevation_deg),
    )


def action_features(
    points_3d: NDArray[np.float64], up: NDArray[np.float64], path: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Features ``(D,)`` of a motion of ``RATE_HZ`` poses a second.

    Skeletons ``(T, P, 3)``, whose first 19 points are the joints, and the direction away from the
    ground, ``(3,)``, are in camera axes and metres; the path ``(T, 2)`` is from
    :func:`app.tracking.motion.ground_path`.
    """
    joints, left = _in_body_axes(points_3d, up)
    at = {name: joints[:, row] for row, name in enumerate(JOINT_NAMES)}
    parts: list[NDArray[np.float64]] = []
    for name in _TRUNK:
        parts.append(_statistics(np.abs(at[name]) * (1, 0, 0) + at[name] * (0, 1, 1)))
    for name in _LIMBS:
        sides = [at[f"{side}_{name}"] * signs for side, signs in _OUTWARD.items()]
        left_side, right_side = (_statistics(side) for side in sides)
        parts += [np.maximum(left_side, right_side), np.minimum(left_side, right_side)]
        parts += _coordination(*sides)
    height = joints[:, 0, 1] - joints[..., 1].min(axis=1)
    apart = [at[f"left_{name}"] - at[f"right_{name}"] for name in ("wrist", "ankle")]
    parts += [_statistics(height), *(_statistics(np.linalg.norm(d, axis=1)) for d in apart)]
    parts += [_turning(at, left), _travel(path)]
    features = np.concatenate([part.ravel() for part in parts])
    # Roots bring the long tails of speeds closer to a normal distribution.
    return np.asarray(np.sign(features) * np.sqrt(np.abs(features)))


def _in_body_axes(
    points_3d: NDArray[np.float64], up: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Joints ``(T, 19, 3)`` to the left, up and forward of the pelvis, in legs.

    Also the person's left direction, ``(T, 3)``.
    """
    joints = points_3d[:, :JOINTS] - points_3d[:, :1]
    at = {name: joints[:, row] for row, name in enumerate(JOINT_NAMES)}
    across = sum(at[f"left_{name}"] - at[f"right_{name}"] for name in ("hip", "shoulder"))
    left = across - np.multiply.outer(across @ up, up)
    left /= np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-6)
    axes = np.stack([left, np.broadcast_to(up, left.shape), np.cross(left, up)], axis=1)
    bones = [
        at[f"{side}_{start}"] - at[f"{side}_{end}"]
        for side in _OUTWARD
        for start, end in (("hip", "knee"), ("knee", "ankle"))
    ]
    leg = np.linalg.norm(bones, axis=-1).mean() * 2
    return np.einsum("tij,tpj->tpi", axes, joints) / leg, left


def _statistics(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean, deviation, minimum, maximum, mean and RMS speed: ``(6, ...)`` of ``(T, ...)``."""
    speeds = RATE_HZ * np.abs(np.diff(values, axis=0))
    return np.stack([
        values.mean(axis=0), values.std(axis=0), values.min(axis=0), values.max(axis=0),
        speeds.mean(axis=0), np.sqrt((speeds**2).mean(axis=0)),
    ])  # fmt: skip


def _coordination(
    left: NDArray[np.float64], right: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Covariance of both sides, negative where they move in turn, and their mean distance."""
    return (
        np.mean((left - left.mean(axis=0)) * (right - right.mean(axis=0)), axis=0),
        np.abs(left - right).mean(axis=0),
    )


def _turning(at: dict[str, NDArray[np.float64]], left: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn of the shoulders against the hips, and of the body; radians and radians a second."""
    yaw = {}
    for name in ("shoulder", "hip"):
        across = at[f"left_{name}"] - at[f"right_{name}"]
        yaw[name] = np.rad2deg(np.arctan2(across[:, 2], across[:, 0]))
    twist = np.deg2rad(wrap_degrees(yaw["shoulder"] - yaw["hip"]))
    # The camera's x and z span the ground closely enough for a turn's speed.
    heading = np.unwrap(np.arctan2(left[:, 2], left[:, 0]))
    return np.array([
        twist.std(), np.ptp(twist), RATE_HZ * np.abs(np.diff(twist)).mean(),
        RATE_HZ * abs(heading[-1] - heading[0]) / (len(heading) - 1),
        RATE_HZ * np.abs(np.diff(heading)).mean(),
    ])  # fmt: skip


def _travel(path: NDArray[np.float64]) -> NDArray[np.float64]:
    """Speeds in metres a second: from start to end, by band, and from pose to pose."""
    steps = RATE_HZ * np.diff(path, axis=0)
    speed = np.linalg.norm(steps.mean(axis=0))
    return np.array([
        speed, *(np.clip(speed, low, high) - low for low, high in _SPEED_BANDS),
        np.linalg.norm(steps, axis=1).mean(), *np.abs(steps).mean(axis=0), steps[:, 1].std(),
    ])  # fmt: skip
