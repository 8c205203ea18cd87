"""A sampler that learns where a roadmap needs its vertices: a heat map over the cells of a map.

    import pytorch_lightning as pl
    from mapdata import MapDataModule
    from mapdata.models import Heatmap

    data = MapDataModule("data/maps", build="paper", batch_size=40)  # map, start, goal, path
    model = Heatmap(targets="path")
    pl.Trainer(max_epochs=2).fit(model, data)
    sample = data.datasets["val"][0]
    points = model.sample(sample.map, sample.start, sample.goal, 25)  # (25, 2) in free cells

A model that is trained on paths samples where paths run. LEGO (Kumar, Mandalika, Choudhury,
Srinivasa, "LEGO: Leveraging Experience in Roadmap Generation for Sampling-Based Planning", IROS
2019) needs only the bottlenecks of paths, which a sparse roadmap cannot do without.
``targets="lego"`` takes them from the bank of experience of
`mapdata.models.pretrained.lego.experience.FixedProblems`, whose batches must have the fields
``TRAINING_FIELDS``. The pretrained weights were trained in this way, by the commands in train.py:

    points = Heatmap.pretrained().sample(grid, start, goal, 25)
    roadmap = roadmap_between(grid, start, goal, points)  # of mapdata.roadmaps

This file reads from top to bottom: what the network sees; targets, training and sampling, which all
samplers share; the network, loss and prediction of the heat map. The layers, symmetries and the
training step are those that all models share.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from numpy.random import Generator
from numpy.typing import ArrayLike
from torch import Tensor, nn

from mapdata import MapDataModule, Sample, inflate, to_metres
from mapdata.arrays import Bytes, Floats, Ints
from mapdata.checks import (
    check_choice,
    check_count,
    check_finite,
    check_number,
    check_resolution,
)
from mapdata.roadmaps import path_lengths, sample_half_halton

from ..geometry import cell_numbers, check_problems, offsets
from ..layers import Trunk, padded
from ..model import Model, Tensors
from ..symmetries import random_symmetry, restore_plane, transform_cells, transform_plane
from .experience import MINED_TARGETS, Bank, FixedProblems, check_no_terrain

TRAINING_FIELDS = ("map", "start", "goal", "optimal_mask", "problem")
"""The fields for targets from a bank; `Heatmap` also learns from the cells of shortest paths."""

TARGETS = ("path", *MINED_TARGETS)
"""Where to sample: on the cells of the path in the batch, or at the targets of a bank."""

PATH_WEIGHT = 4.0
"""Weight of the loss of the second prediction, which helps the network to form its features."""

# --- data: what the network sees ----------------------------------------------------------------


def encode(occupied: Tensor, starts: Tensor, goals: Tensor) -> Tensor:
    """Return (B, 14, H, W): free cells, both ends, and where each cell lies relative to them.

    Args:
        occupied: (B, 1, H, W), 0 free and anything else occupied.
        starts: (B, 2), cells.
        goals: (B, 2), cells.
    """
    free = (occupied[:, 0] == 0).float()  # (B, H, W)
    planes = [free]
    over_cell = torch.zeros_like(free)  # (B, H, W), length from start to goal over each cell
    for cells in (starts, goals):
        down, right = offsets(cells, free.shape[1:])  # (B, H, 1) and (B, 1, W)
        distance = torch.hypot(down, right)  # (B, H, W)
        is_end = (distance == 0).float()  # (B, H, W)
        # Near the end these two tell neighbouring cells apart; farther away they are -1 or 1.
        near_down = (down / 4).clamp(-1, 1)  # (B, H, 1)
        near_right = (right / 4).clamp(-1, 1)  # (B, 1, W)
        # The divisors bring all planes to a size of about 1.
        planes += [is_end, down / 32, right / 32, near_down, near_right, distance / 64]
        over_cell += distance
    straight = torch.linalg.vector_norm((starts - goals).float(), dim=1)  # (B,)
    detour = over_cell - straight[:, None, None]  # (B, H, W)
    planes.append(detour / 32)
    return torch.stack(torch.broadcast_tensors(*planes), dim=1)


# --- what all samplers share: targets, training, sampling ---------------------------------------


class Sampler(Model):
    """The base class of models that learn where to sample.

    Batches have the fields ``map, start, goal, path`` for targets "path", or `TRAINING_FIELDS`.

    Args:
        targets: one of `TARGETS`.

    Attributes:
        bank: the bank of the training problems, which is taken from the data module when training
            begins; None for targets "path".
    """

    def __init__(self, targets: str) -> None:
        """Keep the name of the targets."""
        super().__init__()
        check_choice("targets", targets, TARGETS)
        self.targets = targets
        self.bank: Bank | None = None

    @abstractmethod
    def loss(self, batch: Tensors, points: Tensor, owners: Tensor) -> Tensors:
        """Return the loss and its parts.

        Args:
            batch: the fields of B problems, by name.
            points: (M, 2), the targets of all problems.
            owners: (M,), the row in the batch of the problem that each point belongs to.
        """

    @abstractmethod
    def draw(self, grids: Bytes, starts: Ints, goals: Ints, n: int, rng: Generator) -> Floats:
        """Return (B, n, 2) points in free cells, for problems that were checked before."""

    def on_fit_start(self) -> None:
        """Take the bank of the data module, which the targets are read from.

        Raises:
            ValueError: maps with terrain; targets that need a bank, and data without one.
        """
        data = self.trainer.datamodule  # type: ignore[attr-defined]
        if isinstance(data, MapDataModule):
            check_no_terrain(data)
        if self.targets == "path":
            return
        if not isinstance(data, FixedProblems) or data.bank is None:
            raise ValueError(
                f"targets: got {self.targets!r}, which need a bank of experience: expected data of "
                "mapdata.models.pretrained.lego.experience.FixedProblems with a folder for it, or "
                "targets='path'"
            )
        self.bank = data.bank

    def target_points(self, batch: Sample) -> tuple[Tensor, Tensor]:
        """Return where to sample, points (M, 2), and the row of the problem of each, (M,)."""
        if self.targets == "path":
            is_cell = batch.path[:, :, 0] >= 0  # (B, T); -1 is padding
            owners, k = is_cell.nonzero(as_tuple=True)  # (M,) both
            centres = batch.path[owners, k] + 0.5  # (M, 2)
            return centres, owners
        assert self.bank is not None  # `on_fit_start` has set it
        ends = torch.cat([batch.start, batch.goal], dim=1)  # (B, 4), for the bank to compare
        targets, counts = self.bank.targets(self.targets, batch.problem.cpu(), ends.cpu())
        rows = np.repeat(np.arange(len(counts)), counts)  # (M,)
        points, owners = self.tensors(targets.astype(np.float32), rows)
        return points, owners

    def losses(self, batch: Sample) -> Tensors:
        """Return `loss` on the targets of a batch, after a random symmetry."""
        points, owners = self.target_points(batch)
        fields, points = random_symmetry(batch._asdict(), points)
        return self.loss(fields, points, owners)

    def validation_step(self, batch: Sample, batch_idx: int) -> None:
        """Log ``val_success``: the share of problems that roadmaps of 50 vertices solve.

        As in the table of docs/samplers.md, half of the vertices are Halton's.
        """
        fields = (batch.map[:, 0], batch.start, batch.goal)
        grids, starts, goals = (field.cpu().numpy() for field in fields)
        points = sample_half_halton(self, grids, starts, goals, 50, range(len(grids)))
        solved = np.isfinite(path_lengths(grids, starts, goals, points))
        self.log("val_success", solved.mean(), batch_size=len(grids), prog_bar=True)

    def sample(
        self,
        map: ArrayLike,
        start: ArrayLike,
        goal: ArrayLike,
        n: int,
        seed: int = 0,
        *,
        radius_cells: float = 0.0,
        radius: float = 0.0,
        resolution: float | None = None,
        origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> Floats:
        """Return (n, 2) points in free cells: where a roadmap of this problem needs its vertices.

        A point is (row, column); the centre of a cell is its row and column plus 0.5. With a
        ``resolution`` a point is (x, y) in metres, y upwards, as in ROS.

        Args:
            map: (H, W) or (1, H, W), 0 free and anything else occupied.
            start: (2,), cell.
            goal: (2,), cell.
            n: number of points.
            seed: seed of the draws.
            radius_cells: radius of the robot, in cells, without a ``resolution``; points lie in
                cells at which the robot meets no obstacle.
            radius: the same in metres, with a ``resolution``.
            resolution: side of a cell, in metres.
            origin: (x, y, yaw) of the lower left corner of the map, as in `mapdata.to_metres`.

        Raises:
            ValueError: a start or goal outside the map or on an occupied cell, for a robot of the
                radius; n below 1; what `mapdata.inflate` refuses; a resolution of 0 or less; a
                radius in metres without a resolution, or one in cells with it.
        """
        occupied = np.asarray(map).reshape(np.shape(map)[-2:]) != 0  # (H, W)
        if resolution is None:
            if radius:
                raise ValueError(
                    f"radius: got {radius} metres without a resolution; give resolution=, or the "
                    "radius in cells as radius_cells="
                )
            grid = inflate(occupied, radius_cells)
            return self.sample_batch(grid, start, goal, n, seed).squeeze(0)
        check_resolution("resolution", resolution)
        if radius_cells:
            raise ValueError(
                f"radius_cells: got {radius_cells} with a resolution, expected radius= in metres"
            )
        grid = inflate(occupied, check_number("radius", radius) / resolution)
        points = self.sample_batch(grid, start, goal, n, seed).squeeze(0)
        return to_metres(points=points, rows=len(grid), resolution=resolution, origin=origin)

    def sample_batch(
        self, grids: ArrayLike, starts: ArrayLike, goals: ArrayLike, n: int, seed: int = 0
    ) -> Floats:
        """Return (B, n, 2) points in cells: grids (B, H, W), starts and goals (B, 2).

        Raises:
            ValueError: n below 1, or a start or goal outside its map or on an occupied cell.
        """
        check_count("n", n)
        problems = check_problems(grids, starts, goals)
        with self.inference():
            return self.draw(*problems, n, np.random.default_rng(seed))


# --- the heat map: network, loss, prediction ----------------------------------------------------


class Heatmap(Sampler):
    """Predicts each cell's share of the targets, and which cells lie on shortest paths.

    Args:
        targets: one of `TARGETS`.
        widths: channels at strides 2, 4 and 8.
        passes: number of exchanges between strides 4 and 8.
        learning_rate: the highest of the schedule.
        temperature: 1 draws cells by their shares; 0 takes the cells with the largest shares, which
            solves more problems.
        spacing: distance from a sampled cell, in cells, within which others become less likely.
        views: number of symmetries of the map, 1 to 8, over which shares are averaged; the time of
            a prediction grows with it.
    """

    PRETRAINED: ClassVar[Mapping[str, str]] = {
        "lego": "lego_heatmap.safetensors",  # targets are the bottlenecks of paths
        "shortest_path": "shortest_path_heatmap.safetensors",  # targets are the points of paths
    }

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
        self._check_learning_rate()
        check_finite("temperature", temperature)
        check_finite("spacing", spacing)
        if check_count("views", views) > 8:
            raise ValueError(f"views: got {views}, expected 1 to 8 symmetries")
        self.trunk = Trunk(14, 2, widths, passes)
        nn.init.normal_(self.trunk.head.weight, std=0.02)

    def forward(self, occupied: Tensor, starts: Tensor, goals: Tensor) -> Tensor:
        """Return two scores of each cell, (B, 2, H, W).

        The softmax of the first score over all free cells is the share of the targets. The second
        score is the logit of the probability that the cell lies on a shortest path.

        Args:
            occupied: (B, 1, H, W), 0 free and anything else occupied; any H and W.
            starts: (B, 2), cells.
            goals: (B, 2), cells.
        """
        rows, columns = occupied.shape[2:]
        seen = encode(padded(occupied), starts, goals)  # (B, 14, H, W), up to 15 cells more
        scores: Tensor = self.trunk(seen)
        return scores[..., :rows, :columns].float()

    def loss(self, batch: Tensors, points: Tensor, owners: Tensor) -> Tensors:
        """Return the cross entropy of the shares, and of the second prediction."""
        occupied = batch["map"].flatten(1) != 0  # (B, H * W)
        scores = self(batch["map"], batch["start"], batch["goal"]).flatten(2)  # (B, 2, H * W)
        # -30 instead of -inf, because float32 can round a target at a border into an occupied cell,
        # which would make the loss infinite.
        log_shares = scores[:, 0].masked_fill(occupied, -30).log_softmax(1)  # (B, H * W)
        cells = cell_numbers(points, batch["map"])  # (M,)
        target_losses = -log_shares[owners, cells]  # (M,)
        # Problems count equally, however many targets they have: the mean over a problem's targets,
        # then the mean over the problems that have targets.
        counts = torch.bincount(owners, minlength=len(occupied))  # (B,)
        problems = (counts > 0).sum().clamp(min=1)  # in a batch without targets the loss is 0
        heat_loss = (target_losses / counts[owners]).sum() / problems
        if "optimal_mask" not in batch:
            return {"loss": heat_loss}
        on_path = batch["optimal_mask"].flatten(1)[~occupied].float()  # (free cells,)
        path_logits = scores[:, 1][~occupied]  # (free cells,)
        path_loss = F.binary_cross_entropy_with_logits(path_logits, on_path)
        loss = heat_loss + PATH_WEIGHT * path_loss
        return {"loss": loss, "heat": heat_loss, "path": path_loss}

    def heat_map(self, grids: Bytes, starts: Ints, goals: Ints) -> Floats:
        """Return (B, H, W) shares of the cells, 0 in occupied ones."""
        occupied, start, goal = self.tensors(grids[:, None], starts, goals)
        # Codes of symmetries, in the order in which ``views`` adds them: the map itself, half a
        # turn, mirrored at each diagonal, then the others.
        codes = (0, 3, 4, 7, 1, 2, 5, 6)[: self.hparams["views"]]
        total = torch.zeros(grids.shape, dtype=torch.float64)
        with self.inference():
            for code in codes:
                view = transform_plane(occupied, code)
                ends = [transform_cells(end, code, occupied.shape) for end in (start, goal)]
                scores = self(view, *ends)[:, 0]
                scores = scores.masked_fill(view[:, 0] != 0, -math.inf)  # (B, H, W)
                shares = scores.flatten(1).double().softmax(1).view_as(scores)
                total += restore_plane(shares, code).cpu()
                # A path from goal to start needs the same vertices, so the next view swaps both.
                start, goal = goal, start
        return np.asarray(total / len(codes))

    def draw(self, grids: Bytes, starts: Ints, goals: Ints, n: int, rng: Generator) -> Floats:
        """Return points in cells drawn without replacement, each uniform inside its cell.

        The largest sum of log share and Gumbel noise is a draw by shares (Gumbel-max trick).
        """
        heat_map = self.heat_map(grids, starts, goals)
        noise = self.hparams["temperature"] * rng.gumbel(size=heat_map.shape)
        cells = select(heat_map, noise, n, self.hparams["spacing"])
        return cells + rng.random(cells.shape)


def select(heat_map: Floats, noise: Floats, n: int, spacing: float) -> Floats:
    """Return (B, n, 2) cells, in each step the one with the highest score.

    The score of a cell is

        score   = log(share) + noise + sum over the selected cells of penalty
        penalty = log(1 - exp(-(distance / spacing) ** 2 / 2)) within 3 spacings, 0 farther away

        share       share of the cell in the heat map, without unit
        noise       without unit
        distance    distance from the selected cell, in cells
        spacing     in cells

    Penalties spread the samples: cells near a selected one become less likely. A selected cell is
    not selected again before all others are.

    Args:
        heat_map: (B, H, W), shares of the cells.
        noise: (B, H, W).
        n: number of cells.
        spacing: in cells.
    """
    count, rows, columns = heat_map.shape
    # What a selected cell adds to the scores around it, (2 H - 1, 2 W - 1): the selected cell is in
    # the middle of this table, at (H - 1, W - 1).
    row_numbers, column_numbers = np.indices((2 * rows - 1, 2 * columns - 1))
    down = row_numbers - (rows - 1)
    right = column_numbers - (columns - 1)
    squared = (down**2 + right**2) / spacing**2
    with np.errstate(divide="ignore"):  # the log of 0 is -inf, as it should be
        scores = np.log(heat_map) + noise
        penalty = np.where(squared < 9, np.log(1 - np.exp(-squared / 2)), 0)
    penalty[rows - 1, columns - 1] = -1e6  # more than all other differences of scores
    selected = np.empty((count, n, 2))
    for k in range(n):
        for b in range(count):
            row, column = divmod(scores[b].argmax(), columns)
            # The part of the table that covers the map when its middle lies on the selected cell.
            top = rows - 1 - row
            left = columns - 1 - column
            scores[b] += penalty[top : top + rows, left : left + columns]
            selected[b, k] = row, column
    return selected
