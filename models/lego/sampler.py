"""A sampler that learns where a roadmap needs its vertices: a heat map over the cells of a map.

    import pytorch_lightning as pl
    from mapdata import MapDataModule
    from models.lego.sampler import Heatmap

    data = MapDataModule("data/maps", build="paper", batch_size=40)  # map, start, goal, path
    model = Heatmap(targets="path")
    pl.Trainer(max_epochs=2).fit(model, data)
    sample = data.datasets["val"][0]
    points = model.sample(sample.map, sample.start, sample.goal, 25)  # (25, 2) in free cells

So taught, it samples where paths run. LEGO (Kumar, Mandalika, Choudhury, Srinivasa, "LEGO:
Leveraging Experience in Roadmap Generation for Sampling-Based Planning", IROS 2019) asks only for
the bottlenecks of paths, which a sparse roadmap cannot do without. ``targets="lego"`` takes them
from the bank of experience of `models.lego.experience.FixedProblems`, whose batches have the fields
``TRAINING_FIELDS``. The shipped weights were trained so, by the commands in
scripts/train_lego_sampler.py:

    points = Heatmap.load("models/weights/lego_heatmap.pt").sample(grid, start, goal, 25)
    roadmap = between(grid, start, goal, points)  # of models/lego/roadmap.py

This file reads from top to bottom: what the network sees; targets, training, sampling; the heat
map: network, loss, prediction. The layers, symmetries and the training step are those that all
sample models share.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from numpy.random import Generator
from numpy.typing import ArrayLike
from torch import Tensor, nn

from mapdata import Sample, inflate
from mapdata.arrays import Bytes, Floats, Ints
from mapdata.checks import check_choice, check_count, check_resolution
from models.geometry import cell_numbers, check_problems, offsets
from models.layers import Trunk, padded
from models.model import Model, Tensors
from models.symmetries import random_symmetry, restore_plane, transform_cells, transform_plane

TRAINING_FIELDS = ("map", "start", "goal", "optimal_mask", "problem")
"""The fields for targets from a bank; the cells of all shortest paths help to learn."""

TARGETS = ("path", "lego", "shortest_path")
"""Where to sample: on the path's cells, or, of roadmaps, at bottlenecks or on shortest paths."""

HELP_WEIGHT = 4.0
"""Of the loss of the second prediction, which helps the features to form."""

# --- data: what the network sees ----------------------------------------------------------------


def encode(occupied: Tensor, starts: Tensor, goals: Tensor) -> Tensor:
    """Return (B, 14, H, W): free cells, both ends, and where each cell lies relative to them.

    Of maps (B, 1, H, W), 0 free and anything else occupied, and of cells (B, 2).
    """
    free = (occupied[:, 0] == 0).float()  # (B, H, W)
    planes = [free]
    way = torch.zeros_like(free)  # how long the way from start to goal over each cell is
    for cells in (starts, goals):
        down, right = offsets(cells, free.shape[1:])  # (B, H, 1) and (B, 1, W)
        distance = torch.hypot(down, right)  # (B, H, W)
        here = (distance == 0).float()
        fine = [(each / 4).clamp(-1, 1) for each in (down, right)]  # for cells nearby
        # divisors bring all planes to a size of about 1
        planes += [here, down / 32, right / 32, *fine, distance / 64]
        way += distance
    straight = torch.linalg.vector_norm((starts - goals).float(), dim=1)  # (B,)
    planes.append((way - straight[:, None, None]) / 32)  # the detour over each cell
    return torch.stack(torch.broadcast_tensors(*planes), dim=1)


# --- what all samplers share: targets, training, sampling ---------------------------------------


class Sampler(Model):
    """Learns where to sample.

    Its batches have the fields ``map, start, goal, path``, or `TRAINING_FIELDS`.
    """

    def __init__(self, targets: str) -> None:
        """Keep the kind of targets."""
        super().__init__()
        check_choice("targets", targets, TARGETS)
        self.targets = targets
        self.bank: Any = None  # a `models.lego.experience.Bank`

    @abstractmethod
    def loss(self, batch: Tensors, points: Tensor, owners: Tensor) -> Tensors:
        """Return the loss and its parts: points (M, 2) belong to the problems ``owners`` (M,)."""

    @abstractmethod
    def draw(self, grids: Bytes, starts: Ints, goals: Ints, n: int, source: Generator) -> Floats:
        """Return (B, n, 2) points in free cells, for problems that are known to be sound."""

    def on_fit_start(self) -> None:
        """Mine the bank of the training problems into runs/experience, or read it from there.

        For another folder, set ``bank`` before.
        """
        if self.targets != "path" and self.bank is None:
            data: Any = self.trainer.datamodule  # type: ignore[attr-defined]
            if not hasattr(data, "mine"):
                expected = "models.lego.experience.FixedProblems, or targets='path'"
                raise ValueError(f"targets: got {self.targets!r}, which need {expected}")
            self.bank = data.mine("runs/experience")

    def target_points(self, batch: Sample) -> tuple[Tensor, Tensor]:
        """Return where to sample, points (M, 2), and to which problem each belongs, (M,)."""
        if self.targets == "path":
            owners, k = (batch.path[:, :, 0] >= 0).nonzero(as_tuple=True)  # padding is -1
            return batch.path[owners, k] + 0.5, owners  # the centres of the path's cells
        ends = torch.cat([batch.start, batch.goal], dim=1)  # (B, 4), for the bank to compare
        found, counts = self.bank.targets(self.targets, batch.problem.cpu(), ends.cpu())
        numbers = np.repeat(np.arange(len(counts)), counts)  # (M,)
        points, owners = self.tensors(found.astype(np.float32), numbers)
        return points, owners

    def losses(self, batch: Sample) -> Tensors:
        """Return `loss` on the targets of a batch, after a random symmetry."""
        points, owners = self.target_points(batch)
        fields, points = random_symmetry(batch._asdict(), points)
        return self.loss(fields, points, owners)

    def validation_step(self, batch: Sample, batch_idx: int) -> None:
        """Leave it to `models.lego.comparison.RoadmapSuccess` to judge the batch."""

    def sample(
        self,
        map: ArrayLike,
        start: ArrayLike,
        goal: ArrayLike,
        n: int,
        seed: int = 0,
        *,
        radius: float = 0.0,
        resolution: float | None = None,
        origin: tuple[float, float] = (0.0, 0.0),
    ) -> Floats:
        """Return (n, 2) points in free cells: where the roadmap of this problem wants its vertices.

        A point is (row, col), 0.5 more than a cell in its middle. With a ``resolution`` it is
        (x, y) in metres, y upwards, as in ROS.

        Args:
            map: (H, W) or (1, H, W), 0 free and anything else occupied.
            start: its cell.
            goal: its cell.
            n: number of points.
            seed: of the draws.
            radius: of the robot, in metres with a ``resolution``, else in cells; points are in
                cells that it may be at.
            resolution: metres a cell.
            origin: (x, y) of the map's lower left corner, in metres; a map that is turned by a yaw
                needs its points turned, too.

        Raises:
            ValueError: a start or goal outside the map or on an occupied cell, for a robot of the
                radius; n below 1; what `mapdata.inflate` refuses; a resolution of 0 or less.
        """
        unit = 1.0 if resolution is None else check_resolution("resolution", resolution)
        plane = np.asarray(map).reshape(np.shape(map)[-2:]) != 0
        grid = inflate(plane, radius / unit)
        points = self.sample_batch(grid, start, goal, n, seed).squeeze(0)
        if resolution is None:
            return points
        rows, columns = points.T
        x0, y0 = origin
        return np.column_stack([x0 + unit * columns, y0 + unit * (len(grid) - rows)])

    def sample_batch(
        self, grids: ArrayLike, starts: ArrayLike, goals: ArrayLike, n: int, seed: int = 0
    ) -> Floats:
        """Return (B, n, 2) points, as `sample`: grids (B, H, W), starts and goals (B, 2)."""
        check_count("n", n)
        problems = check_problems(grids, starts, goals)
        with self.inference():
            return self.draw(*problems, n, np.random.default_rng(seed))


# --- the heat map: network, loss, prediction ----------------------------------------------------


class Heatmap(Sampler):
    """Predicts each cell's share of the targets, and which cells lie on shortest paths.

    Args:
        targets: one of ``TARGETS``.
        widths: channels at strides 2, 4 and 8.
        passes: exchanges between strides 4 and 8.
        learning_rate: the highest.
        temperature: 1 draws cells by their shares, 0 takes the likeliest: it solves more problems.
        spacing: cells around a sample within which further ones are less likely.
        views: 1 to 8 symmetries of the map, whose mean the shares are; each takes as long.
    """

    def __init__(
        self,
        targets: str = "lego",
        widths: tuple[int, int, int] = (32, 48, 64),
        passes: int = 3,
        learning_rate: float = 0.003,
        temperature: float = 0.0,
        spacing: float = 1.25,
        views: int = 4,
    ) -> None:
        """Make the network."""
        super().__init__(targets)
        self.save_hyperparameters()
        self.trunk = Trunk(14, 2, widths, passes)
        nn.init.normal_(self.trunk.head.weight, std=0.02)

    def forward(self, occupied: Tensor, starts: Tensor, goals: Tensor) -> Tensor:
        """Return scores (B, 2, H, W): the shares are the first one's softmax over free cells.

        The second one is the logit of lying on a shortest path. Arguments as of `encode`.
        """
        rows, columns = occupied.shape[2:]
        seen = encode(padded(occupied), starts, goals)  # (B, 14, H, W), up to 15 cells more
        scores: Tensor = self.trunk(seen)
        return scores[..., :rows, :columns].float()

    def loss(self, batch: Tensors, points: Tensor, owners: Tensor) -> Tensors:
        """Return the cross entropy of the shares, and of the second prediction."""
        occupied = batch["map"].flatten(1) != 0  # (B, H * W)
        scores = self(batch["map"], batch["start"], batch["goal"]).flatten(2)  # (B, 2, H * W)
        # -30 instead of -inf: a target that rounding puts into a wall costs much, not everything
        log_shares = scores[:, 0].masked_fill(occupied, -30).log_softmax(1)  # (B, H * W)
        cells = cell_numbers(points, batch["map"])  # (M,)
        each = -log_shares[owners, cells]  # (M,)
        # the mean over problems of the mean over their targets
        counts = torch.bincount(owners, minlength=len(occupied))  # (B,)
        heat = (each / counts[owners]).sum() / (counts > 0).sum().clamp(min=1)
        if "optimal_mask" not in batch:
            return {"loss": heat}
        on_path = batch["optimal_mask"].flatten(1)[~occupied].float()
        path = F.binary_cross_entropy_with_logits(scores[:, 1][~occupied], on_path)
        return {"loss": heat + HELP_WEIGHT * path, "heat": heat, "path": path}

    def heat_map(self, grids: Bytes, starts: Ints, goals: Ints) -> Floats:
        """Return (B, H, W) shares of the cells, 0 in occupied ones."""
        occupied, start, goal = self.tensors(grids[:, None], starts, goals)
        # as many symmetries: none, half a turn, mirrored at both diagonals, the others
        views = (0, 3, 4, 7, 1, 2, 5, 6)[: self.hparams["views"]]
        total = torch.zeros(grids.shape, dtype=torch.float64)
        with self.inference():
            for code in views:
                seen = transform_plane(occupied, code)
                ends = [transform_cells(end, code, occupied.shape) for end in (start, goal)]
                scores = self(seen, *ends)[:, 0]
                scores = scores.masked_fill(seen[:, 0] != 0, -math.inf)  # (B, H, W)
                shares = scores.flatten(1).double().softmax(1).view_as(scores)
                total += restore_plane(shares, code).cpu()
                # what one way needs, the way back needs too: the next view is of that
                start, goal = goal, start
        return np.asarray(total / len(views))

    def draw(self, grids: Bytes, starts: Ints, goals: Ints, n: int, source: Generator) -> Floats:
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
    count, rows, columns = heat_map.shape
    # (2 H - 1, 2 W - 1): what a chosen cell in the middle does to the cells around it
    down, right = np.indices((2 * rows - 1, 2 * columns - 1))
    away = ((down - rows + 1) ** 2 + (right - columns + 1) ** 2) / spacing**2
    with np.errstate(divide="ignore"):  # the log of 0 is what it should be: -inf
        scores = np.log(heat_map) + noise
        penalty = np.where(away < 9, np.log(1 - np.exp(-away / 2)), 0)
    penalty[rows - 1, columns - 1] = -1e6  # more than all that scores differ by
    chosen = np.empty((count, n, 2))
    for k in range(n):
        for b in range(count):
            row, column = divmod(scores[b].argmax(), columns)
            # lay the middle of the table over the chosen cell
            around = penalty[rows - 1 - row :, columns - 1 - column :]
            scores[b] += around[:rows, :columns]
            chosen[b, k] = row, column
    return chosen
