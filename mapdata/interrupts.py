"""Ctrl-C ends a command with one line and exit code 130, whenever it is pressed.

Python raises `KeyboardInterrupt` wherever the main thread is. That is right while a command works,
since what it has begun is cleaned up. While modules are imported it may be swallowed or become
another error, and while the interpreter shuts down nothing can catch it. So the process of a
command line calls `exit_on_interrupt` before it imports anything large, and works within
`stoppable`.
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
"""What shells say of a program that Ctrl-C ended: 128 + SIGINT."""

STOPPED = "stopped; run the same command again to go on"

THREADS = "mapdata"
"""What the names of threads begin with whose work Ctrl-C does not wait for."""


def exit_on_interrupt() -> None:
    """From now on let Ctrl-C end this process at once, outside of `stoppable`.

    Only the main thread of a process that is a command line may call it. Where Ctrl-C is ignored,
    as in a background job of a shell, it stays ignored.
    """
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return
    signal.signal(signal.SIGINT, _leave_now)
    sys.excepthook = _report_error
    sys.unraisablehook = _report_unraisable
    # Registered first, it runs last. Behind it Python would take the handler away: Ctrl-C would
    # end the process by the bare signal. The work is done by then.
    atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)


@contextmanager
def stoppable(message: str = STOPPED) -> Iterator[None]:
    """Let Ctrl-C raise `KeyboardInterrupt` here, and end the process once that has cleaned up.

    Ctrl-C once more does not wait for that. In a process without `exit_on_interrupt` nothing is
    changed, and `KeyboardInterrupt` goes on to the caller.

    Args:
        message: the line on stderr.
    """
    if signal.getsignal(signal.SIGINT) is not _leave_now:
        yield
        return
    handler = _RaiseOnce()
    try:
        signal.signal(signal.SIGINT, handler)
        yield
    except BaseException as error:
        # An import may have made another error of the interrupt, and Lightning makes it SystemExit.
        if handler.pressed or isinstance(error, KeyboardInterrupt):
            leave(message)
        raise
    finally:
        signal.signal(signal.SIGINT, _leave_now)


def leave(message: str = STOPPED) -> NoReturn:
    """End this process with the line and the exit code of Ctrl-C.

    A plain exit would wait for the shards under way in other threads, however long they take.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(Exception):  # a reader that is gone; a write that the signal interrupted
        sys.stdout.flush()
    # print() cannot be called while the main thread is inside another print().
    with suppress(OSError):
        os.write(2, f"mapdata: {message}\n".encode())
    os._exit(EXIT_CODE)


def _leave_now(number: int, frame: FrameType | None) -> NoReturn:
    """Handle SIGINT where there is nothing to clean up."""
    leave()


class _RaiseOnce:
    """Handles SIGINT while a command works."""

    def __init__(self) -> None:
        """Begin with no SIGINT."""
        self.pressed = False

    def __call__(self, number: int, frame: FrameType | None) -> NoReturn:
        """Raise KeyboardInterrupt; the second time, end the process."""
        if self.pressed:
            leave()
        self.pressed = True
        raise KeyboardInterrupt


def _report_error(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    """Print an error that nobody caught; compiled modules print here what their import swallows."""
    if issubclass(kind, KeyboardInterrupt):
        leave()
    sys.__excepthook__(kind, error, trace)


def _report_unraisable(unraisable: UnraisableHookArgs) -> None:
    """Print an error of a destructor or callback, where `KeyboardInterrupt` would be lost."""
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        leave()
    sys.__unraisablehook__(unraisable)
