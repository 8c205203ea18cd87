"""Planners on terrain: what is refused, and the scores of their table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from helpers.examples import slow
from helpers.reference import Cell
from helpers.specs import MOVEMENTS

from mapdata import Plan, ProblemSet, astar, check_path, evaluate, search_batch
from mapdata.arrays import Bytes, Ints
from mapdata.evaluation import (
    Batched,
    GoalFieldAstar,
    JumpPointSearch,
    classical,
    score_paths,
    to_text,
)
from mapdata.evaluation.metrics import METRICS, TERRAIN_METRICS
from mapdata.evaluation.planners import BestFirst, Limit, Search
from mapdata.movement import NEURAL_ASTAR, Movement

OCTILE = Movement(8)


def tiles(count: int, movement: Movement = NEURAL_ASTAR, seed: int = 0) -> ProblemSet:
    """Return problems on terrain of 12 x 12 cells."""
    return ProblemSet.sample("tiles", seed, count, movement=movement)


def test_a_weight_whose_products_do_not_fit_into_64_bits_is_refused() -> None:
    """The smallest cost of a cell counts, since the heuristic has it as a factor."""
    terrain = np.full((64, 64), 200, np.uint8)
    grid = np.zeros_like(terrain)
    planner = BestFirst("weighted", OCTILE, 20)
    assert len(planner.plan(grid, (0, 0), (63, 63), terrain=terrain).path) == 64
    with pytest.raises(ValueError, match="too large"):
        replace(planner, weight=21).plan(grid, (0, 0), (63, 63), terrain=terrain)


def test_costs_on_terrain_that_are_too_high_are_refused_by_every_planner() -> None:
    """They are not exact from 1,048,576 on, where diagonal moves cost sqrt(2)."""
    terrain = np.full((1, 9000), 255, np.uint8)
    for planner in (BestFirst("weighted", OCTILE, 0.1), GoalFieldAstar("exact", OCTILE)):
        with pytest.raises(ValueError, match="problem 0: terrain: a path costs 1,048,"):
            planner.plan(terrain * 0, (0, 0), (0, 8999), terrain=terrain)
    path = (
        GoalFieldAstar("exact", Movement())
        .plan(terrain * 0, (0, 0), (0, 8999), terrain=terrain)
        .path
    )
    assert len(path) == 9000


@pytest.mark.parametrize(
    "planner",
    [
        Search("A*", OCTILE, "astar"),
        BestFirst("weighted A*", OCTILE, 2),
        GoalFieldAstar("exact", OCTILE),
        Limit("limit", OCTILE),
    ],
    ids=lambda planner: planner.name,
)
def test_terrain_that_does_not_fit_the_grid_is_refused(
    planner: Search | BestFirst | GoalFieldAstar | Limit,
) -> None:
    """Here an occupied cell has a cost."""
    with pytest.raises(ValueError, match="terrain: got 1 at"):
        planner.plan([[0, 1, 0]], (0, 0), (0, 2), terrain=[[1, 1, 1]])


# --- the table ----------------------------------------------------------------------------------


def row(table: pd.DataFrame, planner: str, subset: str = "all") -> pd.Series:
    """Return one row of a table."""
    rows = table[(table["planner"] == planner) & (table["subset"] == subset)]
    assert len(rows) == 1
    return rows.iloc[0]


@pytest.mark.parametrize("movement", [*map(slow, MOVEMENTS[:-1]), NEURAL_ASTAR], ids=str)
def test_the_table_of_classical_planners_on_terrain(movement: Movement) -> None:
    """Optimal planners have no regret, and those that do not see the terrain have one."""
    problems = tiles(40, movement, seed=8)  # a seed with which all problems are hard
    table = evaluate(classical(movement, terrain=True), problems, bootstrap=20)
    for name in ("Dijkstra", "A*", "A* with the exact goal field", "limit"):
        for end in ("", "_low", "_high"):
            assert row(table, name)[f"opt{end}"] == 1
            assert row(table, name)[f"regret{end}"] == 0
    assert row(table, "A*")["expansion_ratio"] == 1
    for name in ("BFS", "A* on mean cost"):
        assert row(table, name)["regret_low"] > 0.1
    assert (table["success"] == 1).all()
    assert "jump point search" not in set(table["planner"])
    text = to_text(table)
    assert "regret" in text
    # All problems are hard, so that a second block would repeat the first one.
    assert row(table, "A*", "hard")["n"] == len(problems)
    assert "hard: " not in text
    assert text.startswith("all: 40 problems, hardness at least 1.05\n")
    # With fewer hard problems the second block says something else, and it is kept.
    hard = table["subset"] == "hard"
    assert "\n\nhard: 39 problems" in to_text(table.assign(n=table["n"] - hard))


def test_the_scores_on_terrain_by_hand() -> None:
    """A path over the hill, another optimum than that of A*, and a path through a wall."""
    hill = np.array([[1, 9, 1], [1, 1, 1], [1, 1, 1]], np.uint8)
    wall = np.array([[2, 0, 2], [2, 2, 2], [2, 2, 2]], np.uint8)
    stack = np.stack([hill, np.full((3, 3), 4, np.uint8), wall])
    starts = np.zeros((3, 2), np.int64)
    goals = np.array([(0, 2), (2, 2), (0, 2)])
    grids = (stack == 0).astype(np.uint8)
    problems = ProblemSet(grids, starts, goals, Movement(), terrain=stack)
    assert problems.optimal.cost.tolist() == [4, 16, 8]
    expected_path = problems.optimal.cells[slice(*problems.optimal.offsets[1:3])].tolist()
    other_optimum = [(row, column) for column, row in expected_path]  # mirrored at the diagonal
    assert [list(cell) for cell in other_optimum] != expected_path
    paths: list[Sequence[Cell]] = [
        [(0, 0), (0, 1), (0, 2)],
        other_optimum,
        [(0, 0), (0, 1), (0, 2)],
    ]
    scores = row(score_paths(problems, paths, name="mine"), "mine")
    assert scores["success"] == 2 / 3
    assert scores["opt"] == 1 / 3
    assert scores["cost_ratio"] == pytest.approx((10 / 4 + 1) / 2, rel=1e-12)
    assert scores["regret"] == pytest.approx((10 / 4 + 1) / 2 - 1, rel=1e-12)
    assert np.isnan(scores[["expansion_ratio", "p_exp", "hmean", "ms"]].astype(float)).all()


def test_regret_is_the_mean_over_solved_problems_with_a_bootstrapped_interval() -> None:
    """The mean and its interval are those of numpy on each problem's true cost."""
    problems = tiles(300)
    table = evaluate([Search("blind", NEURAL_ASTAR, "astar", uses_terrain=False)], problems)
    assert problems.terrain is not None
    regrets = []
    for k, cost in enumerate(problems.optimal.cost):
        start, goal = problems.starts[k], problems.goals[k]
        path = astar(problems.grids[k], start, goal, NEURAL_ASTAR).path
        true_cost = check_path(problems.grids[k], path, NEURAL_ASTAR, terrain=problems.terrain[k])
        regrets.append(true_cost / cost - 1)
    scores = row(table, "blind")
    assert scores["regret"] == pytest.approx(np.mean(regrets), rel=1e-9)
    half_width = 1.96 * np.std(regrets) / 300**0.5
    assert scores["regret_low"] == pytest.approx(np.mean(regrets) - half_width, abs=0.01)
    assert scores["regret_high"] == pytest.approx(np.mean(regrets) + half_width, abs=0.01)
    assert scores["opt"] == np.mean(np.array(regrets) == 0)


def test_terrain_of_ones_gives_the_table_of_uniform_maps() -> None:
    """Apart from times and the column of the regret."""
    plain = ProblemSet.sample("dungeon", 77, 40, movement=OCTILE)
    ones = replace(plain, terrain=1 - plain.grids)
    planners = classical(OCTILE, terrain=True)
    expected = evaluate(planners, plain, bootstrap=20)
    table = evaluate(planners, ones, bootstrap=20)
    regret = [f"regret{end}" for end in ("", "_low", "_high")]
    assert table.columns.drop(regret).tolist() == expected.columns.tolist()
    assert table.columns.tolist().index("regret") == table.columns.tolist().index("hmean") + 1
    scores = [name for name in expected.columns if not name.startswith("ms")]
    pd.testing.assert_frame_equal(table[scores], expected[scores], check_exact=True)
    np.testing.assert_array_equal(table["regret"], table["cost_ratio"] - 1)


@dataclass
class Recording:
    """A planner that keeps the terrain it gets, writes to it, and walks nowhere."""

    seen: list[Bytes]
    name: str = "recording"

    def plan(self, grid: Bytes, start: Cell, goal: Cell, terrain: Bytes | None = None) -> Plan:
        """Keep the terrain."""
        assert terrain is not None
        self.seen.append(terrain.copy())
        terrain[:] = 0
        return Plan(np.array([start]), 1)


@dataclass
class RecordingInBatches(Recording):
    """The same, in batches as well."""

    batches: list[Bytes] = field(default_factory=list)
    name: str = "recording in batches"

    def plan_batch(
        self, grids: Bytes, starts: Ints, goals: Ints, terrain: Bytes | None = None
    ) -> list[Plan]:
        """Keep the terrain of the batch."""
        assert terrain is not None
        self.batches.append(terrain.copy())
        terrain[:] = 0
        return [Plan(start[None], 1) for start in starts]


class Blind(Batched):
    """A planner in batches that does not take terrain."""

    name = "blind"

    def plan_batch(self, grids: Bytes, starts: Ints, goals: Ints) -> list[Plan]:
        """Return the paths of A* on the grids."""
        return Search("A*", NEURAL_ASTAR, "astar").plan_batch(grids, starts, goals)


@pytest.mark.filterwarnings("ignore:.*none of its paths solves its problem")
def test_planners_get_the_terrain_if_they_take_it() -> None:
    """Each gets a copy of its own; those that do not take it plan on the grid alone."""
    problems = tiles(5)
    recording = Recording([])
    table = evaluate([recording, Blind(), *classical(NEURAL_ASTAR, terrain=True)], problems)
    assert problems.terrain is not None
    np.testing.assert_array_equal(recording.seen[1:], problems.terrain)
    assert row(table, "recording")["success"] == 0
    on_mean_cost = row(table, "A* on mean cost")
    for name in TERRAIN_METRICS:
        np.testing.assert_array_equal(row(table, "blind")[name], on_mean_cost[name])


@pytest.mark.filterwarnings("ignore:.*none of its paths solves its problem")
def test_batches_are_timed_with_their_terrain() -> None:
    """The first batch comes twice, each time with a copy of its own terrain."""
    problems = tiles(70)
    recording = RecordingInBatches([])
    evaluate([recording], problems)
    assert problems.terrain is not None
    first, *batches = recording.batches
    np.testing.assert_array_equal(first, batches[0])
    np.testing.assert_array_equal(np.concatenate(batches), problems.terrain)


def test_jump_point_search_on_terrain_is_refused() -> None:
    """The message says how to leave it out."""
    problems = tiles(3, OCTILE)
    with pytest.raises(ValueError, match=r"got terrain, .* classical\(movement, terrain=True\)"):
        evaluate([JumpPointSearch("jumps", OCTILE)], problems)
    with pytest.raises(ValueError, match="jump point search: got terrain"):
        evaluate(classical(OCTILE), problems)


def test_paths_on_predicted_costs_are_scored_on_the_true_ones() -> None:
    """Searches on the true terrain have no regret; their rows stand beside those of `evaluate`."""
    problems = tiles(30)
    ends = problems.starts, problems.goals
    assert problems.terrain is not None

    def scores(predicted: npt.NDArray[np.integer]) -> pd.Series:
        paths = search_batch("astar", problems.grids, *ends, NEURAL_ASTAR, terrain=predicted)
        return row(score_paths(problems, paths, name="predicted"), "predicted")

    exact = scores(problems.terrain)
    assert [exact[name] for name in TERRAIN_METRICS] == [1, 1, 1, 1, 0, 0, 0]
    rounded = scores(problems.terrain // 8)  # 8, 12, 53, 77, 92 become 1, 1, 6, 9, 11
    assert 0 < rounded["regret"] < 0.1
    assert 0 < rounded["opt"] < 1
    mean = scores(np.full_like(problems.terrain, 48))
    table = evaluate([Search("blind", NEURAL_ASTAR, "astar", uses_terrain=False)], problems)
    for name in ("opt", "regret", "regret_low", "regret_high"):
        assert mean[name] == row(table, "blind")[name]
    assert table.columns.tolist() == score_paths(problems, [[]] * 30).columns.tolist()


def test_paths_on_uniform_maps_are_scored_without_regret() -> None:
    """The row of A*'s own paths is that of `evaluate`."""
    problems = ProblemSet.sample("dungeon", 77, 30, movement=OCTILE)
    table = score_paths(problems, problems.optimal, name="A*", bootstrap=20)
    expected = evaluate([Search("A*", OCTILE, "astar")], problems, bootstrap=20)
    names = ["planner", "subset", "n", *METRICS, *(f"{name}_low" for name in METRICS)]
    pd.testing.assert_frame_equal(table[names], expected[names], check_exact=True)
    assert "regret" not in table


def test_wrong_numbers_of_paths_are_refused() -> None:
    """And no resample."""
    problems = tiles(3)
    with pytest.raises(ValueError, match="paths: got 2, expected one for each of 3"):
        score_paths(problems, [[(0, 0)]] * 2)
    with pytest.raises(ValueError, match="bootstrap: got 0"):
        score_paths(problems, problems.optimal, bootstrap=0)
