"""The public contract of camera sessions and videos; see :mod:`app.api.schemas` for the rest."""

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from app.api.schemas import (
    Box,
    Duration,
    Flat2D,
    Flat3D,
    FrameUpload,
    ImageSize,
    Model,
    Person,
    Point2D,
    Point3D,
    PoseResponse,
    Probability,
    Score,
    Seconds,
    rounding,
)
from app.configuration import EventName, FieldOfView, PixelAspect, Roll, Zone
from app.estimation.posture import PostureLabel
from app.film import VideoEndReason
from app.tracking.results import EventState

LATEST_TIMESTAMP_S = 1e11
"""Later than any clock in seconds, earlier than today in milliseconds."""

MAX_TRACK_ID_CHARACTERS = 64


class TrackUpload(FrameUpload):
    """A frame of a camera and, if known, when it was taken and where its people are."""

    track_ids: str | None = Field(
        default=None,
        description="The caller's own identities of the people in `boxes`: a JSON list of strings "
        'or integers, one for each box, such as `["17", "18"]`. The reply has them as strings, as '
        "`caller_track_id`; the same identity means the same person.",
    )
    timestamp: float | None = Field(
        default=None,
        ge=0,
        le=LATEST_TIMESTAMP_S,
        allow_inf_nan=False,
        description="When the frame was taken: seconds on any clock that never goes back, later "
        "than the last frame. By default, the time of arrival is used.",
    )


class SmoothedPose(Model):
    """The pose of a track, estimated from all of its frames so far."""

    entry: int = Field(ge=0, description="That of the pose's hypothesis.", examples=[20117])
    confidence: Probability = Field(
        description="Calibrated probability that the mean distance of the limb joints from the "
        "person's own, in the image, is under 5 px of the normalised 128x48 frame.",
        examples=[0.91],
    )
    joints_3d: list[Point3D | None] | None = Field(
        description="In metres: camera axes (x right, y down, z forward), origin at the pelvis. "
        "Null where one is unknown, and as a whole with `joints=compact` or `none`.",
        examples=[[{"x": 0.0, "y": 0.0, "z": 0.0}]],
    )
    joints_2d: list[Point2D | None] | None = Field(
        description="The same keypoints in pixels of the frame. Null as above.",
        examples=[[{"x": 431.2, "y": 190.4}]],
    )
    joints_3d_flat: Flat3D
    joints_2d_flat: Flat2D


class Action(Model):
    """The action of a person, recognised from the motion."""

    label: str = Field(description="One of the index's actions.", examples=["walk"])
    probability: Score = Field(description="Probability that the label is right.", examples=[0.88])


class TrackedPerson(Person):
    """One person of the frame, and the track they belong to.

    `facing` and `posture` are those of the track; `hypotheses` are those of the frame alone, and
    empty with `joints=none` and for a person who is hidden behind another one.
    """

    track_id: int = Field(ge=1, description="Identity, unique for one camera.", examples=[3])
    age_frames: int = Field(ge=1, description="Frames of the track, with this one.", examples=[41])
    pose: SmoothedPose | None = Field(
        description="Smoothed over the frames so far. Null with `joints=none`, and if the person "
        "has had no silhouette for a second."
    )
    action: Action | None = Field(
        description="Null until there are enough frames, and if no action reaches a probability of "
        "one half."
    )
    zones: list[str] = Field(
        description="Names of the camera's zones that contain the person's feet or, if the person "
        "lies or crawls, the middle of the box.",
        examples=[["bed"]],
    )
    caller_track_id: str | None = Field(
        description="The caller's own identity of the person, as last given in `track_ids`. Null "
        "if none was given.",
        examples=["17"],
    )
    still_s: Annotated[FiniteFloat, Field(ge=600), rounding(4)] | None = Field(
        description="Seconds for which the person has looked the same, from 600 on: a statue, a "
        "screen, a poster, a sleeper. Otherwise null.",
        examples=[None],
    )
    on_floor: Score | None = Field(
        default=None,
        description="Probability that a lying person is on the floor, rather than on a bed "
        "or a sofa. Null for others, where neither reaches 0.8, and until the camera has seen "
        "people who stand.",
        examples=[None],
    )


class Event(Model):
    """A change in a track, or in the view of the camera, at one frame."""

    id: str | None = Field(
        description="Unique, and the same whenever the event is listed; names its replay. Null in "
        "videos.",
        examples=["2f0c6bd5-6b1f-5d0a-9b0e-8a5a4cf4b6d3"],
    )
    event: EventName = Field(
        description="`entered`, `left`: the track began, ended; `zone_entered`, `zone_left`; "
        "`fell`: the person fell and is down; `lying`, `arms_raised`: the posture; `obstructed`: "
        "little is left of the camera's usual view.",
        examples=["fell"],
    )
    track_id: Annotated[int, Field(ge=1)] | None = Field(
        description="Identity of the person. Null with `obstructed`, an event of the camera.",
        examples=[3],
    )
    state: EventState = Field(
        description="Whether `lying`, `arms_raised` or `obstructed` began or ended; `instant` for "
        "all others; `unconfirmed`, only at the end of a video, if it was not certain yet.",
        examples=["instant"],
    )
    zones: list[str] = Field(
        description="Names of the camera's zones in which the person is, or was last seen; for "
        "`zone_entered` and `zone_left`, only that zone.",
        examples=[["kitchen"]],
    )
    caller_track_id: str | None = Field(
        description="The caller's own identity of the person. Null if none was given.",
        examples=["17"],
    )
    timestamp: Seconds = Field(description="Time of the frame, seconds.", examples=[12.4])
    probability: Score = Field(description="Probability of the event.", examples=[0.93])
    dwell_s: Duration | None = Field(
        description="Seconds that the person was in the zone, with `zone_left`; otherwise null.",
        examples=[31.5],
    )
    lost: bool = Field(
        default=False,
        description="With `fell`, whether the person was no longer visible when the fall was "
        "reported.",
        examples=[False],
    )
    on_floor: Score | None = Field(
        default=None,
        description="With `lying` and `fell`, the person's `on_floor`; otherwise null.",
        examples=[0.97],
    )


class _TrackedFrame(PoseResponse):
    frame_index: int = Field(ge=0, description="Frames of the session before it.", examples=[40])
    timestamp: Seconds = Field(
        description="Time of the frame, seconds: its timestamp, or the time since the session "
        "began.",
        examples=[12.4],
    )
    reset: str | None = Field(
        description="Why all tracks were dropped before this frame, as a sentence. Null where they "
        "were not.",
        examples=["frames were 768x576 pixels before, this one is 640x480"],
    )
    persons: list[TrackedPerson] = Field(  # type: ignore[assignment]
        description="Ordered left to right; empty if there are none."
    )
    events: list[Event] = Field(description="Changes at this frame.")


class TrackResponse(_TrackedFrame):
    """The people of a frame of a camera, each with identity, smoothed pose and action."""

    camera_id: str = Field(description="Name of the camera.", examples=["yard-2"])


class CameraState(Model):
    """A camera at a glance: its zones, and its session if it has one."""

    camera_id: str = Field(description="Name of the camera.", examples=["yard-2"])
    zones: list[Zone] = Field(description="As `PUT` or the service's file set them.")
    zones_outside: list[str] = Field(
        description="Names of the zones that lie wholly outside the last frame, so that nobody is "
        "ever in them. Empty without a session.",
        examples=[[]],
    )
    zones_crossing: list[str] = Field(
        description="Names of the zones whose border crosses itself, as with corners in a wrong "
        "order.",
        examples=[[]],
    )
    fov_deg: FieldOfView | None = Field(description="As configured, or null.")
    pixel_aspect: PixelAspect | None = Field(description="As configured, or null.")
    roll_deg: Roll | None = Field(description="As configured, or null.")
    events: list[EventName] = Field(description="The events that the camera raises.")
    frames: int = Field(ge=0, description="Frames of the session, if any.", examples=[4120])
    timestamp: Seconds | None = Field(
        description="Time of the last frame, seconds. Null without a session.", examples=[412.0]
    )
    image: ImageSize | None = Field(description="Size of the last frame. Null without a session.")
    track_ids: list[int] = Field(description="The people in the last frame.", examples=[[3, 7]])
    age_s: Duration | None = Field(description="Seconds since the first frame.", examples=[413.2])
    idle_s: Duration | None = Field(description="Seconds since the last frame.", examples=[0.1])
    memory_bytes: int = Field(ge=0, description="Of the session, in memory.", examples=[2400000])


class CameraEvents(Model):
    """The latest events of a camera."""

    camera_id: str = Field(description="Name of the camera.", examples=["yard-2"])
    events: list[Event] = Field(description="At most a hundred, in order.")


class ReplayedFrame(Model):
    """A person at one frame."""

    timestamp: Seconds = Field(description="Time of the frame, seconds.", examples=[12.4])
    box: Box = Field(description="The person's box.")
    joints: list[Point2D | None] = Field(
        description="The 17 COCO keypoints in COCO order; null where they are not seen.",
        examples=[[{"x": 429.0, "y": 128.0}]],
    )
    outline: list[FiniteFloat] | None = Field(
        description="Outline of the silhouette, at most 24 corners, as `[x1, y1, x2, y2, ...]`. "
        "Null where it is not known.",
        examples=[[401, 120, 462, 268, 401, 268]],
    )


class EventReplay(Model):
    """What was seen of a person from three seconds before an event to three seconds after it.

    If the person was no longer visible, it begins three seconds before the last sighting. Positions
    are in whole pixels of the frame; there are at most five frames a second.
    """

    camera_id: str = Field(description="Name of the camera.", examples=["yard-2"])
    event: Event
    image: ImageSize
    zones: list[Zone] = Field(description="The camera's zones, as they are now.")
    complete: bool = Field(description="Whether the three seconds after the event have passed.")
    frames: list[ReplayedFrame] = Field(description="In order.")


class CameraList(Model):
    """The cameras of the caller that have a session or a configuration."""

    cameras: list[CameraState] = Field(description="Ordered by name.")


class VideoUpload(Model):
    """A video."""

    video: bytes = Field(
        description="AVI, MP4, MOV, Matroska, WebM, MPEG, FLV, ASF, Ogg, DV, GIF or MJPEG, of any "
        "codec that FFmpeg reads."
    )


class _FrameLine(Model):
    type: Literal["frame"] = Field(description="Always `frame`.", examples=["frame"])
    video_frame: int = Field(ge=0, description="Frame of the video, from 0.", examples=[80])


class SequenceFrame(_TrackedFrame, _FrameLine):
    """A line of a video's reply: one of its frames."""


class PostureTime(Model):
    """The time that a person spent in a posture."""

    label: PostureLabel = Field(description="The posture.", examples=["walking"])
    seconds: Duration = Field(description="Total time.", examples=[11.8])


class TrackSummary(Model):
    """A person over a whole video."""

    track_id: int = Field(ge=1, description="Identity of the person.", examples=[3])
    first_timestamp: Seconds = Field(description="Of the first frame, seconds.", examples=[0.6])
    last_timestamp: Seconds = Field(description="Of the last frame, seconds.", examples=[12.4])
    frames: int = Field(ge=1, description="Frames with the person.", examples=[119])
    action: Action | None = Field(
        description="The likeliest over all frames, with its mean probability. Null if none."
    )
    postures: list[PostureTime] = Field(description="Ordered by duration, the longest first.")


class SequenceEnd(Model):
    """The last line of a video's reply."""

    type: Literal["end"] = Field(description="Always `end`.", examples=["end"])
    reason: VideoEndReason = Field(
        description="`complete`: the video has ended; `max_frames`: no more were requested or "
        "allowed; `broken`: the rest cannot be read; `timeout`: it took too long; `shutdown`: the "
        "service is being stopped; `unavailable`: the index cannot be searched; `failed`: an error "
        "of the service.",
        examples=["complete"],
    )
    detail: str = Field(description="A sentence.", examples=["the video ended after 795 frames"])
    frames: int = Field(ge=0, description="Frames processed.", examples=[795])
    damaged: int = Field(ge=0, description="Those with the warning `damaged`.", examples=[0])
    tracks: list[TrackSummary] = Field(description="Ordered by their ids.")
    events: list[Event] = Field(
        description="All events, in order; last, with the state `unconfirmed`, those that had "
        "begun to show when the video ended."
    )


SequenceLine = SequenceFrame | SequenceEnd


class SequenceResponse(Model):
    """A video's reply as one document."""

    frames: list[SequenceFrame] = Field(description="In order.")
    end: SequenceEnd
