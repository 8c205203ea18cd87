"""`MapDataset`: the problems of built datasets as torch samples."""

from __future__ import annotations

import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset, default_collate

from mapdata.arrays import Bytes, Ints
from mapdata.checks import check_choice, check_flag
from mapdata.datasets.arguments import DEFAULT_FIELDS, FieldFunction, Serving, torch_dtype
from mapdata.datasets.batches import BatchReader
from mapdata.datasets.fields import FIELDS, Batch, Field, Paths, Rooms, room_matrices
from mapdata.datasets.sample import Rows, Sample, cast, row, sample_class, stack
from mapdata.datasets.transforms import check_transform
from mapdata.limits import SPLITS, Size
from mapdata.movement import Movement
from mapdata.problems.sampling import sample_problems
from mapdata.problems.sources import Band, Random, Route, SourceLike, check_band, problem_source
from mapdata.problems.symmetry import sample_symmetries, transform_cells, transform_grids
from mapdata.search.lattice import move_rule
from mapdata.shards.locations import Locations

if TYPE_CHECKING:
    import pandas as pd

Transform = Callable[[Sample], Any]

Sampled = tuple[Bytes, Ints, Paths | None]
"""Problems sampled on B maps: the maps; start and goal on each, (B, 4), -1 where it has none; and
the paths, None where they are still to be searched."""

DRAWS = 32
"""How many random problems are tried on a sample's own map. On the maps that take its place they
are 3 DRAWS, 5 DRAWS and so on."""

MOST_DRAWS = 1_000_000
"""After so many in a row that do not fit, over all samples of a batch, there is an error."""

CONDITIONS: dict[str, Field] = {
    "rooms": lambda batch: (batch.rooms.seed_points[:, :, 0] >= 0).sum(axis=1),
    "path_length": FIELDS["length"],
    "reachable": lambda batch: np.diff(batch.paths.offsets) > 0,
    "all_connected": lambda batch: (batch.rooms.matrix != -1).all(axis=(1, 2)),  # -2 is padding
    "hardness": FIELDS["hardness"],
}
"""What the conditions of `MapDataset.filter` are about: a value for each problem of a batch."""


_MADE_AGAIN = ("reader", "_class", "_kept", "_numbers")
"""Attributes that are not pickled."""


class ProblemDataset(Dataset[Sample], ABC):
    """What both datasets share: indexing, fields, epochs, symmetries.

    ``dataset[i]`` is a `Sample`; ``dataset[2:9]`` and ``dataset[[4, 1]]`` are batches; a DataLoader
    gets whole batches made at once. With a ``transform``, ``dataset[i]`` is what it returns, and
    batches are stacked from such samples as a DataLoader does.

    A batch sampler may yield lists of ``index + epoch * len(dataset)``: what is drawn anew each
    epoch is a function of (sampling_seed, epoch, index), never of worker state. A plain
    ``dataset[i]`` is epoch 0, and i below the length.
    """

    movement: Movement
    """How the served paths move."""

    map_size: Size
    """(rows, columns) of all maps."""

    def __init__(
        self,
        split: str | None,
        serving: Serving,
        dtype: torch.dtype | str | None,
        transform: Transform | None,
    ) -> None:
        """Check and keep the arguments that `MapDataset` describes."""
        if split is not None:
            check_choice("split", split, SPLITS)
        if serving.augment and split in ("val", "test"):
            raise ValueError(
                f"augment: would change the split {split!r}, expected the training split"
            )
        check_transform(transform)
        self.split = split
        self.serving = serving
        self.dtype = torch_dtype(dtype, serving.names)
        self.transform = transform
        self._class = sample_class(serving.names, serving.max_length)
        # glibc hands freed blocks back to the system above a threshold that grows with the largest
        # block that was ever freed. Batches are below that size but above the threshold, so each
        # would fault all its pages in again, which costs more than filling them. So malloc keeps
        # the memory of past batches for the next ones. The block is never touched, so this takes
        # no memory.
        np.empty(31 << 20, np.uint8)

    @abstractmethod
    def __len__(self) -> int:
        """Return the number of problems."""

    def __getstate__(self) -> dict[str, Any]:
        """Pickle without file handles, data and classes made at run time."""
        return {name: value for name, value in vars(self).items() if name not in _MADE_AGAIN}

    def __getitem__(self, index: Any) -> Sample:
        if isinstance(index, slice):
            index = np.arange(*index.indices(len(self)))
        if np.ndim(index):
            rows = self.__getitems__(index)
            return rows.batch if isinstance(rows, Rows) else default_collate(rows)
        i = operator.index(index)
        if not -len(self) <= i < len(self):
            raise IndexError(f"index {i} is out of range for {len(self)} problems")
        sample: Sample = self.__getitems__([i])[0]
        return sample

    def __getitems__(self, indices: Sequence[int] | Ints | Tensor) -> Any:
        """Return a list of samples; torch's DataLoader calls this.

        Without a transform it only looks like a list: it is a whole batch, `Rows`, which torch's
        collate function takes as it is.
        """
        given = np.asarray(indices)
        length = len(self)
        if given.size and given.dtype.kind not in "iu":
            raise TypeError(f"indices: got {given.dtype}, expected integers")
        wanted = given.astype(np.int64).reshape(-1)
        if len(wanted) and (length == 0 or wanted.min() < -length):
            raise IndexError(f"index {wanted.min()} is out of range for {length} problems")
        wanted[wanted < 0] += length
        epochs, indices = np.divmod(wanted, length)
        epoch = epochs.max(initial=0)
        if (epochs == epoch).all():
            batch = self._make(indices, epoch)
        else:  # a batch is of one epoch
            singles = [self._make(indices[k : k + 1], each) for k, each in enumerate(epochs)]
            batch = stack([row(single, 0) for single in singles])
        rows = Rows(batch)
        if self.transform is None or not len(rows):
            return rows
        return [self.transform(sample) for sample in rows]

    def __iter__(self) -> Iterator[Sample]:
        return (self[i] for i in range(len(self)))

    def _make(self, indices: Ints, epoch: int) -> Sample:
        """Return the fields of problems ``indices``, batched."""
        batch = self._batch(indices, epoch)
        if self.serving.augment:
            batch = _transformed(batch, self.serving.sampling_seed, epoch)
        values = []
        for field in self.serving.fields:
            if isinstance(field, str):
                values.append(torch.from_numpy(np.ascontiguousarray(FIELDS[field](batch))))
            else:
                so_far = sample_class(self.serving.names[: len(values)])(*values)
                values.append(torch.as_tensor(field(so_far)))
        sample = self._class(*values)
        return sample if self.dtype is None else cast(sample, self.dtype)

    @abstractmethod
    def _grids(self, places: Ints) -> Bytes:
        """Return the maps at some places, (B, H, W).

        Place i is that of sample i; those beyond the samples are substitutes.
        """

    @abstractmethod
    def _seed_points(self, places: Ints) -> Ints:
        """Return the seed points of the maps at some places, (B, R, 2)."""

    def _rooms(self, places: Ints, grids: Bytes) -> Rooms:
        """Return the rooms of the maps at some places."""
        seed_points = self._seed_points(places)
        matrices = room_matrices(self.serving.search, grids, seed_points, self.movement)
        return Rooms(matrices, seed_points)

    @abstractmethod
    def _substitutes(self, indices: Ints, attempt: int) -> Ints:
        """Return the places of maps to try where those of samples ``indices`` have no problem.

        Attempts count from 1.
        """

    def _batch(self, indices: Ints, epoch: int) -> Batch:
        """Return problems ``indices`` of an epoch, before fields are made of them.

        Each is sampled on its own map, or on a substitute where that has none.
        """
        places = indices.copy()
        grids, ends, found = self._sample(places, indices, epoch, 0)
        tried = 0
        for attempt in count(1):
            missing = np.flatnonzero(ends[:, 0] < 0)
            if len(missing) == 0:
                break
            if tried > MOST_DRAWS:
                raise ValueError(f"problems={self.serving.problems}: none on one map after another")
            places[missing] = self._substitutes(indices[missing], attempt)
            grids[missing], ends[missing], more = self._sample(
                places[missing], indices[missing], epoch, attempt
            )
            if found and more:
                found = found.replaced(missing, more)
            tried += len(missing) * DRAWS * (2 * attempt + 1)
            if (ends[missing] >= 0).any():
                tried = 0
        starts = np.ascontiguousarray(ends[:, :2])
        goals = np.ascontiguousarray(ends[:, 2:])
        batch = self._as_batch(indices, places, grids, starts, goals)
        if found:
            batch.paths = found
        return batch

    def _sample(self, places: Ints, indices: Ints, epoch: int, attempt: int) -> Sampled:
        """Sample a problem on each of the maps at some places.

        Each attempt has draws of its own, so that what failed is not tried again on another map.
        They become more, since conditions that have failed are rare.
        """
        problems = self.serving.problems
        assert isinstance(problems, Random)
        grids = self._grids(places)
        ends, *found = sample_problems(
            grids,
            self._seed_points(places)[:, 0] if problems.to_first_seed_point else None,
            np.uint64(self.serving.sampling_seed),
            epoch,
            indices,
            (DRAWS * attempt**2, DRAWS * (attempt + 1) ** 2),
            *problems.conditions,
            move_rule(self.movement),
        )
        # Conditions may need the paths, which A* finds; what was found is not searched again.
        is_found = len(found[0]) and self.serving.search == "astar"
        return grids, ends, Paths(*found) if is_found else None

    def _as_batch(
        self, indices: Ints, places: Ints, grids: Bytes, starts: Ints, goals: Ints
    ) -> Batch:
        return Batch(
            self.movement,
            self.serving.search,
            grids,
            starts,
            goals,
            indices,
            lambda: self._rooms(places, grids),
            self.serving.names,
            self.serving.max_length,
        )


class MapDataset(ProblemDataset):
    """The problems of one or more built datasets, as torch samples.

    Args:
        root: folder or fsspec URL of a dataset, or a list of them with one map size and movement.
        split: "train", "val", "test" or None for all.
        fields: names of `fields.FIELDS` or functions of the batch so far (a `Sample`), in the order
            of the sample.
        problems: what is asked of the maps: a `Route`, `Pairs` or `Random`, or its name, "route"
            (the stored segments between consecutive rooms), "pairs" (all pairs of rooms i < j) or
            "random" (one problem a map, sampled anew each epoch); or plain JSON, ``{"random":
            {"distance": [10, null]}}``. Problems of length 0 are left out. So are those that have
            no path under the movement and radius that are served, unless it is
            ``Route(unsolvable=True)`` or ``Pairs(unsolvable=True)``.
        search: "astar" or "bfs", whose paths, costs, iterations and matrices are served.
        movement: None for the stored one; under another, problems are solved on the fly. If one of
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

    Raises:
        DatasetNotFoundError: no dataset under a root; the message names the command that makes one.
        ShardError: a damaged or hostile file, found at its first touch, or at once where opening
            the dataset opens all shards.
        ValueError: arguments that do not fit, or that would do nothing; a dataset of which no
            shard is finished.
    """

    def __init__(
        self,
        root: Locations,
        split: str | None = None,
        fields: Sequence[str | FieldFunction] = DEFAULT_FIELDS,
        *,
        problems: SourceLike = "route",
        search: str = "astar",
        movement: Movement | None = None,
        augment: bool = False,
        sampling_seed: int = 0,
        max_length: int | None = None,
        dtype: torch.dtype | str | None = None,
        transform: Transform | None = None,
        radius: float = 0.0,
    ) -> None:
        """Read the manifests; shards are opened at first touch, or now (see ``movement``)."""
        source = problem_source(problems)
        serving = Serving(
            fields, source, search, movement, augment, sampling_seed, max_length, radius
        )
        super().__init__(split, serving, dtype, transform)
        reader = BatchReader(root, split, source, radius, movement)
        self.reader = reader
        self.roots = reader.root.locations
        self._content = [manifest.content_hash for manifest in reader.manifests]
        self._most_seed_points = reader.most_seed_points
        self.movement = movement or reader.movement
        self.map_size = reader.map_size
        self.filters: tuple[dict[str, Any], ...] = ()
        # Labels are stored for the maps as they are and for one movement: others are solved anew.
        self._is_stored = self.movement == reader.movement and reader.least <= 1
        self._kept = reader.solvable()

    def __len__(self) -> int:
        """Return the number of problems."""
        return len(self.reader) if self._kept is None else len(self._kept)

    def __repr__(self) -> str:
        filters = "".join(
            f".filter({', '.join(f'{k}={v!r}' for k, v in each.items())})" for each in self.filters
        )
        where = self.roots[0] if len(self.roots) == 1 else self.roots
        arguments = f"{where!r}, split={self.split!r}, problems={self.serving.problems}"
        if self.serving.radius:
            arguments += f", radius={self.serving.radius}"
        content = [each[:12] for each in self._content]
        known = f"map_size={self.map_size}, content_hash={content}"
        if not all(each.complete for each in self.reader.manifests):
            known += ", of a dataset that is not finished"
        return f"MapDataset({arguments}){filters}: {len(self)} problems, {known}"

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Open it again, if it still is the same: in another one its problems have other places."""
        MapDataset.__init__(self, state["roots"], **arguments_of(state))
        if self._content != state["_content"]:
            raise ValueError(
                f"root: {', '.join(self.roots)}: other maps than when this dataset was opened; "
                "open it again"
            )
        vars(self).update(state)
        # A worker may not know the family of the maps, and so not how far to pad their seed points.
        self.reader.most_seed_points = self._most_seed_points
        for conditions in self.filters:
            self._kept = self._matching(conditions)

    def filter(
        self,
        *,
        rooms: Band | None = None,
        path_length: Band | None = None,
        reachable: bool | None = None,
        all_connected: bool | None = None,
        hardness: Band | None = None,
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

        Raises:
            ValueError: random problems, which are not stored; no condition; a range that is not two
                numbers in ascending order, or a condition that is no bool.
        """
        if isinstance(self.serving.problems, Random):
            raise ValueError(
                "filter: random problems are not stored; give Random(...) the conditions"
            )
        given = {
            "rooms": rooms,
            "path_length": path_length,
            "reachable": reachable,
            "all_connected": all_connected,
            "hardness": hardness,
        }
        conditions = {name: value for name, value in given.items() if value is not None}
        if not conditions:
            raise ValueError(f"filter: got no condition, expected one of {', '.join(given)}")
        for name, value in conditions.items():
            if name in ("reachable", "all_connected"):
                check_flag(name, value)
            else:
                conditions[name] = check_band(name, value)
        view = object.__new__(type(self))
        vars(view).update(vars(self))
        view.filters = (*self.filters, conditions)
        view._kept = self._matching(conditions)
        return view

    def _matching(self, conditions: dict[str, Any]) -> Ints:
        """Return the numbers of the problems that meet conditions of `filter`."""
        indices = np.arange(len(self.reader)) if self._kept is None else self._kept
        found = []
        for part in np.split(indices, range(4096, len(indices), 4096)):  # memory stays flat
            batch = self._stored_batch(part)
            meets = np.ones(len(part), np.bool_)
            for name, wanted in conditions.items():
                # One value is both. The hardness is of 32 bits, too, or its ends were not in it.
                lowest, highest = np.broadcast_to(np.array(wanted, np.float32), 2)
                values = CONDITIONS[name](batch)
                meets &= (values >= lowest) & (values <= highest)
            found.append(part[meets])
        return np.concatenate(found)

    def table(self) -> pd.DataFrame:
        """Return a table of the maps of this split: the paper's items, and ours (docs/paper.md).

        Maps, paths, matrices and what is reachable are as stored, whatever movement and radius are
        served.
        """
        import pandas as pd

        from mapdata.describe.table import map_rows

        rows = []
        for k, (_, first, entry) in enumerate(self.reader.shards):
            rows += map_rows(self.reader.open(k), self.split, entry.maps, first)
        return pd.DataFrame(rows)

    def _batch(self, indices: Ints, epoch: int) -> Batch:
        if self._kept is not None:
            indices = self._kept[indices]
        if isinstance(self.serving.problems, Random):
            return super()._batch(indices, epoch)
        return self._stored_batch(indices)

    def _stored_batch(self, indices: Ints) -> Batch:
        reader = self.reader
        shards, maps, first, second = reader.find(indices)
        grids = reader.grids(shards, maps)
        starts = reader.seed_points(shards, maps, first)
        goals = reader.seed_points(shards, maps, second)
        batch = self._as_batch(indices, indices, grids, starts, goals)
        if isinstance(self.serving.problems, Route) and self._is_stored:
            batch.find_paths = lambda: reader.paths(shards, maps, first, self.serving.search)
        return batch

    def _grids(self, places: Ints) -> Bytes:
        shards, maps, _, _ = self.reader.find(places)
        return self.reader.grids(shards, maps)

    def _stored_rooms(self, places: Ints) -> Rooms:
        shards, maps, _, _ = self.reader.find(places)
        return self.reader.rooms(shards, maps, self.serving.search)

    def _seed_points(self, places: Ints) -> Ints:
        return self._stored_rooms(places).seed_points

    def _rooms(self, places: Ints, grids: Bytes) -> Rooms:
        return self._stored_rooms(places) if self._is_stored else super()._rooms(places, grids)

    def _substitutes(self, indices: Ints, attempt: int) -> Ints:
        return (indices + attempt) % len(self.reader)


def _transformed(batch: Batch, seed: int, epoch: int) -> Batch:
    """Return the batch after the symmetries drawn for its problems; everything moves along."""
    rows, columns = batch.grids.shape[1:]
    codes = sample_symmetries(np.uint64(seed), epoch, batch.problems, rows == columns)

    def transformed(cells: Ints, each: Ints | int = 1) -> Ints:
        """Return cells (..., 2), of which ``each`` says how many a problem has."""
        flat = transform_cells(cells.reshape(-1, 2), np.repeat(codes, each), rows, columns)
        return flat.reshape(cells.shape)

    def paths() -> Paths:
        found = batch.paths
        return found._replace(cells=transformed(found.cells, np.diff(found.offsets)))

    def rooms() -> Rooms:
        seed_points = batch.rooms.seed_points
        return batch.rooms._replace(seed_points=transformed(seed_points, seed_points.shape[1]))

    return replace(
        batch,
        grids=transform_grids(batch.grids, codes),
        starts=transformed(batch.starts),
        goals=transformed(batch.goals),
        find_paths=paths,
        find_rooms=rooms,
    )


def arguments_of(state: dict[str, Any], *own: str) -> dict[str, Any]:
    """Return the arguments of a pickled dataset: those that both datasets take, and ``own``."""
    given = {name: state[name] for name in ("split", "dtype", "transform", *own)}
    return {**vars(state["serving"]), **given}
