"""Camera sessions: the frames of fixed cameras, in order, and the people in them over time."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Path, Request
from fastapi.responses import Response
from pydantic import ValidationError

from app.api.replies import ReplyForm
from app.api.tracking_replies import camera_reply, track_reply, zones_from
from app.api.tracking_schemas import CameraConfiguration, CameraList, CameraState, TrackResponse
from app.http.identity import CAMERA_PATTERN
from app.http.problems import ProblemError
from app.http.request_context import note_header
from app.messages import expected_and_got
from app.routes.auth import Caller, RequireKey
from app.routes.forms import CheckQuery
from app.routes.openapi import documented
from app.routes.uploads import (
    DOCUMENTED_TRACK_UPLOAD,
    EvidenceQuery,
    HypothesisCount,
    JointsQuery,
    KeypointSetQuery,
    ObservedSetQuery,
    SilhouettesQuery,
    TrackUploadForm,
)
from app.scheduling.job import Job
from app.serving.runtime import run_frame, runtime_of
from app.tracking.results import SessionState
from app.tracking.sessions import CameraKey, TooManyCamerasError
from index.parameters import DEFAULT_HYPOTHESES
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

    def work(job: Job) -> bytes:
        tracked = sessions.process(camera, estimator, upload, timestamp, n, job, evidence)
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
    summary="The cameras",
    responses=documented(401),
)
async def list_cameras(request: Request, caller: Caller) -> CameraList:
    """List the caller's cameras that have a session or zones, ordered by name."""
    sessions = runtime_of(request).sessions.summaries(caller)
    return CameraList(cameras=[camera_reply(session) for session in sessions])


@router.get(
    "/{camera_id}",
    operation_id="get_camera",
    summary="One camera",
    responses=documented(401, 404, 422),
)
async def get_camera(request: Request, camera: Camera) -> CameraState:
    """Get the zones of a camera and the state of its session."""
    try:
        return camera_reply(runtime_of(request).sessions.summary(camera))
    except KeyError:
        raise _unknown(camera) from None


# Parsed here, so that whatever is wrong is told in one sentence, and after the key is checked.
async def _read_configuration(request: Request) -> CameraConfiguration:
    try:
        return CameraConfiguration.model_validate_json(await request.body())
    except ValidationError as error:
        first = error.errors()[0]
        if first["type"] == "json_invalid" or not first["loc"]:
            raise ProblemError(
                422, 'expected a JSON object such as {"zones": []}, got something else'
            ) from None
        steps = (f"[{step}]" if isinstance(step, int) else f".{step}" for step in first["loc"])
        place = "".join(steps)[1:]
        raise ProblemError(422, f"{place}: {expected_and_got(first)}", field=place) from None


@router.put(
    "/{camera_id}",
    operation_id="configure_camera",
    summary="Set the zones of a camera",
    responses=documented(401, 422),
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {
                "application/json": {"schema": {"$ref": "#/components/schemas/CameraConfiguration"}}
            },
        }
    },
)
async def configure_camera(
    request: Request,
    camera: Camera,
    configuration: Annotated[CameraConfiguration, Depends(_read_configuration)],
) -> CameraState:
    """Set the zones of a camera, whether or not it has sent frames.

    From its next frame on, persons and events name those in which they are. They replace the ones
    before, and outlive the camera's session, but not the service: set them again after a restart.
    """
    try:
        zones = zones_from(configuration.zones)
        return camera_reply(runtime_of(request).sessions.configure(camera, zones))
    except TooManyCamerasError as error:
        raise ProblemError(422, f"zones: {error}", field="zones") from None


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
    """Forget a camera's zones and end its session: its next frame starts afresh.

    To remove the zones alone, set an empty list.
    """
    try:
        runtime_of(request).sessions.forget(camera)
    except KeyError:
        raise _unknown(camera) from None


def _unknown(camera: CameraKey) -> ProblemError:
    return ProblemError(
        404, f"expected a camera that has sent frames of late or has zones, got {camera.camera_id}"
    )
