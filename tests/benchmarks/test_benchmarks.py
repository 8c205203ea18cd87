"""The yardsticks of benchmarks/ find the same as `mapdata`, or their ratios would compare nothing;
and the one door to all tables. No timing.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from benchmarks import __main__ as door
from benchmarks import first_uses, graphs, loading, making, measure, naive, paths, terrain
from benchmarks.measure import Peer, Row
from mapdata import MapSpec, Movement, build, distance_field, generate, label
from mapdata.formats.movingai import read_terrain, terrain_grid
from mapdata.formats.movingai_scen import read_scen

MAPS = 20


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["paper", pytest.param("dungeon", marks=pytest.mark.slow)])
def test_naive_labels_equal_ours(preset: str) -> None:
    """Cells of every path, iterations and both matrices, on easy maps and on hard ones."""
    labels = label(generate(MapSpec.preset(preset), 3, range(MAPS)))
    for i in range(MAPS):
        assert naive.differences(labels, i) == []


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["paper", pytest.param("dungeon", marks=pytest.mark.slow)])
def test_careful_labels_equal_naive_ones(preset: str) -> None:
    """All of them; matrices as nested lists."""
    maps = generate(MapSpec.preset(preset), 3, range(MAPS))
    for i in range(MAPS):
        grid = maps.occupancy[i]
        seed_points = naive.seed_points_of(maps, i)
        careful = naive.careful_label(grid, seed_points)
        usual = naive.label(grid, seed_points)
        for name, one, other in zip(usual._fields, careful, usual, strict=True):
            np.testing.assert_equal(one, other, err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize("search", ["bfs", "astar"])
def test_a_difference_is_seen(search: str) -> None:
    """The comparison itself is no rubber stamp: one thing is broken, and that alone is named."""
    labels = label(generate(MapSpec.preset("paper"), 3, [0]))
    good = getattr(labels, search)
    broken = {
        "iterations": replace(good, iterations=good.iterations + 1),
        "route": replace(good, moves=good.moves ^ np.uint8(1)),
        "matrix": replace(good, costs=good.costs + 1),
    }
    for name, bad in broken.items():
        labels_with_it = replace(labels, **{search: bad})
        assert naive.differences(labels_with_it, 0) == [f"{search} {name}"]


def test_the_first_use_of_readme_is_its_training() -> None:
    """The program is the one that README prints the table of, with fewer steps."""
    program = first_uses.readme_training(1, 2)
    lines = set(first_uses.README.read_text(encoding="utf-8").splitlines())
    new = [line for line in program.splitlines() if line not in lines]
    assert [line.partition("  #")[0] for line in new] == ["SETS, STEPS = 1, 2"]
    assert "score_paths(test, paths)" in program


def test_a_difference_of_maps_is_seen() -> None:
    """One cell of wall that is free, or a free one that is wall."""
    labels = label(generate(MapSpec.preset("paper"), 3, [0]))
    packed = labels.maps.packed.copy()
    packed[0, 0, 0] ^= 1
    other_maps = replace(labels.maps, packed=packed)
    assert naive.differences(replace(labels, maps=other_maps), 0) == ["occupancy"]


def test_naive_labels_of_a_problem_without_a_path() -> None:
    """A wall between start and goal: one cell taken, no path, -1."""
    grid = np.array([[0, 1, 0]], np.uint8)
    start = (0, 0)
    goal = (0, 2)
    no_path = naive.Found([], 1)
    assert naive.bfs(grid, start, goal) == no_path
    assert naive.astar(grid, start, goal) == no_path
    apart = [[0, -1], [-1, 0]]
    assert naive.bfs_matrix(grid, [start, goal]).tolist() == apart
    assert naive.astar_matrix(grid, [start, goal]).tolist() == apart


WALLED = np.array(
    [
        [0, 0, 1, 0],
        [1, 0, 1, 0],
        [0, 0, 1, 0],
    ],
    np.uint8,
)
"""From (0, 0) five cells lead to (2, 0), and none to the last column."""


def problems_on_walled(goals: list[tuple[int, int]]) -> paths.ProblemSet:
    """Return the problems from (0, 0) to these goals."""
    grids = np.stack([WALLED] * len(goals))
    starts = np.zeros((len(goals), 2), np.int64)
    return paths.ProblemSet(grids, starts, np.array(goals), [0] * len(goals))


@pytest.mark.parametrize("peer", paths.PEERS, ids=lambda peer: peer.name)
def test_peers_find_paths_of_our_lengths(peer: Peer) -> None:
    """Between rooms, from a cell to itself, and where there is no path."""
    if peer.absence:
        pytest.skip(f"{peer.name}: {peer.absence}")
    maps = generate(paths.table_1(64), 1, range(3))
    between_rooms = paths.problems_of(maps, every_pair=True)
    paths.solve_with(peer, between_rooms)  # stops at another length

    solve = paths.solve_with(peer, problems_on_walled([(2, 0), (0, 0), (0, 3)]))
    lengths = [len(path) for path in solve()]
    assert lengths == [5, 1, 0]


def test_a_peer_that_finds_otherwise_stops_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its ratio would compare two things."""
    wrong = Peer("wrong", "numpy", "numpy", "")
    monkeypatch.setitem(paths.PEERS, wrong, lambda module, grid: lambda start, goal: [start])
    with pytest.raises(SystemExit, match="mapdata and wrong differ: 5 and 1 cells on problem 0"):
        paths.solve_with(wrong, problems_on_walled([(2, 0)]))


def test_absent_peers_are_skipped_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A missing package, and two that are there and do not import: one raises an error, the other
    needs a package that is missing.
    """
    (tmp_path / "broken_peer.py").write_text("raise ImportError('built for another machine')")
    (tmp_path / "needy_peer.py").write_text("import no_such_thing")
    monkeypatch.syspath_prepend(tmp_path)
    modules = ["numpy", "no_such_thing", "broken_peer", "needy_peer"]
    peers = [Peer(module, "pip-name", module, "call()") for module in modules]
    text = measure.to_text(
        "Title", [Row("work")], packages=["numpy"], notes=["a note"], peers=peers
    )
    expected = [
        "- a note",
        "- numpy: `call()`",
        "- no_such_thing: skipped, not installed",
        "- broken_peer: skipped, does not import: built for another machine",
        "- needy_peer: skipped, does not import: No module named 'no_such_thing'",
    ]
    assert "\n".join(expected) in text
    assert f"numpy {np.__version__}, pip-name not installed" in text


def test_each_row_says_which_peer_is_absent(monkeypatch: pytest.MonkeyPatch) -> None:
    """The row stays, with what is missing in its note."""
    monkeypatch.setattr(measure, "absence", lambda module: "not installed")
    monkeypatch.setattr(measure, "AT_LEAST", 1e-9)
    rows = paths.rows_of(64, count=2, few=3, rounds=1)
    fastest, *others = [f"{peer.name}: skipped" for peer in paths.PEERS]
    assert [row.note for row in rows] == [fastest, fastest, fastest, *others]
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
        (Row("growth of memory", "-0.4 MB", target="0 MB"), False),
        (Row("growth of memory", "+0.4 MB", target="0 MB"), True),
        (Row("a peer that is not installed", "11.9 us", target="15x"), False),
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
        title = f"{self.name} {quick} {parent}"
        return measure.to_text(title, [Row("first"), Row("second")], packages=(), notes=())


def test_one_command_runs_every_benchmark(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """All tables by default, those named otherwise; printed, and written as a page."""
    monkeypatch.setattr(door, "import_module", Fake)
    door.main([])
    printed = capsys.readouterr().out
    every = [f"## benchmarks.{name} False None" for name in door.TABLES]
    assert [line for line in printed.splitlines() if line.startswith("## ")] == every

    page = tmp_path / "benchmarks.md"
    asked = ["paths", "build", "--quick"]
    door.main([*asked, "--folder", str(tmp_path), "--write", str(page)])
    text = page.read_text(encoding="utf-8")
    assert text.startswith(
        "# Benchmarks\n\nThe command `python -m benchmarks paths build --quick` writes this page."
    )
    titles = [f"benchmarks.{name} True {tmp_path}" for name in ("paths", "build")]
    first, *tables = text.split("\n## ")
    assert [table.splitlines()[0] for table in tables] == [*titles, "How it is measured"]
    shown = [line.split("|")[1].strip() for line in first.splitlines() if line.startswith("|")]
    assert [shown[0], *shown[2:]] == ["work", "first", "first"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["speed"], "unknown table speed: expected labels, paths"),
        (["--write", "no/such/page.md"], "no folder no/such"),
    ],
)
def test_the_command_refuses_unknown_benchmarks(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2 before anything is measured."""
    with pytest.raises(SystemExit) as stop:
        door.main(arguments)
    assert stop.value.code == 2
    assert said in capsys.readouterr().err


def test_every_table_has_its_module() -> None:
    """And every module that measures is behind the door."""
    folder = Path(str(door.__file__)).parent
    modules = {path.stem for path in folder.glob("*.py")}
    without_table = {"__init__", "__main__", "measure", "naive"}
    assert modules - without_table == set(door.TABLES)
    for name in door.TABLES:
        assert callable(import_module(f"benchmarks.{name}").table)


TITLES = {
    "labels": "Labels on one core",
    "paths": "Paths",
    "graphs": "Beside graph libraries and planners in C++",
    "terrain": "Terrain",
    "making": "Making maps",
    "build": "Building a dataset",
    "first_uses": "First uses",
    "loading": "Loading",
    "bands": "Goals a map gets, under conditions",
    "scale": "A million maps",
}
"""What stands above each table."""


def test_the_page_has_every_table() -> None:
    """docs/benchmarks.md, as ``--write`` makes it of all tables: their titles in order, the first
    row of each above them, and the names of the tables below them.
    """
    page = (Path(__file__).parents[2] / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    assert page.startswith("# Benchmarks\n\nThe command `python -m benchmarks` writes this page.")
    assert list(TITLES) == list(door.TABLES)
    first, *sections = page.split("\n## ")
    assert [text.splitlines()[0] for text in sections] == [*TITLES.values(), "How it is measured"]
    assert door.results(sections[:-1]) in first
    assert f"single tables: {', '.join(door.TABLES)}." in " ".join(page.split())


def test_rows_of_terrain_say_which_peer_is_absent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Our times stay, with what is missing in the notes."""
    monkeypatch.setattr(measure, "absence", lambda module: "not installed")
    monkeypatch.setattr(measure, "AT_LEAST", 1e-9)
    for name, terrains in terrain.maps_of(1).items():
        assert terrains[0].shape == (64, 64)
        assert terrains[0].min() >= 1, name
    rows = terrain.rows_of("ones", terrain.maps_of(1)["ones"], 1)
    assert [row.note for row in rows] == [
        "scikit-image: skipped",
        "scikit-image: skipped",
        "pyastar2d: skipped",
    ]
    assert all(row.mapdata for row in rows)


@pytest.mark.parametrize("part", ["field", "path"])
def test_other_costs_on_terrain_stop_the_run(part: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A peer that finds other costs than ours is no peer."""
    ones = terrain.maps_of(1)["ones"]
    field = distance_field(1 - ones[0], (0, 0), terrain.MOVEMENT)
    wrong = {"field": float(part == "field"), "path": float(part == "path")}
    monkeypatch.setattr(terrain, "SCIKIT_IMAGE", Peer("scikit-image", "numpy", "numpy", ""))
    monkeypatch.setattr(terrain, "skimage_costs", lambda *_: field + wrong["field"])
    monkeypatch.setattr(terrain, "skimage_path_cost", lambda *_: float(field[3, 9]) + wrong["path"])
    with pytest.raises(SystemExit, match=f"mapdata and scikit-image differ in a {part}"):
        terrain.check_costs(ones, [(3, 9)], [(0, 0)])


SEARCHES = [
    (peer, connectivity, number)
    for peer, library in graphs.LIBRARIES.items()
    for connectivity in (4, 8)
    for number in range(len(library.searches(connectivity)))
]
"""The searches of graph libraries that labels stand beside."""


@pytest.mark.parametrize(
    ("peer", "connectivity", "number"), SEARCHES, ids=lambda value: getattr(value, "name", None)
)
def test_searches_of_libraries_find_our_costs(peer: Peer, connectivity: int, number: int) -> None:
    """Two rooms of map 47 have one seed point, and there is no path to the last column of a map."""
    if peer.absence:
        pytest.skip(f"{peer.name}: {peer.absence}")
    library = graphs.LIBRARIES[peer]
    search = library.searches(connectivity)[number]
    maps = generate(replace(MapSpec.preset("paper"), movement=Movement(connectivity)), 0, [47])
    cells = maps.seed_points[0, : maps.rooms[0]]
    assert len(np.unique(cells, axis=0)) < len(cells)
    for grid, seeds, expected in (
        (maps.occupancy[0], np.asarray(cells @ [64, 1], np.int64), label(maps).matrix("astar", 0)),
        (WALLED, np.array([0, 8, 3]), np.array([[0, 4, -1], [4, 0, -1], [-1, -1, 0]])),
    ):
        graph = library.build(peer.load(), grid, connectivity)
        found = search(peer.load(), graph, seeds, connectivity)
        np.testing.assert_allclose(np.where(np.isfinite(found), found, -1), expected, atol=1e-3)


def test_the_faster_search_of_a_library_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both are measured; moves of several costs have one search alone."""

    def measured(contestants: dict[str, object], rounds: int) -> dict[str, list[float]]:
        seconds = {"ours": 1.0, "graph": 4.0, "search 0": 3.0, "search 1": 2.0}
        return {name: [seconds[name]] * rounds for name in contestants}

    monkeypatch.setattr(graphs, "interleaved", measured)
    for connectivity, expected in ((4, 2.0), (8, 3.0)):
        generator = replace(MapSpec.preset("paper"), movement=Movement(connectivity))
        maps = generate(generator, 0, [47])
        seeds = [np.asarray(maps.seed_points[0, : maps.rooms[0]] @ [64, 1], np.int64)]
        grids = maps.occupancy
        times = graphs.library_times(graphs.SCIPY, maps, grids, seeds, connectivity, 1)
        assert times == {"ours": [1.0], "graph": [4.0], "search": [expected]}


def test_time_is_that_of_the_processor() -> None:
    """What waits takes no time, unless its clock is on the wall."""
    assert measure.seconds(lambda: time.sleep(0.02)) < 0.02
    assert measure.seconds(lambda: time.sleep(0.02), clock=time.perf_counter) >= 0.02


def test_warthog_gets_the_same_problems(tmp_path: Path) -> None:
    """The files that it reads have our map, starts, goals and costs; those without a path are left
    out.
    """
    ends, costs = graphs.solvable_ends_of(WALLED, Movement(4))
    assert 0 < len(ends) < 40
    scen = graphs.write_scenario(tmp_path, WALLED, ends, costs)
    np.testing.assert_array_equal(terrain_grid(read_terrain(tmp_path / "map.map")), WALLED)
    read = read_scen(scen)
    assert [(problem.start, problem.goal) for problem in read] == ends
    assert [float(problem.length) for problem in read] == costs


@pytest.mark.parametrize("program", ["warthog", "warthog-jps"])
def test_warthog_finds_our_costs(program: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a map of rooms, if it is there; rows say so where it is not."""
    grid = generate(MapSpec.preset("paper"), 3, [0]).occupancy[0]
    monkeypatch.setattr(graphs, "grids_of", lambda _: {"rooms": grid})
    searches = [search for search in graphs.WARTHOG_SEARCHES if search[0] == program]
    monkeypatch.setattr(graphs, "WARTHOG_SEARCHES", searches)
    what = "skipped" if shutil.which(program) is None else "equal costs"
    rows = graphs.warthog_rows(64, 1)
    assert [row.note for row in rows] == [f"Warthog, {search[1]}: {what}" for search in searches]
    assert all(bool(row.ratio) == (what == "equal costs") for row in rows)


@pytest.mark.skipif(sys.platform == "win32", reason="the program is a shell script")
def test_other_costs_of_warthog_stop_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program in its place that prints one cell too many."""
    _, costs = graphs.solvable_ends_of(WALLED, Movement(4))
    monkeypatch.setattr(graphs, "grids_of", lambda _: {"walled": WALLED})
    monkeypatch.setattr(
        graphs, "WARTHOG_SEARCHES", [("false-warthog", "astar4c", Movement(4), "A*")]
    )
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    for extra in (0, 1):
        lines = [
            "id\tnanos\tpcost",
            *(f"{k}\t1000\t{cost + extra}" for k, cost in enumerate(costs)),
        ]
        program = tmp_path / "false-warthog"
        program.write_text("#!/bin/sh\ncat <<'END'\n" + "\n".join(lines) + "\nEND\n")
        program.chmod(0o755)
        if extra:
            with pytest.raises(SystemExit, match="mapdata and Warthog, astar4c differ on walled"):
                graphs.warthog_rows(3, 1)
        else:
            (row,) = graphs.warthog_rows(3, 1)
            assert row.other == "1 us"


def test_readers_of_files_give_our_samples(tmp_path: Path) -> None:
    """By zarr and litdata, if they are there; a sample that is missing or another is seen."""
    build(tmp_path / "maps", MapSpec.preset("paper"), maps=30)
    tensors = loading.in_ram(tmp_path / "maps", 100)
    found = [
        *loading.zarr_readers(tmp_path, tensors),
        *loading.litdata_readers(tmp_path, tensors),
    ]
    present = [not peer.absence for peer in (loading.ZARR, loading.LITDATA)]
    assert len(found) == 2 * sum(present)

    turned = [tensor.flip(0) for tensor in tensors]
    loading.check_in_any_order(turned, tensors, "a reader")
    fewer = [tensor[1:] for tensor in tensors]
    other = [tensors[0] ^ 1, *tensors[1:]]
    for wrong in (fewer, other):
        with pytest.raises(SystemExit, match="mapdata and a reader differ"):
            loading.check_in_any_order(wrong, tensors, "a reader")
