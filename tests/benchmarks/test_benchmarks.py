"""The yardsticks of benchmarks/ find the same as `mapdata`, or their ratios would compare nothing;
and the one door to all tables. No timing.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from benchmarks import __main__ as door
from benchmarks import making, measure, naive, paths
from benchmarks.measure import Peer, Row
from mapdata import MapSpec, generate, label

MAPS = 20


@pytest.mark.parametrize("preset", ["paper", "dungeon"])
def test_naive_labels_equal_ours(preset: str) -> None:
    """Cells of every path, iterations and both matrices, on easy maps and on hard ones."""
    labels = label(generate(MapSpec.preset(preset), 3, range(MAPS)))
    assert {i: naive.differences(labels, i) for i in range(MAPS)} == {i: [] for i in range(MAPS)}


@pytest.mark.parametrize("preset", ["paper", "dungeon"])
def test_careful_labels_equal_naive_ones(preset: str) -> None:
    """All of them; matrices as nested lists."""
    maps = generate(MapSpec.preset(preset), 3, range(MAPS))
    for i in range(MAPS):
        grid, seed_points = maps.occupancy[i], naive.seed_points_of(maps, i)
        careful, usual = naive.careful_label(grid, seed_points), naive.label(grid, seed_points)
        for one, other in zip(careful, usual, strict=True):
            np.testing.assert_equal(one, other)


def test_a_difference_is_seen() -> None:
    """The comparison itself is no rubber stamp."""
    labels = label(generate(MapSpec.preset("paper"), 3, [0]))
    bfs, astar = labels.bfs, labels.astar
    for name, broken in (
        ("bfs iterations", replace(labels, bfs=replace(bfs, iterations=bfs.iterations + 1))),
        ("bfs route", replace(labels, bfs=replace(bfs, moves=bfs.moves ^ np.uint8(1)))),
        ("astar matrix", replace(labels, astar=replace(astar, costs=astar.costs + 1))),
    ):
        assert naive.differences(broken, 0) == [name]


def test_no_path() -> None:
    """A wall between start and goal: one cell taken, no path, -1."""
    grid = np.array([[0, 1, 0]], np.uint8)
    assert naive.bfs(grid, (0, 0), (0, 2)) == naive.astar(grid, (0, 0), (0, 2)) == ([], 1)
    assert naive.bfs_matrix(grid, [(0, 0), (0, 2)]).tolist() == [[0, -1], [-1, 0]]
    assert naive.astar_matrix(grid, [(0, 0), (0, 2)]).tolist() == [[0, -1], [-1, 0]]


WALLED = np.array([[[0, 0, 1, 0], [1, 0, 1, 0], [0, 0, 1, 0]]], np.uint8)


@pytest.mark.parametrize("peer", paths.PEERS, ids=lambda peer: peer.name)
def test_peers_find_paths_of_our_lengths(peer: Peer) -> None:
    """Between rooms, from a cell to itself, and where there is no path."""
    if peer.absence:
        pytest.skip(f"{peer.name}: {peer.absence}")
    paths.solve_with(
        peer, paths.problems_of(generate(paths.table_1(64), 1, range(3)), every_pair=True)
    )
    grids = np.repeat(WALLED, 3, axis=0)
    problems = paths.Problems(
        grids, np.array([[0, 0]] * 3), np.array([[2, 0], [0, 0], [0, 3]]), [0] * 3
    )
    assert [len(path) for path in paths.solve_with(peer, problems)()] == [5, 1, 0]


def test_a_peer_that_finds_otherwise_stops_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its ratio would compare two things."""
    wrong = Peer("wrong", "numpy", "numpy", "")
    monkeypatch.setitem(paths.PEERS, wrong, lambda module, grid: lambda start, goal: [start])
    with pytest.raises(SystemExit, match="mapdata and wrong differ: 5 and 1 cells on problem 0"):
        paths.solve_with(wrong, paths.Problems(WALLED, np.array([[0, 0]]), np.array([[2, 0]]), [0]))


def test_absent_peers_are_skipped_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """A missing package, and one that is there and does not import."""
    monkeypatch.setitem(sys.modules, "broken", ModuleType("broken"))
    peers = [
        Peer(name, "pip-name", name, "call()") for name in ("numpy", "no_such_thing", "broken.part")
    ]
    text = measure.to_text(
        "Title", [Row("work")], packages=["numpy"], notes=["a note"], peers=peers
    )
    assert (
        "- numpy: `call()`\n- no_such_thing: skipped, not installed\n- broken.part: skipped, "
        in text
    )
    assert f"numpy {np.__version__}, pip-name not installed" in text


def test_each_row_says_which_peer_is_absent(monkeypatch: pytest.MonkeyPatch) -> None:
    """The row stays, with what is missing in its note."""
    monkeypatch.setattr(measure, "absence", lambda module: "not installed")
    monkeypatch.setattr(measure, "AT_LEAST", 1e-9)
    notes = [row.note for row in paths.rows_of(64, 2, 3, 1)]
    assert notes[2:] == [f"{peer.name}: skipped" for peer in paths.PEERS]
    assert making.PEER.absence == "not installed"


@pytest.mark.parametrize(
    ("row", "missed"),
    [
        (Row("a path", "11.9 us", "50.8 us", "4.3x", "15x"), True),
        (Row("a path", "11.9 us", "50.8 us", "1,502.1x", "15x"), False),
        (Row("labels", "59.5 ms", target="50 ms"), True),
        (Row("labels", "224 ms", target="0.3 s"), False),
        (Row("fields", "122,185 samples/s", target="200,000 samples/s"), True),
        (Row("fields", "204,480 samples/s", target="200,000 samples/s"), False),
        (Row("growth, side 64 to 128", ratio="3.9x and 4.1x", target="4x"), True),
        (Row("growth, side 64 to 128", ratio="3.9x and 3.7x", target="4x"), False),
        (Row("growth of memory", "+0.0 MB", target="0 MB"), False),
        (Row("pickle", "439 bytes", target="10,000 bytes"), False),
        (Row("no target", "1 s"), False),
    ],
)
def test_a_missed_target_is_marked(row: Row, missed: bool) -> None:
    """Ratios and rates are to be reached, times and sizes are limits."""
    assert row.is_missed == missed
    text = measure.to_text("Title", [row], packages=[], notes=[])
    assert (", missed |" in text) == missed


class Fake:
    """A module with a table."""

    def __init__(self, name: str) -> None:
        """Keep the name."""
        self.name = name

    def table(self, quick: bool, parent: str | None) -> str:
        """Return what was asked."""
        return f"## {self.name} {quick} {parent}\n"


def test_the_one_door(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """All tables by default, those named otherwise; printed, and written as a page."""
    monkeypatch.setattr(door, "import_module", Fake)
    door.main([])
    assert capsys.readouterr().out.split("\n")[0:-1:2] == [
        f"## benchmarks.{name} False None" for name in door.TABLES
    ]
    page = tmp_path / "benchmarks.md"
    door.main(["paths", "build", "--quick", "--folder", str(tmp_path), "--write", str(page)])
    text = page.read_text(encoding="utf-8")
    assert text.startswith("# Benchmarks\n\nWritten by `python -m benchmarks paths build --quick`.")
    assert text.endswith(
        f"## benchmarks.paths True {tmp_path}\n\n## benchmarks.build True {tmp_path}\n"
    )


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["speed"], "unknown table speed: expected labels, paths"),
        (["--write", "no/such/page.md"], "no folder no/such"),
    ],
)
def test_the_one_door_refuses(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2 before anything is measured."""
    with pytest.raises(SystemExit) as stop:
        door.main(arguments)
    assert stop.value.code == 2
    assert said in capsys.readouterr().err


def test_every_table_has_its_module() -> None:
    """And every module that measures is behind the door."""
    modules = {path.stem for path in Path(str(door.__file__)).parent.glob("*.py")}
    assert modules - {"__init__", "__main__", "measure", "naive"} == set(door.TABLES)
    for name in door.TABLES:
        assert callable(import_module(f"benchmarks.{name}").table)


def test_the_page_names_every_table() -> None:
    """docs/benchmarks.md, as it is by hand or as ``--write`` makes it."""
    page = (Path(__file__).parents[2] / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    assert page.startswith("# Benchmarks\n")
    assert page.startswith("# Benchmarks\n\nWritten by") or all(
        f"| `{name}` |" in page for name in door.TABLES
    )
