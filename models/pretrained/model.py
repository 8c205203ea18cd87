"""`Model`: what all models share, which is a step of training and files of weights."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeVar

import numpy as np
import pytorch_lightning as pl
import safetensors
import safetensors.torch
import torch
from lightning_fabric.utilities.exceptions import MisconfigurationException
from numpy.typing import ArrayLike
from torch import Tensor, nn

from mapdata import MapDataModule
from mapdata.checks import check_choice, check_finite
from mapdata.shards import write_output

from .optimizer import Muon, one_cycle

Tensors = dict[str, Tensor]
"""Tensors by name: the fields of a batch, or a loss and its parts."""

WEIGHTS = Path(__file__).parent / "weights"
"""The folder of the pretrained weights."""

MAX_ARGUMENT = 1024
"""Largest number among the arguments of a saved model, such as the width or number of layers."""

_NUMBER_WORDS = {"4": "four", "8": "eight"}
"""How names of weights call a number of moves."""

M = TypeVar("M", bound=nn.Module)
P = TypeVar("P", bound="Model")


def fast_precision() -> Literal["bf16-mixed", "32-true"]:
    """Return the ``precision`` of a Lightning Trainer that is the faster one on this processor.

    bfloat16 takes half the time where the processor multiplies it (AVX-512 or AMX), and nine times
    as long where it does not, since torch then has no fast convolution for it.
    """
    if not hasattr(torch.cpu, "get_capabilities"):
        # Older versions of torch do not say what the processor can do: take the safe choice.
        return "32-true"
    capabilities = torch.cpu.get_capabilities()
    if capabilities.get("avx512_bf16") or capabilities.get("amx_bf16"):
        return "bf16-mixed"
    return "32-true"


class Model(pl.LightningModule, ABC):
    """The base class of all models, which add a network and a loss.

    Their hyperparameters hold ``learning_rate``, the highest of the schedule. They train in 32 bits
    or in mixed precision ("bf16-mixed").
    """

    # Muon, since AdamW needs more steps here; `Muon` has the figures.
    optimizer_class: Callable[..., torch.optim.Optimizer] = Muon

    PRETRAINED: ClassVar[Mapping[str, str]] = {}
    """The pretrained weights: their files in `WEIGHTS`, by name; the first is the default."""

    def _check_learning_rate(self) -> None:
        """Refuse a learning rate that is not a finite number of at least 0, as torch does."""
        check_finite("learning_rate", self.hparams["learning_rate"])

    @abstractmethod
    def losses(self, batch: Any) -> Tensors:
        """Return ``loss`` and its parts, by the names under which `training_step` logs them."""

    def setup(self, stage: str) -> None:
        """Compare the movement of the model, if it has one, with that of the data module.

        Raises:
            ValueError: they differ, so that the model would learn, or be tested on, moves that it
                does not make.
        """
        movement = getattr(self, "movement", None)
        data = getattr(self.trainer, "datamodule", None)
        if movement is None or not isinstance(data, MapDataModule):
            return
        for dataset in data.datasets.values():
            if dataset.movement != movement:
                raise ValueError(
                    f"movement: the model is for {movement}, the data for {dataset.movement}: "
                    "give movement=model.movement to MapDataModule"
                )

    def training_step(self, batch: Any, batch_idx: int) -> Tensor:
        """Return the loss of one step."""
        losses = self.losses(batch)
        self.log_dict({f"train_{name}": loss for name, loss in losses.items()}, prog_bar=True)
        return losses["loss"]

    def on_train_start(self) -> None:
        """Compare the schedule with the training, and log at least once an epoch.

        Raises:
            MisconfigurationException: the training was resumed from a checkpoint whose schedule
                has fewer steps.
        """
        trainer: Any = self.trainer  # whose type does not have log_every_n_steps
        steps = trainer.estimated_stepping_batches
        for config in trainer.lr_scheduler_configs:
            # A checkpoint brings its own schedule, in place of that of `configure_optimizers`.
            schedule_steps = getattr(config.scheduler, "total_steps", math.inf)
            if schedule_steps < steps:
                raise MisconfigurationException(
                    f"the learning rate of the checkpoint ends at step {schedule_steps}, but this "
                    f"training has {steps:.0f} steps: resume it with the max_epochs and max_steps "
                    "that it had (--weights FILE then writes its weights), or begin a new training "
                    "from its weights: --start_from FILE in place of --ckpt_path"
                )
        # Loggers get the loss of every n-th step. A shorter epoch would leave them without any.
        epoch_steps = trainer.num_training_batches // trainer.accumulate_grad_batches
        if 0 < epoch_steps < trainer.log_every_n_steps:
            trainer.log_every_n_steps = int(epoch_steps)

    def configure_optimizers(self) -> Any:
        """Return an ``optimizer_class`` and torch's OneCycleLR."""
        optimizer = self.optimizer_class(self.parameters(), self.hparams["learning_rate"])
        return one_cycle(optimizer, self.trainer.estimated_stepping_batches)

    def tensors(self, *arrays: ArrayLike) -> list[Tensor]:
        """Return copies of arrays as tensors on the device of the model."""
        return [torch.from_numpy(np.array(array)).to(self.device) for array in arrays]

    @contextlib.contextmanager
    def inference(self) -> Iterator[None]:
        """Predict without gradients, in evaluation mode, in the precision that is fast.

        bfloat16 takes half the time where the processor multiplies it. On another device the
        autocast of the processor changes nothing.
        """
        use_bfloat16 = fast_precision() == "bf16-mixed"
        # `fit` leaves a model in training mode, in which a batch norm depends on the batch.
        was_training = self.training
        self.eval()
        try:
            with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16, use_bfloat16):
                yield
        finally:
            self.train(was_training)

    def save(self, file: str | PathLike[str]) -> None:
        """Write class, arguments and weights as a file of safetensors, in float16: half the size.

        A file of that name is replaced as a whole, or stays as it is where writing fails.

        Raises:
            ValueError: weights that are not finite as float16, for instance after a training that
                diverged.
            OSError: the disk is full or may not be written to.
        """
        # LightningCLI adds "_instantiator", which is no argument of the class.
        arguments = {
            name: value for name, value in self.hparams.items() if not name.startswith("_")
        }
        weights = {
            name: weight.to("cpu", torch.float16).contiguous()
            for name, weight in self.state_dict().items()
        }
        _check_weights(weights)
        description = {"class": type(self).__name__, "arguments": json.dumps(arguments)}
        description["sha256"] = _digest(description, weights)
        write_output(file, _with_sorted_metadata(safetensors.torch.save(weights, description)))

    @classmethod
    def pretrained(cls: type[P], name: str | None = None) -> P:
        """Return the model with pretrained weights, in evaluation mode.

        Args:
            name: one of ``PRETRAINED``; None takes the first.

        Raises:
            ValueError: no weights of this class have the name.
        """
        if not cls.PRETRAINED:
            raise ValueError(f"{cls.__name__}: no weights of it ship: train it, and use load")
        if name is None:
            name = next(iter(cls.PRETRAINED))
        if name not in cls.PRETRAINED and str(name) in _NUMBER_WORDS:
            hint = _NUMBER_WORDS[str(name)]
            raise ValueError(
                f"{cls.__name__}.pretrained: got {name!r}, expected one of "
                f"{', '.join(cls.PRETRAINED)}"
                f"{f'; did you mean {hint}?' if hint in cls.PRETRAINED else ''}"
            )
        check_choice(f"{cls.__name__}.pretrained", name, cls.PRETRAINED)
        return load_model(WEIGHTS / cls.PRETRAINED[name], cls)

    @classmethod
    def load(cls: type[M], file: str | PathLike[str]) -> M:
        """Return the model of this class that `save` wrote; errors are those of `load_model`."""
        return load_model(file, cls)


def load_model(file: str | PathLike[str], *classes: type[M]) -> M:
    """Return the model of one of ``classes`` that `Model.save` wrote, in evaluation mode.

    A file of safetensors holds no code, and takes no more memory than it is long.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file holds no such model, is damaged, was written before version 0.4.0, or
            holds weights that are not finite real numbers; the message is one line and names the
            file.
    """
    path = Path(file)
    if not path.exists():
        raise FileNotFoundError(f"{file}: no such file")
    if zipfile.is_zipfile(path):
        raise ValueError(
            f"{file}: holds no file of safetensors, but an archive, such as versions before 0.4.0 "
            "wrote; docs/pretrained.md (Files of earlier versions) converts it"
        )
    classes_by_name = {model_class.__name__: model_class for model_class in classes}
    try:
        with safetensors.safe_open(path, "pt") as opened:
            description = opened.metadata() or {}
            weights = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118
        model_class = classes_by_name[description["class"]]
        # safetensors has no checksum: a flipped bit would be another weight.
        if description.pop("sha256") != _digest(description, weights):
            raise ValueError("damaged: its hash does not fit")
        arguments = json.loads(description["arguments"])
        _check_arguments(arguments)
        with torch.device("meta"):  # a model without memory, which has names and shapes alone
            expected = model_class(**arguments).state_dict()
        if _shapes(weights) != _shapes(expected):
            raise ValueError("its weights have other names or shapes than its arguments say")
        _check_weights(weights)
        model = model_class(**arguments)
        model.load_state_dict(weights)
    except Exception as error:
        # Which errors safetensors and the constructor of a model raise is not documented.
        reason = str(error).strip().split("\n")[0]
        raise ValueError(
            f"{file}: holds no saved {' or '.join(classes_by_name)} "
            f"({type(error).__name__}: {reason})"
        ) from None
    return model.eval()


def _with_sorted_metadata(content: bytes) -> bytes:
    """Return a file of safetensors, which writes metadata in any order, with its keys in order.

    So the same model gives the same bytes. Such a file begins with the length of its header, in
    eight bytes; the header is JSON, with blanks to a multiple of eight bytes.
    """
    length = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + length])
    header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
    text = json.dumps(header, separators=(",", ":")).encode()
    text = text.ljust(-(-len(text) // 8) * 8)
    return len(text).to_bytes(8, "little") + text + content[8 + length :]


def _digest(description: Mapping[str, str], weights: Mapping[str, Tensor]) -> str:
    """Return the hash of class, arguments and weights."""
    digest = hashlib.sha256(description["class"].encode())
    digest.update(description["arguments"].encode())
    for name in sorted(weights):
        digest.update(name.encode())
        digest.update(weights[name].flatten().view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def _check_arguments(arguments: dict[str, Any]) -> None:
    """Refuse arguments of which even the shapes of the weights would take much memory."""
    for name, argument in arguments.items():
        numbers = argument if isinstance(argument, (list, tuple)) else [argument]
        for number in numbers:
            if not isinstance(number, (int, float)):
                continue
            # "not <=" also refuses NaN, which is neither larger nor smaller than any number.
            if not abs(number) <= MAX_ARGUMENT:
                raise ValueError(f"{name}: got {number}, expected at most {MAX_ARGUMENT}")


def _check_weights(weights: Mapping[str, Tensor]) -> None:
    """Refuse weights that are not finite real numbers: torch would drop imaginary parts."""
    for name, weight in weights.items():
        if not weight.is_floating_point():
            raise ValueError(f"{name}: got weights of {weight.dtype}, expected real numbers")
        if not weight.isfinite().all():
            number = weight[~weight.isfinite()][0].item()
            raise ValueError(f"{name}: got the weight {number}, expected finite numbers")


def _shapes(weights: dict[str, Tensor]) -> dict[str, torch.Size]:
    return {name: weight.shape for name, weight in weights.items()}
