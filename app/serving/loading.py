"""Loads the index once the service answers probes; with Milvus, also later versions of it."""

import asyncio
import logging
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated

import anyio
from pydantic import StringConstraints, TypeAdapter, ValidationError

from app import VERSION
from app.api.replies import settings_from
from app.api.tracking_schemas import CameraConfiguration
from app.cameras import CameraSettings
from app.http.identity import CAMERA_PATTERN
from app.messages import located
from app.photograph import Estimator, load_estimator
from app.scheduling.process import (
    freeze_loaded_objects,
    lower_thread_priority,
    native_lines_logged,
    trim_heap,
)
from app.serving.runtime import Runtime
from app.settings import SettingsError
from app.vision.tflite import NetworkError
from index.artefact import ArtefactError
from index.search import SearchUnavailableError
from index.store import PoseIndex

_CAMERAS = TypeAdapter(
    dict[Annotated[str, StringConstraints(pattern=CAMERA_PATTERN)], CameraConfiguration]
)


def read_cameras(path: Path | None) -> dict[str, CameraSettings]:
    """Read the settings of cameras by their names; none without a file.

    The file holds a JSON object: for each name, the body of ``PUT /cameras/{camera_id}``.

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
        place, problem = located(error)
        sentence = f"{path}: {place}: {problem}" if place else f"{path}: {problem}"
    else:
        return {name: settings_from(camera) for name, camera in cameras.items()}
    raise SettingsError(f"POSE_CAMERAS_FILE: {sentence}")


log = logging.getLogger("app")

POLL_S = 3.0
"""Interval at which Milvus is polled for the published index."""


async def keep_index_loaded(
    runtime: Runtime, read_index: Callable[[], PoseIndex] | None = None
) -> None:
    """Get the service ready; with Milvus, serve the index that is published there, always."""
    if runtime.settings.milvus is None:
        # Loading runs in a thread of the executor, since the networks' own threads inherit its low
        # priority.
        loading = runtime.executor.submit(lambda: _prepare_estimator(runtime, read_index))
        await _become_ready_or_say_why(runtime, asyncio.wrap_future(loading))
        runtime.loading = False
        return
    # This thread is separate because Milvus may take long to answer, and frames need the executor's
    # threads.
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
