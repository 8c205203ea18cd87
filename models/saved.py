"""Weights in files, read without trust: nothing in the file is run, and it takes what it weighs."""

from __future__ import annotations

import zipfile
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

import pytorch_lightning as pl
import torch
from torch import Tensor, nn

M = TypeVar("M", bound=nn.Module)

MOST = 1024
"""Largest number among the arguments of a saved model: a layer's width, how many layers."""


def save_model(model: pl.LightningModule, file: str | PathLike[str], dtype: torch.dtype) -> None:
    """Write a model's class, arguments and weights, as plain types and tensors of ``dtype``."""
    known = {
        k: v for k, v in model.hparams.items() if not k.startswith("_")
    }  # LightningCLI adds one of its own
    arguments = {name: list(v) if isinstance(v, tuple) else v for name, v in known.items()}
    weights = {
        name: v.detach().to("cpu", dtype).contiguous() for name, v in model.state_dict().items()
    }
    torch.save({"class": type(model).__name__, "arguments": arguments, "weights": weights}, file)


def load_model(file: str | PathLike[str], *classes: type[M]) -> M:
    """Return the model of one of ``classes`` that `save_model` wrote, ready to use.

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
        with torch.device("meta"):  # its shapes alone take no memory
            shapes = {
                name: value.shape for name, value in kind(**saved["arguments"]).state_dict().items()
            }
        if shapes != {name: value.shape for name, value in saved["weights"].items()}:
            raise ValueError("its weights have other names or shapes than its arguments say")
        model = kind(**saved["arguments"])
        model.load_state_dict(saved["weights"])
    except Exception as error:
        # what torch's readers and a model's own arguments raise is not documented
        reason = str(error).strip().split("\n")[0]
        expected = " or ".join(known)
        raise ValueError(
            f"{file}: holds no saved {expected} ({type(error).__name__}: {reason})"
        ) from None
    return model.eval()


def _read(path: Path) -> dict[str, Any]:
    """Return what the file holds, after checking that it takes no more memory than the file is
    long.
    """
    size = path.stat().st_size
    with zipfile.ZipFile(path) as archive:
        unpacked = sum(info.file_size for info in archive.infolist())
    if unpacked > size:
        raise ValueError(f"it unpacks to {unpacked} bytes, expected at most its own {size}")
    saved = torch.load(path, map_location="cpu", weights_only=True)
    if not isinstance(saved, dict) or not all(
        isinstance(saved.get(name), dict) for name in ("arguments", "weights")
    ):
        raise ValueError("expected arguments and weights")
    numbers = [
        item
        for value in saved["arguments"].values()
        for item in (value if isinstance(value, list) else [value])
    ]
    if any(isinstance(number, (int, float)) and not abs(number) <= MOST for number in numbers):
        raise ValueError(f"its arguments hold a number beyond {MOST}")
    weights = saved["weights"].values()
    if not all(isinstance(value, Tensor) for value in weights):
        raise ValueError("its weights are no tensors")
    if sum(value.numel() * value.element_size() for value in weights) > size:
        raise ValueError("its weights are larger than the file")
    return saved
