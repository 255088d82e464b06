"""Camera sessions: the frames of fixed cameras, in order, and the people in them over time."""

from codecs import BOM_UTF8
from typing import Annotated

from fastapi import APIRouter, Depends, Path, Query, Request
from fastapi.responses import Response
from pydantic import ValidationError
from starlette.types import Scope

from app.api import tracking_schemas as schemas
from app.api.pictures import encode_replay
from app.api.replies import camera_reply, replay_reply, tracked_fields
from app.cameras import CameraKey, CameraSessions, Wanted
from app.configuration import (
    CAMERA_PATTERN,
    MAX_CORNERS,
    MAX_NAME_CHARACTERS,
    MAX_ZONES,
    CameraConfiguration,
)
from app.http.errors import ProblemError, invalid
from app.http.identity import Identity, RequireKey, identity_of
from app.http.routing import request_state
from app.messages import located
from app.routes.openapi import BINARY, documented, documented_json
from app.routes.queries import GivenOnce, NoQuery, TrackQuery, estimator_for, hypotheses_of
from app.routes.uploads import DOCUMENTED_TRACK_UPLOAD, TrackUploadForm
from app.scheduling.job import Job
from app.serving import run_frame, runtime_of
from app.tracking.results import SessionState

router = APIRouter(prefix="/cameras", tags=["cameras"], dependencies=[RequireKey, GivenOnce])

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


def _owner(identity: Identity) -> int:
    """Return the owner of a caller's cameras; without API keys, all callers are the same owner."""
    return identity.caller.key or 0


def count_dropped(sessions: CameraSessions, scope: Scope, reason: str) -> None:
    """Count a refused request for the camera whose frame it contained, if any."""
    identity = identity_of(scope)
    stream = identity.stream
    # The header X-Camera-ID names a camera on other routes, too.
    is_frame = scope["method"] == "POST" and scope["path"].startswith(f"{router.prefix}/")
    if stream is not None and is_frame and identity.is_authorised:
        sessions.count_dropped(CameraKey(_owner(identity), stream.camera), reason)


async def _camera_key(request: Request, camera_id: CameraId) -> CameraKey:
    return CameraKey(_owner(identity_of(request.scope)), camera_id)


Camera = Annotated[CameraKey, Depends(_camera_key)]


async def _session_header(request: Request, camera: Camera) -> None:
    """Add the state of the session to every reply; the work corrects it later."""
    _set_session_header(request, "warm" if camera in runtime_of(request).sessions else "new")


def _set_session_header(request: Request, state: SessionState) -> None:
    request_state(request.scope).headers[SESSION_HEADER] = state


@router.post(
    "/{camera_id}/frames",
    operation_id="track_frame",
    summary="The people in the next frame of a camera, over time",
    response_model=schemas.TrackResponse,
    dependencies=[Depends(_session_header)],
    responses=documented(400, 401, 403, 404, 408, 409, 413, 415, 422, 503),
    openapi_extra=DOCUMENTED_TRACK_UPLOAD,
)
async def track_frame(
    request: Request,
    camera: Camera,
    frame: TrackUploadForm,
    query: Annotated[TrackQuery, Query()],
) -> Response:
    """Track the people in the next frame of a fixed camera.

    In addition to the reply of `/pose`, each person has an identity, a pose smoothed over time and
    an action. Frames of one camera are processed one after the other, in order of arrival. Only the
    newest waiting frame is kept; older ones get a 503. The header `X-Session` is `new` if the
    camera starts afresh: with its first frame, after a pause, or after the service had to forget it
    or has switched to another index.
    """
    runtime = runtime_of(request)
    runtime.sessions.check_kept()
    estimator, sessions = estimator_for(runtime.ready_estimator(), query), runtime.sessions
    upload, milliseconds = query.of(frame.upload), query.timestamp_ms
    seconds = None if milliseconds is None else milliseconds / 1000
    given = [time for time in (frame.timestamp, query.timestamp, seconds) if time is not None]
    if len(given) > 1:
        raise invalid("timestamp", "expected a form field or a query parameter, got both")
    timestamp = given[0] if given else None

    def work(job: Job) -> bytes:
        drawn = query.silhouettes != "none"
        wanted = Wanted(hypotheses_of(query), query.evidence, drawn)
        tracked = sessions.process(camera, estimator, upload, timestamp, job, wanted)
        _set_session_header(request, tracked.session)
        runtime.metrics.camera_frames.labels(tracked.session).inc()
        runtime.metrics.observe_events(tracked.events)
        runtime.metrics.observe_frame(tracked)
        fields = tracked_fields(tracked, estimator.index, query.form)
        reply = schemas.TrackResponse(camera_id=camera.camera_id, **fields)
        return reply.model_dump_json().encode()

    # The first frame of a session takes longer.
    content = await run_frame(request, work, kind=(upload.given, camera in sessions))
    return Response(content, media_type="application/json")


@router.get(
    "",
    operation_id="list_cameras",
    summary="The cameras",
    dependencies=[NoQuery],
    responses=documented(401),
)
async def list_cameras(request: Request) -> schemas.CameraList:
    """List the caller's cameras that have a session or a configuration, ordered by name."""
    sessions = runtime_of(request).sessions.summaries(_owner(identity_of(request.scope)))
    return schemas.CameraList(cameras=[camera_reply(session) for session in sessions])


@router.get(
    "/{camera_id}",
    operation_id="get_camera",
    summary="One camera",
    dependencies=[NoQuery],
    responses=documented(401, 404, 422),
)
async def get_camera(request: Request, camera: Camera) -> schemas.CameraState:
    """Get the configuration of a camera and the state of its session."""
    return camera_reply(runtime_of(request).sessions.summary(camera))


@router.get(
    "/{camera_id}/events",
    operation_id="list_camera_events",
    summary="The latest events of a camera",
    dependencies=[NoQuery],
    responses=documented(401, 404, 422),
)
async def list_camera_events(request: Request, camera: Camera) -> schemas.CameraEvents:
    """List the last hundred events of a camera, the newest last.

    They are kept as long as the camera has a session or a configuration.
    """
    events = runtime_of(request).sessions.events(camera)
    return schemas.CameraEvents.model_validate({"camera_id": camera.camera_id, "events": events})


@router.get(
    "/{camera_id}/events/{event_id}/replay",
    operation_id="replay_event",
    summary="What was seen of an event, without a photograph",
    dependencies=[NoQuery],
    response_class=Response,
    responses={
        200: {
            "description": "An animated WebP image, `image/webp`; with `Accept: application/json`, "
            "what it draws.",
            "content": {**BINARY, **documented_json(schemas.EventReplay)},
        },
        **documented(401, 404, 422, 503),
    },
)
async def replay_event(request: Request, camera: Camera, event_id: str) -> Response:
    """Draw the outlines of the person of an event, from three seconds before to three after.

    Silhouette, skeleton and box are drawn on an empty ground with the camera's zones; of no frame
    is a pixel kept. Until the three seconds have passed, it has what there is so far. It is kept
    as long as `events` lists the event.
    """
    event, zones = runtime_of(request).sessions.replay(camera, event_id)
    if request.headers.get("accept") == "application/json":
        reply = schemas.EventReplay.model_validate(replay_reply(camera.camera_id, event, zones))
        return Response(reply.model_dump_json(), media_type="application/json")
    content = await run_frame(request, lambda _: encode_replay(event, zones), kind="replay")
    return Response(content, media_type="image/webp")


# The configuration is parsed here, after the key is checked, so that any error is one sentence.
async def _read_configuration(request: Request) -> CameraConfiguration:
    body = await request.body()
    # All corners of all zones, and commas in their names. They are counted before they are parsed,
    # which would keep all other clients waiting.
    values = MAX_ZONES * (MAX_CORNERS + MAX_NAME_CHARACTERS)
    if (count := body.count(b",")) > 2 * values:
        most = f"at most {MAX_ZONES} zones of {MAX_CORNERS} corners"
        raise invalid("zones", f"expected {most}, got {count} values")
    try:
        return CameraConfiguration.model_validate_json(body.removeprefix(BOM_UTF8))
    except ValidationError as error:
        place, sentence = located(error)
        detail = ": ".join(filter(None, (place, sentence)))
        raise ProblemError(422, detail, field=place or None) from None


@router.put(
    "/{camera_id}",
    operation_id="configure_camera",
    summary="Configure a camera",
    dependencies=[NoQuery],
    responses=documented(401, 403, 404, 408, 409, 413, 422, 503),
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": documented_json(CameraConfiguration),
        }
    },
)
async def configure_camera(
    request: Request,
    camera: Camera,
    configuration: Annotated[CameraConfiguration, Depends(_read_configuration)],
) -> schemas.CameraState:
    """Set zones, optics and events of a camera, whether or not it has sent frames.

    From the next frame on, persons and events name the zones they are in. A new configuration
    replaces the whole previous one and, for this caller, the one in the service's file. It
    outlives the camera's session but not the service: to keep it across restarts, put it in the
    file. A caller may configure as many cameras as there may be sessions; beyond that, one that has
    sent no frame is forgotten for the new one.
    """
    return camera_reply(runtime_of(request).sessions.configure(camera, configuration))


@router.delete(
    "/{camera_id}",
    operation_id="forget_camera",
    summary="Forget a camera",
    dependencies=[NoQuery],
    status_code=204,
    # A JSON response would name the media type of a body that does not exist.
    response_class=Response,
    responses=documented(401, 404, 422),
)
async def forget_camera(request: Request, camera: Camera) -> None:
    """Forget a camera's configuration and events and end its session: its next frame starts afresh.

    A configuration in the service's file applies again. To remove only the zones, set an empty
    list.
    """
    runtime_of(request).sessions.forget(camera)
