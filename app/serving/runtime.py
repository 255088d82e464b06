"""The state of a running service, shared by its routes."""

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, TypeVar, cast

from fastapi import Depends, Request

from app.cameras import CameraSessions
from app.http.errors import overloaded
from app.http.identity import identity_of
from app.http.metrics import Metrics
from app.photograph import Estimator
from app.scheduling.executor import Executor
from app.scheduling.job import Job
from app.settings import Settings

T = TypeVar("T")

_LOADED_IN_S = 2
_SEQUENCE_RETRY_S = 10


@dataclass
class Runtime:
    """State of an application.

    All work on images is the executor's. ``sequences`` counts the videos that are received or
    worked on. Until the index is loaded, ``estimator`` is None, ``not_ready_because`` tells the
    operator why, and ``loading`` is whether loading goes on or will be tried again.
    """

    settings: Settings
    executor: Executor
    metrics: Metrics
    sessions: CameraSessions
    sequences: int = 0
    estimator: Estimator | None = None
    not_ready_because: str = "the index is being loaded"
    loading: bool = True

    def ready_estimator(self) -> Estimator:
        """Return the estimator, or raise a problem with status 503."""
        if self.estimator is None:
            # Retrying does not help once loading has failed.
            retry_after_s = _LOADED_IN_S if self.loading else None
            raise overloaded(self.not_ready_because, "not_ready", retry_after_s)
        return self.estimator

    @contextmanager
    def sequence(self) -> Iterator[None]:
        """Count a video while it is received and worked on; raise a 503 if there are too many."""
        most = self.settings.max_sequences
        if self.sequences >= most:
            raise overloaded(
                f"expected at most {most} videos at once; try again later",
                "too_many_sequences",
                _SEQUENCE_RETRY_S,
            )
        self.sequences += 1
        try:
            yield
        finally:
            self.sequences -= 1


def runtime_of(request: Request) -> Runtime:
    """Return the state of the application.

    This is a function rather than a dependency, since each dependency costs time on every frame.
    """
    return cast(Runtime, request.app.state.runtime)


# Dependencies are coroutines although they wait for nothing: FastAPI runs other functions in a
# thread, which takes milliseconds while frames keep the cores busy.
async def _ready_estimator(request: Request) -> Estimator:
    return runtime_of(request).ready_estimator()


EstimatorDep = Annotated[Estimator, Depends(_ready_estimator)]


async def run_frame(request: Request, work: Callable[[Job], T], *, kind: Hashable) -> T:
    """Work on a request's frame in a thread; see :meth:`app.scheduling.executor.Executor.run`.

    The body has been read. ``kind`` is the kind of content that was sent; with the route, it
    determines how long the work takes.
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
