"""Dask, for builds on many machines, whose workers may come and go. Needs the extra ``dask``."""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Iterator
from concurrent.futures import CancelledError, Executor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any


@contextmanager
def executor_of(scheduler: str, workers: int | None = None) -> Iterator[Executor]:
    """Yield an executor for `mapdata.build` that runs on a Dask cluster.

    The shards of a worker that dies are built again by another one.

    Args:
        scheduler: address of a running scheduler, as tcp://host:8786, or "local" for processes of
            this machine that end with the build.
        workers: how many local processes; default one a core.

    Raises:
        ValueError: no address, Dask is not installed, or ``workers`` is given for a cluster that
            has its own.
        OSError: no scheduler answers there, or it gave up.
    """
    if scheduler != "local" and "://" not in scheduler:
        raise ValueError(
            f"scheduler: got {scheduler!r}, expected tcp://HOST:PORT of a scheduler, or local"
        )
    try:
        import dask
        from distributed import Client, KilledWorker, LocalCluster
    except ImportError:
        raise ValueError("scheduler: Dask is not installed: pip install distributed") from None
    if scheduler == "local":
        # Dask suspects the task of a worker that is killed, and gives up after a few suspicions:
        # here workers are killed for other reasons, such as the end of a batch job.
        dask.config.set({"distributed.scheduler.allowed-failures": 100})
        quiet = logging.CRITICAL
        place: AbstractContextManager[Any] = LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address=None, silence_logs=quiet
        )
    elif workers is None:
        place = nullcontext(scheduler)
    else:
        raise ValueError("workers: would do nothing beside a running scheduler, which has its own")
    with place as cluster, Client(cluster, set_as_default=False) as client:
        try:
            yield client.get_executor(pure=False)
        except (CancelledError, KilledWorker) as error:
            what = str(error).partition(". ")[0] or "the scheduler is gone"
            raise OSError(f"scheduler: {what}; run the same again to go on") from None
        except KeyboardInterrupt:
            if scheduler == "local":
                # killed, since closing a cluster waits for the tasks that it has begun
                for nanny in cluster.workers.values():
                    nanny.auto_restart = False
                    if nanny.pid:
                        os.kill(nanny.pid, signal.SIGKILL)
            raise
