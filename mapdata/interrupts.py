"""Ctrl-C ends a command with one line and exit code 130, whenever it is pressed.

Python raises `KeyboardInterrupt` wherever the main thread is. That is right while a command works,
because `finally` blocks then clean up what it has begun. While modules are imported, the exception
may be swallowed or replaced by another one, and while the interpreter shuts down nothing can catch
it. So the process of a command line calls `exit_on_interrupt` before it imports anything large, and
does its work within `stoppable`. An exception that Python swallows even there, such as one in a
destructor, stops nothing: Ctrl-C then has to be pressed again.
"""

from __future__ import annotations

import atexit
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import NoReturn

EXIT_CODE = 130
"""The exit code that shells report for a program that Ctrl-C ended: 128 + SIGINT."""

STOPPED = "stopped; run the same command again to go on"

THREADS = "mapdata"
"""Prefix of the names of worker threads; Ctrl-C does not wait for them."""


def exit_on_interrupt() -> None:
    """From now on let Ctrl-C end this process at once, except within `stoppable`.

    Only the main thread of a command line's process may call it. Where Ctrl-C is ignored, as in a
    background job of a shell, it stays ignored.
    """
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return
    signal.signal(signal.SIGINT, _handle)
    # Registered first, this runs last. After it Python removes the handler, and Ctrl-C would end
    # the process by the bare signal, although its work is done by then. So Ctrl-C is ignored.
    atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)


@contextmanager
def stoppable(message: str = STOPPED) -> Iterator[None]:
    """Let Ctrl-C raise `KeyboardInterrupt` in this block, and end the process after the cleanup.

    A second Ctrl-C ends the process without waiting for the cleanup. In a process that did not call
    `exit_on_interrupt` this does nothing, and `KeyboardInterrupt` reaches the caller.

    Args:
        message: the line that is printed to stderr.
    """
    global _raises  # noqa: PLW0603  (a signal has one handler in a process)
    if _raises or signal.getsignal(signal.SIGINT) is not _handle:
        yield
        return
    _raises = True
    try:
        yield
    except BaseException:
        # An import may have turned the interrupt into another error; Lightning raises SystemExit.
        was_pressed = not _raises
        if was_pressed:
            leave(message)
        raise
    finally:
        _raises = False


def leave(message: str = STOPPED) -> NoReturn:
    """Print ``message`` to stderr and end this process with the exit code of Ctrl-C.

    A plain exit would wait for the shards that other threads are building.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(Exception):  # the reader of a pipe may be gone, or the signal cut a write short
        sys.stdout.flush()
    # The signal may have arrived inside a print(), and print() cannot be called inside itself.
    with suppress(OSError):
        os.write(2, f"mapdata: {message}\n".encode())
    os._exit(EXIT_CODE)


_raises = False
"""Whether Ctrl-C raises `KeyboardInterrupt`: within `stoppable`, until it was pressed once."""


def _handle(number: int, frame: FrameType | None) -> NoReturn:
    """Handle SIGINT: raise `KeyboardInterrupt` or, with nothing to clean up, end the process."""
    global _raises  # noqa: PLW0603
    if not _raises:
        leave()
    _raises = False
    raise KeyboardInterrupt
