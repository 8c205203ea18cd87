"""`ProblemDataset`: what all datasets share, indexing, epochs, fields and symmetries."""

from __future__ import annotations

import operator
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset, default_collate, get_worker_info

from mapdata.arrays import Ints, places_of_mask
from mapdata.checks import check_choice
from mapdata.datasets.arguments import (
    DEFAULT_FIELDS,
    FieldFunction,
    Serving,
    field_names,
    torch_dtype,
)
from mapdata.datasets.batch_sources import BatchSource
from mapdata.datasets.fields import FIELD_CLASSES, FIELDS, Batch, Rooms
from mapdata.datasets.info import DatasetInfo
from mapdata.datasets.problem_statistics import SAMPLE, measure
from mapdata.datasets.sample import Rows, Sample, cast, row, sample_class, stack
from mapdata.datasets.waypoints import NO_TAUT_LINES
from mapdata.describe.dataset_card import movement_text
from mapdata.describe.problem_statistics import ProblemStatistics
from mapdata.limits import SPLITS, Size
from mapdata.movement import Movement
from mapdata.problems.drawing import Paths
from mapdata.problems.sources import check_possible, plain_text
from mapdata.problems.symmetry import sample_symmetries, transform_cells, transform_grids
from mapdata.shards.workers import Advance, no_bar

if TYPE_CHECKING:
    from matplotlib.axes import Axes


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
    """A source of batches as a dataset of torch: indexing, fields, epochs and symmetries.

    ``dataset[i]`` is a `Sample`. ``dataset[2:9]``, ``dataset[[4, 1]]`` and ``dataset[mask]``, with
    a bool for each problem, are batches. A DataLoader gets whole batches that are computed at once.
    With a ``transform``, ``dataset[i]`` is what it
    returns, and batches are stacked from such samples as a DataLoader does.

    A batch sampler may yield lists of ``index + epoch * len(dataset)``: what is drawn anew each
    epoch is a function of (sampling_seed, epoch, index), never of worker state. A plain
    ``dataset[i]`` is epoch 0, and i below the length.
    """

    source: BatchSource
    """The problems."""

    report_tried: Advance = staticmethod(no_bar)
    """Called with the number of maps on which problems were sought just now, for a progress bar."""

    _opened: ClassVar[tuple[str, ...]] = ("source",)
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
        self._warns_of_repeats = True
        self._read_count = 0  # problems that loaders of this process have read
        keep_freed_memory()

    @property
    def _drawn_anew(self) -> str:
        """What is drawn anew each epoch: "problems", "symmetries", "light" or "" for nothing."""
        if self.source.draws_anew:
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
        self._warns_of_repeats = False

    def _check_on_maps(self) -> None:
        """Refuse fields and problems that do not exist on these maps.

        Raises:
            ValueError: waypoints on terrain, or as `check_possible`.
        """
        if self.has_terrain and "waypoints" in self._field_names:
            raise ValueError(f"fields: {NO_TAUT_LINES}")
        check_possible(
            self.serving.problems, self.map_size, self.movement, has_terrain=self.has_terrain
        )

    @property
    def movement(self) -> Movement:
        """Movement of the served paths."""
        return self.source.movement

    @property
    def map_size(self) -> Size:
        """(rows, columns) of all maps."""
        return self.source.map_size

    @property
    def has_terrain(self) -> bool:
        """Whether the maps have terrain: free cells that cost different amounts."""
        return self.source.has_terrain

    def __len__(self) -> int:
        """Return the number of problems."""
        return len(self.source)

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
        copied._read_count = 0
        return copied

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes that are pickled: all but those that `_open` sets."""
        state = {name: v for name, v in vars(self).items() if name not in self._opened}
        # A process that gets the dataset pickled, such as a loader worker, reads a part of a pass.
        return {**state, "_warns_of_repeats": False}

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
            samples = self._serve(self._checked_numbers(index))
            return samples.batch if isinstance(samples, Rows) else default_collate(samples)
        sample: Sample = self._serve(np.array([self._checked_index(index)]))[0]
        return sample

    def __getitems__(self, indices: Sequence[int] | Ints | Tensor) -> Any:
        """Return a list of samples; torch's DataLoader calls this.

        Without a transform the list is a whole batch, `Rows`, which torch's collate function takes
        as it is.

        Args:
            indices: ``index + epoch * len(dataset)`` each; a negative index counts from the end.
        """
        numbers = self._checked_numbers(indices)
        if self._warns_of_repeats and len(numbers):
            self._watch(numbers)
        return self._serve(numbers)

    def _watch(self, numbers: Ints) -> None:
        """Warn of a plain loader with ``shuffle=True``, whose passes draw the same again and again.

        Only what is read in the main process is seen. A later pass in ascending order is a
        validation, which should repeat its problems.
        """
        if not self._drawn_anew:  # Repeats are what all passes should serve.
            self.expect_epochs()
            return
        had_a_pass = self._read_count >= len(self)
        self._read_count += len(numbers)
        if numbers.max() >= len(self):
            self.expect_epochs()
        elif had_a_pass and (np.diff(numbers) < 0).any() and get_worker_info() is None:
            self.expect_epochs()
            warnings.warn(
                f"a second pass over this dataset serves the same {self._drawn_anew} as the first, "
                "those of epoch 0: instead of shuffle=True give the DataLoader "
                "sampler=EpochSampler(dataset, batch_size, sampling_seed=0) of "
                "mapdata.datasets, or use MapDataModule, and each pass is an epoch of its own",
                stacklevel=3,
            )

    def _checked_numbers(self, indices: Sequence[int] | Ints | Tensor) -> Ints:
        """Return indices as an array (B,) of ``index + epoch * len(dataset)``, none negative.

        Raises:
            TypeError: they are no integers.
            IndexError: one counts from the end to before the first problem.
        """
        numbers = np.asarray(indices)
        length = len(self)
        if numbers.size and numbers.dtype.kind not in "iu":
            raise TypeError(f"indices: got {numbers.dtype}, expected integers")
        numbers = numbers.astype(np.int64).reshape(-1)
        if len(numbers) and (length == 0 or numbers.min() < -length):
            raise IndexError(f"index {numbers.min()} is out of range for {length} problems")
        numbers[numbers < 0] += length
        return numbers

    def _serve(self, numbers: Ints) -> Any:
        """Return a list of samples as `__getitems__`, of numbers from `_checked_numbers`."""
        epochs, problems = np.divmod(numbers, len(self))
        last_epoch = epochs.max(initial=0)
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

    def served_text(self) -> str:
        """Return which problems are served, in words."""
        parts = [plain_text(self.serving.problems), movement_text(self.movement, self.has_terrain)]
        if self.split is not None:
            parts.append(f"split {self.split}")
        if self.serving.radius:
            parts.append(f"radius {self.serving.radius:g} m")
        return "; ".join(parts)

    def problems_text(self) -> str:
        """Return which problems are served, in words that no other problems have.

        They do not depend on where the files of the maps are.
        """
        hashes = ", ".join(map_hash[:12] for map_hash in self.source.map_hashes)
        text = f"{self.served_text()}; maps {hashes}"
        if self.source.draws_anew:
            text += f"; sampling_seed {self.serving.sampling_seed}"
        return text

    def own_maps(self, indices: Ints) -> Ints | None:
        """Return the maps on which problems are drawn first, as ``map_index`` numbers them.

        None for problems that are not drawn, and so never on another map.
        """
        return self.source.own_maps(indices)

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

    def batch_of(self, indices: Ints, epoch: int) -> Batch:
        """Return problems ``indices``, (B,), of an epoch, before any symmetry."""
        return self.source.batch_of(indices, epoch, self.report_tried)

    def _batch(self, indices: Ints, epoch: int) -> Batch:
        """Return problems ``indices`` of an epoch, transformed by symmetries if asked for."""
        batch = self.batch_of(indices, epoch)
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
