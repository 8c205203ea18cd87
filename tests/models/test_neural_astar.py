"""Neural A*: its search beside a slow one, what it learns, and its row in the table."""

from __future__ import annotations

import math
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.ndimage import label

from mapdata import (
    Generator,
    Maze,
    Movement,
    OnlineMapDataset,
    Problems,
    Random,
    check_path,
    distance_field,
    evaluate,
    search,
)
from mapdata.arrays import Bytes
from mapdata.evaluation import classical
from mapdata.search import STEPS
from mapdata.spec import NEURAL_ASTAR, Cell
from models import neural_astar
from models.model import load_model
from models.neural_astar import TRAINING_FIELDS, NeuralAstar
from models.path_predictor import PathPredictor

MOVEMENTS = [NEURAL_ASTAR, Movement(8), Movement(4)]


def random_grids(count: int, side: int) -> Bytes:
    """Return maps with a quarter of their cells occupied, but for two opposite corners."""
    grids = (np.random.default_rng(3).random((count, side, side)) < 0.25).astype(np.uint8)
    grids[:, 0, 0] = 0
    grids[:, -1, -1] = 0
    return grids


def slow_search(
    grid: Bytes, costs: np.ndarray, start: Cell, goal: Cell, movement: Movement
) -> tuple[set[Cell], list[Cell]]:
    """Return the cells that the paper's search expands, and its path: sets and dictionaries."""
    way = {start: 0.0}
    parent: dict[Cell, Cell] = {}
    frontier = {start}
    expanded: set[Cell] = set()

    def estimate(cell: Cell) -> float:
        down, right = abs(cell[0] - goal[0]), abs(cell[1] - goal[1])
        if movement.connectivity == 4:
            least = float(down + right)
        else:
            least = max(down, right) + (movement.diagonal_cost - 1) * min(down, right)
        return float(way[cell] + least + 0.001 * math.hypot(down, right) + costs[cell])

    while frontier and goal not in expanded:
        cell = min(frontier, key=estimate)
        frontier.remove(cell)
        expanded.add(cell)
        for row, column in STEPS[: movement.connectivity].tolist():
            to = (cell[0] + row, cell[1] + column)
            if not (0 <= to[0] < len(grid) and 0 <= to[1] < len(grid)) or grid[to]:
                continue
            diagonal = row != 0 and column != 0
            sides = grid[cell[0] + row, cell[1]] or grid[cell[0], cell[1] + column]
            if diagonal and sides and not movement.corner_cutting:
                continue
            length = movement.diagonal_cost if diagonal else 1.0
            reached = way[cell] + length * costs[cell]
            if to not in expanded and reached < way.get(to, math.inf):
                way[to] = reached
                parent[to] = cell
                frontier.add(to)
    path = [goal] if goal in expanded else []
    while path and path[-1] != start:
        path.append(parent[path[-1]])
    return expanded, path[::-1]


@pytest.mark.parametrize("movement", MOVEMENTS, ids=str)
def test_the_search_expands_what_a_slow_one_does(movement: Movement) -> None:
    """In batches, with and without a path: the same cells, and the same parents."""
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


def test_without_guidance_it_is_the_search_that_it_is_compared_with() -> None:
    """Equal costs: as many expansions as A* of Neural A*, but for ties in floats of 32 bits."""
    problems = Problems.sample(Generator.preset("maze"), 5, maps=12, movement=NEURAL_ASTAR)
    vanilla = classical(NEURAL_ASTAR)[-1]
    assert vanilla.name == "A* of Neural A*"
    grids, starts, goals = map(
        torch.tensor, (problems.grids[:, None], problems.starts, problems.goals)
    )
    most = grids[0].numel()
    expanded, _ = neural_astar.search(
        torch.ones(grids[:, 0].shape), grids, starts, goals, NEURAL_ASTAR, most
    )
    counts = expanded.sum(dim=(1, 2)).numpy()
    for k, count in enumerate(counts):
        start, goal = tuple(problems.starts[k].tolist()), tuple(problems.goals[k].tolist())
        assert count == pytest.approx(
            vanilla.plan(problems.grids[k], start, goal).expansions, rel=0.02, abs=2
        )


def test_the_gradient_is_that_of_the_shares() -> None:
    """Of the softmax at each choice (equation 3), with the ways so far and the choices fixed."""
    torch.manual_seed(0)
    grid = torch.from_numpy(random_grids(1, 6)[:, None])
    start, goal = torch.tensor([[0, 0]]), torch.tensor([[5, 5]])
    costs = torch.rand(1, 6, 6, requires_grad=True)
    weights = torch.rand(1, 6, 6)
    expanded, _ = neural_astar.search(costs, grid, start, goal, NEURAL_ASTAR, 36)
    (expanded * weights).sum().backward()
    assert costs.grad is not None

    # the frontier and the ways of each step, from the values of shorter searches
    fixed = costs.detach()[0].numpy()
    cells, _ = slow_search(grid[0, 0].numpy(), fixed, (0, 0), (5, 5), NEURAL_ASTAR)
    taken: list[Cell] = []
    way = {(0, 0): 0.0}
    total = torch.zeros(())
    free = costs.detach().clone().requires_grad_()
    while (5, 5) not in taken:
        frontier = sorted(set(way) - set(taken))
        scores = []
        for row, column in frontier:
            down, right = 5 - row, 5 - column
            least = max(down, right) + 0.001 * math.hypot(down, right)
            scores.append(-(way[row, column] + least + free[0, row, column]) / (2 * math.sqrt(6)))
        shares = torch.stack(scores).softmax(dim=0)
        for share, cell in zip(shares, frontier, strict=True):
            # every cell of the frontier gets the gradient of its share, chosen or not
            total = total + weights[0, cell[0], cell[1]] * share
        cell = frontier[int(shares.argmax())]
        taken.append(cell)
        for row, column in STEPS.tolist():
            to = (cell[0] + row, cell[1] + column)
            if min(to) >= 0 and max(to) < 6 and not grid[0, 0, to[0], to[1]] and to not in taken:
                way[to] = min(way.get(to, math.inf), way[cell] + float(fixed[cell]))
    assert set(taken) == cells
    total.backward()
    torch.testing.assert_close(costs.grad, free.grad, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("movement", [NEURAL_ASTAR, Movement(8), Movement(4)])
def test_random_paths_are_shortest(movement: Movement) -> None:
    """Each leads from start to goal over cells of shortest paths, one for each distance."""
    caves = Generator.preset("cave")
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
        at = (cells[:, 0], cells[:, 1])
        np.testing.assert_allclose(from_start[at] + to_goal[at], to_goal[start], rtol=1e-6)
        in_order = cells[np.argsort(from_start[at])]
        assert check_path(grid, in_order, movement) == pytest.approx(float(to_goal[start]))
        assert tuple(in_order[0]) == start
        assert tuple(in_order[-1]) == goal


def test_random_paths_take_every_way() -> None:
    """Each of three first moves that are equally good in a third of 3,000 paths."""
    grid = np.zeros((3, 3), np.uint8)
    to_goal = distance_field(grid, (1, 2), NEURAL_ASTAR)
    moves = np.zeros((3, 3), np.uint8)
    for (row, column), bit in product(np.ndindex(3, 3), range(8)):
        to = row + STEPS[bit, 0], column + STEPS[bit, 1]
        if min(to) >= 0 and max(to) < 3 and to_goal[to] == to_goal[row, column] - 1:
            moves[row, column] |= 1 << bit
    many = torch.from_numpy(moves).expand(3000, 1, 3, 3)
    starts = torch.tensor([1, 0]).expand(3000, 2)
    torch.manual_seed(0)
    middle = neural_astar.random_paths(starts, many)[:, :, 1].sum(dim=0)  # of three rows
    assert middle.sum() == 3000
    np.testing.assert_allclose(middle, 1000, atol=5 * math.sqrt(3000 * 2 / 9))


@pytest.fixture(scope="module")
def trained() -> NeuralAstar:
    """A model after 60 steps of the same 24 mazes."""
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


def test_it_plans_where_there_is_a_path(trained: NeuralAstar, tmp_path: Path) -> None:
    """Alone and in batches, and after a file; without a path it has expanded all it can reach."""
    trained.save(tmp_path / "weights.pt")
    again = load_model(tmp_path / "weights.pt", PathPredictor, NeuralAstar)
    assert isinstance(again, NeuralAstar)
    grids = random_grids(20, 21)
    starts = np.zeros((20, 2), np.int64)
    goals = np.full((20, 2), 20)
    found = search.search_batch("bfs", grids, starts, goals, NEURAL_ASTAR)
    for planner in (trained, again):
        for k, plan in enumerate(planner.plan_batch(grids, starts, goals)):
            alone = planner.plan(grids[k], (0, 0), (20, 20))
            assert np.array_equal(alone.path, plan.path)
            assert alone.expansions == plan.expansions
            if found.cost[k] < 0:
                assert plan.path.shape == (0, 2)
                parts, _ = label(grids[k] == 0, np.ones((3, 3)))
                assert plan.expansions == (parts == parts[0, 0]).sum()
            else:
                assert plan.path[0].tolist() == [0, 0]
                assert plan.path[-1].tolist() == [20, 20]
                assert check_path(grids[k], plan.path, NEURAL_ASTAR) >= found.cost[k]
    # after `fit` a model is in training mode, in which a batch norm depends on the batch
    trained.train()
    before = {name: value.clone() for name, value in trained.state_dict().items()}
    in_training = trained.plan(grids[0], (0, 0), (20, 20))
    assert trained.training
    trained.eval()
    assert in_training.expansions == trained.plan(grids[0], (0, 0), (20, 20)).expansions
    for name, value in trained.state_dict().items():
        assert torch.equal(value, before[name]), name
    with pytest.raises(ValueError, match="start: got"):
        trained.plan(np.eye(5, dtype=np.uint8), (0, 0), (4, 3))


def test_its_row_stands_in_the_table(trained: NeuralAstar) -> None:
    """Sixty steps bring it below A*, on mazes that it has not seen."""
    problems = Problems.sample(Maze((15, 15)), 77, maps=40, movement=NEURAL_ASTAR)
    table = evaluate([trained], problems, bootstrap=1).set_index("planner")
    row = table[table["subset"] == "all"].loc["Neural A*"]
    assert row["success"] == 1
    assert row["p_exp"] > 0.05
    assert row["ms_batched"] > 0
