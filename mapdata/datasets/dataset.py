"""`MapDataset`: the problems of built datasets as torch samples."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from mapdata.checks import check_flag
from mapdata.datasets.arguments import (
    DEFAULT_FIELDS,
    FieldFunction,
    MovementLike,
    Serving,
    Transform,
    as_movement,
)
from mapdata.datasets.batch_sources import DrawnSource, StoredSource
from mapdata.datasets.batches import BatchReader, stored_counts
from mapdata.datasets.fields import FIELDS, Field
from mapdata.datasets.info import DatasetInfo, field_infos
from mapdata.datasets.map_sources import StoredMapSource
from mapdata.datasets.problem_dataset import ProblemDataset
from mapdata.datasets.waypoints import divided_lines
from mapdata.generators.recipe import Recipe
from mapdata.generators.stored_families import unknown_family
from mapdata.limits import SPLITS
from mapdata.problems.sources import Band, Random, Source, SourceLike, check_band, problem_source
from mapdata.shards.locations import Locations, locations

if TYPE_CHECKING:
    import pandas as pd

FILTER_BATCH = 4096
"""Number of problems that `MapDataset.filter` examines at once, which limits its memory."""

CONDITIONS: dict[str, Field] = {
    "rooms": lambda batch: (batch.rooms.seed_points[:, :, 0] >= 0).sum(axis=1),
    "path_length": FIELDS["length"],
    "reachable": lambda batch: np.diff(batch.paths.offsets) > 0,
    "all_connected": lambda batch: (batch.rooms.matrix != -1).all(axis=(1, 2)),  # -2 is padding
    "hardness": FIELDS["hardness"],
    "bends": lambda batch: divided_lines(batch, 2)[1],
}
"""The quantity that each condition of `MapDataset.filter` limits, (B,) for a batch."""


class MapDataset(ProblemDataset):
    """The problems of one or more built datasets, as torch samples.

    Args:
        root: folder or fsspec URL of a dataset, or a list of them with one map size and movement.
        split: "train", "val", "test" or None for all.
        fields: names of `fields.FIELDS` or functions of the batch so far (a `Sample`), in the order
            of the sample.
        problems: which problems are served: a `Route`, `Pairs` or `Random`, or its name, "route"
            (the stored segments between consecutive rooms), "pairs" (all pairs of rooms i < j) or
            "random" (one problem a map, or ``per_map`` of them, sampled anew each epoch); or plain
            JSON, ``{"random": {"distance": [10, null]}}``. Problems of length 0 are left out. So
            are those that have no path under the movement and radius that are served, unless it is
            ``Route(unsolvable=True)`` or ``Pairs(unsolvable=True)``.
        search: "astar" or "bfs", whose paths, costs, iterations and matrices are served.
        movement: None for the stored one; a `Movement`; (connectivity, corner_cutting,
            diagonal_cost); or some of these by name, as a mapping. Under another one than the
            stored one, problems are solved on the fly. If one of
            the two cuts corners and the other does not, they do not connect the same cells. Then
            the connected components of every map decide which problems of a route or of pairs have
            a path: opening the dataset opens all shards, and takes some 20 us a map of 64 x 64
            cells. Under any other movement shards are opened at their first touch.
        augment: one of the 8 symmetries (4 when not square) a sample, drawn anew each epoch; not
            for val and test.
        sampling_seed: seed of all that is drawn while loading; the maps have a seed of their own.
        max_length: fixed number of rows of ``path``; a longer path is an error.
        dtype: what maps and masks become, such as torch.float32, which networks take, or its name,
            "float32"; cells, counts and bit sets stay integers. None leaves them uint8, a quarter
            of the bytes.
        transform: a function of one sample (never of a batch), called after all else; what it
            returns is what ``dataset[i]`` gives. Return a `Sample`, such as
            ``sample._replace(map=...)``, and ragged paths are still padded in batches. Geometric
            transforms of torchvision are refused: they would move the map, but neither cells nor
            masks, whereas ``augment`` moves everything. The price: each batch is taken apart and
            stacked again, some tens of microseconds a sample; a function among the fields gets
            whole batches, and is the fast way to values of your own. What it draws at random is its
            own affair. Loader workers started by spawn need one that can be pickled, so no lambda.
        radius: of the robot, in metres. Above 0 all maps are served as `mapdata.inflate` gives them
            for ``radius / resolution`` cells, and everything is solved anew on those, as under
            another movement. A seed point on which the robot has no room has no path: such problems
            of a route or of pairs are left out, or kept with ``unsolvable=True``. The connected
            components of the inflated maps decide which, as under a movement that treats corners
            otherwise; that takes some 40 us a map.
        follow_links: read files that are links out of their folder, as in the cache of
            huggingface_hub. Only for folders of your own: a stranger's folder may have links to any
            file of this machine.

    Raises:
        DatasetNotFoundError: no dataset under a root; the message names the command that makes one.
        ShardError: a damaged or hostile file, found at its first touch, or at once where opening
            the dataset opens all shards.
        ValueError: arguments that do not fit, or that would do nothing; a dataset of which no
            shard is finished; a radius with which no problem has a path; conditions that no random
            problem on such maps can meet.
    """

    _opened = ("reader", "source")

    def __init__(
        self,
        root: Locations,
        split: str | None = None,
        fields: Sequence[str | FieldFunction] = DEFAULT_FIELDS,
        *,
        problems: SourceLike = "route",
        search: str = "astar",
        movement: MovementLike | None = None,
        augment: bool = False,
        sampling_seed: int = 0,
        max_length: int | None = None,
        dtype: torch.dtype | str | None = None,
        transform: Transform | None = None,
        radius: float = 0.0,
        follow_links: bool = False,
    ) -> None:
        """Read the manifests; shards are opened at first touch, or now (see ``movement``)."""
        serving = Serving(
            fields=fields,
            problems=problem_source(problems),
            search=search,
            movement=as_movement(movement),
            augment=augment,
            sampling_seed=sampling_seed,
            max_length=max_length,
            dtype=dtype,
            transform=transform,
            radius=radius,
        )
        super().__init__(split, serving)
        self.roots = locations(root)
        self._follow_links = follow_links
        self.filters: tuple[dict[str, Any], ...] = ()
        self._open()
        reader = self.reader
        self._content_hashes = [manifest.content_hash for manifest in reader.manifests]
        self._max_seed_points = reader.max_seed_points
        self._check_on_maps()
        if radius and len(self) == 0 and len(self.reader) > 0:
            rows, columns = self.map_size
            raise ValueError(
                f"radius: got {radius:g} m, with which none of the {len(self.reader)} problems of "
                f"{', '.join(self.roots)} (split={split!r}) has a path; take a smaller radius (the "
                f"maps are {rows} x {columns} cells of {reader.root.resolution:g} m)"
            )

    def _open(self) -> None:
        serving = self.serving
        reader = BatchReader(
            self.roots,
            self.split,
            serving.problems,
            serving.radius,
            serving.movement,
            self._follow_links,
        )
        movement = serving.movement or reader.movement
        maps = StoredMapSource(reader, movement, serving.radius, serving.sampling_seed)
        self.reader = reader
        if serving.problems.is_stored:
            self.source = StoredSource(maps, serving, movement, reader.solvable_problems())
        else:
            count = len(reader) * serving.problems.per_map
            self.source = DrawnSource(maps, serving, movement, count, draws_anew=True)

    def __repr__(self) -> str:
        root = self.roots[0] if len(self.roots) == 1 else self.roots
        arguments = f"{root!r}, split={self.split!r}, problems={self.serving.problems}"
        if self.serving.movement is not None:
            arguments += f", movement={self.serving.movement}"
        if self.serving.radius:
            arguments += f", radius={self.serving.radius}"
        hashes = [content_hash[:12] for content_hash in self._content_hashes]
        properties = f"map_size={self.map_size}, content_hash={hashes}"
        if not all(manifest.complete for manifest in self.reader.manifests):
            properties += ", of a dataset that is not finished"
        filters = self._filters_text()
        properties += self._epoch_note()
        return f"MapDataset({arguments}){filters}: {len(self)} problems, {properties}"

    def _filters_text(self) -> str:
        """Return the calls of `filter` that made this view, as code."""
        calls = []
        for conditions in self.filters:
            bands = ", ".join(f"{name}={band!r}" for name, band in conditions.items())
            calls.append(f".filter({bands})")
        return "".join(calls)

    def served_text(self) -> str:
        """Return which problems are served, in words."""
        filters = self._filters_text()
        return super().served_text() + (f"; {filters}" if filters else "")

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Open the dataset again, if it still holds the same maps.

        In another dataset the problems would have other numbers.
        """
        super().__setstate__(state)
        if [manifest.content_hash for manifest in self.reader.manifests] != self._content_hashes:
            raise ValueError(
                f"root: {', '.join(self.roots)}: other maps than when this dataset was opened; "
                "open it again"
            )
        # A worker may not know the family of the maps, and so not the number of rooms to pad to.
        self.reader.max_seed_points = self._max_seed_points
        for conditions in self.filters:
            self.source = self._matching(conditions)

    @property
    def info(self) -> DatasetInfo:
        """Where the maps come from, their counts, and what a sample holds.

        The shapes of the fields are those of the first sample, which is loaded for it.
        """
        recipes = []
        for manifest in self.reader.manifests:
            generator = manifest.generator
            recipe = None
            # `Recipe` refuses a generator whose family is not registered here.
            is_registered = unknown_family(generator) is None
            if generator is not None and is_registered and manifest.seed is not None:
                recipe = Recipe(generator, manifest.seed, manifest.maps, manifest.content_hash)
            recipes.append(recipe)
        resolutions = {manifest.resolution for manifest in self.reader.manifests}
        splits = SPLITS if self.split is None else (self.split,)
        return DatasetInfo(
            roots=self.roots,
            recipes=tuple(recipes),
            identities=tuple(manifest.identity for manifest in self.reader.manifests),
            content_hashes=tuple(self._content_hashes),
            map_counts={split: self._counts(Random())[split] for split in splits},
            problem_counts={split: self._problem_counts()[split] for split in splits},
            map_size=self.map_size,
            resolution=resolutions.pop() if len(resolutions) == 1 else None,
            movement=self.movement,
            has_terrain=self.has_terrain,
            fields=field_infos(self._load(np.array([0]), 0)) if len(self) else None,
        )

    def _counts(self, problems: Source) -> dict[str, int]:
        """Return the number of problems of each split, of random ones of an epoch."""
        totals = dict.fromkeys(SPLITS, 0)
        for _, _, entry in self.reader.shards:
            for split, count in stored_counts(entry, problems).items():
                totals[split] += count * problems.per_map
        return totals

    def _problem_counts(self) -> dict[str, int]:
        """Return the number of served problems of each split, after filters and radius."""
        if not isinstance(self.source, StoredSource) or self.source.selected is None:
            return self._counts(self.serving.problems)
        codes = self.reader.split_codes(self.reader.locate(self.source.selected))
        counts = np.bincount(codes, minlength=len(SPLITS)).tolist()
        return dict(zip(SPLITS, counts, strict=True))

    def filter(
        self,
        *,
        rooms: Band | None = None,
        path_length: Band | None = None,
        reachable: bool | None = None,
        all_connected: bool | None = None,
        hardness: Band | None = None,
        bends: Band | None = None,
    ) -> MapDataset:
        """Return a view on the stored problems that meet all conditions.

        Ranges are (lowest, highest), both included; None leaves a side open.

        Args:
            rooms: number of rooms of the map.
            path_length: number of cells of the path.
            reachable: whether the problem has a path (problems without one need
                ``Route(unsolvable=True)``).
            all_connected: whether all rooms of the map are connected.
            hardness: optimal cost over heuristic.
            bends: number of bends of the path's taut line (`mapdata.pull_taut`); up to T - 2 fit
                into T waypoints.

        Raises:
            ValueError: random problems, which are not stored; no condition; a range that is not two
                numbers in ascending order, or a condition that is no bool.
        """
        if not self.serving.problems.is_stored:
            raise ValueError(
                "filter: random problems are not stored; give Random(...) the conditions"
            )
        arguments = {
            "rooms": rooms,
            "path_length": path_length,
            "reachable": reachable,
            "all_connected": all_connected,
            "hardness": hardness,
            "bends": bends,
        }
        conditions: dict[str, Any] = {}
        for name, condition in arguments.items():
            if condition is None:
                continue
            if name in ("reachable", "all_connected"):
                check_flag(name, condition)
                conditions[name] = condition
            else:
                conditions[name] = check_band(name, condition)
        if not conditions:
            raise ValueError(f"filter: got no condition, expected one of {', '.join(arguments)}")
        view = copy(self)
        view.filters = (*self.filters, conditions)
        view.source = self._matching(conditions)
        return view

    def _matching(self, conditions: dict[str, Any]) -> StoredSource:
        """Return the problems of the source that meet conditions of `filter`."""
        assert isinstance(self.source, StoredSource)
        selected = self.source.numbers
        matching = []
        for numbers in np.split(selected, range(FILTER_BATCH, len(selected), FILTER_BATCH)):
            batch = self.source.batch_of_numbers(numbers)
            is_match = np.ones(len(numbers), np.bool_)
            for name, condition in conditions.items():
                quantity = CONDITIONS[name](batch)
                # A flag is a band of one number. The bounds are rounded to 32 bits, because
                # `hardness` is: a band would otherwise exclude a hardness at its end.
                band = np.array(condition, np.float32)
                lowest, highest = np.broadcast_to(band, 2)
                is_match &= (quantity >= lowest) & (quantity <= highest)
            matching.append(numbers[is_match])
        return self.source.select(np.concatenate(matching))

    def table(self, columns: Sequence[str] | None = None) -> pd.DataFrame:
        """Return a table of the maps of this split: the paper's items, and ours (docs/paper.md).

        Maps, paths, matrices and what is reachable are as stored, whatever movement and radius are
        served.

        Args:
            columns: names of the columns, in this order, such as ``["item", "rooms"]``; None for
                all of them. Only these are computed. Columns of one number a map, such as "rooms",
                take a hundredth of the time of those of paths and matrices.

        Raises:
            ValueError: there is no column of a name, or a name is given twice.
        """
        import pandas as pd

        from mapdata.describe.table import table_columns

        table: dict[str, list[Any]] = {}
        for k, (_, first_map, entry) in enumerate(self.reader.shards):
            shard = self.reader.open(k)
            of_shard = table_columns(shard, self.split, entry.maps, first_map, columns)
            for name, values in of_shard.items():
                table.setdefault(name, []).extend(values)
        return pd.DataFrame(table)
