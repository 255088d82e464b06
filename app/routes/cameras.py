"""Camera sessions: the frames of fixed cameras, in order, and the people in them over time."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Path, Request
from fastapi.responses import Response

from app.auth import Caller, RequireKey
from app.cameras import CAMERA_PATTERN
from app.cancellation import CancellationToken
from app.errors import ProblemError, documented
from app.replies import ReplyForm
from app.request_context import note_header
from app.routes.forms import CheckQuery
from app.routes.uploads import (
    DEFAULT_HYPOTHESES,
    DOCUMENTED_TRACK_UPLOAD,
    EvidenceQuery,
    HypothesisCount,
    JointsQuery,
    KeypointSetQuery,
    ObservedSetQuery,
    SilhouettesQuery,
    TrackUploadForm,
)
from app.runtime import run_frame, runtime_of
from app.tracking.results import SessionState
from app.tracking.sessions import CameraKey
from app.tracking_replies import camera_reply, track_reply
from app.tracking_schemas import CameraList, CameraState, TrackResponse
from index.skeleton import KEYPOINT_SETS

router = APIRouter(prefix="/cameras", tags=["cameras"], dependencies=[RequireKey, CheckQuery])

SESSION_HEADER = "X-Session"

CameraId = Annotated[
    str,
    Path(
        pattern=CAMERA_PATTERN,
        description="Name of the camera, chosen by the caller; another caller's camera of the "
        "same name is another one.",
        examples=["yard-2"],
    ),
]


async def _camera_key(camera_id: CameraId, caller: Caller) -> CameraKey:
    return CameraKey(caller, camera_id)


Camera = Annotated[CameraKey, Depends(_camera_key)]


async def _session_header(request: Request, camera: Camera) -> None:
    """Tell the session's state with whatever answer; the work knows it better later."""
    _tell_session(request, "warm" if camera in runtime_of(request).sessions else "new")


def _tell_session(request: Request, state: SessionState) -> None:
    note_header(request.scope, SESSION_HEADER, state)


@router.post(
    "/{camera_id}/frames",
    operation_id="track_frame",
    summary="The people in the next frame of a camera, over time",
    response_model=TrackResponse,
    dependencies=[Depends(_session_header)],
    responses=documented(400, 401, 404, 408, 409, 413, 415, 422, 503),
    openapi_extra=DOCUMENTED_TRACK_UPLOAD,
)
async def track_frame(
    request: Request,
    camera: Camera,
    frame: TrackUploadForm,
    n: HypothesisCount = DEFAULT_HYPOTHESES,
    keypoints: KeypointSetQuery = "native",
    evidence: EvidenceQuery = "photograph",
    silhouettes: SilhouettesQuery = "none",
    joints: JointsQuery = "full",
    observed: ObservedSetQuery = "coco17",
) -> Response:
    """Track the people in the next frame of a fixed camera.

    Each has an identity, a pose smoothed over time and an action besides what `/pose` tells of the
    frame. Frames of one camera are worked on one after the other, in order of arrival; of those
    that wait, the newest is answered, older ones get a 503. The header `X-Session` says `new` where
    the camera starts afresh: with its first frame, after a pause, or when the service had to forget
    it or has moved over to another index.
    """
    runtime = runtime_of(request)
    if not runtime.settings.max_cameras:
        raise ProblemError(404, "this service keeps no camera sessions", reason="no_sessions")
    estimator, sessions = runtime.searching_estimator(), runtime.sessions
    form = ReplyForm(KEYPOINT_SETS[keypoints], silhouettes, joints, observed)
    upload, timestamp = frame

    def work(token: CancellationToken) -> bytes:
        tracked = sessions.process(camera, estimator, upload, timestamp, n, token.check, evidence)
        _tell_session(request, tracked.session)
        runtime.metrics.camera_frames.labels(tracked.session).inc()
        runtime.metrics.observe_stages(tracked.timings_ms)
        runtime.metrics.observe_persons(person.person for person in tracked.persons)
        reply = track_reply(tracked, camera.camera_id, estimator.index, form)
        return reply.model_dump_json().encode()

    # The first frame of a session takes longer.
    content = await run_frame(request, work, kind=(upload.given, camera in sessions))
    return Response(content, media_type="application/json")


@router.get(
    "",
    operation_id="list_cameras",
    summary="The camera sessions",
    responses=documented(401),
)
async def list_cameras(request: Request, caller: Caller) -> CameraList:
    """List the caller's camera sessions, ordered by name."""
    sessions = runtime_of(request).sessions.summaries(caller)
    return CameraList(cameras=[camera_reply(session) for session in sessions])


@router.get(
    "/{camera_id}",
    operation_id="get_camera",
    summary="One camera session",
    responses=documented(401, 404, 422),
)
async def get_camera(request: Request, camera: Camera) -> CameraState:
    """Get the state of a camera session."""
    try:
        return camera_reply(runtime_of(request).sessions.summary(camera))
    except KeyError:
        raise _unknown(camera) from None


@router.delete(
    "/{camera_id}",
    operation_id="forget_camera",
    summary="Forget a camera",
    status_code=204,
    # A JSON response would name a media type for a body that there is not.
    response_class=Response,
    responses=documented(401, 404, 422),
)
async def forget_camera(request: Request, camera: Camera) -> None:
    """End a camera session: its next frame starts afresh."""
    try:
        runtime_of(request).sessions.forget(camera)
    except KeyError:
        raise _unknown(camera) from None


def _unknown(camera: CameraKey) -> ProblemError:
    return ProblemError(
        404, f"expected a camera that has sent frames of late, got {camera.camera_id}"
    )
