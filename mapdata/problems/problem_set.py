"""Problems that planners are compared on: sampled on new maps, or on one split of a dataset."""

from __future__ import annotations

import hashlib
import json
import math
import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from io import BytesIO
from pathlib import Path

import numpy as np

from mapdata.arrays import Array, Bytes, Flags, Floats, Ints, summary
from mapdata.checks import check_choice, check_count, check_seed
from mapdata.generators.generator import MapGenerator, check_spec, generate, identity
from mapdata.generators.maps import Maps
from mapdata.hashing import canonical_json
from mapdata.limits import SPLITS
from mapdata.movement import Movement
from mapdata.npy import MAX_BYTES, Npz
from mapdata.problems.sampling import sample_problems
from mapdata.problems.sources import Random
from mapdata.search.api import BatchResult, search_batch
from mapdata.search.footprint import inflate_all, min_squared_clearance
from mapdata.search.lattice import HARD, hardness, move_rule
from mapdata.shards.files import StrPath, write_output
from mapdata.shards.root import Places, Root

_DRAWS = (0, 1000)
"""The draws that are tried on a map; a dataset goes on to another map sooner."""

_MAPS_A_CHUNK = 256
_ARRAYS = ("grids", "starts", "goals")

_MAX_UNPACKED = 2**26
"""Bytes that the arrays of any saved set may unpack to: 16,000 maps of 64 x 64 cells."""

_MAX_RATIO = 200
"""How many times its file a larger set may unpack to, up to `MAX_BYTES`. Maps that planners are
compared on reach some 10 to 160 times; a file that is made to fill the memory reaches 1,000.
"""


@dataclass(frozen=True, eq=False)
class ProblemSet:
    """N problems that planners are compared on, each with a path.

    The arrays are copied and cannot be written to. A grid that `numpy.broadcast_to` has given to
    all problems is kept once.

    Attributes:
        grids: (N, H, W) uint8, 0 free and 1 occupied.
        starts: (N, 2) int64, cells.
        goals: (N, 2) int64, cells other than the starts.
        movement: how one moves; `sample` and `read` take 8-connected moves without corner cutting
            by default.
        description: where they come from, in words.

    Raises:
        ValueError: what `search_batch` refuses; a problem without a path, or whose start is its
            goal.
    """

    grids: Bytes
    starts: Ints
    goals: Ints
    movement: Movement
    description: str = "problems"

    def __post_init__(self) -> None:
        """Solve the problems, so that bad ones are refused here, and copy the arrays."""
        if np.ndim(self.grids) != 3:  # one (H, W) would serve all problems of `search_batch`
            raise ValueError(f"grids: got shape {np.shape(self.grids)}, expected (N, H, W)")
        cost = self.optimal.cost
        for bad_cost, why in ((-1, "has no path"), (0, "starts at its goal")):
            if (cost == bad_cost).any():
                raise ValueError(f"problem {int(np.argmax(cost == bad_cost))} {why}: leave it out")
        for name, dtype in zip(_ARRAYS, (np.uint8, np.int64, np.int64), strict=True):
            shape = np.shape(getattr(self, name))
            array = np.array(_shared(getattr(self, name)), dtype, order="C")
            if array.shape != shape:
                array = np.broadcast_to(array, shape)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    __repr__ = summary

    def __len__(self) -> int:
        """Return N, the number of problems."""
        return len(self.starts)

    @cached_property
    def optimal(self) -> BatchResult:
        """What mapdata's A* finds: optimal costs, and the iterations to compare planners with."""
        grids = _shared(self.grids)
        return search_batch("astar", grids, self.starts, self.goals, self.movement)

    @cached_property
    def hardness(self) -> Floats:
        """(N,) optimal cost over heuristic (the cost on an empty grid); 1 is the easiest."""
        return hardness(self.optimal.cost, self.starts, self.goals, self.movement)

    @cached_property
    def hard(self) -> Flags:
        """(N,) bool: the hardness is at least ``HARD``."""
        return self.hardness >= HARD

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 of the problems, as hex: whoever has the same hash compared on the same set."""
        digest = hashlib.sha256(canonical_json(asdict(self.movement)).encode())
        for name in _ARRAYS:
            array = getattr(self, name)
            digest.update(f"{name} {array.shape}".encode())
            for entry in array:  # one at a time, since many may share the memory of one
                digest.update(entry.astype(entry.dtype.newbyteorder("<")).tobytes())
        return digest.hexdigest()

    def save(self, path: StrPath) -> None:
        """Write the problems to a compressed .npz; the same problems are the same bytes.

        It holds ``grids``, ``starts`` and ``goals`` as above, and ``about``: JSON of the rest. A
        file that is there is replaced at once, or not at all. A set that would unpack to more than
        `load` allows is not compressed: one of over 1 GiB, or many large and nearly empty maps.
        """
        about = {"movement": asdict(self.movement), "description": self.description}
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        file = BytesIO()
        np.savez_compressed(file, about=canonical_json(about), **arrays)
        size = file.getbuffer().nbytes
        if sum(array.nbytes for array in arrays.values()) > _max_unpacked(size):
            file = BytesIO()
            np.savez(file, about=canonical_json(about), **arrays)
        write_output(path, file.getvalue())

    @staticmethod
    def load(path: StrPath) -> ProblemSet:
        """Read what `save` wrote.

        The headers of the arrays are checked before anything is unpacked. All together may unpack
        to 64 MiB, or to 200 times the size of the file but not over 1 GiB; uncompressed ones may
        have any size.

        Raises:
            FileNotFoundError: no such file.
            ValueError: it holds no problems, too many for its size, or what `ProblemSet` refuses;
                the message names it.
        """
        path = Path(path)
        limit = _max_unpacked(path.stat().st_size)
        try:
            archive = Npz(path, sys.maxsize)  # the limit is compared below, in words of its own
            about = json.loads(archive.text("about"))
            stored = archive.arrays(*_ARRAYS)
            _check_shapes([array.shape for array in stored])
            size = sum(array.nbytes for array in stored)
            if size > limit:
                raise ValueError(
                    f"they unpack to {size} bytes, expected at most {limit}: 64 MiB, or "
                    f"{_MAX_RATIO} times the file up to 1 GiB. If you trust it, save its arrays "
                    "with numpy.savez, uncompressed"
                )
            grids, starts, goals = (array.read() for array in stored)
            return ProblemSet(
                grids,
                starts,
                goals,
                movement=Movement(**about["movement"]),
                description=str(about["description"]),
            )
        except Exception as error:  # what zip's and JSON's readers raise is not documented
            why = str(error).removeprefix(f"{path}: ")
            raise ValueError(f"{path}: holds no saved problems ({why})") from None

    @staticmethod
    def sample(
        spec: MapGenerator,
        seed: int,
        maps: int | None = None,
        *,
        problems: Random = Random(distance=(10, None)),
        until_hard: int | None = None,
        movement: Movement = Movement(8),
        radius: float = 0.0,
    ) -> ProblemSet:
        """Sample one problem on each map 0, 1, ... of (spec, seed).

        It is that of a dataset in epoch 0, where one of the first 32 draws meets the conditions.

        The goal is a uniform free cell, or the map's first seed point with
        `Random.to_first_seed_point`; the start is a uniform one of the cells that reach it and are
        far enough. Where the problem does not meet all conditions, both are drawn anew, up to 1,000
        draws in all; then the map is left out. The problem on map i is a pure function of (spec,
        seed, i), of the conditions and of ``movement``.

        Args:
            spec: the distribution of maps; its own movement is not used.
            seed: 64-bit seed of the maps and of the problems.
            maps: how many maps; with ``until_hard`` at most that many.
            problems: the conditions on distance, hardness and length, and on the goal.
            until_hard: stop at the map that brings the number of hard problems to this.
            movement: how one moves.
            radius: of the robot, in metres: maps are those of `mapdata.inflate` for ``radius /
                spec.resolution`` cells.

        Raises:
            ValueError: what is no spec; neither ``maps`` nor ``until_hard``; no map with a problem;
                not enough hard ones (without ``maps``: less than one on 1,000 maps).

        >>> from mapdata import MapSpec
        >>> len(ProblemSet.sample(MapSpec.preset("dungeon"), seed=77, maps=20))
        20
        """
        check_spec(spec)
        if maps is None:
            if until_hard is None:
                raise ValueError("got neither maps nor until_hard, expected one of them or both")
            # fewer hard ones than one on 1,000 maps are not worth the wait
            maps = 1000 * check_count("until_hard", until_hard)
        check_count("maps", maps)
        chunks = (range(maps)[k : k + _MAPS_A_CHUNK] for k in range(0, maps, _MAPS_A_CHUNK))
        chosen = ((generate(spec, seed, chunk), slice(None)) for chunk in chunks)
        where = f"the maps with identity {identity(spec, seed)[:12]}"
        least = min_squared_clearance(radius, spec.resolution)
        return _collect(
            chosen, maps, problems, until_hard, check_seed(seed), movement, where, least
        )

    @staticmethod
    def read(
        root: Places,
        maps: int | None = None,
        *,
        split: str = "test",
        seed: int | None = None,
        problems: Random = Random(distance=(10, None)),
        until_hard: int | None = None,
        movement: Movement = Movement(8),
        radius: float = 0.0,
    ) -> ProblemSet:
        """Sample one problem on each map of a split of a dataset: that which `sample` gives.

        Args:
            root: folder or URL of the dataset, or several.
            maps: how many maps of the split at most; all without.
            split: "train", "val" or "test".
            seed: seed of the problems; default the (first) dataset's own, 0 for imported maps.
            problems: as in `sample`.
            until_hard: as in `sample`.
            movement: how one moves.
            radius: as in `sample`.

        Raises:
            DatasetNotFoundError: there is no dataset under ``root``.
            ShardError: it is damaged.
            ValueError: no such split; no map with a problem; not enough hard ones.
        """
        check_choice("split", split, SPLITS)
        dataset = Root.open(root)
        if seed is None:
            seed = dataset.manifests[0].seed or 0
        chosen = (
            (labels.maps, labels.maps.split == SPLITS.index(split)) for labels in dataset.labels()
        )
        where = f"split {split} of {dataset}"
        # only with a radius must all roots have one resolution
        least = min_squared_clearance(radius, dataset.resolution) if radius else 0
        return _collect(
            chosen, maps, problems, until_hard, check_seed(seed), movement, where, least
        )


def _shared(arrays: Array) -> Array:
    """Return the only grid, (H, W), if all of (N, H, W) are views of it; else the arrays."""
    arrays = np.asarray(arrays)
    return arrays[0] if len(arrays) > 0 and arrays.strides[0] == 0 else arrays


def _max_unpacked(size: int) -> int:
    """Return to how many bytes the arrays of a saved set may unpack whose file has ``size``.

    Arrays that are not compressed are smaller than their file, and always allowed.
    """
    return max(_MAX_UNPACKED, min(_MAX_RATIO * size, MAX_BYTES), size)


def _check_shapes(shapes: Sequence[tuple[int, ...]]) -> None:
    """Refuse shapes of grids, starts and goals that do not fit together.

    Raises:
        ValueError: the message says what was expected.
    """
    grids, starts, goals = shapes
    if len(grids) != 3 or starts != (grids[0], 2) or goals != starts:
        raise ValueError(
            f"grids, starts and goals have shapes {grids}, {starts} and {goals}, expected "
            "(N, H, W), (N, 2) and (N, 2)"
        )


def _collect(
    chosen: Iterable[tuple[Maps, Flags | slice]],
    maps: int | None,
    problems: Random,
    until_hard: int | None,
    seed: int,
    movement: Movement,
    where: str,
    least: int,
) -> ProblemSet:
    """Sample a problem on each of the first ``maps`` of what is chosen of some batches of maps.

    With ``until_hard``, the last problem is that which brings the hard ones to this number. Cells
    are free from the clearance ``least`` on.
    """
    if not isinstance(problems, Random):
        raise ValueError(f"problems: got {problems!r}, expected mapdata.Random(...)")
    if until_hard is not None:
        check_count("until_hard", until_hard)
    left = sys.maxsize if maps is None else check_count("maps", maps)
    found = []
    hard = 0
    for each, which in chosen:
        indices = each.index[which][:left]
        grids = each.occupancy[which][:left]
        goals = each.seed_points[which][:left, 0] if problems.to_first_seed_point else None
        left -= len(indices)
        if least > 1:  # else nothing changes, and the kernel need not be compiled
            inflate_all(grids, least)
        sampled, *_ = sample_problems(
            grids,
            goals,
            np.uint64(seed),
            0,
            indices,
            _DRAWS,
            *problems.conditions,
            move_rule(movement),
        )
        kept = np.flatnonzero(sampled[:, 0] >= 0)  # -1: the map has no such problem
        if until_hard is not None:
            starts, goals = np.split(sampled[kept], 2, axis=1)
            cost = search_batch("astar", grids[kept], starts, goals, movement).cost
            hard_so_far = hard + np.cumsum(hardness(cost, starts, goals, movement) >= HARD)
            enough = np.searchsorted(hard_so_far, until_hard) + 1
            kept = kept[:enough]
            hard = hard_so_far[:enough].max(initial=hard)
        found.append((indices[kept], grids[kept], sampled[kept]))
        if left == 0 or hard == until_hard:
            break
    if not any(len(kept) for kept, _, _ in found):
        raise ValueError(f"{where}: no map has a problem that meets {problems}")
    if until_hard is not None and hard < until_hard:
        raise ValueError(
            f"until_hard: got {until_hard}, found only {hard} hard problems on {where}"
        )
    index, grid, ends = (np.concatenate(parts) for parts in zip(*found, strict=True))
    description = f"maps {index[0]} to {index[-1]} of {where}, problems by seed {seed}"
    if least:
        description += f", inflated by {math.sqrt(least) / 2:.3g} cells"
    return ProblemSet(grid, ends[:, :2], ends[:, 2:], movement, description)
