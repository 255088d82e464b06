"""The work on a video: its frames take their turn among all others, and each becomes a line."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass

from app.api.replies import ReplyForm, sequence_end_reply, sequence_frame_reply, sequence_line
from app.api.tracking_schemas import SequenceEndReason
from app.estimation.results import Evidence
from app.estimation.upload import Upload
from app.http.errors import SEARCH_FAILED
from app.scheduling.job import DeadlineError, Job
from app.scheduling.queue import Sender
from app.serving.runtime import Runtime
from app.tracking.results import TrackedFrame
from app.tracking.session import CameraSession
from app.tracking.summary import SequenceSummary
from app.video.reader import VideoError, VideoFrame, VideoReader
from index.search import UnavailableError


@dataclass(frozen=True)
class OpenVideo:
    """A video whose first frame could be read."""

    reader: VideoReader
    first: VideoFrame


class SequenceRun:
    """The work on the frames of one video, one after the other.

    Parameters
    ----------
    runtime : Runtime
    sender : Sender
        The source of its frames, for the queue.
    n : int
        Number of hypotheses per person.
    evidence : str
        ``photograph`` or ``silhouette``.
    form : ReplyForm
    max_frames : int
        Number of frames after which the work ends.
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

    async def lines(self, video: OpenVideo, is_ending: Callable[[], bool]) -> AsyncIterator[bytes]:
        """Yield a line for each frame, and a last one that says why it is the last.

        Parameters
        ----------
        video : OpenVideo
        is_ending : callable
            Returns whether the service is being stopped.
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
        """Work on a frame once a thread is free, and return its line."""

        def work(job: Job) -> tuple[TrackedFrame, bytes]:
            tracked = self._session.process(
                Upload(frame.pixels), frame.timestamp, self._n, job, self._evidence
            )
            self._runtime.metrics.observe_stages(tracked.timings_ms)
            self._runtime.metrics.observe_persons(person.person for person in tracked.persons)
            reply = sequence_frame_reply(tracked, frame.number, self._estimator.index, self._form)
            return tracked, sequence_line(reply)

        tracked, line = await self._runtime.executor.run(
            work, _until_cancelled, sender=self._sender, kind="sequence", unbounded_wait=True
        )
        self._summary.add(tracked)
        return line

    def _end(self, reason: SequenceEndReason, detail: str) -> bytes:
        return sequence_line(sequence_end_reply(self._summary, reason, detail))


async def _until_cancelled() -> None:
    """Wait: if the client disconnects, the whole answer is cancelled."""
    await asyncio.Event().wait()
