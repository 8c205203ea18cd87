"""Samplers that learn where a roadmap needs its vertices: LEGO's conditional autoencoder, and a heat map over cells.

Kumar, Mandalika, Choudhury, Srinivasa, "LEGO: Leveraging Experience in Roadmap Generation for Sampling-Based Planning",
IROS 2019. All samplers here have `sample`, and learn from the batches of a data module and a bank of experience:

    from models.lego_sampler import load
    from models.roadmap import between, halton

    sampler = load("models/weights/lego_heatmap.pt")
    points = sampler.sample(grid, start, goal, 25)  # (25, 2) points in free cells
    roadmap = between(grid, start, goal, np.concatenate([halton(grid, 25), points]))

- `Heatmap`: a convolutional network gives every cell its share of the targets; cells are drawn without replacement.
- `CVAE`: as published. A latent of 2 numbers and a condition become a point; the condition is here a convolutional
  code of map, start and goal, of any map size, where the original has 10 x 10 cells.
- `LocalCVAE`: the same with a condition that stays where it is: latent and code become a query that the features of
  the cells answer, so that its points lie in cells instead of between them.

The command that made each of the weights that ship is in scripts/train_lego_sampler.py.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from os import PathLike
from typing import Any

import numpy as np
import numpy.typing as npt
import pytorch_lightning as pl
import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from torch import Tensor, nn

from mapdata.jit import kernel
from mapdata.sample import Sample
from models.experience import KINDS, Bank
from models.layers import Muon, Pass, Residual, bfloat16
from models.roadmap import between, free_at, halton, uniform
from models.saved import load_model

FIELDS = ("map", "start", "goal", "optimal_mask", "problem")
"""What a data module must serve."""

STRIDE = 8
"""Maps are padded with occupied cells to a multiple of this."""

CHANNELS = 14

VIEWS = (0, 3, 4, 7, 1, 2, 5, 6)
"""Symmetries of a map in the order in which a heat map adds them, as `_turn_plane` numbers them."""

POINTS = 6
"""Points of each problem in a step of `LocalCVAE`."""

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Bytes = npt.NDArray[np.uint8]


# --- what the networks see ------------------------------------------------------------------------------------------


def look(occupied: Tensor, starts: Tensor, goals: Tensor) -> Tensor:
    """Return what a network sees, (B, 14, H, W): free cells, both ends, and where each cell lies relative to them.

    Args:
        occupied: (B, 1, H, W), 0 free and anything else occupied.
        starts: (B, 2), cells.
        goals: (B, 2), cells.
    """
    count, _, rows, columns = occupied.shape
    row = torch.arange(rows, device=occupied.device).view(1, -1, 1).expand(count, rows, columns)
    column = torch.arange(columns, device=occupied.device).view(1, 1, -1).expand(count, rows, columns)
    planes, estimates = [(occupied[:, 0] == 0).float()], []
    for cells in (starts, goals):
        down, right = (row - cells[:, 0, None, None]).float(), (column - cells[:, 1, None, None]).float()
        estimates.append(torch.hypot(down, right))
        planes += [((down == 0) & (right == 0)).float(), down / 32, right / 32]
        planes += [(down / 4).clamp(-1, 1), (right / 4).clamp(-1, 1), estimates[-1] / 64]
    span = torch.linalg.vector_norm((starts - goals).float(), dim=1)[:, None, None]
    planes.append((estimates[0] + estimates[1] - span) / 32)
    return torch.stack(planes, dim=1)


class Trunk(nn.Module):
    """Features of every cell, from near and far; it knows no map size."""

    def __init__(self, out: int, widths: tuple[int, int, int], passes: int) -> None:
        """Take the channels of a cell, the widths at strides 2, 4 and 8, and how far information travels."""
        super().__init__()
        shallow, width, deep = widths
        self.stem = nn.Sequential(nn.Conv2d(4 * CHANNELS, shallow, 3, padding=1), Residual(shallow))
        self.down = nn.Conv2d(shallow, width, 2, stride=2)
        self.passes = nn.ModuleList(Pass(width, deep) for _ in range(passes))
        self.end = Residual(width)
        self.up = nn.Conv2d(width, 4 * shallow, 1)
        self.join = nn.Conv2d(2 * shallow, shallow, 3, padding=1)
        self.head = nn.Conv2d(shallow, 4 * out, 1)
        nn.init.normal_(self.head.weight, std=0.02)

    def forward(self, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Return (B, out, H, W) and a code (B, deep) for (B, 14, H, W), H and W multiples of 8."""
        skip = F.relu(self.stem(F.pixel_unshuffle(seen, 2)))  # (B, shallow, H/2, W/2)
        fine: Tensor = self.down(skip)  # (B, width, H/4, W/4)
        coarse: Tensor | None = None
        for each in self.passes:
            fine, coarse = each(fine, coarse)  # coarse: (B, deep, H/8, W/8)
        up = F.pixel_shuffle(F.relu(self.up(F.relu(self.end(fine)))), 2)  # (B, shallow, H/2, W/2)
        joined = F.relu(self.join(torch.cat([up, skip], dim=1)))
        code = fine.new_zeros(len(fine), 0) if coarse is None else coarse.amax(dim=(2, 3))
        return F.pixel_shuffle(self.head(joined), 2), code


# --- what all samplers share ----------------------------------------------------------------------------------------


class Sampler(pl.LightningModule):
    """Learns where to sample from batches with the `FIELDS` and the bank of their problems.

    The bank is mined in the first fit, or read if it is there. The data module must keep its problems: stored ones,
    or random ones through `models.experience.FixedProblems`.
    """

    def __init__(self, targets: str, learning_rate: float, experience: str) -> None:
        """Keep what all have: the kind of targets, the highest learning rate, the folder of banks."""
        super().__init__()
        if targets not in KINDS:
            raise ValueError(f"targets: got {targets!r}, expected one of {', '.join(KINDS)}")
        self.targets, self.learning_rate, self.experience = targets, learning_rate, experience
        self.bank: Bank | None = None

    def loss(self, batch: dict[str, Tensor], points: Tensor, owners: Tensor) -> dict[str, Tensor]:
        """Return the loss and its parts, for points (M, 2) that belong to the problems ``owners`` (M,) of a batch."""
        raise NotImplementedError

    def draw(self, grids: Bytes, starts: Ints, goals: Ints, n: int, source: np.random.Generator) -> Floats:
        """Return (B, n, 2) points in free cells, for problems that are known to be sound."""
        raise NotImplementedError

    def sample(self, map: npt.ArrayLike, start: npt.ArrayLike, goal: npt.ArrayLike, n: int, seed: int = 0) -> Floats:  # noqa: A002
        """Return (n, 2) points in free cells: where the roadmap of this problem wants its vertices.

        Args:
            map: (H, W) or (1, H, W), 0 free and 1 occupied.
            start: its cell.
            goal: its cell.
            n: how many.
            seed: of the draws.

        Raises:
            ValueError: no free cell, a start or goal outside the map or on an occupied cell, or n below 1.
        """
        grid = np.asarray(map, np.uint8).reshape(np.shape(map)[-2:])
        ends = np.array([start, goal], np.int64).reshape(2, 1, 2)
        found: Floats = self.sample_batch(grid[None], ends[0], ends[1], n, seed)[0]
        return found

    def sample_batch(self, grids: Bytes, starts: Ints, goals: Ints, n: int, seed: int = 0) -> Floats:
        """Return (B, n, 2) points, as `sample`: grids (B, H, W), starts and goals (B, 2)."""
        cells = np.array(grids, np.uint8)
        if n < 1:
            raise ValueError(f"n: got {n}, expected at least 1 sample")
        if cells.reshape(len(cells), -1).all(axis=1).any():
            raise ValueError(f"map: got one of {cells.shape[1:]} without a free cell, expected one to sample in")
        ends = [np.array(each, np.int64) for each in (starts, goals)]
        for name, each in zip(("start", "goal"), ends, strict=True):
            for grid, cell in zip(cells, each, strict=True):
                if not free_at(grid, cell + 0.5)[0]:
                    raise ValueError(f"{name}: got {cell.tolist()}, expected a free cell of a map of {grid.shape}")
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
        owners = torch.arange(len(counts)).repeat_interleave(torch.as_tensor(counts)).to(self.device)
        values = self.loss(*_turned(fields, places), owners)
        self.log_dict({f"train_{name}": value for name, value in values.items()}, prog_bar=True)
        return values["loss"]

    def validation_step(self, batch: Sample, batch_idx: int) -> None:
        """Log the share of problems that roadmaps of 50 vertices solve, half of them by Halton."""
        fields = dict(zip(batch._fields, batch, strict=True))
        grids, starts, goals = (fields[name].cpu().numpy() for name in ("map", "start", "goal"))
        grids = grids[:, 0].astype(np.uint8)
        found = 0
        for k, points in enumerate(self.sample_batch(grids, starts, goals, 25)):
            roadmap = between(grids[k], starts[k], goals[k], np.concatenate([halton(grids[k], 25, k), points]))
            found += math.isfinite(roadmap.shortest_path()[0])
        self.log("val_success", found / len(grids), batch_size=len(grids), prog_bar=True)

    def configure_optimizers(self) -> Any:  # noqa: ANN401  (Lightning's signature)
        """Return an optimizer whose rate rises over 100 steps, or the first tenth, and falls as a cosine."""
        optimizer = self.optimizer()
        steps = float(self.trainer.estimated_stepping_batches)

        def rate(step: int) -> float:
            return min(1.0, (step + 1) / min(100, 0.1 * steps)) * (
                0.5 + 0.5 * math.cos(math.pi * min(1.0, step / steps))
            )

        schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, rate)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

    def optimizer(self) -> torch.optim.Optimizer:
        """Return the optimizer."""
        return Muon(self.parameters(), self.learning_rate)

    def save(self, file: str | PathLike[str]) -> None:
        """Write arguments and weights, as plain types and tensors of 16 bits: they were learnt with no more."""
        known = {k: v for k, v in self.hparams.items() if not k.startswith("_")}  # LightningCLI adds one of its own
        arguments = {name: list(v) if isinstance(v, tuple) else v for name, v in known.items()}
        weights = {name: v.detach().half().cpu().contiguous() for name, v in self.state_dict().items()}
        torch.save({"class": type(self).__name__, "arguments": arguments, "weights": weights}, file)


def load(file: str | PathLike[str]) -> Sampler:
    """Return the sampler that `Sampler.save` wrote, ready to sample; nothing in the file is run.

    Raises:
        FileNotFoundError: no such file.
        ValueError: it holds no sampler.
    """
    return load_model(file, Heatmap, CVAE, LocalCVAE)


def _turned(fields: dict[str, Tensor], points: Tensor) -> tuple[dict[str, Tensor], Tensor]:
    """Return a batch and its points after a random symmetry; start and goal may change places, too."""
    code, swap = int(torch.randint(8, ())), bool(torch.rand(()) < 0.5)
    size = torch.tensor(fields["map"].shape[2:], device=points.device)
    ends = [fields["goal"], fields["start"]] if swap else [fields["start"], fields["goal"]]
    names = ("map", "optimal_mask", "start", "goal")
    planes = [_turn_plane(fields[name], code) for name in names[:2]]
    cells = [_turn_points(each + 0.5, code, size).floor().long() for each in ends]
    return dict(zip(names, [*planes, *cells], strict=True)), _turn_points(points, code, size)


def _turn_plane(plane: Tensor, code: int) -> Tensor:
    """Return (..., H, W) after a symmetry: bit 0 flips rows, bit 1 flips columns, bit 2 transposes at last."""
    turned = plane.flip([axis - 2 for axis in range(2) if code >> axis & 1])
    return turned.transpose(-2, -1) if code & 4 else turned


def _turn_back(plane: Tensor, code: int) -> Tensor:
    """Return what `_turn_plane` turned."""
    turned = plane.transpose(-2, -1) if code & 4 else plane
    return turned.flip([axis - 2 for axis in range(2) if code >> axis & 1])


def _turn_points(points: Tensor, code: int, size: Tensor) -> Tensor:
    """Return points (M, 2) on a map of ``size`` after a symmetry."""
    flips = torch.tensor([code & 1, code >> 1 & 1], device=points.device)
    turned = points * (1 - 2 * flips) + size * flips
    return turned.flip(1) if code & 4 else turned


def _padded(occupied: Tensor) -> Tensor:
    return F.pad(occupied.float(), (0, -occupied.shape[3] % STRIDE, 0, -occupied.shape[2] % STRIDE), value=1)


def _tensors(model: nn.Module, grids: Bytes, starts: Ints, goals: Ints) -> list[Tensor]:
    device = next(model.parameters()).device
    return [torch.as_tensor(np.array(each), device=device) for each in (grids[:, None], starts, goals)]


def _cell_numbers(points: Tensor, occupied: Tensor) -> Tensor:
    """Return the number row * columns + column of each point's cell, (M,)."""
    rows, columns = occupied.shape[2:]
    cells = points.floor().long()
    return cells[:, 0].clamp(0, rows - 1) * columns + cells[:, 1].clamp(0, columns - 1)


# --- the heat map ---------------------------------------------------------------------------------------------------


class Heatmap(Sampler):
    """Predicts each cell's share of the targets, and as a help which cells lie on shortest paths.

    Args:
        targets: "lego" or "shortest_path".
        widths: channels at strides 2, 4 and 8.
        passes: exchanges between strides 4 and 8.
        learning_rate: the highest.
        help_weight: weight of the second prediction's loss.
        temperature: 1 draws cells by their shares; 0 takes always the likeliest, which solves more problems.
        spacing: cells around a sample within which further ones are less likely.
        views: 1 to 8 symmetries of the map, whose mean the shares are; each costs as much as the first.
        experience: folder of banks.
    """

    def __init__(
        self,
        targets: str = "lego",
        widths: tuple[int, int, int] = (32, 48, 64),
        passes: int = 3,
        learning_rate: float = 0.006,
        help_weight: float = 4.0,
        temperature: float = 0.0,
        spacing: float = 1.25,
        views: int = 4,
        experience: str = "runs/experience",
    ) -> None:
        """Make the network."""
        super().__init__(targets, learning_rate, experience)
        self.save_hyperparameters()
        self.trunk = Trunk(2, widths, passes).to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, occupied: Tensor, starts: Tensor, goals: Tensor) -> Tensor:
        """Return (B, 2, H, W) scores: their softmax over free cells is the shares; and of lying on a path."""
        rows, columns = occupied.shape[2:]
        scores: Tensor = self.trunk(look(_padded(occupied), starts, goals))[0][..., :rows, :columns]
        return scores.float()

    def loss(self, batch: dict[str, Tensor], points: Tensor, owners: Tensor) -> dict[str, Tensor]:
        """Return the cross entropy of the shares, over problems with a target, and of the second prediction."""
        scores = self(batch["map"], batch["start"], batch["goal"])
        occupied = batch["map"].flatten(1) != 0
        shares = scores[:, 0].flatten(1).masked_fill(occupied, -30).log_softmax(1)  # (B, H * W)
        each = -shares[owners, _cell_numbers(points, batch["map"])]  # (M,)
        counts = torch.bincount(owners, minlength=len(shares)).clamp(min=1)
        heat = (each / counts[owners]).sum() / (torch.bincount(owners) > 0).sum() if len(owners) else each.sum()
        path = F.binary_cross_entropy_with_logits(
            scores[:, 1].flatten(1)[~occupied], batch["optimal_mask"].flatten(1)[~occupied].float()
        )
        return {"loss": heat + self.hparams["help_weight"] * path, "heat": heat, "path": path}

    def shares(self, grids: Bytes, starts: Ints, goals: Ints) -> Floats:
        """Return (B, H, W) shares of the cells, 0 in occupied ones."""
        occupied, *ends = _tensors(self, grids, starts, goals)
        size, total = torch.tensor(occupied.shape[2:], device=occupied.device), torch.zeros(grids.shape)
        with torch.inference_mode(), bfloat16(self.device):
            for k, code in enumerate(VIEWS[: self.hparams["views"]]):
                cells = [_turn_points(each + 0.5, code, size).floor().long() for each in ends[:: 1 - 2 * (k % 2)]]
                turned = _turn_plane(occupied, code)
                scores = self(turned, *cells)[:, 0].masked_fill(turned[:, 0] != 0, -torch.inf)
                shares = scores.flatten(1).double().softmax(1).view(scores.shape)
                total = total + _turn_back(shares, code).cpu()
        found: Floats = (total / self.hparams["views"]).contiguous().numpy()
        return found

    def draw(self, grids: Bytes, starts: Ints, goals: Ints, n: int, source: np.random.Generator) -> Floats:
        """Return points in cells drawn without replacement, each uniform inside its cell."""
        shares = self.shares(grids, starts, goals)
        noise = self.hparams["temperature"] * source.gumbel(size=shares.shape)
        cells = choose(shares, noise, n, self.hparams["spacing"])
        return cells + source.random(cells.shape)


@kernel
def choose(shares: Floats, noise: Floats, n: int, spacing: float) -> Floats:
    """Return (B, n, 2) cells: always the one with the highest log share + noise, (B, H, W) each.

    A chosen cell makes its neighbours less likely, by exp(-(distance / spacing)^2 / 2), and is itself not taken again
    before all others are.
    """
    count, rows, columns = shares.shape
    chosen = np.empty((count, n, 2))
    reach = int(3 * spacing)
    for b in range(count):
        scores, taken = np.full((rows, columns), -np.inf), np.zeros((rows, columns), np.int64)
        for i in range(rows):
            for j in range(columns):
                if shares[b, i, j] > 0:
                    scores[i, j] = math.log(shares[b, i, j]) + noise[b, i, j]
        for k in range(n):
            row, column, most = 0, 0, 1 << 60
            for i in range(rows):
                for j in range(columns):
                    if scores[i, j] > -np.inf and (
                        taken[i, j] < most or (taken[i, j] == most and scores[i, j] > scores[row, column])
                    ):
                        row, column, most = i, j, taken[i, j]
            chosen[b, k, 0], chosen[b, k, 1] = row, column
            taken[row, column] += 1
            for i in range(max(row - reach, 0), min(row + reach + 1, rows)):
                for j in range(max(column - reach, 0), min(column + reach + 1, columns)):
                    away = ((i - row) ** 2 + (j - column) ** 2) / (spacing * spacing)
                    if 0 < away < 9:
                        scores[i, j] += math.log(1 - math.exp(-away / 2))
    return chosen


# --- conditional autoencoders ---------------------------------------------------------------------------------------


def _layers(inputs: int, width: int, outputs: int, dropout: float) -> nn.Sequential:
    """Return the published encoder or decoder: two hidden layers with ReLU and dropout."""
    hidden = [nn.Linear(inputs, width), nn.ReLU(), nn.Dropout(dropout)]
    hidden += [nn.Linear(width, width), nn.ReLU(), nn.Dropout(dropout)]
    return nn.Sequential(*hidden, nn.Linear(width, outputs))


def _latent(code: Tensor) -> tuple[Tensor, Tensor]:
    """Return a draw of the latent (..., z), and how far its distribution is from the prior, (...)."""
    mean, log_variance = code.float().chunk(2, dim=-1)
    latent = mean + torch.randn_like(mean) * (log_variance / 2).exp()
    return latent, (log_variance.exp() + mean**2 - 1 - log_variance).sum(-1) / 2


def _until_free(
    draw: Callable[[int], Floats], grids: Bytes, n: int, source: np.random.Generator, rounds: int = 8
) -> Floats:
    """Return (B, n, 2): the first n free ones of the points (B, k, 2) that ``draw(k)`` gives; what lacks is uniform."""
    found: list[list[Floats]] = [[] for _ in grids]
    for _ in range(rounds):
        for grid, points, kept in zip(grids, draw(2 * n), found, strict=True):
            kept.append(points[free_at(grid, points)])
        if min(sum(map(len, kept)) for kept in found) >= n:
            break
    more = [uniform(grid, n, int(source.integers(2**31))) for grid in grids]
    return np.stack([np.concatenate([*kept, rest])[:n] for kept, rest in zip(found, more, strict=True)])


class CVAE(Sampler):
    """LEGO's conditional variational autoencoder: a point of the unit square from a latent and a condition.

    Published: two hidden layers of 512 with ReLU and dropout 0.5 on both sides, a latent of 2, squared error plus 2e-4
    of the divergence, Adam with 1e-4 for up to 600,000 steps of 256 points; the learning rate here is higher, since the
    steps are far fewer.

    Args:
        targets: "lego" or "shortest_path".
        latent: its numbers.
        width: of the hidden layers.
        code: numbers of the convolutional code of map, start and goal.
        dropout: share of hidden units left out.
        divergence_weight: of the divergence from the prior.
        learning_rate: the highest.
        experience: folder of banks.
    """

    def __init__(
        self,
        targets: str = "lego",
        latent: int = 2,
        width: int = 512,
        code: int = 128,
        dropout: float = 0.5,
        divergence_weight: float = 2e-4,
        learning_rate: float = 1e-3,
        experience: str = "runs/experience",
    ) -> None:
        """Make the networks."""
        super().__init__(targets, learning_rate, experience)
        self.save_hyperparameters()
        self.condition = nn.Sequential(
            nn.Conv2d(4 * CHANNELS, 32, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(32, 48, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.Conv2d(48, 64, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.AdaptiveAvgPool2d(8),
            nn.Conv2d(64, 32, 1),
            nn.Flatten(),
            nn.Linear(32 * 64, code),
            nn.ReLU(),
        )
        self.encoder = _layers(2 + code + 4, width, 2 * latent, dropout)
        self.decoder = _layers(latent + code + 4, width, 2, dropout)

    def forward(self, occupied: Tensor, starts: Tensor, goals: Tensor) -> Tensor:
        """Return the condition of each problem, (B, code + 4)."""
        seen = F.pixel_unshuffle(look(_padded(occupied), starts, goals), 2)
        ends = torch.cat([starts, goals], dim=1) / torch.tensor(occupied.shape[2:]).repeat(2).to(starts.device)
        return torch.cat([self.condition(seen).float(), ends], dim=1)

    def loss(self, batch: dict[str, Tensor], points: Tensor, owners: Tensor) -> dict[str, Tensor]:
        """Return the squared error and the divergence."""
        condition = self(batch["map"], batch["start"], batch["goal"])[owners]
        unit = points / torch.tensor(batch["map"].shape[2:], device=points.device)
        latent, divergence = _latent(self.encoder(torch.cat([unit, condition], dim=1)))
        error = ((self.decoder(torch.cat([latent, condition], dim=1)).float() - unit) ** 2).mean(dim=1)
        error, apart = (each.sum() / max(len(points), 1) for each in (error, divergence))
        return {"loss": error + self.hparams["divergence_weight"] * apart, "error": error, "divergence": apart}

    def draw(self, grids: Bytes, starts: Ints, goals: Ints, n: int, source: np.random.Generator) -> Floats:
        """Return points that lie in free cells, of as many as it takes."""
        condition = self(*_tensors(self, grids, starts, goals))

        def points(count: int) -> Floats:
            latents = source.standard_normal((len(grids), count, self.hparams["latent"])).astype(np.float32)
            each = condition[:, None].expand(-1, count, -1)
            unit = self.decoder(torch.cat([torch.as_tensor(latents, device=each.device), each], dim=2))
            found: Floats = unit.double().cpu().numpy() * grids.shape[1:]
            return found

        return _until_free(points, grids, n, source)

    def optimizer(self) -> torch.optim.Optimizer:
        """Return Adam, as published."""
        return torch.optim.Adam(self.parameters(), self.learning_rate)


class LocalCVAE(Sampler):
    """A conditional variational autoencoder whose decoder asks the cells: a query of latent and code, a key a cell.

    A point becomes a cell by the cell that holds it, its likelihood is the softmax of query times keys over free cells,
    and it is drawn uniformly inside its cell.

    Args:
        targets: "lego" or "shortest_path".
        latent: its numbers.
        keys: numbers a key.
        widths, passes: as of `Heatmap`.
        width: of the hidden layers.
        divergence_weight: of the divergence from the prior.
        learning_rate: the highest.
        experience: folder of banks.
    """

    def __init__(
        self,
        targets: str = "lego",
        latent: int = 4,
        keys: int = 16,
        widths: tuple[int, int, int] = (32, 48, 64),
        passes: int = 3,
        width: int = 128,
        divergence_weight: float = 0.1,
        learning_rate: float = 0.006,
        experience: str = "runs/experience",
    ) -> None:
        """Make the networks."""
        super().__init__(targets, learning_rate, experience)
        self.save_hyperparameters()
        self.trunk = Trunk(keys, widths, passes).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.encoder = _layers(2 + keys + widths[2], width, 2 * latent, 0.0)
        self.decoder = _layers(latent + widths[2], width, keys, 0.0)

    def forward(self, occupied: Tensor, starts: Tensor, goals: Tensor) -> tuple[Tensor, Tensor]:
        """Return keys of the cells, (B, H * W, keys), and a code of each problem."""
        rows, columns = occupied.shape[2:]
        keys, code = self.trunk(look(_padded(occupied), starts, goals))
        return keys[..., :rows, :columns].flatten(2).transpose(1, 2), code

    def loss(self, batch: dict[str, Tensor], points: Tensor, owners: Tensor) -> dict[str, Tensor]:
        """Return the cross entropy of the cells and the divergence, for some points of each problem that has any."""
        counts = torch.bincount(owners, minlength=len(batch["map"]))
        some = (counts > 0).nonzero()[:, 0]  # S problems
        chosen = torch.rand(len(some), POINTS, device=points.device) * counts[some, None]
        points = points[(counts.cumsum(0) - counts)[some, None] + chosen.long()]  # (S, POINTS, 2)
        keys, code = self(*(batch[name][some] for name in ("map", "start", "goal")))
        occupied = batch["map"][some]
        cells = _cell_numbers(points.flatten(0, 1), occupied).view(len(some), POINTS)
        near = keys.gather(1, cells[..., None].expand(-1, -1, keys.shape[2]))
        unit = points / torch.tensor(occupied.shape[2:], device=points.device)
        codes = code[:, None].expand(-1, POINTS, -1)
        latent, divergence = _latent(self.encoder(torch.cat([unit, near, codes], dim=2)))
        query = self.decoder(torch.cat([latent.to(code.dtype), codes], dim=2))
        scores = (query @ keys.transpose(1, 2)).float()  # (S, POINTS, H * W)
        scores = scores.masked_fill(occupied.flatten(2) != 0, -30)
        error, apart = F.cross_entropy(scores.flatten(0, 1), cells.flatten(), reduction="sum"), divergence.sum()
        count = max(cells.numel(), 1)
        error, apart = error / count, apart / count
        return {"loss": error + self.hparams["divergence_weight"] * apart, "error": error, "divergence": apart}

    def draw(self, grids: Bytes, starts: Ints, goals: Ints, n: int, source: np.random.Generator) -> Floats:
        """Return points, each of a latent of its own."""
        occupied, *ends = _tensors(self, grids, starts, goals)
        keys, code = self(occupied, *ends)
        latents = torch.as_tensor(source.standard_normal((len(grids), n, self.hparams["latent"])), device=code.device)
        query = self.decoder(torch.cat([latents.to(code.dtype), code[:, None].expand(-1, n, -1)], dim=2))
        scores = torch.einsum("bnk,bck->bnc", query, keys).double()
        likely = scores.masked_fill(occupied.flatten(1)[:, None] != 0, -torch.inf).cpu().numpy()
        cells = (likely + source.gumbel(size=likely.shape)).argmax(axis=2)
        return np.stack(np.divmod(cells, grids.shape[2]), axis=2) + source.random((len(grids), n, 2))
