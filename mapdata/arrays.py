"""The types of arrays, named by what they hold, and how objects that hold arrays are printed."""

from __future__ import annotations

from collections.abc import Mapping
from math import prod
from typing import Any

import numpy as np
import numpy.typing as npt

Ints = npt.NDArray[np.int64]
Int32s = npt.NDArray[np.int32]
UInt32s = npt.NDArray[np.uint32]
Words = npt.NDArray[np.uint64]
Bytes = npt.NDArray[np.uint8]
Flags = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]
Float32s = npt.NDArray[np.float32]


def summary(name: str, values: Mapping[str, Any]) -> str:
    """Return a ``repr`` that tells dtype and shape of arrays and tensors instead of their values.

    >>> summary("Sample", {"map": np.zeros((1, 64, 64), np.uint8), "start": np.array([3, 5])})
    'Sample(map=uint8 (1, 64, 64), start=[3, 5])'
    """
    return f"{name}({', '.join(f'{key}={_brief(value)}' for key, value in values.items())})"


def _brief(value: Any) -> str:
    """Return dtype and shape of an array or tensor, the values of one of up to two."""
    if not hasattr(value, "dtype"):
        return repr(value)
    if 1 <= prod(value.shape) <= 2:
        return str(value.tolist())
    return f"{str(value.dtype).removeprefix('torch.')} {tuple(value.shape)}"
