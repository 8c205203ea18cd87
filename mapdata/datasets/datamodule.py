"""`MapDataModule`: the datasets under a Lightning Trainer, a LightningCLI, or in a plain loop."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import astuple
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytorch_lightning as pl
import torch
from torch.utils.data import DataLoader

from mapdata.checks import check_count, items_of, known_values, plain_values
from mapdata.datasets.arguments import DEFAULT_FIELDS, FieldFunction, Serving, torch_dtype
from mapdata.datasets.dataset import MapDataset, Transform
from mapdata.datasets.online import OnlineMapDataset
from mapdata.datasets.sample import Sample, cast
from mapdata.datasets.sampler import EpochSampler, LateLoader
from mapdata.datasets.transforms import check_transform
from mapdata.generators.generator import MapGenerator, identity
from mapdata.generators.recipe import Recipe, RecipeLike, as_recipe
from mapdata.limits import SPLITS
from mapdata.movement import Movement
from mapdata.problems.sources import SourceLike, problem_source
from mapdata.shards.builder import build
from mapdata.shards.locations import is_url, locations
from mapdata.shards.manifest import MANIFEST, read_manifest

if TYPE_CHECKING or find_spec("lightning") is None:
    _Base = pl.LightningDataModule
else:  # the same library under its other name, whose Trainer accepts only its own class
    from lightning.pytorch import LightningDataModule as _OtherDataModule

    class _Base(pl.LightningDataModule, _OtherDataModule):
        """A data module of both packages."""


Dataset = MapDataset | OnlineMapDataset


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

    ``setup`` adds recipe, identity and content hash of the maps to ``hparams``, and tells loggers
    them with all arguments, as ``data``: checkpoints and logs say what was trained on. (Imported
    maps have no recipe and no identity; maps made online have no content hash, and ``build`` is
    their recipe.)

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
        num_workers, pin_memory, persistent_workers, prefetch_factor, multiprocessing_context: as of
        torch's DataLoader.
        fields: as in `MapDataset`, like all further arguments. ``augment`` concerns the training
            split only, ``transform`` all splits. A checkpoint holds neither a ``transform`` nor
            functions among the fields: give them to ``load_from_checkpoint`` again.
        movement: a `Movement`; (connectivity, corner_cutting, diagonal_cost); or some of these by
            name, as a mapping.

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
        fields: Sequence[str | FieldFunction] = DEFAULT_FIELDS,
        problems: SourceLike = "route",
        search: str = "astar",
        movement: Movement | tuple[int, bool, float] | Mapping[str, Any] | None = None,
        augment: bool = False,
        sampling_seed: int = 0,
        max_length: int | None = None,
        dtype: torch.dtype | str | None = None,
        transform: Transform | None = None,
        radius: float = 0.0,
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
        self.roots = roots
        self.build = _plain_recipe(build)
        self.batch_size = check_count("batch_size", batch_size)
        self.loading: dict[str, Any] = {
            "num_workers": num_workers,
            "pin_memory": pin_memory,
            "persistent_workers": persistent_workers,
            "prefetch_factor": prefetch_factor,
            "multiprocessing_context": multiprocessing_context,
        }
        source = problem_source(problems)
        moves = _movement(movement)
        self.serving = Serving(
            fields, source, search, moves, augment, sampling_seed, max_length, radius
        )
        check_transform(transform)
        self.dtype = torch_dtype(dtype, self.serving.names)
        self.transform = transform
        self.datasets: dict[str, Dataset] = {}
        plain = {  # without the transform, which a checkpoint cannot hold safely
            **self.loading,
            **self.serving.plain(),
            "dtype": None if self.dtype is None else str(self.dtype).removeprefix("torch."),
            "build": self.build,
            "batch_size": self.batch_size,
            "root": roots[0] if len(roots) == 1 else roots or None,
        }
        self.save_hyperparameters(plain, logger=False)

    def __repr__(self) -> str:
        return (
            f"MapDataModule({self.hparams['root']!r}, build={self.build!r}, "
            f"batch_size={self.batch_size}, fields={self.serving.names}): "
            f"{self.datasets or 'not set up'}"
        )

    __str__ = __repr__  # Lightning's own opens all loaders, and so builds a missing dataset

    def prepare_data(self) -> None:
        """Build the dataset if ``build`` says how and it is missing or incomplete.

        Many processes may do so at once.
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
        for split in stages[stage]:
            if split not in self.datasets:
                self.datasets[split] = self._open(split)
        self._describe(self.datasets[split])

    def _describe(self, dataset: Dataset) -> None:
        """Say in ``hparams``, and so in checkpoints, what the maps are; tell the loggers all."""
        if isinstance(dataset, MapDataset):
            found: list[tuple[str | None, ...]] = [
                (each.recipe() if each.spec else None, each.identity, each.content_hash)
                for each in dataset.reader.manifests
            ]
        else:  # what was given as ``build`` is its recipe
            found = [(None, identity(dataset.spec, dataset.seed), None)]
        values = found[0] if len(found) == 1 else zip(*found, strict=True)
        self.hparams.update(zip(("recipe", "identity", "content_hash"), values, strict=True))
        # In a group of its own, since Lightning refuses a name that a model gives another value.
        # Unlike the arguments it has the stored movement, and the names of functions.
        movement = astuple(dataset.movement)
        told = {**self.hparams, "fields": self.serving.names, "movement": movement}
        if self.transform is not None:
            told["transform"] = getattr(self.transform, "__name__", repr(self.transform))
        for logger in self.trainer.loggers if self.trainer else ():
            logger.log_hyperparams({"data": json.loads(json.dumps(told, default=str))})  # no tuples

    def _open(self, split: str) -> Dataset:
        arguments = {
            **vars(self.serving),
            "augment": self.serving.augment and split == "train",
            "dtype": self.dtype,
            "transform": self.transform,
        }
        if self.roots:
            return MapDataset(self.roots, split, **arguments)
        assert self.build is not None  # there are roots or a recipe
        recipe = as_recipe(self.build)
        length = max(round(recipe.maps * recipe.spec.splits[SPLITS.index(split)]), 1)
        return OnlineMapDataset(recipe.spec, recipe.seed, length, split, **arguments)

    def train_dataloader(self) -> DataLoader[Sample]:
        """Return the loader of the training split, in an order of its own each epoch."""
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
        if split not in self.datasets:
            self.setup(stage)
        dataset = self.datasets[split]
        sampling_seed = self.serving.sampling_seed if split == "train" else None
        sampler = EpochSampler(dataset, self.batch_size, sampling_seed, self)
        return LateLoader(dataset, batch_size=self.batch_size, sampler=sampler, **self.loading)

    def on_after_batch_transfer(self, batch: Any, dataloader_idx: int) -> Any:
        """Cast maps and masks to the type of the model, on the device of the batch.

        That is float32 unless the Trainer's ``precision`` says otherwise. Integers and bools that
        ``dtype`` asked for stay, and so does what a ``transform`` made into another type of batch.
        """
        stays = self.dtype is not None and not self.dtype.is_floating_point
        if stays or not isinstance(batch, Sample):
            return batch
        dtype: Any = self.trainer.lightning_module.dtype if self.trainer else torch.float32
        return cast(batch, dtype)


def _plain_recipe(recipe: RecipeLike | None) -> Any:
    """Return a recipe as text or plain values, which checkpoints can hold; files are not read."""
    if isinstance(recipe, MapGenerator | Recipe):
        recipe = as_recipe(recipe).to_dict()
    return str(recipe) if isinstance(recipe, Path) else plain_values(recipe)


def _movement(values: Any) -> Any:
    """Return the `Movement` that plain values stand for; what is none of these stays as it is."""
    if isinstance(values, Mapping):
        return Movement(**known_values("movement", values, Movement))
    items = items_of(values)
    return Movement(*items) if items else values
