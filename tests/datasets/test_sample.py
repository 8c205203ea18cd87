"""Samples become batches under any DataLoader: whole batches and stacked samples are equal, bit for
bit.
"""

from __future__ import annotations

import pickle
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
import torch
from helpers import samples
from helpers.examples import slow
from torch.utils.data import (
    BatchSampler,
    ConcatDataset,
    DataLoader,
    Dataset,
    SequentialSampler,
    Subset,
    random_split,
)
from torch.utils.data._utils.pin_memory import pin_memory

from mapdata import MapDataset, OnlineMapDataset, Sample
from mapdata.datasets import row
from mapdata.datasets.sample import Rows, _restore, sample_class, stack


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A small dataset in four shards."""
    return samples.build_small(tmp_path_factory.mktemp("sample") / "maps")


def test_a_field_that_was_not_asked_for(root: str) -> None:
    """The error of a training step says which fields there are, and where others are named."""
    sample = MapDataset(root, fields=("map", "goal"))[:2]
    message = r"no attribute 'optimal_mask': it has the fields map, goal; name others in fields="
    with pytest.raises(AttributeError, match=message):
        _ = sample.optimal_mask
    assert not hasattr(sample, "keys")  # as torch asks


@pytest.fixture(params=[slow("disk"), "random", "online", slow("fixed")])
def dataset(request: pytest.FixtureRequest, root: str) -> MapDataset | OnlineMapDataset:
    """Datasets of all kinds, with every field."""
    if request.param == "online":
        return OnlineMapDataset(samples.SPEC, 5, 60, "train", samples.ALL_FIELDS, augment=True)
    if request.param == "random":
        return MapDataset(root, "train", samples.ALL_FIELDS, problems="random", augment=True)
    return MapDataset(
        root, fields=samples.ALL_FIELDS, max_length=90 if request.param == "fixed" else None
    )


class OneByOne(Dataset[Sample]):
    """The same samples without `__getitems__`: torch stacks them itself."""

    def __init__(self, dataset: MapDataset | OnlineMapDataset) -> None:
        """Wrap a dataset."""
        self.dataset = dataset

    def __len__(self) -> int:
        """Return its length."""
        return len(self.dataset)

    def __getitem__(self, i: int) -> Sample:
        return self.dataset[i]


# --- batches ------------------------------------------------------------------------------------


def test_a_plain_loader_equals_stacked_samples(dataset: MapDataset | OnlineMapDataset) -> None:
    """The fast way (`__getitems__`) and the slow way (one by one, torch's default collate) give the
    same batches.
    """
    fast = list(DataLoader(dataset, 25))
    samples.assert_all_same(fast, list(DataLoader(OneByOne(dataset), 25)))
    assert all(isinstance(batch, Sample) for batch in fast)
    assert sum(len(batch.start) for batch in fast) == len(dataset)
    samples.assert_same(fast[0], stack([dataset[k] for k in range(25)]))
    samples.assert_same(fast[0], dataset[:25])


def test_shuffling_loaders_give_the_samples_of_their_sampler(
    dataset: MapDataset | OnlineMapDataset,
) -> None:
    """With a generator the order is torch's, and each row is the sample of its number."""
    generator = torch.Generator().manual_seed(3)
    batches = list(DataLoader(dataset, 7, shuffle=True, generator=generator))
    samples.assert_same(batches[2], stack([dataset[int(k)] for k in batches[2].problem]))
    seen = sorted(int(k) for batch in batches for k in batch.problem)
    assert seen == list(range(len(dataset)))


@pytest.mark.filterwarnings("ignore:a second pass over this dataset")
def test_views_of_torch(dataset: MapDataset | OnlineMapDataset) -> None:
    """Subset, random_split and ConcatDataset hold the same samples, under a plain loader too."""
    chosen = [5, 1, 1, 30, -1]
    expected = [dataset[k] for k in chosen]
    samples.assert_same(next(iter(DataLoader(Subset(dataset, chosen), 5))), stack(expected))
    first, second = random_split(dataset, [0.5, 0.5], generator=torch.Generator().manual_seed(0))
    numbers = [
        int(k) for part in (first, second) for batch in DataLoader(part, 9) for k in batch.problem
    ]
    assert sorted(numbers) == list(range(len(dataset)))
    samples.assert_same(first[2], dataset[first.indices[2]])
    both: ConcatDataset[Sample] = ConcatDataset([dataset, dataset])
    assert len(both) == 2 * len(dataset)
    across = DataLoader(Subset(both, [len(dataset) - 1, len(dataset)]), 2)
    samples.assert_same(next(iter(across)), stack([dataset[-1], dataset[0]]))


def test_loaders_without_batches(dataset: MapDataset | OnlineMapDataset) -> None:
    """`batch_size=None`: samples, or whole batches when the sampler yields lists."""
    alone = list(DataLoader(Subset(dataset, range(4)), batch_size=None))
    samples.assert_all_same(alone, [dataset[k] for k in range(4)])
    sampler = BatchSampler(SequentialSampler(range(20)), 8, drop_last=False)
    whole = list(DataLoader(dataset, batch_size=None, sampler=sampler))
    samples.assert_all_same(whole, [dataset[:8], dataset[8:16], dataset[16:20]])


class Seen:
    """A collate function of one's own that remembers what it was given."""

    def __init__(self) -> None:
        """Remember nothing yet."""
        self.lists: list[Sequence[Sample]] = []

    def __call__(self, given: Sequence[Sample]) -> int:
        """Use what is given as a list of samples is used."""
        self.lists.append(given)
        assert len(given[1:3]) == min(2, len(given) - 1)
        samples.assert_same(given[-1], [*given][len(given) - 1])
        return sum(int(sample.problem) for sample in given)


def test_a_collate_function_of_ones_own_sees_ordinary_samples(
    dataset: MapDataset | OnlineMapDataset,
) -> None:
    """As many as the batch has, each what `dataset[i]` is, in a sequence that behaves as a list."""
    collate = Seen()
    assert next(iter(DataLoader(dataset, 8, collate_fn=collate))) == sum(range(8))
    assert len(list(DataLoader(dataset, 8, collate_fn=collate))) > 4
    given = collate.lists[2]
    assert isinstance(given, Sequence)
    assert len(given) == 8
    samples.assert_all_same(list(given), [dataset[k] for k in range(8, 16)])
    samples.assert_all_same(given[2:8:3], [dataset[10], dataset[13]])
    for bad in (8, -9):
        with pytest.raises(IndexError, match=f"row {bad} of 8"):
            given[bad]


def test_a_batch_of_two_epochs(dataset: MapDataset | OnlineMapDataset) -> None:
    """Rows of different epochs may stand in one batch: each is what it is in a batch of its own."""
    n = len(dataset)
    mixed = dataset.__getitems__([3, n + 3, 2 * n + 4]).batch
    alone = [dataset.__getitems__([k]).batch for k in (3, n + 3, 2 * n + 4)]
    samples.assert_same(mixed, stack([row(batch, 0) for batch in alone]))


def test_an_empty_batch(dataset: MapDataset | OnlineMapDataset) -> None:
    """No rows, but the right shapes."""
    empty = dataset[:0]
    full = dataset[:3]
    for name, value in zip(empty._fields, empty, strict=True):
        assert len(value) == 0, name
        assert value.dtype == getattr(full, name).dtype
        assert value.ndim == getattr(full, name).ndim
    assert len(dataset.__getitems__([])) == 0


# --- paths --------------------------------------------------------------------------------------


def some_path(length: int) -> torch.Tensor:
    """Return a path of so many cells."""
    return torch.arange(2 * length).reshape(length, 2)


@pytest.mark.parametrize(
    ("lengths", "rows"),
    [((1,), 16), ((16, 3), 16), ((17, 16), 32), ((0, 2), 16), ((0, 0), 0), ((48,), 48)],
)
def test_padding_to_a_multiple_of_16(lengths: tuple[int, ...], rows: int) -> None:
    """As few rows as the longest path needs, in steps of 16, the rest -1."""
    kind = sample_class(("path", "length"))
    batch = stack([kind(some_path(length), torch.tensor(length)) for length in lengths])
    assert batch.path.shape == (len(lengths), rows, 2)
    assert batch.length.tolist() == list(lengths)
    for k, length in enumerate(lengths):
        assert torch.equal(batch.path[k, :length], some_path(length))
        assert (batch.path[k, length:] == -1).all()
        assert torch.equal(row(batch, k).path, some_path(length))


def test_padding_to_a_fixed_length() -> None:
    """With room for 20 cells every path, batched or not, has 20 rows."""
    kind = sample_class(("path",), 20)
    alone = [row(stack([kind(some_path(length))]), 0) for length in (3, 20)]
    assert [sample.path.shape for sample in alone] == [(20, 2), (20, 2)]
    assert stack(alone).path.shape == (2, 20, 2)
    assert torch.equal(stack(alone).path[0, :3], some_path(3))


# --- samples are NamedTuples --------------------------------------------------------------------


def test_a_sample_is_a_named_tuple() -> None:
    """Names, order, unpacking, `_replace`, `_asdict`, repr."""
    kind = sample_class(("map", "goal"))
    sample = kind(1, 2)
    assert sample_class(("map", "goal")) is kind
    assert (sample.map, sample.goal, sample[1], [*sample]) == (1, 2, 2, [1, 2])
    assert kind._fields == ("map", "goal")
    assert isinstance(sample, Sample)
    assert isinstance(sample, tuple)
    assert sample._replace(goal=5) == (1, 5)
    assert type(sample._replace(goal=5)) is kind
    assert sample._asdict() == {"map": 1, "goal": 2}
    assert repr(sample) == "Sample(map=1, goal=2)"
    with pytest.raises(AttributeError):
        sample.path  # noqa: B018


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_samples_pickle(root: str, protocol: int) -> None:
    """A sample, a batch and their class come back the same, `max_length` included."""
    for max_length in (None, 90):
        dataset = MapDataset(root, fields=("map", "path", "cost"), max_length=max_length)
        for sample in (dataset[3], dataset[:4]):
            again = pickle.loads(pickle.dumps(sample, protocol))
            assert type(again) is type(sample)
            samples.assert_same(again, sample)


# Older versions of torch load with `weights_only=False` unless they are told otherwise.
needs_torch_2_4 = pytest.mark.skipif(
    not hasattr(torch.serialization, "add_safe_globals"), reason="torch older than 2.4"
)


@needs_torch_2_4
def test_torch_saves_samples(root: str, tmp_path: Path) -> None:
    """`torch.save` keeps names, and `torch.load` needs no `weights_only=False`."""
    for max_length in (None, 90):
        dataset = MapDataset(root, max_length=max_length)
        for sample in (dataset[:5], dataset[3]):
            torch.save(sample, tmp_path / "sample.pt")
            for weights_only in (True, False):
                again = torch.load(tmp_path / "sample.pt", weights_only=weights_only)
                assert type(again) is type(sample)
                samples.assert_same(again, sample)


@needs_torch_2_4
def test_a_saved_sample_runs_no_code(tmp_path: Path) -> None:
    """Names of fields that are no identifiers are refused, since they become names of a class."""

    class Hostile:
        """Pickles as a sample with a bad name."""

        def __reduce__(self) -> tuple[Any, ...]:
            names = ("map=print('run')",)
            return _restore, (names, None, (1,))

    torch.save(Hostile(), tmp_path / "sample.pt")
    with pytest.raises(Exception, match="must be valid identifiers"):
        torch.load(tmp_path / "sample.pt", weights_only=True)


def test_pinning_keeps_names(root: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The pin thread makes a batch of the same class, each tensor pinned once."""
    pinned: list[torch.Tensor] = []

    def pin(tensor: torch.Tensor, *_: object) -> torch.Tensor:
        pinned.append(tensor)
        return tensor.clone()

    monkeypatch.setattr(torch.Tensor, "pin_memory", pin)
    batch = next(iter(DataLoader(MapDataset(root), 8)))
    again: Any = pin_memory(batch)
    assert type(again) is type(batch)
    assert len(pinned) == 4
    samples.assert_same(again, batch)


def test_iterating_a_dataset(root: str) -> None:
    """`for sample in dataset` ends, and gives each sample once."""
    dataset = MapDataset(root, fields=("problem",))
    iterator: Iterator[Sample] = iter(dataset)
    assert [int(sample.problem) for sample in iterator] == list(range(len(dataset)))


def test_rows_of_a_batch() -> None:
    """A batch of paths of different lengths comes apart into what it was made of."""
    kind = sample_class(("path",))
    paths = [some_path(k) for k in (4, 0, 17)]
    rows = Rows(stack([kind(path) for path in paths]))
    for path, sample in zip(paths, rows, strict=True):
        assert torch.equal(sample.path, path)


def flat(sample: Sample) -> Sample:
    """Number the cells of a path: (T, 2) becomes (T,)."""
    path = sample.path[:, 0] * 64 + sample.path[:, 1]
    changed: Sample = sample._replace(path=path)
    return changed


def test_paths_that_a_transform_made_flat_are_padded(root: str) -> None:
    """Along their own axis, to a multiple of 16."""
    plain = next(iter(DataLoader(MapDataset(root), 8)))
    batch = next(iter(DataLoader(MapDataset(root, transform=flat), 8)))
    numbers = plain.path[:, :, 0] * 64 + plain.path[:, :, 1]
    assert batch.path.tolist() == torch.where(plain.path[:, :, 0] < 0, -1, numbers).tolist()


def test_rows_are_pinned_as_samples(root: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A collate function that keeps the list: torch makes a list of the pinned samples."""
    monkeypatch.setattr(torch.Tensor, "pin_memory", lambda tensor, *_: tensor.clone())
    rows = MapDataset(root).__getitems__(range(8))
    again: Any = pin_memory(rows)
    assert len(again) == 8
    for one, other in zip(again, rows, strict=True):
        samples.assert_same(one, other)
