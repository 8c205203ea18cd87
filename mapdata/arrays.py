"""The types of arrays, named by what they hold; how objects that hold arrays are printed."""

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
    """Return where runs of so many values begin, one after another, and where the last ends.

    >>> offsets_of([2, 0, 3])
    array([0, 2, 2, 5])
    """
    return np.concatenate(([0], np.cumsum(counts, dtype=np.int64)))


def summary(self: Any) -> str:
    """Return the ``repr`` of a dataclass or NamedTuple that holds arrays: their dtype and shape.

    >>> from dataclasses import dataclass
    >>> @dataclass
    ... class Problem:
    ...     map: Bytes
    ...     goal: Ints
    ...     __repr__ = summary
    >>> Problem(np.zeros((1, 64, 64), np.uint8), np.array([3, 5]))
    Problem(map=uint8 (1, 64, 64), goal=[3, 5])
    """
    shown = (f"{name}={_brief(getattr(self, name))}" for name in self.__match_args__)
    return f"{type(self).__name__}({', '.join(shown)})"


def _brief(value: Any) -> str:
    """Return dtype and shape of an array or tensor, the values of one of up to two."""
    if not hasattr(value, "dtype"):
        return repr(value)
    if 1 <= prod(value.shape) <= 2:
        return str(value.tolist())
    return f"{value.dtype} {tuple(value.shape)}".removeprefix("torch.")
