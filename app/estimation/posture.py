"""The probability of each posture of a person, in a frame and over time.

Rules name the posture of every hypothesis (:mod:`index.posture`), and each hypothesis votes for it
with its confidence. Landmarks give the probabilities of six postures (:mod:`app.vision.judgement`).
In a frame with landmarks, these six decide, and the votes split them into finer ones. Without
landmarks, the silhouette decides (:mod:`index.network`). Over the frames of a track,
both are averaged.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import Box
from app.vision.judgement import FRAME_POSTURES, FramePosture
from index.posture import POSTURES, PostureGroups, PostureName

LANDMARK_GROUPS = PostureGroups(0, *FRAME_POSTURES)

MIN_PROBABILITY = 0.5
"""Probability from which a posture is reported; below it, the label is ``unclear``."""


PostureLabel = PostureName | Literal["unclear"]
"""``unclear`` if the probability of the likeliest posture is too small."""


@dataclass(frozen=True)
class EstimatedPosture:
    """Share ``(10,)`` of each of ``POSTURES`` of a person, summing to 1, and the likeliest posture.

    The probability is that of the label, which is ``unclear`` if it is too small.
    """

    label: PostureLabel
    probability: float
    shares: NDArray[np.float64] = field(default_factory=lambda: np.zeros(len(POSTURES)))

    def share(self, postures: Sequence[PostureName]) -> float:
        return float(sum(self.shares[POSTURES.index(posture)] for posture in postures))


def as_standing(shares: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same shares ``(10,)``, with walking and running added to standing."""
    moving = np.isin(POSTURES, ("walking", "running"))
    standing = np.array([posture == "standing" for posture in POSTURES])
    return np.where(moving, 0.0, shares + standing * shares[moving].sum())


def likeliest_posture(
    shares: NDArray[np.float64], presence: float = 1.0, confidence: float = 1.0
) -> EstimatedPosture:
    """The likeliest posture, given its shares ``(10,)``.

    ``presence`` is the probability that there is a person at all. If no hypothesis fits, votes and
    landmarks are doubtful as well, so the confidence of the best one limits the probability.
    """
    best = int(shares.argmax())
    # Probability above the minimum that a posture can reach, per confidence of the best hypothesis:
    # above 0.8 from a confidence of 0.2.
    limit = MIN_PROBABILITY + 1.5 * confidence
    probability = min(presence * float(shares[best]), limit)
    label = POSTURES[best] if probability >= MIN_PROBABILITY else "unclear"
    return EstimatedPosture(label, probability, shares)


_LYING = np.array([posture == "lying" for posture in POSTURES], np.float64)


# Time constant with which the posture follows the frames.
_SETTLING_S = 0.4
# Longest gap that counts: after a longer one, the newest frame has no more weight.
_MAX_STEP_S = 1.0


class PostureFilter:
    """Averages the postures of a track's frames; the newest has the most weight."""

    def __init__(self) -> None:
        self._shares: NDArray[np.float64] | None = None
        self._presence = 1.0
        self._last_at = -math.inf

    def update(
        self,
        timestamp: float,
        votes: NDArray[np.float64],
        frame_posture: FramePosture | None,
        presence: float,
        box: Box,
        weight: float = 1.0,
    ) -> tuple[EstimatedPosture, NDArray[np.float64]]:
        """Add a frame; return the track's posture, and the shares ``(10,)`` of this frame alone.

        The votes ``(10,)`` are those of the hypotheses or, without landmarks, the frame's shares;
        ``frame_posture`` is from the landmarks, if any were read. ``presence`` is the probability
        that the landmarks are a person's, ``weight`` the weight of the frame, 0 to 1.
        """
        shares = votes
        if frame_posture is not None:
            # If the network does not recognise the person, only the shape of the box shows lying.
            lying = self._wide(box) * _LYING
            shares = (
                presence * LANDMARK_GROUPS.split(frame_posture.probabilities, votes)
                + (1 - presence) * lying
            )
            shares = shares + (1 - shares.sum()) * votes
        if self._shares is None:
            self._shares, self._presence = shares, presence
        else:
            elapsed = weight * min(timestamp - self._last_at, _MAX_STEP_S)
            kept = math.exp(-elapsed / _SETTLING_S)
            self._shares = kept * self._shares + (1 - kept) * shares
            self._presence = kept * self._presence + (1 - kept) * presence
        self._last_at = timestamp
        return likeliest_posture(self._shares, self._presence), shares

    def _wide(self, box: Box) -> float:
        """Probability that the person in a box lies, from its shape alone."""
        return float(1 / (1 + (1.2 * box.height / box.width) ** 3))
