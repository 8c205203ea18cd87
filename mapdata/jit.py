"""The one decorator that makes a kernel: compiled on first use, and cached on disk.

The kernels of mapdata are never stale. Of others numba watches the file of the kernel alone: what
it calls, and the constants that it uses, belong into the same file, or into mapdata.
"""

from __future__ import annotations

import gc
import hashlib
import os
import sys
import warnings
from collections import defaultdict
from collections.abc import Callable
from multiprocessing import current_process
from pathlib import Path
from threading import Timer
from time import monotonic
from typing import Any, TypeAlias, TypeVar, cast

import numba
import numpy as np
from numba.core import event, types

Int: TypeAlias = Any
"""An integer inside a kernel, where Python's and numpy's mix."""

F = TypeVar("F", bound=Callable[..., Any])


def source_hash(package: Path) -> str:
    """Return a hash of all sources in ``package`` that define kernels.

    numba watches only the file of the function it compiled. A kernel that calls one of another file
    would go on giving the old bytes after an edit there, so the name of the cache folder covers all
    of them.
    """
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        source = file.read_bytes()
        if b"@kernel" in source or b"@inlined" in source:
            digest.update(file.relative_to(package).as_posix().encode() + b"\0" + source + b"\0")
    return digest.hexdigest()[:16]


def cache_home() -> Path:
    """Return the user's cache folder.

    Compiled code is loaded from it, so it must not be a shared one like /tmp.
    """
    if override := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(override)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


def _is_main() -> bool:
    """Return whether this is no worker process, which would repeat what the main one says."""
    return current_process().name == "MainProcess"


_modules: set[str] = set()
"""The modules that define kernels."""

_CONFIG: Any = numba.config  # whose stub knows no settings
_unliteral: Any = types.unliteral  # which has no types

CACHE_FOLDER = cache_home() / "mapdata" / f"kernels-{source_hash(Path(__file__).parent)}"
_CACHED = _writable(CACHE_FOLDER)

COMPILED = not _CONFIG.DISABLE_JIT
"""Whether kernels are compiled; with the environment variable NUMBA_DISABLE_JIT they are not."""

_PATIENCE = 0.5
"""Seconds of compiling after which a line says what is being compiled."""


class _CompileListener(event.Listener):
    """Hears of kernels that the cache does not have, and of what numba compiles for them.

    Says on stderr whose kernels are being compiled, once for each module: that of the kernel that
    Python called. Meanwhile Python's collector of cyclic garbage is off: it would look through all
    that numba creates again and again, which takes a tenth of the time.
    """

    def __init__(self) -> None:
        """Nothing is compiled yet."""
        self.depth = 0
        self.began = 0.0
        self.module = ""
        self.seconds: dict[str, float] = defaultdict(float)
        self.announced: set[str] = set()
        self.timer: Timer | None = None
        self.collects_garbage = True

    def on_start(self, started: event.Event) -> None:
        """Hear of a kernel, of one that it calls, or of a function of numba's own."""
        self.depth += 1
        if self.depth > 1:
            return
        self.began = monotonic()
        self.module = started.data["dispatcher"].py_func.__module__
        self.collects_garbage = gc.isenabled()
        gc.disable()
        if self.module in _modules - self.announced and _CACHED and _is_main():
            patience = _PATIENCE - self.seconds[self.module]
            if patience <= 0:
                self.announce(self.module)
                return
            self.timer = Timer(patience, self.announce, (self.module,))
            self.timer.daemon = True  # it must not keep a process from ending
            self.timer.start()

    def announce(self, module: str) -> None:
        """Say what is being compiled."""
        from tqdm.auto import tqdm  # whose bars the line must not break

        self.announced.add(module)
        tqdm.write(f"compiling kernels for {module} (kept for later runs) ...", file=sys.stderr)

    def on_end(self, ended: event.Event) -> None:
        """Hear that one is ready."""
        self.depth -= 1
        if self.depth > 0:
            return
        if self.timer is not None:
            self.timer.cancel()
            self.timer = None
        self.seconds[self.module] += monotonic() - self.began
        if self.collects_garbage:
            gc.enable()


if COMPILED:
    event.register("numba:compile", _CompileListener())  # type: ignore[no-untyped-call]
if not _CACHED and _is_main():
    warnings.warn(
        f"{CACHE_FOLDER} is not writable: kernels are compiled anew in every process; set "
        "NUMBA_CACHE_DIR to a folder that is "
        f"(now: {os.environ.get('NUMBA_CACHE_DIR', 'not set')})",
        stacklevel=2,
    )


def kernel(function: F) -> F:
    """Compile ``function`` with numba on its first call: no Python objects, no GIL, one thread.

    The static type is that of the plain function, so that callers are checked. Unless `COMPILED`,
    it stays a plain function, for a debugger: slow, with equal results.
    """
    if not COMPILED:
        # Integers wrap without a warning, as in compiled code.
        return np.errstate(all="ignore")(function)
    return _cached(function, "never")


def inlined(function: F) -> F:
    """Mark ``function`` as a part of kernels: its body replaces each call.

    A real call with array arguments counts their references, which costs more than what a small
    helper does.
    """
    return _cached(function, "always")


def _ignore_constants(dispatcher: Any) -> None:
    """Let kernels that call this one with constants share what is compiled for other numbers.

    numba has a type for each constant, and would compile the kernel again for it.
    """
    get_call_template = dispatcher.get_call_template

    def get_template(arguments: Any, keywords: Any) -> Any:
        plain = [_unliteral(argument) for argument in arguments]
        return get_call_template(plain, {key: _unliteral(keywords[key]) for key in keywords})

    dispatcher.get_call_template = get_template


def _cached(function: F, inline: str) -> F:
    """Return ``function`` as numba compiles it, into the cache folder."""
    _modules.add(function.__module__)
    # Nothing calls kernels from C, and the wrappers for that take time to compile. numba's stub
    # does not know the option.
    dispatcher = numba.njit(  # type: ignore[call-overload]
        nogil=True, error_model="numpy", no_cfunc_wrapper=True, inline=inline
    )(function)
    if COMPILED:
        _ignore_constants(dispatcher)
    if _CACHED and COMPILED:
        # numba reads its cache folder from a process-wide setting, when caching is enabled.
        before = _CONFIG.CACHE_DIR
        _CONFIG.CACHE_DIR = str(CACHE_FOLDER)
        try:
            dispatcher.enable_caching()
        finally:
            _CONFIG.CACHE_DIR = before
    return cast(F, dispatcher)
