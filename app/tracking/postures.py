"""A track's posture, held against single bad frames."""

from __future__ import annotations

from collections import deque

from app.posture import VotedPosture
from index.posture import POSTURES, Posture

WINDOW_S = 0.6
"""Seconds over which frames vote."""

LEAD = 0.15
"""By how much of the votes another posture has to be ahead to take over."""


class PostureFilter:
    """Lets the postures of a track's last frames vote; the present one stays in doubt."""

    def __init__(self) -> None:
        self._recent: deque[tuple[float, VotedPosture]] = deque()
        self._label: Posture | None = None

    def update(self, timestamp: float, posture: VotedPosture) -> VotedPosture:
        """Take in a frame's posture and return the track's.

        Parameters
        ----------
        timestamp : float
            Seconds, after those of the frames before.
        posture : VotedPosture
        """
        self._recent.append((timestamp, posture))
        while timestamp - self._recent[0][0] > WINDOW_S:
            self._recent.popleft()
        shares: dict[Posture, float] = dict.fromkeys(POSTURES, 0.0)
        for _, voted in self._recent:
            rest = (1 - voted.probability) / (len(POSTURES) - 1)
            for label in POSTURES:
                shares[label] += (voted.probability if label == voted.label else rest) / len(
                    self._recent
                )
        best = max(shares, key=lambda label: shares[label])
        if self._label is None or shares[best] > shares[self._label] + LEAD:
            self._label = best
        return VotedPosture(self._label, shares[self._label])
