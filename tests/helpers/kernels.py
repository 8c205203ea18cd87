"""The processes of one test run compile each kernel once, and not each of them all kernels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher

from helpers.locks import lock


def share_compiling(folder: Path) -> None:
    """Let this process wait while another one with the same ``folder`` compiles the same kernel.

    numba looks for a kernel in its cache before it compiles it. So a process that has waited reads
    what the other one wrote. Two processes never wait for each other, since no kernel calls itself
    through others. This counts for the kernels that are defined after it is called.

    Args:
        folder: where the locks are, one for each kernel.
    """
    compile_kernel: Any = Dispatcher.compile
    held: set[str] = set()

    def compile_once(self: Any, signature: Any) -> Any:
        """Compile a kernel for these types of arguments, or read it from the cache."""
        name = f"{self.py_func.__module__}.{self.py_func.__qualname__}"
        if not name.startswith("mapdata.") or name in held:
            return compile_kernel(self, signature)
        # numba's own lock comes first: two threads could wait for each other otherwise.
        with global_compiler_lock, lock(folder / f"{name}.lock"):
            held.add(name)
            try:
                return compile_kernel(self, signature)
            finally:
                held.remove(name)

    setattr(Dispatcher, "compile", compile_once)  # noqa: B010  (mypy refuses an assignment)
