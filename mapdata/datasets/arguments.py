"""The arguments that the datasets and the data module share, checked once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass
from functools import partial
from typing import Any

import torch

from mapdata.checks import (
    check_choice,
    check_count,
    check_flag,
    check_number,
    check_seed,
    did_you_mean,
    items_of,
)
from mapdata.datasets.fields import FIELDS
from mapdata.datasets.sample import MAPS_AND_MASKS, Sample
from mapdata.movement import Movement, check_movement
from mapdata.problems.sources import Source, plain_text
from mapdata.search.api import SEARCHES
from mapdata.search.footprint import min_squared_clearance

FieldFunction = Callable[[Sample], Any]

DEFAULT_FIELDS = ("map", "start", "goal", "path")


@dataclass(frozen=True)
class Serving:
    """How problems become samples. `MapDataset` describes the arguments, which have the same names.

    Raises:
        ValueError: arguments that do not fit, or that would do nothing.
    """

    fields: Sequence[str | FieldFunction]
    problems: Source
    search: str
    movement: Movement | None
    augment: bool
    sampling_seed: int
    max_length: int | None
    radius: float

    def __post_init__(self) -> None:
        """Check the arguments."""
        self._check_fields()
        keep = partial(object.__setattr__, self)  # plain values, which checkpoints can hold
        keep("fields", tuple(self.fields))
        check_choice("search", self.search, SEARCHES)
        if self.movement is not None:
            check_movement(self.movement)
        check_flag("augment", self.augment)
        min_squared_clearance(self.radius)  # raises an error for a bad radius
        keep("radius", check_number("radius", self.radius))
        keep("sampling_seed", check_seed(self.sampling_seed, "sampling_seed"))
        if self.max_length is not None:
            keep("max_length", check_count("max_length", self.max_length))
            if "path" not in self.fields:
                raise ValueError("max_length: expected 'path' among the fields")

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the fields."""
        return tuple(
            field if isinstance(field, str) else getattr(field, "__name__", "")
            for field in self.fields
        )

    def plain(self) -> dict[str, Any]:
        """Return the arguments as plain values, which checkpoints can hold safely.

        Functions among the fields cannot be kept; then ``fields`` is left out.
        """
        plain = {**vars(self), "problems": plain_text(self.problems)}
        if self.movement is not None:
            plain["movement"] = astuple(self.movement)
        if not all(isinstance(field, str) for field in self.fields):
            del plain["fields"]
        return plain

    def _check_fields(self) -> None:
        if not items_of(self.fields):
            raise ValueError(
                f"fields: got {self.fields!r}, expected a sequence of names or functions"
            )
        for field in self.fields:
            if not callable(field) and field not in list(FIELDS):
                raise ValueError(
                    f"fields: got {field!r}, expected a function or one of "
                    f"{', '.join(FIELDS)}{did_you_mean(field, FIELDS)}"
                )
        if len(set(self.names)) < len(self.names):
            raise ValueError(f"fields: got {self.names}, expected each name once")
        if not all(name.isidentifier() for name in self.names):
            raise ValueError(
                "fields: a function gives its name to the sample; use 'def', not 'lambda'"
            )


def torch_dtype(dtype: torch.dtype | str | None, names: Sequence[str]) -> torch.dtype | None:
    """Return the type that maps and masks among the fields ``names`` become.

    Args:
        dtype: a type of torch or its name, such as "float32"; None leaves them as they are.
        names: the names of the fields.

    Raises:
        ValueError: no type, or there is neither map nor mask among the fields.
    """
    if dtype is None:
        return None
    named = getattr(torch, dtype.removeprefix("torch."), None) if isinstance(dtype, str) else dtype
    if isinstance(named, torch.dtype) and set(names) & set(MAPS_AND_MASKS):
        return named
    raise ValueError(
        f"dtype: got {dtype!r}, expected one of torch, such as torch.float32 or its name, and one "
        f"of {', '.join(MAPS_AND_MASKS)} among the fields"
    )
