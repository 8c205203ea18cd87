"""Problems that planners are compared on: sampled on new maps, or on one split of a dataset."""

from __future__ import annotations

import hashlib
import json
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mapdata.arrays import Array, Bytes, Flags, Floats, Ints, summary
from mapdata.checks import check_choice, check_count, check_seed
from mapdata.generators.generator import identity
from mapdata.generators.maps import Maps
from mapdata.generators.recipe import RecipeLike, as_recipe, generate
from mapdata.hashing import canonical_json
from mapdata.limits import SPLITS
from mapdata.movement import Movement
from mapdata.npy import MAX_BYTES, Npz
from mapdata.problems.sampling import sample_problems, solve_pairs
from mapdata.problems.sources import Random, Route, Source, SourceLike, problem_source
from mapdata.problems.terrain_sampling import sample_terrain_problems, solve_terrain_pairs
from mapdata.search.api import BatchResult, check_cost, search_batch
from mapdata.search.footprint import inflate_all, min_squared_clearance, without_occupied
from mapdata.search.lattice import ASTAR, HARD, hardness, move_rule
from mapdata.search.terrain import min_cell_costs
from mapdata.shards.files import StrPath, write_output
from mapdata.shards.locations import Locations
from mapdata.shards.root import Root

_DRAWS = (0, 1000)
"""First and last (excluded) draw that is tried on a map. A dataset tries fewer of them before it
takes another map.
"""

_CHUNK_SIZE = 256
"""Maps that are drawn and searched at a time."""

_MAPS_PER_HARD_PROBLEM = 1000
"""Maps that are tried for each hard problem. Where hard problems are rarer, nobody would wait."""

_DTYPES = {"grids": np.uint8, "starts": np.int64, "goals": np.int64, "terrain": np.uint8}
"""Dtypes of the arrays of a set by name, in the order in which they are hashed."""

_MAX_UNPACKED = 2**26
"""Bytes that the arrays of any saved set may unpack to: 16,000 maps of 64 x 64 cells."""

_MAX_RATIO = 200
"""Factor by which the arrays of a saved set may be larger than its file, up to `MAX_BYTES`.

Sets that planners are compared on reach 10 to 160; files made to fill the memory reach 1,000.
"""


@dataclass(frozen=True, eq=False)
class ProblemSet:
    """N problems that planners are compared on, each with a path.

    The arrays are copied and cannot be written to. A grid or terrain that `numpy.broadcast_to` has
    given to all problems is kept once.

    Attributes:
        grids: (N, H, W) uint8, 0 free and 1 occupied.
        starts: (N, 2) int64, cells.
        goals: (N, 2) int64, cells other than the starts.
        movement: the rule of moves under which the problems are solved.
        description: where the problems come from, in words.
        terrain: (N, H, W) uint8, the cost of each cell as `mapdata.astar` takes it: 0 where
            ``grids`` is 1, and 1 to 255 elsewhere; None if all free cells cost the same.

    Raises:
        ValueError: what `search_batch` refuses; a problem without a path, or whose start is its
            goal.
    """

    grids: Bytes
    starts: Ints
    goals: Ints
    movement: Movement
    description: str = "problems"
    terrain: Bytes | None = None

    def __post_init__(self) -> None:
        """Solve the problems, so that bad ones are refused here, and copy the arrays."""
        if np.ndim(self.grids) != 3:  # `search_batch` accepts one grid, (H, W), for all problems
            raise ValueError(f"grids: got shape {np.shape(self.grids)}, expected (N, H, W)")
        if self.terrain is not None and np.shape(self.terrain) != np.shape(self.grids):
            raise ValueError(
                f"terrain: got shape {np.shape(self.terrain)}, expected {np.shape(self.grids)}, "
                "that of the grids"
            )
        cost = self.optimal.cost
        for is_bad, fault in ((cost == -1, "has no path"), (cost == 0, "starts at its goal")):
            if is_bad.any():
                raise ValueError(f"problem {int(np.argmax(is_bad))} {fault}: leave it out")
        for name, original in self._arrays().items():
            copy = np.array(_without_repeats(original), _DTYPES[name], order="C")
            if copy.shape != np.shape(original):
                copy = np.broadcast_to(copy, np.shape(original))
            copy.setflags(write=False)
            object.__setattr__(self, name, copy)

    __repr__ = summary

    def __len__(self) -> int:
        """Return N, the number of problems."""
        return len(self.starts)

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes that are pickled: a map that all problems share is pickled once.

        The solutions are among them, so that another process does not search again.
        """
        arrays = self._arrays()
        return {**vars(self), **{name: _without_repeats(arrays[name]) for name in arrays}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over the pickled attributes, again as arrays that cannot be written to."""
        vars(self).update(state)
        for name, array in self._arrays().items():
            array.setflags(write=False)
            if name in ("grids", "terrain"):
                repeated = np.broadcast_to(array, (len(self), *array.shape[-2:]))
                object.__setattr__(self, name, repeated)

    def _arrays(self) -> dict[str, Array]:
        """Return the arrays of the set by name; terrain is among them if there is any."""
        arrays = {name: getattr(self, name) for name in _DTYPES}
        return {name: array for name, array in arrays.items() if array is not None}

    @cached_property
    def optimal(self) -> BatchResult:
        """The answers of mapdata's A*: the optimal costs, and the expansions to compare with."""
        grids = _without_repeats(self.grids)
        terrain = self.terrain
        if terrain is not None:
            terrain = _without_repeats(terrain)
            # A search takes one map or N maps, but not one grid and N terrains.
            if terrain.ndim != grids.ndim:
                grids = np.asarray(self.grids)
                terrain = np.asarray(self.terrain)
        return search_batch("astar", grids, self.starts, self.goals, self.movement, terrain=terrain)

    @cached_property
    def hardness(self) -> Floats:
        """(N,) optimal cost over heuristic (the cost on an empty grid); 1 is the easiest.

        On terrain the empty grid has the smallest cost of a free cell everywhere, so that nearly
        every problem is hard.
        """
        return _hardness(self.optimal.cost, self.starts, self.goals, self.terrain, self.movement)

    @cached_property
    def hard(self) -> Flags:
        """(N,) bool: the hardness is at least ``HARD``."""
        return self.hardness >= HARD

    @cached_property
    def map_count(self) -> int:
        """Number of different maps among the grids, or terrains."""
        maps = _without_repeats(self.grids if self.terrain is None else self.terrain)
        maps = maps.reshape(-1, *self.grids.shape[1:])
        return len({hashlib.sha256(grid).digest() for grid in maps})

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 of the problems and the movement, as hex: equal sets have equal hashes."""
        digest = hashlib.sha256(canonical_json(asdict(self.movement)).encode())
        for name, array in self._arrays().items():
            digest.update(f"{name} {array.shape}".encode())
            little_endian = array.dtype.newbyteorder("<")
            # Row by row, since grids that share memory would each be copied otherwise.
            for row in array:
                digest.update(row.astype(little_endian).tobytes())
        return digest.hexdigest()

    def save(self, path: StrPath) -> None:
        """Write the problems to a compressed .npz; the same problems are the same bytes.

        It holds ``grids``, ``starts`` and ``goals`` as above, and ``about``: movement and
        description as JSON. A set with terrain holds ``terrain`` in place of ``grids``, which are 1
        where it is 0. So versions of mapdata that do not know terrain refuse the file. An existing
        file is replaced as a whole or not at all. A set that would unpack to more than `load`
        allows is not compressed: a set of more than 1 GiB, or many large and nearly empty maps.
        """
        about = canonical_json({"movement": asdict(self.movement), "description": self.description})
        arrays: dict[str, Any] = self._arrays()
        if "terrain" in arrays:
            del arrays["grids"]
        archive = BytesIO()
        np.savez_compressed(archive, about=about, **arrays)
        unpacked_bytes = sum(array.nbytes for array in arrays.values())
        if unpacked_bytes > _max_unpacked(archive.getbuffer().nbytes):
            archive = BytesIO()
            np.savez(archive, about=about, **arrays)
        write_output(path, archive.getvalue())

    @staticmethod
    def load(path: StrPath) -> ProblemSet:
        """Read problems that `save` wrote.

        The headers of the arrays are checked before anything is unpacked. The arrays together may
        unpack to 64 MiB, or to 200 times the size of the file but at most 1 GiB; arrays that are
        not compressed may have any size.

        Raises:
            FileNotFoundError: the file does not exist.
            ValueError: the file holds no problems, too many for its size, or problems that
                `ProblemSet` refuses; the message names the file.
        """
        path = Path(path)
        max_bytes = _max_unpacked(path.stat().st_size)
        try:
            archive = Npz(path, sys.maxsize)  # the size is checked below, with a clearer message
            about = json.loads(archive.text("about"))
            has_terrain = "terrain" in archive.shapes
            stored = archive.arrays("terrain" if has_terrain else "grids", "starts", "goals")
            _check_shapes([array.shape for array in stored])
            unpacked_bytes = sum(array.nbytes for array in stored)
            if unpacked_bytes > max_bytes:
                raise ValueError(
                    f"they unpack to {unpacked_bytes} bytes, expected at most {max_bytes}: 64 MiB, "
                    f"or {_MAX_RATIO} times the file up to 1 GiB. If you trust it, save its arrays "
                    "with numpy.savez, uncompressed"
                )
            maps, starts, goals = (array.read() for array in stored)
            return ProblemSet(
                maps == 0 if has_terrain else maps,
                starts,
                goals,
                movement=Movement(**about["movement"]),
                description=str(about["description"]),
                terrain=maps if has_terrain else None,
            )
        except Exception as error:  # the readers of zip and JSON do not document what they raise
            reason = str(error).removeprefix(f"{path}: ")
            raise ValueError(f"{path}: holds no saved problems ({reason})") from None

    @staticmethod
    def sample(
        recipe: RecipeLike,
        seed: int | None = None,
        maps: int | None = None,
        *,
        movement: Movement | None = None,
        problems: SourceLike = Random(distance=(10, None)),
        until_hard: int | None = None,
        radius: float = 0.0,
    ) -> ProblemSet:
        """Sample one problem on each map 0, 1, ... of a recipe.

        The problem on a map is that of a dataset in epoch 0, wherever one of the dataset's 32 draws
        meets the conditions.

        The goal of a random problem is a uniform free cell, or the map's first seed point with
        `Random.to_first_seed_point`; the start is a uniform one of the cells that reach it and are
        far enough. Where the problem does not meet all conditions, both are drawn anew, up to 1,000
        draws in all; then the map is left out. The problem on map i is a pure function of
        (generator, seed, i), of the conditions and of ``movement``.

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
                goal; or a `Route` or `Pairs`, or its name. As for `MapDataset`.
            until_hard: stop at the map that brings the number of hard problems to this.
            radius: of the robot, in metres: maps are those of `mapdata.inflate` (with terrain
                `mapdata.inflate_terrain`) for ``radius / resolution`` cells.

        Raises:
            ValueError: no recipe; no map with a problem; fewer hard problems than ``until_hard``;
                problems without a path (``unsolvable=True``); terrain with costs that are too high
                to be exact.

        >>> from mapdata import Movement
        >>> len(ProblemSet.sample("dungeon", seed=77, maps=20, movement=Movement(8)))
        20

        From corner to corner:

        >>> movement = Movement(8, corner_cutting=True, diagonal_cost=1)
        >>> tiles = ProblemSet.sample("tiles", maps=5, movement=movement, problems="route")
        >>> tiles.starts[0].tolist(), tiles.goals[0].tolist()
        ([0, 0], [11, 11])
        """
        if maps is None and until_hard is not None:
            maps = _MAPS_PER_HARD_PROBLEM * check_count("until_hard", until_hard)
        recipe = as_recipe(recipe, seed=seed, maps=maps)
        chunks = (
            range(start, min(start + _CHUNK_SIZE, recipe.maps))
            for start in range(0, recipe.maps, _CHUNK_SIZE)
        )
        return _sample_until(
            (_map_batch(generate(recipe, indices=chunk), slice(None)) for chunk in chunks),
            problems=problems,
            until_hard=until_hard,
            seed=recipe.seed,
            movement=movement or recipe.generator.movement,
            min_clearance=min_squared_clearance(radius, recipe.generator.resolution),
            source=f"the maps with identity {identity(recipe.generator, recipe.seed)[:12]}",
        )

    @staticmethod
    def read(
        root: Locations,
        maps: int | None = None,
        *,
        movement: Movement | None = None,
        split: str = "test",
        seed: int | None = None,
        problems: SourceLike = Random(distance=(10, None)),
        until_hard: int | None = None,
        radius: float = 0.0,
        follow_links: bool = False,
    ) -> ProblemSet:
        """Sample one problem on each map of a split of a dataset, as `sample` does.

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

        Raises:
            DatasetNotFoundError: there is no dataset under ``root``.
            ShardError: it is damaged.
            ValueError: no such split, or one without maps; what `sample` refuses.
        """
        check_choice("split", split, SPLITS)
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
        batches = (
            _map_batch(labels.maps, labels.maps.split == code) for labels in dataset.labels()
        )
        return _sample_until(
            _first_maps(batches, sys.maxsize if maps is None else check_count("maps", maps)),
            problems=problems,
            until_hard=until_hard,
            seed=check_seed(seed),
            movement=movement or dataset.movement,
            min_clearance=min_clearance,
            source=f"split {split} of {dataset}",
        )


def _without_repeats(arrays: Array) -> Array:
    """Return the first map, (H, W), if all maps, (N, H, W), share its memory; else the maps."""
    arrays = np.asarray(arrays)
    is_repeated = len(arrays) > 0 and arrays.strides[0] == 0
    return arrays[0] if is_repeated else arrays


def _max_unpacked(file_bytes: int) -> int:
    """Return how many bytes the arrays of a saved set of this size may unpack to.

    Arrays that are not compressed are smaller than their file, and so are always allowed.
    """
    return max(_MAX_UNPACKED, min(_MAX_RATIO * file_bytes, MAX_BYTES), file_bytes)


def _check_shapes(shapes: Sequence[tuple[int, ...]]) -> None:
    """Refuse shapes of grids, starts and goals that do not fit together.

    Raises:
        ValueError: the message says which shapes were expected.
    """
    grids, starts, goals = shapes
    if len(grids) != 3 or starts != (grids[0], 2) or goals != starts:
        raise ValueError(
            f"grids, starts and goals have shapes {grids}, {starts} and {goals}, expected "
            "(N, H, W), (N, 2) and (N, 2)"
        )


class _MapBatch(NamedTuple):
    """B maps to sample problems on.

    Attributes:
        indices: (B,) int64, number of each map.
        grids: (B, H, W) uint8.
        terrain: (B, H, W) uint8, or None.
        seed_points: (B, R, 2) int64.
        seed_point_counts: (B,) int64, number of seed points of each map.
    """

    indices: Ints
    grids: Bytes
    terrain: Bytes | None
    seed_points: Ints
    seed_point_counts: Ints

    def select(self, rows: Flags | slice) -> _MapBatch:
        """Return the maps that ``rows`` selects."""
        return _MapBatch(
            self.indices[rows],
            self.grids[rows],
            None if self.terrain is None else self.terrain[rows],
            self.seed_points[rows],
            self.seed_point_counts[rows],
        )


class _SampledProblems(NamedTuple):
    """M sampled problems with a path.

    Attributes:
        indices: (M,) int64, number of the map of each problem.
        grids: (M, H, W) uint8.
        terrain: (M, H, W) uint8, or None.
        starts: (M, 2) int64.
        goals: (M, 2) int64.
    """

    indices: Ints
    grids: Bytes
    terrain: Bytes | None
    starts: Ints
    goals: Ints

    def first(self, count: int) -> _SampledProblems:
        """Return the first ``count`` problems, or all if there are fewer."""
        return _SampledProblems(
            self.indices[:count],
            self.grids[:count],
            None if self.terrain is None else self.terrain[:count],
            self.starts[:count],
            self.goals[:count],
        )


def _map_batch(maps: Maps, rows: Flags | slice) -> _MapBatch:
    """Return the maps that ``rows`` selects."""
    batch = _MapBatch(maps.index, maps.occupancy, maps.terrain, maps.seed_points, maps.rooms)
    return batch.select(rows)


def _first_maps(batches: Iterable[_MapBatch], max_maps: int) -> Iterator[_MapBatch]:
    """Yield batches that together hold the first ``max_maps`` maps of ``batches``."""
    remaining = max_maps
    for batch in batches:
        yield batch.select(slice(remaining))
        remaining -= min(len(batch.indices), remaining)
        if remaining == 0:
            return


def _sample_until(
    batches: Iterable[_MapBatch],
    *,
    problems: SourceLike,
    until_hard: int | None,
    seed: int,
    movement: Movement,
    min_clearance: int,
    source: str,
) -> ProblemSet:
    """Sample a problem on each map of the batches, until there are enough hard problems.

    The arguments are those of `ProblemSet.sample`, with ``min_clearance``, the clearance from which
    on cells are free, in the unit of `min_squared_clearance`; and ``source``, which says where the
    maps come from in the description and in errors.
    """
    problems = problem_source(problems)
    if problems.unsolvable:
        raise ValueError(
            f"problems: got {problems!r}, expected unsolvable=False: a set holds problems that "
            "have a path"
        )
    if until_hard is not None:
        check_count("until_hard", until_hard)
    parts = []
    hard_count = 0
    for batch in batches:
        part = _sample_on(batch, problems, seed, movement, min_clearance)
        if until_hard is not None:
            part, hard_in_part = _until_hard(part, until_hard - hard_count, movement)
            hard_count += hard_in_part
        parts.append(part)
        if hard_count == until_hard:
            break
    if not any(len(part.indices) for part in parts):
        robot = ""
        if min_clearance > 1:  # obstacles are inflated
            robot = f" for a robot with a radius of {_inflation(min_clearance):.3g} cells"
        raise ValueError(f"{source}: no map has a problem that meets {problems}{robot}")
    if until_hard is not None and hard_count < until_hard:
        raise ValueError(
            f"until_hard: got {until_hard}, found only {hard_count} hard problems on {source}"
        )
    indices = np.concatenate([part.indices for part in parts])
    description = f"maps {indices[0]} to {indices[-1]} of {source}, problems by seed {seed}"
    if min_clearance > 0:
        description += f", inflated by {_inflation(min_clearance):.3g} cells"
    # The maps of a source all have terrain, or none has.
    terrains = [part.terrain for part in parts if part.terrain is not None]
    return ProblemSet(
        np.concatenate([part.grids for part in parts]),
        np.concatenate([part.starts for part in parts]),
        np.concatenate([part.goals for part in parts]),
        movement,
        description,
        np.concatenate(terrains) if terrains else None,
    )


def _inflation(min_clearance: int) -> float:
    """Return a clearance in cells; ``min_clearance`` is in half cells, squared."""
    return math.sqrt(min_clearance) / 2


def _sample_on(
    batch: _MapBatch, problems: Source, seed: int, movement: Movement, min_clearance: int
) -> _SampledProblems:
    """Sample a problem on each map; maps without a problem that meets the conditions are left out.

    With a ``min_clearance`` the grids of ``batch`` are inflated in place.
    """
    # Every free cell has a clearance of 1, and the kernel takes seconds to compile.
    if min_clearance > 1:
        inflate_all(batch.grids, min_clearance)
        if batch.terrain is not None:
            inflated = without_occupied(batch.terrain, batch.grids)
            batch = batch._replace(terrain=inflated)
    if isinstance(problems, Random):
        ends = _sample_random(batch, problems, seed, movement)
    else:
        batch = batch.select(batch.seed_point_counts >= 2)  # the maps that have a pair
        ends = _sample_pairs(batch, isinstance(problems, Route), seed, movement)
    has_problem = ends[:, 0] >= 0
    return _SampledProblems(
        batch.indices[has_problem],
        batch.grids[has_problem],
        None if batch.terrain is None else batch.terrain[has_problem],
        starts=ends[has_problem, :2],
        goals=ends[has_problem, 2:],
    )


def _sample_random(batch: _MapBatch, problems: Random, seed: int, movement: Movement) -> Ints:
    """Return the start and goal of a random problem on each map, (B, 4), -1 where there is none."""
    arguments = (
        batch.seed_points[:, 0] if problems.to_first_seed_point else None,
        np.uint64(seed),
        0,  # epoch
        batch.indices,
        _DRAWS,
        *problems.conditions,
        move_rule(movement),
    )
    if batch.terrain is None:
        ends, *_ = sample_problems(batch.grids, *arguments)
        return ends
    ends, _, _, _, failed, high_cost = sample_terrain_problems(batch.terrain, *arguments)
    check_cost(batch.indices, failed, high_cost)
    return ends


def _sample_pairs(batch: _MapBatch, only_route: bool, seed: int, movement: Movement) -> Ints:
    """Return the cells of a pair of seed points of each map, (B, 4), -1 where none has a path.

    With ``only_route`` the pairs are those of consecutive seed points.
    """
    epoch = 0
    keep_unsolvable = False
    rule = move_rule(movement)
    if batch.terrain is None:
        ends, *_ = solve_pairs(
            batch.grids,
            batch.seed_points,
            batch.seed_point_counts,
            np.uint64(seed),
            epoch,
            batch.indices,
            only_route,
            keep_unsolvable,
            ASTAR,
            rule,
        )
        return ends
    ends, _, _, _, failed, high_cost = solve_terrain_pairs(
        batch.terrain,
        batch.seed_points,
        batch.seed_point_counts,
        np.uint64(seed),
        epoch,
        batch.indices,
        only_route,
        keep_unsolvable,
        rule,
    )
    check_cost(batch.indices, failed, high_cost)
    return ends


def _until_hard(
    sampled: _SampledProblems, max_hard: int, movement: Movement
) -> tuple[_SampledProblems, int]:
    """Return the problems up to the hard problem number ``max_hard``, and how many are hard.

    All problems are returned if fewer of them are hard.
    """
    _, grids, terrain, starts, goals = sampled
    cost = search_batch("astar", grids, starts, goals, movement, terrain=terrain).cost
    is_hard = _hardness(cost, starts, goals, terrain, movement) >= HARD
    hard_rows = np.flatnonzero(is_hard)[:max_hard]
    row_count = hard_rows[-1] + 1 if len(hard_rows) == max_hard else len(is_hard)
    return sampled.first(row_count), len(hard_rows)


def _hardness(
    costs: Floats, starts: Ints, goals: Ints, terrain: Bytes | None, movement: Movement
) -> Floats:
    """Return the hardness (N,) of problems on ``terrain``, (N, H, W), or on maps without it."""
    if terrain is None:
        return hardness(costs, starts, goals, movement)
    min_costs = min_cell_costs(_without_repeats(terrain))
    return hardness(costs, starts, goals, movement, min_costs)
