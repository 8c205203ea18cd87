"""What a dataset yields, and how samples become batches under any DataLoader."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor
from torch.nn.functional import pad
from torch.nn.utils.rnn import pad_sequence
from torch.utils.data._utils.collate import collate, default_collate_fn_map

from mapdata.arrays import summary
from mapdata.datasets.field_kernels import PADDING

PATH_STEP = 16
"""Batches pad paths to a multiple of this, so that their shapes are few."""

MAPS_AND_MASKS = ("map", "free", "path_mask", "start_mask", "goal_mask", "optimal_mask")
"""The uint8 fields that networks take as numbers; ``optimal_moves`` is a bit set and stays one."""


class Sample(tuple[Any, ...]):
    """Base class of samples and batches: NamedTuples of the fields asked for, in order.

    It is registered with torch's default collate function, so that a plain ``DataLoader(dataset,
    256)`` gives padded batches.
    """

    __slots__ = ()
    _fields: tuple[str, ...]
    _capacity: int | None

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Fields are tensors."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as field names and values.

        The class is made at run time, and loader workers must find it again.
        """
        return _restore, (self._fields, self._capacity, tuple(self))

    __repr__ = summary


@cache
def sample_class(names: tuple[str, ...], capacity: int | None = None) -> type[Any]:
    """Return the class of samples with these fields.

    ``capacity`` is the number of rows of ``path``; None for as many as it needs.
    """
    return type(
        "Sample", (Sample, namedtuple("Sample", names)), {"__slots__": (), "_capacity": capacity}
    )


def _restore(names: tuple[str, ...], capacity: int | None, values: tuple[Any, ...]) -> Sample:
    sample: Sample = sample_class(names, capacity)(*values)
    return sample


@dataclass(eq=False)
class Rows(Sequence[Sample]):
    """A batch that looks like a list of samples: to collate it costs nothing."""

    batch: Sample

    def __len__(self) -> int:
        return len(self.batch[0])

    def __post_init__(self) -> None:
        """Refuse a list: torch, which would make rows of the samples that it pinned, keeps it."""
        if not isinstance(self.batch, Sample):
            raise TypeError("rows: expected a batch")

    def __getitem__(self, i: Any) -> Any:
        if isinstance(i, slice):
            return [self[k] for k in range(*i.indices(len(self)))]
        if not -len(self) <= i < len(self):
            raise IndexError(f"row {i} of {len(self)}")
        return row(self.batch, i)


def row(batch: Sample, i: int) -> Sample:
    """Return sample ``i`` of a batch.

    Its path has no padding, unless the dataset has a ``max_length``.
    """
    sample: Sample = type(batch)(*(value[i] for value in batch))
    if batch._capacity is None and "path" in batch._fields:
        path = sample.path
        sample = sample._replace(path=path[path[:, 0] != PADDING])
    return sample


def cast(batch: Sample, dtype: torch.dtype) -> Sample:
    """Return a sample or batch whose maps and masks have another type; all else stays as it is."""
    for name in MAPS_AND_MASKS:
        if name in batch._fields:
            batch = batch._replace(**{name: getattr(batch, name).to(dtype)})
    return batch


def stack(samples: Sequence[Sample], collate_fn_map: Any = default_collate_fn_map) -> Sample:
    """Stack samples into a batch.

    Paths are padded with -1 to a multiple of 16 cells, or to the dataset's ``max_length``.
    """
    kind = type(samples[0])
    stacked = []
    for name, values in zip(kind._fields, zip(*samples, strict=True), strict=True):
        if name == "path":
            stacked.append(_stack_paths(values, kind._capacity))
        else:
            stacked.append(collate(list(values), collate_fn_map=collate_fn_map))
    return kind(*stacked)


def _stack_paths(paths: Sequence[Tensor], capacity: int | None) -> Tensor:
    longest = max(map(len, paths))
    rows = rows_of_path(longest, capacity)
    stacked = pad_sequence(list(paths), batch_first=True, padding_value=PADDING)
    return pad(stacked, (0, 0) * (stacked.ndim - 2) + (0, rows - longest), value=PADDING)


def rows_of_path(longest: int, max_length: int | None) -> int:
    """Return how many rows ``path`` has where the longest one has so many cells.

    Raises:
        ValueError: it does not fit into ``max_length``.
    """
    if max_length is None:
        return -(-longest // PATH_STEP) * PATH_STEP
    if longest > max_length:
        raise ValueError(f"max_length: a path of {longest} cells does not fit into {max_length}")
    return max_length


def _collate(samples: Any, *, collate_fn_map: Any = None) -> Sample:
    return samples.batch if isinstance(samples, Rows) else stack(samples, collate_fn_map)


default_collate_fn_map[Sample] = _collate
