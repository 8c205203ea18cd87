"""A CNN that predicts paths: for every cell, the moves that start a shortest path to the goal.

One path as a target is ill-posed: between two cells of a room there are 10^5 equally good ones. The set of optimal
moves of each cell is unique, and gives some 2,000 labelled cells a map. Following the most probable moves is a path.

    from mapdata import MapSpec, Movement
    from mapdata.evaluate import Problems, evaluate
    from models.path_predictor import PathPredictor, planners

    model = PathPredictor.load("models/weights/path_predictor.pt")
    problems = Problems.draw(MapSpec.preset("dungeon"), seed=77, maps=600)
    path = model.predict_path(problems.grids[0], problems.starts[0], problems.goals[0])  # (k, 2) cells
    print(evaluate(planners(model), problems))

The weights that ship saw 3,000 steps of 40 maps: 2,000 steps of `scripts/train_path_predictor.py fit` with 8 epochs in
its file, then 1,000 more from that checkpoint with --trainer.max_epochs 6; 24 minutes on two cores that other work was
using too (0.21 s a step where they were idle). A later version replaces them by one run of the command.
"""

from __future__ import annotations

import contextlib
import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pytorch_lightning as pl
import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from pytorch_lightning.utilities import CombinedLoader
from torch import Tensor, nn
from torch.utils.data import DataLoader

from mapdata.datamodule import MapDataModule
from mapdata.evaluate import BatchPlanner, Bytes, Cell, Ints, Plan
from mapdata.jit import Int, kernel
from mapdata.kernels import STEPS
from mapdata.sample import Sample
from mapdata.search import search_batch
from mapdata.spec import Movement

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FIELDS = ("map", "start", "goal", "optimal_moves", "heuristic_ratio")
"""What a data module must serve."""

STRIDE = 8
"""Maps are padded with occupied cells to a multiple of this."""

_TURNED = [2, 3, 0, 1, 6, 7, 4, 5]
_TRANSPOSED = [3, 2, 1, 0, 6, 5, 4, 7]
"""Which move each move becomes when the map is turned by 180 degrees, or transposed."""

Floats = npt.NDArray[np.float32]


# --- what the network sees ------------------------------------------------------------------------------------------


@lru_cache(maxsize=16)
def _surroundings(rows: int, columns: int, moves: int) -> tuple[Tensor, Tensor]:
    """Return planes about a goal in their middle, (6, 2 rows - 1, 2 columns - 1), and how much each move leads astray.

    The window of a map with its goal at (i, j) begins at (rows - 1 - i, columns - 1 - j). A move leads astray by its
    cost plus the change of the heuristic: 0 for the moves that would be optimal on an empty map.
    """
    down = torch.arange(1 - rows, rows).float()[:, None].expand(-1, 2 * columns - 1)
    right = torch.arange(1 - columns, columns).float()[None].expand(2 * rows - 1, -1)

    def heuristic(down: Tensor, right: Tensor) -> Tensor:
        down, right = down.abs(), right.abs()
        if moves == 4:
            return down + right
        return torch.maximum(down, right) + (math.sqrt(2) - 1) * torch.minimum(down, right)

    here = heuristic(down, right)
    near, side = [torch.clamp(each / 4, -1, 1) for each in (down, right)], (down.abs() - right.abs()) / 4
    planes = torch.stack([here / 64, down / 32, right / 32, *near, side.clamp(-1, 1)])
    steps = STEPS[:moves].tolist()
    astray = [heuristic(down + r, right + c) - here + math.hypot(r, c) for r, c in steps]
    return planes, torch.stack(astray)


def look(occupied: Tensor, goals: Tensor, moves: int) -> tuple[Tensor, Tensor]:
    """Return what the network sees, (B, 8, H, W), and how much each move leads astray, (B, moves, H, W).

    Args:
        occupied: (B, 1, H, W), 0 free and anything else occupied.
        goals: (B, 2), cells.
        moves: 4 or 8.
    """
    count, _, rows, columns = occupied.shape
    planes, astray = (each.to(occupied.device) for each in _surroundings(rows, columns, moves))
    seen = torch.zeros(count, 8, rows, columns, device=occupied.device)
    prior = torch.empty(count, moves, rows, columns, device=occupied.device)
    seen[:, 0] = occupied[:, 0] == 0
    for k, (i, j) in enumerate(goals.tolist()):
        window = (slice(None), slice(rows - 1 - i, 2 * rows - 1 - i), slice(columns - 1 - j, 2 * columns - 1 - j))
        seen[k, 1, i, j] = 1
        seen[k, 2:], prior[k] = planes[window], astray[window]
    return seen, prior


def legal_moves(occupied: Tensor, movement: Movement) -> Tensor:
    """Return (B, moves, H, W) bool: the moves that ``movement`` allows from each cell; occupied is (B, 1, H, W)."""
    rows, columns = occupied.shape[2:]
    free = F.pad(occupied[:, 0] == 0, (1, 1, 1, 1))

    def neighbour(row: int, column: int) -> Tensor:
        return free[:, 1 + row : 1 + row + rows, 1 + column : 1 + column + columns]

    legal = []
    for row, column in STEPS[: movement.connectivity].tolist():
        beside = row and column and not movement.corner_cutting
        sides = neighbour(row, 0) & neighbour(0, column) if beside else True
        legal.append(neighbour(row, column) & sides)
    return torch.stack(legal, dim=1)


# --- the network ----------------------------------------------------------------------------------------------------


class Residual(nn.Module):
    """x + two 3 x 3 convolutions, the second of which begins at zero; no norm, so that all map sizes are alike."""

    def __init__(self, width: int, dilation: int = 1) -> None:
        """Make both convolutions; the second sees ``dilation`` times as far."""
        super().__init__()
        self.first = nn.Conv2d(width, width, 3, padding=1)
        self.second = nn.Conv2d(width, width, 3, padding=dilation, dilation=dilation)
        nn.init.kaiming_normal_(self.first.weight, nonlinearity="relu")
        nn.init.zeros_(self.second.weight)

    def forward(self, x: Tensor) -> Tensor:
        """Return (B, width, H, W) for the same."""
        out: Tensor = x + self.second(F.relu(self.first(F.relu(x))))
        return out


class Pass(nn.Module):
    """One exchange between two resolutions: near at stride 4, and far at stride 8."""

    def __init__(self, width: int, deep: int) -> None:
        """Take ``width`` channels at stride 4 and ``deep`` ones at stride 8."""
        super().__init__()
        self.local = Residual(width)
        self.down = nn.Conv2d(width, deep, 2, stride=2)
        self.far = Residual(deep, dilation=2)
        self.up = nn.Conv2d(deep, 4 * width, 1)

    def forward(self, fine: Tensor, coarse: Tensor | None) -> tuple[Tensor, Tensor]:
        """Return both states: (B, width, H/4, W/4) and (B, deep, H/8, W/8)."""
        fine = self.local(fine)
        below = self.down(F.relu(fine))
        coarse = self.far(below if coarse is None else below + coarse)
        return fine + F.pixel_shuffle(self.up(F.relu(coarse)), 2), coarse


class Network(nn.Module):
    """Scores of moves and the heuristic ratio of every cell; it knows no map size."""

    def __init__(self, moves: int, widths: tuple[int, int, int], passes: int) -> None:
        """Take the widths at strides 2, 4 and 8."""
        super().__init__()
        shallow, width, deep = widths
        self.stem = nn.Sequential(nn.Conv2d(4 * 8, shallow, 3, padding=1), Residual(shallow))
        self.down = nn.Conv2d(shallow, width, 2, stride=2)
        self.passes = nn.ModuleList(Pass(width, deep) for _ in range(passes))
        self.end = Residual(width)
        self.up = nn.Conv2d(width, 4 * shallow, 1)
        self.join = nn.Conv2d(2 * shallow, shallow, 3, padding=1)
        self.head = nn.Conv2d(shallow, 4 * (moves + 1), 1)
        nn.init.zeros_(self.head.weight)

    def forward(self, seen: Tensor) -> Tensor:
        """Return (B, moves + 1, H, W) for (B, 8, H, W), H and W multiples of 8."""
        skip = F.relu(self.stem(F.pixel_unshuffle(seen, 2)))  # (B, shallow, H/2, W/2)
        fine, coarse = self.down(skip), None  # (B, width, H/4, W/4)
        for each in self.passes:
            fine, coarse = each(fine, coarse)  # coarse: (B, deep, H/8, W/8)
        up = F.pixel_shuffle(F.relu(self.up(F.relu(self.end(fine)))), 2)  # (B, shallow, H/2, W/2)
        joined = F.relu(self.join(torch.cat([up, skip], dim=1)))
        return F.pixel_shuffle(self.head(joined), 2)  # no convolution at full resolution: twice as fast


class Muon(torch.optim.Optimizer):
    """Momentum whose matrices are brought near the closest orthogonal one (Jordan et al. 2024), Adam for the vectors.

    On this network a step is worth about two of AdamW's. https://kellerjordan.github.io/posts/muon
    """

    def __init__(self, parameters: Any, lr: float, weight_decay: float = 0.01) -> None:  # noqa: ANN401
        """Take what any optimizer takes."""
        super().__init__(parameters, {"lr": lr, "weight_decay": weight_decay})

    @torch.no_grad()
    def step(self, closure: Any = None) -> Any:  # noqa: ANN401  (torch's own signature)
        """Change all parameters once."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            for parameter in group["params"]:
                if parameter.grad is not None:
                    _muon(parameter, parameter.grad, self.state[parameter], group["lr"], group["weight_decay"])
        return loss


def _muon(parameter: Tensor, slope: Tensor, state: dict[str, Any], rate: float, decay: float) -> None:
    if not state:
        state.update(step=0, mean=torch.zeros_like(parameter), square=torch.zeros_like(parameter))
    state["step"] += 1
    if parameter.ndim < 2:
        state["mean"].lerp_(slope, 0.1)
        state["square"].lerp_(slope * slope, 0.02)
        mean, square = state["mean"] / (1 - 0.9 ** state["step"]), state["square"] / (1 - 0.98 ** state["step"])
        parameter.sub_(mean / (square.sqrt() + 1e-8), alpha=rate)
        return
    state["mean"].lerp_(slope, 0.05)
    update = slope.lerp(state["mean"], 0.95).flatten(1)  # (out, in * 3 * 3)
    tall = update.shape[0] > update.shape[1]
    x = update.T if tall else update
    x = x / (x.norm() + 1e-7)
    for _ in range(5):  # a Newton-Schulz iteration: all singular values towards 1
        square = x @ x.T
        x = 3.4445 * x + (-4.7750 * square + 2.0315 * square @ square) @ x
    x = (x.T if tall else x).reshape(parameter.shape)
    parameter.mul_(1 - rate * decay).sub_(x, alpha=0.2 * rate * math.sqrt(max(update.shape)))


# --- the model: what is learnt, and how -----------------------------------------------------------------------------


class PathPredictor(pl.LightningModule):
    """Predicts optimal moves and the heuristic ratio of every cell, given map and goal.

    A batch has the ``FIELDS``; a list of batches, of several map sizes even, is one step.

    Args:
        connectivity: 4 or 8 moves.
        corner_cutting: whether diagonal moves pass beside occupied cells.
        widths: channels at strides 2, 4 and 8.
        passes: exchanges between strides 4 and 8: how far information travels.
        learning_rate: the highest; it rises over 100 steps and falls as a cosine until the last step.
        ratio_weight: weight of the heuristic ratio's squared error.
        detour_weight: how much more cells count where the heuristic is more than 2 % too low.
    """

    def __init__(
        self,
        connectivity: int = 8,
        corner_cutting: bool = False,
        widths: tuple[int, int, int] = (32, 48, 48),
        passes: int = 3,
        learning_rate: float = 0.012,
        ratio_weight: float = 5.0,
        detour_weight: float = 2.0,
    ) -> None:
        """Make the network."""
        super().__init__()
        self.save_hyperparameters()
        self.movement = Movement(connectivity, corner_cutting)
        network = Network(connectivity, widths, passes)
        self.network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, occupied: Tensor, goals: Tensor) -> tuple[Tensor, Tensor]:
        """Return scores of the moves, (B, moves, H, W), and predicted heuristic ratios, (B, H, W) in [0, 1].

        Args:
            occupied: (B, 1, H, W), 0 free and anything else occupied; any H and W.
            goals: (B, 2), cells.
        """
        rows, columns = occupied.shape[2:]
        padded = F.pad(occupied, (0, -columns % STRIDE, 0, -rows % STRIDE), value=1)
        seen, astray = look(padded, goals, self.movement.connectivity)
        out = self.network(seen)[..., :rows, :columns]
        scores = torch.sub(out[:, :-1], astray[..., :rows, :columns], alpha=3)
        return scores, torch.sigmoid(out[:, -1].float())

    def training_step(self, batch: Sample | Sequence[Sample], batch_idx: int) -> Tensor:
        """Return the loss of one step."""
        values = self.losses(batch)
        self.log_dict({f"train_{name}": value for name, value in values.items()}, prog_bar=True)
        return values["loss"]

    def validation_step(self, batch: Sample | Sequence[Sample], batch_idx: int, dataloader_idx: int = 0) -> None:
        """Log the losses."""
        values = {f"val_{name}": value for name, value in self.losses(batch).items()}
        self.log_dict(values, batch_size=1 if isinstance(batch, list) else len(batch[0]))

    def losses(self, batch: Sample | Sequence[Sample]) -> dict[str, Tensor]:
        """Return the loss, that of the moves alone, and the share of cells whose most probable move is optimal."""
        sums = [self._sums(each) for each in _by_size([batch] if isinstance(batch, Sample) else batch)]
        loss, weight, error, right, cells = torch.stack(sums).sum(dim=0)
        moves = loss / weight
        return {"loss": moves + self.hparams["ratio_weight"] * error / cells, "moves": moves, "accuracy": right / cells}

    def _sums(self, batch: dict[str, Tensor]) -> Tensor:
        """Return sums over the cells with an optimal move: loss, its weight, squared error, right answers, cells."""
        scores, ratios = self(batch["map"], batch["goal"])
        optimal = batch["optimal_moves"][:, 0]  # (B, H, W), bit sets
        cells = optimal.nonzero(as_tuple=True)  # n of them
        optimal, ratio = optimal[cells], batch["heuristic_ratio"][:, 0][cells]
        scores = scores.permute(0, 2, 3, 1)[cells].float()  # (n, moves)
        legal = legal_moves(batch["map"], self.movement).permute(0, 2, 3, 1)[cells]
        bits = 2 ** torch.arange(scores.shape[1], device=scores.device)
        good = (optimal[:, None] & bits) != 0
        scores = scores.masked_fill(~legal, -math.inf)
        loss = scores.logsumexp(1) - scores.masked_fill(~good, -math.inf).logsumexp(1)  # -log P(any optimal move)
        weight = 1 + self.hparams["detour_weight"] * (ratio < 0.98)
        error = (ratios[cells] - ratio) ** 2
        right = good.gather(1, scores.argmax(1, keepdim=True))
        count = torch.tensor(float(len(ratio)), device=scores.device)
        return torch.stack([(loss * weight).sum(), weight.sum(), error.sum(), right.float().sum(), count])

    def configure_optimizers(self) -> Any:  # noqa: ANN401  (Lightning's signature)
        """Return Muon with a rate that rises, then falls as a cosine."""
        optimizer = Muon(self.parameters(), self.hparams["learning_rate"])
        steps = float(self.trainer.estimated_stepping_batches)

        def rate(step: int) -> float:
            return min(1.0, (step + 1) / 100) * (0.5 + 0.5 * math.cos(math.pi * min(1.0, step / steps)))

        schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, rate)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

    def save(self, file: str | PathLike[str]) -> None:
        """Write weights and arguments, as plain types and tensors."""
        known = {k: v for k, v in self.hparams.items() if not k.startswith("_")}  # LightningCLI adds one of its own
        arguments = {name: list(v) if isinstance(v, tuple) else v for name, v in known.items()}
        weights = {name: v.detach().cpu().contiguous() for name, v in self.state_dict().items()}
        torch.save({"arguments": arguments, "weights": weights}, file)

    @staticmethod
    def load(file: str | PathLike[str]) -> PathPredictor:
        """Return the model that `save` wrote, ready to plan."""
        saved = torch.load(file, map_location="cpu", weights_only=True)
        model = PathPredictor(**saved["arguments"])
        model.load_state_dict(saved["weights"])
        return model.eval()

    def predict(self, grids: Bytes, goals: Ints, views: int = 1) -> tuple[Floats, Floats]:
        """Return log probabilities (B, moves, H, W), up to a constant a cell, and heuristic ratios (B, H, W).

        Args:
            grids: (B, H, W), 0 free and 1 occupied.
            goals: (B, 2), cells.
            views: 1, 2 or 3: their mean over the map as it is, turned by 180 degrees, and transposed. Each costs as
                much as the first.
        """
        occupied = torch.from_numpy(np.array(grids, np.uint8))[:, None].to(self.device)
        cells = torch.as_tensor(np.array(goals, np.int64))
        last = torch.tensor(occupied.shape[2:]) - 1
        with torch.inference_mode(), _bfloat16(self.device):
            seen = [self(occupied, cells)]
            if views > 1:
                scores, ratios = self(occupied.flip(2, 3), last - cells)
                seen.append((scores.flip(2, 3)[:, _TURNED[: scores.shape[1]]], ratios.flip(1, 2)))
            if views > 2:
                scores, ratios = self(occupied.transpose(2, 3).contiguous(), cells.flip(1))
                seen.append((scores.transpose(2, 3)[:, _TRANSPOSED[: scores.shape[1]]], ratios.transpose(1, 2)))
        scores, ratios = seen[0]
        for more in seen[1:]:
            scores, ratios = scores + more[0], ratios + more[1]
        return [(each.float() / len(seen)).cpu().contiguous().numpy() for each in (scores, ratios)]

    def predict_path(self, map: npt.ArrayLike, start: npt.ArrayLike, goal: npt.ArrayLike) -> Ints:  # noqa: A002
        """Return the predicted path, (k, 2) cells from start to goal; (0, 2) where the moves do not lead there.

        Args:
            map: (H, W) or (1, H, W), 0 free and 1 occupied.
            start: its cell.
            goal: its cell.
        """
        grid = np.asarray(map, np.uint8).reshape(np.shape(map)[-2:])
        ends = np.array([start, goal], np.int64)
        plan = LearnedPlanner("walk", self, fallback=False).plan_batch(grid[None], ends[:1], ends[1:])[0]
        return np.asarray(plan.path, np.int64)


class Mixture(pl.LightningDataModule):
    """Several data modules at once: a training step gets a list with a batch of each; validation sees them in turn."""

    def __init__(self, parts: list[MapDataModule]) -> None:
        """Keep the parts."""
        super().__init__()
        self.parts = parts

    def prepare_data(self) -> None:
        """Build what is missing."""
        for part in self.parts:
            part.prepare_data()

    def setup(self, stage: str | None = None) -> None:
        """Open the datasets."""
        for part in self.parts:
            part.trainer = self.trainer
            part.setup(stage)

    def train_dataloader(self) -> CombinedLoader:
        """Return what yields lists of batches, until the first part ends."""
        return CombinedLoader([part.train_dataloader() for part in self.parts], "min_size")

    def val_dataloader(self) -> list[DataLoader[Sample]]:
        """Return a loader a part."""
        return [part.val_dataloader() for part in self.parts]


def _by_size(batches: Sequence[Sample]) -> list[dict[str, Tensor]]:
    """Return the batches with those of one map size joined."""
    groups: dict[torch.Size, list[dict[str, Tensor]]] = {}
    for batch in batches:
        fields = dict(zip(batch._fields, batch, strict=True))
        groups.setdefault(fields["map"].shape[2:], []).append(fields)
    names = ("map", "goal", "optimal_moves", "heuristic_ratio")
    return [{name: torch.cat([each[name] for each in group]) for name in names} for group in groups.values()]


def _bfloat16(device: torch.device) -> contextlib.AbstractContextManager[Any]:
    """Return the context that halves the time of a prediction where the processor multiplies bfloat16."""
    abilities: dict[str, Any] = getattr(torch.cpu, "get_capabilities", dict)()
    fast = abilities.get("avx512_bf16") or abilities.get("amx_bf16")
    return torch.autocast("cpu", torch.bfloat16) if device.type == "cpu" and fast else contextlib.nullcontext()


# --- planning: from predicted moves to paths ------------------------------------------------------------------------


def planners(model: PathPredictor) -> list[BatchPlanner]:
    """Return the planners of a model, as rows for `mapdata.evaluate`."""
    return [
        LearnedPlanner("path_predictor (walk)", model, fallback=False),
        LearnedPlanner("path_predictor (walk, else A*)", model),
        GuidedSearch("path_predictor (search, 3 views)", model, views=3),
    ]


@dataclass(frozen=True, eq=False)
class LearnedPlanner:
    """Follows the most probable legal move to a cell not yet visited, until the goal.

    Every cell of the walk is one expansion: each is taken once, and its neighbours are looked at, as in a search.

    Attributes:
        name: its name in the table.
        model: what predicts the moves.
        fallback: where a walk ends in a cell without unvisited neighbours, mapdata's A* begins anew from the start, and
            its expansions add to those of the walk; False gives up.
        views: of the map, as in `PathPredictor.predict`.
    """

    name: str
    model: PathPredictor
    fallback: bool = True
    views: int = 1

    def plan(self, grid: Bytes, start: Cell, goal: Cell) -> Plan:
        """Return the path from ``start`` to ``goal`` on ``grid``, (H, W)."""
        return self.plan_batch(np.asarray(grid)[None], np.array([start]), np.array([goal]))[0]

    def plan_batch(self, grids: Bytes, starts: Ints, goals: Ints) -> list[Plan]:
        """Return a plan for each problem: grids (B, H, W), starts and goals (B, 2).

        Raises:
            ValueError: a start or goal outside its map or on an occupied cell.
        """
        grids, starts, goals = _problems(grids, starts, goals)
        scores, _ = self.model.predict(grids, goals, self.views)
        movement = self.model.movement
        cells, offsets = _walk(grids, scores, starts, goals, int(movement.corner_cutting))
        plans, stuck = [], []
        for k, (begin, end) in enumerate(zip(offsets[:-1].tolist(), offsets[1:].tolist(), strict=True)):
            path = cells[begin:end]
            if (path[-1] != goals[k]).any():
                stuck.append(k)
                path = path[:0]
            plans.append(Plan(path, end - begin))
        if stuck and self.fallback:
            found = search_batch("astar", grids[stuck], starts[stuck], goals[stuck], movement)
            for n, k in enumerate(stuck):
                path = found.cells[found.offsets[n] : found.offsets[n + 1]]
                plans[k] = Plan(path, plans[k].expansions + int(found.iterations[n]))
        return plans


@dataclass(frozen=True, eq=False)
class GuidedSearch:
    """Best-first search by the cost so far, the predicted cost to go, and how improbable the moves so far were.

    f = g + ``trust`` * (sum over the moves of log P(best move) - log P(move)) + ``weight`` * h / ratio. A cell
    is expanded once; it finds a path where there is one, and needs no fallback.

    Attributes:
        name: its name in the table.
        model: what predicts the moves.
        trust: cells that a factor e of probability is worth.
        weight: of the predicted cost to go.
        views: of the map, as in `PathPredictor.predict`.
    """

    name: str
    model: PathPredictor
    trust: float = 2.0
    weight: float = 1.1
    views: int = 1

    def plan(self, grid: Bytes, start: Cell, goal: Cell) -> Plan:
        """Return the path from ``start`` to ``goal`` on ``grid``, (H, W)."""
        return self.plan_batch(np.asarray(grid)[None], np.array([start]), np.array([goal]))[0]

    def plan_batch(self, grids: Bytes, starts: Ints, goals: Ints) -> list[Plan]:
        """Return a plan for each problem: grids (B, H, W), starts and goals (B, 2).

        Raises:
            ValueError: a start or goal outside its map or on an occupied cell.
        """
        grids, starts, goals = _problems(grids, starts, goals)
        scores, ratios = self.model.predict(grids, goals, self.views)
        corners = int(self.model.movement.corner_cutting)
        plans = []
        for k in range(len(grids)):
            found = _search(grids[k], scores[k], ratios[k], starts[k], goals[k], corners, self.trust, self.weight)
            plans.append(Plan(*found))
        return plans


def _problems(grids: Bytes, starts: Ints, goals: Ints) -> tuple[Bytes, Ints, Ints]:
    """Return the problems as the kernels want them.

    Raises:
        ValueError: a start or goal outside its map or on an occupied cell.
    """
    grids = np.array(grids, np.uint8)
    starts, goals = np.array(starts, np.int64), np.array(goals, np.int64)
    for ends in (starts, goals):
        outside = (ends < 0).any() or (ends >= grids.shape[1:]).any()
        if outside or grids[np.arange(len(grids)), ends[:, 0], ends[:, 1]].any():
            raise ValueError("a start or goal is outside its map or on an occupied cell")
    return grids, starts, goals


@kernel
def _search(
    grid: Bytes, scores: Floats, ratios: Floats, start: Ints, goal: Ints, corners: Int, trust: float, weight: float
) -> tuple[Ints, Int]:
    """Return the path (k, 2) of one problem, and how many cells were expanded."""
    moves, rows, columns = scores.shape
    best = np.full((rows, columns), np.inf)  # g and what the improbable moves cost; -inf once a cell is expanded
    way, parent = np.zeros((rows, columns)), np.full((rows, columns), -1)
    best[start[0], start[1]] = 0.0
    heap, pushes, taken = [(0.0, 0, start[0] * columns + start[1])], 0, 0
    while heap:
        _, _, cell = heapq.heappop(heap)
        row, column = cell // columns, cell % columns
        so_far = best[row, column]
        if so_far == -np.inf:
            continue
        best[row, column] = -np.inf
        taken += 1
        if row == goal[0] and column == goal[1]:
            break
        top, legal = -np.inf, 0
        for k in range(moves):
            i, j = row + STEPS[k, 0], column + STEPS[k, 1]
            if i < 0 or j < 0 or i >= rows or j >= columns or grid[i, j]:
                continue
            if k >= 4 and not corners and (grid[i, column] or grid[row, j]):
                continue
            legal |= 1 << k
            top = max(top, scores[k, row, column])
        for k in range(moves):
            i, j = row + STEPS[k, 0], column + STEPS[k, 1]
            if not legal >> k & 1 or best[i, j] == -np.inf:
                continue
            step = 1.0 if k < 4 else math.sqrt(2.0)
            cost = so_far + step + trust * (top - scores[k, row, column])
            if cost < best[i, j]:
                best[i, j], way[i, j], parent[i, j] = cost, way[row, column] + step, cell
                high, wide = abs(i - goal[0]), abs(j - goal[1])
                least = max(high, wide) + (math.sqrt(2.0) - 1) * min(high, wide) if moves == 8 else high + wide
                pushes += 1
                f = cost + weight * least / max(ratios[i, j], 0.05) - 0.001 * way[i, j]  # among equals the farthest
                heapq.heappush(heap, (f, -pushes, i * columns + j))
    length, cell = 0, goal[0] * columns + goal[1]
    if best[goal[0], goal[1]] == -np.inf:
        while cell >= 0:
            length, cell = length + 1, parent[cell // columns, cell % columns]
    path, cell = np.empty((length, 2), np.int64), goal[0] * columns + goal[1]
    for at in range(length - 1, -1, -1):
        path[at, 0], path[at, 1] = cell // columns, cell % columns
        cell = parent[path[at, 0], path[at, 1]]
    return path, taken


@kernel
def _walk(grids: Bytes, scores: Floats, starts: Ints, goals: Ints, corner_cutting: Int) -> tuple[Ints, Ints]:
    """Return all walks one after another, (M, 2), and their offsets (B + 1,); a stuck one ends before its goal."""
    count, moves, rows, columns = scores.shape
    cells, offsets = np.empty((1024, 2), np.int64), np.zeros(count + 1, np.int64)
    visited = np.zeros((rows, columns), np.int64)
    for b in range(count):
        row, column, end, move = starts[b, 0], starts[b, 1], offsets[b], 0
        while move >= 0:
            if end == len(cells):
                longer = np.empty((2 * end, 2), np.int64)
                longer[:end] = cells
                cells = longer
            cells[end, 0], cells[end, 1] = row, column
            end += 1
            visited[row, column] = b + 1
            move, best = -1, np.float32(-np.inf)
            if row == goals[b, 0] and column == goals[b, 1]:
                break
            for k in range(moves):
                i, j = row + STEPS[k, 0], column + STEPS[k, 1]
                if i < 0 or j < 0 or i >= rows or j >= columns or grids[b, i, j] or visited[i, j] == b + 1:
                    continue
                if k >= 4 and not corner_cutting and (grids[b, i, column] or grids[b, row, j]):
                    continue
                if scores[b, k, row, column] > best:
                    move, best = k, scores[b, k, row, column]
            if move >= 0:
                row, column = row + STEPS[move, 0], column + STEPS[move, 1]
        offsets[b + 1] = end
    return cells[: offsets[count]], offsets


# --- looking at it --------------------------------------------------------------------------------------------------


def plot_prediction(model: PathPredictor, sample: Sample, axes: Axes | None = None) -> Axes:
    """Draw the predicted path of one sample over its map; the colour of a cell is its predicted heuristic ratio."""
    from mapdata.plot import PALETTE, plot_grid

    fields = dict(zip(sample._fields, sample, strict=True))
    grid, start, goal = (fields[name].cpu().numpy() for name in ("map", "start", "goal"))
    grid = grid[0].astype(np.uint8)
    axes = plot_grid(grid, axes)
    ratios = model.predict(grid[None], goal[None])[1][0]
    axes.imshow(np.ma.masked_array(ratios, grid != 0), cmap="viridis", vmin=0, vmax=1, alpha=0.6)
    path = model.predict_path(grid, start, goal)
    axes.plot(path[:, 1], path[:, 0], color=PALETTE[1], linewidth=2)
    for cell, mark in ((start, "o"), (goal, "*")):
        axes.plot(cell[1], cell[0], mark, color=PALETTE[0], markeredgecolor="white", markersize=10)
    axes.set_title("a path" if len(path) else "stuck")
    return axes
