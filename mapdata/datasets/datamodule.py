"""`MapDataModule`: the datasets under a Lightning Trainer, a LightningCLI, or in a plain loop."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import astuple
from importlib.util import find_spec
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytorch_lightning as pl
import torch
from torch.utils.data import DataLoader

from mapdata.checks import (
    check_choice,
    check_count,
    check_flag,
    plain_values,
)
from mapdata.datasets.arguments import (
    DEFAULT_FIELDS,
    FieldFunction,
    MovementLike,
    Serving,
    Transform,
    as_movement,
    torch_dtype,
)
from mapdata.datasets.dataset import MapDataset
from mapdata.datasets.online import OnlineMapDataset
from mapdata.datasets.sample import Sample, cast
from mapdata.datasets.sampler import EpochSampler, LateLoader
from mapdata.generators.generator import MapGenerator, identity
from mapdata.generators.recipe import Recipe, RecipeLike, as_recipe
from mapdata.limits import SPLITS
from mapdata.problems.sources import SourceLike, problem_source
from mapdata.shards.builder import build
from mapdata.shards.locations import is_url, locations
from mapdata.shards.manifest import MANIFEST, read_manifest

if TYPE_CHECKING:
    from matplotlib.axes import Axes

if TYPE_CHECKING or find_spec("lightning") is None:
    _Base = pl.LightningDataModule
else:  # the same library under its other name, whose Trainer accepts only its own class
    from lightning.pytorch import LightningDataModule as _OtherDataModule

    class _Base(pl.LightningDataModule, _OtherDataModule):
        """A data module of both packages."""


Dataset = MapDataset | OnlineMapDataset

_IS_ARGUMENT = "it is an argument of the data module"
_ORDERS_SAMPLES = "the data module sets it, since it decides on the samples of an epoch"

OWN_LOADER_OPTIONS = {
    "batch_size": _IS_ARGUMENT,
    "num_workers": _IS_ARGUMENT,
    "pin_memory": _IS_ARGUMENT,
    "persistent_workers": _IS_ARGUMENT,
    "prefetch_factor": _IS_ARGUMENT,
    "multiprocessing_context": _IS_ARGUMENT,
    "drop_last": _IS_ARGUMENT,
    "dataset": "the data module opens the datasets itself",
    "shuffle": _ORDERS_SAMPLES,
    "sampler": _ORDERS_SAMPLES,
    "batch_sampler": _ORDERS_SAMPLES,
    "collate_fn": "datasets make whole batches themselves; transform= changes their samples",
}
"""Options of torch's DataLoader that ``loader_options`` refuses, with the reason."""


class MapDataModule(_Base):
    """Loaders for training, validation, test and prediction.

    ``prepare_data`` only builds what is missing, ``setup`` only opens; without a Trainer the
    loaders call both themselves. ``num_workers=0`` is the fast way: whole batches come from one
    kernel call, and workers only add the cost of sending them.

    Loaders deliver maps and masks as uint8, or as the type that ``dtype`` names. Under a Trainer
    they become the type of the model on its device: float32, or what ``Trainer(precision=...)``
    makes of the model. So ``dtype=torch.float32`` serves a plain loop, and under a Trainer a model
    of bfloat16, too. Integers and bools that ``dtype`` asks for stay, as an embedding needs them,
    and so does a batch that a ``transform`` made into anything but a `Sample`.

    ``setup`` adds recipe, identity and content hash of the maps to ``hparams``, and logs them with
    all arguments, as ``data``: checkpoints and logs say on which maps a model was trained.
    (Imported maps have no recipe and no identity; maps made online have no content hash, and
    ``build`` is their recipe.)

    Under DDP with default Trainer flags, training samples are disjoint (at most ranks - 1 are left
    out of an epoch), and validation, test and prediction see every sample exactly once. So metrics
    of torchmetrics have the value of a single process; Lightning's own ``self.log(...,
    sync_dist=True)`` averages over ranks, which may hold unequal numbers of samples.

    Args:
        root: folder or URL of a dataset, or several; None with ``build`` makes maps online, without
            any disk.
        build: which maps to build when ``root`` is missing or incomplete: a preset's name, a
            recipe file, its JSON text or mapping, a `MapGenerator` or a `Recipe`.
        batch_size: samples a batch (a rank).
        num_workers: as in torch's DataLoader.
        pin_memory: as in torch's DataLoader.
        persistent_workers: as in torch's DataLoader.
        prefetch_factor: as in torch's DataLoader.
        multiprocessing_context: as in torch's DataLoader.
        drop_last: whether training leaves out the last batch of an epoch if it is not full. The
            loaders of validation, test and prediction always serve every sample.
        loader_options: further options of torch's DataLoader for all loaders by name, such as
            ``{"timeout": 60}``; not those that decide on the samples of an epoch, such as
            ``sampler``. A checkpoint holds no functions among them.
        fields: as in `MapDataset`, like all further arguments. ``augment`` and the
            ``jitter`` of `Tiles` concern the training split only, ``transform`` all splits. A
            checkpoint holds neither a ``transform`` nor functions among the fields: give them to
            ``load_from_checkpoint`` again.

    Raises:
        ValueError: arguments that do not fit, or that would do nothing.
    """

    def __init__(
        self,
        root: str | Path | Sequence[str] | None = "data/maps",
        *,
        build: RecipeLike | None = None,
        batch_size: int = 256,
        num_workers: int = 0,
        pin_memory: bool = False,
        persistent_workers: bool = False,
        prefetch_factor: int | None = None,
        multiprocessing_context: str | None = None,
        drop_last: bool = False,
        loader_options: Mapping[str, Any] | None = None,
        fields: Sequence[str | FieldFunction] = DEFAULT_FIELDS,
        problems: SourceLike = "route",
        search: str = "astar",
        movement: MovementLike | None = None,
        augment: bool = False,
        sampling_seed: int = 0,
        max_length: int | None = None,
        dtype: torch.dtype | str | None = None,
        transform: Transform | None = None,
        radius: float = 0.0,
        follow_links: bool = False,
    ) -> None:
        """Keep the arguments; nothing is read or built yet."""
        super().__init__()
        roots = () if root is None else locations(root)
        if not roots and build is None:
            raise ValueError(
                "root: got None, expected a dataset; or say with build= which maps to make online"
            )
        if build is not None and (len(roots) > 1 or any(map(is_url, roots))):
            raise ValueError(f"build: makes one dataset in one folder, root is {root!r}")
        if build is not None and follow_links:
            raise ValueError("follow_links: has no effect beside build=, which writes the dataset")
        self.roots = roots
        self.follow_links = follow_links
        self.build = _plain_recipe(build)
        self.batch_size = check_count("batch_size", batch_size)
        check_flag("drop_last", drop_last)
        self.drop_last = drop_last
        named_options: dict[str, Any] = {
            "num_workers": num_workers,
            "pin_memory": pin_memory,
            "persistent_workers": persistent_workers,
            "prefetch_factor": prefetch_factor,
            "multiprocessing_context": multiprocessing_context,
        }
        other_options = _checked_loader_options(loader_options)
        self.loader_options = {**named_options, **other_options}
        self.serving = Serving(
            fields=fields,
            problems=problem_source(problems),
            search=search,
            movement=as_movement(movement),
            augment=augment,
            sampling_seed=sampling_seed,
            max_length=max_length,
            dtype=dtype,
            transform=transform,
            radius=radius,
        )
        self.dtype = torch_dtype(self.serving.dtype, self.serving.names)
        self.transform = transform
        self.datasets: dict[str, Dataset] = {}
        # Checkpoints hold plain values only, so functions are left out.
        plain_options = {name: option for name, option in other_options.items() if is_plain(option)}
        hyperparameters = {
            **named_options,
            "drop_last": drop_last,
            "loader_options": plain_options or None,
            **self.serving.plain(),
            "build": self.build,
            "batch_size": self.batch_size,
            "follow_links": follow_links,
            "root": one_or_all(roots) if roots else None,
        }
        self.save_hyperparameters(hyperparameters, logger=False)

    def __repr__(self) -> str:
        arguments = (
            f"{self.hparams['root']!r}, build={self.build!r}, batch_size={self.batch_size}, "
            f"fields={self.serving.names}, problems={self.serving.problems}"
        )
        if self.serving.movement is not None:
            arguments += f", movement={self.serving.movement}"
        if self.serving.radius:
            arguments += f", radius={self.serving.radius}"
        return f"MapDataModule({arguments}): {self.datasets or 'not set up'}"

    __str__ = __repr__  # Lightning's own opens all loaders, and so builds a missing dataset

    def prepare_data(self) -> None:
        """Build the dataset if there is a ``build`` and the dataset is missing or incomplete.

        Several processes may do so at once.
        """
        if self.build is None or not self.roots:
            return
        root = Path(self.roots[0])
        shard_size = read_manifest(root).shard_size if (root / MANIFEST).exists() else 1000
        build(root, self.build, shard_size=shard_size, progress=True)

    def setup(self, stage: str | None = None) -> None:
        """Open the datasets of ``stage``; a second call does nothing.

        Stages are "fit", "validate", "test" and "predict"; None opens all.
        """
        if self.trainer is None:
            self.prepare_data()
        stages = {
            None: SPLITS,
            "fit": ("train", "val"),
            "validate": ("val",),
            "test": ("test",),
            "predict": ("test",),
        }
        splits = stages[stage]
        for split in splits:
            if split not in self.datasets:
                self.datasets[split] = self._open(split)
        self._describe(self.datasets[splits[0]])

    def _describe(self, dataset: Dataset) -> None:
        """Add the origin of the maps to ``hparams``, and so to checkpoints, and log all of it."""
        recipes: list[str | None] = [None]  # maps made online have ``build`` as their recipe
        content_hashes: list[str | None] = [None]
        if isinstance(dataset, MapDataset):
            manifests = dataset.reader.manifests
            recipes = [manifest.recipe() if manifest.generator else None for manifest in manifests]
            identities = [manifest.identity for manifest in manifests]
            content_hashes = [manifest.content_hash for manifest in manifests]
        else:
            identities = [identity(dataset.generator, dataset.seed)]
        self.hparams["recipe"] = one_or_all(recipes)
        self.hparams["identity"] = one_or_all(identities)
        self.hparams["content_hash"] = one_or_all(content_hashes)
        # Unlike the arguments, logs have the stored movement and the names of functions.
        logged = {
            **self.hparams,
            "fields": self.serving.names,
            "movement": astuple(dataset.movement),
        }
        if self.transform is not None:
            logged["transform"] = getattr(self.transform, "__name__", repr(self.transform))
        # JSON has no tuples, which some loggers refuse.
        plain_logged = json.loads(json.dumps(logged, default=str))
        # All is logged in a group of its own, because Lightning refuses a name that the model logs
        # with another value.
        for logger in self.trainer.loggers if self.trainer else ():
            logger.log_hyperparams({"data": plain_logged})

    def _open(self, split: str) -> Dataset:
        """Return the dataset of a split; only training samples are augmented and have jitter."""
        # The fields of `Serving` are keyword arguments of both datasets.
        arguments = vars(self.serving.of_split(split))
        if self.roots:
            return MapDataset(self.roots, split, follow_links=self.follow_links, **arguments)
        assert self.build is not None  # there are roots or a recipe
        recipe = as_recipe(self.build)
        maps = max(round(recipe.maps * recipe.generator.splits[SPLITS.index(split)]), 1)
        length = maps * self.serving.problems.per_map
        return OnlineMapDataset(recipe.generator, recipe.seed, length, split, **arguments)

    def train_dataloader(self) -> DataLoader[Sample]:
        """Return the loader of the training split, in another order each epoch."""
        return self._loader("train", "fit")

    def val_dataloader(self) -> DataLoader[Sample]:
        """Return the loader of the validation split, in its order."""
        return self._loader("val", "validate")

    def test_dataloader(self) -> DataLoader[Sample]:
        """Return the loader of the test split, in its order."""
        return self._loader("test", "test")

    def predict_dataloader(self) -> DataLoader[Sample]:
        """Return the loader of the test split, in its order."""
        return self._loader("test", "predict")

    def _loader(self, split: str, stage: str) -> DataLoader[Sample]:
        """Return the loader of a split, which ``stage`` opens."""
        if split not in self.datasets:
            self.setup(stage)
        dataset = self.datasets[split]
        is_training = split == "train"
        if not is_training and len(dataset) == 0:
            warnings.warn(
                f"{split}: no map of the dataset gives a problem of this split, so its loader is "
                "empty; a subclass may return a loader of a problem set (docs/problems.md, Problem "
                "sets from files)",
                stacklevel=3,
            )
        drop_last = self.drop_last and is_training
        sampler = EpochSampler(
            dataset,
            self.batch_size,
            self.serving.sampling_seed if is_training else None,
            self,
            drop_last=drop_last,
        )
        if drop_last and len(sampler) < self.batch_size:
            raise ValueError(
                f"drop_last: {len(sampler)} training samples do not fill a batch of "
                f"{self.batch_size}; take a smaller batch_size"
            )
        return LateLoader(
            dataset,
            batch_size=self.batch_size,
            sampler=sampler,
            drop_last=drop_last,
            **self.loader_options,
        )

    def plot(self, batch: Sample | None = None, split: str = "train") -> Axes:
        """Draw 9 samples: maps, starts S, goals G and paths.

        ``datamodule.plot().figure.savefig("batch.png")`` writes a picture.

        Args:
            batch: what a loader gives, with the field ``map`` or ``free``, of which the first
                samples are drawn; None for samples at equal steps of the split's dataset, which
                are of different maps, without a ``transform``.
            split: "train", "val" or "test"; it matters without a batch only.

        Returns:
            The axes of the first sample.

        Raises:
            ValueError: an unknown split, or a batch without maps.
        """
        # The face of the folder imports a lot that loading does not need.
        from mapdata.plotting.plot_models import MAX_SAMPLES, plot_sample

        if batch is not None:
            return plot_sample(batch)
        check_choice("split", split, SPLITS)
        if split not in self.datasets:
            self.setup({"train": "fit", "val": "validate", "test": "test"}[split])
        dataset = self.datasets[split]
        count = min(MAX_SAMPLES, len(dataset))
        return dataset.plot([k * len(dataset) // count for k in range(count)])

    def on_after_batch_transfer(self, batch: Any, dataloader_idx: int) -> Any:
        """Cast maps and masks to the type of the model, on the device of the batch.

        That is float32 unless the Trainer's ``precision`` says otherwise. Integers and bools that
        ``dtype`` asked for stay, and so does what a ``transform`` made into another type of batch.
        """
        is_integer = self.dtype is not None and not self.dtype.is_floating_point
        if is_integer or not isinstance(batch, Sample):
            return batch
        dtype: Any = self.trainer.lightning_module.dtype if self.trainer else torch.float32
        return cast(batch, dtype)


def _checked_loader_options(options: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return further options of torch's DataLoader as a dict.

    Raises:
        ValueError: an option that DataLoader does not have, or that the data module sets itself.
    """
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise ValueError(f"loader_options: got {options!r}, expected options by name")
    parameters = [name for name in signature(DataLoader).parameters if name != "self"]
    allowed = [name for name in parameters if name not in OWN_LOADER_OPTIONS]
    for name in options:
        if name in OWN_LOADER_OPTIONS:
            raise ValueError(f"loader_options: got {name!r}, but {OWN_LOADER_OPTIONS[name]}")
        check_choice("loader_options", name, allowed)
    return dict(options)


def is_plain(option: object) -> bool:
    """Return whether a checkpoint can hold an option with torch's safe default."""
    return option is None or isinstance(option, (bool, int, float, str))


def one_or_all(values: Sequence[Any]) -> Any:
    """Return the value of a single root, or the values of several roots as a tuple."""
    return values[0] if len(values) == 1 else tuple(values)


def _plain_recipe(recipe: RecipeLike | None) -> Any:
    """Return a recipe as text or plain values, which checkpoints can hold; files are not read."""
    if isinstance(recipe, MapGenerator | Recipe):
        recipe = as_recipe(recipe).to_dict()
    return str(recipe) if isinstance(recipe, Path) else plain_values(recipe)
