"""The tables of planners are made from a file of results, to which one command adds a planner."""

from __future__ import annotations

import json
import re
import shutil
from functools import partial
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
import torch
from helpers.pages import DOCS

from mapdata import MapGenerator, Movement, ProblemSet, evaluate
from mapdata.evaluation import GuidedSearch, classical, prior
from mapdata.evaluation.planners import BestFirst
from mapdata.models import MovePredictor

OWN_PLANNER = """
from mapdata import Plan
from mapdata.evaluation import Search


class Planner(Search):
    def __init__(self, movement):
        super().__init__("my planner", movement, "bfs")


class Twice:
    name = "my planner"

    def plan(self, grid, start, goal):
        plan = Search("BFS", MOVEMENT, "bfs").plan(grid, start, goal)
        return Plan(plan.path, 2 * plan.expansions)


from mapdata import MapGenerator, Movement

MOVEMENT = Movement(8)
planner = Twice()
"""


@pytest.fixture
def tables(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    """Return planner_tables.py with one set of five problems, in a folder with a page to fill."""
    monkeypatch.syspath_prepend(str(DOCS))
    import planner_tables

    monkeypatch.setattr(planner_tables, "SETS", {"maze-hard-5": ("maze", "")})
    monkeypatch.setattr(planner_tables, "FIRST_SETS", ["maze-hard-5"])
    monkeypatch.setattr(planner_tables, "all_planners", classical)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_module.py").write_text(OWN_PLANNER)
    page = "<!-- table differences -->\nold\n<!-- end -->\nb\n"
    (tmp_path / "planners.md").write_text(page)
    (tmp_path / "which_problems.md").touch()
    return planner_tables


def rows_of(folder: Path) -> pd.DataFrame:
    """Return the rows in a folder's file of results, by the names of the planners."""
    document = json.loads((folder / "planner_results.json").read_text())
    return pd.DataFrame(document["rows"]).set_index("planner")


@pytest.mark.slow
def test_one_command_adds_a_planner_to_the_results(
    tables: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its row is that of `evaluate`, beside those of the other planners; measured once more, it
    takes the place of the older row.
    """
    command = ["--folder", str(tmp_path), "--set", "maze-hard-5"]
    tables.main(command)
    others = rows_of(tmp_path)
    assert list(others.index) == [planner.name for planner in classical(Movement(8))]
    for name, factor in (("Planner", 1), ("planner", 2)):
        tables.main([*command, "--add", f"my_module:{name}"])
        rows = rows_of(tmp_path)
        assert list(rows.index) == [*others.index, "my planner"]
        expected = factor * rows.expansion_ratio["BFS"]
        assert rows.expansion_ratio["my planner"] == pytest.approx(expected, abs=1e-5)
        assert rows.opt["my planner"] == rows.opt["BFS"]
    printed = capsys.readouterr().out
    assert printed.count("| limit |") == 3  # the table of the set, after each of three commands
    assert printed.count("| my planner |") == 2

    problems = ProblemSet.sample("maze", 77, until_hard=5, movement=Movement(8))
    table = evaluate(classical(Movement(8)), problems)
    table = table[table.subset == "hard"].set_index("planner")
    for column in ("opt", "hmean", "hmean_low", "hmean_high", "look_ratio", "prepared_ratio"):
        np.testing.assert_allclose(others[column], table[column], atol=1e-6)
    document = json.loads((tmp_path / "planner_results.json").read_text())
    assert document["sets"]["maze-hard-5"]["hash"] == problems.content_hash
    commands = [run["command"] for run in document["runs"]]
    assert commands == [
        "python docs/planner_tables.py --set maze-hard-5",
        "python docs/planner_tables.py --set maze-hard-5 --add my_module:planner",
    ]
    assert {row["run"] for row in document["rows"]} == {0, 1}


@pytest.mark.slow
def test_the_row_without_a_network_is_measured_alone(
    tables: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """With --no-network no other row changes, and the file gets what the network adds to this row,
    as `evaluate` says it; the page shows it.
    """
    movement = Movement(8)
    network = BestFirst(tables.SEARCH, movement, weight=2)
    monkeypatch.setattr(tables, "all_planners", lambda rule: [*classical(rule), network])
    tables.main(["--folder", str(tmp_path), "--set", "maze-hard-5", "--no-network"])
    assert list(rows_of(tmp_path).index) == [tables.NO_NETWORK]
    document = json.loads((tmp_path / "planner_results.json").read_text())
    (difference,) = document["differences"]
    assert (difference["set"], difference["planner"]) == ("maze-hard-5", tables.SEARCH)
    assert len(document["runs"]) == 1

    problems = ProblemSet.sample("maze", 77, until_hard=5, movement=movement)
    planners = [*classical(movement), network]
    table = evaluate(planners, problems, difference_from=tables.NO_NETWORK)
    (row,) = table[(table.subset == "hard") & (table.planner == tables.SEARCH)].to_dict("records")
    columns = [column for column in difference if "_difference" in column]
    assert len(columns) == 6
    assert [difference[column] for column in columns] == pytest.approx(
        [row[column] for column in columns], abs=1e-6
    )
    tables.main(["--folder", str(tmp_path), "--set", "maze-hard-5"])
    page = (tmp_path / "planners.md").read_text()
    opt, expansions = difference["opt_difference"], difference["expansion_ratio_difference"]
    assert f"| {opt:+.3f} [" in page
    assert f"| {expansions:+.3f} [" in page


@pytest.mark.slow
def test_the_sample_is_measured_alone(
    tables: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """With --sample no other row changes; its row is that of `evaluate`, and the page shows it."""
    torch.manual_seed(0)
    model = MovePredictor()
    torch.nn.init.normal_(next(reversed(list(model.network.parameters()))), std=0.5)
    monkeypatch.setattr(MovePredictor, "load_from_checkpoint", lambda file, **_: model)
    monkeypatch.setattr(tables, "FIRST_SETS", ["maze-hard-5"])
    (tmp_path / "planners.md").write_text("<!-- table sample -->\nold\n<!-- end -->\n")
    command = ["--folder", str(tmp_path), "--set", "maze-hard-5"]
    tables.main([*command, "--sample", "moves.ckpt"])
    assert set(rows_of(tmp_path).index) == {tables.UNTRAINED, tables.SAMPLE}
    movement = Movement(8)
    problems = ProblemSet.sample("maze", 77, until_hard=5, movement=movement)
    planners = [
        GuidedSearch(tables.SAMPLE, movement, model.predict, trust=0.01),
        GuidedSearch(tables.UNTRAINED, movement, partial(prior, movement=movement), trust=0.01),
    ]
    rows = evaluate(planners, problems).query("subset == 'hard'").set_index("planner")
    assert rows["expansion_ratio"].nunique() == 2
    for planner in planners:
        for metric in ("opt", "expansion_ratio"):
            expected = pytest.approx(rows[metric][planner.name], abs=1e-5)
            assert rows_of(tmp_path)[metric][planner.name] == expected
    network = BestFirst(tables.SEARCH, movement, weight=2)
    monkeypatch.setattr(tables, "all_planners", lambda rule: [*classical(rule), network])
    tables.main(command)
    page = (tmp_path / "planners.md").read_text()
    assert "| maze-hard-5 | " in page


QUICK_SETS = ("narrow-4-hard-300", "mazes-cut-300")
"""Sets of few and small maps, which the quick run draws."""


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if name in QUICK_SETS else [pytest.mark.slow])
        for name, drawn in json.loads((DOCS / "planner_results.json").read_text())["sets"].items()
        if "seed" in drawn
    ],
)
def test_the_sets_of_the_tables_keep_their_problems(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each has the numbers and the hash of the file of results. The name says how it is drawn:
    preset, rule and number of hard problems.
    """
    monkeypatch.syspath_prepend(str(DOCS))
    import planner_tables

    drawn = json.loads((DOCS / "planner_results.json").read_text())["sets"][name]
    found = planner_tables.problems_of(name)
    assert found.content_hash == drawn["hash"]
    assert (len(found), found.hard.sum()) == (drawn["problems"], drawn["hard"])
    parts = re.fullmatch(r"(\w+?)(?:-(cut|4))?(?:-hard)?-(\d+)", name)
    assert parts is not None
    preset, rule, hard = parts.groups()
    assert found.hard.sum() == int(hard)
    expected = {"cut": Movement(8, corner_cutting=True), "4": Movement(4), None: Movement(8)}
    assert found.movement == expected[rule]
    if preset not in ("loops", "dungeon256"):
        generator = MapGenerator.preset("maze" if preset == "mazes" else preset)
        assert drawn["generator"] == json.loads(generator.to_json())


def test_rows_of_other_problems_are_dropped(tables: ModuleType, tmp_path: Path) -> None:
    """A set of the same name with another hash has none of the rows of the older set."""
    from planner_results import Results, this_run

    results = Results()
    for seed in (1, 2):
        problems = ProblemSet.sample("maze", seed, 3, movement=Movement(8))
        results.add_set("set", problems)
        planners = classical(Movement(8))[:seed]
        results.add_rows("set", evaluate(planners, problems), this_run("a command"))
    assert list(results.rows_of("set")) == ["BFS", "Dijkstra"]
    results.write(tmp_path / "results.json")
    assert Results.read(tmp_path / "results.json") == results


def test_the_page_is_made_from_the_file_of_results(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Writing them again changes nothing."""
    monkeypatch.syspath_prepend(str(DOCS))
    import planner_tables

    names = ("planner_results.json", "planners.md", "which_problems.md")
    for name in names:
        shutil.copy(DOCS / name, tmp_path / name)
    planner_tables.main(["--pages", "--folder", str(tmp_path)])
    for name in names:
        assert (tmp_path / name).read_text() == (DOCS / name).read_text(), name


@pytest.mark.parametrize(
    ("metric", "heading"), [("opt", "optimal"), ("expansion_ratio", "expansions")]
)
def test_the_tables_of_transfer_are_differences_from_no_network(
    metric: str, heading: str, tables: ModuleType, tmp_path: Path
) -> None:
    """From the file of results, without a training: each network beside none, on each family."""
    shutil.copy(DOCS / "planner_results.json", tmp_path)
    mark = f"<!-- table transfer-{metric} -->\nold\n<!-- end -->\n"
    (tmp_path / "which_problems.md").write_text(mark)
    tables.main(["--pages", "--folder", str(tmp_path)])
    page = (tmp_path / "which_problems.md").read_text()
    head, _, first, *lines = [line for line in page.splitlines() if line.startswith("|")]
    families = [cell.strip() for cell in head.split("|")[2:-1]]
    document = json.loads((DOCS / "planner_results.json").read_text())
    measured = {(row["planner"], row["set"]): row[metric] for row in document["rows"]}
    sets = [tables.TRANSFER_SETS[family] for family in families]
    without = [measured[tables.NO_NETWORK, name] for name in sets]
    cells = [f" {number:.2f} " for number in without]
    assert first.split("|")[1:-1] == [f" no network: {heading} ", *cells]
    assert len(lines) == 9
    for line in lines:
        training, *cells = (cell.strip() for cell in line.split("|")[1:-1])
        for name, base, cell in zip(sets, without, cells, strict=True):
            difference = measured[f"small network trained on {training}", name] - base
            value, low, high = map(float, re.findall(r"[-+][\d.]+", cell))
            assert value == pytest.approx(difference, abs=0.0051)
            assert low <= value <= high


def test_windows_of_maps_give_hard_problems(tables: ModuleType, tmp_path: Path) -> None:
    """The maps of a folder are measured on hard problems, whose grids are windows of the map."""
    import zero_shot

    rng = np.random.default_rng(0)
    grid = (rng.random((20, 30)) < 0.3).astype(np.uint8)
    lines = ["type octile", "height 20", "width 30", "map"]
    lines += ["".join(".@"[cell] for cell in row) for row in grid]
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "hall.map").write_text("\n".join(lines) + "\n")
    arguments = ["maps", "--size", "16", "--hard", "4", "--corner-cutting", "--add"]
    zero_shot.main([*arguments, "my_module:Planner", "--folder", str(tmp_path)])
    row = rows_of(tmp_path).loc["my planner"]
    assert (row["set"], row.n, row.success) == ("hall-16-cut-windows", 4, 1)

    movement = Movement(8, corner_cutting=True)
    problems = zero_shot.hard_problems("hall", grid, movement, 16, 4)
    assert problems is not None
    assert problems.hard.all()
    windows = np.lib.stride_tricks.sliding_window_view(grid, (16, 16)).reshape(-1, 16, 16)
    for window in problems.grids:
        assert (windows == window).all(axis=(1, 2)).any()
