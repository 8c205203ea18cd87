"""The warning of a plain loader whose passes repeat the draws of the first one."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import torch
from helpers import samples
from torch.utils.data import DataLoader, Sampler

from mapdata import (
    MapDataset,
    MapSpec,
    Movement,
    OnlineMapDataset,
    ProblemSet,
    ProblemSetDataset,
    Tiles,
)
from mapdata.datasets import EpochSampler

FIELDS = ("map", "start", "problem")
DATASETS: dict[str, tuple[Callable[[str], Any], str]] = {
    "random": (lambda root: MapDataset(root, "train", FIELDS, problems="random"), "problems"),
    "augment": (lambda root: MapDataset(root, "train", FIELDS, augment=True), "symmetries"),
    "online": (lambda root: OnlineMapDataset(samples.SPEC, 5, 12, "train", FIELDS), "problems"),
    "set": (
        lambda root: ProblemSetDataset(
            ProblemSet.sample(MapSpec(), seed=3, maps=12, movement=Movement(8)),
            FIELDS,
            augment=True,
        ),
        "symmetries",
    ),
    "jitter": (
        lambda root: MapDataset(root, "train", ("map", "start", "problem", Tiles(4, jitter=True))),
        "light",
    ),
}
"""Datasets that draw anew in each epoch, and what they draw."""


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A small dataset."""
    return samples.build_small(tmp_path_factory.mktemp("repeats") / "maps")


def passes(loader: Any, count: int) -> list[torch.Tensor]:
    """Return the maps (or images) and starts of each pass, in the order of the problems."""
    found = []
    for _ in range(count):
        batches = list(loader)
        order = torch.cat([batch.problem for batch in batches]).argsort()
        pictures = [getattr(batch, "image", batch.map) for batch in batches]
        maps = torch.cat([picture.flatten(1) for picture in pictures])
        starts = torch.cat([batch.start for batch in batches])
        found.append(torch.cat([maps, starts], dim=1)[order])
    return found


@pytest.mark.parametrize("kind", DATASETS)
def test_a_second_shuffled_pass_warns_once(root: str, kind: str) -> None:
    """It does serve the same samples, and says what of them should be drawn anew."""
    dataset_of, drawn = DATASETS[kind]
    dataset = dataset_of(root)
    assert repr(dataset).endswith(f"{drawn} of epoch 0 unless a sampler gives the epoch")
    loader = DataLoader(dataset, 3, shuffle=True, generator=torch.Generator().manual_seed(1))
    first = passes(loader, 1)[0]
    with pytest.warns(UserWarning, match=f"serves the same {drawn} as the first.*EpochSampler"):
        second = passes(loader, 1)[0]
    assert torch.equal(first, second)
    passes(loader, 2)  # and no more


@pytest.mark.parametrize("kind", DATASETS)
def test_epochs_of_a_sampler_do_not_warn(root: str, kind: str) -> None:
    """Neither does a second training that begins at epoch 0 again; and its epochs differ."""
    dataset = DATASETS[kind][0](root)
    for _ in range(2):
        sampler = EpochSampler(dataset, 3, sampling_seed=0)
        found = passes(DataLoader(dataset, 3, sampler=sampler), 3)
        assert not torch.equal(found[0], found[1])


class Numbers(Sampler[int]):
    """A sampler of a user, which gives epochs as `EpochSampler` does."""

    def __init__(self, length: int) -> None:
        """Keep the length."""
        self.length = length
        self.epoch = 0

    def __iter__(self) -> Iterator[int]:
        """Count on from pass to pass, in descending order."""
        first = self.epoch * self.length
        yield from range(first + self.length - 1, first - 1, -1)
        self.epoch += 1

    def __len__(self) -> int:
        """Return the number of samples of a pass."""
        return self.length


QUIET: dict[str, Callable[[Any], Any]] = {
    "validation": lambda dataset: [DataLoader(dataset, 5)] * 4,
    "validation-alone": lambda dataset: [DataLoader(dataset, 1)] * 4,
    "validation-left": lambda dataset: [
        DataLoader(dataset, 5),
        zip(range(3), DataLoader(dataset, 5), strict=False),
        DataLoader(dataset, 5),
    ],
    "own-sampler": lambda dataset: [
        DataLoader(dataset, 5, sampler=numbers) for numbers in [Numbers(len(dataset))] * 3
    ],
    "indexing": lambda dataset: [
        DataLoader(dataset, 5),
        *([dataset[k] for k in (5, 3, 9)] for _ in range(3)),
        *(dataset[[7, 2, 4]] for _ in range(3)),
    ],
}
"""What is read of a dataset without a second shuffled pass over all of it."""


@pytest.mark.parametrize("name", QUIET)
def test_other_reading_does_not_warn(root: str, name: str) -> None:
    """Ascending order is a validation, which should repeat its problems."""
    dataset = MapDataset(root, None, FIELDS, problems="random")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for batches in QUIET[name](dataset):
            assert list(batches)


def test_problems_that_are_stored_do_not_warn(root: str) -> None:
    """They are the same in each epoch, and no one was promised others; so says `repr`."""
    stored = MapDataset(root, "train", FIELDS)
    one_a_map = OnlineMapDataset("tiles", 5, 12, "train", FIELDS)  # from corner to corner
    for dataset in (stored, one_a_map):
        passes(DataLoader(dataset, 3, shuffle=True), 3)
        assert "epoch" not in repr(dataset)


def test_a_view_is_watched_by_itself(root: str) -> None:
    """It has other numbers than the dataset that it was made from."""
    dataset = MapDataset(root, "train", FIELDS, augment=True)
    passes(DataLoader(dataset, 3), 1)
    view = dataset.filter(rooms=(2, 3))
    assert 6 < len(view) < len(dataset)
    passes(DataLoader(view, 3, shuffle=True), 1)
    passes(DataLoader(copy.copy(dataset), 3, shuffle=True), 1)
    with pytest.warns(UserWarning, match="the same symmetries"):
        passes(DataLoader(view, 3, sampler=range(len(view) - 1, -1, -1)), 1)


def test_workers_are_not_watched(root: str) -> None:
    """Each of them reads a part of a pass, and knows of no other one."""
    dataset = MapDataset(root, "train", FIELDS, problems="random")
    passes(DataLoader(dataset, 3), 1)
    loader = DataLoader(dataset, 3, shuffle=True, num_workers=1, persistent_workers=True)
    passes(loader, 2)
