"""A CNN path predictor in one file, to read and to copy: it predicts the moves of shortest paths.

    python -m mapdata.models.path_predictor data/dungeon --weights moves.ckpt

trains it on a dataset in a few minutes of one core, and prints a table that compares it with
classical planners. The file reads from top to bottom: targets, planes, network, loss, training,
prediction, comparison.

For every cell of a map the network predicts which moves begin a shortest path to the goal, and the
cost to go. `GuidedSearch` plans with both, and finds a path wherever there is one. The network does
not begin from nothing: `prior` has the scores of the moves and the costs to go on an empty map, and
the network corrects them where obstacles are in the way. Before training its scores are nearly
those of the row "guided search, no network" of the table, which is the row to beat.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
import pytorch_lightning as pl
import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from pytorch_lightning.utilities.types import OptimizerLRScheduler
from torch import Tensor, nn

from mapdata import MapDataModule, Movement, ProblemSet, Random, Sample, evaluate
from mapdata.arrays import Bytes, Float32s, Ints
from mapdata.evaluation import GuidedSearch, classical, prior, to_text
from mapdata.models import fast_precision

ROOT = "data/dungeon"
"""The dataset that is trained on if no other is named; it is built if it is missing."""

MOVEMENT = Movement(connectivity=8)
"""Eight moves that cut no corner."""

FIELDS = ("map", "start", "goal", "optimal_moves", "heuristic_ratio")
"""What the data module serves: the problem, and the targets of every cell."""

HARD = Random(distance=(10, None), hardness=(1.05, None))
"""Problems whose shortest path is at least 5 % longer than on an empty map."""


# --- targets ------------------------------------------------------------------------------------


def is_optimal(optimal_moves: Tensor) -> Tensor:
    """Return which moves begin a shortest path to the goal, (B, 8, H, W) bool.

    Args:
        optimal_moves: (B, 1, H, W) uint8; bit k is set where move k of `mapdata.search.STEPS` does.
    """
    bits = torch.arange(8, device=optimal_moves.device)[:, None, None]
    return (optimal_moves >> bits) & 1 == 1


# --- planes: what the network sees --------------------------------------------------------------


def planes_of(maps: Tensor, scores: Tensor, costs: Tensor) -> Tensor:
    """Return the input of the network, (B, 11, H, W), whose numbers are of a size of about 1.

    Args:
        maps: (B, 1, H, W), 0 free and 1 occupied.
        scores: (B, 8, H, W), scores of the moves on an empty map: where the goal lies.
        costs: (B, 1, H, W), costs to go on an empty map, in cells.
    """
    near_goal = (costs / 4).clamp(max=1)  # tells neighbouring cells apart; farther away it is 1
    return torch.cat([maps.float(), costs / 64, near_goal, scores], dim=1)


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
        nn.init.zeros_(self.head.weight)

    def forward(self, planes: Tensor) -> Tensor:
        """Return features (B, outputs, H, W)."""
        details = F.relu(self.stem(F.pixel_unshuffle(planes, 2)))  # (B, fine, H/2, W/2)
        context = self.blocks(self.down(details))  # (B, coarse, H/4, W/4)
        context = F.pixel_shuffle(F.relu(self.up(context)), 2)  # (B, fine, H/2, W/2)
        joined = self.join(torch.cat([context, details], dim=1))  # (B, fine, H/2, W/2)
        return F.pixel_shuffle(self.head(F.relu(joined)), 2)


# --- loss and training --------------------------------------------------------------------------


class MovePredictor(pl.LightningModule):
    """Predicts for every cell which moves begin a shortest path, and the cost to go.

    Args:
        learning_rate: the highest of the schedule.
    """

    def __init__(self, learning_rate: float = 0.004) -> None:
        """Make the network."""
        super().__init__()
        self.save_hyperparameters()
        # As many inputs as `planes_of` returns, 8 scores and a ratio. With this order of numbers in
        # memory convolutions take less time.
        self.network = Network(11, 9).to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, maps: Tensor, goals: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return predictions for every cell of maps (B, 1, H, W), given goals (B, 2).

        Returns:
            Scores of the moves (B, 8, H, W): their softmax has the probabilities that a move is
            optimal. Ratios (B, H, W): the cost to go on an empty map over the true cost to go. The
            cost to go on an empty map (B, H, W), in cells.
        """
        rows, columns = maps.shape[2:]
        padded = F.pad(maps, (0, -columns % 4, 0, -rows % 4), value=1)
        known = prior(padded[:, 0].cpu(), goals.cpu(), MOVEMENT)
        scores, costs = (torch.from_numpy(plane).to(maps.device) for plane in known)
        output = self.network(planes_of(padded, scores, costs[:, None])).float()  # (B, 9, H, W)
        scores = (scores + output[:, :8])[..., :rows, :columns]
        ratios = output[:, 8].sigmoid()[..., :rows, :columns]
        return scores, ratios, costs[..., :rows, :columns]

    def loss(self, batch: Sample) -> Tensor:
        """Return the loss of a batch with the fields `FIELDS`: a weighted mean over all cells.

            loss   = -log P(some optimal move) + 5 * (predicted ratio - true ratio) ** 2
            weight = 3 where the way to the goal has a detour, 1 elsewhere, 0 without a way

        The network need not decide among moves that are equally good.
        """
        scores, ratios, _ = self(batch.map, batch.goal)
        optimal = is_optimal(batch.optimal_moves)  # (B, 8, H, W)
        true_ratios = batch.heuristic_ratio[:, 0]  # (B, H, W)
        log_probabilities = scores.log_softmax(dim=1)  # (B, 8, H, W)
        some_optimal = log_probabilities.masked_fill(~optimal, -1e9).logsumexp(dim=1)  # (B, H, W)
        losses = -some_optimal + 5 * (ratios - true_ratios) ** 2  # (B, H, W)
        weights = torch.where(true_ratios < 0.98, 3.0, 1.0) * optimal.any(dim=1)
        loss: Tensor = (losses * weights).sum() / weights.sum()
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
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimizer,
            max_lr=self.hparams["learning_rate"],
            total_steps=int(self.trainer.estimated_stepping_batches),
            pct_start=0.1,
        )
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": schedule, "interval": "step"},
        }

    # --- prediction -----------------------------------------------------------------------------

    @torch.inference_mode()
    def predict(self, grids: Bytes, goals: Ints) -> tuple[Float32s, Float32s]:
        """Return scores of the moves (B, 8, H, W) and costs to go (B, H, W), in cells.

        Args:
            grids: (B, H, W), 0 free and 1 occupied.
            goals: (B, 2), cells.
        """
        maps, cells = (torch.from_numpy(np.array(each)).to(self.device) for each in (grids, goals))
        scores, ratios, costs = self(maps[:, None], cells)
        return scores.cpu().numpy(), (costs / ratios.clamp(min=0.05)).cpu().numpy()


# --- a program: train, then compare -------------------------------------------------------------


def main(arguments: Sequence[str] | None = None) -> None:
    """Train on a dataset, and compare the predictor with classical planners on its test split."""
    parser = argparse.ArgumentParser(description="Train a path predictor, and compare it.")
    parser.add_argument("root", nargs="?", default=ROOT, help="folder of a dataset")
    parser.add_argument("--steps", type=int, default=1500, help="steps of 16 maps each")
    parser.add_argument("--weights", help="file to which the weights are written")
    options = parser.parse_args(arguments)
    pl.seed_everything(1)
    data = MapDataModule(
        options.root,
        build="dungeon" if options.root == ROOT else None,
        fields=FIELDS,
        problems="random",
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
    model = MovePredictor()
    trainer.fit(model, data)
    if options.weights is not None:  # MovePredictor.load_from_checkpoint(file) reads them
        trainer.save_checkpoint(options.weights, weights_only=True)
    problems = ProblemSet.read(options.root, 300, movement=MOVEMENT, problems=HARD)
    planners = [*classical(MOVEMENT), GuidedSearch("sample", MOVEMENT, model.eval().predict)]
    print(to_text(evaluate(planners, problems), ["opt", "expansion_ratio"]))


if __name__ == "__main__":
    main()
