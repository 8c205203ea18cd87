"""Models: samples to read and to copy, and models to call, imported as ``mapdata.models``.

To read, from top to bottom; each trains, predicts and compares itself in one file:

- ``path_predictor.py``: a CNN path predictor, which predicts the moves of shortest paths.
- ``lego_sampler.py``: a LEGO-style sampler, which learns where a roadmap needs its vertices.

To call, with weights, options and checks; their names are below:

- ``pretrained/``: `PathPredictor`, `CostPredictor`, `Heatmap` and `CVAE`, their weights, and the
  files that they share.
- ``neural_astar.py``: Neural A*, without weights.
- ``train.py`` and ``evaluate.py``: the command lines that train and compare these.

In a checkout this folder lies beside ``mapdata/``, whose entry ``models`` is a link to it. So it
has the name ``mapdata.models`` everywhere. The names below are imported on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if __name__ != "mapdata.models":
    # A program that runs in the checkout could import the folder once more as "models". Its classes
    # would then exist twice, and the ones would not be instances of the others.
    raise ImportError(f"{__name__}: this folder is imported as mapdata.models, and as nothing else")

if TYPE_CHECKING:
    from .lego_sampler import LegoSampler as LegoSampler
    from .neural_astar import NeuralAstar as NeuralAstar
    from .path_predictor import MovePredictor as MovePredictor
    from .pretrained.cost_predictor import CostPredictor as CostPredictor
    from .pretrained.learned_planners import GuidedSearch as GuidedSearch
    from .pretrained.learned_planners import LearnedPlanner as LearnedPlanner
    from .pretrained.learned_planners import planners as planners
    from .pretrained.lego.cvae import CVAE as CVAE
    from .pretrained.lego.sampler import Heatmap as Heatmap
    from .pretrained.lego.sampler import Sampler as Sampler
    from .pretrained.mixed_batches import MixedBatches as MixedBatches
    from .pretrained.model import Model as Model
    from .pretrained.model import fast_precision as fast_precision
    from .pretrained.model import load_model as load_model
    from .pretrained.path_predictor import PathPredictor as PathPredictor

_MODULES = {
    "CVAE": "pretrained.lego.cvae",
    "CostPredictor": "pretrained.cost_predictor",
    "GuidedSearch": "pretrained.learned_planners",
    "Heatmap": "pretrained.lego.sampler",
    "LearnedPlanner": "pretrained.learned_planners",
    "LegoSampler": "lego_sampler",
    "MixedBatches": "pretrained.mixed_batches",
    "Model": "pretrained.model",
    "MovePredictor": "path_predictor",
    "NeuralAstar": "neural_astar",
    "PathPredictor": "pretrained.path_predictor",
    "Sampler": "pretrained.lego.sampler",
    "fast_precision": "pretrained.model",
    "load_model": "pretrained.model",
    "planners": "pretrained.learned_planners",
}
"""The module that each public name is imported from."""

_MOVED = ("Costmap", "fit_costmap")
"""Names of `mapdata.costmaps` that this version still gives here."""

__all__ = [*_MODULES]  # noqa: PLE0604  (a list of names)


def __getattr__(name: str) -> object:
    """Import a public name on first use."""
    if name in _MOVED:
        import warnings

        warnings.warn(
            f"mapdata.models.{name} will be gone in 0.5.0: it is now mapdata.costmaps.{name}",
            FutureWarning,
            stacklevel=2,
        )
        moved: object = getattr(import_module("mapdata.costmaps"), name)
        return moved
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    member = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    globals()[name] = member
    return member


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(__all__)
