"""Building on a Dask cluster, whose workers may come and go. Needs the extra ``dask``."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import CancelledError, Executor
from contextlib import contextmanager


@contextmanager
def dask_executor(scheduler: str) -> Iterator[Executor]:
    """Yield an executor for `mapdata.build` that runs on a Dask cluster.

    If a worker dies, other workers build its shards.

    Args:
        scheduler: address of a running scheduler, such as tcp://host:8786.

    Raises:
        ValueError: it is not an address, or Dask is not installed.
        OSError: no scheduler answers at this address, or it gave up.
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
            first_sentence = str(error).partition(". ")[0]
            reason = first_sentence or "the scheduler is gone"
            raise OSError(f"scheduler: {reason}; run the same again to go on") from None
