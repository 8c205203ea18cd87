"""A sampler that learns where a roadmap needs its vertices: a heat map over the cells of a map.

    import pytorch_lightning as pl
    from mapdata import MapDataModule
    from models.lego_sampler import Heatmap

    data = MapDataModule("data/maps", build="paper", batch_size=40)  # map, start, goal, path
    model = Heatmap(targets="path")
    pl.Trainer(max_epochs=2).fit(model, data)
    sample = data.datasets["val"][0]
    points = model.sample(sample.map, sample.start, sample.goal, 25)  # (25, 2) in free cells

So taught, it samples where paths run. LEGO (Kumar, Mandalika, Choudhury, Srinivasa, "LEGO:
Leveraging Experience in Roadmap Generation for Sampling-Based Planning", IROS 2019) asks only for
the bottlenecks of paths, which a sparse roadmap cannot do without. ``targets="lego"`` takes them
from the bank of experience of `models.experience.FixedProblems`, with its ``FIELDS``:

    model = Heatmap.load("models/weights/lego_heatmap.pt")
    points = model.sample(grid, start, goal, 25)
    roadmap = between(grid, start, goal, np.concatenate([halton(grid, 25), points]))

with both functions from models/roadmap.py. scripts/train_lego_sampler.py names the command that
made each of the weights that ship; models/cvae.py has LEGO's own autoencoder.

This file reads from top to bottom: what the network sees; what all samplers share, data and
training; the heat map: network, loss, prediction. The network's layers, symmetries of maps, the
optimizer and the files of weights are in models/common.py.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from os import PathLike
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import pytorch_lightning as pl
import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from torch import Tensor, nn

from mapdata import Sample
from mapdata.arrays import Bytes, Flags, Floats, Ints
from models.common import (
    Muon,
    Trunk,
    bfloat16,
    load_model,
    one_cycle,
    padded,
    restore_plane,
    save_model,
    transform_cells,
    transform_plane,
    transform_points,
)

FIELDS = ("map", "start", "goal", "optimal_mask", "problem")
"""The fields for targets from a bank; the cells of all shortest paths help to learn."""

TARGETS = ("path", "lego", "shortest_path")
"""Where a sampler shall sample: on the cells of the path, or at points of a bank of experience:
the bottlenecks of paths on roadmaps ("lego"), or vertices of the shortest of them.
"""

CHANNELS = 14
"""Planes of what a network sees."""

# --- what the network sees ----------------------------------------------------------------------


def encode(occupied: Tensor, starts: Tensor, goals: Tensor) -> Tensor:
    """Return (B, 14, H, W): free cells, both ends, and where each cell lies relative to them.

    Args:
        occupied: (B, 1, H, W), 0 free and anything else occupied.
        starts: (B, 2), cells.
        goals: (B, 2), cells.
    """
    count, _, rows, columns = occupied.shape
    shape = (count, rows, columns)
    planes = [(occupied[:, 0] == 0).float()]
    distances = []
    for cells in (starts, goals):  # divisors bring all planes to a size of about 1
        row = torch.arange(rows, device=cells.device) - cells[:, :1]  # (B, H)
        column = torch.arange(columns, device=cells.device) - cells[:, 1:]  # (B, W)
        down = row[:, :, None].float().expand(shape)  # (B, H, W)
        right = column[:, None, :].float().expand(shape)  # (B, H, W)
        distance = torch.hypot(down, right)  # (B, H, W)
        planes += [(distance == 0).float(), down / 32, right / 32]
        planes += [(down / 4).clamp(-1, 1), (right / 4).clamp(-1, 1), distance / 64]
        distances.append(distance)
    span = torch.linalg.vector_norm((starts - goals).float(), dim=1)  # (B,)
    detour = distances[0] + distances[1] - span[:, None, None]  # (B, H, W) of the way over a cell
    planes.append(detour / 32)
    return torch.stack(planes, dim=1)


def cell_numbers(points: Tensor, occupied: Tensor) -> Tensor:
    """Return the number row * columns + column of each point's cell, (M,)."""
    rows, columns = occupied.shape[2:]
    cells = points.floor().long()  # (M, 2)
    return cells[:, 0].clamp(0, rows - 1) * columns + cells[:, 1].clamp(0, columns - 1)


def random_symmetry(fields: dict[str, Tensor], points: Tensor) -> tuple[dict[str, Tensor], Tensor]:
    """Return a batch and its points after a symmetry; start and goal may change places, too."""
    code = int(torch.randint(8, ()))
    shape = fields["map"].shape
    changed: dict[str, Tensor] = {}
    for name in ("map", "optimal_mask"):
        if name in fields:
            changed[name] = transform_plane(fields[name], code)
    changed["start"] = transform_cells(fields["start"], code, shape)
    changed["goal"] = transform_cells(fields["goal"], code, shape)
    if torch.rand(()) < 0.5:
        changed["start"], changed["goal"] = changed["goal"], changed["start"]
    return changed, transform_points(points, code, shape)


# --- what all samplers share: targets, training, sampling ---------------------------------------

S = TypeVar("S", bound="Sampler")


class Sampler(pl.LightningModule, ABC):
    """Learns where to sample from batches with ``map, start, goal, path``, or with `FIELDS`.

    Targets other than "path" come from a bank of experience, which `FixedProblems` mines in the
    first fit, or reads if it is there.
    """

    def __init__(self, targets: str, learning_rate: float, experience: str) -> None:
        """Keep the kind of targets, the highest learning rate, the folder of banks."""
        super().__init__()
        if targets not in TARGETS:
            raise ValueError(f"targets: got {targets!r}, expected one of {', '.join(TARGETS)}")
        self.targets = targets
        self.learning_rate = learning_rate
        self.experience = experience
        self.bank: Any = None  # a `models.experience.Bank`

    @abstractmethod
    def loss(self, batch: dict[str, Tensor], points: Tensor, owners: Tensor) -> dict[str, Tensor]:
        """Return the loss and its parts: points (M, 2) belong to the problems ``owners`` (M,)."""

    @abstractmethod
    def draw(
        self, grids: Bytes, starts: Ints, goals: Ints, n: int, source: np.random.Generator
    ) -> Floats:
        """Return (B, n, 2) points in free cells, for problems that are known to be sound."""

    def on_fit_start(self) -> None:
        """Mine or read the bank of the training problems."""
        if self.bank is None and self.targets != "path":
            data: Any = self.trainer.datamodule  # type: ignore[attr-defined]
            if not hasattr(data, "mine"):
                raise ValueError(
                    f"targets: {self.targets!r} are points of a bank of experience, which the data "
                    "module models.experience.FixedProblems has; any other teaches 'path'"
                )
            self.bank = data.mine(self.experience)

    def target_points(self, batch: Sample) -> tuple[Tensor, Tensor]:
        """Return where to sample, points (M, 2), and to which problem each belongs, (M,)."""
        if self.targets == "path":
            owners, k = (batch.path[:, :, 0] >= 0).nonzero(as_tuple=True)  # padding is -1
            return batch.path[owners, k] + 0.5, owners
        ends = torch.cat([batch.start, batch.goal], dim=1)  # (B, 4): the bank refuses others
        points, counts = self.bank.targets(
            self.targets, batch.problem.cpu().numpy(), ends.cpu().numpy()
        )
        owners = torch.from_numpy(np.repeat(np.arange(len(counts)), counts))
        return torch.from_numpy(points).float().to(self.device), owners.to(self.device)

    def training_step(self, batch: Sample, batch_idx: int) -> Tensor:
        """Return the loss of one step."""
        points, owners = self.target_points(batch)
        fields, points = random_symmetry(batch._asdict(), points)
        values = self.loss(fields, points, owners)
        self.log_dict({f"train_{name}": value for name, value in values.items()}, prog_bar=True)
        return values["loss"]

    def validation_step(self, batch: Sample, batch_idx: int) -> Tensor:
        """Return samples (B, 25, 2), for `models.sampler_table.RoadmapSuccess` to judge."""
        grids = batch.map[:, 0].cpu().numpy()
        points = self.sample_batch(grids, batch.start.cpu().numpy(), batch.goal.cpu().numpy(), 25)
        return torch.from_numpy(points)

    def configure_optimizers(self) -> Any:
        """Return the optimizer and torch's OneCycleLR."""
        return one_cycle(self.optimizer(), self.trainer.estimated_stepping_batches)

    def optimizer(self) -> torch.optim.Optimizer:
        """Return the optimizer."""
        return Muon(self.parameters(), self.learning_rate)

    def sample(
        self, map: npt.ArrayLike, start: npt.ArrayLike, goal: npt.ArrayLike, n: int, seed: int = 0
    ) -> Floats:
        """Return (n, 2) points in free cells: where the roadmap of this problem wants its vertices.

        Args:
            map: (H, W) or (1, H, W), 0 free and 1 occupied.
            start: its cell.
            goal: its cell.
            n: how many.
            seed: of the draws.

        Raises:
            ValueError: no free cell, a start or goal outside the map or on an occupied cell, or n
                below 1.
        """
        grid = np.asarray(map, np.uint8).reshape(1, *np.shape(map)[-2:])
        ends = np.asarray(start)[None], np.asarray(goal)[None]  # (1, 2) both
        found: Floats = self.sample_batch(grid, *ends, n, seed)[0]
        return found

    def sample_batch(
        self, grids: Bytes, starts: Ints, goals: Ints, n: int, seed: int = 0
    ) -> Floats:
        """Return (B, n, 2) points, as `sample`: grids (B, H, W), starts and goals (B, 2)."""
        grids = np.array(grids, np.uint8)
        ends = {"start": np.array(starts, np.int64), "goal": np.array(goals, np.int64)}
        if n < 1:
            raise ValueError(f"n: got {n}, expected at least 1 sample")
        size = grids.shape[1:]
        if grids.all(axis=(1, 2)).any():
            raise ValueError(f"map: got one of {size} without a free cell, expected one to sample")
        for name, cells in ends.items():
            inside: Flags = np.all((cells >= 0) & (cells < size), axis=1)  # (B,)
            row, column = np.where(inside[:, None], cells, 0).T
            free: Flags = inside & (grids[np.arange(len(grids)), row, column] == 0)  # (B,)
            if not free.all():
                wrong = cells[free.argmin()].tolist()
                raise ValueError(f"{name}: got {wrong}, expected a free cell of a map of {size}")
        with torch.inference_mode(), bfloat16(self.device):
            return self.draw(grids, ends["start"], ends["goal"], n, np.random.default_rng(seed))

    def tensors(self, *arrays: npt.NDArray[Any]) -> list[Tensor]:
        """Return arrays as tensors on the device of the model."""
        return [torch.from_numpy(np.array(each)).to(self.device) for each in arrays]

    def save(self, file: str | PathLike[str]) -> None:
        """Write arguments and weights in 16 bits, since no more were learnt, as plain types."""
        save_model(self, file, torch.float16)

    @classmethod
    def load(cls: type[S], file: str | PathLike[str]) -> S:
        """Return the sampler of this class that `save` wrote; errors as of `load_model`."""
        return load_model(file, cls)


# --- the heat map: network, loss, prediction ----------------------------------------------------

VIEWS = (0, 3, 4, 7, 1, 2, 5, 6)
"""Symmetries of a map, as `transform_plane` numbers them, in the order in which a heat map adds
them: those that keep rows as rows come first, for maps that are not square.
"""


class Heatmap(Sampler):
    """Predicts each cell's share of the targets, and which cells lie on shortest paths.

    Args:
        targets: one of ``TARGETS``.
        widths: channels at strides 2, 4 and 8.
        passes: exchanges between strides 4 and 8.
        learning_rate: the highest.
        help_weight: weight of the second prediction's loss, where a batch has ``optimal_mask``; it
            is there to help the features.
        temperature: 1 draws cells by their shares; 0 takes always the likeliest, which solves more
            problems.
        spacing: cells around a sample within which further ones are less likely.
        views: 1 to 8 symmetries of the map, whose mean the shares are; each costs as much as the
            first.
        experience: folder of banks.
    """

    def __init__(
        self,
        targets: str = "lego",
        widths: tuple[int, int, int] = (32, 48, 64),
        passes: int = 3,
        learning_rate: float = 0.003,
        help_weight: float = 4.0,
        temperature: float = 0.0,
        spacing: float = 1.25,
        views: int = 4,
        experience: str = "runs/experience",
    ) -> None:
        """Make the network."""
        super().__init__(targets, learning_rate, experience)
        self.save_hyperparameters()
        self.trunk = Trunk(CHANNELS, 2, widths, passes)
        nn.init.normal_(self.trunk.head.weight, std=0.02)

    def forward(self, occupied: Tensor, starts: Tensor, goals: Tensor) -> Tensor:
        """Return scores (B, 2, H, W): the shares are the first one's softmax over free cells.

        The second one is the logit of lying on a shortest path. Arguments as of `encode`.
        """
        rows, columns = occupied.shape[2:]
        cells, _ = self.trunk(encode(padded(occupied), starts, goals))
        scores: Tensor = cells[..., :rows, :columns].float()
        return scores

    def loss(self, batch: dict[str, Tensor], points: Tensor, owners: Tensor) -> dict[str, Tensor]:
        """Return the cross entropy of the shares, and of the second prediction."""
        occupied = batch["map"].flatten(1) != 0  # (B, H * W)
        scores = self(batch["map"], batch["start"], batch["goal"]).flatten(2)  # (B, 2, H * W)
        # -30 instead of -inf: a target that rounding puts into a wall costs much, not everything
        log_shares = scores[:, 0].masked_fill(occupied, -30).log_softmax(1)  # (B, H * W)
        each = -log_shares[owners, cell_numbers(points, batch["map"])]  # (M,)
        counts = torch.bincount(owners, minlength=len(occupied))  # (B,) targets of each problem
        # the mean over problems of the mean over their targets
        heat = (each / counts[owners]).sum() / (counts > 0).sum().clamp(min=1)
        if "optimal_mask" not in batch:
            return {"loss": heat}
        on_path = batch["optimal_mask"].flatten(1)[~occupied].float()
        path = F.binary_cross_entropy_with_logits(scores[:, 1][~occupied], on_path)
        return {"loss": heat + self.hparams["help_weight"] * path, "heat": heat, "path": path}

    def heat_map(self, grids: Bytes, starts: Ints, goals: Ints) -> Floats:
        """Return (B, H, W) shares of the cells, 0 in occupied ones."""
        occupied, start, goal = self.tensors(grids[:, None], starts, goals)
        views = VIEWS[: self.hparams["views"]]
        total = torch.zeros(grids.shape, dtype=torch.float64)
        with torch.inference_mode(), bfloat16(self.device):
            for k, code in enumerate(views):
                seen = transform_plane(occupied, code)
                # what one way needs, the way back needs too
                pair = (start, goal) if k % 2 == 0 else (goal, start)
                ends = [transform_cells(each, code, occupied.shape) for each in pair]
                scores = self(seen, *ends)[:, 0]
                scores = scores.masked_fill(seen[:, 0] != 0, -math.inf)  # (B, H, W)
                shares = scores.flatten(1).double().softmax(1).view(scores.shape)
                total += restore_plane(shares, code).cpu()
        found: Floats = (total / len(views)).numpy()
        return found

    def draw(
        self, grids: Bytes, starts: Ints, goals: Ints, n: int, source: np.random.Generator
    ) -> Floats:
        """Return points in cells drawn without replacement, each uniform inside its cell."""
        heat_map = self.heat_map(grids, starts, goals)
        noise = self.hparams["temperature"] * source.gumbel(size=heat_map.shape)
        cells = select(heat_map, noise, n, self.hparams["spacing"])
        return cells + source.random(cells.shape)


def select(heat_map: Floats, noise: Floats, n: int, spacing: float) -> Floats:
    """Return (B, n, 2) cells: always the one with the highest log share + noise, (B, H, W) each.

    A chosen cell makes its neighbours less likely, by 1 - exp(-(distance / spacing)^2 / 2), and is
    itself not taken again before all others are.
    """
    count = len(heat_map)
    reach = int(3 * spacing)
    row, column = np.indices((2 * reach + 1, 2 * reach + 1)) - reach
    away = (row**2 + column**2) / spacing**2  # (2 reach + 1, 2 reach + 1)
    with np.errstate(divide="ignore"):
        penalty = np.where(away < 9, np.log(1 - np.exp(-away / 2)), 0)
        log_shares = np.log(heat_map)
    penalty[reach, reach] = -1e6  # more than all that scores differ by
    # a margin, so that the window about a cell never leaves the array
    margin = ((0, 0), (reach, reach), (reach, reach))
    scores = np.pad(log_shares + noise, margin, constant_values=-np.inf)
    chosen = np.empty((count, n, 2))
    for k in range(n):
        for b in range(count):
            cell = scores[b].argmax()
            i, j = divmod(int(cell), scores.shape[2])
            scores[b, i - reach : i + reach + 1, j - reach : j + reach + 1] += penalty
            chosen[b, k] = i - reach, j - reach
    return chosen
