"""Workers: a progress bar, threads that Ctrl-C does not wait for, results as they are finished."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from queue import SimpleQueue
from typing import TypeVar

from tqdm.auto import tqdm

from mapdata.interrupts import THREADS

CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
"""How many cores this process may use: in a batch job often fewer than the machine has."""

FEW = 4 * CORES
"""Tasks that threads of this process are given: what is not begun costs nothing to cancel."""

Advance = Callable[[int], object]
"""Called with how much more is done."""

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")


def no_bar(count: int) -> None:
    """Show nothing; unlike a closure it can be pickled."""


@contextmanager
def bar(shown: bool, total: int, initial: int = 0, unit: str = " maps") -> Iterator[Advance]:
    """Yield what advances a bar of how much is done, the rate and the time left, from any thread.

    A bar that is not shown, or of nothing, is not made: tqdm takes a lock and a thread. Nor is one
    where stderr is closed; where it is no terminal, as in a log file, it prints every two seconds.
    """
    if shown and total and sys.stderr:
        pause = 0.1 if sys.stderr.isatty() else 2.0
        with tqdm(total=total, initial=initial, unit=unit, mininterval=pause) as shown_bar:
            lock = threading.Lock()

            def advance(count: int) -> None:
                with lock:  # tqdm adds without one
                    shown_bar.update(count)

            yield advance
    else:
        yield no_bar


@contextmanager
def threads(workers: int | None = None) -> Iterator[Executor]:
    """Yield an executor of ``workers`` threads, default all cores.

    Ctrl-C cancels tasks that have not begun, and does not wait for the others.
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


def finished(
    pool: Executor, function: Callable[[_Task], _Result], tasks: Iterable[_Task], most: int = FEW
) -> Iterator[tuple[_Task, _Result]]:
    """Yield each task with its result as it is finished, in any order.

    At most ``most`` tasks are submitted at a time; those left are cancelled when the caller stops.
    An error of a task is raised here.
    """
    done: SimpleQueue[Future[_Result]] = SimpleQueue()
    left = iter(tasks)
    under_way = {}
    try:
        while True:
            for task in left:  # goes on where it stopped
                future = pool.submit(function, task)
                under_way[future] = task
                future.add_done_callback(done.put)
                # results are taken while others run, so that few are held
                if len(under_way) >= most or not done.empty():
                    break
            if not under_way:
                return
            future = done.get()
            yield under_way.pop(future), future.result()
    finally:
        for future in under_way:
            future.cancel()
