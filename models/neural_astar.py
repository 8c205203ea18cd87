"""Neural A*: a network that guides A*, trained through the search with one path per problem.

Yonetani, Taniai, Barekatain, Nishimura, Kanezaki: Path Planning using Neural A* Search, ICML 2021,
arXiv 2009.07476 (https://github.com/omron-sinicx/neural-astar). A network gives every cell a
guidance cost in (0, 1). A* with these costs should expand the cells of the path, and no others:

    import pytorch_lightning as pl
    from mapdata import MapDataModule
    from models.neural_astar import TRAINING_FIELDS, NeuralAstar

    model = NeuralAstar()
    data = MapDataModule(
        "data/mazes",
        fields=TRAINING_FIELDS,
        problems="random",
        movement=model.movement,
        batch_size=100,
    )  # docs/planners.md has the command that its table is of
    pl.Trainer(max_epochs=50).fit(model, data)

This file reads from top to bottom: search, network, training, planner. All of it is torch: a step
of the search is a few operations on tensors of B maps, so that gradients flow through it.
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
from models.geometry import cell_numbers, check_problems, heuristic, legal_moves, offsets
from models.learned_planners import LearnedPlanner
from models.model import Tensors

TRAINING_FIELDS = ("map", "start", "goal", "optimal_moves")

FAR = 1e9
"""More than any way costs."""

# --- search -------------------------------------------------------------------------------------


def search(
    costs: Tensor, occupied: Tensor, starts: Tensor, goals: Tensor, movement: Movement, most: int
) -> tuple[Tensor, Tensor]:
    """Search B maps at once with guidance costs (section 3.2).

    f = (g + h + cost) / 2, half as in the authors' code, where g is the sum of the guidance costs
    of the cells that the way leaves, each times the length of the step. The cell of least f is
    taken from the frontier, as a softmax whose largest value counts as 1 (equation 3): g has no
    gradient, the choices have one.
    A finished map keeps choosing its goal until all maps of the batch are finished; its other
    cells get gradients from that, as in the authors' code.

    Args:
        costs: (B, H, W), guidance costs.
        occupied: (B, 1, H, W), 0 free and anything else occupied.
        starts: (B, 2), cells.
        goals: (B, 2), cells.
        movement: how one moves.
        most: how many cells may be expanded.

    Returns:
        Which cells were expanded, (B, H, W), 0 or 1 and differentiable in ``costs``; the number of
        each cell's parent, or -1, (B, H * W + 1).
    """
    rows, columns = costs.shape[1:]
    # Cells are numbered row by row. One more stands for nowhere: illegal moves lead there, and it
    # is taken when nothing else is left.
    nowhere = rows * columns
    each = torch.arange(len(costs), device=costs.device)  # (B,)
    first = cell_numbers(starts, occupied)  # (B,)
    last = cell_numbers(goals, occupied)  # (B,)
    legal = F.pad(legal_moves(occupied, movement).flatten(2), (0, 1))  # (B, moves, cells)
    moves = torch.tensor(STEPS[: movement.connectivity], device=costs.device)  # (moves, 2)
    lengths = torch.where(moves.prod(dim=1) == 0, 1.0, movement.diagonal_cost)  # (moves,)
    jumps = moves[:, 0] * columns + moves[:, 1]  # (moves,)

    down, right = offsets(goals, occupied.shape[2:])
    # the straight distance decides among cells that are equally far, as in the paper's code
    to_go = heuristic(down, right, movement) + 0.001 * torch.hypot(down, right)  # (B, H, W)
    ahead = F.pad((to_go + costs).flatten(1), (0, 1))  # (B, cells)
    guidance = F.pad(costs.detach().flatten(1), (0, 1))  # (B, cells)
    way = torch.full_like(guidance, math.inf)  # g, (B, cells)
    way[:, nowhere] = FAR
    way[each, first] = 0
    frontier = way < math.inf  # (B, cells)
    parents = torch.full_like(way, -1, dtype=torch.long)  # (B, cells)
    expanded = torch.zeros_like(guidance)  # (B, cells)
    for _ in range(most):
        scores = (way + ahead) / (-2 * math.sqrt(columns))  # temperature as in the authors' code
        shares = scores.masked_fill(~frontier, -math.inf).softmax(dim=1)  # (B, cells)
        cell = shares.argmax(dim=1)  # (B,)
        chosen = F.one_hot(cell, nowhere + 1)  # (B, cells)
        # the value is that of ``chosen``, the gradient that of ``shares``
        expanded = (expanded + chosen - shares.detach() + shares).clamp(0, 1)
        done = (cell == last) | (cell == nowhere)
        if done.all():
            break
        frontier[each, cell] = done

        to = (cell[:, None] + jumps).clamp(0, nowhere)  # (B, moves)
        reached = way[each, cell, None] + lengths * guidance[each, cell, None]  # (B, moves)
        known = way.gather(1, to)  # (B, moves)
        is_open = frontier.gather(1, to) | (known == math.inf)
        better = legal[each, :, cell] & is_open & (reached < known)
        to = to.where(better, nowhere)
        way.scatter_(1, to, reached.where(better, FAR))
        parents.scatter_(1, to, cell[:, None].expand_as(to))
        frontier.scatter_(1, to, True)
    return expanded[:, :nowhere].unflatten(1, (rows, columns)), parents


def random_paths(starts: Tensor, optimal_moves: Tensor) -> Tensor:
    """Return the cells of a shortest path of each problem, (B, H, W), 1 there and 0 elsewhere.

    Of several optimal moves a cell takes a random one, as in the authors' data.

    Args:
        starts: (B, 2), cells.
        optimal_moves: (B, 1, H, W), bit k of a cell is set where move k is optimal.
    """
    steps = torch.tensor(STEPS, device=starts.device)  # (8, 2)
    numbers = torch.arange(len(steps), device=starts.device)
    optimal = (optimal_moves[:, 0, :, :, None].int() >> numbers) & 1  # (B, H, W, 8), 0 or 1
    move = (optimal * (1 + torch.rand(optimal.shape, device=starts.device))).argmax(dim=3)
    step = steps[move] * optimal.any(dim=3, keepdim=True)  # (B, H, W, 2), none at the goal
    paths = torch.zeros_like(optimal[..., 0], dtype=torch.float)  # (B, H, W)
    each = torch.arange(len(starts), device=starts.device)  # (B,)
    cells = starts
    while True:
        at = (each, *cells.unbind(1))
        if paths[at].all():
            return paths  # all stand at their goals
        paths[at] = 1
        cells = cells + step[at]


# --- network and training -----------------------------------------------------------------------


class NeuralAstar(LearnedPlanner):
    """Predicts a guidance cost in (0, 1) for every cell, and plans with it.

    A batch has the fields ``TRAINING_FIELDS``; its paths move as the model does.

    Args:
        connectivity: 4 or 8 moves.
        corner_cutting: whether diagonal moves pass beside occupied cells.
        diagonal_cost: of a diagonal move, sqrt(2) or 1; the paper's rule is 8, True, 1.
        learning_rate: of RMSprop.
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
        self.movement = Movement(connectivity, corner_cutting, diagonal_cost)
        layers = []
        for inputs, outputs in pairwise((2, 32, 64, 128, 256, 1)):
            layers += [nn.Conv2d(inputs, outputs, 3, padding=1), nn.BatchNorm2d(outputs), nn.ReLU()]
        self.encoder = nn.Sequential(*layers[:-1])

    def forward(self, occupied: Tensor, starts: Tensor, goals: Tensor) -> Tensor:
        """Return guidance costs (B, H, W), for maps (B, 1, H, W) and cells (B, 2)."""
        ends = torch.zeros_like(occupied[:, 0], dtype=torch.float)  # (B, H, W)
        each = torch.arange(len(ends), device=ends.device)
        for cells in (starts, goals):
            ends[each, cells[:, 0], cells[:, 1]] += 1
        seen = torch.stack([(occupied[:, 0] == 0).float(), ends], dim=1)  # (B, 2, H, W)
        return torch.sigmoid(self.encoder(seen)[:, 0].float())

    def losses(self, batch: Sample) -> Tensors:
        """Return ``loss``: the mean absolute difference of expanded cells and a shortest path's.

        The authors' path leaves out the goal, which every search expands; ours includes it.
        """
        problems = (batch.map, batch.start, batch.goal)
        costs = self(*problems)
        most = costs[0].numel() // 4  # as in the authors' training
        expanded, _ = search(costs, *problems, self.movement, most)
        return {"loss": F.l1_loss(expanded, random_paths(batch.start, batch.optimal_moves))}

    def validation_step(self, batch: Sample, batch_idx: int, dataloader_idx: int = 0) -> None:
        """Search: `on_validation_epoch_end` logs the results."""
        self.score(self, batch)

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Return the paper's optimizer."""
        return torch.optim.RMSprop(self.parameters(), self.hparams["learning_rate"])

    # --- planner --------------------------------------------------------------------------------

    def plan_batch(self, grids: Bytes, starts: Ints, goals: Ints) -> list[Plan]:
        """Return a plan for each problem: grids (B, H, W), starts and goals (B, 2).

        Raises:
            ValueError: a start or goal outside its map or on an occupied cell.
        """
        grids, starts, goals = check_problems(grids, starts, goals)
        occupied, first, last = self.tensors(grids[:, None], starts, goals)
        with self.inference():
            costs = self(occupied, first, last)
            most = costs[0].numel()
            expanded, parents = search(costs, occupied, first, last, self.movement, most)
        ends = [cell_numbers(end, occupied).tolist() for end in (first, last)]
        counts = expanded.sum(dim=(1, 2)).round().int().tolist()
        plans = []
        for start, goal, each, count in zip(*ends, parents.tolist(), counts, strict=True):
            path = [goal]
            while path[-1] not in (start, -1):  # -1: nothing leads there
                path.append(each[path[-1]])
            if path[-1] == -1:
                path.clear()
            cells = np.array(path[::-1], np.int64)
            plans.append(Plan(np.column_stack(np.divmod(cells, occupied.shape[3])), count))
        return plans
