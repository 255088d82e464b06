"""The workers of a Dask cluster as an executor; the only module that imports Dask."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterator
from concurrent.futures import CancelledError, Executor
from contextlib import contextmanager

from distributed import Client, KilledWorker, rpc
from distributed.scheduler import NoWorkerError

from index.build.parameters import RENDERING
from index.build.shard_files import ShardError


@contextmanager
def cluster_executor(
    address: str, first_worker_s: float = RENDERING.first_worker_s
) -> Iterator[Executor]:
    """Connect to a Dask scheduler; leaving the context cancels what still runs.

    Dask gives the task of a worker that dies to another one; workers may come and go.

    Parameters
    ----------
    address : str
        Address of the scheduler, such as ``tcp://10.0.0.1:8786``.
    first_worker_s : float
        How long the first worker may take to join, in seconds.

    Raises
    ------
    ShardError
        If the scheduler does not answer or is lost, no worker joins or remains, a worker cannot
        import this project, or a task kills several workers.
    """
    client = _connect(address)
    try:
        try:
            client.wait_for_workers(1, timeout=first_worker_s)
        except TimeoutError:
            raise ShardError(f"no worker joined {address} in {first_worker_s:g} s") from None
        yield client.get_executor(pure=False)
    except KilledWorker as error:
        raise ShardError(
            f"every worker of {address} that took a certain shard died; has each enough memory?"
        ) from error
    except NoWorkerError as error:
        raise ShardError(f"no worker of {address} is left") from error
    except CancelledError as error:
        raise ShardError(f"lost the Dask scheduler at {address}") from error
    except RuntimeError as error:
        if isinstance(error.__cause__, ImportError):
            raise ShardError(
                f"a worker of {address} cannot import this project ({error.__cause__}): start it "
                "in a checkout, with the build extra"
            ) from error
        raise
    finally:
        client.close()


def _connect(address: str) -> Client:
    # Errors are reported in one sentence; Dask would also log them.
    for logger in ("distributed", "distributed.client"):
        logging.getLogger(logger).setLevel(logging.CRITICAL + 1)
    try:
        # A client would wait for ever for a server that is no scheduler, and log errors at exit.
        asyncio.run(_check_scheduler(address))
        return Client(address, timeout=RENDERING.connect_s, set_as_default=False)
    # The answer of any other server, read as Dask's, may raise anything.
    except Exception as error:
        raise ShardError(f"no Dask scheduler answers at {address}") from error


async def _check_scheduler(address: str) -> None:
    async with rpc(address, timeout=RENDERING.connect_s) as remote:
        identity = await asyncio.wait_for(remote.identity(), RENDERING.connect_s)
    if identity["type"] != "Scheduler":
        raise ValueError(f"expected a scheduler, got a {identity['type']}")
