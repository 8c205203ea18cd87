"""Arrays: names for their types, offsets of runs, and the ``repr`` of objects that hold them."""

from __future__ import annotations

from math import prod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[Any]
Ints = NDArray[np.int64]
Int8s = NDArray[np.int8]
Int32s = NDArray[np.int32]
UInt32s = NDArray[np.uint32]
Words = NDArray[np.uint64]
Bytes = NDArray[np.uint8]
Flags = NDArray[np.bool_]
Floats = NDArray[np.float64]
Float32s = NDArray[np.float32]


def offsets_of(counts: ArrayLike) -> Ints:
    """Return the offsets (N + 1,) of N runs of ``counts`` elements that are stored consecutively.

    Run k is ``offsets[k]:offsets[k + 1]``.

    >>> offsets_of([2, 0, 3])
    array([0, 2, 2, 5])
    """
    return np.concatenate(([0], np.cumsum(counts, dtype=np.int64)))


def places_of_mask(mask: Flags, count: int) -> Ints:
    """Return the places (M,) that a mask of ``count`` bools selects, as NumPy selects rows.

    Raises:
        IndexError: a mask of another shape.

    >>> places_of_mask(np.array([True, False, True]), 3)
    array([0, 2])
    """
    if mask.shape != (count,):
        raise IndexError(
            f"indices: got a mask of shape {mask.shape}, expected ({count},), a bool a problem"
        )
    return np.flatnonzero(mask)


def summary(self: Any) -> str:
    """Return the ``repr`` of a dataclass or NamedTuple, with dtype and shape for its arrays.

    It is assigned to ``__repr__`` in the body of the class:

    >>> from dataclasses import dataclass
    >>> @dataclass
    ... class Problem:
    ...     map: Bytes
    ...     goal: Ints
    ...     __repr__ = summary
    >>> Problem(np.zeros((1, 64, 64), np.uint8), np.array([3, 5]))
    Problem(map=uint8 (1, 64, 64), goal=[3, 5])
    """
    fields = [f"{name}={brief_text(getattr(self, name))}" for name in self.__match_args__]
    return f"{type(self).__name__}({', '.join(fields)})"


def brief_text(field: Any) -> str:
    """Return dtype and shape of an array or tensor, or its numbers if there are one or two."""
    if not hasattr(field, "dtype"):
        return repr(field)
    if 1 <= prod(field.shape) <= 2:
        return str(field.tolist())
    return f"{field.dtype} {tuple(field.shape)}".removeprefix("torch.")
