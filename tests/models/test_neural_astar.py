"""Neural A*: its search is compared with a slow one, it learns, and it has a row in the table."""

from __future__ import annotations

import math
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.ndimage import label

from mapdata import (
    MapGenerator,
    Maze,
    Movement,
    OnlineMapDataset,
    ProblemSet,
    Random,
    check_path,
    distance_field,
    evaluate,
    search,
)
from mapdata.arrays import Bytes
from mapdata.evaluation import classical
from mapdata.limits import Cell
from mapdata.models import neural_astar
from mapdata.models.neural_astar import TRAINING_FIELDS, NeuralAstar
from mapdata.models.pretrained.model import load_model
from mapdata.models.pretrained.path_predictor import PathPredictor
from mapdata.movement import NEURAL_ASTAR
from mapdata.search import STEPS

MOVEMENTS = [NEURAL_ASTAR, Movement(8), Movement(4)]


def random_grids(count: int, side: int) -> Bytes:
    """Return maps with a quarter of their cells occupied; two opposite corners are free."""
    grids = (np.random.default_rng(3).random((count, side, side)) < 0.25).astype(np.uint8)
    grids[:, 0, 0] = 0
    grids[:, -1, -1] = 0
    return grids


def slow_search(
    grid: Bytes, costs: np.ndarray, start: Cell, goal: Cell, movement: Movement
) -> tuple[set[Cell], list[Cell]]:
    """Return the cells that the search of the paper expands, and its path, empty without one.

    It works on sets and dictionaries.
    """
    g = {start: 0.0}
    parent: dict[Cell, Cell] = {}
    frontier = {start}
    expanded: set[Cell] = set()

    def estimate(cell: Cell) -> float:
        down = abs(cell[0] - goal[0])
        right = abs(cell[1] - goal[1])
        if movement.connectivity == 4:
            h = float(down + right)
        else:
            h = max(down, right) + (movement.diagonal_cost - 1) * min(down, right)
        return float(g[cell] + h + 0.001 * math.hypot(down, right) + costs[cell])

    while frontier and goal not in expanded:
        cell = min(frontier, key=estimate)
        frontier.remove(cell)
        expanded.add(cell)
        for row, column in STEPS[: movement.connectivity].tolist():
            neighbour = (cell[0] + row, cell[1] + column)
            is_inside = 0 <= neighbour[0] < len(grid) and 0 <= neighbour[1] < len(grid)
            if not is_inside or grid[neighbour]:
                continue
            is_diagonal = row != 0 and column != 0
            cuts_corner = grid[cell[0] + row, cell[1]] or grid[cell[0], cell[1] + column]
            if is_diagonal and cuts_corner and not movement.corner_cutting:
                continue
            length = movement.diagonal_cost if is_diagonal else 1.0
            new_g = g[cell] + length * costs[cell]
            if neighbour not in expanded and new_g < g.get(neighbour, math.inf):
                g[neighbour] = new_g
                parent[neighbour] = cell
                frontier.add(neighbour)
    path = [goal] if goal in expanded else []
    while path and path[-1] != start:
        path.append(parent[path[-1]])
    return expanded, path[::-1]


@pytest.mark.parametrize("movement", MOVEMENTS, ids=str)
def test_the_search_expands_what_a_slow_one_does(movement: Movement) -> None:
    """In a batch of maps with and without a path, both searches expand the same cells and have the
    same parents.
    """
    grids = random_grids(60, 13)
    costs = np.random.default_rng(4).random(grids.shape, np.float32)
    starts = np.zeros((60, 2), np.int64)
    goals = np.full((60, 2), 12)
    expanded, parents = neural_astar.search(
        torch.from_numpy(costs),
        torch.from_numpy(grids[:, None]),
        torch.from_numpy(starts),
        torch.from_numpy(goals),
        movement,
        max_expansions=13 * 13,
    )
    solved = 0
    for k in range(60):
        cells, path = slow_search(grids[k], costs[k], (0, 0), (12, 12), movement)
        assert set(map(tuple, np.argwhere(expanded[k].numpy() == 1).tolist())) == cells
        solved += bool(path)
        for before, after in pairwise(path):
            number = int(parents[k, after[0] * 13 + after[1]])
            assert divmod(number, 13) == before
    assert 10 < solved < 60


@pytest.mark.slow
def test_without_guidance_it_is_the_search_that_it_is_compared_with() -> None:
    """With equal guidance costs it expands as many cells as the row "A* of Neural A*", except where
    ties are broken otherwise in 32-bit floats.
    """
    problems = ProblemSet.sample(MapGenerator.preset("maze"), 5, maps=12, movement=NEURAL_ASTAR)
    vanilla = classical(NEURAL_ASTAR)[-1]
    assert vanilla.name == "A* of Neural A*"
    grids, starts, goals = map(
        torch.tensor, (problems.grids[:, None], problems.starts, problems.goals)
    )
    costs = torch.ones(grids[:, 0].shape)
    max_expansions = grids[0].numel()
    expanded, _ = neural_astar.search(costs, grids, starts, goals, NEURAL_ASTAR, max_expansions)
    counts = expanded.sum(dim=(1, 2)).numpy()
    for k, count in enumerate(counts):
        start = tuple(problems.starts[k].tolist())
        goal = tuple(problems.goals[k].tolist())
        expected = vanilla.plan(problems.grids[k], start, goal).expansions
        assert count == pytest.approx(expected, rel=0.02, abs=2)


def test_the_gradient_is_that_of_the_shares() -> None:
    """It is the gradient of the softmax at each choice (equation 3), where g and the choices count
    as constants.
    """
    torch.manual_seed(0)
    grid = torch.from_numpy(random_grids(1, 6)[:, None])
    start, goal = torch.tensor([[0, 0]]), torch.tensor([[5, 5]])
    costs = torch.rand(1, 6, 6, requires_grad=True)
    weights = torch.rand(1, 6, 6)
    expanded, _ = neural_astar.search(costs, grid, start, goal, NEURAL_ASTAR, 36)
    (expanded * weights).sum().backward()
    assert costs.grad is not None

    # The same search step by step. ``constants`` are the costs in g, ``variables`` those in the
    # choices, which get the gradient.
    constants = costs.detach()[0].numpy()
    variables = costs.detach().clone().requires_grad_()
    cells, _ = slow_search(grid[0, 0].numpy(), constants, (0, 0), (5, 5), NEURAL_ASTAR)
    expanded_cells: list[Cell] = []
    g = {(0, 0): 0.0}
    total = torch.zeros(())
    while (5, 5) not in expanded_cells:
        frontier = sorted(set(g) - set(expanded_cells))
        scores = []
        for row, column in frontier:
            down = 5 - row
            right = 5 - column
            h = max(down, right) + 0.001 * math.hypot(down, right)
            f = (g[row, column] + h + variables[0, row, column]) / 2
            scores.append(-f / math.sqrt(6))
        shares = torch.stack(scores).softmax(dim=0)
        for share, cell in zip(shares, frontier, strict=True):
            # All cells of the frontier get the gradient of their shares, not only the chosen one.
            total = total + weights[0, cell[0], cell[1]] * share
        cell = frontier[int(shares.argmax())]
        expanded_cells.append(cell)
        for row, column in STEPS.tolist():
            neighbour = (cell[0] + row, cell[1] + column)
            if min(neighbour) < 0 or max(neighbour) >= 6 or neighbour in expanded_cells:
                continue
            if not grid[0, 0, neighbour[0], neighbour[1]]:
                new_g = g[cell] + float(constants[cell])
                g[neighbour] = min(g.get(neighbour, math.inf), new_g)
    assert set(expanded_cells) == cells
    total.backward()
    torch.testing.assert_close(costs.grad, variables.grad, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("movement", [NEURAL_ASTAR, Movement(8), Movement(4)])
def test_random_paths_are_shortest(movement: Movement) -> None:
    """Their cells, ordered by the distance from the start, are a path from start to goal, and its
    cost is the distance between both.
    """
    caves = MapGenerator.preset("cave")
    fields = ("map", "start", "goal", "optimal_moves")
    data = OnlineMapDataset(caves, length=20, fields=fields, problems="random", movement=movement)
    batch = data[:]
    paths = neural_astar.random_paths(batch.start, batch.optimal_moves)
    assert set(paths.unique().tolist()) == {0.0, 1.0}
    for k, path in enumerate(paths.numpy()):
        grid = batch.map[k, 0].numpy()
        start, goal = (tuple(end[k].tolist()) for end in (batch.start, batch.goal))
        from_start, to_goal = (distance_field(grid, end, movement) for end in (start, goal))
        cells = np.argwhere(path)
        index = (cells[:, 0], cells[:, 1])
        np.testing.assert_allclose(from_start[index] + to_goal[index], to_goal[start], rtol=1e-6)
        in_order = cells[np.argsort(from_start[index])]
        assert check_path(grid, in_order, movement) == pytest.approx(float(to_goal[start]))
        assert tuple(in_order[0]) == start
        assert tuple(in_order[-1]) == goal


def test_random_paths_make_all_optimal_moves() -> None:
    """Three first moves are optimal, and each of them is made by a third of 3,000 paths."""
    grid = np.zeros((3, 3), np.uint8)
    to_goal = distance_field(grid, (1, 2), NEURAL_ASTAR)
    moves = np.zeros((3, 3), np.uint8)
    for (row, column), bit in product(np.ndindex(3, 3), range(8)):
        neighbour = row + STEPS[bit, 0], column + STEPS[bit, 1]
        is_inside = min(neighbour) >= 0 and max(neighbour) < 3
        if is_inside and to_goal[neighbour] == to_goal[row, column] - 1:
            moves[row, column] |= 1 << bit
    optimal_moves = torch.from_numpy(moves).expand(3000, 1, 3, 3)
    starts = torch.tensor([1, 0]).expand(3000, 2)
    torch.manual_seed(0)
    paths = neural_astar.random_paths(starts, optimal_moves)
    middle = paths[:, :, 1].sum(dim=0)  # (3,), paths through each row of the middle column
    assert middle.sum() == 3000
    np.testing.assert_allclose(middle, 1000, atol=5 * math.sqrt(3000 * 2 / 9))


@pytest.fixture(scope="module")
def trained() -> NeuralAstar:
    """Return a model that was trained for 60 steps on 24 mazes."""
    torch.manual_seed(1)
    data = OnlineMapDataset(
        Maze((15, 15)),
        length=24,
        fields=TRAINING_FIELDS,
        problems=Random(distance=(8, None)),
        movement=NEURAL_ASTAR,
    )
    batch = data[:]
    model = NeuralAstar()
    optimizer = model.configure_optimizers()
    losses = []
    for _ in range(60):
        optimizer.zero_grad()
        loss = model.losses(batch)["loss"]
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert np.mean(losses[-5:]) < 0.65 * np.mean(losses[:5])
    return model.eval()


@pytest.mark.slow
def test_it_plans_where_there_is_a_path(trained: NeuralAstar, tmp_path: Path) -> None:
    """Plans are equal in batches and one by one, and before and after saving. Without a path all
    cells that can be reached are expanded.
    """
    trained.save(tmp_path / "weights.pt")
    again = load_model(tmp_path / "weights.pt", PathPredictor, NeuralAstar)
    assert isinstance(again, NeuralAstar)
    grids = random_grids(20, 21)
    starts = np.zeros((20, 2), np.int64)
    goals = np.full((20, 2), 20)
    searches = search.search_batch("bfs", grids, starts, goals, NEURAL_ASTAR)
    for planner in (trained, again):
        for k, plan in enumerate(planner.plan_batch(grids, starts, goals)):
            alone = planner.plan(grids[k], (0, 0), (20, 20))
            assert np.array_equal(alone.path, plan.path)
            assert alone.expansions == plan.expansions
            assert alone.prepared == plan.prepared == 21 * 21
            if searches.cost[k] < 0:
                assert plan.path.shape == (0, 2)
                components, _ = label(grids[k] == 0, np.ones((3, 3)))
                assert plan.expansions == (components == components[0, 0]).sum()
            else:
                assert plan.path[0].tolist() == [0, 0]
                assert plan.path[-1].tolist() == [20, 20]
                assert check_path(grids[k], plan.path, NEURAL_ASTAR) >= searches.cost[k]
    # After `fit` a model is in training mode, in which a batch norm depends on the batch.
    trained.train()
    before = {name: tensor.clone() for name, tensor in trained.state_dict().items()}
    in_training = trained.plan(grids[0], (0, 0), (20, 20))
    assert trained.training
    trained.eval()
    assert in_training.expansions == trained.plan(grids[0], (0, 0), (20, 20)).expansions
    for name, tensor in trained.state_dict().items():
        assert torch.equal(tensor, before[name]), name
    with pytest.raises(ValueError, match="start: "):
        trained.plan(np.eye(5, dtype=np.uint8), (0, 0), (4, 3))


@pytest.mark.slow
def test_its_row_is_in_the_table(trained: NeuralAstar) -> None:
    """After 60 steps it expands fewer cells than A* on mazes that were not in its training."""
    problems = ProblemSet.sample(Maze((15, 15)), 77, maps=40, movement=NEURAL_ASTAR)
    table = evaluate([trained], problems, bootstrap=1).set_index("planner")
    row = table[table["subset"] == "all"].loc["Neural A*"]
    assert row["success"] == 1
    assert row["p_exp"] > 0.05
    assert row["ms_batched"] > 0
