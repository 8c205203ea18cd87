"""The kernel cache: never stale, whichever source file was edited, and no need for a cache at
all.
"""

from __future__ import annotations

import ast
import gc
import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numba
import numpy as np
import pytest
from helpers import served_fields

import mapdata
from mapdata import jit
from mapdata.datasets import FIELDS
from mapdata.jit import count_high_zeros, count_low_zeros, kernel, source_hash
from mapdata.rng import philox4x32

PACKAGE = Path(mapdata.__file__).parent

CALLER = """
from mapdata.jit import kernel
from mapdata.rng import block

@kernel
def draw(seed, index):
    return block(seed, index, 0, 0, 0)
"""
"""A kernel that calls one of rng.py, as those of dungeon.py do, and compiles in a moment."""

DRAW = "import numpy, mapdata.caller\nprint(mapdata.caller.draw(numpy.uint64(1), numpy.uint64(2)))"

WORDS = """
import numpy as np
from mapdata.rng import philox4x32
print(*(f"{word:08x}" for word in philox4x32(*[np.uint64(0)] * 6)))
"""


class Copy:
    """A copy of the package's sources that can be edited, with a cache of its own."""

    def __init__(self, home: Path) -> None:
        """Copy the sources below ``home``."""
        self.home, self.cache = home, home / "cache"
        shutil.copytree(PACKAGE, home / "mapdata", ignore=shutil.ignore_patterns("__pycache__"))

    def edit(self, file: str, old: str, new: str) -> None:
        """Replace ``old`` in a source file."""
        path = self.home / "mapdata" / file
        source = path.read_text(encoding="utf-8")
        assert old in source
        path.write_text(source.replace(old, new), encoding="utf-8")

    def run(self, code: str, **variables: str) -> subprocess.CompletedProcess[str]:
        """Run ``code`` with the copy in place of the package."""
        environment = {
            name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")
        }
        environment |= {"PYTHONPATH": str(self.home), "XDG_CACHE_HOME": str(self.cache)}
        environment |= {"HOME": str(self.home), "LOCALAPPDATA": str(self.cache), **variables}
        command = [
            sys.executable,
            "-B",
            "-c",
            f"import mapdata\nassert {str(self.home)!r} in mapdata.__file__\n{code}",
        ]
        return subprocess.run(
            command, env=environment, cwd=self.home, capture_output=True, text=True, check=True
        )

    def cached(self) -> dict[str, int]:
        """Return the files of the cache and when they were written."""
        return {str(path): path.stat().st_mtime_ns for path in self.home.rglob("*.nb[ci]")}


@pytest.fixture
def copy(tmp_path: Path) -> Copy:
    """Give a copy of the package."""
    return Copy(tmp_path)


@pytest.mark.slow
def test_a_stale_kernel_is_never_served(copy: Copy) -> None:
    """An edit of rng.py changes what a cached kernel of another file gives; with numba's own cache
    it would not.
    """
    (copy.home / "mapdata" / "caller.py").write_text(CALLER, encoding="utf-8")
    true = "digest.hexdigest()[:16]"
    copy.edit("jit.py", true, '"same"')  # numba alone: the folder does not know the sources
    before = copy.run(DRAW).stdout
    copy.edit("rng.py", "0x9E3779B9", "0x9E3779BB")
    assert copy.run(DRAW).stdout == before, (
        "numba sees such edits itself: mapdata.jit may become simpler"
    )
    copy.edit("jit.py", '"same"', true)
    after = copy.run(DRAW).stdout
    assert after != before
    files = copy.cached()
    assert copy.run(DRAW).stdout == after
    assert copy.cached() == files, "the second run compiled again"


@pytest.mark.slow
def test_parts_of_kernels_are_cached_where_python_calls_them(copy: Copy) -> None:
    """`read_problems` calls `block` and `bounded`: a second process compiles nothing."""
    program = """
import numpy as np
from mapdata.rng import MAP, block, bounded
word = block(np.uint64(1), np.uint64(2), 0, MAP, 0)[0]
print(bounded(word, 0, 9))
"""
    drawn = copy.run(program).stdout
    files = copy.cached()
    assert all(any(name in file for file in files) for name in (".block-", ".bounded-"))
    second_run = copy.run(program)
    assert second_run.stdout == drawn
    assert second_run.stderr == ""
    assert copy.cached() == files


@pytest.mark.slow
def test_without_a_cache_kernels_still_work(copy: Copy) -> None:
    """A cache folder that cannot be made is a warning, not an error."""
    copy.cache.write_text("not a folder", encoding="utf-8")
    if sys.platform == "darwin":
        (copy.home / "Library").write_text("not a folder", encoding="utf-8")
    done = copy.run(WORDS)
    assert done.stdout == "6627e8d5 e169c58d bc57ac4c 9b00dbd8\n"
    assert "is not writable: kernels are compiled anew in every process" in done.stderr
    assert copy.cached() == {}


@pytest.mark.slow
def test_long_compiling_is_announced_by_module(copy: Copy) -> None:
    """One line for each module whose kernels take long, none when the cache has them."""
    copy.edit("jit.py", "_SECONDS_BEFORE_MESSAGE = 0.5", "_SECONDS_BEFORE_MESSAGE = 1e6")
    assert copy.run(WORDS).stderr == ""
    copy.edit("jit.py", "_SECONDS_BEFORE_MESSAGE = 1e6", "_SECONDS_BEFORE_MESSAGE = 0.0")
    code = "mapdata.generate(mapdata.MapSpec(), 0, [0])"
    assert copy.run(code).stderr.splitlines() == [
        f"compiling kernels for mapdata.generators.{module} "
        "(once per feature, kept for later runs) ..."
        for module in ("splits", "rooms")
    ]
    assert copy.run(code).stderr == ""


def test_compiling_is_announced_when_patience_ends(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not at once but after half a second, for all kernels of a module together."""
    waits: list[tuple[float, str]] = []

    class Timer:
        """Notes what it would do, and when."""

        daemon = False

        def __init__(self, seconds: float, function: object, arguments: tuple[str]) -> None:
            waits.append((seconds, *arguments))

        def start(self) -> None:
            """Do nothing."""

        cancel = start

    clock = iter([10.0, 10.2, 20.0, 20.5, 30.0, 31.0, 40.0, 41.0])
    monkeypatch.setattr(jit, "Timer", Timer)
    monkeypatch.setattr(jit, "monotonic", lambda: next(clock))
    listener = jit._CompileListener()
    started: Any = SimpleNamespace(data={"dispatcher": philox4x32})
    for _ in range(4):  # 0.2, 0.5, 1 and 1 seconds
        listener.on_start(started)
        listener.on_start(started)  # what the kernel calls
        assert not gc.isenabled()
        listener.on_end(started)
        listener.on_end(started)
        assert gc.isenabled()
    assert waits == [(0.5, "mapdata.rng"), (pytest.approx(0.3), "mapdata.rng")]
    line = "compiling kernels for mapdata.rng (once per feature, kept for later runs) ...\n"
    assert capsys.readouterr().err == line


@pytest.mark.slow
def test_workers_do_not_repeat_what_to_set(copy: Copy) -> None:
    """Of a cache folder that cannot be made one process speaks."""
    (copy.home / "without").write_text("a file", encoding="utf-8")
    worker = (
        "import multiprocessing\n"
        "from mapdata import jit\n"
        "worker = multiprocessing.get_context('spawn').Process(target=jit.cache_home)\n"
        "worker.start()\n"
        "worker.join()\n"
        "assert worker.exitcode == 0"
    )
    done = copy.run(worker, NUMBA_CACHE_DIR=str(copy.home / "without"))
    assert done.stderr.count("is not writable") == 1
    assert "set NUMBA_CACHE_DIR to a folder that is" in done.stderr


@pytest.mark.slow
def test_kernels_as_plain_python(copy: Copy, tmp_path: Path) -> None:
    """With NUMBA_DISABLE_JIT, for a debugger, labels and batches are the same."""
    mapdata.build(tmp_path / "maps", mapdata.MapSpec(), maps=3)
    code = (
        "from mapdata.shards import content_hash\n"
        "labels = mapdata.label(mapdata.generate(mapdata.MapSpec(), 0, range(10)))\n"
        "print(content_hash(labels))\n"
        f"print(mapdata.MapDataset({str(tmp_path / 'maps')!r}, problems='random')[:].path.tolist())"
    )
    done = copy.run(code, NUMBA_DISABLE_JIT="1")
    content, paths = done.stdout.splitlines()
    assert content == "356538d522b09c70e056be7ed6e395c79c2ae7e4b60549dac6914ade3b53fd87"
    served = mapdata.MapDataset(tmp_path / "maps", problems="random")[:]
    assert paths == str(served.path.tolist())
    assert done.stderr == ""


# --- which sources count ------------------------------------------------------------------------


def package_of(folder: Path, **sources: str) -> Path:
    """Write a package with these modules."""
    folder.mkdir(exist_ok=True)
    for name, source in sources.items():
        (folder / f"{name}.py").write_text(source, encoding="utf-8")
    return folder


def test_the_hash_covers_all_kernels(tmp_path: Path) -> None:
    """Any edit of a file with kernels, its name included, gives another folder; other files do
    not.
    """
    sources = {
        "one": "@kernel\ndef f(): ...",
        "two": "K = 1\n@kernel\ndef g(): ...",
        "plain": "x = 1",
    }
    known = source_hash(package_of(tmp_path / "a", **sources))
    assert source_hash(package_of(tmp_path / "b", **sources)) == known
    assert source_hash(package_of(tmp_path / "c", **(sources | {"plain": "x = 2"}))) == known
    changes = [
        {"one": "@kernel\ndef f(): return 1"},
        {"two": "K = 2\n@kernel\ndef g(): ..."},
        {"plain": "@kernel\ndef h(): ..."},
        {"one": sources["two"], "two": sources["one"]},
    ]
    hashes = {
        source_hash(package_of(tmp_path / f"d{k}", **(sources | change)))
        for k, change in enumerate(changes)
    }
    assert len(hashes | {known}) == 1 + len(changes)


def kernels_of(tree: ast.Module) -> Iterator[ast.FunctionDef]:
    """Yield the functions that are compiled."""
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    compiled = {ast.unparse(call.args[0]) for call in calls if ast.unparse(call.func) == "kernel"}
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and node.name in compiled:
            yield node
        elif isinstance(node, ast.FunctionDef):
            parts = [part for decorator in node.decorator_list for part in ast.walk(decorator)]
            if {part.id for part in parts if isinstance(part, ast.Name)} & {
                "kernel",
                "inlined",
                "intrinsic",
                "njit",
                "vectorize",
            }:
                yield node


@pytest.mark.slow
def test_kernels_use_nothing_that_the_hash_does_not_cover() -> None:
    """Every file with compiled code is hashed, and so is every file that compiled code takes names
    from.
    """
    files = {
        ".".join(path.relative_to(PACKAGE).with_suffix("").parts): path
        for path in PACKAGE.rglob("*.py")
    }
    covered = {
        name
        for name, path in files.items()
        if {b"@kernel", b"@inlined"} & set(path.read_bytes().split())
    }
    assert {"rng", "generators.rooms", "search.labels", "shards.content"} <= covered
    for name, path in files.items():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        compiled = list(kernels_of(tree))
        if not compiled:
            continue
        assert name in covered, f"{path} has compiled code and no kernel, so that it is not hashed"
        taken = {
            alias.asname or alias.name: node.module.removeprefix("mapdata.")
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom)
            and node.module
            and node.module.startswith("mapdata.")
            for alias in node.names
        }
        for function in compiled:
            body = (part for statement in function.body for part in ast.walk(statement))
            used = {part.id for part in body if isinstance(part, ast.Name)}
            sources = {taken[name] for name in used & set(taken)} - {"arrays", "jit"}
            assert sources <= covered, f"{path}: {function.name} uses names of {sources - covered}"


def test_the_cache_folder_is_named_by_the_sources() -> None:
    """What is running uses the folder of its own sources."""
    assert jit.CACHE_FOLDER.name == f"kernels-{source_hash(PACKAGE)}"
    assert jit.CACHE_FOLDER.parent.name == "mapdata"


def test_a_kernel_keeps_numbas_setting() -> None:
    """The process-wide cache folder of numba stays what it was, for other people's functions."""

    def twice(value: np.int64) -> np.int64:
        return value + value

    before = vars(numba.config)["CACHE_DIR"]
    kernel(twice)
    after = vars(numba.config)["CACHE_DIR"]
    assert after == before


def test_constants_are_no_flavours_of_their_own() -> None:
    """What a kernel calls with constants, and Python with numbers, is compiled once."""

    @kernel
    def add(value: jit.Int, weights: tuple[jit.Int, jit.Int], is_shifted: bool) -> jit.Int:
        return value + weights[0] + (weights[1] if is_shifted else 0)

    both = (2, 3)

    @kernel
    def caller(value: jit.Int) -> jit.Int:
        return add(7, both, True) + add(value, (value, 5), False)

    assert caller(10) == 12 + 20
    assert add(1, (2, 3), True) == 6
    if jit.COMPILED:
        assert len(vars(add)["overloads"]) == 1


def test_a_kernel_has_only_the_branch_of_its_argument() -> None:
    """What numba could not compile for an argument does no harm in the branch for None."""

    @kernel
    def sum_or_zero(numbers: Any) -> Any:
        if numbers is None:
            return numbers.there_is_no_such_thing()  # type: ignore[attr-defined]
        return numbers.sum()

    @kernel
    def zero_or_length(numbers: Any) -> Any:
        if numbers is not None:
            return numbers.there_is_no_such_thing()
        return 0

    assert sum_or_zero(np.arange(4)) == 6
    assert zero_or_length(None) == 0
    for function, argument in ((sum_or_zero, None), (zero_or_length, np.arange(4))):
        with pytest.raises(numba.TypingError, match="there_is_no_such_thing"):
            function(argument)


def test_an_argument_that_may_be_none_keeps_both_branches() -> None:
    """An argument is decided by its value if its type has None."""

    @kernel
    def is_given(number: Any) -> Any:
        return number is not None

    @kernel
    def pass_on(number: int) -> Any:
        return is_given(number if number > 0 else None)

    assert (pass_on(1), pass_on(-1)) == (True, False)


@pytest.mark.skipif(sys.platform != "linux", reason="counts page faults")
def test_zeros_below_and_above_the_ones_of_a_word() -> None:
    """Compiled and not: of all words with one or two ones."""

    @kernel
    def count(word: Any) -> Any:
        return count_low_zeros(word), count_high_zeros(word)

    for low in range(64):
        for high in range(low, 64):
            word = np.uint64(1 << low | 1 << high)
            assert count(word) == (low, 63 - high)
            assert (count_low_zeros(word), count_high_zeros(word)) == (low, 63 - high)


def test_calls_do_not_map_memory_again_and_again() -> None:
    """Wherever a loop of calls begins on Python's stack, numba has room below a large frame."""

    def loop() -> None:
        for _ in range(1000):
            nothing()

    def nothing() -> None:
        pass

    def at_depth(depth: int) -> None:
        if depth:
            at_depth(depth - 1)
        else:
            loop()

    def page_faults(depth: int) -> int:
        before = resource.getrusage(resource.RUSAGE_THREAD).ru_minflt
        jit._in_large_frame(at_depth, depth)
        return resource.getrusage(resource.RUSAGE_THREAD).ru_minflt - before

    # Without the large frame there are more than 1,000 page faults at one of these depths.
    page_faults(300)  # touches the memory for the first time
    assert max(page_faults(depth) for depth in range(300)) < 200


@pytest.mark.slow
def test_all_fields_are_those_of_plain_python(tmp_path: Path) -> None:
    """Compiled kernels neither wrap around, nor read beyond an array, where Python would not."""
    program = [sys.executable, served_fields.__file__, str(tmp_path / "plain.npz")]
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    subprocess.run(program, env=environment, check=True, capture_output=True)
    with np.load(tmp_path / "plain.npz") as file:
        plain = dict(file)
    compiled = dict(served_fields.served_fields())
    assert compiled.keys() == plain.keys()
    assert len(compiled) == 4 * len(FIELDS) - 1
    for name, values in compiled.items():
        assert values.dtype == plain[name].dtype, name
        np.testing.assert_array_equal(values, plain[name], err_msg=name)
