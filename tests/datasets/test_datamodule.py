"""The data module: plain loops, Trainers, checkpoints in mid-epoch, two processes, LightningCLI;
the order.
"""

from __future__ import annotations

import json
import pickle
import random
import shutil
import subprocess
import sys
import tracemalloc
from collections import UserDict, UserList
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from inspect import signature
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import pytorch_lightning as pl
import torch
import yaml
from helpers import ranks, reference, run_helper, samples
from helpers.examples import slow
from helpers.figures import assert_lines, drawn, figure_of
from helpers.training import FIELDS, Model, Seen, module, trainer
from pytorch_lightning.callbacks import ModelCheckpoint
from pytorch_lightning.cli import LightningCLI
from pytorch_lightning.loggers import CSVLogger, Logger, TensorBoardLogger
from torch.utils.data import DataLoader, TensorDataset

from mapdata import (
    DatasetNotFoundError,
    MapDataModule,
    MapDataset,
    MapSpec,
    Movement,
    Pairs,
    Random,
    Route,
    Sample,
    verify,
)
from mapdata.datasets import EpochSampler
from mapdata.datasets.datamodule import OWN_LOADER_OPTIONS
from mapdata.formats import Collection, ForeignMap, import_maps
from mapdata.generators import as_recipe
from mapdata.plotting import COLOURS
from mapdata.problems.sources import Source
from mapdata.shards import builder, read_manifest

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*does not have many workers which may be a bottleneck"),
    pytest.mark.filterwarnings("ignore:This DataLoader will create 3 worker:UserWarning"),
    pytest.mark.filterwarnings(
        "ignore:You requested to overfit but enabled .* dataloader shuffling"
    ),
    pytest.mark.filterwarnings(
        "ignore:Be aware that when using `ckpt_path`, callbacks used to create the checkpoint"
    ),
    pytest.mark.filterwarnings("ignore:.*isinstance.treespec, LeafSpec.* is deprecated"),
]

RECIPE = json.dumps({"spec": samples.SPEC.to_dict(), "seed": 5, "maps": 60})


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A small dataset in four shards."""
    return samples.build_small(tmp_path_factory.mktemp("datamodule") / "maps")


def batches_of(data: MapDataModule, passes: int = 1) -> list[Sample]:
    """Return all training batches of some passes over one loader."""
    loader = data.train_dataloader()
    return [batch for _ in range(passes) for batch in loader]


# --- without a Trainer --------------------------------------------------------------------------

LIGHTNING = (
    "pytorch_lightning",
    "lightning",
    "lightning_fabric",
    "torchmetrics",
    "pandas",
    "fsspec",
    "matplotlib",
)
"""Packages that take seconds to import and that serve no batch."""

WITHOUT_LIGHTNING = f"""
import pickle, sys

def report():
    print([name for name in {LIGHTNING} if name in sys.modules])

loader_dataset, collate = pickle.load(sys.stdin.buffer)  # as a spawned loader worker begins
collate(loader_dataset.__getitems__([2, 1, 0]))
report()
from mapdata import MapDataset, MapSpec, build
from torch.utils.data import DataLoader, TensorDataset
build(sys.argv[1], MapSpec(), maps=3)
next(iter(DataLoader(MapDataset(sys.argv[1]), 2)))
report()
from mapdata.datasets import MapDataModule
assert MapDataModule.__bases__ and "pytorch_lightning" in sys.modules
"""


@pytest.mark.slow
def test_only_the_data_module_loads_lightning(root: str, tmp_path: Path) -> None:
    """Neither does a dataset that is built and read, nor a spawned worker of the module's loader,
    which gets dataset and collate function pickled.
    """
    loader = MapDataModule(root).train_dataloader()
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_LIGHTNING, str(tmp_path / "maps")],
        input=pickle.dumps((loader.dataset, loader.collate_fn)),
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr.decode()
    assert done.stdout.decode().splitlines() == ["[]", "[]"]


def test_a_plain_loop_needs_nothing_else(root: str) -> None:
    """No Trainer, no setup: the default four fields, uint8, each sample once, in an order that is
    not theirs.
    """
    data = MapDataModule(root, batch_size=10)
    map_, start, goal, path = next(iter(data.train_dataloader()))
    assert (map_.dtype, tuple(map_.shape)) == (torch.uint8, (10, 1, 20, 20))
    assert (start.dtype, goal.dtype, path.dtype) == (torch.int64,) * 3
    data = module(root)
    expected = MapDataset(root, "train", FIELDS)
    seen = torch.cat([batch.problem for batch in data.train_dataloader()])
    assert sorted(seen.tolist()) == list(range(len(expected))) != seen.tolist()
    assert len(data.train_dataloader()) == -(-len(expected) // 8)
    first = next(iter(data.train_dataloader()))
    samples.assert_same(first, expected[first.problem])
    for split, loader in (("val", data.val_dataloader()), ("test", data.test_dataloader())):
        whole = MapDataset(root, split, FIELDS)
        samples.assert_all_same(list(loader), [whole[k : k + 8] for k in range(0, len(whole), 8)])
    samples.assert_all_same(list(data.predict_dataloader()), list(data.test_dataloader()))


def test_a_plain_loop_trains_with_a_dtype(root: str) -> None:
    """Maps and masks as the network takes them, in every split; all else as it was."""
    fields = ("map", "goal_mask", "path", "cost_to_go", "optimal_moves")
    data = module(root, fields=fields, dtype=torch.float32)
    plain = module(root, fields=fields)
    for loader, expected in (
        (data.train_dataloader(), plain.train_dataloader()),
        (data.val_dataloader(), plain.val_dataloader()),
        (data.test_dataloader(), plain.test_dataloader()),
    ):
        for batch, before in zip(loader, expected, strict=True):
            samples.assert_same(batch, before, without=("map", "goal_mask"))
            for name in ("map", "goal_mask"):
                assert getattr(batch, name).dtype == torch.float32
                assert torch.equal(getattr(batch, name), getattr(before, name).float())
    layer = torch.nn.Conv2d(1, 1, 3)
    layer(next(iter(data.train_dataloader())).map).mean().backward()
    assert layer.weight.grad is not None


def input_and_target(sample: Sample) -> tuple[torch.Tensor, torch.Tensor]:
    """Return what many training loops expect of a dataset."""
    return sample.map, sample.goal


def test_a_transform_is_that_of_the_dataset(root: str) -> None:
    """Called with single samples of every split, in the order of the module."""
    arguments: dict[str, Any] = {"dtype": torch.float32, "transform": input_and_target}
    data = module(root, **arguments)
    order = [batch.problem for batch in module(root).train_dataloader()]
    dataset = MapDataset(root, "train", FIELDS, **arguments)
    for batch, problems in zip(data.train_dataloader(), order, strict=True):
        for values, expected in zip(batch, dataset[problems], strict=True):
            assert torch.equal(values, expected)
    assert batch[0].dtype == torch.float32
    for split, loader in (("val", data.val_dataloader()), ("test", data.test_dataloader())):
        _, goals = next(iter(loader))
        assert torch.equal(goals, MapDataset(root, split)[:8].goal)


class Convolution(pl.LightningModule):
    """Feeds maps to a layer, remembers their types."""

    def __init__(self) -> None:
        """Make the layer."""
        super().__init__()
        self.layer = torch.nn.Conv2d(1, 1, 3)
        self.types: set[torch.dtype] = set()

    def training_step(self, batch: Sample, _: int) -> torch.Tensor:
        """Return a loss of maps and a field of floats."""
        self.types |= {batch.map.dtype, batch.cost_to_go.dtype}
        loss: torch.Tensor = self.layer(batch.map).mean() + 0 * batch.cost_to_go.mean()
        return loss

    def validation_step(self, batch: Sample, _: int) -> None:
        """Remember the types alone."""
        self.types |= {batch.map.dtype, batch.cost_to_go.dtype}

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Return any optimizer."""
        return torch.optim.SGD(self.parameters(), 0.1)


@pytest.mark.parametrize(
    ("precision", "dtype"),
    [("32-true", torch.float32), ("bf16-true", torch.bfloat16), ("64-true", torch.float64)],
)
def test_maps_have_the_type_of_the_model(root: str, precision: Any, dtype: torch.dtype) -> None:
    """Whatever precision the Trainer gives the model, maps and other floats have it, too."""
    model = Convolution()
    data = module(root, fields=("map", "cost_to_go"))
    trainer(precision=precision, max_steps=1).fit(model, datamodule=data)
    assert model.types == {dtype}


@pytest.mark.parametrize(
    ("dtype", "precision", "arrives"),
    [
        (torch.float32, "32-true", torch.float32),
        (torch.float32, "bf16-true", torch.bfloat16),
        (torch.float16, "32-true", torch.float32),
        (torch.int64, "bf16-true", torch.int64),
        (torch.uint8, "32-true", torch.uint8),
    ],
)
def test_a_trainer_casts_floats_to_the_type_of_the_model(
    root: str, dtype: torch.dtype, precision: Any, arrives: torch.dtype
) -> None:
    """As Lightning does with all floats; integers that were asked for, say for an embedding,
    stay.
    """
    types = set()

    class Remembers(Convolution):
        def training_step(self, batch: Sample, _: int) -> torch.Tensor:
            types.add(batch.map.dtype)
            loss: torch.Tensor = self.layer(batch.map.to(self.dtype)).mean()
            return loss

    data = module(root, fields=("map",), dtype=dtype)
    trainer(precision=precision, max_steps=1, limit_val_batches=0).fit(Remembers(), datamodule=data)
    assert types == {arrives}


def test_a_transform_decides_what_arrives_under_a_trainer(root: str) -> None:
    """A pair is left as the transform made it; a `Sample` is cast like any other."""
    seen: list[Any] = []

    class Remembers(Convolution):
        def training_step(self, batch: Any, _: int) -> torch.Tensor:
            seen.append(batch)
            loss: torch.Tensor = self.layer(batch[0].to(self.dtype)).mean()
            return loss

    for transform in (input_and_target, goal_as_start):
        run = trainer(max_steps=1, limit_val_batches=0)
        run.fit(Remembers(), datamodule=module(root, transform=transform))
    pair, batch = seen
    assert (type(pair), pair[0].dtype) == (list, torch.uint8)  # as torch collates tuples
    assert (batch.map.dtype, batch.start.dtype) == (torch.float32, torch.int64)
    assert torch.equal(batch.start, batch.goal)


def goal_as_start(sample: Sample) -> Sample:
    """Return the sample with its goal in place of its start."""
    changed: Sample = sample._replace(start=sample.goal)
    return changed


def test_a_trainer_takes_a_plain_loader(root: str) -> None:
    """No data module, no cast: the dataset makes floats itself."""
    model = Convolution()
    dataset = MapDataset(root, "train", ("map", "cost_to_go"), dtype=torch.float32)
    trainer(max_steps=1).fit(model, DataLoader(dataset, 8), DataLoader(dataset, 8))
    assert model.types == {torch.float32}


def test_each_pass_is_an_epoch(root: str) -> None:
    """The order is anew each pass, and that of the epoch that `set_epoch` names."""
    data = module(root)
    loader = data.train_dataloader()
    passes = [torch.cat([batch.problem for batch in loader]).tolist() for _ in range(3)]
    assert len({tuple(one) for one in passes}) == 3
    assert len({tuple(sorted(one)) for one in passes}) == 1
    sampler = loader.sampler
    assert isinstance(sampler, EpochSampler)
    for epoch in (2, 0, 2):
        sampler.set_epoch(epoch)
        assert torch.cat([batch.problem for batch in loader]).tolist() == passes[epoch]


def test_the_order_is_a_permutation_without_pattern() -> None:
    """Each number once; over many epochs each place holds each number about equally often."""
    counts = np.zeros((12, 12))
    sampler = sampler_of(12, 4, 3)
    for epoch in range(600):
        order = np.array(list(sampler)) - epoch * 12
        assert sorted(order.tolist()) == list(range(12))
        counts[np.arange(12), order] += 1
    assert 20 < counts.min() < counts.max() < 85  # 50 are expected


def sampler_of(count: int, batch_size: int, sampling_seed: int) -> EpochSampler:
    """Return the sampler of a dataset of so many problems."""
    dataset: Any = TensorDataset(torch.zeros(count))
    return EpochSampler(dataset, batch_size, sampling_seed)


@pytest.mark.parametrize("count", [1, 2, 7, 64, 300])
def test_the_order_is_the_shuffle_of_the_reference(count: int) -> None:
    """Fisher and Yates with the words of stream order, whatever the batch size; Python's ints."""
    sampler = sampler_of(count, 7, 2**63 + 5)
    sampler.set_epoch(3)
    order = list(range(count))
    for k in range(count - 1, 0, -1):
        first, second, _, _ = reference.block(2**63 + 5, k, 3, reference.ORDER, 0)
        j = (first << 32 | second) * (k + 1) >> 64
        order[k], order[j] = order[j], order[k]
    found = list(sampler)
    assert found == [k + 3 * count for k in order]
    assert {type(k) for k in found} == {int}


def test_a_million_samples_take_a_few_bytes_each() -> None:
    """The sampler never holds them as a list of Python's integers, which take 36 bytes."""
    sampler = sampler_of(1_000_000, 256, 1)
    next(iter(sampler))  # compiles
    tracemalloc.start()
    try:
        next(iter(sampler))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 5_000_000


@pytest.mark.parametrize("split", ["train", "val"])
def test_augmentation_is_for_training_alone(root: str, split: str) -> None:
    """Validation and test see the maps as they are."""
    plain, turned = (module(root, augment=augment) for augment in (False, True))
    loaders = [
        data.train_dataloader() if split == "train" else data.val_dataloader()
        for data in (plain, turned)
    ]
    same = [torch.equal(a.map, b.map) for a, b in zip(*loaders, strict=True)]
    assert all(same) == (split == "val")


ORDERS: dict[str, dict[str, Any]] = {
    "workers-1": {"num_workers": 1},
    "workers-3": {"num_workers": 3},
    "persistent": {"num_workers": 1, "persistent_workers": True},
    "persistent-3": {"num_workers": 3, "persistent_workers": True, "prefetch_factor": 1},
    "spawn": {"num_workers": 1, "persistent_workers": True, "multiprocessing_context": "spawn"},
}


@pytest.fixture(scope="module")
def two_epochs(root: str) -> list[Sample]:
    """Two epochs of random problems with symmetries, by the process itself."""
    return batches_of(module(root, problems="random", augment=True), 2)


@pytest.mark.parametrize(
    "order",
    [slow(name) if name != "persistent-3" else name for name in ORDERS],
)
def test_workers_change_neither_order_nor_samples(
    root: str, two_epochs: list[Sample], order: str
) -> None:
    """Whatever their number and start, and whatever else draws random numbers."""
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002  (what others may do)
    torch.manual_seed(1)
    data = module(root, problems="random", augment=True, **ORDERS[order])
    samples.assert_all_same(batches_of(data, 2), two_epochs)


def test_another_sampling_seed_is_another_order(root: str, two_epochs: list[Sample]) -> None:
    """The sampling seed is not the seed of the maps."""
    again = batches_of(module(root, problems="random", augment=True, sampling_seed=1), 2)
    assert [batch.problem.tolist() for batch in again] != [
        batch.problem.tolist() for batch in two_epochs
    ]


# --- under a Trainer ----------------------------------------------------------------------------


def test_fit_with_default_flags(root: str) -> None:
    """Every sample once an epoch, in the order of the plain loop; float32 in the model, uint8 from
    the loader.
    """
    model = Model(noise=True)
    trainer().fit(model, datamodule=module(root))
    plain = batches_of(module(root), 2)
    assert [list(one.problems) for one in model.seen] == [batch.problem.tolist() for batch in plain]
    assert [one.starts for one in model.seen] == [
        tuple(batch.start.flatten().tolist()) for batch in plain
    ]
    assert [one.occupied for one in model.seen] == [int(batch.map.sum()) for batch in plain]
    assert {one.dtype for one in model.seen} == {torch.float32}
    assert {one.epoch for one in model.seen} == {0, 1}
    assert plain[0].map.dtype == torch.uint8
    val = list(range(len(MapDataset(root, "val"))))
    assert model.others["val"] == val[:16] + val + val  # the sanity check first: two batches


@pytest.mark.slow
def test_random_problems_are_anew_in_each_epoch_of_a_fit(root: str) -> None:
    """The epoch that is drawn for is the Trainer's."""
    model = Model()
    trainer().fit(
        model, datamodule=module(root, problems="random", num_workers=2, persistent_workers=True)
    )
    starts = [
        {
            problem: one.starts[2 * k : 2 * k + 2]
            for one in model.seen
            if one.epoch == epoch
            for k, problem in enumerate(one.problems)
        }
        for epoch in (0, 1)
    ]
    assert starts[0].keys() == starts[1].keys()
    assert sum(starts[0][k] == starts[1][k] for k in starts[0]) < len(starts[0]) / 4
    assert [list(one.problems) for one in model.seen] == [
        batch.problem.tolist() for batch in batches_of(module(root, problems="random"), 2)
    ]


def test_what_is_cast_on_the_device(root: str) -> None:
    """Maps and masks become float32; cells, numbers and the bit sets of moves stay what they
    are.
    """
    data = module(root, fields=samples.ALL_FIELDS)
    before = next(iter(data.val_dataloader()))
    after = data.on_after_batch_transfer(before, 0)
    cast = {
        name for name in before._fields if getattr(before, name).dtype != getattr(after, name).dtype
    }
    assert cast == {
        "image",
        "maze_image",
        "map",
        "free",
        "terrain",
        "path_mask",
        "start_mask",
        "goal_mask",
        "optimal_mask",
    }
    assert all(getattr(after, name).dtype == torch.float32 for name in cast)
    assert all(torch.equal(getattr(after, name), getattr(before, name)) for name in before._fields)
    assert data.on_after_batch_transfer({"other": 1}, 0) == {"other": 1}


def test_validate_test_and_predict(root: str) -> None:
    """Each sees its split once, in order."""
    model, run = Model(), trainer()
    run.validate(model, datamodule=module(root), verbose=False)
    run.test(model, datamodule=module(root), verbose=False)
    predicted = run.predict(model, datamodule=module(root))
    for stage, split in (("val", "val"), ("test", "test"), ("predict", "test")):
        assert model.others[stage] == list(range(len(MapDataset(root, split))))
    assert predicted is not None
    assert torch.cat([*map(torch.as_tensor, predicted)]).tolist() == model.others["predict"]


@pytest.mark.parametrize(
    ("flags", "counts"),
    [
        ({"fast_dev_run": True}, [1]),
        ({"limit_train_batches": 3}, [3, 3]),
        ({"limit_train_batches": 0.5}, [6, 6]),
        ({"overfit_batches": 2}, [2, 2]),
    ],
    ids=["fast_dev_run", "limit", "limit-share", "overfit"],
)
def test_flags_of_the_trainer(root: str, flags: dict[str, Any], counts: list[int]) -> None:
    """The flags do what they say: as many batches, and with `overfit_batches` the same ones."""
    model = Model()
    trainer(**flags).fit(model, datamodule=module(root))
    by_epoch = [
        [one.problems for one in model.seen if one.epoch == epoch] for epoch in range(len(counts))
    ]
    total = -(-len(MapDataset(root, "train")) // 8)
    halved = flags.get("limit_train_batches") == 0.5
    expected = [int(total * 0.5) if halved else count for count in counts]
    assert [len(one) for one in by_epoch] == expected
    if len(counts) > 1:
        assert (by_epoch[0] == by_epoch[1]) == ("overfit_batches" in flags)


# --- checkpoints --------------------------------------------------------------------------------

RESUMED: dict[str, tuple[dict[str, Any], dict[str, Any], int]] = {
    "plain": ({}, {}, 5),
    "random": ({"problems": "random", "augment": True}, {}, 3),
    "workers": ({"num_workers": 2}, {}, 5),
    "estimate": ({}, {"estimate": True}, 5),
    "estimate-workers": ({"num_workers": 2}, {"estimate": True}, 5),
    "persistent": ({"num_workers": 1, "persistent_workers": True}, {"estimate": True}, 5),
    "second-epoch": ({}, {"estimate": True}, 17),
    "accumulation": ({}, {"estimate": True, "accumulate_grad_batches": 2}, 4),
    "validation": ({}, {"val_check_interval": 3}, 5),
    "validation-there": ({}, {"val_check_interval": 5, "estimate": True}, 5),
    "limit": ({}, {"limit_train_batches": 7, "estimate": True}, 9),
    "limit-end": ({}, {"limit_train_batches": 7}, 7),
    "drop-last": ({"drop_last": True}, {"estimate": True}, 5),
    "drop-last-end": ({"drop_last": True}, {"estimate": True}, 10),
}
"""Arguments of the data module, of model and Trainer, and the step that is gone on from."""


QUICK_RESUMED = ("random", "second-epoch")
"""Cases that README's test command tries; the others are slow."""


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=() if case in QUICK_RESUMED else pytest.mark.slow)
        for case in RESUMED
    ],
)
def test_a_resumed_epoch_goes_on_where_it_stopped(root: str, tmp_path: Path, case: str) -> None:
    """Exactly the samples that were not seen yet, in the same order, then the same epochs."""
    data, arguments, step = RESUMED[case]
    arguments = {"num_sanity_val_steps": 0, **arguments}
    estimate = arguments.pop("estimate", False)
    every = ModelCheckpoint(tmp_path, "{step}", every_n_train_steps=1, save_top_k=-1)
    whole, rest = Model(estimate=estimate), Model(estimate=estimate, noise=True)
    trainer(callbacks=[every], enable_checkpointing=True, **arguments).fit(
        whole, datamodule=module(root, **data)
    )
    path = tmp_path / f"step={step}.ckpt"
    trainer(**arguments).fit(rest, datamodule=module(root, **data), ckpt_path=path)
    done = step * arguments.get("accumulate_grad_batches", 1)
    assert 0 < done < len(whole.seen)
    assert rest.seen == whole.seen[done:]
    assert _is_within_an_epoch(whole.seen, done) == (not case.endswith("-end"))


@pytest.mark.slow
@pytest.mark.parametrize("workers", [0, 2])
@pytest.mark.parametrize("step", [3, 7])
def test_a_loader_alone_goes_on_where_it_stopped(
    root: str, tmp_path: Path, step: int, workers: int
) -> None:
    """A Trainer that knows the loader, but not its data module, saves the loader's own state."""
    every = ModelCheckpoint(tmp_path, "{step}", every_n_train_steps=1, save_top_k=-1)
    arguments: dict[str, Any] = {"problems": "random", "num_workers": workers}
    whole, rest = Model(), Model()
    run = trainer(callbacks=[every], enable_checkpointing=True)
    data = module(root, **arguments)
    run.fit(whole, data.train_dataloader(), data.val_dataloader())
    loaders = data.train_dataloader(), data.val_dataloader()
    trainer().fit(rest, *loaders, ckpt_path=tmp_path / f"step={step}.ckpt")
    assert rest.seen == whole.seen[step:]
    assert _is_within_an_epoch(whole.seen, step)


@pytest.mark.parametrize(("workers", "split"), [(0, "train"), (0, "val"), (2, "train")])
def test_a_plain_loop_goes_on_where_it_stopped(root: str, workers: int, split: str) -> None:
    """From the state after each batch of two epochs; what workers prefetched is not lost."""
    arguments: dict[str, Any] = {"problems": "random", "augment": True, "num_workers": workers}

    def new_loader() -> Any:
        data = module(root, batch_size=4 if split == "val" else 16, **arguments)
        return data.train_dataloader() if split == "train" else data.val_dataloader()

    whole = []
    loader = new_loader()
    states = [loader.state_dict()]
    for _ in range(2):
        for batch in loader:
            whole.append(batch)
            states.append(loader.state_dict())
    assert pickle.loads(pickle.dumps(states)) == states
    assert len(whole) == 2 * len(loader) >= 4
    for done in range(len(whole)) if workers == 0 else (1,):
        state = states[done]
        resumed = new_loader()
        resumed.load_state_dict(state)
        assert resumed.state_dict() == state
        passes = 2 - done // len(loader)
        found = [batch for _ in range(passes) for batch in resumed]
        samples.assert_all_same(found, whole[done:])
        assert resumed.state_dict() == states[-1]


def test_a_pass_that_was_left_is_the_state_until_the_next_one_begins(root: str) -> None:
    """`break` loses nothing; the next pass of the same loader is the next epoch."""
    loader: Any = module(root).train_dataloader()
    for _ in zip(range(2), loader, strict=False):
        pass
    next(iter(loader))
    state = loader.state_dict()
    assert (state["epoch"], state["batches_done"]) == (1, 1)
    loader.sampler.set_epoch(7)
    state = loader.state_dict()
    assert (state["epoch"], state["batches_done"]) == (7, 0)


def test_a_state_of_another_order_is_told(root: str) -> None:
    """In the middle of an epoch; at its begin any order will do."""
    loader: Any = module(root).train_dataloader()
    at_the_begin = loader.state_dict()
    next(iter(loader))
    state = loader.state_dict()
    other: Any = module(root, batch_size=5, sampling_seed=3).train_dataloader()
    other.load_state_dict(at_the_begin)
    changes = "batch_size was 8 and is 5, sampling_seed was 0 and is 3"
    with pytest.warns(UserWarning, match=f"an epoch of another order .{changes}"):
        other.load_state_dict(state)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (None, "state: got 7, expected what state_dict"),
        ({"epoch": ...}, "state: got .*, expected what state_dict.* a mapping with epoch, batches"),
        ({"batches_done": -1}, "batches_done: got -1"),
        (
            {"batches_done": 10**9},
            "batches_done: got 1000000000, expected less than 11, the number",
        ),
        (
            {"batches_done": 11},
            "batches_done: got 11, expected less than 11, the number of batches",
        ),
        ({"batches_done": True}, "batches_done: got True"),
        ({"epoch": 1.5}, "epoch: got 1.5"),
        (
            {"problems": 80},
            "of other problems .problems was 80 and is 81.*from the end of an epoch",
        ),
    ],
)
def test_what_is_no_state_is_refused(root: str, changes: Any, message: str) -> None:
    """Such as an epoch of no batches; `...` stands for a key that is missing."""
    loader: Any = module(root).train_dataloader()
    next(iter(loader))
    state = loader.state_dict()
    changed = {**state, **(changes or {})}
    wrong = {key: value for key, value in changed.items() if value is not ...}
    with pytest.raises(ValueError, match=message):
        loader.load_state_dict(7 if changes is None else wrong)


def test_an_empty_state_is_refused(root: str) -> None:
    """It tells no position, and would silently begin at the first epoch."""
    loader: Any = module(root).train_dataloader()
    with pytest.raises(ValueError, match=r"state: got \{\}, expected what state_dict"):
        loader.load_state_dict({})


OTHER_PROBLEMS: dict[str, dict[str, Any]] = {
    "conditions": {"problems": Random(distance=(4, None))},
    "source": {"problems": "pairs"},
    "movement": {"movement": Movement(8)},
    "radius": {"radius": 0.01},
    "seed": {"sampling_seed": 4},
}


@pytest.mark.parametrize("changes", OTHER_PROBLEMS.values(), ids=OTHER_PROBLEMS)
def test_a_state_of_other_problems_is_refused(root: str, changes: dict[str, Any]) -> None:
    """Within an epoch, also of as many problems; from the begin of an epoch training may go on."""
    loader: Any = module(root, problems="random").train_dataloader()
    at_the_begin = loader.state_dict()
    next(iter(loader))
    arguments = {"problems": "random", **changes}
    other: Any = module(root, **arguments).train_dataloader()
    other.load_state_dict(at_the_begin)
    with pytest.raises(ValueError, match="one in the middle of an epoch of other problems"):
        other.load_state_dict(loader.state_dict())


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"movement": Movement(8)}, r"saved with 4-connected: [^;]*, here with 8-connected: [^;]*"),
        ({"radius": 0.01}, "saved without it, here with radius 0.01 m"),
        ({"problems": "pairs"}, r"problems was .*, saved with random; sampling_seed 0, here .*"),
    ],
    ids=["movement", "radius", "source"],
)
def test_the_error_of_other_problems_names_what_differs_alone(
    root: str, changes: dict[str, Any], text: str
) -> None:
    """What both have in common, such as the split and the maps, is left out."""
    loader: Any = module(root, problems="random").train_dataloader()
    next(iter(loader))
    other: Any = module(root, **{"problems": "random", **changes}).train_dataloader()
    with pytest.raises(ValueError, match=rf"of other problems \({text}\), expected") as error:
        other.load_state_dict(loader.state_dict())
    assert "split train" not in str(error.value)


def test_a_trainer_takes_other_problems_from_the_end_of_an_epoch(root: str, tmp_path: Path) -> None:
    """For instance harder ones; in the middle of an epoch they are refused."""
    every = ModelCheckpoint(tmp_path, "{step}", every_n_train_steps=3, save_top_k=-1)
    run = trainer(callbacks=[every], enable_checkpointing=True, max_epochs=1)
    run.fit(Model(), datamodule=module(root, problems="random"))
    run.save_checkpoint(tmp_path / "end.ckpt")
    harder = Random(distance=(4, None))
    resumed = Model()
    trainer().fit(
        resumed, datamodule=module(root, problems=harder), ckpt_path=tmp_path / "end.ckpt"
    )
    assert [one.epoch for one in resumed.seen] == [1] * len(resumed.seen)
    with pytest.raises(ValueError, match="in the middle of an epoch of other problems"):
        trainer().fit(
            Model(), datamodule=module(root, problems=harder), ckpt_path=tmp_path / "step=3.ckpt"
        )


def test_the_same_problems_of_another_folder_are_the_same(root: str, tmp_path: Path) -> None:
    """A training goes on where its dataset was copied."""
    shutil.copytree(root, tmp_path / "copy")
    loader: Any = module(root, problems="random").train_dataloader()
    next(iter(loader))
    copied: Any = module(str(tmp_path / "copy"), problems="random").train_dataloader()
    copied.load_state_dict(loader.state_dict())
    assert copied.state_dict() == loader.state_dict()


def test_a_state_of_an_earlier_version_is_taken(root: str) -> None:
    """Version 0.3.0 saved no text of the problems."""
    loader: Any = module(root).train_dataloader()
    next(iter(loader))
    state = loader.state_dict()
    other: Any = module(root).train_dataloader()
    other.load_state_dict({key: value for key, value in state.items() if key != "problems_text"})
    assert other.state_dict() == state


def test_an_epoch_that_is_shorter_in_another_order_begins_anew(root: str) -> None:
    """No pass is without batches."""
    loader: Any = module(root, batch_size=4).train_dataloader()
    for _ in zip(range(7), loader, strict=False):
        pass
    other: Any = module(root, batch_size=16).train_dataloader()
    with pytest.warns(UserWarning, match="batch_size was 4 and is 16"):
        other.load_state_dict(loader.state_dict())
    assert len(list(other)) == len(other) > 0


def test_a_trainer_that_overfits_saves_and_resumes(root: str, tmp_path: Path) -> None:
    """Its loader has a sampler of Lightning, whose position is not ours to know."""
    run = trainer(overfit_batches=2)
    run.fit(Model(), datamodule=module(root))
    run.save_checkpoint(tmp_path / "last.ckpt")
    resumed = Model()
    again = trainer(max_epochs=3)
    again.fit(resumed, datamodule=module(root), ckpt_path=tmp_path / "last.ckpt")
    assert {one.epoch for one in resumed.seen} == {2}


def _is_within_an_epoch(seen: list[Seen], done: int) -> bool:
    return seen[done - 1].epoch == seen[done].epoch


@pytest.mark.parametrize(
    "problems",
    [Route(unsolvable=True), slow(Pairs()), Random((3, None), (None, 2)), slow("random")],
)
def test_checkpoints_load_with_torchs_safe_default(
    root: str, tmp_path: Path, problems: str | Source
) -> None:
    """Model and data module come back from a checkpoint that holds nothing but plain values."""
    path = tmp_path / "last.ckpt"
    movement = Movement(8, corner_cutting=True, diagonal_cost=1)
    arguments: dict[str, Any] = {
        "augment": True,
        "sampling_seed": 7,
        "max_length": 99,
        "fields": (*FIELDS, "path"),
    }
    data = module(root, movement=movement, problems=problems, **arguments)
    run = trainer(max_epochs=1)
    run.fit(Model(size=3), datamodule=data)
    run.save_checkpoint(path)
    assert "state_dict" in torch.load(path, weights_only=True)
    again = MapDataModule.load_from_checkpoint(path)
    assert (again.roots, again.batch_size, again.serving) == (data.roots, 8, data.serving)
    assert again.serving.movement == movement
    assert isinstance(data.hparams["problems"], str)
    samples.assert_all_same(batches_of(again), batches_of(module(root, **vars(data.serving))))
    assert again.hparams == data.hparams
    assert MapDataModule.load_from_checkpoint(path, batch_size=5).batch_size == 5
    model = Model.load_from_checkpoint(path)
    assert model.size == 3


def test_checkpoints_hold_the_name_of_the_dtype_and_no_transform(root: str, tmp_path: Path) -> None:
    """They load with torch's safe default; a transform is given again, or is none."""
    path = tmp_path / "last.ckpt"
    data = module(root, dtype=torch.float64, transform=goal_as_start)
    told = Told()
    run = trainer(max_steps=1, logger=[told], limit_val_batches=0, log_every_n_steps=1)
    run.fit(Model(), datamodule=data)
    run.save_checkpoint(path)
    saved = torch.load(path, weights_only=True)["datamodule_hyper_parameters"]
    assert saved["dtype"] == "float64"
    assert "transform" not in saved
    assert (told.params["data"]["dtype"], told.params["data"]["transform"]) == (
        "float64",
        "goal_as_start",
    )
    again = MapDataModule.load_from_checkpoint(path)
    assert (again.dtype, again.transform) == (torch.float64, None)
    again = MapDataModule.load_from_checkpoint(path, transform=goal_as_start)
    samples.assert_all_same(list(again.val_dataloader()), list(data.val_dataloader()))


def test_a_configuration_becomes_plain_values(root: str) -> None:
    """Mappings and sequences of any class: the arguments and hparams are those of dicts and
    lists.
    """

    def configured(mapping: Any, sequence: Any, movement: Any) -> MapDataModule:
        return MapDataModule(
            root,
            build=mapping({"maps": 60, "spec": mapping({"map_size": sequence([20, 20])})}),
            fields=sequence(["map", "goal", "problem"]),
            problems=mapping({"random": mapping({"distance": sequence([3, None])})}),
            movement=movement,
        )

    expected = configured(dict, list, Movement(8, True, 1))
    named = UserDict({"connectivity": 8, "corner_cutting": True, "diagonal_cost": 1})
    for movement in (UserList([8, True, 1]), named):
        data = configured(UserDict, UserList, movement)
        assert data.serving == expected.serving
        assert data.hparams == expected.hparams
        assert type(data.hparams["build"]["spec"]) is dict
        assert type(data.hparams["build"]["spec"]["map_size"]) is list


def test_hydra_makes_a_module(root: str, tmp_path: Path) -> None:
    """Without `_convert_`, of plain values and of `_target_`; a checkpoint holds nothing of it."""
    instantiate = pytest.importorskip("hydra.utils").instantiate
    create = pytest.importorskip("omegaconf").OmegaConf.create
    common = {
        "_target_": "mapdata.MapDataModule",
        "root": [root, root],
        "batch_size": 8,
        "fields": list(FIELDS),
        "dtype": "float32",
    }
    source, movement = Random(distance=(3, None)), Movement(8)
    expected = MapDataModule(
        [root, root], fields=FIELDS, problems=source, movement=movement, dtype=torch.float32
    )
    for arguments in (
        {"problems": {"random": {"distance": [3, None]}}, "movement": {"connectivity": 8}},
        {
            "problems": {"_target_": "mapdata.Random", "distance": [3, None]},
            "movement": {"_target_": "mapdata.Movement", "connectivity": 8},
        },
    ):
        data = instantiate(create({**common, **arguments}))
        assert data.serving == expected.serving
        assert data.dtype == torch.float32
        run = trainer(max_steps=1, limit_val_batches=0)
        run.fit(Model(), datamodule=data)
        run.save_checkpoint(tmp_path / "hydra.ckpt")
        saved = torch.load(tmp_path / "hydra.ckpt", weights_only=True)
        assert all(plain(value) for value in saved["datamodule_hyper_parameters"].values())
    recipe = json.loads(RECIPE)
    online = instantiate(create({**common, "root": None, "build": recipe}))
    assert json.loads(json.dumps(online.hparams["build"])) == recipe
    assert type(online.hparams["build"]["spec"]["movement"]) is dict


def test_hydra_makes_a_dataset(root: str) -> None:
    """Without `_convert_`; it takes its movement as an object, and keeps nothing of Hydra."""
    instantiate = pytest.importorskip("hydra.utils").instantiate
    create = pytest.importorskip("omegaconf").OmegaConf.create
    configuration = {
        "_target_": "mapdata.MapDataset",
        "root": root,
        "split": "val",
        "fields": list(FIELDS),
        "dtype": "float32",
        "movement": {"_target_": "mapdata.Movement", "connectivity": 8},
    }
    source, movement = Random(distance=(3, None)), Movement(8)
    expected = MapDataset(
        root, "val", FIELDS, problems=source, movement=movement, dtype=torch.float32
    )
    for problems in (
        {"random": {"distance": [3, None]}},
        {"_target_": "mapdata.Random", "distance": [3, None]},
    ):
        dataset = instantiate(create({**configuration, "problems": problems}))
        assert dataset.serving == expected.serving
        assert b"omegaconf" not in pickle.dumps(dataset)


class Told(Logger):
    """A logger that keeps what it is told, as W&B and MLflow do."""

    name, version = "told", 0

    def __init__(self) -> None:
        """Nothing yet."""
        super().__init__()
        self.params: dict[str, Any] = {}

    def log_hyperparams(self, params: Any, *_: Any, **__: Any) -> None:
        """Keep them."""
        self.params.update(params)

    def log_metrics(self, metrics: Any, step: int | None = None) -> None:
        """Leave them."""


def plain(value: object) -> bool:
    """Return whether a value is text, a number, None, or a tuple of these."""
    if isinstance(value, tuple):
        return all(plain(each) for each in value)
    return value is None or type(value) in (str, int, float, bool)


def test_numpys_numbers_become_plain_ones(root: str) -> None:
    """Among the arguments: checkpoints and loggers take no others."""
    data = MapDataModule(
        root,
        batch_size=np.int64(8),  # type: ignore[arg-type]
        max_length=np.int64(128),  # type: ignore[arg-type]
        sampling_seed=np.int64(3),  # type: ignore[arg-type]
        radius=np.float32(0.05),  # type: ignore[arg-type]
    )
    for name in ("batch_size", "max_length", "sampling_seed", "radius"):
        assert type(data.hparams[name]) in (int, float), name


@pytest.mark.parametrize("kind", ["disk", "roots", "online", "imported"])
def test_logs_and_checkpoints_say_what_was_trained_on(root: str, tmp_path: Path, kind: str) -> None:
    """Recipe, identity, content hash and all arguments, in plain values; the recipe builds it."""
    manifest = read_manifest(Path(root))
    folder: Any = {"roots": [root, root], "online": None}.get(kind, root)
    recipe: str | None = manifest.recipe()
    identity, content = manifest.identity, manifest.content_hash
    if kind == "imported":
        folder = str(tmp_path / "imported")
        import_maps(folder, Collection([ForeignMap("eye", np.eye(20, dtype=np.uint8))] * 40))
        recipe, identity = None, None
        content = read_manifest(Path(folder)).content_hash
    data = module(folder, build=RECIPE if kind == "online" else None, fields=(*FIELDS, own_field))
    told, csv = Told(), CSVLogger(tmp_path / "logs")
    run = trainer(max_steps=1, logger=[told, csv], log_every_n_steps=1)
    run.fit(Model(size=2), datamodule=data)
    path = tmp_path / "last.ckpt"
    run.save_checkpoint(path)
    saved = torch.load(path, weights_only=True)["datamodule_hyper_parameters"]
    assert all(plain(value) for value in saved.values())
    logged = told.params["data"]
    assert logged == {
        **{name: list(value) if type(value) is tuple else value for name, value in saved.items()},
        "movement": [4, False, Movement().diagonal_cost],
        "fields": [*FIELDS, "own_field"],
    }
    assert logged["batch_size"] == 8
    assert told.params["size"] == 2  # the model's own
    written = yaml.safe_load(Path(csv.log_dir, "hparams.yaml").read_text())
    assert written["data"] == logged
    if kind == "online":
        assert as_recipe(logged["build"]) == as_recipe(RECIPE)
        found = (logged["recipe"], logged["identity"], logged["content_hash"])
        assert found == (None, identity, None)
        return
    found = (logged["recipe"], logged["identity"], logged["content_hash"])
    if kind == "roots":
        assert logged["root"] == [root, root]
        assert found == ([recipe, recipe], [identity, identity], [content, content])
    else:
        assert found == (recipe, identity, content)
    assert MapDataModule.load_from_checkpoint(path, fields=FIELDS).roots == data.roots


def test_tensorboard_shows_what_was_trained_on(root: str, tmp_path: Path) -> None:
    """Its hparams.yaml, which was empty, has the data module's arguments."""
    pytest.importorskip("tensorboard")
    logger = TensorBoardLogger(tmp_path)
    data = module(root)
    trainer(max_steps=1, logger=logger, log_every_n_steps=1).fit(Model(), datamodule=data)
    written = yaml.full_load(Path(logger.log_dir, "hparams.yaml").read_text())
    assert written["data"]["identity"] == read_manifest(Path(root)).identity


def own_field(sample: Sample) -> torch.Tensor:
    """Return a field of one's own."""
    goal: torch.Tensor = sample.goal
    return goal.sum(dim=1)


def test_functions_among_the_fields_are_not_kept_in_checkpoints(root: str, tmp_path: Path) -> None:
    """They are code; the restored module takes them again."""
    path = tmp_path / "last.ckpt"
    run = trainer(max_epochs=1)
    run.fit(Model(), datamodule=module(root, fields=(*FIELDS, own_field)))
    run.save_checkpoint(path)
    again = MapDataModule.load_from_checkpoint(path, fields=(*FIELDS, own_field))
    assert next(iter(again.val_dataloader())).own_field.shape == (8,)


def test_the_text_of_a_module_and_a_dataset_names_what_they_serve(root: str) -> None:
    """Also before the set-up: which problems, by which moves, and for which radius."""
    data = module(root, problems="random", movement=Movement(8), radius=0.1)
    data.setup("fit")
    for text in (
        repr(module(root, problems="random", movement=Movement(8), radius=0.1)),
        repr(data),
    ):
        assert "problems=Random(" in text
        assert "movement=Movement(connectivity=8" in text
        assert "radius=0.1" in text
    assert "movement=Movement(connectivity=8" in repr(data.datasets["train"])
    assert "movement" not in repr(module(root))


# --- several processes --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def two_ranks(root: str, tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """What each of two processes saw (tests/helpers/ranks.py)."""
    out = tmp_path_factory.mktemp("ranks")
    result = run_helper(
        "ranks", root, str(out), "2", OMP_NUM_THREADS="1", PL_TORCH_DISTRIBUTED_BACKEND="gloo"
    )
    assert result.returncode == 0, result.stderr[-3000:]
    return [json.loads((out / f"rank{rank}.json").read_text()) for rank in range(2)]


@pytest.mark.slow
def test_ranks_share_the_training_split(root: str, two_ranks: list[dict[str, Any]]) -> None:
    """Disjoint, equally many, at most one left out of an epoch; each epoch in an order of its
    own.
    """
    total = len(MapDataset(root, "train"))
    for epoch in (0, 1):
        shares = [
            [k for number, problems in one["seen"] if number == epoch for k in problems]
            for one in two_ranks
        ]
        assert [len(share) for share in shares] == [total // 2, total // 2]
        assert not set(shares[0]) & set(shares[1])
        assert len({*shares[0], *shares[1]}) == total - total % 2
    assert two_ranks[0]["seen"][0][1] != two_ranks[0]["seen"][len(two_ranks[0]["seen"]) // 2][1]


@pytest.mark.slow
def test_ranks_see_every_other_sample_once(root: str, two_ranks: list[dict[str, Any]]) -> None:
    """Validation, test and prediction: each sample on exactly one rank."""
    for stage, split in (("val", "val"), ("test", "test"), ("predict", "test")):
        seen = sorted(k for one in two_ranks for k in one["others"][stage])
        assert seen == list(range(len(MapDataset(root, split))))


@pytest.mark.slow
def test_metrics_of_ranks_are_those_of_one_process(
    root: str, tmp_path: Path, two_ranks: list[dict[str, Any]]
) -> None:
    """A metric of torchmetrics has one value, whatever the number of processes."""
    ranks.main(root, tmp_path, 1)
    alone = json.loads((tmp_path / "rank0.json").read_text())
    assert len(alone["means"]) == 4  # two epochs, validate, test
    for one in two_ranks:
        assert one["means"] == pytest.approx(alone["means"], rel=1e-6)


@pytest.mark.slow
def test_a_logged_metric_is_the_mean_over_the_samples_of_all_ranks(
    root: str, two_ranks: list[dict[str, Any]]
) -> None:
    """As docs/distributed.md logs it; so is the quotient of sum and count. The ranks hold unequal
    numbers of samples.
    """
    count = len(MapDataset(root, "val"))
    assert count % 2 == 1
    for one in two_ranks:
        logged = one["logged"]
        assert logged["metric"] == np.arange(count).mean()
        assert logged["sum"] / logged["count"] == np.arange(count).mean()


@pytest.mark.slow
def test_a_mean_that_lightning_takes_over_ranks_may_lie_above_all_samples(
    root: str, two_ranks: list[dict[str, Any]]
) -> None:
    """As docs/distributed.md says: it rounds the mean number of samples of a rank down.

    If this fails, Lightning does not round any more. Then correct the page.
    """
    count = len(MapDataset(root, "val"))
    for one in two_ranks:
        assert one["logged"]["mean_of_ones"] == pytest.approx(count / (2 * (count // 2)))
        assert one["logged"]["mean_of_ones"] > 1


@pytest.mark.slow
def test_ranks_resume_in_mid_epoch(two_ranks: list[dict[str, Any]]) -> None:
    """Each rank goes on with its own unseen samples."""
    for one in two_ranks:
        assert one["resumed"] == one["seen"][ranks.MIDDLE :]
        assert one["seen"][ranks.MIDDLE - 1][0] == one["seen"][ranks.MIDDLE][0]  # within an epoch


# --- building and online ------------------------------------------------------------------------


def test_a_missing_dataset_is_built(tmp_path: Path, root: str) -> None:
    """By JSON text or a recipe file; what is there is used, what is incomplete is finished, nothing
    is made twice.
    """
    recipe = tmp_path / "recipe.json"
    recipe.write_text(RECIPE)
    for name, build in (("text", RECIPE), ("file", str(recipe))):
        folder = tmp_path / name
        data = module(str(folder), build=build)
        assert not folder.exists()
        samples.assert_all_same(batches_of(data), batches_of(module(root)))
        assert verify(folder) == []
        before = {path: path.stat().st_mtime_ns for path in folder.glob("*.h5")}
        samples.assert_all_same(
            batches_of(module(str(folder), build=build)), batches_of(module(root))
        )
        assert {path: path.stat().st_mtime_ns for path in folder.glob("*.h5")} == before
    model = Model()
    trainer(max_epochs=1).fit(model, datamodule=module(str(tmp_path / "fitted"), build=RECIPE))
    assert len(model.seen) == len(module(root).train_dataloader())
    assert read_manifest(Path(root)).content_hash == read_manifest(tmp_path / "fitted").content_hash


def test_a_recipe_that_promises_another_content_is_told(tmp_path: Path, root: str) -> None:
    """Its hash is compared with what was built, as the command does; another number changes it."""
    recipe = json.loads(read_manifest(Path(root)).recipe())
    data = module(str(tmp_path / "same"), build=json.dumps(recipe))
    samples.assert_all_same(batches_of(data), batches_of(module(root)))
    other = module(str(tmp_path / "other"), build=json.dumps(recipe | {"maps": 59}))
    with pytest.raises(ValueError, match=r"content hash .*, the recipe says"):
        batches_of(other)


def test_a_preset_is_built_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`build="paper"` makes the paper's 10,000 maps (here fewer)."""
    monkeypatch.setattr(builder, "as_recipe", lambda name, **_: as_recipe(name, maps=30))
    data = MapDataModule(str(tmp_path / "maps"), build="paper", batch_size=4)
    assert next(iter(data.test_dataloader())).map.shape[1:] == (1, 64, 64)
    assert read_manifest(tmp_path / "maps").generator == MapSpec()


def test_without_a_dataset_and_without_build(tmp_path: Path) -> None:
    """The error says where it was looked for."""
    with pytest.raises(DatasetNotFoundError, match=r"no dataset at .*nowhere"):
        MapDataModule(str(tmp_path / "nowhere")).train_dataloader()


def test_online_without_any_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`root=None`: as many maps as the recipe says in all splits, the same in each process, nothing
    written.
    """
    monkeypatch.chdir(tmp_path)
    data = module(None, build=RECIPE, problems="random")
    seen = torch.cat([batch.problem for batch in data.train_dataloader()])
    assert sorted(seen.tolist()) == list(range(36))
    assert len(torch.cat([batch.problem for batch in data.val_dataloader()])) == 12
    model = Model()
    trainer().fit(model, datamodule=module(None, build=RECIPE, num_workers=2, problems="random"))
    assert sorted(k for one in model.seen if one.epoch == 1 for k in one.problems) == list(
        range(36)
    )
    assert list(tmp_path.iterdir()) == []


REFUSED: dict[str, tuple[Callable[[], MapDataModule], str]] = {
    "root": (lambda: MapDataModule(None), "root: got None, expected a dataset"),
    "build-roots": (
        lambda: MapDataModule(["a", "b"], build="paper"),
        "build: makes one dataset in one folder",
    ),
    "build-url": (
        lambda: MapDataModule("https://x/y", build="paper"),
        "build: makes one dataset in one folder",
    ),
    "batch_size": (
        lambda: MapDataModule("a", batch_size=0),
        "batch_size: got 0, expected an integer of at least 1",
    ),
    "movement": (lambda: MapDataModule("a", movement=(6, False, 1.0)), "connectivity: got 6"),
    "movement as a number": (
        lambda: MapDataModule("a", movement=8),  # type: ignore[arg-type]
        r"movement: got 8, expected a Movement, or a mapping such as \{connectivity: 8\}",
    ),
    "movement-name": (
        lambda: MapDataModule("a", movement={"conectivity": 8}),
        "movement: unknown key: conectivity; .* did you mean connectivity",
    ),
    "dtype": (
        lambda: MapDataModule("a", dtype="flaot32"),
        "dtype: got 'flaot32', expected one of torch",
    ),
    "dtype-fields": (
        lambda: MapDataModule("a", fields=("start", "goal"), dtype=torch.float32),
        "dtype: .* expected one of map, free, .* among the fields",
    ),
    "transform": (
        lambda: MapDataModule("a", transform=3),  # type: ignore[arg-type]
        "transform: got 3, expected a function",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_arguments_name_themselves(case: str) -> None:
    """When the module is made, not when the first batch is."""
    make, says = REFUSED[case]
    with pytest.raises(ValueError, match=says):
        make()


# --- LightningCLI -------------------------------------------------------------------------------

QUIET = [
    "--trainer.accelerator=cpu",
    "--trainer.logger=false",
    "--trainer.enable_progress_bar=false",
    "--trainer.enable_model_summary=false",
    "--trainer.enable_checkpointing=false",
    "--trainer.max_epochs=1",
]


@pytest.fixture(autouse=True)
def _quiet_command_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        sys, "argv", ["train.py"]
    )  # LightningCLI warns when it is given others beside them
    monkeypatch.setenv(
        "JSONARGPARSE_DEPRECATION_WARNINGS", "off"
    )  # of Lightning's calls, not of ours


def run_cli(arguments: list[str]) -> LightningCLI:
    """Run what a script of two lines runs."""
    return LightningCLI(
        Model, MapDataModule, args=arguments, save_config_callback=None, seed_everything_default=0
    )


def test_cli_with_flags(root: str) -> None:
    """Every argument is a flag, the movement too."""
    flags = [
        f"--data.root={root}",
        "--data.batch_size=8",
        "--data.fields=[map,start,goal,problem]",
        "--data.movement=[8,true,1]",
        "--data.problems=random",
        "--data.problems.distance=[3,null]",
        "--data.augment=true",
    ]
    cli = run_cli(["fit", *QUIET, *flags])
    assert isinstance(cli.datamodule, MapDataModule)
    assert cli.datamodule.serving.movement == Movement(8, True, 1)
    assert cli.datamodule.serving.problems == Random(distance=(3, None))
    assert isinstance(cli.model, Model)
    expected = module(
        root, movement=Movement(8, True, 1), problems=Random(distance=(3, None)), augment=True
    )
    assert [list(one.problems) for one in cli.model.seen] == [
        b.problem.tolist() for b in batches_of(expected)
    ]
    named = [flag for flag in flags if "movement" not in flag]
    cli = run_cli(["fit", *QUIET, *named, "--data.movement.connectivity=8"])
    assert cli.datamodule.serving.movement == Movement(8)


@pytest.mark.slow
def test_cli_with_yaml(root: str, tmp_path: Path) -> None:
    """A file holds the same; flags win over it."""
    config = tmp_path / "config.yaml"
    config.write_text(
        f"data:\n  root: {root}\n  batch_size: 8\n  fields: [map, start, goal, problem]\n"
        "  movement: {connectivity: 8, corner_cutting: true, diagonal_cost: 1.0}\n  search: bfs\n"
        "  problems: {random: {distance: [3, null], length: [null, 30]}}\n"
    )
    cli = run_cli(["fit", *QUIET, f"--config={config}", "--data.batch_size=5"])
    assert isinstance(cli.datamodule, MapDataModule)
    assert cli.datamodule.batch_size == 5
    assert cli.datamodule.serving.movement == Movement(8, True, 1)
    assert cli.datamodule.serving.search == "bfs"
    assert cli.datamodule.serving.problems == Random(distance=(3, None), length=(None, 30))
    run_cli(["validate", *QUIET[:4], f"--config={config}"])


def test_cli_takes_a_dtype_and_a_transform(
    root: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The type by its name, the function by its import path."""
    (tmp_path / "own_transforms.py").write_text("def swap(sample):\n    return sample[::-1]\n")
    monkeypatch.syspath_prepend(tmp_path)
    flags = [f"--data.root={root}", "--data.batch_size=8", "--data.fields=[map,start,problem]"]
    flags += ["--data.dtype=float64", "--data.transform=own_transforms.swap"]
    cli = LightningCLI(
        Model, MapDataModule, args=[*QUIET, *flags], run=False, seed_everything_default=0
    )
    problem, _, map_ = next(iter(cli.datamodule.train_dataloader()))
    assert (problem.dtype, map_.dtype) == (torch.int64, torch.float64)


@pytest.mark.slow
def test_cli_takes_several_roots(root: str, tmp_path: Path) -> None:
    """As a list, of a flag or a file; null stands for none of them, and not for a name."""
    config = tmp_path / "config.yaml"
    config.write_text(f"data:\n  root: [{root}, {root}]\n")
    short = ["--trainer.max_steps=1", "--data.fields=[map,start,goal,problem]"]
    for flag in (f"--data.root=[{root},{root}]", f"--config={config}"):
        cli = run_cli(["fit", *QUIET, *short, flag])
        assert isinstance(cli.datamodule, MapDataModule)
        assert cli.datamodule.roots == (root, root)
    online = ["--data.root=null", '--data.build={"maps": 100}', "--trainer.limit_val_batches=0"]
    cli = run_cli(["fit", *QUIET, *short, *online])
    assert isinstance(cli.datamodule, MapDataModule)
    assert cli.datamodule.roots == ()


@pytest.mark.slow
def test_cli_checkpoints_come_back(root: str, tmp_path: Path) -> None:
    """A checkpoint of a run by flags loads like any other."""
    flags = [f"--data.root={root}", "--data.batch_size=8", "--data.fields=[map,start,goal,problem]"]
    cli = run_cli(["fit", *QUIET, *flags])
    cli.trainer.save_checkpoint(tmp_path / "cli.ckpt")
    again = MapDataModule.load_from_checkpoint(tmp_path / "cli.ckpt")
    assert (again.roots, again.batch_size, again.serving.fields) == ((root,), 8, FIELDS)


def test_one_class_serves_both_packages(root: str) -> None:
    """`lightning.pytorch` and `pytorch_lightning` each accept only their own class; ours is both
    where both are.
    """
    assert issubclass(MapDataModule, pl.LightningDataModule)
    if find_spec("lightning") is None:
        pytest.skip("package 'lightning' is not installed")
    other: Any = import_module("lightning.pytorch")

    def training_step(model: Any, batch: Sample, _: int) -> torch.Tensor:
        model.seen += batch.problem.tolist()
        loss: torch.Tensor = model.layer(torch.zeros(1, 2)).sum()
        return loss

    def configure_optimizers(model: Any) -> torch.optim.Optimizer:
        return torch.optim.SGD(model.parameters(), 1e-9)

    methods = {
        "training_step": training_step,
        "validation_step": lambda *_: None,
        "configure_optimizers": configure_optimizers,
    }
    model = type("OtherModel", (other.LightningModule,), methods)()
    model.layer, model.seen = torch.nn.Linear(2, 1), []
    run = other.Trainer(
        accelerator="cpu",
        logger=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        enable_checkpointing=False,
        max_epochs=1,
        limit_val_batches=0,
    )
    run.fit(model, datamodule=module(root))
    assert sorted(model.seen) == list(range(len(MapDataset(root, "train"))))


@pytest.mark.parametrize(("drop_last", "batch_count"), [(True, 2), (False, 3)])
def test_a_pass_whose_batches_are_all_done_starts_again(drop_last: bool, batch_count: int) -> None:
    """Of 20 samples 2 or 3 batches of 8 are an epoch: a Trainer at its end is at the next start."""
    dataset: Any = TensorDataset(torch.zeros(20))
    progress = SimpleNamespace(current=SimpleNamespace(ready=0))
    loop = SimpleNamespace(epoch_loop=SimpleNamespace(batch_progress=progress))
    run = SimpleNamespace(
        training=True, current_epoch=0, global_rank=0, world_size=1, fit_loop=loop
    )
    sampler = EpochSampler(dataset, 8, 3, SimpleNamespace(trainer=run), drop_last=drop_last)  # type: ignore[arg-type]
    order = list(sampler)
    for batches_done in range(batch_count + 1):
        progress.current.ready = batches_done
        expected = order if batches_done == batch_count else order[8 * batches_done :]
        assert list(sampler) == expected


# --- options of torch's DataLoader --------------------------------------------------------------


def test_drop_last_leaves_out_training_samples_alone(root: str) -> None:
    """All training batches are full; validation, test and prediction serve every sample."""
    data = module(root, drop_last=True)
    count = len(MapDataset(root, "train"))
    assert count % 8, "a last batch that is not full"
    sizes = [len(batch.map) for batch in batches_of(data)]
    assert sizes == [8] * (count // 8)
    assert len(data.train_dataloader()) == count // 8
    assert [len(batch.map) for batch in batches_of(module(root))] == [*sizes, count % 8]
    for loader, split in (
        (data.val_dataloader(), "val"),
        (data.test_dataloader(), "test"),
        (data.predict_dataloader(), "test"),
    ):
        assert sum(len(batch.map) for batch in loader) == len(MapDataset(root, split))


def test_drop_last_that_leaves_no_batch_is_refused(root: str) -> None:
    """A training without a single batch would pass for one that is done."""
    count = len(MapDataset(root, "train"))
    message = f"drop_last: {count} training samples do not fill a batch of {count + 1}; take a"
    with pytest.raises(ValueError, match=message):
        module(root, batch_size=count + 1, drop_last=True).train_dataloader()
    assert len(module(root, batch_size=count, drop_last=True).train_dataloader()) == 1


def seed_worker(_: int) -> None:
    """Stand for what users do when a worker starts."""


def test_loader_options_reach_every_loader(root: str, tmp_path: Path) -> None:
    """Checkpoints hold those of them that are plain values."""
    options = {"timeout": 30, "worker_init_fn": seed_worker}
    data = module(root, num_workers=1, loader_options=options)
    for loader in (data.train_dataloader(), data.val_dataloader(), data.predict_dataloader()):
        assert (loader.timeout, loader.worker_init_fn) == (30, seed_worker)
        assert (loader.num_workers, loader.batch_size) == (1, 8)
    assert data.hparams["loader_options"] == {"timeout": 30}
    run = trainer(max_steps=1, limit_val_batches=0)
    run.fit(Model(), datamodule=module(root, loader_options={"worker_init_fn": seed_worker}))
    run.save_checkpoint(tmp_path / "last.ckpt")
    assert MapDataModule.load_from_checkpoint(tmp_path / "last.ckpt").loader_options == {
        "num_workers": 0,
        "pin_memory": False,
        "persistent_workers": False,
        "prefetch_factor": None,
        "multiprocessing_context": None,
    }


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"time_out": 3}, "loader_options: got 'time_out', .*did you mean timeout?"),
        ({"sampler": []}, "loader_options: got 'sampler', but the data module sets it"),
        ({"batch_sampler": []}, "loader_options: got 'batch_sampler', but the data module sets it"),
        ({"shuffle": False}, "loader_options: got 'shuffle', but the data module sets it"),
        ({"collate_fn": list}, "loader_options: got 'collate_fn', but .* transform="),
        ({"dataset": []}, "loader_options: got 'dataset', but the data module opens"),
        ({"num_workers": 2}, "loader_options: got 'num_workers', but it is an argument"),
        ({"drop_last": True}, "loader_options: got 'drop_last', but it is an argument"),
        (["timeout"], r"loader_options: got \['timeout'\], expected options by name"),
    ],
)
def test_loader_options_that_do_not_fit_are_refused(root: str, options: Any, message: str) -> None:
    """In one line, before anything is opened."""
    with pytest.raises(ValueError, match=message) as error:
        module(root, loader_options=options)
    assert "\n" not in str(error.value)


def test_every_option_of_torchs_loader_is_accepted_or_refused_by_name(root: str) -> None:
    """None is both, and the arguments of the data module are those that the refusal names."""
    names = set(signature(DataLoader).parameters)
    assert set(OWN_LOADER_OPTIONS) <= names
    arguments = set(signature(MapDataModule).parameters)
    for name, reason in OWN_LOADER_OPTIONS.items():
        assert (name in arguments) == ("argument" in reason), name
    for name in names - set(OWN_LOADER_OPTIONS):
        assert module(root, loader_options={name: None}).loader_options[name] is None


def test_hydra_gives_loader_options(root: str) -> None:
    """As a part of its configuration, which becomes a plain dict."""
    instantiate = pytest.importorskip("hydra.utils").instantiate
    create = pytest.importorskip("omegaconf").OmegaConf.create
    arguments = {"root": root, "drop_last": True, "loader_options": {"timeout": 5}}
    data = instantiate(create({"_target_": "mapdata.MapDataModule", **arguments}))
    assert data.drop_last is True
    assert data.val_dataloader().timeout == 5
    assert type(data.hparams["loader_options"]) is dict


def test_cli_takes_options_of_the_loader(root: str, tmp_path: Path) -> None:
    """As flags and in a file."""
    config = tmp_path / "config.yaml"
    config.write_text(
        f"data:\n  root: {root}\n  drop_last: true\n  loader_options: {{timeout: 5}}\n"
    )
    flags = [f"--data.root={root}", "--data.drop_last=true", "--data.loader_options={timeout: 5}"]
    for arguments in (flags, [f"--config={config}"]):
        cli = LightningCLI(
            Model, MapDataModule, args=[*QUIET, *arguments], run=False, seed_everything_default=0
        )
        assert cli.datamodule.drop_last is True
        assert cli.datamodule.loader_options["timeout"] == 5


# --- pictures -----------------------------------------------------------------------------------


@pytest.mark.parametrize("split", ["train", "val"])
def test_plot_draws_samples_of_a_split_at_equal_steps(root: str, split: str) -> None:
    """Maps, starts, goals and paths where they are, whichever fields are served."""
    axes = module(root, fields=("goal",)).plot(split=split)
    dataset = MapDataset(root, split)
    expected = dataset[[k * len(dataset) // 9 for k in range(9)]]
    panels = [panel for panel in figure_of(axes).axes if panel.axison]
    assert axes is panels[0]
    assert len(panels) == len(expected.map) == 9
    for k, panel in enumerate(panels):
        (image,) = panel.get_images()
        np.testing.assert_array_equal(np.asarray(image.get_array()), expected.map[k, 0])
        path = samples.cells_of(expected.path[k])
        assert_lines(drawn(panel, COLOURS["astar"]), [np.array(path)])
        letters = {text.get_text(): text.get_position()[::-1] for text in panel.texts}
        assert letters == {"S": path[0], "G": path[-1]}


def test_plot_draws_a_batch(root: str) -> None:
    """The samples of the batch, in its order."""
    data = module(root, fields=("map", "start", "goal"), batch_size=4)
    batch = next(iter(data.train_dataloader()))
    panels = figure_of(data.plot(batch)).axes
    for k, panel in enumerate(panels):
        (image,) = panel.get_images()
        np.testing.assert_array_equal(np.asarray(image.get_array()), batch.map[k, 0])
        starts = [text.get_position()[::-1] for text in panel.texts if text.get_text() == "S"]
        assert starts == [tuple(batch.start[k].tolist())]
    assert len(panels) == 4
    with pytest.raises(ValueError, match=r"split: got 'tran'.*did you mean train\?"):
        data.plot(split="tran")


def test_a_loader_without_samples_is_warned_of(tmp_path: Path) -> None:
    """One map is in the split train; Lightning would validate nothing, and say little."""
    builder.build(tmp_path / "maps", MapSpec(), maps=1, seed=1, workers=1)
    data = MapDataModule(tmp_path / "maps")
    assert len(data.train_dataloader()) > 0
    for split in ("val", "test"):
        with pytest.warns(
            UserWarning, match=f"{split}: no map of the dataset gives a prob"
        ) as said:
            assert len(getattr(data, f"{split}_dataloader")()) == 0
        assert said[0].filename == __file__
