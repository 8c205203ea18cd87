"""Ctrl-C ends a command with one line and exit code 130, whenever it is pressed.

Python raises `KeyboardInterrupt` wherever the main thread is. That is right while a command works,
because `finally` blocks then clean up what it has begun. While modules are imported, the exception
may be swallowed or replaced by another one, and while the interpreter shuts down nothing can catch
it. So the process of a command line calls `exit_on_interrupt` before it imports anything large, and
does its work within `stoppable`.
"""

from __future__ import annotations

import atexit
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

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
    signal.signal(signal.SIGINT, _leave_now)
    sys.excepthook = _report_error
    sys.unraisablehook = _report_unraisable
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
    if signal.getsignal(signal.SIGINT) is not _leave_now:
        yield
        return
    handler = _RaiseOnce()
    try:
        signal.signal(signal.SIGINT, handler)
        yield
    except BaseException as error:
        # An import may have turned the interrupt into another error; Lightning raises SystemExit.
        if handler.pressed or isinstance(error, KeyboardInterrupt):
            leave(message)
        raise
    finally:
        signal.signal(signal.SIGINT, _leave_now)


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


def _leave_now(number: int, frame: FrameType | None) -> NoReturn:
    """Handle SIGINT outside of `stoppable`, where there is nothing to clean up."""
    leave()


class _RaiseOnce:
    """The handler of SIGINT within `stoppable`.

    Attributes:
        pressed: whether Ctrl-C was pressed.
    """

    def __init__(self) -> None:
        """Create a handler that has not been called."""
        self.pressed = False

    def __call__(self, number: int, frame: FrameType | None) -> NoReturn:
        """Raise KeyboardInterrupt at the first call, and end the process at the second."""
        if self.pressed:
            leave()
        self.pressed = True
        raise KeyboardInterrupt


def _report_error(
    error_type: type[BaseException], error: BaseException, traceback: TracebackType | None
) -> None:
    """Print an error that nothing caught, or end the process if it is `KeyboardInterrupt`.

    Compiled modules also report the errors here that they swallow while they are imported.
    """
    if issubclass(error_type, KeyboardInterrupt):
        leave()
    sys.__excepthook__(error_type, error, traceback)


def _report_unraisable(unraisable: UnraisableHookArgs) -> None:
    """Print an error of a destructor or callback, where Python ignores `KeyboardInterrupt`."""
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        leave()
    sys.__unraisablehook__(unraisable)
