"""Results of tracking for a frame: people with identities, smoothed poses, actions, events."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.estimation.results import Estimate, Person

EventName = Literal["entered", "left", "zone_entered", "zone_left", "lying", "fell", "arms_raised"]
EventState = Literal["begin", "end", "instant", "unconfirmed"]
SessionState = Literal["new", "warm"]


@dataclass(frozen=True)
class SmoothedPose:
    """A track's pose at the newest frame, estimated from all frames so far.

    Parameters
    ----------
    points_3d : (24, 3) float64 array
        Camera axes, metres, origin at the pelvis; rows are ``POINT_NAMES``.
    points_2d : (24, 2) float64 array
        Pixels of the frame.
    confidence : float
        Calibrated probability that the mean joint error in the normalised frame is below 5 px.
    entry : int
        Index entry of the hypothesis of this frame that the pose follows.
    """

    points_3d: NDArray[np.float64]
    points_2d: NDArray[np.float64]
    confidence: float
    entry: int


@dataclass(frozen=True)
class RecognisedAction:
    """What a person does: one of the index's actions, and its probability."""

    label: str
    probability: float


@dataclass(frozen=True)
class Event:
    """Something that began, ended or happened to a tracked person at a frame.

    Parameters
    ----------
    event : str
        ``entered``, ``left``, ``zone_entered``, ``zone_left``, ``lying``, ``fell`` or
        ``arms_raised``.
    track_id : int
        Identity of the person.
    state : str
        ``begin`` or ``end`` of ``lying`` and ``arms_raised``; ``instant`` for all others;
        ``unconfirmed`` if it had only begun to show at the last frame.
    timestamp : float
        Seconds, of the frame.
    probability : float
        Confidence in the event, 0 to 1.
    zones : tuple of str
        Names of the zones in which the person is; for ``zone_entered`` and ``zone_left``, of the
        zone that the person entered or left.
    caller_track_id : str or None
        As in :class:`TrackedPerson`.
    dwell_s : float or None
        Seconds that the person was in the zone; only for ``zone_left``.
    """

    event: EventName
    track_id: int
    state: EventState
    timestamp: float
    probability: float
    zones: tuple[str, ...] = ()
    caller_track_id: str | None = None
    dwell_s: float | None = None


@dataclass(frozen=True, kw_only=True)
class TrackedPerson(Person):
    """A person of a frame and the track they belong to; facing and posture are the track's.

    Parameters
    ----------
    track_id : int
        Unique within a camera session.
    age_frames : int
        Frames since the track began, this one included.
    pose : SmoothedPose or None
        None if the track has had no silhouette, and so no pose, for a second.
    action : RecognisedAction or None
        None until enough frames have been seen, and if no action is likely.
    zones : tuple of str
        Names of the zones in which the person is.
    caller_track_id : str or None
        The identity that the caller gave the person's box, if any.
    """

    track_id: int
    age_frames: int
    pose: SmoothedPose | None
    action: RecognisedAction | None
    zones: tuple[str, ...] = ()
    caller_track_id: str | None = None


@dataclass(frozen=True, kw_only=True)
class TrackedFrame(Estimate):
    """A frame of a camera session.

    Parameters
    ----------
    persons : tuple of TrackedPerson
        Ordered left to right, in pixels of the frame as sent.
    frame_index : int
        Number of the frame in the session, from 0.
    timestamp : float
        Seconds.
    session : str
        ``new`` if this frame began the session.
    reset : str or None
        Why all tracks were dropped before this frame, as a sentence.
    events : tuple of Event
        What began, ended or happened at this frame.
    """

    persons: tuple[TrackedPerson, ...]
    frame_index: int
    timestamp: float
    session: SessionState
    reset: str | None
    events: tuple[Event, ...]
