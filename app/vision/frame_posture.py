"""The posture in one frame, from landmarks in three dimensions; trained on rendered people."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from app.vision.dense import DenseNetwork, softmax
from app.vision.odds import logit
from app.vision.people import landmark_rows

FramePostureName = Literal["standing", "bending", "crouching", "sitting", "all_fours", "lying"]

FRAME_POSTURES: tuple[FramePostureName, ...] = get_args(FramePostureName)
"""Standing includes walking, running and raised arms; crouching includes kneeling."""


MIN_RIGHT = 0.01
"""The probability that landmarks are right is kept this far from 0 and 1."""


@dataclass(frozen=True)
class FramePosture:
    """Probability of each posture.

    Parameters
    ----------
    probabilities : (6,) float64 array
        Of :data:`FRAME_POSTURES`; they sum to 1.
    """

    probabilities: NDArray[np.float64]

    def __post_init__(self) -> None:
        if self.probabilities.shape != (len(FRAME_POSTURES),):
            raise ValueError(f"expected six probabilities, got {self.probabilities.shape}")

    @property
    def likeliest(self) -> FramePostureName:
        """The likeliest posture."""
        return FRAME_POSTURES[int(self.probabilities.argmax())]

    def of(self, name: FramePostureName) -> float:
        """Probability of one posture."""
        return float(self.probabilities[FRAME_POSTURES.index(name)])


_SHOULDERS, _HIPS, _KNEES, _ANKLES, _WRISTS, _EARS = (
    landmark_rows(part) for part in ("shoulder", "hip", "knee", "ankle", "wrist", "ear")
)
_EXTENT = [*_SHOULDERS, *_HIPS, *_KNEES, *_ANKLES, *_EARS]


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, 1e-6))


def _slopes(bones: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Sine of the elevation of bones ``(N, 3)``, and its complement."""
    sine = -_unit(bones)[:, 1]
    return [sine, np.sqrt(np.maximum(1 - sine**2, 0))]


def posture_features(
    points: NDArray[np.float64],
    visibility: NDArray[np.float64],
    roll_deg: NDArray[np.float64],
    presence: NDArray[np.float64],
    box_aspect: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Features from which postures are estimated; they do not distinguish left from right.

    Parameters
    ----------
    points : (N, 33, 3) float64 array
        Landmarks, metres, camera axes: y down.
    visibility : (N, 33) float64 array
    roll_deg : (N,) float64 array
        Of the windows.
    presence : (N,) float64 array
        As the network gives it.
    box_aspect : (N,) float64 array
        Width over height of the box about the landmarks.

    Returns
    -------
    (N, F) float64 array
    """

    def middle(rows: list[int]) -> NDArray[np.float64]:
        return np.asarray(points[:, rows].mean(axis=1))

    trunk = middle(_SHOULDERS) - middle(_HIPS)
    thighs = points[:, _KNEES] - points[:, _HIPS]
    shanks = points[:, _ANKLES] - points[:, _KNEES]
    head = middle(_EARS) - middle(_SHOULDERS)
    hip = (_unit(thighs) * _unit(trunk)[:, None]).sum(axis=-1)
    knee = (_unit(thighs) * _unit(shanks)).sum(axis=-1)
    legs = np.linalg.norm(thighs, axis=-1).mean(1) + np.linalg.norm(shanks, axis=-1).mean(1)
    legs = np.maximum(legs, 0.2)
    slopes = [np.sort(-_unit(bones)[..., 1], axis=1) for bones in (thighs, shanks)]
    heights = -points[..., 1]
    lowest = heights[:, _EXTENT].min(axis=1)
    extent = np.ptp(points[:, _EXTENT], axis=1)
    roll = np.deg2rad(roll_deg)
    forward = [_unit(bone)[:, 2] for bone in (trunk, thighs.mean(axis=1), shanks.mean(axis=1))]
    return np.column_stack(
        [
            *_slopes(trunk),
            *_slopes(thighs.mean(axis=1)),
            *_slopes(shanks.mean(axis=1)),
            *_slopes(head),
            *(pair[:, side] for pair in slopes for side in (0, 1)),
            *forward,
            *(np.sort(angle, axis=1)[:, side] for angle in (hip, knee) for side in (0, 1)),
            extent[:, 1],
            np.log((extent[:, 1] + 0.05) / (np.hypot(extent[:, 0], extent[:, 2]) + 0.05)),
            (heights[:, _HIPS].mean(axis=1) - lowest) / legs,
            (heights[:, _SHOULDERS].mean(axis=1) - lowest) / legs,
            (heights[:, _WRISTS].min(axis=1) - lowest) / legs,
            (heights[:, _KNEES].min(axis=1) - lowest) / legs,
            np.sin(roll),
            np.cos(roll),
            presence,
            np.log(np.clip(box_aspect, 0.05, 20)),
            visibility[:, _KNEES].max(axis=1),
            visibility[:, _ANKLES].max(axis=1),
            visibility[:, _HIPS].max(axis=1),
        ]
    )


@dataclass(frozen=True)
class PostureModel:
    """Estimates postures from the mean scores of two networks.

    One gets no feature maps, so surroundings unlike any rendered ones cannot determine the result
    alone.

    Parameters
    ----------
    by_body : DenseNetwork
        Scores of :data:`FRAME_POSTURES`, from :func:`posture_features` and
        :func:`app.vision.doubt.doubt_features`.
    by_surroundings : DenseNetwork
        The same scores, from :func:`app.vision.landmark_features.region_features` as well.
    trust : (2,) float64 array
        The scores are multiplied by a factor: the less of a person is seen, the less certain is the
        posture. These are the factor's logarithm if landmarks are as likely right as wrong, and its
        growth with the log odds of right landmarks. Both are calibrated on held-out renders.
    """

    by_body: DenseNetwork
    by_surroundings: DenseNetwork
    trust: NDArray[np.float64]

    def scores(
        self, body: NDArray[np.float64], surroundings: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Scores ``(N, 6)`` of features of bodies ``(N, F)`` and their surroundings ``(N, M)``."""
        both = self.by_surroundings(np.hstack([body, surroundings]))
        return np.asarray((self.by_body(body) + both) / 2, np.float32)

    def estimate(
        self, body: NDArray[np.float64], surroundings: NDArray[np.float32], right: float
    ) -> FramePosture:
        """Posture of a body from features ``(F,)``, ``(M,)`` and the chance of right landmarks."""
        scores = self.scores(body[None], surroundings[None])
        return FramePosture(trusted(scores, np.array([right]), self.trust)[0])


def trusted(
    scores: NDArray[np.floating], right: NDArray[np.float64], trust: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Probabilities ``(N, O)`` of scores, see :class:`PostureModel`."""
    factors = np.exp(trust[0] + trust[1] * logit(right, MIN_RIGHT))
    return softmax(scores * factors[:, None])
