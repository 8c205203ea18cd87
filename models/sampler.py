"""What the learned samplers share: what their networks see, their batches, their symmetries, how
they are asked.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from os import PathLike
from typing import Any

import numpy as np
import numpy.typing as npt
import pytorch_lightning as pl
import torch
from torch import Tensor, nn

from mapdata.arrays import Bytes, Floats, Ints
from mapdata.datasets import Sample
from models.experience import KINDS, Bank
from models.layers import Muon, bfloat16, scheduled
from models.roadmap import between, free_at, halton
from models.saved import save_model

FIELDS = ("map", "start", "goal", "optimal_mask", "problem")
"""What a data module must serve."""

CHANNELS = 14
"""Planes of what a network sees."""


def encode(occupied: Tensor, starts: Tensor, goals: Tensor) -> Tensor:
    """Return what a network sees, (B, 14, H, W): free cells, both ends, and where each cell lies
    relative to them.

    Args:
        occupied: (B, 1, H, W), 0 free and anything else occupied.
        starts: (B, 2), cells.
        goals: (B, 2), cells.
    """
    count, _, rows, columns = occupied.shape
    row = torch.arange(rows, device=occupied.device).view(1, -1, 1).expand(count, rows, columns)
    column = (
        torch.arange(columns, device=occupied.device).view(1, 1, -1).expand(count, rows, columns)
    )
    planes, estimates = [(occupied[:, 0] == 0).float()], []
    for cells in (starts, goals):
        down, right = (
            (row - cells[:, 0, None, None]).float(),
            (column - cells[:, 1, None, None]).float(),
        )
        estimates.append(torch.hypot(down, right))
        planes += [((down == 0) & (right == 0)).float(), down / 32, right / 32]
        planes += [(down / 4).clamp(-1, 1), (right / 4).clamp(-1, 1), estimates[-1] / 64]
    span = torch.linalg.vector_norm((starts - goals).float(), dim=1)[:, None, None]
    planes.append((estimates[0] + estimates[1] - span) / 32)
    return torch.stack(planes, dim=1)


class Sampler(pl.LightningModule, ABC):
    """Learns where to sample from batches with the `FIELDS` and the bank of their problems.

    The bank is mined in the first fit, or read if it is there. The data module must keep its
    problems: stored ones, or random ones through `models.experience.FixedProblems`.
    """

    def __init__(self, targets: str, learning_rate: float, experience: str) -> None:
        """Keep what all have: the kind of targets, the highest learning rate, the folder of
        banks.
        """
        super().__init__()
        if targets not in KINDS:
            raise ValueError(f"targets: got {targets!r}, expected one of {', '.join(KINDS)}")
        self.targets, self.learning_rate, self.experience = targets, learning_rate, experience
        self.bank: Bank | None = None

    @abstractmethod
    def loss(self, batch: dict[str, Tensor], points: Tensor, owners: Tensor) -> dict[str, Tensor]:
        """Return the loss and its parts, for points (M, 2) that belong to the problems ``owners``
        (M,) of a batch.
        """

    @abstractmethod
    def draw(
        self, grids: Bytes, starts: Ints, goals: Ints, n: int, source: np.random.Generator
    ) -> Floats:
        """Return (B, n, 2) points in free cells, for problems that are known to be sound."""

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
        grid = np.asarray(map, np.uint8).reshape(np.shape(map)[-2:])
        ends = np.array([start, goal], np.int64).reshape(2, 1, 2)
        found: Floats = self.sample_batch(grid[None], ends[0], ends[1], n, seed)[0]
        return found

    def sample_batch(
        self, grids: Bytes, starts: Ints, goals: Ints, n: int, seed: int = 0
    ) -> Floats:
        """Return (B, n, 2) points, as `sample`: grids (B, H, W), starts and goals (B, 2)."""
        cells = np.array(grids, np.uint8)
        if n < 1:
            raise ValueError(f"n: got {n}, expected at least 1 sample")
        if cells.reshape(len(cells), -1).all(axis=1).any():
            raise ValueError(
                f"map: got one of {cells.shape[1:]} without a free cell, expected one to sample in"
            )
        ends = [np.array(each, np.int64) for each in (starts, goals)]
        for name, each in zip(("start", "goal"), ends, strict=True):
            for grid, cell in zip(cells, each, strict=True):
                if not free_at(grid, cell + 0.5)[0]:
                    raise ValueError(
                        f"{name}: got {cell.tolist()}, expected a free cell of a map of "
                        f"{grid.shape}"
                    )
        with torch.inference_mode(), bfloat16(self.device):
            return self.draw(cells, ends[0], ends[1], n, np.random.default_rng(seed))

    def on_fit_start(self) -> None:
        """Mine or read the bank of the training problems."""
        if self.bank is None:
            data: Any = self.trainer.datamodule  # type: ignore[attr-defined]
            self.bank = Bank.of(data.datasets["train"], self.experience)

    def training_step(self, batch: Sample, batch_idx: int) -> Tensor:
        """Return the loss of one step."""
        assert self.bank is not None
        fields = dict(zip(batch._fields, batch, strict=True))
        ends = torch.cat([fields["start"], fields["goal"]], dim=1).cpu().numpy()
        points, counts = self.bank.targets(self.targets, fields["problem"].cpu().numpy(), ends)
        places = torch.as_tensor(points, dtype=torch.float32, device=self.device)
        owners = (
            torch.arange(len(counts)).repeat_interleave(torch.as_tensor(counts)).to(self.device)
        )
        values = self.loss(*_transformed(fields, places), owners)
        self.log_dict({f"train_{name}": value for name, value in values.items()}, prog_bar=True)
        return values["loss"]

    def validation_step(self, batch: Sample, batch_idx: int) -> None:
        """Log the share of problems that roadmaps of 50 vertices solve, half of them by Halton."""
        fields = dict(zip(batch._fields, batch, strict=True))
        grids, starts, goals = (fields[name].cpu().numpy() for name in ("map", "start", "goal"))
        grids = grids[:, 0].astype(np.uint8)
        found = 0
        for k, points in enumerate(self.sample_batch(grids, starts, goals, 25)):
            roadmap = between(
                grids[k], starts[k], goals[k], np.concatenate([halton(grids[k], 25, k), points])
            )
            found += math.isfinite(roadmap.shortest_path()[0])
        self.log("val_success", found / len(grids), batch_size=len(grids), prog_bar=True)

    def configure_optimizers(self) -> Any:
        """Return the optimizer with a rate that rises, then falls as a cosine."""
        return scheduled(self.optimizer(), float(self.trainer.estimated_stepping_batches))

    def optimizer(self) -> torch.optim.Optimizer:
        """Return the optimizer."""
        return Muon(self.parameters(), self.learning_rate)

    def save(self, file: str | PathLike[str]) -> None:
        """Write arguments and weights, as plain types and tensors of 16 bits: they were learnt with
        no more.
        """
        save_model(self, file, torch.float16)


def _transformed(fields: dict[str, Tensor], points: Tensor) -> tuple[dict[str, Tensor], Tensor]:
    """Return a batch and its points after a random symmetry; start and goal may change places,
    too.
    """
    code, swap = int(torch.randint(8, ())), bool(torch.rand(()) < 0.5)
    size = torch.tensor(fields["map"].shape[2:], device=points.device)
    ends = [fields["goal"], fields["start"]] if swap else [fields["start"], fields["goal"]]
    names = ("map", "optimal_mask", "start", "goal")
    planes = [transform_plane(fields[name], code) for name in names[:2]]
    cells = [transform_points(each + 0.5, code, size).floor().long() for each in ends]
    return dict(zip(names, [*planes, *cells], strict=True)), transform_points(points, code, size)


def transform_plane(plane: Tensor, code: int) -> Tensor:
    """Return (..., H, W) after a symmetry: bit 0 flips rows, bit 1 flips columns, bit 2 transposes
    at last.
    """
    transformed = plane.flip([axis - 2 for axis in range(2) if code >> axis & 1])
    return transformed.transpose(-2, -1) if code & 4 else transformed


def restore_plane(plane: Tensor, code: int) -> Tensor:
    """Return what `transform_plane` turned."""
    transformed = plane.transpose(-2, -1) if code & 4 else plane
    return transformed.flip([axis - 2 for axis in range(2) if code >> axis & 1])


def transform_points(points: Tensor, code: int, size: Tensor) -> Tensor:
    """Return points (M, 2) on a map of ``size`` after a symmetry."""
    flips = torch.tensor([code & 1, code >> 1 & 1], device=points.device)
    transformed = points * (1 - 2 * flips) + size * flips
    return transformed.flip(1) if code & 4 else transformed


def tensors(model: nn.Module, grids: Bytes, starts: Ints, goals: Ints) -> list[Tensor]:
    """Return maps (B, 1, H, W), starts and goals (B, 2) on the device of a model."""
    device = next(model.parameters()).device
    return [
        torch.as_tensor(np.array(each), device=device) for each in (grids[:, None], starts, goals)
    ]


def cell_numbers(points: Tensor, occupied: Tensor) -> Tensor:
    """Return the number row * columns + column of each point's cell, (M,)."""
    rows, columns = occupied.shape[2:]
    cells = points.floor().long()
    return cells[:, 0].clamp(0, rows - 1) * columns + cells[:, 1].clamp(0, columns - 1)
