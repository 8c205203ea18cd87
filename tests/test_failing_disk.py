"""Each call of open, write, fsync, rename and mkdir fails, one after another, in what writes files.

Nothing partial stands where something good stood. The error is one line that names a file which the
user knows. The next run succeeds and leaves no litter.
"""

from __future__ import annotations

import io
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.builds import shard_name
from helpers.failing_disk import failing_disk

import mapdata.__main__ as door
from mapdata import MapSpec, Movement, ProblemSet, Terrain, build
from mapdata.cli import write_table
from mapdata.export import PROBLEM_FORMATS
from mapdata.formats.registry import functions_by_format
from mapdata.models import PathPredictor
from mapdata.shards import MANIFEST, read_manifest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")

SPEC = MapSpec((8, 8), (2, 3), (2, 3), (2, 3), passage_width=(1, 2), splits=(0.4, 0.3, 0.3))
RECIPE = f'{{"spec": {SPEC.to_json()}, "seed": 3}}'

Files = dict[str, bytes | None]
"""What a folder holds: the bytes of each file by its name, None for a folder."""

Action = Callable[[Path], str | None]
"""Does something in a folder; returns the one line of its error, None without an error."""


def files_in(folder: Path) -> Files:
    """Return what a folder holds, without the lock of a dataset."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
        if path.name != ".lock"
    }


def command(*arguments: object) -> Action:
    """Return the command ``mapdata`` with these arguments, in which @ stands for the folder."""

    def run(folder: Path) -> str | None:
        words = [str(argument).replace("@", str(folder)) for argument in arguments]
        errors = io.StringIO()
        code: object = 0
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "argv", ["mapdata", *words])
            # It would change how this process takes signals.
            patch.setattr(door, "exit_on_interrupt", lambda: None)
            try:
                with redirect_stderr(errors), redirect_stdout(io.StringIO()):
                    door.main()
            except SystemExit as stop:
                code = stop.code
        text = errors.getvalue()
        assert "Traceback" not in text
        lines = [line for line in text.splitlines() if line.startswith("mapdata: ")]
        assert (code, len(lines)) in [(0, 0), (2, 1)], text
        return lines[0] if lines else None

    return run


def call(function: Callable[[Path], object]) -> Action:
    """Return a call of Python, whose error is an `OSError` of one line."""

    def run(folder: Path) -> str | None:
        try:
            function(folder)
        except OSError as error:
            return str(error)
        return None

    return run


def check_what_is_left(folder: Path, before: Files, truth: Files) -> None:
    """Check a folder after a failure: each file is as it was before, or as it should become."""
    left = files_in(folder)
    for name, content in left.items():
        is_temporary = any(part.startswith(".") for part in Path(name).parts)
        if is_temporary or (name, content) in [*before.items(), *truth.items()]:
            continue
        # A manifest may list some of the shards; all else would be partial.
        assert Path(name).name == MANIFEST, f"{name} is partial"
        manifest = read_manifest(folder / Path(name).parent)
        names = [str(Path(name).parent / entry.name) for entry in manifest.shards]
        assert all(left[shard] in (before.get(shard), truth.get(shard)) for shard in names)
    lost = [name for name in before if name not in left and name in truth]
    assert not lost


def let_each_call_fail(
    folder: Path, begin: Path, action: Action, *, lasting: bool = False, only: str = ""
) -> set[str]:
    """Repeat an action, each time with another call that fails; return the calls that failed.

    Args:
        folder: where copies of the folder ``begin`` are made.
        begin: the state before the action.
        action: writes files.
        lasting: whether all later calls that write fail, too.
        only: the name of a call; then its first call is the only one that fails.
    """
    place = folder / "work"  # Files may hold the name of their folder, so it is always the same.
    shutil.copytree(begin, place)
    with failing_disk(place, -1) as disk:
        assert action(place) is None
    truth = files_in(place)
    before = files_in(begin)
    numbers = [disk.calls.index(only)] if only else range(len(disk.calls))
    failed = set()
    for number in numbers:
        shutil.rmtree(place)
        shutil.copytree(begin, place)
        with failing_disk(place, number, lasting=lasting) as disk:
            error = action(place)
        if disk.failed is None:  # Threads do not always make the same calls.
            assert error is None
            continue
        failed.add(disk.failed[0])
        where = f"call {number}, {disk.failed[0]} of {disk.failed[1]}: {error}"
        if error is None:
            assert files_in(place) == truth, where  # what failed was not needed
            continue
        assert "\n" not in error, where
        known = {place, *(place / name for name in [*before, *truth])}
        named = re.findall(r"'(/[^']*)'", error) or re.findall(r"^(?:mapdata: )?(/[^:]*): ", error)
        assert named, where
        assert all(Path(name) in known or name.endswith("/.lock") for name in named), where
        check_what_is_left(place, before, truth)
        assert action(place) is None, where
        assert files_in(place) == truth, where
    shutil.rmtree(place)
    return failed


@pytest.fixture(scope="module")
def empty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give an empty folder."""
    return tmp_path_factory.mktemp("empty")


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a folder with a dataset of two shards, a damaged one, grids to import, and files that
    are to be replaced.
    """
    folder = tmp_path_factory.mktemp("built")
    build(folder / "maps", SPEC, maps=20, seed=3, shard_size=12)
    damaged = Path(shutil.copytree(folder / "maps", folder / "damaged"))
    (damaged / shard_name(12, 20)).unlink()
    for name in ("map.png", "page.html", "set.npz", "model.pt", "table.csv", "table.json"):
        (folder / name).write_bytes(b"what stood here before")
    np.save(folder / "grids.npy", np.zeros((3, 8, 8), np.uint8))
    return folder


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Give the folder ``maps`` with the dataset that an export of a format needs, by the format."""
    folder = tmp_path_factory.mktemp("sources")
    tiles = Terrain((8, 8), movement=Movement(8, True, 1.0), obstacles=0, corners=True)

    def folder_of(name: str) -> Path:
        kind = "tiles" if name == "warcraft" else "rooms"
        if not (folder / kind).exists():
            spec = tiles if name == "warcraft" else SPEC
            build(folder / kind / "maps", spec, maps=20, seed=3, shard_size=12)
        return folder / kind

    return folder_of


SHARDS = ("--recipe", RECIPE, "--shard-size", 12, "--workers", 1)
BUILD = command("build", "@/maps", *SHARDS, "--maps", 20)
EXTEND = command("build", "@/maps", *SHARDS, "--maps", 30)

WRITES = {"open", "write", "fsync", "rename"}
"""The calls of a write that is atomic and outlives a power cut."""


@pytest.mark.slow
def test_a_build(empty: Path, tmp_path: Path) -> None:
    """Finished shards stay, and the manifest never lists a shard that is not there."""
    assert let_each_call_fail(tmp_path, empty, BUILD) == WRITES | {"mkdir"}


@pytest.mark.slow
def test_an_extension(built: Path, tmp_path: Path) -> None:
    """The old partial shard stays until the longer one has replaced it."""
    assert let_each_call_fail(tmp_path, built, EXTEND) >= WRITES


@pytest.mark.slow
def test_an_export(built: Path, tmp_path: Path) -> None:
    """The folder appears as a whole or not at all."""
    export = command("export", "@/maps", "@/out", "--format", "arrays", "--split", "val")
    assert let_each_call_fail(tmp_path, built, export) == {"open", "write", "mkdir", "rename"}


@pytest.mark.slow
def test_a_picture(built: Path, tmp_path: Path) -> None:
    """The picture that was there stays until the new one is whole."""
    show = command("show", "@/maps", "-o", "@/map.png")
    assert let_each_call_fail(tmp_path, built, show) == WRITES


@pytest.mark.slow
def test_saved_files(built: Path, tmp_path: Path) -> None:
    """Problem sets, weights and tables: the old file stays until the new one is whole."""
    problems = ProblemSet(
        np.zeros((1, 8, 8), np.uint8), np.array([[0, 0]]), np.array([[7, 7]]), Movement()
    )
    model = PathPredictor.pretrained()
    table = pd.DataFrame({"planner": ["A*"], "ms": [1.5]})

    def save(folder: Path) -> None:
        problems.save(folder / "set.npz")
        model.save(folder / "model.pt")
        write_table(table, str(folder / "table.csv"), str(folder / "table.json"))

    assert let_each_call_fail(tmp_path, built, call(save)) == WRITES


@pytest.mark.slow
@pytest.mark.parametrize(
    "action",
    [
        command("import", "@/grids.npy", "@/imported"),
        command("verify", "@/damaged", "--repair"),
        command("report", "@/maps", "-o", "@/page.html", "--maps", 2),
    ],
    ids=["import", "repair", "report"],
)
def test_a_failing_write(action: Action, built: Path, tmp_path: Path) -> None:
    """The same holds for the first write of what writes in the same ways."""
    assert let_each_call_fail(tmp_path, built, action, only="write") == {"write"}


@pytest.mark.slow
@pytest.mark.parametrize("action", [BUILD, EXTEND], ids=["build", "extend"])
def test_a_disk_that_stays_full(action: Action, empty: Path, built: Path, tmp_path: Path) -> None:
    """What is done after the first failure fails, too."""
    begin = empty if action is BUILD else built
    assert let_each_call_fail(tmp_path, begin, action, lasting=True) >= WRITES


FORMATS = [*PROBLEM_FORMATS, *functions_by_format("write")]


@pytest.mark.slow
@pytest.mark.parametrize("lasting", [False, True], ids=["once", "from-then-on"])
@pytest.mark.parametrize("name", FORMATS)
def test_an_export_of_each_format(
    name: str, lasting: bool, source: Callable[[str], Path], tmp_path: Path
) -> None:
    """As `test_an_export`; C code writes the files of Parquet, which are not seen here."""
    target = "@/out.npz" if name == "planning-datasets" else "@/out"
    export = command("export", "@/maps", target, "--format", name)
    failed = let_each_call_fail(tmp_path, source(name), export, lasting=lasting)
    assert failed >= {"open", "write", "mkdir", "rename"}


LIMITED = """
import resource, sys, tempfile
from pathlib import Path
import mapdata.export, mapdata.formats, mapdata.plotting.plot
from mapdata.cli import main

tempfile.gettempdir()  # tries to write a file, once
hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
for size in map(int, sys.argv[1].split(",")):
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        main(sys.argv[3:])
    except SystemExit as stop:
        assert stop.code == 2, stop.code
    resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
    left = [path.name for path in Path(sys.argv[2]).rglob("*.tmp")]
    assert not left, left
"""
"""The command under limits of the size of a file, which C code meets as a full disk."""


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_files_beyond_a_limit(name: str, source: Callable[[str], Path], tmp_path: Path) -> None:
    """Whoever writes the bytes: h5py, Pillow, pyarrow, numpy and zipfile."""
    place = Path(shutil.copytree(source(name), tmp_path / "work"))
    target = place / ("out.npz" if name == "planning-datasets" else "out")
    check_limits(place, target, "export", place / "maps", target, "--format", name)


@pytest.mark.slow
def test_other_files_beyond_a_limit(built: Path, tmp_path: Path) -> None:
    """A dataset, a picture, a page: what stood there stays."""
    place = Path(shutil.copytree(built, tmp_path / "work"))
    for target, *words in (
        ("maps", "build", place / "maps", *SHARDS, "--maps", 30),
        ("imported", "import", place / "grids.npy", place / "imported"),
        ("damaged", "verify", place / "damaged", "--repair"),
        ("map.png", "show", place / "maps", "-o", place / "map.png"),
        ("page.html", "report", place / "maps", "-o", place / "page.html", "--maps", 2),
    ):
        check_limits(place, place / target, *words)


def check_limits(place: Path, target: Path, *words: object) -> None:
    """Run a command under five limits, up to a byte less than its largest file; then without."""
    before = files_in(place)
    copy = Path(shutil.copytree(place, place.with_name("copy")))
    assert command(*(str(word).replace(str(place), str(copy)) for word in words))(copy) is None
    written = [content for name, content in files_in(copy).items() if content != before.get(name)]
    shutil.rmtree(copy)
    largest = max(len(content) for content in written if content is not None)
    sizes = ",".join(str(size) for size in (0, 1, largest // 3, 2 * largest // 3, largest - 1))
    program = [sys.executable, "-c", LIMITED, sizes, place, *words]
    done = subprocess.run(list(map(str, program)), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    errors = [line for line in done.stderr.splitlines() if line.startswith("mapdata: ")]
    assert len(errors) == 5, done.stderr
    for error in errors:
        assert error.startswith("mapdata: [Errno 27] ")
        assert f"File too large: '{target}" in error
        assert error.endswith(
            "'; free some room or choose another disk, and run the same command again"
        )
        assert ".mapdata.tmp" not in error
    left = files_in(place)
    assert {name: left[name] for name in before if Path(name).name != MANIFEST} == {
        name: content for name, content in before.items() if Path(name).name != MANIFEST
    }
    new = left.keys() - before.keys()
    assert all(Path(name).parts[0] == target.name for name in new), new
    assert command(*words)(place) is None
    assert not [name for name in files_in(place) if name.endswith(".mapdata.tmp")]
