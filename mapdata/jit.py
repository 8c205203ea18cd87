"""The decorator `kernel`, which compiles a function on its first use and caches it on disk.

Compiling is what a first use waits for. So the branches that the types of the arguments rule out
are left out (`_DecideIsNone`), and Python's stack has room for the calls of numba
(`_in_large_frame`).

The cache of mapdata's own kernels is never stale. For kernels of other packages, numba watches only
the file of the kernel. So the functions that such a kernel calls, and the constants that it uses,
have to be in the same file or in mapdata.
"""

from __future__ import annotations

import gc
import hashlib
import operator
import os
import sys
import warnings
from collections import defaultdict
from collections.abc import Callable
from functools import partial
from multiprocessing import current_process
from pathlib import Path
from threading import Timer
from time import monotonic
from typing import Any, TypeAlias, TypeVar, cast

import numba
import numpy as np
from llvmlite import ir as llvm_ir
from numba.core import event, ir, ir_utils, types
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.untyped_passes import InlineInlinables, RewriteSemanticConstants
from numba.extending import lower_builtin, type_callable

Int: TypeAlias = Any
"""An integer inside a kernel, where integers of Python and of numpy mix."""

F = TypeVar("F", bound=Callable[..., Any])


def source_hash(package: Path) -> str:
    """Return a hash of all sources in ``package`` that define kernels.

    numba watches only the file of the function that it compiled. A kernel that calls a kernel of
    another file would keep running the old code after an edit there. So the name of the cache
    folder depends on all these files.
    """
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        source = file.read_bytes()
        if b"@kernel" in source or b"@inlined" in source:
            digest.update(file.relative_to(package).as_posix().encode() + b"\0" + source + b"\0")
    return digest.hexdigest()[:16]


def cache_home() -> Path:
    """Return the user's cache folder.

    Compiled code is loaded from it, so it must not be a folder that users share, like /tmp.
    """
    if override := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(override)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _is_writable(folder: Path) -> bool:
    """Return whether ``folder`` exists, or could be created, and files can be written to it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


def _is_main_process() -> bool:
    """Return whether this is the main process; workers would repeat its messages."""
    return current_process().name == "MainProcess"


_kernel_modules: set[str] = set()
"""The modules that define kernels."""

_CONFIG: Any = numba.config  # numba's stub does not know its settings.
_unliteral: Any = types.unliteral  # numba does not annotate this function.

CACHE_FOLDER = cache_home() / "mapdata" / f"kernels-{source_hash(Path(__file__).parent)}"
_CACHED = _is_writable(CACHE_FOLDER)

COMPILED = not _CONFIG.DISABLE_JIT
"""Whether kernels are compiled; with the environment variable NUMBA_DISABLE_JIT they are not."""

_SECONDS_BEFORE_MESSAGE = 0.5
"""Seconds of compiling after which a message says what is being compiled."""


class _CompileListener(event.Listener):
    """Reports on stderr which kernels are being compiled, and speeds compiling up.

    numba calls this listener for every kernel that the cache does not have, and for every function
    that it compiles for such a kernel. The message names the module of the kernel that Python
    called, once for each module. Meanwhile Python's collector of cyclic garbage is off, because it
    would look through all the objects of numba again and again, which takes a tenth of the time.

    Attributes:
        depth: number of functions that are being compiled, each for the one before it.
        began: when the first of them began, as `time.monotonic` returns it.
        module: module of the first of them.
        seconds: time that compiling has taken so far, by module.
        announced: modules for which the message has been written.
        timer: writes the message after some time, unless it is cancelled.
        collects_garbage: whether the garbage collector was on before.
    """

    def __init__(self) -> None:
        """Begin with nothing compiled."""
        self.depth = 0
        self.began = 0.0
        self.module = ""
        self.seconds: dict[str, float] = defaultdict(float)
        self.announced: set[str] = set()
        self.timer: Timer | None = None
        self.collects_garbage = True

    def on_start(self, started: event.Event) -> None:
        """Begin to measure, if ``started`` is about a kernel that Python called."""
        self.depth += 1
        if self.depth > 1:
            return
        self.began = monotonic()
        self.module = started.data["dispatcher"].py_func.__module__
        self.collects_garbage = gc.isenabled()
        gc.disable()
        if self.module in _kernel_modules - self.announced and _CACHED and _is_main_process():
            delay = _SECONDS_BEFORE_MESSAGE - self.seconds[self.module]
            if delay <= 0:
                self.announce(self.module)
                return
            self.timer = Timer(delay, self.announce, (self.module,))
            self.timer.daemon = True  # It must not keep a process from ending.
            self.timer.start()

    def announce(self, module: str) -> None:
        """Write that kernels of ``module`` are being compiled."""
        # tqdm's own function for this leaves its progress bars intact.
        from tqdm.auto import tqdm

        self.announced.add(module)
        # Another process may compile other kernels of the same module: those of other features.
        how_often = "once per feature, kept for later runs"
        tqdm.write(f"compiling kernels for {module} ({how_often}) ...", file=sys.stderr)

    def on_end(self, ended: event.Event) -> None:
        """Add up the time and turn the garbage collector on, if the kernel is ready."""
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
if not _CACHED and _is_main_process():
    warnings.warn(
        f"{CACHE_FOLDER} is not writable: kernels are compiled anew in every process; set "
        "NUMBA_CACHE_DIR to a folder that is "
        f"(now: {os.environ.get('NUMBA_CACHE_DIR', 'not set')})",
        stacklevel=2,
    )


def kernel(function: F) -> F:
    """Compile ``function`` with numba on its first call: no Python objects, no GIL, one thread.

    The static type is that of the plain function, so that callers are checked. Unless `COMPILED`,
    the function is not compiled, so that a debugger can step through it: it returns the same, but
    slowly.
    """
    if not COMPILED:
        # Integers overflow without a warning, as in compiled code.
        return np.errstate(all="ignore")(function)
    return _cached(function, "never")


def inlined(function: F) -> F:
    """Mark ``function`` as a part of kernels: its body replaces each call to it.

    A call with array arguments counts their references, which takes longer than the work of a small
    helper. And a function that only one kernel calls compiles in less time as a part of it.
    """
    return _cached(function, "always")


def _ignore_constants(dispatcher: Any) -> None:
    """Compile a kernel once for all integers, although other kernels call it with constants.

    numba has a type of its own for each constant, and would compile the kernel again for it.
    """
    get_call_template = dispatcher.get_call_template

    def get_template(arguments: Any, keywords: Any) -> Any:
        argument_types = [_unliteral(argument) for argument in arguments]
        keyword_types = {name: _unliteral(argument) for name, argument in keywords.items()}
        return get_call_template(argument_types, keyword_types)

    dispatcher.get_call_template = get_template


def count_low_zeros(word: Any) -> Int:
    """Return how many zeros are below the lowest one of ``word``, a uint64 that is not 0.

    In kernels this is one instruction, to which numba has no way.
    """
    return np.uint64((int(word) & -int(word)).bit_length() - 1)


def count_high_zeros(word: Any) -> Int:
    """Return how many zeros are above the highest one of ``word``, a uint64 that is not 0."""
    return np.uint64(64 - int(word).bit_length())


def _count_zeros_by(function: Callable[..., Any], instruction: str) -> None:
    """Let kernels compile calls of ``function`` to an instruction of LLVM.

    Source: numba's documentation, "Low-level extension API".
    """

    def type_of_call(context: Any) -> Any:
        return lambda word: types.uint64 if word == types.uint64 else None

    def lower(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        is_never_zero = llvm_ir.Constant(llvm_ir.IntType(1), 1)
        return getattr(builder, instruction)(arguments[0], is_never_zero)

    type_callable(function)(type_of_call)
    lower_builtin(function, types.uint64)(lower)  # type: ignore[no-untyped-call]


_count_zeros_by(count_low_zeros, "cttz")
_count_zeros_by(count_high_zeros, "ctlz")

_ANALYSIS: Any = ir_utils  # numba does not annotate the functions of this module.


@register_pass(mutates_CFG=False, analysis_only=False)  # type: ignore[no-untyped-call]
class _DecideIsNone(FunctionPass):
    """Replaces ``x is None`` by False where the type of the argument ``x`` has no None.

    numba itself leaves out a branch for arrays if the argument is None. If it is an array, numba
    compiles the branch for None, too. After this pass, it compiles only what the kernel can run.
    Source: numba's documentation, "Customizing the compiler".
    """

    _name = "mapdata_decide_is_none"

    def __init__(self) -> None:
        """Numba makes a new object for each function."""
        super().__init__()  # type: ignore[no-untyped-call]

    def run_pass(self, state: Any) -> bool:
        """Replace the comparisons in the function of ``state``; return whether there were any."""
        function = state.func_ir
        is_changed = False
        for block in function.blocks.values():
            for statement in block.find_insts(ir.Assign):
                comparison = statement.value
                if _is_settled(comparison, function, state.args):
                    is_not_none = ir.Const(comparison.fn is operator.is_not, comparison.loc)  # type: ignore[no-untyped-call]
                    statement.value = is_not_none
                    definitions = function._definitions[statement.target.name]
                    definitions[definitions.index(comparison)] = is_not_none
                    is_changed = True
        return is_changed


def _is_settled(expression: Any, function: Any, argument_types: Any) -> bool:
    """Return whether ``expression`` asks if an argument is None whose type has no None."""
    if not (isinstance(expression, ir.Expr) and expression.op == "binop"):
        return False
    if expression.fn not in (operator.is_, operator.is_not):
        return False
    left, right = (
        _ANALYSIS.guard(_ANALYSIS.get_definition, function, side)
        for side in (expression.lhs, expression.rhs)
    )
    if not (isinstance(left, ir.Arg) and isinstance(right, ir.Const) and right.value is None):
        return False
    may_be_none = (types.NoneType, types.Optional, types.Omitted)
    return not isinstance(argument_types[left.index], may_be_none)


class _Compiler(CompilerBase):
    """numba's compiler, with `_DecideIsNone` before its first two passes that leave out branches.

    Before the second of them, `inlined` functions have become a part of the kernel.
    """

    def define_pipelines(self) -> list[Any]:
        """Return numba's passes with ours among them."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)  # type: ignore[no-untyped-call]
        passes.add_pass_after(_DecideIsNone, RewriteSemanticConstants)
        passes.add_pass_after(_DecideIsNone, InlineInlinables)
        passes.finalize()
        return [passes]


def _in_large_frame(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return ``function(*arguments)``, for which Python's stack has room without growing.

    Since version 3.11 Python keeps the frames of functions in blocks of 16 KiB. A loop that calls
    functions at the end of a block maps and unmaps the next block at each call. numba has such
    loops: it took a fifth of the time that compiling for terrain takes. A frame as large as this
    one gets a block of its own, in which the frames of the functions that it calls follow.
    """
    return function(*arguments)


_LARGE_FRAME = 70_000
"""Slots of a frame, of 8 bytes each. It gets the next power of two, 1 MiB, of which 450 KiB are
left for numba. Memory that is not used does not become memory of the process."""

_in_large_frame.__code__ = _in_large_frame.__code__.replace(co_stacksize=_LARGE_FRAME)


def _cached(function: F, inline: str) -> F:
    """Return ``function`` as a dispatcher of numba, which compiles it into the cache folder.

    ``inline`` is numba's option: "always" or "never".
    """
    _kernel_modules.add(function.__module__)
    # The wrappers that numba could compile for calls from C would take time, and nothing uses them.
    # numba's stub does not know the option.
    dispatcher = numba.njit(  # type: ignore[call-overload]
        nogil=True,
        error_model="numpy",
        no_cfunc_wrapper=True,
        inline=inline,
        pipeline_class=_Compiler,
    )(function)
    if COMPILED:
        _ignore_constants(dispatcher)
        dispatcher.compile = partial(_in_large_frame, dispatcher.compile)
    if _CACHED and COMPILED:
        # numba reads its cache folder from a setting of the whole process, when caching is enabled.
        previous_folder = _CONFIG.CACHE_DIR
        _CONFIG.CACHE_DIR = str(CACHE_FOLDER)
        try:
            dispatcher.enable_caching()
        finally:
            _CONFIG.CACHE_DIR = previous_folder
    return cast(F, dispatcher)
