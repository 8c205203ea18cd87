"""What the sample models share.

- `Trunk`: a convolutional network that gives every cell features from near and far.
- `offsets`, `heuristic`, `legal_moves`: the geometry of maps, on tensors.
- `random_symmetry` and others: the symmetries of maps.
- `Muon` and `one_cycle`: the optimizer and its learning rate.
- `Model` and `load_model`: a step of training, predictions from arrays, and files of weights, read
  without trust.
"""

from __future__ import annotations

import contextlib
import io
import math
import zipfile
from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import pytorch_lightning as pl
import torch
import torch.nn.functional as F  # noqa: N812  (its usual name)
from numpy.typing import ArrayLike
from scipy.ndimage import map_coordinates
from torch import Tensor, nn
from torch.optim.lr_scheduler import OneCycleLR

from mapdata import Movement
from mapdata.arrays import Bytes, Ints
from mapdata.search import STEPS
from mapdata.shards import write_output

Tensors = dict[str, Tensor]
"""Tensors by name: the fields of a batch, or a loss and its parts."""

WEIGHTS = Path(__file__).parent / "weights"
"""The folder of the weights that ship."""

# --- the network --------------------------------------------------------------------------------

STRIDE = 16
"""`Trunk` takes maps whose sides are multiples of this."""


class Residual(nn.Module):
    """x + two 3 x 3 convolutions. Without a norm, so that no statistic depends on the map size."""

    def __init__(self, width: int, dilation: int = 1) -> None:
        """Make both convolutions; the second sees ``dilation`` times as far."""
        super().__init__()
        self.first = nn.Conv2d(width, width, 3, padding=1)
        self.second = nn.Conv2d(width, width, 3, padding=dilation, dilation=dilation)
        nn.init.kaiming_normal_(self.first.weight, nonlinearity="relu")
        nn.init.zeros_(self.second.weight)  # the block begins as the identity, but for a bias

    def forward(self, x: Tensor) -> Tensor:
        """Return (B, width, H, W) for the same."""
        inner = F.relu(self.first(F.relu(x)))
        out: Tensor = x + self.second(inner)
        return out


class Pass(nn.Module):
    """One pass down to the coarsest resolution and back; a convolution there reaches further."""

    def __init__(self, widths: Sequence[int], dilation: int = 1) -> None:
        """Take the channels at each stride, the finest first."""
        super().__init__()
        width, *deeper = widths
        self.local = Residual(width, dilation)
        self.deeper: Pass | None = None
        if deeper:
            self.down = nn.Conv2d(width, deeper[0], 2, stride=2)
            self.deeper = Pass(deeper, dilation=2)
            self.up = nn.Conv2d(deeper[0], 4 * width, 1)

    def forward(self, states: list[Tensor]) -> list[Tensor]:
        """Return the states of all strides: (B, width, H, W), then (B, next width, H/2, W/2)."""
        fine, *coarser = states
        fine = self.local(fine)
        if self.deeper is None:
            return [fine]
        coarser[0] = self.down(F.relu(fine)) + coarser[0]
        coarser = self.deeper(coarser)
        back = self.up(F.relu(coarser[0]))  # (B, 4 width, H/2, W/2)
        return [fine + F.pixel_shuffle(back, 2), *coarser]


class Trunk(nn.Module):
    """Features of every cell from near and far, for maps of any size once they are `padded`."""

    def __init__(
        self, inputs: int, outputs: int, widths: Sequence[int], passes: int, refinements: int = 0
    ) -> None:
        """Make the layers.

        Args:
            inputs: channels in.
            outputs: channels out.
            widths: channels at strides 2, 4, 8 and 16; the last two may be left out.
            passes: how many `Pass`.
            refinements: how many `Residual` at stride 2 follow them.
        """
        super().__init__()
        shallow, width = widths[:2]
        self.coarser = len(widths) - 2
        # the first and the last convolution work on blocks of 2 x 2 cells: half the time
        self.stem = nn.Sequential(nn.Conv2d(4 * inputs, shallow, 3, padding=1), Residual(shallow))
        self.down = nn.Conv2d(shallow, width, 2, stride=2)
        self.passes = nn.ModuleList(Pass(widths[1:]) for _ in range(passes))
        self.end = Residual(width)
        self.up = nn.Conv2d(width, 4 * shallow, 1)
        self.join = nn.Conv2d(2 * shallow, shallow, 3, padding=1)
        self.refine = nn.Sequential(*(Residual(shallow) for _ in range(refinements)))
        self.head = nn.Conv2d(shallow, 4 * outputs, 1)
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, seen: Tensor) -> Tensor:
        """Return features (B, outputs, H, W).

        Args:
            seen: (B, inputs, H, W), H and W multiples of ``STRIDE``.
        """
        skip = F.relu(self.stem(F.pixel_unshuffle(seen, 2)))  # (B, shallow, H/2, W/2)
        # the coarser strides begin with nothing
        states = [self.down(skip)] + [seen.new_zeros(())] * self.coarser
        for each in self.passes:
            states = each(states)
        up = self.up(F.relu(self.end(states[0])))  # (B, 4 shallow, H/4, W/4)
        up = F.pixel_shuffle(F.relu(up), 2)  # (B, shallow, H/2, W/2)
        fine = self.refine(self.join(torch.cat([up, skip], dim=1)))  # (B, shallow, H/2, W/2)
        return F.pixel_shuffle(self.head(F.relu(fine)), 2)  # (B, outputs, H, W)


def padded(occupied: Tensor) -> Tensor:
    """Return maps (B, 1, H, W) walled in below and to the right, up to a multiple of `STRIDE`."""
    below = -occupied.shape[2] % STRIDE
    right = -occupied.shape[3] % STRIDE
    return F.pad(occupied, (0, right, 0, below), value=1)


# --- geometry -----------------------------------------------------------------------------------


def offsets(cells: Tensor, shape: torch.Size) -> tuple[Tensor, Tensor]:
    """Return how far each row and each column is from cells (B, 2): (B, H, 1) and (B, 1, W)."""
    rows, columns = shape
    down = torch.arange(rows, device=cells.device) - cells[:, :1]  # (B, H)
    right = torch.arange(columns, device=cells.device) - cells[:, 1:]  # (B, W)
    return down[:, :, None].float(), right[:, None, :].float()


def heuristic(down: Tensor, right: Tensor, movement: Movement) -> Tensor:
    """Return the cost of going so far on an empty map: Manhattan, octile or Chebyshev distance."""
    down = down.abs()
    right = right.abs()
    if movement.connectivity == 4:
        return down + right
    return (down - right).abs() + movement.diagonal_cost * torch.minimum(down, right)


def legal_moves(occupied: Tensor, movement: Movement) -> Tensor:
    """Return (B, moves, H, W) bool: which moves are allowed from each cell of (B, 1, H, W).

    The rule of `mapdata.search.is_legal` once more, for all cells at once on the device.
    """
    free = F.pad(occupied[:, 0] == 0, (1, 1, 1, 1))  # (B, H + 2, W + 2), a wall around the map
    legal = []
    for row, column in STEPS[: movement.connectivity].tolist():
        # rolled, so that each cell has what its neighbour is; over the border come walls
        allowed = free.roll((-row, -column), (1, 2))
        if row and column and not movement.corner_cutting:  # diagonal: both sides must be free
            allowed = allowed & free.roll(-row, 1) & free.roll(-column, 2)
        legal.append(allowed[:, 1:-1, 1:-1])
    return torch.stack(legal, dim=1)


def cell_numbers(points: Tensor, occupied: Tensor) -> Tensor:
    """Return the number row * columns + column of each point's cell, (M,), of maps (B, 1, H, W)."""
    rows, columns = occupied.shape[2:]
    row, column = points.floor().long().unbind(1)  # (M,) both
    return row.clamp(0, rows - 1) * columns + column.clamp(0, columns - 1)


def check_problems(
    maps: ArrayLike, starts: ArrayLike, goals: ArrayLike
) -> tuple[Bytes, Ints, Ints]:
    """Return one problem or B of them as new arrays: (B, H, W) of 0 and 1, starts, goals (B, 2).

    Raises:
        ValueError: a map without a free cell, a start or goal outside its map or on an occupied
            cell, or not of integers.
    """
    cells = np.asarray(maps)
    grids = (cells != 0).astype(np.uint8).reshape(-1, *cells.shape[-2:])
    if grids.all(axis=(1, 2)).any():
        raise ValueError(f"map: got one of {grids.shape[1:]} without a free cell")
    ends = []
    for name, given in (("start", starts), ("goal", goals)):
        end = np.atleast_2d(given)
        if end.dtype.kind not in "iu":
            raise ValueError(f"{name}: got {given!r}, expected whole numbers")
        end = end.astype(np.int64)
        # of order 0, the value of a cell itself; outside the map all is occupied
        occupied = map_coordinates(grids, [np.arange(len(grids)), *end.T], order=0, cval=1)  # (B,)
        if occupied.any():
            raise ValueError(
                f"{name}: got {end[occupied.argmax()].tolist()}, outside its map or on an occupied "
                f"cell, expected a free cell of a map of {grids.shape[1:]}"
            )
        ends.append(end)
    return grids, ends[0], ends[1]


# --- symmetries of a map ------------------------------------------------------------------------


def transform_plane(plane: Tensor, code: int) -> Tensor:
    """Return (..., H, W) after a symmetry.

    Bit 0 of its code flips rows, bit 1 flips columns, bit 2 transposes at last.
    """
    if code & 1:
        plane = plane.flip(-2)
    if code & 2:
        plane = plane.flip(-1)
    return plane.transpose(-2, -1) if code & 4 else plane


def restore_plane(plane: Tensor, code: int) -> Tensor:
    """Return the plane of which `transform_plane` made this one."""
    if code & 4:
        plane = plane.transpose(-2, -1)
    return transform_plane(plane, code & 3)


def transform_points(points: Tensor, code: int, shape: torch.Size) -> Tensor:
    """Return points (M, 2) after a symmetry of their map, whose shape was (..., H, W).

    Cell (r, c) covers [r, r + 1) x [c, c + 1), so that a flip takes row to H - row.
    """
    row, column = points.unbind(1)  # (M,) both
    if code & 1:
        row = shape[-2] - row
    if code & 2:
        column = shape[-1] - column
    return torch.stack([column, row] if code & 4 else [row, column], dim=1)


def transform_cells(cells: Tensor, code: int, shape: torch.Size) -> Tensor:
    """Return cells (M, 2) after a symmetry, which moves their centres."""
    return transform_points(cells + 0.5, code, shape).floor().long()


def random_symmetry(fields: Tensors, points: Tensor) -> tuple[Tensors, Tensor]:
    """Return a batch and its points after a symmetry; start and goal may change places, too."""
    code = int(torch.randint(8, ()))
    shape = fields["map"].shape
    start = transform_cells(fields["start"], code, shape)
    goal = transform_cells(fields["goal"], code, shape)
    if torch.rand(()) < 0.5:
        start, goal = goal, start
    changed = {"start": start, "goal": goal}
    for name in ("map", "optimal_mask"):
        if name in fields:
            changed[name] = transform_plane(fields[name], code)
    return changed, transform_points(points, code, shape)


# --- the optimizer ------------------------------------------------------------------------------


def one_cycle(optimizer: torch.optim.Optimizer, steps: float) -> dict[str, Any]:
    """Return an optimizer and its rate over ``steps``, as `configure_optimizers` may.

    The optimizer's own rate is the highest: reached after 100 steps, then it falls as a cosine.
    """
    warm_up = min(100 / max(steps, 1), 0.15)  # not 0.1: OneCycleLR cannot rise for exactly one step
    highest = optimizer.param_groups[0]["lr"]
    schedule = OneCycleLR(
        optimizer,
        highest,
        total_steps=steps,  # type: ignore[arg-type]  # endless training is its own error
        pct_start=warm_up,
        cycle_momentum=False,
    )
    return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


class Muon(torch.optim.Optimizer):
    """Muon for the weights of layers, Adam for their biases (Jordan et al. 2024).

    https://kellerjordan.github.io/posts/muon; the size of a step as in Liu et al. 2025, arXiv
    2502.16982. torch.optim.Muon (2.13) refuses convolutions, and torch 2.1 has none. After 400
    steps of the training of docs/tutorial.md the loss of the moves, on maps not seen, is .34 and
    .35 with this (two seeds), .53 twice with torch's AdamW at the best of three rates; after 800
    steps it is .20 and .31.
    """

    def __init__(self, parameters: Any, lr: float, weight_decay: float = 0.01) -> None:
        """Take what any optimizer takes."""
        super().__init__(parameters, {"lr": lr, "weight_decay": weight_decay})

    @torch.no_grad()
    def step(self, closure: Any = None) -> Any:
        """Change all parameters once."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            rate = group["lr"]
            matrices: dict[torch.Size, list[tuple[Tensor, Tensor]]] = defaultdict(list)
            for parameter in group["params"]:
                if parameter.grad is None:
                    continue
                update = _momentum(parameter.grad, self.state[parameter])
                if parameter.ndim < 2:
                    parameter.sub_(update, alpha=rate)
                else:
                    matrix = update.flatten(1)  # (out, in * kernel cells)
                    matrices[matrix.shape].append((parameter, matrix))
            for shape, found in matrices.items():
                # those of one shape together take a third of the time
                near = _orthogonal(torch.stack([matrix for _, matrix in found]))
                size = 0.2 * math.sqrt(max(shape)) * rate  # steps as large as Adam's
                for (parameter, _), update in zip(found, near, strict=True):
                    parameter.mul_(1 - rate * group["weight_decay"])
                    parameter.sub_(update.reshape_as(parameter), alpha=size)
        return loss


def _momentum(gradient: Tensor, state: dict[str, Any]) -> Tensor:
    """Return the direction of a step: Nesterov's momentum for matrices, Adam's for vectors."""
    if not state:
        state["step"] = 0
        state["mean"] = torch.zeros_like(gradient)
        if gradient.ndim < 2:
            state["square"] = torch.zeros_like(gradient)
    state["step"] += 1
    mean: Tensor = state["mean"]
    if gradient.ndim >= 2:
        mean.lerp_(gradient, 0.05)
        return gradient.lerp(mean, 0.95)
    mean.lerp_(gradient, 0.1)
    state["square"].lerp_(gradient**2, 0.02)
    unbiased: Tensor = mean / (1 - 0.9 ** state["step"])
    square: Tensor = state["square"] / (1 - 0.98 ** state["step"])
    return unbiased / (square.sqrt() + 1e-8)


def _orthogonal(x: Tensor) -> Tensor:
    """Return matrices (B, rows, columns) with all singular values near 1, by Newton-Schulz."""
    if x.shape[1] > x.shape[2]:
        return _orthogonal(x.mT).mT  # the products below are of the shorter side
    x = x / (torch.linalg.matrix_norm(x, keepdim=True) + 1e-7)
    # The momentum of weights that never change fades to the smallest numbers there are, with which
    # a processor multiplies so slowly that a step took three times as long in the end.
    x = F.hardshrink(x, 1e-12)
    for _ in range(5):
        square = x @ x.mT
        x = 3.4445 * x + (-4.7750 * square + 2.0315 * square @ square) @ x
    return x


# --- models and their weights in files ----------------------------------------------------------


def fast_precision() -> Literal["bf16-mixed", "32-true"]:
    """Return the ``precision`` of a Lightning Trainer that is the faster one on this processor.

    bfloat16 takes half the time where the processor multiplies it (AVX-512 or AMX), and nine times
    as long where it does not, since torch then has no fast convolution for it.
    """
    abilities: dict[str, bool] = getattr(torch.cpu, "get_capabilities", dict)()
    multiplies = abilities.get("avx512_bf16") or abilities.get("amx_bf16")
    return "bf16-mixed" if multiplies else "32-true"


M = TypeVar("M", bound=nn.Module)

MOST = 1024
"""Largest number among the arguments of a saved model: a layer's width, how many layers."""


class Model(pl.LightningModule, ABC):
    """What all sample models are, besides their network and loss.

    Its hyperparameters hold ``learning_rate``, the highest of the schedule. They train in 32 bits
    or in mixed precision ("bf16-mixed").
    """

    optimizer_class: Callable[..., torch.optim.Optimizer] = Muon  # AdamW needs more steps here

    @abstractmethod
    def losses(self, batch: Any) -> Tensors:
        """Return ``loss`` and its parts, by the names under which `training_step` logs them."""

    def training_step(self, batch: Any, batch_idx: int) -> Tensor:
        """Return the loss of one step."""
        values = self.losses(batch)
        self.log_dict({f"train_{name}": value for name, value in values.items()}, prog_bar=True)
        return values["loss"]

    def configure_optimizers(self) -> Any:
        """Return an ``optimizer_class`` and torch's OneCycleLR."""
        optimizer = self.optimizer_class(self.parameters(), self.hparams["learning_rate"])
        return one_cycle(optimizer, self.trainer.estimated_stepping_batches)

    def tensors(self, *arrays: ArrayLike) -> list[Tensor]:
        """Return copies of arrays as tensors on the device of the model."""
        return [torch.from_numpy(np.array(each)).to(self.device) for each in arrays]

    @contextlib.contextmanager
    def inference(self) -> Iterator[None]:
        """Predict without gradients; half the time where the processor multiplies bfloat16.

        On another device the autocast of processors changes nothing. In evaluation mode, which
        `fit` leaves: a batch norm would depend on the batch.
        """
        fast = fast_precision() == "bf16-mixed"
        training = self.training
        self.eval()
        try:
            with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16, fast):
                yield
        finally:
            self.train(training)

    def save(self, file: str | PathLike[str]) -> None:
        """Write class, arguments and weights, as plain types and float16 tensors: half the size.

        What was there before is replaced by the whole file, or stays.

        Raises:
            OSError: the disk is full or may not be written to.
        """
        arguments = {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in self.hparams.items()
            if not name.startswith("_")  # LightningCLI adds one of its own
        }
        weights = {
            name: value.to("cpu", torch.float16).contiguous()
            for name, value in self.state_dict().items()
        }
        data = io.BytesIO()
        torch.save({"class": type(self).__name__, "arguments": arguments, "weights": weights}, data)
        write_output(file, data.getvalue())

    @classmethod
    def load(cls: type[M], file: str | PathLike[str]) -> M:
        """Return the model of this class that `save` wrote; errors as of `load_model`."""
        return load_model(file, cls)


def load_model(file: str | PathLike[str], *classes: type[M]) -> M:
    """Return the model of one of ``classes`` that `Model.save` wrote, ready to use.

    Nothing in the file is run, and it takes no more memory than the file is long.

    Raises:
        FileNotFoundError: no such file.
        ValueError: it holds no such model, or code, or less than it says; the message is one line
            and names the file.
    """
    path = Path(file)
    if not path.exists():
        raise FileNotFoundError(f"{file}: no such file")
    known = {each.__name__: each for each in classes}
    try:
        saved = _read(path)
        kind = known[saved["class"]]
        weights = saved["weights"]
        with torch.device("meta"):  # its shapes alone take no memory
            expected = kind(**saved["arguments"]).state_dict()
        shapes = {name: value.shape for name, value in weights.items()}
        if shapes != {name: value.shape for name, value in expected.items()}:
            raise ValueError("its weights have other names or shapes than its arguments say")
        model = kind(**saved["arguments"])
        model.load_state_dict(weights)
    except Exception as error:
        # what torch's readers and a model's own arguments raise is not documented
        reason = str(error).strip().split("\n")[0]
        raise ValueError(
            f"{file}: holds no saved {' or '.join(known)} ({type(error).__name__}: {reason})"
        ) from None
    return model.eval()


def _read(path: Path) -> dict[str, Any]:
    """Return what the file holds, checked to take no more memory than the file is long."""
    size = path.stat().st_size
    with zipfile.ZipFile(path) as archive:
        unpacked = sum(info.file_size for info in archive.infolist())
        if unpacked > size:
            raise ValueError(f"it unpacks to {unpacked} bytes, expected at most its own {size}")
        if archive.testzip() is not None:  # torch compares no checksums
            raise ValueError("damaged: its checksums do not fit")
    saved: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    for name in ("arguments", "weights"):
        if not isinstance(saved, dict) or not isinstance(saved.get(name), dict):
            raise ValueError("expected arguments and weights")
    for value in saved["arguments"].values():
        for number in value if isinstance(value, list) else [value]:
            # "not <=", since NaN is larger than nothing
            if isinstance(number, (int, float)) and not abs(number) <= MOST:
                raise ValueError(f"its arguments hold a number beyond {MOST}")
    weights = saved["weights"].values()
    if not all(isinstance(value, Tensor) for value in weights):
        raise ValueError("its weights are no tensors")
    if sum(value.numel() * value.element_size() for value in weights) > size:
        raise ValueError("its weights are larger than the file")
    return saved
