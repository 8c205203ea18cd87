"""Options, weights and images of all models that could only give nonsense are refused by name."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors
import safetensors.torch
import torch

from mapdata.models import (
    CVAE,
    CostPredictor,
    Heatmap,
    Model,
    NeuralAstar,
    PathPredictor,
    load_model,
)
from mapdata.models.pretrained.model import _digest

MODELS: tuple[type[Model], ...] = (CostPredictor, PathPredictor, NeuralAstar, Heatmap, CVAE)
SMALL: dict[type[Model], dict[str, Any]] = {
    CostPredictor: {"width": 2},
    PathPredictor: {"widths": (4, 4, 4), "passes": 1},
    NeuralAstar: {},
    Heatmap: {"widths": (4, 4, 4), "passes": 1},
    CVAE: {"width": 4, "code": 4},
}
"""Arguments of small models, for speed."""


@pytest.mark.parametrize(
    ("model_class", "option", "values"),
    [
        *((model_class, "learning_rate", (-1, math.nan, math.inf, "1")) for model_class in MODELS),
        (CostPredictor, "pixels", (4, 6, 8.5)),
        (CostPredictor, "width", (0, -2, 2.5)),
        (CostPredictor, "parts", (-1, 0.5)),
        (PathPredictor, "widths", ((8,), (8, 8, 0), (8, 8, 8, 8, 8), (8, 8.5), 8, "88")),
        (PathPredictor, "passes", (-1, 1.5)),
        (PathPredictor, "refinements", (-1,)),
        (PathPredictor, "ratio_weight", (-1, math.nan)),
        (PathPredictor, "detour_weight", (-1, math.inf)),
        (PathPredictor, "terrain", (1,)),
        (PathPredictor, "connectivity", (6,)),
        (Heatmap, "widths", ((8,), (8, -8))),
        (Heatmap, "passes", (-1,)),
        (Heatmap, "temperature", (-1, math.nan)),
        (Heatmap, "spacing", (-1, math.nan)),
        (Heatmap, "views", (0, 9, 1.5)),
        (CVAE, "latent", (0,)),
        (CVAE, "width", (0,)),
        (CVAE, "code", (-1,)),
    ],
)
def test_an_option_that_does_not_fit_is_refused_by_name(
    model_class: type[Model], option: str, values: tuple[Any, ...]
) -> None:
    """Before any layer is made."""
    for value in values:
        with pytest.raises(ValueError, match=f"^{option}: got "):
            model_class(**{**SMALL[model_class], option: value})


def test_the_smallest_cells_have_an_output() -> None:
    """Cells of 7 pixels are the smallest that the convolutions reduce to at least one place."""
    model = CostPredictor(pixels=7, width=2)
    terrain = model.predict(np.zeros((1, 3, 14, 21), np.uint8), np.zeros((1, 2, 3), np.uint8))
    assert terrain.shape == (1, 2, 3)


CHANGES: dict[str, tuple[Callable[[torch.Tensor], torch.Tensor], str]] = {
    "nan": (lambda weight: weight * math.nan, "got the weight nan, expected finite numbers"),
    "infinite": (lambda weight: weight.abs() + math.inf, "got the weight inf, expected finite"),
    "complex": (
        lambda weight: weight.float() + 0j,
        "got weights of torch.complex.*, expected real",
    ),
    "integers": (lambda weight: weight.to(torch.int8), "got weights of torch.int8, expected real"),
}


@pytest.mark.parametrize("model_class", MODELS)
@pytest.mark.parametrize("change", CHANGES)
def test_weights_that_are_no_finite_real_numbers_are_refused(
    tmp_path: Path, model_class: type[Model], change: str
) -> None:
    """The message names the file, and the first tensor that holds one."""
    file = tmp_path / "weights.pt"
    model_class(**SMALL[model_class]).save(file)
    with safetensors.safe_open(file, "pt") as opened:
        description = opened.metadata()
    weights = safetensors.torch.load_file(file)
    *_, name = weights
    function, message = CHANGES[change]
    weights[name] = function(weights[name])
    description["sha256"] = _digest(description, weights)
    safetensors.torch.save_file(weights, file, description)
    with pytest.raises(ValueError, match=rf"weights\.pt: holds no saved .*{name}: {message}"):
        load_model(file, model_class)


def test_weights_of_a_training_that_diverged_are_not_saved(tmp_path: Path) -> None:
    """Nor are those that have no room in 16 bits; the file of before stays."""
    model = CostPredictor(**SMALL[CostPredictor])
    file = tmp_path / "weights.pt"
    model.save(file)
    sound = file.read_bytes()
    for number in (math.nan, 1e6):
        with torch.no_grad():
            next(model.parameters()).fill_(number)
        with pytest.raises(ValueError, match=r"network\.0\.weight: got the weight (nan|inf)"):
            model.save(file)
    assert file.read_bytes() == sound


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (math.nan, "images: got the value nan, expected numbers from 0 to 255"),
        (-1.0, "images: got the value -1.0, expected"),
        (256.0, "images: got the value 256.0, expected"),
        (1j, "images: got torch.complex128, expected"),
    ],
)
def test_images_of_other_numbers_are_refused(value: complex, message: str) -> None:
    """One NaN made the terrain of the whole map 0."""
    images = np.zeros((1, 3, 16, 16), type(value))
    images[0, 0, 3, 3] = value
    with pytest.raises(ValueError, match=message):
        CostPredictor(width=2).predict(images, np.zeros((1, 2, 2), np.uint8))


def test_weights_of_nan_give_no_terrain() -> None:
    """Costs of NaN would become terrain of 0, which is occupied."""
    model = CostPredictor(width=2)
    with torch.no_grad():
        next(model.parameters()).fill_(math.nan)
    with pytest.raises(ValueError, match=r"costs: got nan at \(0, 0, 0\), expected a finite"):
        model.predict(np.zeros((1, 3, 16, 16), np.uint8), np.zeros((1, 2, 2), np.uint8))
