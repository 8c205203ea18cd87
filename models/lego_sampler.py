"""A LEGO-style sampler in one file, to read and to copy: it learns where a roadmap needs vertices.

    python -m mapdata.models.lego_sampler data/dungeon --weights sampler.ckpt

trains it on a dataset in a few minutes of one core, and prints a table that compares it with
uniform and Halton points; roadmaps need scipy. A copy runs in the same way, `python my_sampler.py`,
from any folder; `--steps 20 --problems 20` is a trial of a minute. The file reads from top to
bottom: targets, planes, network, loss, training, prediction, comparison.

LEGO (Kumar, Mandalika, Choudhury, Srinivasa, "LEGO: Leveraging Experience in Roadmap Generation for
Sampling-Based Planning", IROS 2019) learns which vertices the shortest paths of a roadmap cannot do
without, and samples there. The targets here are simpler: the cells where a shortest path turns at a
corner of an obstacle. docs/samplers.md says where LEGO's mined bottlenecks are better.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytorch_lightning as pl
import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from pytorch_lightning.utilities.types import OptimizerLRScheduler
from torch import Tensor, nn

from mapdata import MapDataModule, Movement, ProblemSet, Random, Sample
from mapdata.arrays import Bytes, Floats, Ints
from mapdata.evaluation import prior
from mapdata.models import fast_precision
from mapdata.roadmaps import compare, contenders, to_text
from mapdata.search import STEPS

MOVEMENT = Movement(connectivity=8)
"""Eight moves that cut no corner."""

PROBLEMS = Random(distance=(10, None))
"""Problems whose shortest path has a cost of at least 10 cells."""


# --- targets ------------------------------------------------------------------------------------


def at_corners(maps: Tensor) -> Tensor:
    """Return which free cells of maps (B, 1, H, W) lie at a convex corner of an obstacle, as bool.

    A neighbour on a diagonal is occupied, and both cells between it and the cell are free.
    """
    rows, columns = maps.shape[2:]
    surrounded = F.pad(maps == 1, (1, 1, 1, 1), value=True)

    def occupied(down: int, right: int) -> Tensor:
        return surrounded[..., 1 + down : 1 + down + rows, 1 + right : 1 + right + columns]

    is_corner = torch.zeros_like(maps, dtype=torch.bool)
    for down, right in STEPS[4:].tolist():  # the diagonal moves
        is_corner |= occupied(down, right) & ~occupied(down, 0) & ~occupied(0, right)
    return is_corner & ~occupied(0, 0)


def targets(batch: Sample) -> Tensor:
    """Return the cells where the path turns at a corner of an obstacle, (B, 1, H, W) bool.

    The data module calls it as a field, with the fields that stand before it in `FIELDS`.
    """
    steps = batch.path.diff(dim=1)  # (B, T - 1, 2)
    turns_next = (steps[:, 1:] != steps[:, :-1]).any(dim=2)  # (B, T - 2)
    turns_next &= batch.path[:, 2:, 0] >= 0  # what follows the goal is padding
    problem, k = turns_next.nonzero(as_tuple=True)
    row, column = batch.path[problem, k + 1].unbind(dim=1)
    is_turn = torch.zeros_like(batch.map, dtype=torch.bool)
    is_turn[problem, 0, row, column] = True
    return is_turn & at_corners(batch.map)


FIELDS = ("map", "start", "goal", "path", targets)
"""What the data module serves: the problem, and the targets of every cell."""


# --- planes: what the network sees --------------------------------------------------------------


PLANES = 6
"""How many planes `planes_of` returns."""


def planes_of(maps: Tensor, starts: Tensor, goals: Tensor) -> Tensor:
    """Return the input of the network, (B, PLANES, H, W), whose numbers are of a size of about 1.

    The problems are maps (B, 1, H, W), and cells (B, 2) as starts and goals. Planes are computed
    from them alone, because where points are sampled there are no labels.
    """
    planes = [maps[:, 0]]
    over_cell = torch.zeros_like(maps[:, 0], dtype=torch.float32)  # from start to goal over a cell
    for ends in (starts, goals):
        _, known = prior(maps[:, 0].cpu(), ends.cpu(), MOVEMENT)  # costs on an empty map
        costs = torch.from_numpy(known).to(maps.device)
        near_end = (costs / 4).clamp(max=1)  # tells neighbouring cells apart; farther away it is 1
        planes += [costs / 64, near_end]
        over_cell += costs
    planes.append((over_cell - over_cell.amin(dim=(1, 2), keepdim=True)) / 32)
    return torch.stack([plane.float() for plane in planes], dim=1)


# --- network ------------------------------------------------------------------------------------


class Block(nn.Module):
    """A residual block: its input plus the output of two convolutions, the second one dilated."""

    def __init__(self, width: int, dilation: int) -> None:
        """Make the convolutions; the block begins as the identity."""
        super().__init__()
        self.first = nn.Conv2d(width, width, 3, padding=1)
        self.second = nn.Conv2d(width, width, 3, padding=dilation, dilation=dilation)
        nn.init.zeros_(self.second.weight)

    def forward(self, x: Tensor) -> Tensor:
        """Return features (B, width, H, W) for features of the same shape."""
        correction: Tensor = self.second(F.relu(self.first(F.relu(x))))
        return x + correction


class Network(nn.Module):
    """From planes (B, inputs, H, W) to features of every cell; H and W are multiples of 4.

    Features of 4 x 4 cells exchange information near and far; features of 2 x 2 cells add details.
    """

    def __init__(self, inputs: int, outputs: int, fine: int = 24, coarse: int = 48) -> None:
        """Make the layers, with ``fine`` channels of 2 x 2 cells and ``coarse`` ones of 4 x 4."""
        super().__init__()
        self.stem = nn.Conv2d(4 * inputs, fine, 3, padding=1)
        self.down = nn.Conv2d(fine, coarse, 2, stride=2)
        self.blocks = nn.Sequential(*(Block(coarse, d) for d in (1, 2, 4, 1, 2, 4)))
        self.up = nn.Conv2d(coarse, 4 * fine, 1)
        self.join = nn.Conv2d(2 * fine, fine, 3, padding=1)
        self.head = nn.Conv2d(fine, 4 * outputs, 1)

    def forward(self, planes: Tensor) -> Tensor:
        """Return features (B, outputs, H, W)."""
        details = F.relu(self.stem(F.pixel_unshuffle(planes, 2)))  # (B, fine, H/2, W/2)
        context = self.blocks(self.down(details))  # (B, coarse, H/4, W/4)
        context = F.pixel_shuffle(F.relu(self.up(context)), 2)  # (B, fine, H/2, W/2)
        joined = self.join(torch.cat([context, details], dim=1))  # (B, fine, H/2, W/2)
        return F.pixel_shuffle(self.head(F.relu(joined)), 2)


# --- loss and training --------------------------------------------------------------------------


class LegoSampler(pl.LightningModule):
    """Predicts which share of the vertices of a roadmap each cell should have.

    Args:
        learning_rate: the highest of the schedule.
    """

    def __init__(self, learning_rate: float = 0.003) -> None:
        """Make the network."""
        super().__init__()
        self.save_hyperparameters()
        network = Network(inputs=PLANES, outputs=1)
        # Convolutions take less time where the channels of a cell stand together in memory.
        self.network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, maps: Tensor, starts: Tensor, goals: Tensor) -> Tensor:
        """Return the logarithms of the shares of all cells, (B, H, W).

        The problems are maps (B, 1, H, W), and cells (B, 2) as starts and goals.
        """
        rows, columns = maps.shape[2:]
        padded = F.pad(maps, (0, -columns % 4, 0, -rows % 4), value=1)
        output = self.network(planes_of(padded, starts, goals)).float()  # (B, 1, H, W)
        # Such a score is a share of 0. Unlike -inf it does not turn other losses into NaN.
        scores = output[..., :rows, :columns].masked_fill(maps == 1, -1e4)
        log_shares: Tensor = scores.flatten(1).log_softmax(dim=1).view(-1, rows, columns)
        return log_shares

    def loss(self, batch: Sample) -> Tensor:
        """Return the loss of a batch with the fields `FIELDS`: the cross entropy of the targets.

        It is the mean over the problems whose paths turn of

            loss = - mean over the targets of a problem of log(share)
        """
        log_shares = self(batch.map, batch.start, batch.goal)  # (B, H, W)
        is_target = batch.targets[:, 0] > 0  # (B, H, W)
        counts = is_target.sum(dim=(1, 2))  # (B,)
        sums = log_shares.masked_fill(~is_target, 0).sum(dim=(1, 2))  # (B,)
        means = sums / counts.clamp(min=1)  # (B,)
        loss: Tensor = -means.sum() / (counts > 0).sum().clamp(min=1)
        return loss

    def training_step(self, batch: Sample, _: int) -> Tensor:
        """Return the loss of one step."""
        loss = self.loss(batch)
        self.log("train_loss", loss, prog_bar=True)
        return loss

    def validation_step(self, batch: Sample, _: int) -> None:
        """Log the loss on problems of the validation split."""
        self.log("val_loss", self.loss(batch), prog_bar=True, batch_size=len(batch.map))

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Return AdamW, whose learning rate rises and then falls to 0 at the last step."""
        optimizer = torch.optim.AdamW(self.parameters())
        steps = int(self.trainer.estimated_stepping_batches)
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimizer,
            max_lr=self.hparams["learning_rate"],
            total_steps=max(steps, 100),  # a short trial has the beginning of a schedule
            pct_start=0.1,
        )
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": schedule, "interval": "step"},
        }

    # --- prediction -----------------------------------------------------------------------------

    @torch.inference_mode()
    def sample_batch(
        self, grids: Bytes, starts: Ints, goals: Ints, n: int, seed: int = 0
    ) -> Floats:
        """Return (B, n, 2) points (row, column) in free cells.

        One point after another lies in the cell with the largest share, at a random place of it,
        and lowers the shares around it, so that the next point lies elsewhere. The problems are
        grids (B, H, W), and cells (B, 2) as starts and goals.
        """
        maps, start_cells, goal_cells = (
            torch.tensor(array, device=self.device) for array in (grids, starts, goals)
        )
        log_shares = self(maps[:, None], start_cells, goal_cells)  # (B, H, W)
        scores = log_shares.masked_fill(maps == 1, -torch.inf).cpu()  # no point lies there
        rows, columns = torch.meshgrid(*map(torch.arange, scores.shape[1:]), indexing="ij")
        cells = []
        for _ in range(n):
            best = scores.flatten(1).argmax(dim=1)[:, None, None]  # (B, 1, 1)
            row, column = best // scores.shape[2], best % scores.shape[2]
            cells.append(torch.cat([row, column], dim=2))
            squared = (rows - row) ** 2 + (columns - column) ** 2  # distance to the cell, (B, H, W)
            nearness = (-squared / (2 * SPACING**2)).exp()  # 1 in the cell itself
            # The bound is there so that cells are taken again once all others are.
            scores = scores + (1 - nearness).log().clamp(min=-1e6)
        inside = np.random.default_rng(seed).random((len(scores), n, 2))
        return torch.cat(cells, dim=1).numpy() + inside


SPACING = 1.25
"""Distance from a sampled cell, in cells, within which others become less likely."""


# --- a program: train, then compare -------------------------------------------------------------

ROOT = "data/dungeon"
"""The dataset that is trained on if no other is named. This one is built if it is missing."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Train on a dataset, and compare the sampler with others on its test split."""
    parser = argparse.ArgumentParser(description="Train a sampler of roadmaps, and compare it.")
    parser.add_argument("root", nargs="?", default=ROOT, help="folder of a dataset")
    parser.add_argument("--steps", type=int, default=1500, help="steps of 16 problems each")
    parser.add_argument("--weights", help="file to which the weights are written")
    parser.add_argument("--problems", type=int, default=200, help="problems that are compared")
    options = parser.parse_args(arguments)
    pl.seed_everything(1)
    is_missing = Path(options.root) == Path(ROOT) and not Path(ROOT).exists()
    data = MapDataModule(
        options.root,
        build="dungeon" if is_missing else None,
        fields=FIELDS,
        problems=PROBLEMS,
        movement=MOVEMENT,
        augment=True,
        batch_size=16,
    )
    trainer = pl.Trainer(
        accelerator="cpu",
        precision=fast_precision(),
        max_steps=options.steps,
        gradient_clip_val=1.0,
        limit_val_batches=4,
        logger=False,
        enable_checkpointing=False,
    )
    model = LegoSampler()
    trainer.fit(model, data)
    if options.weights is not None:  # LegoSampler.load_from_checkpoint(file) reads them
        trainer.save_checkpoint(options.weights, weights_only=True)
    problems = ProblemSet.read(options.root, options.problems, movement=MOVEMENT)  # random ones
    rows = contenders({"learned": model.eval()})
    # Of the points of "learned", half are Halton's, as in LEGO. Those of "learned_alone" are not.
    names = ("uniform", "halton", "learned", "learned_alone")
    print(to_text(compare({name: rows[name] for name in names}, problems, [24, 50])))


if __name__ == "__main__":
    main()
