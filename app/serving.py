"""The running service: the state that its routes share, and what it loads at its start.

The index is loaded once the service answers probes; with Milvus, also later versions of it.
"""

import asyncio
import logging
from collections.abc import Callable, Hashable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, TypeVar, cast

import anyio
from fastapi import Depends, Request
from pydantic import TypeAdapter, ValidationError

from app import VERSION
from app.cameras import CameraSessions
from app.configuration import CameraConfiguration, CameraId
from app.decoding.pictures import Workers
from app.http.errors import overloaded
from app.http.identity import Caller, identity_of
from app.http.metrics import Metrics
from app.messages import located
from app.networks.shipped import NetworkError
from app.photograph import Estimator, load_estimator
from app.scheduling.executor import Executor
from app.scheduling.job import Job
from app.scheduling.process import (
    freeze_loaded_objects,
    lower_thread_priority,
    native_lines_logged,
    trim_heap,
)
from app.settings import Settings, SettingsError
from index.artefact import ArtefactError
from index.search import SearchUnavailableError
from index.store import PoseIndex

log = logging.getLogger("app")

T = TypeVar("T")


@dataclass
class Runtime:
    """State of an application.

    ``sequences`` has the callers of the videos that are worked on. Until the index is loaded,
    ``estimator`` is None, ``not_ready_because`` tells the operator why, and ``loading`` is whether
    loading goes on or will be tried again; ``attempted`` is set once it has succeeded or failed.
    """

    settings: Settings
    executor: Executor
    workers: Workers
    metrics: Metrics
    sessions: CameraSessions
    sequences: list[Caller] = field(default_factory=list)
    estimator: Estimator | None = None
    not_ready_because: str = "the index is being loaded"
    loading: bool = True
    attempted: asyncio.Event = field(default_factory=asyncio.Event)

    def ready_estimator(self) -> Estimator:
        """Return the estimator, or raise a problem with status 503."""
        if self.estimator is None:
            # Retrying does not help once loading has failed.
            retry_after_s = 2 if self.loading else None
            raise overloaded(self.not_ready_because, "not_ready", retry_after_s)
        return self.estimator

    def check_sequence(self, caller: Caller) -> None:
        """Raise a 503 if no further video of this caller, who leaves others a place, is taken."""
        most = self.settings.max_sequences
        own = max(1, most - 1)
        if len(self.sequences) >= most:
            allowed = f"{most} videos at once"
        elif self.sequences.count(caller) >= own:
            allowed = f"{own} of one caller's videos at once"
        else:
            return
        sentence = f"expected at most {allowed}; try again later"
        raise overloaded(sentence, "too_many_sequences", 10)

    @contextmanager
    def sequence(self, caller: Caller) -> Iterator[None]:
        """Count a video while it is worked on; raise a 503 if there are too many."""
        self.check_sequence(caller)
        self.sequences.append(caller)
        try:
            yield
        finally:
            self.sequences.remove(caller)


def runtime_of(request: Request) -> Runtime:
    """The state of the application; a dependency would cost time on every frame."""
    return cast(Runtime, request.app.state.runtime)


# Dependencies are coroutines although they wait for nothing: FastAPI runs other functions in a
# thread, which takes milliseconds while frames keep the cores busy.
async def _ready_estimator(request: Request) -> Estimator:
    return runtime_of(request).ready_estimator()


EstimatorDep = Annotated[Estimator, Depends(_ready_estimator)]


async def run_frame(request: Request, work: Callable[[Job], T], *, kind: Hashable) -> T:
    """Work on a request's frame in a thread; see :meth:`app.scheduling.executor.Executor.run`.

    The body has been read. ``kind`` is that of the content; with the route, it determines how long
    the work takes.
    """

    async def until_gone() -> None:
        # After the body, only the disconnect can follow.
        while (await request.receive())["type"] != "http.disconnect":
            pass

    identity = identity_of(request.scope)
    return await runtime_of(request).executor.run(
        work,
        until_gone,
        caller=identity.caller,
        kind=(request.scope["route"].path, kind),
        camera=identity.stream,
    )


POLL_S = 3.0  # Interval at which Milvus is asked for the published index.


async def keep_index_loaded(
    runtime: Runtime, read_index: Callable[[], PoseIndex] | None = None
) -> None:
    """Get the service ready; with Milvus, serve the index that is published there, always."""
    if runtime.settings.milvus is None:
        # In a thread of the executor, whose low priority the networks' own threads inherit.
        loading = runtime.executor.submit(lambda: _prepare_estimator(runtime, read_index))
        await _become_ready_or_say_why(runtime, asyncio.wrap_future(loading))
        runtime.loading = False
        return
    # Milvus may take long to answer, and frames need the executor's threads.
    thread = ThreadPoolExecutor(1, "index", initializer=lower_thread_priority)
    try:
        while True:
            polling = asyncio.wrap_future(thread.submit(_published_estimator, runtime))
            await _become_ready_or_say_why(runtime, polling)
            await anyio.sleep(POLL_S)
    finally:
        thread.shutdown(wait=False, cancel_futures=True)


def become_ready(runtime: Runtime, estimator: Estimator) -> None:
    """Serve with an estimator from now on; current requests keep theirs."""
    estimator = estimator.with_workers(runtime.workers)
    runtime.metrics.observe_index(estimator.index.name, estimator.index.version)
    runtime.estimator = estimator
    runtime.sessions.end_others(estimator)
    index, revision = estimator.index, runtime.settings.revision
    ready = "ready: version %s (%s), index %s with %d entries"
    log.info(ready, VERSION, revision, index.version, len(index))


def _prepare_estimator(runtime: Runtime, read_index: Callable[[], PoseIndex] | None) -> Estimator:
    with native_lines_logged(log):
        estimator = load_estimator(runtime.settings, read_index)
    freeze_loaded_objects()
    trim_heap()
    return estimator


def _published_estimator(runtime: Runtime) -> Estimator | None:
    """Load the index that is published in Milvus; None if it is served already."""
    from index.milvus import load_published

    before, settings = runtime.estimator, runtime.settings
    assert settings.milvus is not None
    known = before.index.version if before else ""
    index = load_published(settings.milvus, settings.index, known)
    if index is None:
        return None
    return before.with_index(index) if before else _prepare_estimator(runtime, lambda: index)


async def _become_ready_or_say_why(
    runtime: Runtime, loading: asyncio.Future[Estimator] | asyncio.Future[Estimator | None]
) -> None:
    """Wait for an estimator; without it, the service goes on as it is and says why."""
    state = "not ready" if runtime.estimator is None else "still serving the index before"
    try:
        estimator = await loading
    except (ArtefactError, NetworkError, SearchUnavailableError) as error:
        if runtime.not_ready_because != str(error):
            log.error("%s: %s", state, error)
        runtime.not_ready_because = str(error)
    except Exception:
        # A process that ended here would be restarted for ever, and probes would not learn why.
        runtime.not_ready_because = "the index could not be loaded; the log says more"
        log.exception(state)
    else:
        runtime.not_ready_because = ""
        if estimator is not None:
            become_ready(runtime, estimator)
    runtime.attempted.set()


_CAMERAS = TypeAdapter(dict[CameraId, CameraConfiguration])


def read_cameras(path: Path | None) -> dict[str, CameraConfiguration]:
    """Read the settings of cameras by their names; none without a file.

    The file holds a JSON object: for each name, the body of ``PUT /cameras/{camera_id}``. Raises
    SettingsError if it cannot be read or does not fit.
    """
    if path is None:
        return {}
    try:
        return _CAMERAS.validate_json(path.read_text("utf-8-sig", errors="replace"))
    except OSError as error:
        reason = error.strerror or type(error).__name__
        sentence = f"expected a file of cameras, got {path}: {reason}"
    except ValidationError as error:
        sentence = f"{path}: " + ": ".join(filter(None, located(error)))
    raise SettingsError(f"POSE_CAMERAS_FILE: {sentence}")
