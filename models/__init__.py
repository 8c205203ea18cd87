"""Sample models to use, to read and to copy, imported as ``mapdata.models``.

- ``path_predictor.py``: a CNN that predicts the moves of shortest paths.
- ``neural_astar.py``: Neural A* in one file.
- ``cost_predictor.py``: a CNN that reads the costs of terrain from images, taught by paths.
- ``learned_planners.py``: the planners of a model, as rows of a table, and their validation.
- ``lego/``: a sampler that learns where a roadmap needs its vertices.

They share six files:

- ``layers.py``: the layers of the networks.
- ``geometry.py``: distances, heuristics and legal moves on tensors of maps.
- ``symmetries.py``: the eight symmetries of a square map.
- ``optimizer.py``: Muon, and the schedule of its learning rate.
- ``model.py``: the training step, and saving and loading weights.
- ``mixed_batches.py``: batches of several families in one training step.

``train.py`` and ``evaluate.py`` are the command lines; ``configs/`` has the arguments of the
trainings, ``weights/`` what they gave.

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
    from .cost_predictor import CostPredictor as CostPredictor
    from .learned_planners import GuidedSearch as GuidedSearch
    from .learned_planners import LearnedPlanner as LearnedPlanner
    from .learned_planners import planners as planners
    from .lego.cvae import CVAE as CVAE
    from .lego.sampler import Heatmap as Heatmap
    from .lego.sampler import Sampler as Sampler
    from .mixed_batches import MixedBatches as MixedBatches
    from .model import Model as Model
    from .model import fast_precision as fast_precision
    from .model import load_model as load_model
    from .neural_astar import NeuralAstar as NeuralAstar
    from .path_predictor import PathPredictor as PathPredictor

_MODULES = {
    "CVAE": "lego.cvae",
    "CostPredictor": "cost_predictor",
    "GuidedSearch": "learned_planners",
    "Heatmap": "lego.sampler",
    "LearnedPlanner": "learned_planners",
    "MixedBatches": "mixed_batches",
    "Model": "model",
    "NeuralAstar": "neural_astar",
    "PathPredictor": "path_predictor",
    "Sampler": "lego.sampler",
    "fast_precision": "model",
    "load_model": "model",
    "planners": "learned_planners",
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
            f"mapdata.models.{name} is now mapdata.costmaps.{name}", FutureWarning, stacklevel=2
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
