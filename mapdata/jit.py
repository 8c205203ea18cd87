"""The one decorator that makes a kernel: compiled on first use, and cached on disk.

The kernels of mapdata are never stale. Of others numba watches the file of the kernel alone: what
it calls, and the constants that it uses, belong into the same file, or into mapdata.
"""

from __future__ import annotations

import hashlib
import os
import sys
import warnings
from collections.abc import Callable
from multiprocessing import current_process
from pathlib import Path
from typing import Any, TypeAlias, TypeVar, cast

import numba
import numpy as np
from numba.core import event

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
        if b"@kernel" in source:
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


_CONFIG: Any = numba.config  # whose stub knows no settings

CACHE_FOLDER = cache_home() / "mapdata" / f"kernels-{source_hash(Path(__file__).parent)}"
_CACHED = _writable(CACHE_FOLDER)

COMPILED = not _CONFIG.DISABLE_JIT
"""Whether kernels are compiled; with the environment variable NUMBA_DISABLE_JIT they are not."""

_FEW = 2
"""The line appears with this many kernels; a single one takes a moment."""


class _CompileNotice(event.Listener):
    """Says on stderr, once, that kernels are being compiled."""

    compiled = 0

    def on_start(self, started: event.Event) -> None:
        """Hear of a kernel that the cache did not have; numba's own functions do not count."""
        if started.data["dispatcher"].py_func.__module__.startswith("mapdata."):
            self.compiled += 1
            if self.compiled == _FEW and _is_main():
                from tqdm.auto import tqdm  # whose bars the line must not break

                tqdm.write("compiling kernels, once for this machine ...", file=sys.stderr)

    def on_end(self, ended: event.Event) -> None:
        """Hear that one is ready."""


if _CACHED:
    event.register("numba:compile", _CompileNotice())  # type: ignore[no-untyped-call]
elif _is_main():
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


def _cached(function: F, inline: str) -> F:
    """Return ``function`` as numba compiles it, into the cache folder."""
    # Nothing calls kernels from C, and the wrappers for that take time to compile. numba's stub
    # does not know the option.
    dispatcher = numba.njit(  # type: ignore[call-overload]
        nogil=True, error_model="numpy", no_cfunc_wrapper=True, inline=inline
    )(function)
    if _CACHED and COMPILED:
        # numba reads its cache folder from a process-wide setting, when caching is enabled.
        before = _CONFIG.CACHE_DIR
        _CONFIG.CACHE_DIR = str(CACHE_FOLDER)
        try:
            dispatcher.enable_caching()
        finally:
            _CONFIG.CACHE_DIR = before
    return cast(F, dispatcher)
