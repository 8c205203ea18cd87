"""Problems that planners are compared on: sampled on new maps, or on one split of a dataset.

The file is long because all ways to get a `ProblemSet` are methods of the class. Most of their work
is done elsewhere: drawing problems in `mapdata.problems.drawing`, files in
`mapdata.problems.set_file`.
"""

from __future__ import annotations

import hashlib
import math
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from mapdata.arrays import Array, Bytes, Flags, Floats, Ints, brief_text, offsets_of, places_of_mask
from mapdata.checks import check_choice, check_count, check_seed
from mapdata.generators.generator import identity
from mapdata.generators.recipe import RecipeLike, as_recipe, generate
from mapdata.hashing import canonical_json
from mapdata.limits import SPLITS
from mapdata.movement import Movement, check_movement
from mapdata.problems.drawing import DRAWS_OF_SETS, Drawing, GivenMaps, Paths
from mapdata.problems.map_stream import MapStream, draw_problems, first_maps
from mapdata.problems.set_file import StoredSet, different_maps, read_set, write_set
from mapdata.problems.sources import Random, SourceLike, problem_source
from mapdata.search.api import BatchResult, search_batch
from mapdata.search.arguments import as_grid, as_terrain
from mapdata.search.footprint import min_squared_clearance
from mapdata.search.lattice import HARD, hardness
from mapdata.search.map_stack import MapStack
from mapdata.shards.files import StrPath
from mapdata.shards.locations import Locations
from mapdata.shards.root import Root

_PART_CELLS = 2**24
"""Cells of the repeated maps of the problems that are solved at a time."""

_CHUNK_SIZE = 256
"""Maps that are drawn at a time."""

_MAPS_PER_HARD_PROBLEM = 1000
"""Maps that are tried for each hard problem. Where hard problems are rarer, nobody would wait."""

DEFAULT_PROBLEMS = Random(distance=(10, None))
"""What `ProblemSet.sample` and `ProblemSet.read` draw: start and goal are not close together."""


# The defaults of two fields: the maps of all problems, which are made when they are first used.
_GRIDS: Any = cached_property(lambda problem_set: problem_set._of_all(problem_set._maps.grids))
_TERRAIN: Any = cached_property(lambda problem_set: problem_set._of_all(problem_set._maps.terrain))


@dataclass(frozen=True, eq=False, init=False)
class ProblemSet:
    """N problems that planners are compared on, each with a path.

    The arrays are copies and cannot be written to. Equal maps are kept, pickled and saved once: a
    map that all problems share is repeated by `numpy.broadcast_to`. Where only some problems share
    a map, ``grids`` and ``terrain`` are made when they are first used, and take the memory of N
    maps; `maps_of` returns the maps of some problems without it.

    ``problem_set[indices]`` is the set of some problems, by a slice, a list or array of integers,
    or a mask of N bools, as NumPy selects rows. A problem keeps its map's number, its own number
    and its path in every subset. An integer alone selects no set: take ``problem_set[[i]]``, or the
    sample ``ProblemSetDataset(problem_set)[i]``.

    Attributes:
        grids: (N, H, W) uint8, 0 free and 1 occupied.
        starts: (N, 2) int64, cells.
        goals: (N, 2) int64, cells other than the starts.
        movement: the rule of moves under which the problems are solved.
        description: where the problems come from, in words.
        terrain: (N, H, W) uint8, the cost of each cell as `mapdata.astar` takes it: 0 where
            ``grids`` is 1, and 1 to 255 elsewhere; None if all free cells cost the same.
        map_indices: (N,) int64, number of the map of each problem, served as ``map_index``. Equal
            maps have the same number; maps are numbered in the order in which they occur first.
        problem_numbers: (N,) int64, number of each problem, served as ``problem``: 0 to N - 1, and
            in a subset the numbers of the set that it was taken from.
        optimal: the answers of mapdata's A*: the optimal costs, and the expansions to compare with.
            Its arrays cannot be written to either.

    Raises:
        ValueError: what `search_batch` refuses; a problem without a path, or whose start is its
            goal.

    >>> from mapdata import Movement
    >>> problems = ProblemSet.sample("dungeon", seed=77, maps=20, movement=Movement(8))
    >>> hard = problems[problems.hard]
    >>> len(problems[:5]), hard.problem_numbers.tolist() == problems.hard.nonzero()[0].tolist()
    (5, True)
    """

    __match_args__ = ("grids", "starts", "goals", "movement", "description", "terrain")

    starts: Ints
    goals: Ints
    movement: Movement
    description: str
    grids: Bytes = _GRIDS
    terrain: Bytes | None = _TERRAIN
    map_indices: Ints = field(init=False)
    problem_numbers: Ints = field(init=False)
    optimal: BatchResult = field(init=False)
    _maps: MapStack = field(init=False)
    _rows: Ints = field(init=False)  # (N,), the row of `_maps` that each problem is on

    def __init__(
        self,
        grids: Bytes,
        starts: Ints,
        goals: Ints,
        movement: Movement,
        description: str = "problems",
        terrain: Bytes | None = None,
    ) -> None:
        """Copy the arrays and solve the problems, so that bad ones are refused here."""
        if np.ndim(grids) != 3:  # `search_batch` accepts one grid, (H, W), for all problems
            raise ValueError(f"grids: got shape {np.shape(grids)}, expected (N, H, W)")
        if terrain is not None and np.shape(terrain) != np.shape(grids):
            raise ValueError(
                f"terrain: got shape {np.shape(terrain)}, expected {np.shape(grids)}, "
                "that of the grids"
            )
        count = len(grids)
        start_count, goal_count = (len(np.atleast_1d(cells)) for cells in (starts, goals))
        if not start_count == goal_count == count:
            raise ValueError(
                f"got {count} grids, {start_count} starts and {goal_count} goals, expected equal "
                "numbers"
            )
        maps, map_indices = _as_maps(grids, terrain)
        self._set(maps, map_indices, starts, goals, np.arange(count), movement, description)

    def _set(
        self,
        maps: MapStack,
        map_indices: Ints,
        starts: Ints,
        goals: Ints,
        problem_numbers: Ints,
        movement: Movement,
        description: str,
        optimal: BatchResult | None = None,
    ) -> None:
        """Set all attributes of a new set, and check that its problems can be solved.

        Args:
            maps: the K different maps.
            map_indices: (N,) number of the map of each problem; the k-th smallest of the numbers is
                that of map k.
            starts: (N, 2) cells, of any integer type.
            goals: (N, 2) cells, of any integer type.
            problem_numbers: (N,).
            movement: the rule of moves.
            description: in words.
            optimal: the solutions, if the problems are known to be good.

        Raises:
            ValueError: as the class says.
        """
        rows = np.unique(map_indices, return_inverse=True)[1].reshape(-1)
        if optimal is None:
            optimal = _solve(maps, rows, starts, goals, movement)
            cost = optimal.cost
            for is_bad, fault in ((cost == -1, "has no path"), (cost == 0, "starts at its goal")):
                if is_bad.any():
                    raise ValueError(f"problem {int(np.argmax(is_bad))} {fault}: leave it out")
        self.__setstate__(
            {
                "starts": _as_cells(starts),
                "goals": _as_cells(goals),
                "movement": movement,
                "description": description,
                "map_indices": map_indices,
                "problem_numbers": problem_numbers,
                "optimal": optimal,
                "_maps": maps,
                "_rows": rows,
            }
        )

    @classmethod
    def _of(cls, *parts: Any) -> ProblemSet:
        """Return a set of known maps and problems; the arguments are those of `_set`."""
        problem_set = cls.__new__(cls)
        problem_set._set(*parts)
        return problem_set

    def _of_all(self, maps: Bytes | None) -> Bytes | None:
        """Return the map of each problem, (N, H, W), of the different maps, (K, H, W)."""
        if maps is None or self._has_own_maps:
            return maps
        if len(maps) == 1:
            return np.broadcast_to(maps[0], (len(self), *maps.shape[1:]))
        repeated = maps[self._rows]
        repeated.setflags(write=False)
        return repeated

    @property
    def _has_own_maps(self) -> bool:
        """Whether problem i is on map i of the different maps."""
        return _are_own(self._maps, self._rows)

    def __repr__(self) -> str:
        texts = []
        for name in self.__match_args__:
            # Other arrays than these two are shown as everywhere; these may have to be made first.
            text = f"uint8 {(len(self), *self.map_size)}"
            if name not in ("grids", "terrain") or getattr(self._maps, name) is None:
                text = brief_text(getattr(self, name))
            texts.append(f"{name}={text}")
        return f"ProblemSet({', '.join(texts)})"

    def __len__(self) -> int:
        """Return N, the number of problems."""
        return len(self.starts)

    def __getitem__(self, indices: slice | Sequence[int] | Sequence[bool] | Array) -> ProblemSet:
        """Return the set of some problems, in the given order, which may repeat problems.

        Raises:
            TypeError: an integer, or what NumPy cannot select rows by.
            IndexError: a problem that the set does not have, or a mask of another length.
        """
        which = self._selected(indices)
        maps = self._maps
        used = np.unique(self._rows[which])
        if len(used) < len(maps.grids):
            # Maps of no problem are left out, so that they are neither pickled nor saved.
            maps = maps.select(used)
        return ProblemSet._of(
            maps,
            self.map_indices[which],
            self.starts[which],
            self.goals[which],
            self.problem_numbers[which],
            self.movement,
            self.description,
            selected_paths(self.optimal, which),
        )

    def _selected(self, indices: Any) -> Ints:
        """Return the places in the set that ``indices`` selects, (M,)."""
        places = np.arange(len(self))
        if isinstance(indices, slice):
            return places[indices]
        array = np.asarray(indices)
        if array.ndim and array.dtype == np.bool_:
            return places_of_mask(array, len(self))
        if array.ndim == 1 and array.size == 0:
            return places[:0]
        if array.ndim != 1 or array.dtype.kind not in "iu":
            hint = f"; [[{indices}]] is the set of this problem" if array.ndim == 0 else ""
            raise TypeError(
                f"indices: got {indices!r}, expected a slice, a list or array of integers, or a "
                f"mask of {len(self)} bools{hint}"
            )
        selected: Ints = places[array]
        return selected

    def maps_of(self, indices: slice | Sequence[int] | Array) -> tuple[Bytes, Bytes | None]:
        """Return copies of the grids and of the terrain of some problems, each (M, H, W) uint8.

        The terrain is None without any. ``indices`` selects as in ``problem_set[indices]``.
        """
        maps = self._maps.select(self._rows[self._selected(indices)])
        return maps.grids, maps.terrain

    @property
    def has_terrain(self) -> bool:
        """Whether the maps have terrain: free cells that cost different amounts."""
        return self._maps.terrain is not None

    @property
    def map_size(self) -> tuple[int, int]:
        """(rows, columns) of all maps."""
        _, rows, columns = self._maps.grids.shape
        return rows, columns

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes that are pickled: each different map once.

        The solutions are among them, so that another process does not search again.
        """
        made = ("grids", "terrain", "hardness", "hard")
        return {name: v for name, v in vars(self).items() if name not in made}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Set all attributes, and make the arrays such that they cannot be written to."""
        for name, value in state.items():
            object.__setattr__(self, name, value)
        numbers = (self.map_indices, self.problem_numbers, self._rows)
        for array in (self.starts, self.goals, *numbers, *self.optimal, *self._maps):
            if array is not None:
                array.setflags(write=False)

    @cached_property
    def hardness(self) -> Floats:
        """(N,) optimal cost over heuristic (the cost on an empty grid); 1 is the easiest.

        On terrain the empty grid has the smallest cost of a free cell everywhere, so that nearly
        every problem is hard.
        """
        min_costs = self._maps.min_cell_costs
        if min_costs is not None:
            min_costs = min_costs[self._rows]
        ratios = hardness(self.optimal.cost, self.starts, self.goals, self.movement, min_costs)
        ratios.setflags(write=False)
        return ratios

    @cached_property
    def hard(self) -> Flags:
        """(N,) bool: the hardness is at least ``HARD``."""
        is_hard: Flags = self.hardness >= HARD
        is_hard.setflags(write=False)
        return is_hard

    @property
    def map_count(self) -> int:
        """Number of different maps among the grids, or terrains."""
        return len(self._maps.grids)

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 of the problems and the movement, as hex: equal sets have equal hashes.

        The numbers of maps and problems are not part of it, nor is the description.
        """
        grids, terrain = self._maps
        count = len(self)
        digest = hashlib.sha256(canonical_json(asdict(self.movement)).encode())
        # Each problem is hashed with its whole map, as if no map were shared.
        for name, maps in (
            ("grids", grids),
            ("starts", None),
            ("goals", None),
            ("terrain", terrain),
        ):
            if maps is not None:
                digest.update(f"{name} {(count, *maps.shape[1:])}".encode())
                for row in self._rows:
                    digest.update(maps[row].tobytes())
            elif name != "terrain":
                cells: Ints = getattr(self, name)
                digest.update(f"{name} {cells.shape}".encode())
                digest.update(cells.astype("<i8").tobytes())
        return digest.hexdigest()

    def save(self, path: StrPath) -> None:
        """Write the problems to a compressed .npz; the same problems are the same bytes.

        Each different map is stored once, and no path or picture is stored. The file states its
        format and a hash of itself, which `verify` compares; versions of mapdata that do not know
        the format refuse it. An existing file is replaced as a whole or not at all. A set that
        would unpack to more than `load` allows is not compressed: one whose different maps take
        more than 1 GiB, or many large and nearly empty maps.
        """
        stored = StoredSet(
            self._maps.content,
            self.has_terrain,
            self.map_indices,
            self.starts,
            self.goals,
            self.problem_numbers,
            self.movement,
            self.description,
            self.content_hash,
        )
        write_set(path, stored)

    @staticmethod
    def load(path: StrPath) -> ProblemSet:
        """Read problems that `save` wrote, in this version of mapdata or an earlier one.

        The file hash, which covers every bit, and the headers of the arrays are checked before
        anything is unpacked. A file of mapdata 0.2 has no such hash; the checksums of its arrays
        are compared. The arrays together may unpack to 64 MiB, or to 200 times the size of the file
        but at most 1 GiB; arrays that are not compressed may have any size. A file that another
        program wrote is refused: give its arrays to `ProblemSet` (docs/problems.md, Saved sets).

        Raises:
            FileNotFoundError: the file does not exist.
            ValueError: the file is damaged, written by another program or of a newer format; it
                holds no problems, too many for its size, or problems that `ProblemSet` refuses. The
                message names the file.
        """
        problem_set, _ = _load(Path(path))
        return problem_set

    @staticmethod
    def verify(path: StrPath) -> list[str]:
        """Return what is wrong with a file that `save` wrote, in one line, or an empty list.

        The set is read as `load` does, and its content hash is compared with the one in the file. A
        file of mapdata 0.2 has no content hash.

        Raises:
            FileNotFoundError: the file does not exist.
        """
        path = Path(path)
        try:
            problem_set, stated_hash = _load(path)
        except FileNotFoundError:
            raise
        except (OSError, ValueError) as error:
            reason = str(error)
            return [reason if str(path) in reason else f"{path}: {reason}"]
        if stated_hash is None:
            return []
        if problem_set.content_hash != stated_hash:
            return [f"{path}: damaged (its content hash does not fit)"]
        return []

    @staticmethod
    def sample(
        recipe: RecipeLike,
        seed: int | None = None,
        maps: int | None = None,
        *,
        movement: Movement | None = None,
        problems: SourceLike = DEFAULT_PROBLEMS,
        until_hard: int | None = None,
        radius: float = 0.0,
        progress: bool = False,
    ) -> ProblemSet:
        """Sample one problem on each map 0, 1, ... of a recipe, or `Random.per_map` of them.

        The problem on a map is that of a dataset in epoch 0, wherever one of the dataset's 32 draws
        meets the conditions.

        The goal of a random problem is a uniform free cell, or the map's first seed point with
        `Random.to_first_seed_point`; the start is a uniform one of the cells that reach it and are
        far enough. Where the problem does not meet all conditions, both are drawn anew, up to 1,000
        draws in all; then the map is left out. The problem on map i is a pure function of
        (generator, seed, i), of the conditions and of ``movement``. With ``per_map`` = k, problem j
        on map i is drawn as that of map k i + j would be.

        With "route" or "pairs" the problem is a uniform one of the map's segments or pairs of seed
        points, as `OnlineMapDataset` draws it; a map where none has a path is left out. The only
        segment of the preset "tiles" leads from its upper left to its lower right corner.

        On terrain, ``distance`` limits the cost of a path and ``length`` the number of its cells.
        Choose problems by these two: nearly every problem on terrain is harder than ``HARD``, so
        that ``hardness`` and ``until_hard`` say little.

        Args:
            recipe: which maps: a preset's name, a recipe file, its JSON text or mapping, a
                `MapGenerator` or a `Recipe`.
            seed: 64-bit seed of the maps and of the problems; the recipe's by default, 0 for a
                preset or generator.
            maps: number of maps. By default the recipe's, 10,000 for a preset or generator; with
                ``until_hard`` as many as it takes, up to 1,000 for each hard problem.
            movement: the rule of moves; the generator's by default.
            problems: a `Random`, with its conditions on distance, hardness and length, and on the
                goal; or a `Route` or `Pairs`, or its name. As for `MapDataset`, but by default
                ``Random(distance=(10, None))``.
            until_hard: stop at the map that brings the number of hard problems to this.
            radius: of the robot, in metres: maps are those of `mapdata.inflate` (with terrain
                `mapdata.inflate_terrain`) for ``radius / resolution`` cells.
            progress: show a progress bar of the maps that were tried.

        Raises:
            ValueError: no recipe; conditions that no problem on such maps can meet; no map with a
                problem, or none among the first maps, after about 10 s of search; fewer hard
                problems than ``until_hard``; problems without a path (``unsolvable=True``); terrain
                with costs that are too high to be exact.

        >>> from mapdata import Movement
        >>> len(ProblemSet.sample("dungeon", seed=77, maps=20, movement=Movement(8)))
        20

        From corner to corner:

        >>> movement = Movement(8, corner_cutting=True, diagonal_cost=1)
        >>> tiles = ProblemSet.sample("tiles", maps=5, movement=movement, problems="route")
        >>> tiles.starts[0].tolist(), tiles.goals[0].tolist()
        ([0, 0], [11, 11])
        """
        if movement is not None:
            check_movement(movement)
        if maps is None and until_hard is not None:
            maps = _MAPS_PER_HARD_PROBLEM * check_count("until_hard", until_hard)
        recipe = as_recipe(recipe, seed=seed, maps=maps)

        def batches() -> Iterator[GivenMaps]:
            for start in range(0, recipe.maps, _CHUNK_SIZE):
                chunk = range(start, min(start + _CHUNK_SIZE, recipe.maps))
                yield GivenMaps.of(generate(recipe, indices=chunk))

        generator = recipe.generator
        stream = MapStream(
            batches(),
            f"the maps with identity {identity(generator, recipe.seed)[:12]}",
            recipe.maps,
            generator.map_size,
            has_terrain=generator.has_terrain,
            are_alike=True,
        )
        drawing = Drawing(
            problem_source(problems),
            recipe.seed,
            movement or generator.movement,
            DRAWS_OF_SETS,
            min_clearance=min_squared_clearance(radius, generator.resolution),
            radius=radius,
        )
        return _drawn_set(stream, drawing, until_hard, progress=progress)

    @staticmethod
    def read(
        root: Locations,
        maps: int | None = None,
        *,
        movement: Movement | None = None,
        split: str = "test",
        seed: int | None = None,
        problems: SourceLike = DEFAULT_PROBLEMS,
        until_hard: int | None = None,
        radius: float = 0.0,
        follow_links: bool = False,
        progress: bool = False,
    ) -> ProblemSet:
        """Sample one problem on each map of a split of a dataset, as `sample` does.

        All maps of the split are tried, since its problems may all be on the last ones.

        Args:
            root: folder or URL of the dataset, or several.
            maps: largest number of maps of the split; all maps by default.
            movement: the rule of moves; the stored one by default.
            split: "train", "val" or "test".
            seed: seed of the problems; that of the (first) dataset by default, 0 for imported maps.
            problems: the source of the problems, as for `sample`.
            until_hard: stop at the map that brings the number of hard problems to this.
            radius: of the robot, in metres, as for `sample`.
            follow_links: read files that are links out of their folder.
            progress: show a progress bar of the maps that were tried.

        Raises:
            DatasetNotFoundError: there is no dataset under ``root``.
            ShardError: it is damaged.
            ValueError: no such split, or one without maps; what `sample` refuses.
        """
        check_choice("split", split, SPLITS)
        if movement is not None:
            check_movement(movement)
        dataset = Root.open(root, follow_links=follow_links)
        dataset.check_begun()
        map_counts = {
            name: sum(shard.entry.counts[name]["maps"] for shard in dataset.shards)
            for name in SPLITS
        }
        if map_counts[split] == 0:
            numbers = ", ".join(f"{name} {count}" for name, count in map_counts.items())
            raise ValueError(
                f"split: got {split!r}, which has 0 maps in {dataset} ({numbers}); expected a "
                "split with maps"
            )
        if seed is None:
            seed = dataset.manifests[0].seed or 0
        code = SPLITS.index(split)
        # Without a radius, roots may have several resolutions, which `dataset.resolution` refuses.
        min_clearance = min_squared_clearance(radius, dataset.resolution) if radius else 0
        max_maps = sys.maxsize if maps is None else check_count("maps", maps)
        shards = (labels.maps for labels in dataset.labels())
        of_split = (GivenMaps.of(maps_).select(maps_.split == code) for maps_ in shards)
        stream = MapStream(
            first_maps(of_split, max_maps),
            f"split {split} of {dataset}",
            min(max_maps, map_counts[split]),
            dataset.map_size,
            has_terrain=dataset.has_terrain,
            are_alike=False,
        )
        drawing = Drawing(
            problem_source(problems),
            check_seed(seed),
            movement or dataset.movement,
            DRAWS_OF_SETS,
            min_clearance=min_clearance,
            radius=radius,
        )
        return _drawn_set(stream, drawing, until_hard, progress=progress)


def _drawn_set(
    stream: MapStream, drawing: Drawing, until_hard: int | None, *, progress: bool
) -> ProblemSet:
    """Return the set of the problems that `draw_problems` draws."""
    drawn = draw_problems(stream, drawing, until_hard, progress=progress)
    first, last = drawn.numbers[0], drawn.numbers[-1]
    description = f"maps {first} to {last} of {stream.origin}, problems by seed {drawing.seed}"
    if drawing.min_clearance > 0:
        cells = math.sqrt(drawing.min_clearance) / 2  # it is in half cells, squared
        description += f", inflated by {cells:.3g} cells"
    grids, terrain = drawn.maps
    return ProblemSet(grids, drawn.starts, drawn.goals, drawing.movement, description, terrain)


def _are_own(maps: MapStack, rows: Ints) -> bool:
    """Return whether problem i is on map i of the different maps; ``rows``, (N,), are its map."""
    return len(rows) == len(maps.grids) and np.array_equal(rows, np.arange(len(rows)))


def _as_maps(grids: Bytes, terrain: Bytes | None) -> tuple[MapStack, Ints]:
    """Return the different maps of N problems, as new arrays, and the number of each problem's map.

    Args:
        grids: (N, H, W) of 0 and 1.
        terrain: (N, H, W), or None.

    Raises:
        ValueError: numbers that are no maps.
    """
    count, *shape = np.shape(grids)
    arrays = [np.asarray(grids)] + ([] if terrain is None else [np.asarray(terrain)])
    if count and all(array.strides[0] == 0 for array in arrays):
        # `numpy.broadcast_to` gave one map to all problems.
        arrays = [array[:1] for array in arrays]
    grid_stack = as_grid(arrays[0], 3)
    if terrain is None:
        different, map_indices = different_maps(grid_stack, tuple(shape))
        maps = MapStack(different, None)
    else:
        different, map_indices = different_maps(as_terrain(arrays[1], grid_stack), tuple(shape))
        maps = MapStack((different == 0).astype(np.uint8), different)
    return maps, np.resize(map_indices, count)


def _as_cells(cells: Ints) -> Ints:
    """Return a copy of cells, (N, 2) int64; they are known to be cells."""
    return np.array(cells, np.int64, order="C").reshape(-1, 2)


def _solve(
    maps: MapStack, rows: Ints, starts: Ints, goals: Ints, movement: Movement
) -> BatchResult:
    """Return A*'s answers to N problems on the maps ``rows``, (N,).

    Raises:
        ValueError: what `search_batch` refuses.
    """
    if _are_own(maps, rows):
        return search_batch("astar", maps.grids, starts, goals, movement, terrain=maps.terrain)
    count, *size = maps.grids.shape
    if count == 1:
        shared = None if maps.terrain is None else maps.terrain[0]
        return search_batch("astar", maps.grids[0], starts, goals, movement, terrain=shared)
    # The maps are repeated for some problems at a time, so that memory does not hold N of them.
    part_size = max(1, _PART_CELLS // math.prod(size))
    parts = []
    for first in range(0, len(rows), part_size):
        part = slice(first, first + part_size)
        grids, terrain = maps.select(rows[part])
        ends = np.asarray(starts)[part], np.asarray(goals)[part]
        try:
            found = search_batch("astar", grids, *ends, movement, terrain=terrain)
        except ValueError as error:
            # The message names the problem by its number in the part.
            match = re.fullmatch(r"problem (\d+): (.*)", str(error), re.DOTALL)
            if match is None:
                raise
            raise ValueError(f"problem {first + int(match[1])}: {match[2]}") from None
        parts.append(found)
    return BatchResult(
        np.concatenate([part.cells for part in parts]),
        offsets_of(np.concatenate([np.diff(part.offsets) for part in parts])),
        np.concatenate([part.cost for part in parts]),
        np.concatenate([part.iterations for part in parts]),
    )


def selected_paths(paths: BatchResult, which: Ints) -> BatchResult:
    """Return the answers to the problems ``which``, (M,)."""
    selected = Paths(paths.cells, paths.offsets, paths.iterations).select(which)
    return BatchResult(selected.cells, selected.offsets, paths.cost[which], selected.iterations)


def _load(path: Path) -> tuple[ProblemSet, str | None]:
    """Return the set of a file, and the content hash that the file states, if any.

    Raises:
        FileNotFoundError, ValueError: as `ProblemSet.load`.
    """
    try:
        stored = read_set(path)
        maps, rows = _as_maps(
            (stored.maps == 0) if stored.has_terrain else stored.maps,
            stored.maps if stored.has_terrain else None,
        )
        # The maps of a file are different ones, unless another program wrote it.
        if len(maps.grids) < len(rows):
            raise ValueError("two of its maps are equal")
        problem_set = ProblemSet._of(
            maps,
            stored.map_indices,
            stored.starts,
            stored.goals,
            stored.problem_numbers,
            stored.movement,
            stored.description,
        )
    except (FileNotFoundError, PermissionError):
        raise
    except Exception as error:  # the readers of zip and JSON do not document what they raise
        reason = str(error).removeprefix(f"{path}: ")
        raise ValueError(f"{path}: holds no saved problems ({reason})") from None
    return problem_set, stored.content_hash
