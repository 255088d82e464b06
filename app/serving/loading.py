"""Loads the index once the service answers probes, and follows an alias in Milvus."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated, TypeVar

import anyio
from pydantic import StringConstraints, TypeAdapter, ValidationError

from app.api.replies import settings_from
from app.api.tracking_schemas import CameraConfiguration
from app.cameras import CameraSettings
from app.http.identity import CAMERA_PATTERN
from app.messages import located
from app.photograph import Estimator, load_models
from app.scheduling.process import (
    freeze_loaded_objects,
    lower_thread_priority,
    native_lines_logged,
    trim_heap,
)
from app.serving.milvus import MissingPackageError, RemoteIndex, check_milvus_package
from app.serving.runtime import VERSION, Runtime
from app.settings import Settings, SettingsError
from app.vision.tflite import NetworkError
from index.artefact import load_index
from index.files import ArtefactError
from index.milvus_address import MilvusAddress
from index.search import UnavailableError
from index.store import PoseIndex

_CAMERAS = TypeAdapter(
    dict[Annotated[str, StringConstraints(pattern=CAMERA_PATTERN)], CameraConfiguration]
)


def read_cameras(path: Path | None) -> dict[str, CameraSettings]:
    """Read the settings of cameras by their names; none without a file.

    Parameters
    ----------
    path : Path or None
        A JSON object: for each name, the body of ``PUT /cameras/{camera_id}``.

    Raises
    ------
    SettingsError
        If the file cannot be read or does not fit; the message is one sentence.
    """
    if path is None:
        return {}
    try:
        cameras = _CAMERAS.validate_json(path.read_text(errors="replace"))
    except OSError as error:
        reason = error.strerror or type(error).__name__
        sentence = f"expected a file of cameras, got {path}: {reason}"
    except ValidationError as error:
        first = error.errors()[0]
        place, problem = located(first)
        sentence = f"{path}: {place}: {problem}" if place else f"{path}: {problem}"
    else:
        return {name: settings_from(camera) for name, camera in cameras.items()}
    raise SettingsError(f"POSE_CAMERAS_FILE: {sentence}")


T = TypeVar("T")

log = logging.getLogger("app")

POLL_S = 3.0
"""Interval in which Milvus is asked which collection the alias names."""

RETRY_S, MAX_RETRY_S = 1.0, 5.0
"""First and longest pause between attempts to reach Milvus; pauses double in between."""


def load_estimator(settings: Settings, index: PoseIndex | None = None) -> Estimator:
    """Load the networks, and the index from the folder in the settings unless it is given.

    Raises
    ------
    ArtefactError
        If the index cannot be used.
    NetworkError
        If a network file shipped with the package is missing or has been modified.
    """
    if index is None:
        assert isinstance(settings.index, Path), "an index in Milvus is loaded beforehand"
        index = load_index(settings.index)
    return Estimator(
        index,
        load_models(settings.concurrency, settings.min_person_px),
        min_person_px=settings.min_person_px,
        max_pixels=settings.max_pixels,
        max_persons=settings.max_persons,
    )


async def keep_index_loaded(runtime: Runtime) -> None:
    """Get the service ready, and follow the alias if the index is in Milvus."""
    address = runtime.settings.index
    if isinstance(address, MilvusAddress):
        await _follow(runtime, address)
    else:
        # Loading runs in a thread of the executor, since the networks' own threads inherit its low
        # priority.
        loading = runtime.executor.submit(lambda: _prepare_estimator(runtime, None))
        await _become_ready_or_say_why(runtime, asyncio.wrap_future(loading))
        runtime.loading = False


def become_ready(runtime: Runtime, estimator: Estimator) -> None:
    """Serve with an estimator from now on; current requests keep theirs."""
    runtime.metrics.observe_index(estimator.index.name, estimator.index.version)
    runtime.estimator = estimator
    runtime.sessions.end_others(estimator)
    log.info(
        "ready: version %s (%s), index %s with %d entries",
        VERSION,
        runtime.settings.revision,
        estimator.index.version,
        len(estimator.index),
    )


def _prepare_estimator(runtime: Runtime, index: PoseIndex | None) -> Estimator:
    with native_lines_logged(log):
        estimator = load_estimator(runtime.settings, index)
        estimator.warm_up()
    freeze_loaded_objects()
    trim_heap()
    return estimator


async def _become_ready_or_say_why(runtime: Runtime, loading: asyncio.Future[Estimator]) -> None:
    """Wait for an estimator; if it cannot be loaded, the service stays up and says why."""
    try:
        estimator = await loading
    except (ArtefactError, NetworkError, UnavailableError, MissingPackageError) as error:
        if runtime.not_ready_because != str(error):
            log.error("not ready: %s", error)
        runtime.not_ready_because = str(error)
    except Exception:
        # A process that ended here would be restarted for ever, and probes would not learn why.
        runtime.not_ready_because = "the index could not be loaded; the log says more"
        log.exception("not ready")
    else:
        become_ready(runtime, estimator)


async def _follow(runtime: Runtime, address: MilvusAddress) -> None:
    """Get ready as soon as Milvus answers; from then on, serve the index that the alias names."""
    # This thread is separate because Milvus may take long to answer, and frames need the executor's
    # threads.
    thread = ThreadPoolExecutor(1, "index", initializer=lower_thread_priority)

    def call(function: Callable[[], T]) -> asyncio.Future[T]:
        return asyncio.wrap_future(thread.submit(function))

    try:
        follower = _Follower(runtime, address)
        pause_s = RETRY_S
        while runtime.estimator is None:
            await _become_ready_or_say_why(runtime, call(follower.first))
            if runtime.estimator is None:
                await anyio.sleep(pause_s)
                pause_s = min(2 * pause_s, MAX_RETRY_S)
        while True:
            await anyio.sleep(POLL_S)
            estimator = await call(follower.next)
            if estimator is not None:
                become_ready(runtime, estimator)
    finally:
        thread.shutdown(wait=False, cancel_futures=True)


class _Follower:
    """Loads the index that the alias names, in a thread."""

    def __init__(self, runtime: Runtime, address: MilvusAddress) -> None:
        self._runtime = runtime
        self._address = address
        self._remote: RemoteIndex | None = None
        self._index: PoseIndex | None = None
        self._last_problem = ""

    def first(self) -> Estimator:
        """Load everything."""
        if self._remote is None:
            check_milvus_package()
            settings, metrics = self._runtime.settings, self._runtime.metrics
            self._remote = RemoteIndex(
                self._address, settings.artefacts, settings.search_timeout_s, metrics.observe_search
            )
        self._index = self._remote.load() or self._index
        return _prepare_estimator(self._runtime, self._index)

    def next(self) -> Estimator | None:
        """Load the index if the alias names another one.

        Returns None if nothing has changed, or if the other index cannot be loaded: the service
        then keeps its index and logs why.
        """
        before = self._runtime.estimator
        assert before is not None and self._remote is not None
        try:
            index = self._remote.load()
        except UnavailableError:
            return None  # Failed searches have been reported already.
        except ArtefactError as error:
            if self._last_problem != str(error):
                log.error("still serving the index before: %s", error)
            self._last_problem = str(error)
            return None
        except Exception:
            log.exception("the index that the alias names could not be loaded")
            return None
        self._last_problem = ""
        return None if index is None else before.with_index(index)
