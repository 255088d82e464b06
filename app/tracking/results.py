"""Results of tracking for a frame: people with identities, smoothed poses, actions, events."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.configuration import EventName
from app.estimation.results import Estimate, Person
from app.tracking.replay import Replay

EventState = Literal["begin", "end", "instant", "unconfirmed"]
SessionState = Literal["new", "warm"]


@dataclass(frozen=True)
class SmoothedPose:
    """A track's pose at the newest frame, estimated from all frames so far.

    ``points_3d`` ``(24, 3)`` are metres in camera axes about the pelvis, ``points_2d`` ``(24, 2)``
    pixels of the frame. The confidence is the probability that the mean joint error in the
    normalised frame is below 5 px; ``entry`` is that of the hypothesis that the pose follows,
    ``votes`` ``(10,)`` are the shares of ``POSTURES`` among the likely hypotheses.
    """

    points_3d: NDArray[np.float64]
    points_2d: NDArray[np.float64]
    confidence: float
    entry: int
    votes: NDArray[np.float64]


@dataclass(frozen=True)
class RecognisedAction:
    """What a person does: one of the index's actions, and its probability."""

    label: str
    probability: float


@dataclass(frozen=True)
class Event:
    """An event of a tracked person or of the camera at a frame.

    One without ``track_id``, ``obstructed``, concerns the camera. The state is ``begin`` or ``end``
    for ``lying``, ``arms_raised`` and ``obstructed``, ``instant`` for all others, and
    ``unconfirmed`` if it had only begun to show at the last frame. The zones are those that the
    person is in, or the one that they entered or left; ``dwell_s``, only with ``zone_left``, is how
    long they were in it. ``lost`` is whether a fallen person was no longer visible; ``on_floor``,
    with ``lying`` and ``fell`` alone, that of :class:`TrackedPerson`. The ``id`` is unique; events
    of videos have none. The replay of a person's event grows for some seconds.
    """

    event: EventName
    state: EventState
    timestamp: float
    probability: float
    track_id: int | None = None
    zones: tuple[str, ...] = ()
    caller_track_id: str | None = None
    dwell_s: float | None = None
    lost: bool = False
    on_floor: float | None = None
    id: str | None = None
    replay: Replay | None = field(default=None, repr=False, compare=False)


@dataclass(frozen=True, kw_only=True)
class TrackedPerson(Person):
    """A person of a frame and the track they belong to; facing and posture are the track's.

    ``age_frames`` includes this one. There is no pose if the track has had no silhouette for a
    second, and no action before enough frames or if none is likely. ``caller_track_id`` is the
    caller's own identity for the person's box, if given. ``still_s`` is the time for which the
    person has looked the same, once they may be a statue or a poster; ``on_floor`` the probability
    that a lying person is on the floor, None while that is not known.
    """

    track_id: int
    age_frames: int
    pose: SmoothedPose | None
    action: RecognisedAction | None
    zones: tuple[str, ...] = ()
    caller_track_id: str | None = None
    still_s: float | None = None
    on_floor: float | None = None


@dataclass(frozen=True, kw_only=True)
class TrackedFrame(Estimate):
    """A frame of a camera session, its people from left to right, in pixels as sent.

    It is black if half its size, or a part of its file, was enough. ``frame_index`` counts from 0;
    ``session`` is ``new`` if the frame began it; ``reset`` is a sentence that says why all tracks
    were dropped before the frame.
    """

    persons: tuple[TrackedPerson, ...]
    frame_index: int
    timestamp: float
    session: SessionState
    reset: str | None
    events: tuple[Event, ...]
