"""A CNN path predictor in one file, to read and to copy: it predicts the moves of shortest paths.

    python -m mapdata.models.path_predictor data/dungeon --weights moves.ckpt

trains it on a dataset in some fifteen minutes of one core, and prints a table that compares it with
classical planners. A copy runs in the same way, `python my_predictor.py`, from any folder;
`--steps 20 --problems 20` is a trial of a minute. The file reads from top to bottom: targets,
planes, network, loss, training, prediction, comparison.

For every cell of a map the network predicts which moves begin a shortest path to the goal.
`GuidedSearch` plans with these scores, and finds a path wherever there is one. The network does not
begin from nothing: `prior` has the scores of the moves on an empty map, and the network corrects
them where obstacles are in the way. So the untrained planner is the search without a network, and
the row to beat.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import pytorch_lightning as pl
import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from pytorch_lightning.utilities.types import OptimizerLRScheduler
from torch import Tensor, nn

from mapdata import MapDataModule, Movement, ProblemSet, Random, Sample, evaluate
from mapdata.arrays import Bytes, Float32s, Ints
from mapdata.evaluation import GuidedSearch, classical, prior, to_text
from mapdata.models import fast_precision
from mapdata.search import STEPS

MOVEMENT = Movement(connectivity=8)
"""Eight moves that cut no corner."""

MOVES = STEPS[: MOVEMENT.connectivity]
"""(M, 2), how many cells each of the M = 8 moves goes down and to the right."""

HARD = Random(hardness=(1.05, None))
"""Problems whose shortest path is at least 5 % longer than on an empty map."""


# --- targets ------------------------------------------------------------------------------------


FIELDS = ("map", "start", "goal", "optimal_moves")
"""What the data module serves: the problem, and the targets of every cell."""


def is_optimal(optimal_moves: Tensor) -> Tensor:
    """Return which moves begin a shortest path to the goal, (B, M, H, W) bool.

    Args:
        optimal_moves: (B, 1, H, W) uint8; bit k is set where move k of `MOVES` does.
    """
    bits = torch.arange(len(MOVES), device=optimal_moves.device)[:, None, None]
    return (optimal_moves >> bits) & 1 == 1


def is_legal(maps: Tensor) -> Tensor:
    """Return which moves `MOVEMENT` allows in the free cells of maps, (B, M, H, W) bool.

    Args:
        maps: (B, 1, H, W), 0 free and 1 occupied.
    """
    rows, columns = maps.shape[2:]
    free = F.pad(maps[:, 0] == 0, (1, 1, 1, 1))  # with a wall around the map

    def is_free(down: int, right: int) -> Tensor:
        """Return whether the cell that lies so far away from each cell is free, (B, H, W)."""
        return free[:, 1 + down : 1 + down + rows, 1 + right : 1 + right + columns]

    legal = []
    for down, right in MOVES.tolist():
        enters_free = is_free(down, right)
        if not MOVEMENT.corner_cutting:
            enters_free = enters_free & is_free(down, 0) & is_free(0, right)
        legal.append(enters_free)
    return torch.stack(legal, dim=1)


# --- planes: what the network sees --------------------------------------------------------------


PLANES = 8
"""How many planes `planes_of` returns."""


def planes_of(maps: Tensor, goals: Tensor, costs: Tensor) -> Tensor:
    """Return the input of the network, (B, PLANES, H, W), whose numbers are of a size of about 1.

    Planes are computed from maps and goals alone, because a search has no labels.

    Args:
        maps: (B, 1, H, W), 0 free and 1 occupied.
        goals: (B, 2), cells.
        costs: (B, 1, H, W), costs to go on an empty map, in cells.
    """
    rows, columns = (torch.arange(count, device=maps.device) for count in maps.shape[2:])
    down = (rows - goals[:, :1])[:, None, :, None].expand_as(costs)  # from the goal
    right = (columns - goals[:, 1:])[:, None, None, :].expand_as(costs)
    # Far from the goal these three tell only on which side of it a cell is.
    near = torch.cat([down, right, down.abs() - right.abs()], dim=1) / 4
    planes = [maps, costs == 0, costs / 64, down / 32, right / 32, near.clamp(-1, 1)]
    return torch.cat([plane.float() for plane in planes], dim=1)


# --- network ------------------------------------------------------------------------------------


class Block(nn.Sequential):
    """A residual block: its input plus the output of two convolutions, the first one dilated."""

    def __init__(self, width: int, dilation: int) -> None:
        """Make the layers; the block begins as the identity."""
        dilated = nn.Conv2d(width, width, 3, padding=dilation, dilation=dilation, bias=False)
        last = nn.Conv2d(width, width, 3, padding=1)
        nn.init.zeros_(last.weight)
        norms = nn.BatchNorm2d(width), nn.BatchNorm2d(width)
        super().__init__(norms[0], nn.ReLU(), dilated, norms[1], nn.ReLU(), last)

    def forward(self, x: Tensor) -> Tensor:
        """Return features (B, width, H, W) for features of the same shape."""
        correction: Tensor = super().forward(x)  # type: ignore[no-untyped-call]
        return x + correction


class Network(nn.Sequential):
    """From planes (B, inputs, H, W) to features of every cell; H and W are multiples of 4.

    Its blocks see 4 x 4 cells as one place. Their dilations add up, so that each place sees about
    30 places to each side.
    """

    def __init__(self, inputs: int, outputs: int, width: int = 64) -> None:
        """Make the layers, with ``width`` channels between the first and the last one."""
        first = nn.Conv2d(16 * inputs, width, 3, padding=1)
        blocks = [Block(width, dilation) for dilation in (1, 2, 4, 1, 2, 4, 1, 2, 4)]
        last = nn.Conv2d(width, 16 * outputs, 1)
        nn.init.zeros_(last.weight)  # so that training begins at the scores of an empty map
        nn.init.zeros_(last.bias)  # type: ignore[arg-type]
        super().__init__(nn.PixelUnshuffle(4), first, *blocks, nn.ReLU(), last, nn.PixelShuffle(4))


# --- loss and training --------------------------------------------------------------------------


class MovePredictor(pl.LightningModule):
    """Predicts for every cell which moves begin a shortest path.

    Args:
        learning_rate: the highest of the schedule.
    """

    def __init__(self, learning_rate: float = 0.004) -> None:
        """Make the network."""
        super().__init__()
        self.save_hyperparameters()
        self.network = Network(inputs=PLANES, outputs=len(MOVES))

    def forward(self, maps: Tensor, goals: Tensor) -> tuple[Tensor, Tensor]:
        """Return predictions for every cell of maps (B, 1, H, W), given goals (B, 2).

        Returns:
            Scores of the moves (B, M, H, W): their softmax has the probabilities that a move is
            optimal. Costs to go on an empty map (B, H, W), in cells; they are not learned.
        """
        rows, columns = maps.shape[2:]
        padded = F.pad(maps, (0, -columns % 4, 0, -rows % 4), value=1)
        known = prior(padded[:, 0].cpu(), goals.cpu(), MOVEMENT)
        scores, costs = (torch.from_numpy(plane).to(maps.device) for plane in known)
        output = self.network(planes_of(padded, goals, costs[:, None]))
        return (scores + output.float())[..., :rows, :columns], costs[..., :rows, :columns]

    def loss(self, batch: Sample) -> Tensor:
        """Return the loss of a batch with the fields `FIELDS`: the mean of -log P(an optimal move).

        The mean is over all cells with a way to the goal, and P over the legal moves of a cell. The
        network need not decide among moves that are equally good.
        """
        scores, _ = self(batch.map, batch.goal)
        # Such a score is a probability of 0. Unlike -inf it does not turn other losses into NaN.
        scores = scores.masked_fill(~is_legal(batch.map), -1e4)
        optimal = is_optimal(batch.optimal_moves)  # (B, M, H, W)
        has_way = optimal.any(dim=1)  # (B, H, W)
        scores, optimal = (part.movedim(1, 3)[has_way] for part in (scores, optimal))  # (N, M)
        optimal_scores = scores.masked_fill(~optimal, -1e4)
        return (scores.logsumexp(dim=1) - optimal_scores.logsumexp(dim=1)).mean()

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
        optimizer = torch.optim.AdamW(self.parameters(), betas=(0.9, 0.98), weight_decay=1e-3)
        steps = int(self.trainer.estimated_stepping_batches)
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimizer,
            max_lr=self.hparams["learning_rate"],
            total_steps=max(steps, 100),  # a short trial has the beginning of a schedule
            pct_start=1 / 30,
        )
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": schedule, "interval": "step"},
        }

    # --- prediction -----------------------------------------------------------------------------

    @torch.inference_mode()
    def predict(self, grids: Bytes, goals: Ints) -> tuple[Float32s, Float32s]:
        """Return what `forward` returns in evaluation mode, scores and costs, as arrays.

        Args:
            grids: (B, H, W), 0 free and 1 occupied.
            goals: (B, 2), cells.
        """
        was_training = self.training
        self.eval()
        maps = torch.tensor(grids, device=self.device)
        scores, costs = self(maps[:, None], torch.tensor(goals, device=self.device))
        self.train(was_training)
        return scores.cpu().numpy(), costs.cpu().numpy()

    def planner(self, name: str = "learned") -> GuidedSearch:
        """Return the planner that follows these predictions, as `evaluate` takes it."""
        return GuidedSearch(name, MOVEMENT, self.predict, TRUST)


TRUST = 0.01
"""How much moves cost `GuidedSearch` that the network finds improbable; its default is 0.15.

With less trust it finds more optimal paths and expands more cells.
"""


# --- a program: train, then compare -------------------------------------------------------------

ROOT = "data/dungeon"
"""The dataset that is trained on if no other is named. This one is built if it is missing."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Train on a dataset, and compare the predictor with classical planners on its test split."""
    parser = argparse.ArgumentParser(description="Train a path predictor, and compare it.")
    parser.add_argument("root", nargs="?", default=ROOT, help="folder of a dataset")
    parser.add_argument("--steps", type=int, default=3000, help="steps of 24 maps each")
    parser.add_argument("--weights", help="file to which the weights are written")
    parser.add_argument("--problems", type=int, default=300, help="problems that are compared")
    options = parser.parse_args(arguments)
    pl.seed_everything(1)
    is_missing = Path(options.root) == Path(ROOT) and not Path(ROOT).exists()
    data = MapDataModule(
        options.root,
        build="dungeon" if is_missing else None,
        fields=FIELDS,
        problems=HARD,
        movement=MOVEMENT,
        augment=True,
        batch_size=24,
    )
    trainer = pl.Trainer(
        accelerator="cpu",
        precision=fast_precision(),
        max_steps=options.steps,
        limit_val_batches=4,
        logger=False,
        enable_checkpointing=False,
    )
    model = MovePredictor()
    trainer.fit(model, data)
    if options.weights is not None:  # MovePredictor.load_from_checkpoint(file) reads them
        trainer.save_checkpoint(options.weights, weights_only=True)
    problems = ProblemSet.read(options.root, options.problems, movement=MOVEMENT, problems=HARD)
    untrained = MovePredictor().planner("untrained")  # the same search, without learning
    planners = [*classical(MOVEMENT), untrained, model.planner()]
    print(to_text(evaluate(planners, problems), ["opt", "expansion_ratio"]))


if __name__ == "__main__":
    main()
