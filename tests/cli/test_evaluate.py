"""The verb ``evaluate``: its tables equal those of `mapdata.evaluate`, and one's own planner is a
row of them.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.examples import slow

from mapdata import MapSpec, Movement, ProblemSet, Random, build, evaluate
from mapdata.cli import main
from mapdata.cli.evaluate import SHORT_TABLE
from mapdata.evaluation import TIMES, classical
from mapdata.evaluation.suite import FIRST_ROWS

DUNGEON = MapSpec.preset("dungeon")

MODULE = """
import sys

import numpy as np

from mapdata import Movement, Plan, astar
from mapdata.evaluation import CostPlanner


class Mine:
    name = "mine"

    def __init__(self, movement):
        self.movement = movement

    def plan(self, grid, start, goal):
        found = astar(grid, start, goal, self.movement)
        return Plan(found.path, found.iterations)


class CutsCorners:
    name = "cuts corners"

    def plan(self, grid, start, goal):
        found = astar(grid, start, goal, Movement(8, corner_cutting=True))
        return Plan(found.path, found.iterations)


class GivesUp(Mine):
    name = "gives up"

    def plan(self, grid, start, goal):
        return Plan(np.empty((0, 2), np.int64), 1)


class ReturnsAList(Mine):
    name = "lists"

    def plan(self, grid, start, goal):
        return [start, goal]


class Fails(Mine):
    name = "fails"

    def plan(self, grid, start, goal):
        raise ValueError("my own mistake")


class FailsLate(Mine):
    name = "fails late"
    calls = 0

    def plan(self, grid, start, goal):
        self.calls += 1
        if self.calls == 4:
            raise KeyError(start)
        return super().plan(grid, start, goal)


class FailsOnBatches(Mine):
    name = "fails on batches"

    def plan_batch(self, grids, starts, goals):
        raise ValueError("my batch")


class ReportsItsCalls(Mine):
    name = "reports its calls"
    calls = 0

    def plan(self, grid, start, goal):
        self.calls += 1
        print("call", self.calls, file=sys.stderr)
        return super().plan(grid, start, goal)


class Leaves(Mine):
    name = "leaves"

    def plan(self, grid, start, goal):
        raise SystemExit(0)


class TakesAMap(Mine):
    name = "takes a map"

    def plan(self, grid):
        return None


class Nameless(Mine):
    name = None


def make(movement):
    return Mine(movement)


def plan(grid, start, goal):
    return None


def takes_three(a, b, c):
    return Mine(a)


def diverged(movement):
    return CostPlanner("diverged", movement, lambda grids, *_: np.full(grids.shape, np.nan))


instance = Mine(Movement(8))
number = 3
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Write a module of planners into the working folder, and forget it afterwards."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "own_planners.py").write_text(MODULE)
    yield "own_planners"
    sys.modules.pop("own_planners", None)


def rows_of(file: Path) -> list[dict[str, object]]:
    """Return the rows of a table in a file, without times."""
    rows: list[dict[str, object]] = json.loads(file.read_text())
    times = re.compile("|".join(f"{name}(_low|_high)?$" for name in TIMES))
    return [{key: row[key] for key in row if not times.match(key)} for row in rows]


def short(movement: Movement, terrain: bool = False) -> list[str]:
    """Return the names of the classical planners that the command shows by default."""
    names = [planner.name for planner in classical(movement, terrain=terrain)]
    return [name for name in names if name in SHORT_TABLE]


@pytest.mark.parametrize("name", ["Mine", slow("make"), slow("instance")])
def test_a_planner_of_ones_own_is_a_row(
    module: str, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A class, a function and an object; here all are mapdata's A*, so the rows agree."""
    main(
        ["evaluate", "dungeon", "--maps", "9", "--planner", f"{module}:{name}", "--json", "a.json"]
    )
    rows = {(row["planner"], row["subset"]): row for row in rows_of(Path("a.json"))}
    assert list(dict.fromkeys(name for name, _ in rows)) == ["mine", *short(Movement(8))]
    for subset in ("all", "hard"):
        expected = {**rows["A*", subset], "planner": "mine"}
        assert rows["mine", subset] == expected
    out = capsys.readouterr().out
    assert "problems by seed 77" in out
    assert re.search(r"^ *mine 1\.000", out, re.MULTILINE)


@pytest.mark.slow
def test_a_file_a_dataset_and_a_preset(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each gives the table of its problems."""
    preset = ProblemSet.sample("dungeon", 77, 12, movement=Movement(8))
    preset.save(tmp_path / "set.npz")
    build(tmp_path / "maps", DUNGEON, maps=60, seed=9, shard_size=60, workers=1)
    dataset = ProblemSet.read(tmp_path / "maps", movement=Movement(4))
    json_file = tmp_path / "out.json"
    for arguments, problems in (
        ([str(tmp_path / "set.npz")], preset),
        (["dungeon", "--maps", "12"], preset),
        ([str(tmp_path / "maps"), "--connectivity", "4"], dataset),
    ):
        main(["evaluate", *arguments, "--full", "--json", str(json_file)])
        table = evaluate(classical(problems.movement), problems)
        table.to_json(tmp_path / "expected.json", orient="records")
        for row, expected in zip(
            rows_of(json_file), rows_of(tmp_path / "expected.json"), strict=True
        ):
            assert row == pytest.approx(expected)
        assert problems.content_hash[:12] in capsys.readouterr().out


def test_many_problems_on_one_map_for_a_robot(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As an imported map of a robot needs them: it is in the split train, and is one."""
    build(tmp_path / "site", DUNGEON, maps=1, seed=9, workers=1)
    sampled = ProblemSet.read(
        tmp_path / "site",
        movement=Movement(8),
        split="train",
        problems=Random(distance=(10, None), per_map=7),
        radius=0.15,
    )
    options = ["--split", "train", "--per-map", "7", "--radius", "0.15"]
    main(["evaluate", str(tmp_path / "site"), *options, "--json", str(tmp_path / "out.json")])
    assert rows_of(tmp_path / "out.json")[0]["n"] == 7
    assert sampled.content_hash[:12] in capsys.readouterr().out


def test_a_note_names_the_preset_that_a_folder_hides(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A dataset in the working folder that is named as a preset is what is taken."""
    build(tmp_path / "maze15", DUNGEON, maps=2, seed=9, workers=1)
    monkeypatch.chdir(tmp_path)
    main(["evaluate", "maze15", "--split", "train"])
    captured = capsys.readouterr()
    assert "note: maze15 is the dataset in the folder of this name, not the preset" in captured.err
    assert "of maze15" in captured.out


@pytest.mark.parametrize("option", ["--per-map 2", "--split val", "--radius 0.1"])
def test_a_file_has_its_own_problems(
    tmp_path: Path, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """What would choose others is refused."""
    ProblemSet.sample("dungeon", 77, 3).save(tmp_path / "set.npz")
    with pytest.raises(SystemExit):
        main(["evaluate", str(tmp_path / "set.npz"), *option.split()])
    flag = option.split(maxsplit=1)[0]
    assert f"{flag}: does nothing for {tmp_path / 'set.npz'}, a file" in capsys.readouterr().err


def test_terrain_has_its_own_planners(tmp_path: Path) -> None:
    """Those that take costs, and A* on mean cost."""
    file = tmp_path / "out.json"
    main(["evaluate", "tiles", "--maps", "3", "--json", str(file)])
    expected = short(Movement(8), terrain=True)
    assert expected[-1] == "A* on mean cost"
    assert [row["planner"] for row in rows_of(file)] == 2 * expected


def test_the_table_is_short_unless_all_of_it_is_asked_for(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """It fits into a terminal of 100 letters, and says how to see more."""
    main(["evaluate", "dungeon", "--maps", "3"])
    out = capsys.readouterr().out
    assert "weighted A* (2)" in out
    assert "weighted A* (3)" not in out
    table = [line for line in out.splitlines() if "±" in line]
    assert max(map(len, table)) <= 100
    more = len(classical(Movement(8))) - len(short(Movement(8)))
    assert f"--full shows {more} more classical planners, and all columns" in out
    main(["evaluate", "dungeon", "--maps", "3", "--full"])
    out = capsys.readouterr().out
    assert [name for name in ("weighted A* (3)", "hmean", "ms_batched") if name not in out] == []
    assert "--full" not in out


def test_the_short_table_names_classical_planners() -> None:
    """A name that no planner has would leave a row out silently."""
    names = [*classical(Movement(8)), *classical(Movement(8), terrain=True)]
    unknown = set(SHORT_TABLE) - {planner.name for planner in names}
    assert not unknown


def test_every_planner_of_ones_own_is_a_row(
    module: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """They come first, in their order, and a line says what became of the paths of each."""
    names = ("Mine", "CutsCorners", "GivesUp")
    flags = [word for name in names for word in ("--planner", f"{module}:{name}")]
    main(["evaluate", "dungeon", "--maps", "9", *flags, "--json", "a.json"])
    out, err = capsys.readouterr()
    assert "warning" not in err  # what it would say stands in these lines
    rows = rows_of(Path("a.json"))
    assert [row["planner"] for row in rows[:4]] == ["mine", "cuts corners", "gives up", "A*"]
    (refused,) = [row["refused"] for row in rows if row["planner"] == "cuts corners"][:1]
    assert "\nmine: all 9 problems solved\n" in out
    assert re.search(
        rf"^cuts corners: {refused} of 9 paths refused, the first of problem \d: move \d+, .*, "
        r"cuts a corner \(a Movement with corner_cutting=True allows it\)$",
        out,
        re.MULTILINE,
    )
    assert "\ngives up: no path for 9 of 9 problems\n" in out
    said = "the expansions of mine, cuts corners, gives up are what the planner states, unchecked"
    assert out.splitlines()[-3] == said
    assert "nan" not in out


@pytest.mark.slow
def test_a_part_of_a_suite(module: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The file has the rows of `evaluate_suite`; a search of one's own has no expansions."""
    flags = ["--suite", "carry-over-1", "--planner", f"{module}:Mine", "--json", "a.json"]
    main(["evaluate", "shelves-64", *flags])
    rows = rows_of(Path("a.json"))
    assert [row["planner"] for row in rows] == [
        "mine",
        *(planner.name for planner in classical(Movement(8)) if planner.name in FIRST_ROWS),
    ]
    assert {row["part"] for row in rows} == {"shelves-64"}
    assert (rows[0]["opt"], rows[0]["expansion_ratio"]) == (1, None)
    assert "shelves-64 (out): 200 problems, set 104e9ae304d2" in capsys.readouterr().out


def test_a_seed_of_ones_own_gives_other_problems(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a preset other maps, of a dataset other problems on the same maps."""
    build(tmp_path / "maps", DUNGEON, maps=60, seed=9, shard_size=60, workers=1)
    main(["evaluate", "dungeon", "--maps", "3", "--seed", "4711"])
    expected = ProblemSet.sample("dungeon", 4711, 3, movement=Movement(8))
    assert expected.content_hash[:12] in capsys.readouterr().out
    main(["evaluate", str(tmp_path / "maps"), "--seed", "4711"])
    expected = ProblemSet.read(tmp_path / "maps", movement=Movement(8), seed=4711)
    assert expected.content_hash[:12] in capsys.readouterr().out


def test_the_progress_bar_begins_after_the_first_call_of_each_planner(
    module: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Kernels are compiled in these calls: a bar that counts them is hours off."""
    main(["evaluate", "dungeon", "--maps", "3", "--planner", f"{module}:ReportsItsCalls"])
    err = capsys.readouterr().err
    assert err.index("call 1") < err.index("0/") < err.index("call 2")


def test_the_figure_is_written(module: str) -> None:
    """A picture of the hard problems, with the names of one's own planners."""
    flags = ["--planner", f"{module}:Mine", "--planner", f"{module}:GivesUp"]
    main(["evaluate", "dungeon", "--maps", "4", *flags, "--figure", "planners.svg"])
    words = re.findall("<!-- (.*) -->", Path("planners.svg").read_text())
    assert "mine" in words
    assert "not shown: gives up (solved none)" in words


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["dungeo"], "dungeo: there is no such file, dataset or preset; did you mean dungeon?"),
        (["no/such/dataset"], "no dataset at no/such/dataset"),
        (["no/such.npz"], "no/such.npz"),
        (["dungeon", "--maps", "0"], "maps: got 0"),
        (["dungeon", "--per-map", "0"], "per_map: got 0"),
        (["dungeon", "--split", "val"], "--split: the maps of the preset dungeon are new"),
        (["dungeon", "--json", "no/out.json"], "no/out.json: cannot be written"),
        (["dungeon", "--figure", "no/out.png"], "no/out.png: cannot be written"),
        (["dungeon", "--figure", "out.foo"], "out.foo: expected one of the endings"),
        (["dungeon", "--planner", "own_planners"], "got 'own_planners', expected MODULE:NAME"),
        (["dungeon", "--planner", "own_planners.py:Mine"], "expected the name of a module"),
        (["dungeon", "--planner", "missing:Mine"], "there is no module 'missing'"),
        (["dungeon", "--planner", "own_planners:Mina"], "has no 'Mina'; did you mean Mine?"),
        (["dungeon", "--planner", "own_planners:number"], "own_planners:number is no planner"),
        (
            ["dungeon", "--planner", "own_planners:takes_three"],
            "own_planners:takes_three makes no planner: missing a required argument: 'b'",
        ),
        (
            ["dungeon", "--planner", "own_planners:Nameless"],
            "expected an object with a text 'name'",
        ),
        (
            ["dungeon", "--planner", "own_planners:ReturnsAList"],
            "lists: plan returned list, expected a mapdata.Plan(path, expansions)",
        ),
        (
            ["dungeon", "--planner", "own_planners:plan"],
            "plan makes no planner: missing a required argument: 'start'",
        ),
        (["dungeon", "--planner", "own_planners:TakesAMap"], "TakesAMap.plan() takes 2 positional"),
        (
            [
                "dungeon",
                *("--planner", "own_planners:Mine"),
                *("--planner", "own_planners:make"),
            ],
            "planners: several are named mine, expected different names",
        ),
        ([], "expected PROBLEMS: a file, datasets, a preset, or --suite NAME"),
        (["--suite", "carry-over"], "name: got 'carry-over', expected"),
        (["bars-65", "--suite", "carry-over-1"], "parts: got 'bars-65', expected"),
        (["--suite", "carry-over-1", "--seed", "1"], "--seed: has no effect on a suite"),
        (
            ["--suite", "carry-over-1", "--connectivity", "4"],
            "--connectivity, --corner-cutting, --diagonal-cost: has no effect on a suite",
        ),
        (
            ["bars-64", "--suite", "carry-over-1", "--planner", "own_planners:ReturnsAList"],
            "lists: plan returned list, expected a mapdata.Plan(path, expansions)",
        ),
        (["dungeon", "--seed", "1", "--seed", "2"], "--seed: given twice, expected once"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_what_is_wrong_is_said_in_one_line(
    module: str, arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The exit code is 2, and nothing else is printed."""
    assert module
    with pytest.raises(SystemExit) as error:
        main(["evaluate", *arguments])
    captured = capsys.readouterr()
    assert (error.value.code, captured.out, captured.err.count("\n")) == (2, "", 1)
    assert message in captured.err


@pytest.mark.parametrize(
    ("name", "line", "last"),
    [
        ("Fails", 'raise ValueError("my own mistake")', "ValueError: my own mistake"),
        ("FailsLate", "raise KeyError(start)", "KeyError: (13, 32)"),
        ("Leaves", "raise SystemExit(0)", "SystemExit: 0"),
    ],
)
def test_an_error_of_ones_own_code_shows_its_line(
    module: str, name: str, line: str, last: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The traceback begins in that code, not in mapdata; the last line is the error."""
    with pytest.raises(SystemExit) as error:
        main(["evaluate", "dungeon", "--maps", "5", "--planner", f"{module}:{name}"])
    assert error.value.code == 2
    err = capsys.readouterr().err
    assert line in err
    assert "evaluation/metrics.py" not in err
    assert f"mapdata: {last}" in err.splitlines()[-1]


@pytest.mark.skipif(sys.version_info < (3, 11), reason="Python 3.10 has no notes of errors")
@pytest.mark.parametrize(
    ("name", "note"),
    [
        ("Fails", "(planner fails, problem 0)"),
        ("FailsLate", "(planner fails late, problem 2)"),
        ("FailsOnBatches", "(plan_batch of fails on batches, problems 0 to 4)"),
        ("Leaves", "(planner leaves, problem 0)"),
        ("diverged", "(planner diverged, problem 0)"),
    ],
)
def test_an_error_of_ones_own_code_names_its_planner(
    module: str, name: str, note: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of many planners in one command, the last line says which one failed, and where."""
    flags = ["--planner", f"{module}:Mine", "--planner", f"{module}:{name}"]
    with pytest.raises(SystemExit):
        main(["evaluate", "dungeon", "--maps", "5", *flags])
    assert capsys.readouterr().err.endswith(f" {note}\n")
