"""Loads the index once the service answers probes, and moves over to another one in Milvus."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import anyio
import numpy as np

from app.estimation.estimator import Estimator
from app.scheduling.process import (
    freeze_loaded_objects,
    lower_thread_priority,
    native_lines_logged,
    trim_heap,
)
from app.serving.milvus import (
    GuardedNeighbours,
    MissingPackageError,
    RemoteIndex,
    check_milvus_package,
)
from app.serving.runtime import Runtime
from app.serving.version import VERSION
from app.vision.tflite import NetworkError
from index.files import ArtefactError
from index.milvus_address import MilvusAddress
from index.search import UnavailableError
from index.store import PoseIndex

T = TypeVar("T")

log = logging.getLogger("app")

ASKED_EVERY_S = 3.0
"""Interval in which Milvus is asked what the alias names."""

PROBED_EVERY_S = 1.0
"""Interval of searches while the breaker is open, so that no request has to try."""

LONGEST_PAUSE_S = 5.0
"""Pauses between attempts to get ready double from :data:`PROBED_EVERY_S` up to this."""


async def keep_index_loaded(runtime: Runtime) -> None:
    """Get the service ready, and follow the alias where the index is in Milvus."""
    address = runtime.settings.index
    if isinstance(address, MilvusAddress):
        await _follow(runtime, address)
    else:
        # Where it is loaded, threads of the networks inherit the priority of those that use them.
        loading = runtime.executor.submit(lambda: _load_estimator(runtime, None))
        await _become_ready_or_say_why(runtime, asyncio.wrap_future(loading))
        runtime.loading = False


def become_ready(runtime: Runtime, estimator: Estimator) -> None:
    """Serve with an estimator from now on; requests that are being worked on keep theirs."""
    runtime.metrics.observe_index(estimator.index.name, estimator.index.version)
    runtime.estimator = estimator
    runtime.sessions.end_others(estimator)
    log.info(
        "ready: version %s (%s), index %s with %d entries, detector %s",
        VERSION,
        runtime.settings.revision,
        estimator.index.version,
        len(estimator.index),
        estimator.detector.name,
    )


def _load_estimator(runtime: Runtime, index: PoseIndex | None) -> Estimator:
    with native_lines_logged(log):
        estimator = Estimator.load(runtime.settings, index)
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
    """Get ready as soon as Milvus allows, and serve what the alias names from then on."""
    # A thread of its own: Milvus may take long to answer, and frames need theirs.
    thread = ThreadPoolExecutor(1, "index", initializer=lower_thread_priority)

    def call(function: Callable[[], T]) -> asyncio.Future[T]:
        return asyncio.wrap_future(thread.submit(function))

    try:
        follower = _Follower(runtime, address)
        pause_s = PROBED_EVERY_S
        while runtime.estimator is None:
            await _become_ready_or_say_why(runtime, call(follower.first))
            if runtime.estimator is None:
                await anyio.sleep(pause_s)
                pause_s = min(2 * pause_s, LONGEST_PAUSE_S)
        while True:
            await anyio.sleep(PROBED_EVERY_S if runtime.breaker.is_open else ASKED_EVERY_S)
            estimator = await call(follower.next)
            if estimator is not None:
                become_ready(runtime, estimator)
    finally:
        thread.shutdown(wait=False, cancel_futures=True)


class _Follower:
    """Loads what the alias names, in a thread.

    Parameters
    ----------
    runtime : Runtime
    address : MilvusAddress
    """

    def __init__(self, runtime: Runtime, address: MilvusAddress) -> None:
        self._runtime = runtime
        self._address = address
        self._remote: RemoteIndex | None = None
        self._index: PoseIndex | None = None
        self._told = ""

    def first(self) -> Estimator:
        """Load everything."""
        if self._remote is None:
            check_milvus_package()
            settings = self._runtime.settings
            self._remote = RemoteIndex(
                self._address,
                settings.artefacts,
                settings.search_timeout_s,
                self._runtime.breaker,
            )
        else:
            self._remote.reconnect()
            self._probe(self._index)
        self._index = self._remote.load() or self._index
        return _load_estimator(self._runtime, self._index)

    def next(self) -> Estimator | None:
        """Load the index if the alias names another one, else search if the breaker is open.

        Returns None where nothing has changed or the other one cannot be loaded: the service goes
        on with what it has, and says why.
        """
        before = self._runtime.estimator
        assert before is not None and self._remote is not None
        try:
            if self._runtime.breaker.is_open:
                self._remote.reconnect()
            index = self._remote.load()
            if index is None:
                self._probe(before.index)
        except UnavailableError:
            return None  # Searches tell of that.
        except ArtefactError as error:
            self._tell(str(error))
            return None
        except Exception:
            log.exception("the index that the alias names could not be loaded")
            return None
        self._told = ""
        return None if index is None else before.with_index(index)

    def _probe(self, index: PoseIndex | None) -> None:
        """Search if the breaker is open, which a success closes; else raise UnavailableError."""
        if index is not None and self._runtime.breaker.is_open:
            assert isinstance(index.neighbours, GuardedNeighbours)
            index.neighbours.search_anyway(index.vectors[:1].astype(np.float32), 1)

    def _tell(self, why: str) -> None:
        if why != self._told:
            log.error("still serving the index before: %s", why)
        self._told = why
