"""Videos: answered line by line while they are worked on."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import AsyncIterator, Callable
from contextlib import aclosing, asynccontextmanager
from dataclasses import dataclass
from typing import IO, Annotated, Any

from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import StreamingResponse
from starlette.datastructures import UploadFile
from starlette.types import Message, Receive, Scope, Send

from app.api.replies import ReplyForm
from app.api.schemas import Evidence
from app.api.tracking_replies import sequence_end_reply, sequence_frame_reply, sequence_line
from app.api.tracking_schemas import SequenceEndReason, SequenceLine, VideoUpload
from app.estimation.upload import Upload
from app.http.identity import sender_of
from app.http.problems import SEARCH_FAILED, ProblemError, overloaded
from app.http.request_context import is_ending, note_rejection
from app.messages import WHOLE_NUMBER
from app.routes.auth import RequireKey
from app.routes.forms import CheckQuery, check_fields
from app.routes.openapi import documented
from app.routes.uploads import (
    EvidenceQuery,
    HypothesisCount,
    JointsQuery,
    KeypointSetQuery,
    is_multipart,
    is_video,
    unsupported_body,
)
from app.scheduling.job import DeadlineError, Job
from app.scheduling.queue import Sender
from app.serving.runtime import Runtime, runtime_of
from app.tracking.results import TrackedFrame
from app.tracking.session import CameraSession
from app.tracking.summary import SequenceSummary
from app.video.reader import VideoError, VideoFrame, VideoReader, new_file, open_video
from index.parameters import DEFAULT_HYPOTHESES
from index.search import UnavailableError
from index.skeleton import KEYPOINT_SETS

PATH = "/sequence"

router = APIRouter(tags=["cameras"], dependencies=[RequireKey, CheckQuery])

_LATER_S = 10
_UNREAD_S = 30.0
"""A client that reads nothing for this long is given up."""

StrideQuery = Annotated[
    int,
    Query(ge=1, le=1000, description="Every n-th frame is worked on.", examples=[2]),
    WHOLE_NUMBER,
]
MaxFramesQuery = Annotated[
    int | None,
    Query(
        ge=1,
        description="Frames that are worked on at most; by default, and at most, as many as the "
        "service allows.",
        examples=[500],
    ),
    WHOLE_NUMBER,
]

_DOCUMENTED: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "description": "A video may also be the body itself, as `video/mp4` or any other type of "
        "video.",
        "content": {
            "multipart/form-data": {"schema": {"$ref": "#/components/schemas/VideoUpload"}}
        },
    }
}


class LineStream(StreamingResponse):
    """Lines of JSON; given up if the client does not read them."""

    media_type = "application/x-ndjson"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer the request."""

        async def send_soon(message: Message) -> None:
            async with asyncio.timeout(_UNREAD_S):
                await send(message)

        async with aclosing(self.body_iterator):  # type: ignore[type-var]
            try:
                await super().__call__(scope, receive, send_soon)
            except TimeoutError:
                # The server closes the connection when the answer is not complete.
                note_rejection(scope, "client_gone")


@asynccontextmanager
async def _received(request: Request) -> AsyncIterator[IO[bytes]]:
    """Receive the video of a request into a file."""
    with new_file() as file:
        if is_video(request):
            async for chunk in request.stream():
                file.write(chunk)
        elif is_multipart(request):
            async with request.form() as form:
                check_fields(form, VideoUpload.model_fields)
                part = form.get("video")
                if not isinstance(part, UploadFile):
                    raise ProblemError(422, "video: expected a file, got none", field="video")
                await asyncio.to_thread(shutil.copyfileobj, part.file, file)
        else:
            raise unsupported_body(request, "multipart/form-data or video/*")
        yield file


@dataclass(frozen=True)
class _OpenVideo:
    """A video whose first frame could be read."""

    reader: VideoReader
    first: VideoFrame


async def _open(request: Request, stride: StrideQuery = 1) -> AsyncIterator[_OpenVideo]:
    """Receive and open the video; it is closed once the request has been answered."""
    runtime = runtime_of(request)
    runtime.searching_estimator()
    settings = runtime.settings
    if runtime.sequences >= settings.max_sequences:
        raise overloaded(
            f"expected at most {settings.max_sequences} videos at once; try again later",
            "too_many_sequences",
            _LATER_S,
        )
    runtime.sequences += 1
    try:
        async with (
            _received(request) as file,
            open_video(file, stride, settings.max_pixels, settings.sequence_timeout_s) as reader,
        ):
            first = await reader.next()
            assert first is not None
            yield _OpenVideo(reader, first)
    finally:
        runtime.sequences -= 1


@router.post(
    PATH,
    operation_id="analyse_sequence",
    summary="The people of a video, over time",
    response_class=LineStream,
    responses={
        200: {
            "description": "A line of JSON for each frame as soon as it is done, and a last line "
            "of type `end`; its type is always `application/x-ndjson`.",
            "model": SequenceLine,
            # openapi-python-client ignores lines of JSON.
            "content": {
                "application/octet-stream": {"schema": {"type": "string", "format": "binary"}}
            },
        },
        **documented(400, 401, 408, 413, 415, 422, 503),
    },
    openapi_extra=_DOCUMENTED,
)
async def analyse_sequence(
    request: Request,
    video: Annotated[_OpenVideo, Depends(_open)],
    max_frames: MaxFramesQuery = None,
    n: HypothesisCount = DEFAULT_HYPOTHESES,
    keypoints: KeypointSetQuery = "native",
    evidence: EvidenceQuery = "photograph",
    joints: JointsQuery = "full",
) -> LineStream:
    """Track the people of a video of a fixed camera.

    It is answered line by line while it is worked on: one line of type `frame` for each frame, as
    `/cameras/{camera_id}/frames` answers it, and a last line of type `end` with tracks and events,
    which says why it ends there. Live frames of cameras have their turn in between.
    """
    runtime = runtime_of(request)
    most = runtime.settings.max_sequence_frames
    if max_frames is not None and max_frames > most:
        raise ProblemError(
            422, f"max_frames: expected at most {most}, got {max_frames}", field="max_frames"
        )
    sequence = _Sequence(
        runtime,
        sender_of(request.scope, runtime.settings),
        n=n,
        evidence=evidence,
        form=ReplyForm(KEYPOINT_SETS[keypoints], joints=joints),
        max_frames=max_frames or most,
    )
    return LineStream(sequence.lines(video, lambda: is_ending(request.scope)))


class _Sequence:
    """Works on the frames of a video, one after the other.

    Parameters
    ----------
    runtime : Runtime
    sender : Sender
        Whose turn its frames take.
    n : int
    evidence : str
    form : ReplyForm
    max_frames : int
    """

    def __init__(
        self,
        runtime: Runtime,
        sender: Sender,
        *,
        n: int,
        evidence: Evidence,
        form: ReplyForm,
        max_frames: int,
    ) -> None:
        self._runtime, self._sender = runtime, sender
        self._n, self._evidence, self._form = n, evidence, form
        self._max_frames = max_frames
        self._estimator = runtime.ready_estimator()
        self._session = CameraSession(self._estimator)
        self._summary = SequenceSummary()
        self._timeout_s = runtime.settings.sequence_timeout_s
        self._deadline = asyncio.get_running_loop().time() + self._timeout_s

    async def lines(self, video: _OpenVideo, is_ending: Callable[[], bool]) -> AsyncIterator[bytes]:
        """Yield a line for each frame, and the last one.

        Parameters
        ----------
        video : _OpenVideo
        is_ending : callable
            Whether the service is being stopped.
        """
        frame: VideoFrame | None = video.first
        try:
            while frame is not None:
                if is_ending():
                    yield self._end("shutdown", "the service is being stopped")
                    return
                if self._summary.frames == self._max_frames:
                    yield self._end("max_frames", f"there are more than {self._max_frames} frames")
                    return
                async with asyncio.timeout_at(self._deadline):
                    line = await self._work_on(frame)
                yield line
                async with asyncio.timeout_at(self._deadline):
                    frame = await video.reader.next()
        except TimeoutError:
            yield self._end("timeout", f"the video took longer than {self._timeout_s:g} seconds")
        except DeadlineError as error:
            yield self._end("timeout", str(error))
        except VideoError as error:
            yield self._end("broken", str(error))
        except UnavailableError:
            yield self._end("unavailable", SEARCH_FAILED)
        else:
            yield self._end("complete", f"the video ended after {self._summary.frames} frames")

    async def _work_on(self, frame: VideoFrame) -> bytes:
        """Work on a frame once there is room for it, and return its line."""

        def work(job: Job) -> tuple[TrackedFrame, bytes]:
            tracked = self._session.process(
                Upload(frame.pixels), frame.timestamp, self._n, job, self._evidence
            )
            self._runtime.metrics.observe_stages(tracked.timings_ms)
            self._runtime.metrics.observe_persons(person.person for person in tracked.persons)
            reply = sequence_frame_reply(tracked, frame.number, self._estimator.index, self._form)
            return tracked, sequence_line(reply)

        tracked, line = await self._runtime.executor.run(
            work, _until_cancelled, sender=self._sender, kind=PATH, patient=True
        )
        self._summary.add(tracked)
        return line

    def _end(self, reason: SequenceEndReason, detail: str) -> bytes:
        return sequence_line(sequence_end_reply(self._summary, reason, detail))


async def _until_cancelled() -> None:
    """Wait: if the client hangs up, the whole answer is cancelled."""
    await asyncio.Event().wait()
