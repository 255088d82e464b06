"""Tracked frames, camera sessions and whole videos as models of the public contract."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from app.api import tracking_schemas as schemas
from app.api.replies import ReplyForm, frame_fields, joint_fields, person_fields
from app.api.schemas import ImageSize
from app.tracking.results import Event, RecognisedAction, SmoothedPose, TrackedFrame, TrackedPerson
from app.tracking.sessions import CameraSummary
from app.tracking.summary import TrackSummary, VideoSummary
from app.tracking.video_run import VideoEnd
from app.tracking.zones import Zone
from index.store import PoseIndex

SECOND_DIGITS = 4
"""Seconds are rounded to tenths of milliseconds."""


def track_reply(
    frame: TrackedFrame, camera_id: str, index: PoseIndex, form: ReplyForm
) -> schemas.TrackResponse:
    """Write the answer to a frame of a camera."""
    return schemas.TrackResponse(camera_id=camera_id, **_tracked_fields(frame, index, form))


def sequence_frame_reply(
    frame: TrackedFrame, video_frame: int, index: PoseIndex, form: ReplyForm
) -> schemas.SequenceFrame:
    """Write the line of a frame of a video."""
    return schemas.SequenceFrame(
        type="frame", video_frame=video_frame, **_tracked_fields(frame, index, form)
    )


def sequence_end_reply(summary: VideoSummary, end: VideoEnd) -> schemas.SequenceEnd:
    """Write the last line of the answer to a video."""
    return schemas.SequenceEnd(
        type="end",
        reason=end.reason,
        detail=end.detail,
        frames=summary.frames,
        tracks=[_track(track) for _, track in sorted(summary.tracks.items())],
        events=[_event(event) for event in summary.events],
    )


def sequence_line(reply: schemas.SequenceLine) -> bytes:
    """Write a line of the answer to a video."""
    return reply.model_dump_json().encode() + b"\n"


def camera_reply(camera: CameraSummary) -> schemas.CameraState:
    """Describe a camera."""
    session = camera.session
    return schemas.CameraState(
        camera_id=camera.camera_id,
        zones=[
            schemas.Zone(name=zone.name, kind=zone.kind, polygon=zone.polygon.tolist())
            for zone in camera.zones
        ],
        frames=session.frames if session else 0,
        timestamp=round(session.timestamp, SECOND_DIGITS) if session else None,
        image=ImageSize(width=session.width, height=session.height) if session else None,
        track_ids=list(session.track_ids) if session else [],
        age_s=round(session.age_s, SECOND_DIGITS) if session else None,
        idle_s=round(session.idle_s, SECOND_DIGITS) if session else None,
        memory_bytes=session.memory_bytes if session else 0,
    )


def zones_from(zones: Iterable[schemas.Zone]) -> tuple[Zone, ...]:
    """Read the zones that a caller sets."""
    return tuple(Zone(zone.name, zone.kind, np.array(zone.polygon, float)) for zone in zones)


def _tracked_fields(frame: TrackedFrame, index: PoseIndex, form: ReplyForm) -> dict[str, Any]:
    return {
        **frame_fields(frame.frame, frame.timings_ms, index, form),
        "frame_index": frame.frame_index,
        "timestamp": round(frame.timestamp, SECOND_DIGITS),
        "reset": frame.reset,
        "persons": [_person(tracked, frame.frame.shape, form) for tracked in frame.persons],
        "events": [_event(event) for event in frame.events],
    }


def _person(
    tracked: TrackedPerson, frame_shape: tuple[int, ...], form: ReplyForm
) -> schemas.TrackedPerson:
    return schemas.TrackedPerson(
        **person_fields(tracked.person, frame_shape, form),
        track_id=tracked.track_id,
        age_frames=tracked.age_frames,
        pose=_pose(tracked.pose, form) if tracked.pose else None,
        action=_action(tracked.action) if tracked.action else None,
        zones=list(tracked.zones),
        caller_track_id=tracked.caller_track_id,
    )


def _pose(pose: SmoothedPose, form: ReplyForm) -> schemas.SmoothedPose:
    # Not validated, as the hypotheses in app/api/replies.py.
    return schemas.SmoothedPose.model_construct(
        entry=pose.entry,
        confidence=round(pose.confidence, 4),
        **joint_fields(pose.points_3d, pose.points_2d, form),
    )


def _action(action: RecognisedAction) -> schemas.Action:
    return schemas.Action(label=action.label, probability=round(action.probability, 4))


def _event(event: Event) -> schemas.Event:
    return schemas.Event(
        event=event.event,
        track_id=event.track_id,
        state=event.state,
        timestamp=round(event.timestamp, SECOND_DIGITS),
        probability=round(event.probability, 4),
        zones=list(event.zones),
        caller_track_id=event.caller_track_id,
    )


def _track(track: TrackSummary) -> schemas.TrackSummary:
    action = track.action()
    return schemas.TrackSummary(
        track_id=track.track_id,
        first_timestamp=round(track.first_timestamp, SECOND_DIGITS),
        last_timestamp=round(track.last_timestamp, SECOND_DIGITS),
        frames=track.frames,
        action=_action(action) if action else None,
        postures=[
            schemas.PostureTime(label=label, seconds=round(seconds, SECOND_DIGITS))
            for label, seconds in track.postures()
        ],
    )
