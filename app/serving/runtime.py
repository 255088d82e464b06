"""The state of a running service, shared by its routes."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Annotated, TypeVar, cast

from fastapi import Depends, Request

from app.estimation.estimator import Estimator
from app.http.identity import camera_stream, sender_of
from app.http.metrics import Metrics
from app.http.problems import ProblemError
from app.scheduling.executor import Executor
from app.scheduling.job import Job
from app.serving.milvus import CircuitBreaker
from app.settings import Settings
from app.tracking.sessions import CameraSessions

T = TypeVar("T")

_LOADED_IN_S = 2


@dataclass
class Runtime:
    """State of an application.

    Parameters
    ----------
    settings : Settings
    executor : Executor
        Does all work on images.
    metrics : Metrics
    sessions : CameraSessions
    breaker : CircuitBreaker
        Open while searches by another server fail.
    sequences : int
        Videos that are received or worked on.
    estimator : Estimator or None
        None until the index is loaded.
    not_ready_because : str
        If there is no estimator: a sentence for the operator.
    loading : bool
        Whether it is being loaded.
    """

    settings: Settings
    executor: Executor
    metrics: Metrics
    sessions: CameraSessions
    breaker: CircuitBreaker
    sequences: int = 0
    estimator: Estimator | None = None
    not_ready_because: str = "the index is being loaded"
    loading: bool = True

    def ready_estimator(self) -> Estimator:
        """Return the estimator, or raise a problem with status 503."""
        if self.estimator is None:
            # Retrying does not help once loading has failed.
            headers = {"Retry-After": str(_LOADED_IN_S)} if self.loading else {}
            raise ProblemError(503, self.not_ready_because, reason="not_ready", headers=headers)
        return self.estimator

    def searching_estimator(self) -> Estimator:
        """Return the estimator where searches succeed, else raise at once what they would.

        Raises
        ------
        ProblemError
            As :meth:`ready_estimator` does.
        index.search.UnavailableError
            If the circuit breaker is open.
        """
        estimator = self.ready_estimator()
        self.breaker.check()
        return estimator


def runtime_of(request: Request) -> Runtime:
    """Return the state of the application.

    Called rather than declared as a dependency, since each dependency costs time on every frame.
    """
    return cast(Runtime, request.app.state.runtime)


# Dependencies are coroutines although they wait for nothing: FastAPI runs other functions in a
# thread, which takes milliseconds while frames keep the cores busy.
async def _ready_estimator(request: Request) -> Estimator:
    return runtime_of(request).ready_estimator()


EstimatorDep = Annotated[Estimator, Depends(_ready_estimator)]


async def run_frame(
    request: Request,
    work: Callable[[Job], T],
    *,
    kind: Hashable,
) -> T:
    """Work on a request's frame in a thread; see :meth:`app.scheduling.executor.Executor.run`.

    Parameters
    ----------
    request : Request
    work : callable
    kind : hashable
        What was sent; with the route it tells how long the work takes.
    """

    async def until_gone() -> None:
        # The body has been read, so what follows can only be the disconnect.
        while (await request.receive())["type"] != "http.disconnect":
            pass

    runtime = runtime_of(request)
    return await runtime.executor.run(
        work,
        until_gone,
        sender=sender_of(request.scope, runtime.settings),
        kind=(request.scope["route"].path, kind),
        camera=camera_stream(request.scope),
    )
