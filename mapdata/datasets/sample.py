"""`Sample`: a sample or a batch as a NamedTuple of tensors, and how samples are collated."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad
from torch.nn.utils.rnn import pad_sequence
from torch.utils.data._utils.collate import collate, default_collate_fn_map

from mapdata.arrays import summary
from mapdata.datasets.field_kernels import PADDING
from mapdata.limits import MAPS_AND_MASKS

PATH_STEP = 16
"""Batches pad paths to a multiple of this many cells, so that only few different shapes occur."""


class Sample(tuple[Any, ...]):
    """Base class of samples and batches: NamedTuples of the requested fields, in order.

    It is registered with torch's default collate function, so that a plain ``DataLoader(dataset,
    256)`` gives padded batches.
    """

    __slots__ = ()
    _fields: tuple[str, ...]
    _capacity: int | None

    def __getattr__(self, name: str) -> Any:
        """Refuse a field that the dataset was not asked for; the others are attributes."""
        raise AttributeError(
            f"'Sample' object has no attribute {name!r}: it has the fields "
            f"{', '.join(self._fields)}; name others in fields= of the dataset or data module"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as field names and values.

        The class is created at run time, so another process cannot import it by name.
        """
        return _restore, (self._fields, self._capacity, tuple(self))

    __repr__ = summary


@cache
def sample_class(names: tuple[str, ...], capacity: int | None = None) -> type[Any]:
    """Return the class of samples with these fields.

    Args:
        names: the fields, in order.
        capacity: fixed number of rows of ``path``; None pads it to a multiple of `PATH_STEP`.
    """
    return type(
        "Sample", (Sample, namedtuple("Sample", names)), {"__slots__": (), "_capacity": capacity}
    )


def _restore(names: tuple[str, ...], capacity: int | None, tensors: tuple[Any, ...]) -> Sample:
    """Return a pickled sample."""
    sample: Sample = sample_class(names, capacity)(*tensors)
    return sample


# `torch.load` refuses functions that it does not know, unless they are declared safe. This one runs
# no code of the file: `namedtuple` refuses names of fields that are no plain identifiers.
if hasattr(torch.serialization, "add_safe_globals"):  # from torch 2.4 on
    torch.serialization.add_safe_globals([_restore])


@dataclass(eq=False)
class Rows(Sequence[Sample]):
    """A whole batch that a DataLoader may treat as a list of samples.

    The collate function takes the batch as it is, so nothing is taken apart and stacked again.
    """

    batch: Sample

    def __len__(self) -> int:
        return len(self.batch[0])

    def __post_init__(self) -> None:
        """Refuse a list of samples.

        With ``pin_memory`` torch pins the samples of a sequence and then calls its class with the
        list of them. If that call fails, torch keeps the list, which is what is needed here.
        """
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
    sample: Sample = type(batch)(*(tensor[i] for tensor in batch))
    if batch._capacity is None and "path" in batch._fields:
        path = sample.path
        is_cell = path[:, 0] != PADDING
        sample = sample._replace(path=path[is_cell])
    return sample


def cast(batch: Sample, dtype: torch.dtype) -> Sample:
    """Return a sample or batch whose maps and masks have another dtype."""
    for name in MAPS_AND_MASKS:
        if name in batch._fields:
            batch = batch._replace(**{name: getattr(batch, name).to(dtype)})
    return batch


def stack(samples: Sequence[Sample], collate_fn_map: Any = default_collate_fn_map) -> Sample:
    """Stack samples into a batch.

    Paths are padded with -1 to a multiple of 16 cells, or to the dataset's ``max_length``.

    Args:
        samples: at least one; all have the same fields.
        collate_fn_map: torch's functions for the types of values in a sample.
    """
    sample_type = type(samples[0])
    columns = zip(*samples, strict=True)
    tensors = []
    for name, column in zip(sample_type._fields, columns, strict=True):
        if name == "path":
            tensors.append(_stack_paths(column, sample_type._capacity))
        else:
            tensors.append(collate(list(column), collate_fn_map=collate_fn_map))
    return sample_type(*tensors)


def _stack_paths(paths: Sequence[Tensor], capacity: int | None) -> Tensor:
    """Return paths, (k, 2) each, as one tensor (B, T, 2), padded with -1."""
    max_cells = max(len(path) for path in paths)
    rows = padded_path_length(max_cells, capacity)
    stacked = pad_sequence(list(paths), batch_first=True, padding_value=PADDING)
    # `pad` takes two numbers for each axis, the last axis first; only rows are added.
    unchanged_axes = (0, 0) * (stacked.ndim - 2)
    return pad(stacked, (*unchanged_axes, 0, rows - max_cells), value=PADDING)


def padded_path_length(max_cells: int, max_length: int | None) -> int:
    """Return the number of rows of ``path`` in a batch.

    Args:
        max_cells: number of cells of the longest path of the batch.
        max_length: fixed number of rows; None for the next multiple of `PATH_STEP`.

    Raises:
        ValueError: the longest path does not fit into ``max_length``.
    """
    if max_length is None:
        steps = -(-max_cells // PATH_STEP)  # rounded up
        return steps * PATH_STEP
    if max_cells > max_length:
        raise ValueError(f"max_length: a path of {max_cells} cells does not fit into {max_length}")
    return max_length


def _collate(samples: Any, *, collate_fn_map: Any = None) -> Sample:
    """Return a batch of samples, as torch's collate function calls it."""
    return samples.batch if isinstance(samples, Rows) else stack(samples, collate_fn_map)


default_collate_fn_map[Sample] = _collate
