"""Videos, answered line by line while they are processed."""

import asyncio
import shutil
from collections.abc import AsyncIterator
from contextlib import aclosing, asynccontextmanager
from typing import IO, Annotated, NamedTuple

from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import StreamingResponse
from starlette.datastructures import UploadFile
from starlette.types import Receive, Scope, Send

from app.api import tracking_schemas as schemas
from app.api.replies import tracked_fields
from app.camera import CameraSession
from app.decoding import Frame
from app.decoding.videos import NextFrame, new_file, open_video
from app.film import VideoRun
from app.http.errors import invalid
from app.http.identity import RequireKey, identity_of
from app.http.routing import request_state
from app.routes.openapi import BINARY, documented, documented_form, documented_json
from app.routes.queries import GivenOnce, SequenceQuery, estimator_for, hypotheses_of
from app.routes.uploads import MULTIPART, check_fields, form_of, has_type, unsupported_body
from app.serving import runtime_of
from app.tracking.results import TrackedFrame

PATH = "/sequence"
_BODY_TYPES = ("video/", "image/gif", "multipart/x-mixed-replace", "application/octet-stream")

router = APIRouter(tags=["cameras"], dependencies=[RequireKey, GivenOnce])


class LineStream(StreamingResponse):
    """Lines of JSON, which are no longer made once the client has gone."""

    media_type = "application/x-ndjson"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async with aclosing(self.body_iterator):  # type: ignore[type-var]
            await super().__call__(scope, receive, send)


@asynccontextmanager
async def _received(request: Request) -> AsyncIterator[IO[bytes]]:
    """Receive the video of a request into a file."""
    with new_file() as file:
        if any(has_type(request, start) for start in _BODY_TYPES):
            async for chunk in request.stream():
                file.write(chunk)
        elif has_type(request, MULTIPART):
            async with form_of(request) as form:
                check_fields(form, schemas.VideoUpload.model_fields)
                part = form.get("video")
                if not isinstance(part, UploadFile):
                    raise invalid("video", "expected a file, got none")
                await asyncio.to_thread(shutil.copyfileobj, part.file, file)
        else:
            raise unsupported_body(request, f"{MULTIPART}, video/* or image/gif")
        yield file


class _OpenVideo(NamedTuple):
    """A video whose first frame could be read."""

    first: Frame
    next_frame: NextFrame


async def _open(
    request: Request, query: Annotated[SequenceQuery, Query()]
) -> AsyncIterator[_OpenVideo]:
    """Receive and open the video; it is closed once the request has been answered."""
    runtime, caller = runtime_of(request), identity_of(request.scope).caller
    runtime.ready_estimator()
    runtime.check_sequence(caller)  # Before the upload, which would be in vain.
    settings = runtime.settings
    async with _received(request) as file:
        with runtime.sequence(caller):
            async with open_video(
                file, query.stride, settings.max_pixels, settings.sequence_timeout_s
            ) as next_frame:
                first = await next_frame()
                assert first is not None
                yield _OpenVideo(first, next_frame)


@router.post(
    PATH,
    operation_id="analyse_sequence",
    summary="The people of a video, over time",
    response_class=LineStream,
    responses={
        200: {
            "description": "A line of JSON for each frame as soon as it is done, and a last line "
            "of type `end`, as `application/x-ndjson`; with `Accept: application/json`, the same "
            "as one document.",
            "model": schemas.SequenceLine,
            "content": {**BINARY, **documented_json(schemas.SequenceResponse)},
        },
        **documented(400, 401, 403, 408, 413, 415, 422, 503),
    },
    openapi_extra=documented_form(
        schemas.VideoUpload,
        "A form, or a video alone: as `application/octet-stream`, `video/mp4` or any other type of "
        "video, `image/gif`, or `multipart/x-mixed-replace`.",
    ),
)
async def analyse_sequence(
    request: Request,
    query: Annotated[SequenceQuery, Query()],
    video: Annotated[_OpenVideo, Depends(_open)],
) -> LineStream:
    """Track the people of a video of a fixed camera.

    The reply comes line by line while the video is processed: one line of type `frame` for each
    frame, like the reply of `/cameras/{camera_id}/frames`, and a last line of type `end` with
    tracks, events and the reason why the reply ends there. With `Accept: application/json`, and no
    other type in it, the reply is one document of both. Live frames of cameras take their turn in
    between.
    """
    runtime = runtime_of(request)
    most = runtime.settings.max_sequence_frames
    if query.max_frames is not None and query.max_frames > most:
        raise invalid("max_frames", f"expected at most {most}, got {query.max_frames}")
    estimator, metrics = estimator_for(runtime.ready_estimator(), query), runtime.metrics
    run = VideoRun(
        session=CameraSession(estimator),
        executor=runtime.executor,
        caller=identity_of(request.scope).caller,
        kind=PATH,
        n=hypotheses_of(query),
        evidence=query.evidence,
        optics=query.optics,
        max_frames=query.max_frames or most,
        timeout_s=runtime.settings.sequence_timeout_s,
    )

    def write(tracked: TrackedFrame, number: int) -> bytes:
        metrics.observe_frame(tracked)
        fields = tracked_fields(tracked, estimator.index, query.form)
        frame = schemas.SequenceFrame(type="frame", video_frame=number, **fields)
        return frame.model_dump_json().encode()

    def is_ending() -> bool:
        return request_state(request.scope).is_ending

    is_document = request.headers.get("accept") == "application/json"

    async def parts() -> AsyncIterator[bytes]:
        # A document is written while it grows: none is kept in memory.
        before, after, between = (b"", b"", b",") if is_document else (b"", b"\n", b"")
        if is_document:
            yield b'{"frames":['
        async with aclosing(run.lines(*video, write, is_ending)) as frames:
            async for line in frames:
                yield before + line + after
                before = between
        end = _end_of(run).model_dump_json().encode()
        yield b'],"end":' + end + b"}" if is_document else end + after

    return LineStream(parts(), media_type="application/json" if is_document else None)


def _end_of(run: VideoRun) -> schemas.SequenceEnd:
    summary, end = run.summary, run.end
    assert end is not None
    return schemas.SequenceEnd.model_validate(
        {
            "type": "end",
            "reason": end.reason,
            "detail": end.detail,
            "frames": summary.frames,
            "damaged": summary.damaged,
            "tracks": [track for _, track in sorted(summary.tracks.items())],
            "events": summary.events,
        }
    )
