"""`Model`: what all sample models share, which is a step of training and files of weights."""

from __future__ import annotations

import contextlib
import io
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from os import PathLike
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import pytorch_lightning as pl
import torch
from numpy.typing import ArrayLike
from torch import Tensor, nn

from mapdata.shards import write_output
from models.optimizer import Muon, one_cycle

Tensors = dict[str, Tensor]
"""Tensors by name: the fields of a batch, or a loss and its parts."""

WEIGHTS = Path(__file__).parent / "weights"
"""The folder of the weights that ship."""


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
