"""`MapDataset`: the problems of built datasets as torch samples."""

from __future__ import annotations

import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset, default_collate, get_worker_info

from mapdata.arrays import Bytes, Ints, offsets_of, places_of_mask
from mapdata.checks import check_choice, check_flag
from mapdata.datasets.arguments import (
    DEFAULT_FIELDS,
    FieldFunction,
    MovementLike,
    Serving,
    Transform,
    as_movement,
    field_names,
    torch_dtype,
)
from mapdata.datasets.batches import BatchReader, stored_counts
from mapdata.datasets.fields import (
    FIELD_CLASSES,
    FIELDS,
    NO_TAUT_LINES,
    Batch,
    Field,
    Paths,
    Rooms,
    StoredMaps,
    divided_lines,
    room_matrices,
)
from mapdata.datasets.info import DatasetInfo, field_infos
from mapdata.datasets.problem_statistics import SAMPLE, measure
from mapdata.datasets.repeats import RepeatWatch, warn_of_repeats
from mapdata.datasets.sample import Rows, Sample, cast, row, sample_class, stack
from mapdata.describe.dataset_card import movement_text
from mapdata.describe.problem_statistics import ProblemStatistics
from mapdata.generators.recipe import Recipe
from mapdata.generators.stored_families import unknown_family
from mapdata.limits import SPLITS, Size
from mapdata.movement import Movement
from mapdata.problems.nearest import nearest_text, nothing_seen, see_values
from mapdata.problems.sampling import sample_problems
from mapdata.problems.sources import (
    MAX_CELL_COST,
    Band,
    Random,
    Route,
    Source,
    SourceLike,
    check_band,
    check_possible,
    plain_text,
    problem_source,
)
from mapdata.problems.substitutes import RARE_SHARE, draw_substitutes, most_maps, say_rare
from mapdata.problems.symmetry import sample_symmetries, transform_cells, transform_grids
from mapdata.search.api import check_cost
from mapdata.search.labels import labels_serve
from mapdata.search.lattice import MAX_PATH_COST, move_rule
from mapdata.search.map_stack import MapStack
from mapdata.shards.locations import Locations, locations
from mapdata.shards.workers import Advance, no_bar

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

DRAWS = 32
"""How many goals are drawn on a map for a random problem, before another map takes its place."""

CELLS_AT_ONCE = 2**20
"""Cells of the maps that problems are sampled on at once: 256 maps of 64 x 64.

More of them would keep a progress bar waiting where problems are rare.
"""

_process = {"said_rare": False}
"""Whether this process has said that problems are rare."""

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


class SampledProblems(NamedTuple):
    """Problems that were sampled on B maps.

    Attributes:
        stored_maps: the maps before inflation.
        grids: (B, H, W) uint8, the maps as served.
        ends: (B, 4) int64, row and column of start and goal, -1 where no problem was found.
        paths: their paths; None if they are not searched yet.
    """

    stored_maps: StoredMaps
    grids: Bytes
    ends: Ints
    paths: Paths | None

    def with_rows(self, rows: Ints, others: SampledProblems, places: Ints) -> SampledProblems:
        """Return these problems with number ``rows[k]`` replaced by number ``places[k]`` of others.

        The arrays are changed in place; paths are copied.
        """
        self.grids[rows] = others.grids[places]
        self.ends[rows] = others.ends[places]
        stored_maps = self.stored_maps
        new_maps = others.stored_maps
        stored_maps.numbers[rows] = new_maps.numbers[places]
        stored_maps.maps.overwrite(rows, new_maps.maps, places)  # without inflation, the same grids
        if self.paths is None or others.paths is None:
            return self
        return self._replace(paths=self.paths.with_rows(rows, others.paths, places))


def joined(parts: Sequence[SampledProblems]) -> SampledProblems:
    """Return the problems of all parts, one part after another."""
    stored_maps = [part.stored_maps for part in parts]
    maps = MapStack.joined([stored.maps for stored in stored_maps])
    # Without inflation the maps as served are the stored ones themselves.
    grids = maps.grids
    if parts[0].grids is not stored_maps[0].maps.grids:
        grids = np.concatenate([part.grids for part in parts])
    return SampledProblems(
        StoredMaps(np.concatenate([stored.numbers for stored in stored_maps]), maps),
        grids,
        np.concatenate([part.ends for part in parts]),
        _joined_paths([part.paths for part in parts]),
    )


def _joined_paths(parts: Sequence[Paths | None]) -> Paths | None:
    """Return the paths of all parts, one part after another; None if a part has none."""
    paths = [part for part in parts if part is not None]
    if len(paths) < len(parts):
        return None
    return Paths(
        np.concatenate([part.cells for part in paths]),
        offsets_of(np.concatenate([np.diff(part.offsets) for part in paths])),
        np.concatenate([part.iterations for part in paths]),
    )


@cache
def keep_freed_memory() -> None:
    """Make malloc keep the memory of past batches for the next ones, once for each process.

    Above a threshold glibc gives the memory of a freed block back to the system, and a new block
    faults in all of its pages again, which takes longer than filling them. The threshold grows to
    the size of the largest block that was freed, up to 32 MiB. So a block of 31 MiB, more than
    batches take, is allocated and freed here. It is never written, so it takes no memory.
    """
    np.empty(31 * 2**20, np.uint8)


class ProblemDataset(Dataset[Sample], ABC):
    """Indexing, fields, epochs and symmetries: the part that all datasets share.

    ``dataset[i]`` is a `Sample`. ``dataset[2:9]``, ``dataset[[4, 1]]`` and ``dataset[mask]``, with
    a bool for each problem, are batches. A DataLoader gets whole batches that are computed at once.
    With a ``transform``, ``dataset[i]`` is what it
    returns, and batches are stacked from such samples as a DataLoader does.

    A batch sampler may yield lists of ``index + epoch * len(dataset)``: what is drawn anew each
    epoch is a function of (sampling_seed, epoch, index), never of worker state. A plain
    ``dataset[i]`` is epoch 0, and i below the length.
    """

    movement: Movement
    """Movement of the served paths."""

    map_size: Size
    """(rows, columns) of all maps."""

    has_terrain: bool
    """Whether the maps have terrain: free cells that cost different amounts."""

    _opened: ClassVar[tuple[str, ...]]
    """Attributes that `_open` sets. They are not pickled: each process opens the files itself."""

    def __init__(self, split: str | None, serving: Serving) -> None:
        """Check and keep the arguments that `MapDataset` describes."""
        if split is not None:
            check_choice("split", split, SPLITS)
        if serving.augment and split in ("val", "test"):
            raise ValueError(
                f"augment: would change the split {split!r}, expected the training split"
            )
        if serving.has_jitter and split in ("val", "test"):
            raise ValueError(
                f"jitter: would change the pictures of the split {split!r}, expected Tiles without "
                "jitter, or the training split"
            )
        self.split = split
        self.serving = serving
        self._field_names = serving.names
        self.dtype = torch_dtype(serving.dtype, serving.names)
        self.transform = serving.transform
        self._watch = RepeatWatch() if self._drawn_anew else None
        keep_freed_memory()

    @property
    def _drawn_anew(self) -> str:
        """What is drawn anew each epoch: "problems", "symmetries", "light" or "" for nothing."""
        if isinstance(self.serving.problems, Random):
            return "problems"
        if self.serving.augment:
            return "symmetries"
        return "light" if self.serving.has_jitter else ""

    def _epoch_note(self) -> str:
        """Return what `repr` says of epochs; nothing if all epochs serve the same samples."""
        if not self._drawn_anew:
            return ""
        return f", {self._drawn_anew} of epoch 0 unless a sampler gives the epoch"

    def expect_epochs(self) -> None:
        """Never warn of repeated draws: a sampler gives the epochs."""
        self._watch = None

    def _check_fields_on_terrain(self) -> None:
        """Refuse fields that do not exist on terrain.

        Raises:
            ValueError: waypoints, where the maps have terrain.
        """
        if self.has_terrain and "waypoints" in self._field_names:
            raise ValueError(f"fields: {NO_TAUT_LINES}")

    @abstractmethod
    def __len__(self) -> int:
        """Return the number of problems."""

    @property
    @abstractmethod
    def info(self) -> DatasetInfo:
        """Where the maps come from, their counts, and what a sample holds."""

    @abstractmethod
    def _open(self) -> None:
        """Set the attributes of `_opened` from all other attributes."""

    def __copy__(self) -> Any:
        """Return a copy that shares the open shards."""
        copied = type(self).__new__(type(self))
        vars(copied).update(vars(self))
        copied._watch = RepeatWatch() if self._drawn_anew else None
        return copied

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes that are pickled: all but those that `_open` sets."""
        state = {name: v for name, v in vars(self).items() if name not in self._opened}
        # A process that gets the dataset pickled, such as a loader worker, reads a part of a pass.
        return {**state, "_watch": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over the pickled attributes, and open the dataset again."""
        vars(self).update(state)
        keep_freed_memory()
        self._open()

    def __getitem__(self, index: Any) -> Sample:
        if isinstance(index, slice):
            index = np.arange(*index.indices(len(self)))
        index = self._without_mask(index)
        if np.ndim(index):
            samples = self._serve(index)
            return samples.batch if isinstance(samples, Rows) else default_collate(samples)
        sample: Sample = self._serve([self._checked_index(index)])[0]
        return sample

    def __getitems__(self, indices: Sequence[int] | Ints | Tensor) -> Any:
        """Return a list of samples; torch's DataLoader calls this.

        Without a transform the list is a whole batch, `Rows`, which torch's collate function takes
        as it is.

        Args:
            indices: ``index + epoch * len(dataset)`` each; a negative index counts from the end.
        """
        return self._serve(indices, self._watch)

    def _serve(
        self, indices: Sequence[int] | Ints | Tensor, watch: RepeatWatch | None = None
    ) -> Any:
        """Return a list of samples as `__getitems__`, which only a loader calls, and which watches.

        Without a transform the list is a whole batch, `Rows`, which torch's collate function takes
        as it is.

        Args:
            indices: ``index + epoch * len(dataset)`` each; a negative index counts from the end.
            watch: what finds out whether passes repeat each other, or None.
        """
        numbers = np.asarray(indices)
        length = len(self)
        if numbers.size and numbers.dtype.kind not in "iu":
            raise TypeError(f"indices: got {numbers.dtype}, expected integers")
        numbers = numbers.astype(np.int64).reshape(-1)
        if len(numbers) and (length == 0 or numbers.min() < -length):
            raise IndexError(f"index {numbers.min()} is out of range for {length} problems")
        numbers[numbers < 0] += length
        epochs, problems = np.divmod(numbers, length)
        last_epoch = epochs.max(initial=0)
        if watch is not None and len(numbers):
            if last_epoch > 0:
                self.expect_epochs()
            elif watch.sees_repeats(problems, length):
                warn_of_repeats(self._drawn_anew)
                self.expect_epochs()
        if (epochs == last_epoch).all():
            batch = self._load(problems, last_epoch)
        else:  # `_load` takes one epoch only
            batches = [self._load(problems[k : k + 1], epoch) for k, epoch in enumerate(epochs)]
            batch = stack([row(batch_of_one, 0) for batch_of_one in batches])
        samples = Rows(batch)
        if self.transform is None or not len(samples):
            return samples
        return [self.transform(sample) for sample in samples]

    def __iter__(self) -> Iterator[Sample]:
        return (self[i] for i in range(len(self)))

    def plot(self, index: int | Sequence[int] = 0, axes: Axes | None = None) -> Axes:
        """Draw a problem: its map, start S, goal G and path, whichever fields are served.

        The first dense field among the served ones, such as ``cost_to_go``, is drawn as a shade;
        without one, the costs of the terrain if the maps have any. All problems of a grid have one
        scale, and free cells that cannot reach the goal are grey. A ``transform`` is not applied.
        ``dataset.plot(0).figure.savefig("map.png")`` writes a picture.

        Args:
            index: which problem, or up to 9 of several for a grid of them; a mask selects problems.
            axes: where to draw one problem; a new figure without.

        Returns:
            The axes; of several problems those of the first one.

        Raises:
            IndexError: no such problem.
            ValueError: no problem at all, or axes for several.
        """
        # The face of the folder imports a lot that loading does not need.
        from mapdata.plotting.plot_models import MAX_SAMPLES, plot_sample

        numbers = np.atleast_1d(self._without_mask(index))
        indices = [self._checked_index(i) for i in numbers[:MAX_SAMPLES]]
        terrain_field = ("terrain",) if self.has_terrain else ()
        fields = tuple(dict.fromkeys((*DEFAULT_FIELDS, *self.serving.fields, *terrain_field)))
        batch = self._batch(np.array(indices, np.int64), epoch=0)
        samples = self._compute_fields(batch, fields, field_names(fields))
        return plot_sample(row(samples, 0) if np.ndim(index) == 0 else samples, axes)

    def problem_statistics(self, sample: int = SAMPLE) -> ProblemStatistics:
        """Return whether the served problems need a planner, and whether their paths are unique.

        Nothing is measured before this method is called. On maps of 64 x 64 cells it takes less
        than a second. Shortest paths are those of least cost, with ``search="bfs"`` too.
        Symmetries (``augment``) change none of the statistics.

        Args:
            sample: how many problems are measured, evenly spread over the dataset and always the
                same; all if there are fewer. On maps of more than 5,000 cells they are as many as
                have together ``5000 * sample`` cells, but at least 10.

        Raises:
            ValueError: ``sample`` is less than one.
        """
        return measure(self, sample)

    def _served(self) -> str:
        """Return which problems are served, in words."""
        parts = [plain_text(self.serving.problems), movement_text(self.movement, self.has_terrain)]
        if self.split is not None:
            parts.append(f"split {self.split}")
        if self.serving.radius:
            parts.append(f"radius {self.serving.radius:g} m")
        return "; ".join(parts)

    @abstractmethod
    def _problems_text(self) -> str:
        """Return which problems are served, in words that no other problems have.

        They do not depend on where the files of the maps are.
        """

    def _own_maps(self, problems: Ints) -> Ints | None:
        """Return the maps on which problems are drawn first, as ``map_index`` numbers them.

        None for problems that are not drawn, and so never on another map.
        """
        return None

    def _without_mask(self, index: Any) -> Any:
        """Return the numbers of the problems that a mask selects; any other index as it is.

        Raises:
            IndexError: a mask of another length than the dataset.
        """
        if np.ndim(index) == 0:
            return index
        array = np.asarray(index)
        return places_of_mask(array, len(self)) if array.dtype == np.bool_ else index

    def _checked_index(self, index: Any) -> int:
        """Return an index as an int.

        Raises:
            IndexError: it is out of range.
            TypeError: it is no integer.
        """
        if isinstance(index, (bool, np.bool_)):
            raise TypeError(f"index: got {index}, expected an integer, or a mask of all problems")
        i = operator.index(index)
        if not -len(self) <= i < len(self):
            raise IndexError(f"index {i} is out of range for {len(self)} problems")
        return i % len(self)

    def _load(self, indices: Ints, epoch: int) -> Sample:
        """Return the served fields of problems ``indices`` of an epoch, as a batch."""
        batch = self._batch(indices, epoch)
        sample = self._compute_fields(batch, self.serving.fields, self._field_names)
        return sample if self.dtype is None else cast(sample, self.dtype)

    def _batch(self, indices: Ints, epoch: int) -> Batch:
        """Return problems ``indices`` of an epoch, transformed by symmetries if asked for."""
        batch = self._problems(indices, epoch)
        batch.sampling_seed = self.serving.sampling_seed
        batch.epoch = epoch
        if self.serving.augment:
            batch = _transformed(batch, self.serving.sampling_seed, epoch)
        return batch

    def _compute_fields(
        self, batch: Batch, fields: Sequence[str | FieldFunction], names: tuple[str, ...]
    ) -> Sample:
        """Return fields of a batch; a function gets the fields before it."""
        tensors: list[Tensor] = []
        for field in fields:
            if isinstance(field, (str, *FIELD_CLASSES)):
                compute = FIELDS[field] if isinstance(field, str) else field
                array = np.ascontiguousarray(compute(batch))
                tensors.append(torch.from_numpy(array))
            else:
                batch_so_far = sample_class(names[: len(tensors)])(*tensors)
                count = len(batch.grids)
                tensors.append(_field_tensor(names[len(tensors)], field(batch_so_far), count))
        sample: Sample = sample_class(names, self.serving.max_length)(*tensors)
        return sample

    @abstractmethod
    def _problems(self, indices: Ints, epoch: int) -> Batch:
        """Return problems ``indices`` of an epoch, before any symmetry."""


class SampledProblemDataset(ProblemDataset):
    """Random problems on the maps of a split: what `MapDataset` and `OnlineMapDataset` share.

    Map p is the p-th map of the split. Problem i is first sampled on map i, or on map ``i // k`` if
    there are k problems per map.
    """

    _min_clearance: int
    """Clearance of the cells that are served as free, as from `min_squared_clearance`."""

    report_tried: Advance = staticmethod(no_bar)
    """Called with the number of maps on which problems were sought just now, for a progress bar."""

    def _check_on_maps(self) -> None:
        """Refuse fields and problems that do not exist on these maps.

        Raises:
            ValueError: as `_check_fields_on_terrain` and `check_possible`.
        """
        self._check_fields_on_terrain()
        check_possible(
            self.serving.problems, self.map_size, self.movement, has_terrain=self.has_terrain
        )

    def _problems_text(self) -> str:
        """Return what the problems are a function of: conditions, maps, and the seed of draws."""
        hashes = ", ".join(map_hash[:12] for map_hash in self._map_hashes())
        text = f"{self._served()}; maps {hashes}"
        if self._drawn_anew == "problems":
            text += f"; sampling_seed {self.serving.sampling_seed}"
        return text

    @abstractmethod
    def _map_hashes(self) -> Sequence[str]:
        """Return hashes that identify the maps."""

    @abstractmethod
    def _stored_maps(self, map_numbers: Ints) -> StoredMaps:
        """Return maps by their numbers in the split, before inflation."""

    @abstractmethod
    def _map_indices(self, map_numbers: Ints) -> Ints:
        """Return the numbers in the dataset of maps that have these numbers in the split, (B,)."""

    def _own_maps(self, problems: Ints) -> Ints | None:
        source = self.serving.problems
        is_stored = not isinstance(source, Random)
        return None if is_stored else self._map_indices(problems // source.per_map)

    @abstractmethod
    def _radius_in_cells(self) -> float:
        """Return the radius of the robot in cells."""

    @abstractmethod
    def _seed_points(self, map_numbers: Ints) -> Ints:
        """Return the seed points of maps by their numbers, (B, R, 2)."""

    def _rooms(
        self, map_numbers: Ints, grids: Bytes, compute_stored_maps: Callable[[], StoredMaps]
    ) -> Rooms:
        """Return the rooms of maps, solved anew.

        Args:
            map_numbers: (B,) numbers of the maps in the split.
            grids: (B, H, W), the maps as served.
            compute_stored_maps: returns the maps before inflation.
        """
        seed_points = self._seed_points(map_numbers)
        numbers = map_numbers
        maps = MapStack(grids, None)
        if self.serving.search == "astar" and self.has_terrain:
            numbers, stored_maps = compute_stored_maps()
            maps = stored_maps.with_grids(grids)
        search = self.serving.search
        matrices = room_matrices(search, numbers, maps, seed_points, self.movement)
        return Rooms(matrices, seed_points)

    def _inflated(self, stored_grids: Bytes) -> Bytes:
        """Return grids (B, H, W) after inflation by the radius of the robot.

        Without a radius they are the stored ones themselves.
        """
        return MapStack(stored_grids, None).inflated(self._min_clearance).grids

    @abstractmethod
    def _substitutes(self, indices: Ints, epoch: int, numbers: Ints) -> Ints:
        """Return the maps that take the place of those without a problem, (B,).

        docs/format.md, section 6, has the rule.

        Args:
            indices: (B,) numbers of the problems.
            epoch: pass over the data.
            numbers: (B,) which substitute of the problem it is, from 1 on.
        """

    def _problems(self, indices: Ints, epoch: int) -> Batch:
        """Return problems ``indices`` of an epoch.

        Each of them is sampled on its own map, or on a substitute if that map has none. Which one
        depends on the problem and its maps alone, never on the batch or on other problems.

        Raises:
            ValueError: a problem is on none of as many maps as `most_maps` allows.
        """
        maps = indices // self.serving.problems.per_map
        problems = self._sample_in_parts(maps, indices, epoch)
        most = most_maps(self.serving.problems, self.map_size, DRAWS)
        tried = np.ones(len(indices), np.int64)  # maps of each problem
        failed_in_a_row = 0  # maps of any problem of the batch
        missing = np.flatnonzero(problems.ends[:, 0] < 0)
        while len(missing):
            # After many failures in a row the first problem is sought alone. So the error comes
            # when one problem has been sought in vain, not when all of the batch have been.
            rows = missing[: self._maps_at_once] if failed_in_a_row < most // 8 else missing[:1]
            if (tried[rows] >= most).any():
                row = rows[np.argmax(tried[rows] >= most)]
                raise ValueError(self._no_problem_complaint(int(indices[row]), epoch, most))
            ahead = self._substitutes_ahead(tried[rows], most)
            repeated_rows = np.repeat(rows, ahead)
            numbers = tried[repeated_rows] + np.tile(np.arange(ahead), len(rows))
            tried_indices = indices[repeated_rows]
            tried_maps = self._substitutes(tried_indices, epoch, numbers)
            # A substitute has draws of its own, those of a problem beyond the end of the dataset.
            keys = tried_indices + numbers * len(self)
            sampled = self._sample(tried_maps, keys, epoch)
            self.report_tried(len(tried_maps))
            tried[rows] += ahead
            self._say_rare(tried, len(missing), most)
            places = np.flatnonzero(sampled.ends[:, 0] >= 0)
            failed_in_a_row = 0 if len(places) else failed_in_a_row + len(tried_maps)
            found_rows, first_places = np.unique(repeated_rows[places], return_index=True)
            places = places[first_places]  # the first success of each problem
            if len(places):
                maps[found_rows] = tried_maps[places]
                problems = problems.with_rows(found_rows, sampled, places)
                missing = np.setdiff1d(missing, found_rows)
        stored_maps = problems.stored_maps
        starts = np.ascontiguousarray(problems.ends[:, :2])
        goals = np.ascontiguousarray(problems.ends[:, 2:])
        batch = self._as_batch(indices, maps, problems.grids, starts, goals, lambda: stored_maps)
        if problems.paths is not None:
            batch.paths = problems.paths
        return batch

    def _say_rare(self, tried: Ints, missing_count: int, most: int) -> None:
        """Say once in each process that a batch takes long, if no bar shows it.

        Args:
            tried: (B,) maps that were tried for each problem of the batch.
            missing_count: number of problems that were not found on the maps before the last ones.
            most: number of maps that are tried for a problem before there is an error.
        """
        failed = int(tried.sum()) - len(tried)
        worker = get_worker_info()
        if (
            failed < most // RARE_SHARE
            or _process["said_rare"]
            or self.report_tried is not no_bar
            or (worker is not None and worker.id > 0)  # one worker says it for all
        ):
            return
        _process["said_rare"] = True
        say_rare(
            f"{plain_text(self.serving.problems)}: no such problem at {failed:,} tries on a map, "
            f"and {missing_count:,} of {len(tried):,} problems of a batch still to find; wider "
            "conditions are faster"
        )

    @property
    def _maps_at_once(self) -> int:
        """The number of maps that problems are sampled on at once."""
        rows, columns = self.map_size
        return max(CELLS_AT_ONCE // (rows * columns), 1)

    def _substitutes_ahead(self, tried: Ints, most: int) -> int:
        """Return how many substitutes of each problem are tried at once.

        They are at most an eighth of those that have failed, so that little work is done in vain.
        On large maps with terrain it is one: a cost may be too high, which raises an error, and a
        map must not raise it that comes after the one that is served.

        Args:
            tried: (B,) maps that were tried for each problem.
            most: number of maps that are tried before there is an error.
        """
        rows, columns = self.map_size
        if self.has_terrain and rows * columns * MAX_CELL_COST * math.sqrt(2) > MAX_PATH_COST / 2:
            return 1
        ahead = min(tried.min() // 8, self._maps_at_once // len(tried), most - tried.max())
        return max(int(ahead), 1)

    def _tried_text(self, tries: int) -> str:
        """Return how many maps were tried for a problem."""
        return f"{tries:,} maps were tried"

    def _no_problem_complaint(self, index: int, epoch: int, most: int) -> str:
        """Return the error for a problem that is on none of its first ``most`` maps."""
        problems = self.serving.problems
        is_random = isinstance(problems, Random)
        text = f"problems: got {plain_text(problems)}: none on one map after another"
        text += f"; {self._tried_text(most)} for problem {index} of epoch {epoch}"
        if isinstance(problems, Random):
            text += f", and {self._nearest_text(problems, index, epoch, most)}"
        remedy = "wider conditions" if is_random else "other maps"
        if self.serving.radius:
            remedy += f", or a smaller radius than {self.serving.radius:g} m"
        return f"{text}; take {remedy}"

    def _nearest_text(self, problems: Random, index: int, epoch: int, most: int) -> str:
        """Return the values nearest to the conditions on the first ``most`` maps of a problem."""
        seen = nothing_seen()
        for first in range(0, most, self._maps_at_once):
            numbers = np.arange(first, min(first + self._maps_at_once, most))
            indices = np.full(len(numbers), index)
            maps = indices // problems.per_map
            is_substitute = numbers > 0
            maps[is_substitute] = self._substitutes(
                indices[is_substitute], epoch, numbers[is_substitute]
            )
            see_values(
                seen,
                self._stored_maps(maps).maps.inflated(self._min_clearance),
                self._given_goals(maps),
                self.serving.sampling_seed,
                epoch,
                indices + numbers * len(self),
                (0, DRAWS),
                problems,
                self.movement,
            )
        return nearest_text(seen, problems)

    def _given_goals(self, map_numbers: Ints) -> Ints | None:
        """Return the goals of random problems on maps, (B, 2); None if goals are drawn."""
        problems = self.serving.problems
        if isinstance(problems, Random) and problems.to_first_seed_point:
            return np.ascontiguousarray(self._seed_points(map_numbers)[:, 0])
        return None

    def _sample_in_parts(self, map_numbers: Ints, indices: Ints, epoch: int) -> SampledProblems:
        """Do what `_sample` does, with some of the maps at a time, which it reports."""
        parts = []
        for first in range(0, max(len(indices), 1), self._maps_at_once):
            part = slice(first, first + self._maps_at_once)
            parts.append(self._sample(map_numbers[part], indices[part], epoch))
            self.report_tried(len(indices[part]))
        return parts[0] if len(parts) == 1 else joined(parts)

    def _sample(self, map_numbers: Ints, keys: Ints, epoch: int) -> SampledProblems:
        """Sample a random problem on each map.

        Args:
            map_numbers: (B,) numbers of the maps in the split.
            keys: (B,) the index that the draws of each problem depend on.
            epoch: pass over the data.
        """
        problems = self.serving.problems
        assert isinstance(problems, Random)
        stored_maps = self._stored_maps(map_numbers)
        maps = stored_maps.maps.inflated(self._min_clearance)
        arguments = (
            self._given_goals(map_numbers),
            np.uint64(self.serving.sampling_seed),
            epoch,
            keys,
            (0, DRAWS),
            *problems.conditions,
            move_rule(self.movement),
        )
        # Without conditions the costs of cells do not matter, as no move costs less than 1.
        has_conditions = problems.conditions != Random().conditions
        searched = maps if has_conditions else MapStack(maps.grids, None)
        ends, row, high_cost = sample_problems(searched, *arguments)
        check_cost(stored_maps.numbers, row, high_cost)
        return SampledProblems(stored_maps, maps.grids, ends, paths=None)

    def _as_batch(
        self,
        indices: Ints,
        map_numbers: Ints,
        grids: Bytes,
        starts: Ints,
        goals: Ints,
        compute_stored_maps: Callable[[], StoredMaps],
    ) -> Batch:
        """Return problems as a batch whose paths are searched when they are needed."""
        return Batch(
            movement=self.movement,
            search=self.serving.search,
            grids=grids,
            starts=starts,
            goals=goals,
            problems=indices,
            compute_map_indices=lambda: self._map_indices(map_numbers),
            compute_rooms=lambda: self._rooms(map_numbers, grids, compute_stored_maps),
            compute_stored_maps=compute_stored_maps,
            symmetries=np.zeros(len(indices), np.int64),
            requested_fields=self._field_names,
            max_length=self.serving.max_length,
            radius_cells=self._radius_in_cells(),
            has_terrain=self.has_terrain,
        )


class MapDataset(SampledProblemDataset):
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

    _opened = ("reader", "_selected")

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
        self.movement = serving.movement or reader.movement
        self.map_size = reader.map_size
        self.has_terrain = reader.has_terrain
        self._min_clearance = reader.min_clearance
        self._check_on_maps()
        if radius and len(self) == 0 and len(self.reader) > 0:
            rows, columns = self.map_size
            raise ValueError(
                f"radius: got {radius:g} m, with which none of the {len(self.reader)} problems of "
                f"{', '.join(self.roots)} (split={split!r}) has a path; take a smaller radius (the "
                f"maps are {rows} x {columns} cells of {reader.root.resolution:g} m)"
            )
        # Labels are stored for one movement and for a robot without extent.
        self._labels_serve = labels_serve(reader.movement, self.movement, reader.min_clearance)

    def _open(self) -> None:
        serving = self.serving
        self.reader = BatchReader(
            self.roots,
            self.split,
            serving.problems,
            serving.radius,
            serving.movement,
            self._follow_links,
        )
        # The numbers of the problems that are served, ascending; None for all of them.
        self._selected = self.reader.solvable_problems()

    def __len__(self) -> int:
        """Return the number of problems."""
        if self._selected is not None:
            return len(self._selected)
        return len(self.reader) * self.serving.problems.per_map

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

    def _served(self) -> str:
        filters = self._filters_text()
        return super()._served() + (f"; {filters}" if filters else "")

    def _map_hashes(self) -> Sequence[str]:
        return self._content_hashes

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
            self._selected = self._matching(conditions)

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
        if self._selected is None:
            return self._counts(self.serving.problems)
        codes = self.reader.split_codes(self.reader.locate(self._selected))
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
        if isinstance(self.serving.problems, Random):
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
        view._selected = self._matching(conditions)
        return view

    def _matching(self, conditions: dict[str, Any]) -> Ints:
        """Return the numbers of the selected problems that meet conditions of `filter`."""
        selected = np.arange(len(self.reader)) if self._selected is None else self._selected
        matching = []
        for numbers in np.split(selected, range(FILTER_BATCH, len(selected), FILTER_BATCH)):
            batch = self._stored_problems(numbers)
            is_match = np.ones(len(numbers), np.bool_)
            for name, condition in conditions.items():
                quantity = CONDITIONS[name](batch)
                # A flag is a band of one number. The bounds are rounded to 32 bits, because
                # `hardness` is: a band would otherwise exclude a hardness at its end.
                band = np.array(condition, np.float32)
                lowest, highest = np.broadcast_to(band, 2)
                is_match &= (quantity >= lowest) & (quantity <= highest)
            matching.append(numbers[is_match])
        return np.concatenate(matching)

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

    def _problems(self, indices: Ints, epoch: int) -> Batch:
        numbers = indices if self._selected is None else self._selected[indices]
        if isinstance(self.serving.problems, Random):
            return super()._problems(numbers, epoch)
        return self._stored_problems(numbers)

    def _stored_problems(self, numbers: Ints) -> Batch:
        """Return problems of a route or of pairs by their numbers among all stored problems."""
        stored = self.reader.locate(numbers)
        stored_grids = self.reader.grids(stored)
        starts = self.reader.seed_points(stored, stored.first_rooms)
        goals = self.reader.seed_points(stored, stored.second_rooms)

        def compute_stored_maps() -> StoredMaps:
            return self.reader.stored_maps(stored, stored_grids)

        grids = self._inflated(stored_grids)
        batch = self._as_batch(numbers, numbers, grids, starts, goals, compute_stored_maps)
        if isinstance(self.serving.problems, Route) and self._labels_serve:
            # The batch asks for the paths of the search that its fields need.
            batch.compute_paths = lambda search: self.reader.paths(stored, search)
        return batch

    def _stored_maps(self, map_numbers: Ints) -> StoredMaps:
        stored = self.reader.locate(map_numbers)
        return self.reader.stored_maps(stored, self.reader.grids(stored))

    def _map_indices(self, map_numbers: Ints) -> Ints:
        return self.reader.map_indices(self.reader.locate(map_numbers))

    def _radius_in_cells(self) -> float:
        radius = self.serving.radius
        return radius / self.reader.root.resolution if radius else 0.0

    def _stored_rooms(self, map_numbers: Ints) -> Rooms:
        """Return the rooms of maps as their shards hold them."""
        return self.reader.rooms(self.reader.locate(map_numbers), self.serving.search)

    def _seed_points(self, map_numbers: Ints) -> Ints:
        return self._stored_rooms(map_numbers).seed_points

    def _rooms(
        self, map_numbers: Ints, grids: Bytes, compute_stored_maps: Callable[[], StoredMaps]
    ) -> Rooms:
        return (
            self._stored_rooms(map_numbers)
            if self._labels_serve
            else super()._rooms(map_numbers, grids, compute_stored_maps)
        )

    def _substitutes(self, indices: Ints, epoch: int, numbers: Ints) -> Ints:
        """Draw each map from the whole split, so that no map replaces more others than the rest."""
        seed = np.uint64(self.serving.sampling_seed)
        return draw_substitutes(seed, indices, epoch, numbers, len(self.reader))

    def _tried_text(self, tries: int) -> str:
        """Say that the maps of a small split were tried several times."""
        map_count = len(self.reader)
        if tries <= map_count:
            return super()._tried_text(tries)
        return f"{tries:,} tries were made on the maps of the split, {map_count:,} in number,"


def _field_tensor(name: str, values: Any, count: int) -> Tensor:
    """Return what a field function of the user returned for ``count`` problems, as a tensor.

    Raises:
        ValueError: it is no tensor with a row for each problem.
    """
    try:
        tensor = torch.as_tensor(values)
    except (TypeError, ValueError, RuntimeError):
        returned = "None" if values is None else f"a {type(values).__name__}"
    else:
        if tensor.ndim and len(tensor) == count:
            return tensor
        returned = f"a tensor of shape {tuple(tensor.shape)}"
    raise ValueError(
        f"fields: the function {name} returned {returned} for a batch of {count} problems, "
        f"expected a tensor whose first dimension is {count}"
    )


def _transformed(batch: Batch, seed: int, epoch: int) -> Batch:
    """Return a batch after the symmetries that are drawn for its problems.

    Maps, cells, paths and seed points are transformed alike, and other fields are computed from
    these.
    """
    rows, columns = batch.grids.shape[1:]
    codes = sample_symmetries(np.uint64(seed), epoch, batch.problems, rows == columns)

    def transform(cells: Ints, cells_per_problem: Ints | int = 1) -> Ints:
        """Return cells (..., 2) of all problems, one problem after another."""
        cell_codes = np.repeat(codes, cells_per_problem)
        flat_cells = cells.reshape(-1, 2)
        return transform_cells(flat_cells, cell_codes, rows, columns).reshape(cells.shape)

    def compute_paths(search: str) -> Paths:
        paths = (batch if search == batch.search else batch.with_astar).paths
        return paths._replace(cells=transform(paths.cells, np.diff(paths.offsets)))

    def compute_rooms() -> Rooms:
        seed_points = batch.rooms.seed_points
        return batch.rooms._replace(seed_points=transform(seed_points, seed_points.shape[1]))

    return replace(
        batch,
        grids=transform_grids(batch.grids, codes),
        starts=transform(batch.starts),
        goals=transform(batch.goals),
        compute_paths=compute_paths,
        compute_rooms=compute_rooms,
        compute_stored_maps=lambda: batch.stored_maps,
        symmetries=codes,
    )
