"""One video: its frames go through a camera session in order, until it ends with a summary."""

import asyncio
import logging
from collections.abc import AsyncGenerator, Callable, Hashable
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

from app.camera import CameraSession
from app.decoding import Frame
from app.decoding.videos import NextFrame, VideoError
from app.estimation.posture import PostureLabel
from app.estimation.results import Evidence
from app.estimation.upload import Upload, UploadError
from app.messages import SEARCH_FAILED
from app.scheduling.executor import Executor
from app.scheduling.job import ClientGoneError, DeadlineError, Job
from app.scheduling.queue import ShutdownError
from app.tracking.results import Event, RecognisedAction, TrackedFrame, TrackedPerson
from app.vision.optics import UNKNOWN_OPTICS, Optics
from index.search import SearchUnavailableError

VideoEndReason = Literal[
    "complete", "max_frames", "broken", "timeout", "shutdown", "unavailable", "failed"
]

log = logging.getLogger("app")


@dataclass(frozen=True)
class VideoEnd:
    """Why no further frame is processed; ``detail`` is the reason as a sentence."""

    reason: VideoEndReason
    detail: str


_SHUTDOWN = VideoEnd("shutdown", "the service is being stopped")


class VideoSummary:
    """Tracks and events over the frames of a video."""

    def __init__(self) -> None:
        self.frames = 0
        self.damaged = 0
        """Frames of which the video has lost data."""
        self.tracks: dict[int, TrackSummary] = {}
        self.events: list[Event] = []

    def add(self, frame: TrackedFrame) -> None:
        self.frames += 1
        self.damaged += "damaged" in frame.warnings
        self.events += frame.events
        for tracked in frame.persons:
            track = self.tracks.setdefault(
                tracked.track_id, TrackSummary(tracked.track_id, frame.timestamp, frame.timestamp)
            )
            track.add(tracked, frame.timestamp)


class PostureTime(NamedTuple):
    """How long a person was in a posture."""

    label: PostureLabel
    seconds: float


MAX_GAP_S = 2.0
"""A person unseen for longer is not assumed to keep a posture."""


@dataclass
class TrackSummary:
    """One person over the frames of a video in which they were seen; times in seconds."""

    track_id: int
    first_timestamp: float
    last_timestamp: float
    frames: int = 0
    _posture: PostureLabel | None = None
    _posture_s: dict[PostureLabel, float] = field(default_factory=dict)
    _actions: dict[str, float] = field(default_factory=dict)
    _frames_with_action: int = 0

    def add(self, tracked: TrackedPerson, timestamp: float) -> None:
        """Add the person's next frame; a posture lasts until then unless the gap is longer."""
        gap_s = timestamp - self.last_timestamp
        if self._posture is not None and gap_s <= MAX_GAP_S:
            self._posture_s[self._posture] = self._posture_s.get(self._posture, 0.0) + gap_s
        posture = tracked.posture
        self._posture = posture.label if posture else None
        if self._posture is not None:
            self._posture_s.setdefault(self._posture, 0.0)
        if tracked.action is not None:
            label, probability = tracked.action.label, tracked.action.probability
            self._actions[label] = self._actions.get(label, 0.0) + probability
            self._frames_with_action += 1
        self.last_timestamp = timestamp
        self.frames += 1

    @property
    def postures(self) -> list[PostureTime]:
        """Each posture and its seconds, the longest first."""
        times = [PostureTime(label, seconds) for label, seconds in self._posture_s.items()]
        return sorted(times, key=lambda time: -time.seconds)

    @property
    def action(self) -> RecognisedAction | None:
        """The action with the largest sum of probabilities, and its mean probability."""
        if not self._actions:
            return None
        label = max(self._actions, key=lambda name: self._actions[name])
        return RecognisedAction(label, self._actions[label] / self._frames_with_action)


@dataclass(kw_only=True)
class VideoRun:
    """Tracks the people of a video, in a new session, in turn with the frames of other callers.

    ``caller`` and ``kind`` are as in :meth:`app.scheduling.executor.Executor.run`, ``n`` and
    ``evidence`` as in :meth:`app.camera.CameraSession.process`. At most ``max_frames`` are
    processed, for ``timeout_s`` from now on. Without optics, the video's own pixel aspect is used.

    ``summary`` is that of the frames so far; ``end`` is None until there are no more.
    """

    session: CameraSession
    executor: Executor
    caller: Hashable
    kind: str
    n: int
    evidence: Evidence
    max_frames: int
    timeout_s: float
    optics: Optics = UNKNOWN_OPTICS
    summary: VideoSummary = field(default_factory=VideoSummary, init=False)
    end: VideoEnd | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self._deadline = asyncio.get_running_loop().time() + self.timeout_s

    async def lines(
        self,
        first: Frame,
        next_frame: NextFrame,
        write: Callable[[TrackedFrame, int], bytes],
        is_ending: Callable[[], bool],
    ) -> AsyncGenerator[bytes, None]:
        """Yield a line for each frame; afterwards, :attr:`end` says why there are no more.

        The first frame has been read already. ``write`` makes the line of a frame and its number in
        the video, on the executor's thread; ``is_ending`` says whether the service is being
        stopped.
        """
        frame: Frame | None = first
        try:
            while frame is not None:
                if is_ending():
                    end = _SHUTDOWN
                    break
                if self.summary.frames == self.max_frames:
                    end = VideoEnd("max_frames", f"there are more than {self.max_frames} frames")
                    break
                async with asyncio.timeout_at(self._deadline):
                    line = await self._process(frame, write)
                yield line
                async with asyncio.timeout_at(self._deadline):
                    frame = await next_frame()
            else:
                detail = f"the video ended after {self.summary.frames} frames"
                if self.summary.damaged:
                    detail += f", {self.summary.damaged} of them damaged"
                end = VideoEnd("complete", detail)
        except (TimeoutError, DeadlineError) as error:
            late = f"the video took longer than {self.timeout_s:g} seconds"
            end = VideoEnd("timeout", str(error) or late)
        except (VideoError, UploadError) as error:
            end = VideoEnd("broken", str(error))
        except SearchUnavailableError:
            end = VideoEnd("unavailable", SEARCH_FAILED)
        except (ShutdownError, ClientGoneError):
            # If the client had gone, this would have been cancelled: the executor shuts down.
            end = _SHUTDOWN
        except Exception:
            log.exception("a video failed")
            end = VideoEnd("failed", "an error of the service; its log says more")
        self.summary.events += self.session.unconfirmed()
        self.end = end

    async def _process(self, frame: Frame, write: Callable[[TrackedFrame, int], bytes]) -> bytes:
        def work(job: Job) -> tuple[TrackedFrame, bytes]:
            own = Optics(pixel_aspect=frame.pixel_aspect)
            upload = Upload(frame.pixels, optics=self.optics.or_else(own))
            tracked = self.session.process(upload, frame.timestamp, self.n, job, self.evidence)
            if frame.damaged:
                tracked = replace(tracked, warnings=(*tracked.warnings, "damaged"))
            return tracked, write(tracked, frame.number)

        tracked, line = await self.executor.run(
            work, _until_cancelled, caller=self.caller, kind=self.kind, unbounded_wait=True
        )
        self.summary.add(tracked)
        return line


async def _until_cancelled() -> None:
    """Wait: if the client hangs up, the whole answer is cancelled."""
    await asyncio.Event().wait()
