"""Summary of each person in a video: how long they were seen, their postures and action."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from app.tracking.parameters import DEFAULTS, SummaryParameters
from app.tracking.results import Event, RecognisedAction, TrackedFrame, TrackedPerson
from index.posture import Posture

PostureLabel = Posture | Literal["unclear"]


@dataclass
class TrackSummary:
    """One person over the frames of a video.

    Parameters
    ----------
    track_id : int
        Unique within the video.
    first_timestamp, last_timestamp : float
        Seconds.
    frames : int
        Frames in which the person was seen.
    """

    track_id: int
    first_timestamp: float
    last_timestamp: float
    frames: int = 0
    _posture: PostureLabel | None = None
    _posture_s: dict[PostureLabel, float] = field(default_factory=dict)
    _actions: dict[str, float] = field(default_factory=dict)
    _frames_with_action: int = 0

    def add(self, tracked: TrackedPerson, timestamp: float, max_gap_s: float) -> None:
        """Add the person's next frame; a posture lasts until then unless the gap is longer."""
        gap_s = timestamp - self.last_timestamp
        if self._posture is not None and gap_s <= max_gap_s:
            self._posture_s[self._posture] = self._posture_s.get(self._posture, 0.0) + gap_s
        posture = tracked.person.posture
        self._posture = posture.label if posture else None
        if self._posture is not None:
            self._posture_s.setdefault(self._posture, 0.0)
        if tracked.action is not None:
            label, probability = tracked.action.label, tracked.action.probability
            self._actions[label] = self._actions.get(label, 0.0) + probability
            self._frames_with_action += 1
        self.last_timestamp = timestamp
        self.frames += 1

    def postures(self) -> list[tuple[PostureLabel, float]]:
        """Return each posture and its seconds, the longest first."""
        return sorted(self._posture_s.items(), key=lambda item: -item[1])

    def action(self) -> RecognisedAction | None:
        """Return the action with the largest sum of probabilities, and its mean probability."""
        if not self._actions:
            return None
        label = max(self._actions, key=lambda name: self._actions[name])
        return RecognisedAction(label, self._actions[label] / self._frames_with_action)


class VideoSummary:
    """Tracks and events over the frames of a video."""

    def __init__(self, parameters: SummaryParameters = DEFAULTS.summary) -> None:
        self._max_gap_s = parameters.max_gap_s
        self.frames = 0
        self.tracks: dict[int, TrackSummary] = {}
        self.events: list[Event] = []

    def add(self, frame: TrackedFrame) -> None:
        """Add the next frame."""
        self.frames += 1
        self.events += frame.events
        for tracked in frame.persons:
            track = self.tracks.setdefault(
                tracked.track_id, TrackSummary(tracked.track_id, frame.timestamp, frame.timestamp)
            )
            track.add(tracked, frame.timestamp, self._max_gap_s)
