"""`DatasetInfo`: where the maps of a dataset come from, their counts, and what a sample holds."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import torch

from mapdata.datasets.sample import Sample
from mapdata.generators.recipe import Recipe
from mapdata.limits import Size
from mapdata.movement import Movement


class FieldInfo(NamedTuple):
    """A field of one sample.

    Attributes:
        shape: without the axis of the batch; None for a length that differs between samples.
        dtype: as the dataset serves it.
    """

    shape: tuple[int | None, ...]
    dtype: torch.dtype


@dataclass(frozen=True)
class DatasetInfo:
    """Where the maps of a dataset come from, their counts, and what a sample holds.

    Attributes:
        roots: folders and URLs of the dataset; none for maps made online and for a `ProblemSet`.
        recipes: generator, seed and number of maps of each root; None for imported maps, for maps
            of a family that is not registered or has other parameters by now, and for a
            `ProblemSet`.
        identities: identity of generator and seed of each root; None for a `ProblemSet`, and for
            imported maps, which content hash, resolution and movement together identify.
        content_hashes: hash of the maps of each root, or of the problems of a `ProblemSet`; None
            for maps made online.
        map_counts: number of maps by split, of the splits that are served. A `ProblemSet` has no
            splits: the number of its different maps is that of "all".
        problem_counts: number of problems by split, after filters and radius; in "all" those of a
            `ProblemSet`.
        map_size: (rows, columns).
        resolution: metres per cell; None for roots of several resolutions, and for a `ProblemSet`,
            which does not know it.
        movement: movement of the served paths.
        has_terrain: whether free cells cost different amounts, so that the field ``terrain`` holds
            more than ones.
        fields: shape and dtype of each served field; None for a dataset without problems.
    """

    roots: tuple[str, ...]
    recipes: tuple[Recipe | None, ...]
    identities: tuple[str | None, ...]
    content_hashes: tuple[str | None, ...]
    map_counts: dict[str, int]
    problem_counts: dict[str, int]
    map_size: Size
    resolution: float | None
    movement: Movement
    has_terrain: bool
    fields: dict[str, FieldInfo] | None

    def __repr__(self) -> str:
        """Return one line for each attribute."""
        lines = [f"    {field.name}={getattr(self, field.name)!r}," for field in fields(self)]
        return "\n".join([f"{type(self).__name__}(", *lines, ")"])


def field_infos(batch: Sample) -> dict[str, FieldInfo]:
    """Return shape and dtype of the fields of a batch, by name."""
    infos = {}
    for name, tensor in batch._asdict().items():
        shape: tuple[int | None, ...] = tuple(tensor.shape[1:])
        if name == "path" and batch._capacity is None:
            shape = (None, *shape[1:])
        infos[name] = FieldInfo(shape, tensor.dtype)
    return infos
