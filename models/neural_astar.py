"""Neural A*: a network that guides A*, trained through the search with one path per problem.

Yonetani, Taniai, Barekatain, Nishimura, Kanezaki: Path Planning using Neural A* Search, ICML 2021,
arXiv 2009.07476 (https://github.com/omron-sinicx/neural-astar). A network gives every cell a
guidance cost in (0, 1). A* with these costs should expand the cells of the path, and no others:

    import pytorch_lightning as pl
    from mapdata import MapDataModule
    from mapdata.models.neural_astar import TRAINING_FIELDS, NeuralAstar

    model = NeuralAstar()
    data = MapDataModule(
        "data/mazes",
        fields=TRAINING_FIELDS,
        problems="random",
        movement=model.movement,
        batch_size=100,
    )
    pl.Trainer(max_epochs=50).fit(model, data)

docs/planners.md compares it with the published results; docs/reference/models.md has the command.

This file reads from top to bottom: search, network, training, planner. All of it is torch: each
step of the search is a few operations on tensors of B maps, so that gradients flow through it.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from torch import Tensor, nn

from mapdata import Movement, Sample
from mapdata.arrays import Bytes, Ints
from mapdata.evaluation import Plan
from mapdata.search import STEPS

from .pretrained.geometry import cell_numbers, check_problems, heuristic, legal_moves, offsets
from .pretrained.learned_planners import LearnedPlanner
from .pretrained.model import Tensors

TRAINING_FIELDS = ("map", "start", "goal", "optimal_moves")
"""The fields of a training batch."""

FAR = 1e9
"""More than the cost of any path."""

# --- search -------------------------------------------------------------------------------------


def search(
    costs: Tensor,
    occupied: Tensor,
    starts: Tensor,
    goals: Tensor,
    movement: Movement,
    max_expansions: int,
) -> tuple[Tensor, Tensor]:
    """Search B maps at once with guidance costs (section 3.2 of the paper).

    The cell of least f in the frontier is expanded next:

        f = (g + h + cost) / 2

        g       sum over the moves of a path to the cell of (guidance cost of the cell that the move
                leaves) * (length of the move)
        h       cost to the goal on an empty map, plus 0.001 * straight distance to the goal
        cost    guidance cost of the cell

    The factor 1/2 is that of the authors' code. The choice of a cell is a softmax over the frontier
    whose largest element counts as 1 (equation 3): g has no gradient, but the choices have one.

    A map that is finished keeps choosing its goal until all maps of the batch are finished. Its
    other cells get gradients from that, as in the authors' code.

    Args:
        costs: (B, H, W), guidance costs.
        occupied: (B, 1, H, W), 0 free and anything else occupied.
        starts: (B, 2), cells.
        goals: (B, 2), cells.
        movement: how one moves.
        max_expansions: largest number of cells that are expanded.

    Returns:
        Which cells were expanded, (B, H, W), 0 or 1 and differentiable in ``costs``; and the number
        of each cell's parent, or -1, (B, H * W + 1).
    """
    rows, columns = costs.shape[1:]
    # Cells are numbered row by row. One more number stands for nowhere: illegal moves lead there,
    # and it is chosen when the frontier has no other cell.
    nowhere = rows * columns
    batch = torch.arange(len(costs), device=costs.device)  # (B,)
    start = cell_numbers(starts, occupied)  # (B,)
    goal = cell_numbers(goals, occupied)  # (B,)
    legal = F.pad(legal_moves(occupied, movement).flatten(2), (0, 1))  # (B, moves, cells)
    moves = torch.tensor(STEPS[: movement.connectivity], device=costs.device)  # (moves, 2)
    lengths = torch.where(moves.prod(dim=1) == 0, 1.0, movement.diagonal_cost)  # (moves,)
    steps = moves[:, 0] * columns + moves[:, 1]  # (moves,), in cell numbers

    down, right = offsets(goals, occupied.shape[2:])  # (B, H, 1) and (B, 1, W)
    # Of cells with equal cost to the goal, those that are nearer in a straight line come first, as
    # in the authors' code.
    h = heuristic(down, right, movement) + 0.001 * torch.hypot(down, right)  # (B, H, W)
    h_and_costs = F.pad((h + costs).flatten(1), (0, 1))  # (B, cells)
    guidance = F.pad(costs.detach().flatten(1), (0, 1))  # (B, cells)
    g = torch.full_like(guidance, math.inf)  # (B, cells)
    g[:, nowhere] = FAR
    g[batch, start] = 0
    frontier = g < math.inf  # (B, cells)
    parents = torch.full_like(g, -1, dtype=torch.long)  # (B, cells)
    expanded = torch.zeros_like(guidance)  # (B, cells)
    temperature = math.sqrt(columns)  # as in the authors' code
    for _ in range(max_expansions):
        scores = (g + h_and_costs) / (-2 * temperature)  # (B, cells), -f / temperature
        shares = scores.masked_fill(~frontier, -math.inf).softmax(dim=1)  # (B, cells)
        cell = shares.argmax(dim=1)  # (B,)
        choice = F.one_hot(cell, nowhere + 1)  # (B, cells)
        # What is added has the value of ``choice`` and the gradient of ``shares``.
        expanded = (expanded + choice - shares.detach() + shares).clamp(0, 1)
        is_finished = (cell == goal) | (cell == nowhere)  # (B,)
        if is_finished.all():
            break
        # An expanded cell leaves the frontier, except for the last one of a finished map, which is
        # chosen again in the next step.
        frontier[batch, cell] = is_finished

        neighbours = (cell[:, None] + steps).clamp(0, nowhere)  # (B, moves)
        move_costs = lengths * guidance[batch, cell, None]  # (B, moves)
        new_g = g[batch, cell, None] + move_costs  # (B, moves)
        old_g = g.gather(1, neighbours)  # (B, moves)
        # A neighbour that was reached but left the frontier was expanded: it is not opened again.
        is_open = frontier.gather(1, neighbours) | (old_g == math.inf)
        is_better = legal[batch, :, cell] & is_open & (new_g < old_g)  # (B, moves)
        neighbours = neighbours.where(is_better, nowhere)
        g.scatter_(1, neighbours, new_g.where(is_better, FAR))
        parents.scatter_(1, neighbours, cell[:, None].expand_as(neighbours))
        frontier.scatter_(1, neighbours, True)
    return expanded[:, :nowhere].unflatten(1, (rows, columns)), parents


def random_paths(starts: Tensor, optimal_moves: Tensor) -> Tensor:
    """Return the cells of a shortest path of each problem, (B, H, W), 1 there and 0 elsewhere.

    Where several moves of a cell are optimal the path makes a random one of them, as in the
    authors' data.

    Args:
        starts: (B, 2), cells.
        optimal_moves: (B, 1, H, W), bit k of a cell is set where move k is optimal.
    """
    moves = torch.tensor(STEPS, device=starts.device)  # (8, 2)
    numbers = torch.arange(len(moves), device=starts.device)  # (8,)
    is_optimal = (optimal_moves[:, 0, :, :, None].int() >> numbers) & 1  # (B, H, W, 8), 0 or 1
    # Optimal moves get a random number of 1 to 2, all others 0.
    priorities = is_optimal * (1 + torch.rand(is_optimal.shape, device=starts.device))
    move = priorities.argmax(dim=3)  # (B, H, W)
    has_move = is_optimal.any(dim=3, keepdim=True)  # (B, H, W, 1), not at the goal
    steps = moves[move] * has_move  # (B, H, W, 2), (0, 0) at the goal
    paths = torch.zeros_like(is_optimal[..., 0], dtype=torch.float)  # (B, H, W)
    batch = torch.arange(len(starts), device=starts.device)  # (B,)
    cells = starts
    while True:
        index = (batch, *cells.unbind(1))
        if paths[index].all():
            return paths  # all paths have reached their goals, where they stay
        paths[index] = 1
        cells = cells + steps[index]


# --- network and training -----------------------------------------------------------------------


class NeuralAstar(LearnedPlanner):
    """Predicts a guidance cost in (0, 1) for every cell, and plans with it.

    A batch has the fields `TRAINING_FIELDS`, with the movement of the model.

    Args:
        connectivity: number of moves, 4 or 8.
        corner_cutting: whether diagonal moves may pass beside occupied cells.
        diagonal_cost: cost of a diagonal move, sqrt(2) or 1; the movement of the paper is 8, True
            and 1.
        learning_rate: learning rate of RMSprop.
    """

    name = "Neural A*"

    def __init__(
        self,
        connectivity: int = 8,
        corner_cutting: bool = True,
        diagonal_cost: float = 1.0,
        learning_rate: float = 0.001,
    ) -> None:
        """Make the network: the authors' encoder of depth 4."""
        super().__init__()
        self.save_hyperparameters()
        self._check_learning_rate()
        self.movement = Movement(connectivity, corner_cutting, diagonal_cost)
        layers = []
        for inputs, outputs in pairwise((2, 32, 64, 128, 256, 1)):
            layers += [nn.Conv2d(inputs, outputs, 3, padding=1), nn.BatchNorm2d(outputs), nn.ReLU()]
        self.encoder = nn.Sequential(*layers[:-1])

    def forward(self, occupied: Tensor, starts: Tensor, goals: Tensor) -> Tensor:
        """Return guidance costs (B, H, W).

        Args:
            occupied: (B, 1, H, W), 0 free and anything else occupied.
            starts: (B, 2), cells.
            goals: (B, 2), cells.
        """
        free = (occupied[:, 0] == 0).float()  # (B, H, W)
        ends = torch.zeros_like(free)  # (B, H, W), 1 at start and goal, 2 where they are one cell
        batch = torch.arange(len(ends), device=ends.device)  # (B,)
        for cells in (starts, goals):
            ends[batch, cells[:, 0], cells[:, 1]] += 1
        planes = torch.stack([free, ends], dim=1)  # (B, 2, H, W)
        return torch.sigmoid(self.encoder(planes)[:, 0].float())

    def losses(self, batch: Sample) -> Tensors:
        """Return ``loss``: the mean absolute difference of expanded cells and cells of a path.

        The authors' path leaves out the goal, which every search expands; ours includes it.
        """
        problems = (batch.map, batch.start, batch.goal)
        costs = self(*problems)  # (B, H, W)
        max_expansions = costs[0].numel() // 4  # as in the authors' training
        expanded, _ = search(costs, *problems, self.movement, max_expansions)
        paths = random_paths(batch.start, batch.optimal_moves)  # (B, H, W)
        return {"loss": F.l1_loss(expanded, paths)}

    def validation_step(self, batch: Sample, batch_idx: int, dataloader_idx: int = 0) -> None:
        """Plan the problems of a batch; `on_validation_epoch_end` logs how well that went."""
        self.score(self, batch)

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Return the optimizer of the paper, without a schedule."""
        return torch.optim.RMSprop(self.parameters(), self.hparams["learning_rate"])

    # --- planner --------------------------------------------------------------------------------

    def plan_batch(self, grids: Bytes, starts: Ints, goals: Ints) -> list[Plan]:
        """Return a plan for each problem: grids (B, H, W), starts and goals (B, 2).

        Raises:
            ValueError: a start or goal outside its map or on an occupied cell.
        """
        grids, starts, goals = check_problems(grids, starts, goals)
        # The same as tensors, on the device of the model.
        occupied, start_cells, goal_cells = self.tensors(grids[:, None], starts, goals)
        with self.inference():
            costs = self(occupied, start_cells, goal_cells)  # (B, H, W)
            max_expansions = costs[0].numel()  # all cells
            expanded, parents = search(
                costs, occupied, start_cells, goal_cells, self.movement, max_expansions
            )
        expansions = expanded.sum(dim=(1, 2)).round().int().tolist()
        columns = grids.shape[2]
        start_numbers = starts[:, 0] * columns + starts[:, 1]
        goal_numbers = goals[:, 0] * columns + goals[:, 1]
        plans = []
        for k, parent in enumerate(parents.tolist()):
            path = _trace(parent, int(start_numbers[k]), int(goal_numbers[k]))
            cells = np.column_stack(np.divmod(path, columns))
            plans.append(Plan(cells, expansions[k], prepared=grids[k].size))
        return plans


def _trace(parent: list[int], start: int, goal: int) -> Ints:
    """Return the numbers of the cells from start to goal, (k,), or (0,) where there is no path.

    Args:
        parent: number of each cell's parent, or -1 for cells that were not reached and the start.
        start: number of the start.
        goal: number of the goal.
    """
    path = [goal]
    while path[-1] != start:
        if parent[path[-1]] == -1:
            return np.empty(0, np.int64)
        path.append(parent[path[-1]])
    return np.array(path[::-1], np.int64)
