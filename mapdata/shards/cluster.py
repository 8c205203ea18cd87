"""Dask, for builds on many machines, whose workers may come and go. Needs the extra ``dask``."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import CancelledError, Executor
from contextlib import contextmanager


@contextmanager
def executor_of(scheduler: str) -> Iterator[Executor]:
    """Yield an executor for `mapdata.build` that runs on a Dask cluster.

    The shards of a worker that dies are built again by another one.

    Args:
        scheduler: address of a running scheduler, as tcp://host:8786.

    Raises:
        ValueError: no address, or Dask is not installed.
        OSError: no scheduler answers there, or it gave up.
    """
    if "://" not in scheduler:
        raise ValueError(f"scheduler: got {scheduler!r}, expected tcp://HOST:PORT of a scheduler")
    try:
        from distributed import Client, KilledWorker
    except ImportError:
        raise ValueError("scheduler: Dask is not installed: pip install distributed") from None
    with Client(scheduler, set_as_default=False) as client:
        try:
            yield client.get_executor(pure=False)
        except (CancelledError, KilledWorker) as error:
            what = str(error).partition(". ")[0] or "the scheduler is gone"
            raise OSError(f"scheduler: {what}; run the same again to go on") from None
