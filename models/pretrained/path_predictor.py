"""A CNN that learns to plan from examples: maps with a start, a goal and a shortest path.

For every cell of a map it predicts which moves are the first of a shortest path to the goal, and
the heuristic ratio: the cost on an empty map over the true cost. Following the most probable moves
gives a path:

    import pytorch_lightning as pl
    from mapdata import MapDataModule
    from mapdata.models import PathPredictor

    data = MapDataModule("data/maps", build="paper", batch_size=64)  # map, start, goal, path
    model = PathPredictor(connectivity=4)
    pl.Trainer(max_epochs=2).fit(model, data)
    sample = data.datasets["val"][0]
    path = model.predict_path(sample.map, sample.start, sample.goal)  # (k, 2) cells

A path labels only its own cells, and in an open room it is one of very many that are equally
short. With the fields of ``TRAINING_FIELDS`` every cell is labelled with all of its optimal moves,
which teaches more:

    data = MapDataModule(
        "data/maps", fields=TRAINING_FIELDS, problems="random", augment=True, batch_size=64
    )

On terrain, where each cell has a cost, the network sees the costs, and its costs to go are in their
unit:

    data = MapDataModule(
        "data/terrain", build="terrain", fields=("terrain", *TRAINING_FIELDS), problems="random"
    )
    model = PathPredictor(terrain=True)

The pretrained weights were trained without terrain, by

    OMP_NUM_THREADS=1 python -m mapdata.models.train path_predictor fit --weights FILE

in 7,000 steps of 39 maps of all families and 4 larger ones, which take 50 minutes of one core. Then
came 1,000 steps with the additions of configs/refine_path_predictor.yaml, 10 minutes more.
`PathPredictor.pretrained` loads them, and those for other movements (docs/reference/models.md has
all commands).

`torch.export.export(model, (map, goal))` and the export to ONNX take the network as it is.

This file reads from top to bottom: targets, input of the network, network, loss, training,
prediction. The layers are in layers.py, the moves on a map in geometry.py, the optimizer in
optimizer.py, the training step and the files of weights in model.py; learned_planners.py plans
with predictions.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor, nn

from mapdata import Movement, Sample
from mapdata.arrays import Array, Bytes, Float32s, Ints
from mapdata.checks import check_count, check_finite, check_flag
from mapdata.search import STEPS, path_waypoints

from .geometry import heuristic, legal_moves, min_and_mean_costs, offsets
from .layers import Trunk, padded
from .learned_planners import LearnedPlanner, planners
from .model import Tensors

TRAINING_FIELDS = ("map", "start", "goal", "optimal_moves", "heuristic_ratio")
"""The fields that teach more than ``map, start, goal, path``."""

PRIOR = 3.0
"""How much the log probability of a move falls for each cell of its detour, before training."""

HALF_TURN = [2, 3, 0, 1, 6, 7, 4, 5]
"""The number of each move on a map after half a turn: N becomes S, E becomes W, NE becomes SW."""

MIN_RATIO = 0.05
"""Predicted heuristic ratios below this count as this, since costs are divided by them. On terrain
it is multiplied by the smallest cost of the map over the mean one.
"""

# --- targets ------------------------------------------------------------------------------------


def targets_on_path(batch: Sample, movement: Movement) -> tuple[Tensor, Tensor]:
    """Return the targets that a path gives its own cells, in the form of `targets`.

    If the batch has the field ``terrain``, costs are those of moves on it.
    """
    cells = batch.path[:, :-1]  # (B, T - 1, 2)
    steps = batch.path.diff(dim=1)  # (B, T - 1, 2)
    # N, E, S, W, then NE, SE, SW, NW; bit k of a target is move k.
    moves = torch.tensor(STEPS[: movement.connectivity], device=cells.device)  # (moves, 2)
    is_move = (steps[:, :, None] == moves).all(dim=3)  # (B, T - 1, moves), one-hot
    # A goal at (0, 0) is followed by padding, (-1, -1), which looks like a move to the north-west.
    is_move[batch.path[:, 1:, 0] < 0] = False
    has_target = is_move.any(dim=2)  # (B, T - 1), all cells of a path but its goal
    # The true cost to the goal is the sum over the steps that follow. The heuristic of a step is
    # its length.
    down, right = steps.unbind(2)  # (B, T - 1) both
    costs = heuristic(down, right, movement) * has_target  # (B, T - 1)
    down, right = (cells - batch.goal[:, None]).unbind(2)  # (B, T - 1) both
    heuristics = heuristic(down, right, movement)  # (B, T - 1)
    if "terrain" in batch._fields:
        # Padding, (-1, -1), looks up the last cell of the map, which changes no cost of a step.
        map_numbers = torch.arange(len(cells), device=cells.device)[:, None]  # (B, 1)
        rows, columns = batch.path.unbind(2)  # (B, T) both
        cell_costs = batch.terrain[map_numbers, 0, rows, columns].float()  # (B, T)
        costs = costs * (cell_costs[:, :-1] + cell_costs[:, 1:]) / 2
        min_costs, _ = min_and_mean_costs(batch.terrain)
        heuristics = heuristics * min_costs[:, 0]
    to_go = costs.flip(1).cumsum(dim=1).flip(1)  # (B, T - 1)
    ratios = heuristics / to_go  # (B, T - 1)
    bits = 2 ** is_move.long().argmax(dim=2)  # (B, T - 1)
    # Map, row and column of the n cells of all paths that have a target.
    problem, _ = has_target.nonzero(as_tuple=True)  # (n,)
    index = (problem, *cells[has_target].unbind(1))  # (n,) each
    optimal = torch.zeros_like(batch.map[:, 0], dtype=torch.long)  # (B, H, W)
    optimal[index] = bits[has_target]
    ratio = torch.zeros_like(optimal, dtype=torch.float)  # (B, H, W)
    ratio[index] = ratios[has_target]
    return optimal, ratio


def targets(batch: Sample, movement: Movement) -> tuple[Tensor, Tensor]:
    """Return the targets of each cell, (B, H, W) both.

    - optimal moves, int64: bit k is set where move k is the first of a shortest path to the goal; 0
      for cells without a target.
    - heuristic ratio in [0, 1], float: the heuristic over the true cost to the goal.
    """
    if "optimal_moves" in batch._fields:
        return batch.optimal_moves[:, 0].long(), batch.heuristic_ratio[:, 0]
    return targets_on_path(batch, movement)


# --- input of the network -----------------------------------------------------------------------


def encode(occupied: Tensor, goals: Tensor, movement: Movement) -> tuple[Tensor, Tensor]:
    """Return the input of the network, (B, 8, H, W), and detours of the moves, (B, moves, H, W).

    The detour of a move is its cost plus the change of the heuristic, in cells: 0 for the moves
    that are optimal on an empty map. The scores of moves start from it, so that the network has to
    learn only what obstacles change.

    Args:
        occupied: (B, 1, H, W), 0 free and anything else occupied.
        goals: (B, 2), cells.
        movement: how one moves.
    """
    down, right = offsets(goals, occupied.shape[2:])  # from the goal: (B, H, 1) and (B, 1, W)
    h = heuristic(down, right, movement)  # (B, H, W)
    detours = []
    for rows, columns in STEPS[: movement.connectivity].tolist():
        is_diagonal = rows != 0 and columns != 0
        cost = movement.diagonal_cost if is_diagonal else 1.0
        next_h = heuristic(down + rows, right + columns, movement)  # (B, H, W)
        detours.append(cost + next_h - h)
    free = (occupied[:, 0] == 0).float()  # (B, H, W)
    is_goal = (h == 0).float()  # (B, H, W)
    # These three tell neighbouring cells apart near the row, the column and the diagonals of the
    # goal; farther away they are -1 or 1.
    near_row = (down / 4).clamp(-1, 1)  # (B, H, 1)
    near_column = (right / 4).clamp(-1, 1)  # (B, 1, W)
    near_diagonal = ((down.abs() - right.abs()) / 4).clamp(-1, 1)  # (B, H, W)
    # The divisors bring all planes to a size of about 1.
    planes = torch.broadcast_tensors(
        free, is_goal, h / 64, down / 32, right / 32, near_row, near_column, near_diagonal
    )
    return torch.stack(planes, dim=1), torch.stack(detours, dim=1)


def encode_terrain(terrain: Tensor) -> tuple[Tensor, Tensor]:
    """Return two more planes of input, (B, 2, H, W), and the initial log ratio, (B, 1, 1).

    The planes are the costs over the mean cost of the map, and their logarithms. So the network
    sees the same if all costs of a map are multiplied by a number. Both are 0 on occupied cells.

    The initial log ratio is the logarithm of the smallest cost over the mean one: that of the
    heuristic ratio where a shortest path is straight and its cells have the mean cost. The
    predicted ratio starts from it, so that a single cheap cell, which changes the heuristic of a
    whole map, does not change what the network has to learn.

    Args:
        terrain: (B, 1, H, W), the cost of each cell, 0 on occupied cells.
    """
    costs = terrain[:, 0].float()  # (B, H, W)
    min_costs, mean_costs = min_and_mean_costs(terrain)
    relative_costs = costs / mean_costs  # (B, H, W)
    logarithms = torch.where(costs > 0, relative_costs, 1.0).log()  # (B, H, W)
    return torch.stack([relative_costs, logarithms], dim=1), (min_costs / mean_costs).log()


# --- network, loss and training -----------------------------------------------------------------


class PathPredictor(LearnedPlanner):
    """Predicts optimal moves and the heuristic ratio of every cell, given map and goal.

    A batch has the fields ``map, start, goal, path`` or `TRAINING_FIELDS`, with the movement of the
    model, and on terrain the field ``terrain``. A list of batches, even with maps of several sizes,
    is one training step.

    Args:
        connectivity: number of moves, 4 or 8.
        corner_cutting: whether diagonal moves may pass beside occupied cells.
        diagonal_cost: cost of a diagonal move, sqrt(2) or 1.
        widths: channels at strides 2, 4, 8 and 16; the last two may be left out.
        passes: number of exchanges between strides from 4 on. Each lets information travel farther.
        refinements: number of residual blocks at stride 2 after them. They help where single cells
            matter, as in noise.
        learning_rate: the highest of the schedule.
        ratio_weight: weight of the squared error of the heuristic ratio; on terrain, where ratios
            are small, of its logarithm.
        detour_weight: additional weight of cells where the heuristic is more than 2 % too low.
        terrain: whether the network sees the cost of each cell.
    """

    PRETRAINED: ClassVar[Mapping[str, str]] = {
        "eight": "path_predictor.safetensors",  # 8 moves, no corner is cut
        "cut": "path_predictor_cut.safetensors",  # 8 moves, which may cut corners
        "four": "path_predictor_4.safetensors",  # 4 moves
    }

    def __init__(
        self,
        connectivity: int = 8,
        corner_cutting: bool = False,
        diagonal_cost: float = math.sqrt(2),
        widths: tuple[int, ...] = (32, 48, 48),
        passes: int = 3,
        refinements: int = 0,
        learning_rate: float = 0.004,
        ratio_weight: float = 5.0,
        detour_weight: float = 2.0,
        terrain: bool = False,
    ) -> None:
        """Make the network."""
        super().__init__()
        self.save_hyperparameters()
        self._check_learning_rate()
        check_finite("ratio_weight", ratio_weight)
        check_finite("detour_weight", detour_weight)
        check_flag("terrain", terrain)
        self.movement = Movement(connectivity, corner_cutting, diagonal_cost)
        self.takes_terrain = terrain
        plane_count = 10 if terrain else 8
        self.network = Trunk(plane_count, connectivity + 1, widths, passes, refinements)
        nn.init.zeros_(self.network.head.weight)

    def forward(
        self, occupied: Tensor, goals: Tensor, terrain: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return scores of the moves (B, moves, H, W) and heuristic ratios (B, H, W) in [0, 1].

        Args:
            occupied: (B, 1, H, W), 0 free and anything else occupied; any H and W.
            goals: (B, 2), cells.
            terrain: (B, 1, H, W), the cost of each cell, 0 on occupied cells, for a network that
                takes terrain; None if all free cells cost 1.

        Raises:
            ValueError: terrain for a network that does not take it.
        """
        if terrain is not None and not self.takes_terrain:
            raise ValueError(
                "terrain: got costs for a network without, expected PathPredictor(terrain=True)"
            )
        rows, columns = occupied.shape[2:]
        planes, detours = encode(padded(occupied), goals, self.movement)
        initial_log_ratio: Tensor | None = None
        if self.takes_terrain:
            terrain = occupied == 0 if terrain is None else terrain
            cost_planes, initial_log_ratio = encode_terrain(padded(terrain, value=0))
            planes = torch.cat([planes, cost_planes], dim=1)
        output = self.network(planes)  # (B, moves + 1, H, W), up to 15 rows and columns more
        output = output[..., :rows, :columns].float()
        # Before training the most probable moves are those that lead straight to the goal.
        scores = output[:, :-1] - PRIOR * detours[..., :rows, :columns]
        ratio_logits = output[:, -1]
        if initial_log_ratio is not None:
            ratio_logits = ratio_logits + initial_log_ratio
        return scores, torch.sigmoid(ratio_logits)

    def losses(self, batch: Sample | list[Sample]) -> Tensors:
        """Return ``loss``, its part ``moves``, and ``accuracy``.

        - ``moves``: weighted mean of the loss of the moves.
        - ``loss``: ``moves`` plus ``ratio_weight`` times the mean squared error of the ratio, or of
          its logarithm on terrain.
        - ``accuracy``: share of the cells whose most probable legal move is optimal.

        Cells without a target do not count.

        Raises:
            ValueError: a network that takes terrain gets a batch without it.
        """
        batches = batch if isinstance(batch, list) else [batch]
        # Maps of one size go through the network together, in half the time of several batches.
        by_size: dict[torch.Size, list[list[Tensor]]] = defaultdict(list)
        for part in batches:
            optimal, ratio = targets(part, self.movement)  # (B, H, W) both
            tensors = [optimal, ratio, part.map, part.goal]
            if self.takes_terrain:
                if "terrain" not in part._fields:
                    raise ValueError(
                        f"terrain: got a batch with the fields {', '.join(part._fields)}, expected "
                        "terrain among them: put it into the `fields` of the data"
                    )
                tensors.append(part.terrain)
            by_size[part.map.shape[2:]].append(tensors)
        cell_losses = [
            self.cell_losses(*map(torch.cat, zip(*parts, strict=True)))
            for parts in by_size.values()
        ]
        move_loss, squared_error, is_right, weight = torch.cat(cell_losses, dim=1)  # (n,) each
        moves = (weight * move_loss).sum() / weight.sum()
        loss = moves + self.hparams["ratio_weight"] * squared_error.mean()
        return {"loss": loss, "moves": moves, "accuracy": is_right.mean()}

    def cell_losses(
        self,
        optimal: Tensor,
        ratio: Tensor,
        occupied: Tensor,
        goals: Tensor,
        terrain: Tensor | None = None,
    ) -> Tensor:
        """Return (4, n) for the n cells that have a target.

        The rows are: loss of the moves; squared error of the ratio, or of its logarithm on terrain;
        1 where the most probable legal move is optimal and 0 elsewhere; weight of the cell.

        Args:
            optimal: (B, H, W), optimal moves of `targets`.
            ratio: (B, H, W), heuristic ratio of `targets`.
            occupied: (B, 1, H, W), 0 free and anything else occupied.
            goals: (B, 2), cells.
            terrain: (B, 1, H, W), costs of cells, for a network that takes terrain.
        """
        scores, ratios = self(occupied, goals, terrain)  # (B, moves, H, W) and (B, H, W)
        scores = scores.masked_fill(~legal_moves(occupied, self.movement), -math.inf)
        cells = optimal.nonzero(as_tuple=True)  # map, row and column of the n cells
        scores = scores.permute(0, 2, 3, 1)[cells]  # (n, moves)
        ratio = ratio[cells]  # (n,)
        bits = 2 ** torch.arange(scores.shape[1], device=scores.device)  # (moves,)
        is_optimal = (optimal[cells][:, None] & bits) != 0  # (n, moves)
        # The loss is -log of the probability of making any optimal move, so that the network need
        # not decide among optimal moves.
        optimal_scores = scores.masked_fill(~is_optimal, -math.inf)  # (n, moves)
        move_loss = scores.logsumexp(1) - optimal_scores.logsumexp(1)  # (n,)
        predicted_ratio = ratios[cells]  # (n,)
        if self.takes_terrain:
            # An error of the logarithm is a relative error of the cost to go.
            squared_error = (predicted_ratio.clamp(min=1e-6).log() - ratio.log()) ** 2  # (n,)
        else:
            squared_error = (predicted_ratio - ratio) ** 2  # (n,)
        most_probable = scores.argmax(1, keepdim=True)  # (n, 1)
        is_right = is_optimal.gather(1, most_probable)[:, 0].float()  # (n,)
        weight = 1 + self.hparams["detour_weight"] * (ratio < 0.98)  # (n,)
        return torch.stack([move_loss, squared_error, is_right, weight])

    def validation_step(self, batch: Sample, batch_idx: int, dataloader_idx: int = 0) -> None:
        """Log the losses, and plan; `on_validation_epoch_end` logs how well that went."""
        losses = {f"val_{name}": loss for name, loss in self.losses(batch).items()}
        self.log_dict(losses, batch_size=len(batch.map))
        _, search = planners(self)
        self.score(search, batch)

    # --- prediction -----------------------------------------------------------------------------

    def predict(
        self, grids: Bytes, goals: Ints, terrain: Bytes | None = None
    ) -> tuple[Float32s, Float32s]:
        """Return scores of the moves (B, moves, H, W) and costs to go (B, H, W), in cells.

        A score is a log probability, up to a constant for each cell. A cost to go is the heuristic
        divided by the predicted heuristic ratio. On terrain it is a cost on the terrain.

        Scores and ratios are means over two views: the map, and the map after half a turn. That
        takes twice the time, and makes paths shorter for no more expansions.

        Args:
            grids: (B, H, W), 0 free and 1 occupied.
            goals: (B, 2), cells.
            terrain: (B, H, W), the cost of each cell, 0 on occupied cells, for a network that takes
                terrain; None if all free cells cost 1.

        Raises:
            ValueError: terrain for a network that does not take it.
        """
        occupied, cells = self.tensors(np.not_equal(grids, 0)[:, None], goals)
        last_cell = torch.tensor(occupied.shape[2:], device=self.device) - 1  # (2,)
        costs_of_cells = turned_costs_of_cells = None
        min_costs: Tensor | float = 1.0
        min_ratios: Tensor | float = MIN_RATIO
        if terrain is not None:
            (costs_of_cells,) = self.tensors(terrain[:, None])  # (B, 1, H, W)
            turned_costs_of_cells = costs_of_cells.flip(2, 3)
            min_costs, mean_costs = min_and_mean_costs(costs_of_cells)  # (B, 1, 1) both
            min_ratios = MIN_RATIO * min_costs / mean_costs
        with self.inference():
            scores, ratios = self(occupied, cells, costs_of_cells)
            turned_scores, turned_ratios = self(
                occupied.flip(2, 3), last_cell - cells, turned_costs_of_cells
            )
            scores += turned_scores[:, HALF_TURN[: scores.shape[1]]].flip(2, 3)
            scores /= 2
            ratios += turned_ratios.flip(1, 2)
            ratios /= 2
            h = heuristic(*offsets(cells, ratios.shape[1:]), self.movement)  # (B, H, W)
            costs_to_go = min_costs * h / ratios.clamp(min=min_ratios)  # (B, H, W)
        return scores.cpu().contiguous().numpy(), costs_to_go.cpu().numpy()

    def predict_path(
        self,
        map: ArrayLike,
        start: ArrayLike,
        goal: ArrayLike,
        terrain: ArrayLike | None = None,
    ) -> Ints:
        """Return the predicted path, (k, 2) cells, or (0, 2) where there is no path.

        The path is that of a walk from the start, which always makes the most probable legal move
        to a cell where it has not been, and goes back to the cell before where there is no such
        move. The path takes the shortest way over the moves that the walk has looked at.

        Args:
            map: (H, W) or (1, H, W), 0 free and 1 occupied.
            start: (2,), cell.
            goal: (2,), cell.
            terrain: (H, W) or (1, H, W), the cost of each cell, for a network that takes terrain.

        Raises:
            ValueError: a start or goal outside the map or on an occupied cell; terrain that does
                not fit the map.
        """
        walk, _ = planners(self)
        grid = _without_channel(map)
        costs = None if terrain is None else _without_channel(terrain)
        return walk.plan(grid, start, goal, costs).path.astype(np.int64)

    def predict_waypoints(
        self, map: ArrayLike, start: ArrayLike, goal: ArrayLike, count: int = 32
    ) -> Float32s:
        """Return points of a collision-free line from start to goal, (count, 2) float32, in cells.

        The line is the path of `predict_path`, pulled taut. Its points are divided as those of the
        field ``waypoints``, so the lines of this model are compared with it. The middle of cell
        (r, c) is (r + 0.5, c + 0.5). All points are -1 where there is no path.

        Args:
            map: (H, W) or (1, H, W), 0 free and 1 occupied.
            start: (2,), cell.
            goal: (2,), cell.
            count: number of points, start and goal included; at least 2.

        Raises:
            ValueError: a start or goal outside the map or on an occupied cell; a line with more
                than ``count`` - 2 bends.
        """
        check_count("count", count, minimum=2)
        path = self.predict_path(map, start, goal)
        if not len(path):
            return np.full((count, 2), -1, np.float32)
        grid = np.asarray(map) != 0
        grid = grid.reshape(grid.shape[-2:])
        cuts_corners = self.movement.corner_cutting
        return path_waypoints(grid, path, count, corner_cutting=cuts_corners)


def _without_channel(plane: ArrayLike) -> Array:
    """Return a map or terrain of (H, W) or (1, H, W) as (H, W)."""
    array = np.asarray(plane)
    return array[0] if array.ndim == 3 and len(array) == 1 else array
