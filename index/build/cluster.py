"""Workers of a Dask cluster; the only module that imports Dask."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from time import monotonic
from types import TracebackType

from distributed import Client, KilledWorker, rpc

from index.build.shard_files import code_version
from index.build.workers import Result, Task, WorkersError, bounded_map

CONNECT_S = 5.0
"""How long a scheduler may take to answer."""

WORKERS_WITHIN_S = 60.0
"""How long a cluster may be without any worker."""


class Cluster:
    """The workers of a Dask scheduler, as a context manager.

    A task whose worker dies is given to another; workers may come and go.

    Parameters
    ----------
    address : str
        Of the scheduler, such as ``tcp://10.0.0.1:8786``.
    workers_within_s : float
        How long it may be without any worker, in seconds.

    Raises
    ------
    WorkersError
        If the scheduler does not answer, no worker joins in time, or a worker runs other code
        than this process.
    """

    def __init__(self, address: str, workers_within_s: float = WORKERS_WITHIN_S) -> None:
        # What matters of what it logs is said in one sentence here.
        for logger in ("distributed", "distributed.client"):
            logging.getLogger(logger).setLevel(logging.CRITICAL + 1)
        self._address = address
        self._within_s = workers_within_s
        try:
            # A client that cannot connect would go on trying, and complain at exit.
            asyncio.run(_expect_scheduler(address))
            self._client = Client(address, timeout=CONNECT_S, set_as_default=False)
        # A stranger's answer, read as Dask's, may mean anything.
        except Exception as error:
            raise WorkersError(f"no Dask scheduler answers at {address}") from error
        self._seen = monotonic()
        try:
            self._client.wait_for_workers(1, timeout=workers_within_s)
            self._refuse_other_code()
        except TimeoutError:
            self._client.close()
            raise self._without_workers() from None
        except BaseException:
            self._client.close()
            raise

    def __enter__(self) -> Cluster:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Leave the cluster; tasks that still run are cancelled."""
        self._client.close()

    def map(self, perform: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """Perform tasks; see :class:`index.build.workers.Workers`.

        Raises
        ------
        WorkersError
            If the scheduler is lost, no worker is left, or a task killed several workers.
        """
        self._seen = monotonic()
        executor = self._client.get_executor(pure=False)
        try:
            yield from bounded_map(executor, perform, tasks, self._at_once)
        except KilledWorker as error:
            raise WorkersError(
                f"every worker of {self._address} that took a certain shard died; has each enough "
                "memory?"
            ) from error
        except (CancelledError, OSError) as error:
            raise WorkersError(f"lost the Dask scheduler at {self._address}") from error

    def _at_once(self) -> int:
        """Tasks to hand out: what keeps every thread busy."""
        threads: int = sum(self._client.nthreads().values())
        if threads:
            self._seen = monotonic()
        elif monotonic() - self._seen > self._within_s:
            raise self._without_workers()
        return 2 * threads

    def _without_workers(self) -> WorkersError:
        return WorkersError(
            f"the Dask cluster at {self._address} had no worker for {self._within_s:g} s"
        )

    def _refuse_other_code(self) -> None:
        own = code_version()
        for worker, other in self._client.run(code_version, on_error="return").items():
            if isinstance(other, ImportError):
                raise WorkersError(
                    f"the worker {worker} cannot import this project ({other}): start it in a "
                    "checkout, with the build extra"
                )
            if other != own:
                raise WorkersError(
                    f"the worker {worker} runs other code ({other}) than this build ({own})"
                )


async def _expect_scheduler(address: str) -> None:
    async with rpc(address, timeout=CONNECT_S) as remote:
        identity = await asyncio.wait_for(remote.identity(), CONNECT_S)
    if identity["type"] != "Scheduler":
        raise ValueError(f"expected a scheduler, got a {identity['type']}")
