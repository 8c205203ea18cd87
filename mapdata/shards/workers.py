"""Running tasks in parallel: a pool of threads, results in order of completion, a progress bar."""

from __future__ import annotations

import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from queue import SimpleQueue
from typing import Protocol, TypeVar

from tqdm.auto import tqdm

from mapdata.interrupts import THREADS

CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
"""Number of cores that this process may use: in a batch job often fewer than the machine has."""

MAX_PENDING_IN_THREADS = 4 * CORES
"""How many tasks a pool of threads holds at once, at most, so that few have to be cancelled."""

Advance = Callable[[int], object]
"""Called with the number of maps, or other units of a progress bar, that were just finished."""


class AdvanceWithNote(Protocol):
    """An `Advance` that also shows a note behind the bar.

    The note may change while nothing is finished, with a count of 0.
    """

    def __call__(self, count: int, note: str = "") -> object:
        """Advance the bar by ``count``; an empty note leaves the last one."""


_Task = TypeVar("_Task")
_Result = TypeVar("_Result")


def no_bar(count: int, note: str = "") -> None:
    """Ignore progress. Unlike a closure, this function can be pickled for another process."""


@contextmanager
def bar(
    enabled: bool, total: int, initial: int = 0, unit: str = " maps"
) -> Iterator[AdvanceWithNote]:
    """Show a progress bar with rate and remaining time; yield the function that advances it.

    The function may be called from any thread. No bar is created where it is not enabled, where
    there is nothing to do, or where stderr is closed, because tqdm takes a lock and a thread. Where
    stderr is no terminal, as in a log file, the bar is printed every two seconds.
    """
    if not (enabled and total and sys.stderr):
        yield no_bar
        return
    print_interval = 0.1 if sys.stderr.isatty() else 2.0
    with tqdm(total=total, initial=initial, unit=unit, mininterval=print_interval) as progress_bar:
        lock = threading.Lock()
        shown = -math.inf  # when the note was printed last

        def advance(count: int, note: str = "") -> None:
            nonlocal shown
            with lock:  # tqdm itself is not safe to update from several threads
                if note:
                    progress_bar.set_postfix_str(note, refresh=False)
                progress_bar.update(count)
                # tqdm prints nothing while the count stays.
                if note and time.monotonic() - shown >= print_interval:
                    progress_bar.refresh()
                    shown = time.monotonic()

        yield advance


@contextmanager
def thread_pool(workers: int | None = None) -> Iterator[Executor]:
    """Yield an executor of ``workers`` threads; the default is one thread per core.

    At the end, tasks that have not begun are cancelled and running tasks are waited for. After
    Ctrl-C running tasks are not waited for.
    """
    pool = ThreadPoolExecutor(workers or CORES, thread_name_prefix=THREADS)
    wait = True
    try:
        yield pool
    except KeyboardInterrupt:
        wait = False
        raise
    finally:
        pool.shutdown(wait=wait, cancel_futures=True)


def completed(
    pool: Executor,
    function: Callable[[_Task], _Result],
    tasks: Iterable[_Task],
    max_pending: int = MAX_PENDING_IN_THREADS,
) -> Iterator[tuple[_Task, _Result]]:
    """Yield each task with the return value of ``function(task)``, in the order of completion.

    At most ``max_pending`` tasks are submitted at a time; they are cancelled when the caller stops
    iterating. An error of a task is raised here.
    """
    done: SimpleQueue[Future[_Result]] = SimpleQueue()
    pending: dict[Future[_Result], _Task] = {}

    def next_completed() -> tuple[_Task, _Result]:
        future = done.get()
        return pending.pop(future), future.result()

    try:
        for task in tasks:
            future = pool.submit(function, task)
            pending[future] = task
            future.add_done_callback(done.put)
            # Finished tasks are yielded before more are submitted, so that few results are held.
            if len(pending) >= max_pending or not done.empty():
                yield next_completed()
        while pending:
            yield next_completed()
    finally:
        for future in pending:
            future.cancel()
