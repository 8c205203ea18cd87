"""`Serving`: the options that the datasets and the data module share, declared and checked once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
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
    known_values,
)
from mapdata.datasets.fields import FIELD_CLASSES, FIELDS
from mapdata.datasets.maze_image import MazeImage
from mapdata.datasets.sample import Sample
from mapdata.datasets.tiles import Tiles
from mapdata.datasets.transforms import check_transform
from mapdata.datasets.waypoints import Waypoints
from mapdata.limits import MAPS_AND_MASKS
from mapdata.movement import Movement, check_movement
from mapdata.problems.sources import Route, Source, plain_text
from mapdata.search.api import SEARCHES
from mapdata.search.footprint import min_squared_clearance

FieldFunction = Callable[[Sample], Any] | Waypoints | Tiles | MazeImage
"""A field of your own: a function, or a field with options (`Waypoints`, `Tiles`, `MazeImage`).

A function takes the batch so far, a `Sample`, and returns an array or a tensor with B rows.
"""

Transform = Callable[[Sample], Any]
"""A function of one `Sample`, which is called after all else; a dataset returns its output."""

DEFAULT_FIELDS = ("map", "start", "goal", "path")
"""The fields of a sample where ``fields=`` is left out, in their order."""

DEFAULT_PROBLEMS = Route()

MovementLike = Movement | tuple[int, bool, float] | Mapping[str, Any]
"""A `Movement`; its three values in their order; or some of them by name.

For example ``{"connectivity": 8}`` in a configuration.
"""


@dataclass(frozen=True, kw_only=True)
class Serving:
    """How stored or generated problems become samples.

    The constructors of `MapDataset`, `OnlineMapDataset` and `MapDataModule` show these options with
    the same names and defaults; `MapDataset` describes them.

    Raises:
        ValueError: options that do not fit, or that would have no effect.
    """

    fields: Sequence[str | FieldFunction] = DEFAULT_FIELDS
    problems: Source = DEFAULT_PROBLEMS
    search: str = "astar"
    movement: Movement | None = None
    augment: bool = False
    sampling_seed: int = 0
    max_length: int | None = None
    dtype: torch.dtype | str | None = None
    transform: Transform | None = None
    radius: float = 0.0

    def __post_init__(self) -> None:
        """Check the options, and replace numbers of numpy by plain ones."""
        self._check_fields()
        self._replace("fields", tuple(self.fields))
        check_choice("search", self.search, SEARCHES)
        if self.movement is not None:
            check_movement(self.movement)
        check_flag("augment", self.augment)
        self._replace("sampling_seed", check_seed(self.sampling_seed, "sampling_seed"))
        if self.max_length is not None:
            self._replace("max_length", check_count("max_length", self.max_length))
            if "path" not in self.fields:
                raise ValueError("max_length: expected 'path' among the fields")
        self._replace("dtype", torch_dtype(self.dtype, self.names))
        check_transform(self.transform)
        min_squared_clearance(self.radius)  # raises ValueError if it is not a radius
        self._replace("radius", check_number("radius", self.radius))

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the fields; a function has its own name."""
        return field_names(self.fields)

    @property
    def has_jitter(self) -> bool:
        """Whether the light of pictures varies."""
        return any(isinstance(field, Tiles) and field.jitter for field in self.fields)

    def of_split(self, split: str) -> Serving:
        """Return the options for a split: only the training split is augmented and has jitter."""
        if split == "train":
            return self
        fields = tuple(
            replace(field, jitter=False) if isinstance(field, Tiles) else field
            for field in self.fields
        )
        return replace(self, augment=False, fields=fields)

    def plain(self) -> dict[str, Any]:
        """Return the options as plain values, which checkpoints can hold safely.

        Functions cannot be held: ``transform`` is always left out, and ``fields`` if there is a
        function among them.
        """
        options = {
            **vars(self),
            "problems": plain_text(self.problems),
            "dtype": None if self.dtype is None else str(self.dtype).removeprefix("torch."),
        }
        if self.movement is not None:
            options["movement"] = astuple(self.movement)
        if not all(isinstance(field, str) for field in self.fields):
            del options["fields"]
        del options["transform"]
        return options

    def _replace(self, name: str, checked: object) -> None:
        """Set an option of this frozen dataclass to its checked value."""
        object.__setattr__(self, name, checked)

    def _check_fields(self) -> None:
        """Refuse fields that are unknown, that have no name, or that occur twice."""
        if not items_of(self.fields):
            raise ValueError(
                f"fields: got {self.fields!r}, expected a sequence of names or functions"
            )
        for field in self.fields:
            # A class can be called, so it would be taken for a function of the batch.
            if isinstance(field, type) and issubclass(field, FIELD_CLASSES):
                instance: Any = field()
                raise ValueError(
                    f"fields: got the class {field.__name__}, expected an instance such as "
                    f"{field.__name__}(), or the name {instance.__name__!r}"
                )
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


def as_movement(movement: MovementLike | None) -> Movement | None:
    """Return the `Movement` that a mapping or a sequence stands for; None is unchanged.

    Raises:
        ValueError: it is none of these.
    """
    if movement is None or isinstance(movement, Movement):
        return movement
    if isinstance(movement, Mapping):
        return Movement(**known_values("movement", movement, Movement))
    values = items_of(movement)
    if not 1 <= len(values) <= 3:
        raise ValueError(
            f"movement: got {movement!r}, expected a Movement, or a mapping such as "
            "{connectivity: 8}"
        )
    return Movement(*values)


def field_names(fields: Sequence[str | FieldFunction]) -> tuple[str, ...]:
    """Return the names of fields; a function without a name has an empty one."""
    return tuple(
        field if isinstance(field, str) else getattr(field, "__name__", "") for field in fields
    )


def torch_dtype(dtype: torch.dtype | str | None, names: Sequence[str]) -> torch.dtype | None:
    """Return the dtype that the maps and masks among the fields are converted to.

    Args:
        dtype: a dtype of torch or its name, such as "float32"; None converts nothing.
        names: the names of the fields.

    Raises:
        ValueError: ``dtype`` is unknown, or there is neither a map nor a mask among the fields.
    """
    if dtype is None:
        return None
    torch_type = dtype
    if isinstance(dtype, str):
        torch_type = getattr(torch, dtype.removeprefix("torch."), dtype)
    if not isinstance(torch_type, torch.dtype):
        raise ValueError(
            f"dtype: got {dtype!r}, expected one of torch, such as torch.float32 or its name"
        )
    if set(names).isdisjoint(MAPS_AND_MASKS):
        raise ValueError(
            f"dtype: got {dtype!r}, which converts maps and masks only, and none is served: "
            f"expected one of {', '.join(MAPS_AND_MASKS)} among the fields"
        )
    return torch_type
