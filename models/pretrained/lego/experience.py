"""A bank of experience: where a sampler of roadmaps should have sampled, problem by problem.

There are two kinds of targets:

- "shortest_path" (Ichter, Harrison, Pavone, ICRA 2018): the vertices of the shortest path on a
  dense roadmap.
- "lego" (Kumar, Mandalika, Choudhury, Srinivasa, IROS 2019): of those vertices, the bottlenecks.
  These are the vertices that a sparse roadmap cannot do without: the cheapest path goes through
  them even when their edges are so dear that it costs ten times the length of the shortest path.
  Bottlenecks are also taken from further near-optimal paths, which remain when an adversary closes
  a stretch of the paths before.

In the original, the sparse roadmap has 200 vertices. Here its size is that of the roadmaps that the
sampler is for.

    from mapdata.models.pretrained.lego.experience import FixedProblems

    data = FixedProblems(
        None,
        build={"spec": "dungeon", "maps": 100},
        problems="random",
        movement=(8, False, 2**0.5),
        experience="runs/experience",
    )
    data.setup("fit")  # mines the bank into the folder, or reads it from there
    points, counts = data.bank.targets("lego", [0, 1, 2])
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from io import BytesIO
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from torch.utils.data import DataLoader, Dataset, Subset
from tqdm.contrib.concurrent import thread_map

from mapdata.arrays import Array, Bytes, Floats, Ints
from mapdata.checks import check_choice
from mapdata.datasets import LateLoader, MapDataModule, Sample
from mapdata.hashing import canonical_json
from mapdata.movement import Movement
from mapdata.problems import Pairs, Random, Route
from mapdata.roadmaps import (
    NO_ROADMAPS_ON_TERRAIN,
    build_roadmap,
    connection_radius,
    halton,
    roadmap_between,
)
from mapdata.shards import write_output

MINED_TARGETS = ("lego", "shortest_path")
"""Names of the targets, in the order in which `mine` returns them."""

BANK_FIELDS = ("map", "start", "goal", "problem")
"""The fields that a dataset must have for a bank."""

VERSION = 2
"""Must be raised by any change after which the same mining gives other points."""


@dataclass(frozen=True)
class Mining:
    """How experience is gathered.

    The names and values of these attributes are part of the identity of a bank.

    Attributes:
        dense: number of vertices of the dense roadmap, on which paths are near-optimal.
        sizes: numbers of vertices of the roadmaps that the sampler is for; half of the vertices are
            Halton's.
        price: cost of the cheapest path after the last raise of prices, in lengths of the path.
        paths: largest number of paths for each problem.
        slack: largest length of a near-optimal path, in lengths of the shortest one.
        closed: radius of the stretch that the adversary closes, in cells.
        attempts: number of stretches that the adversary tries; one that leaves no near-optimal path
            is opened again.
        seed: seed of all random choices.
    """

    dense: int = 2000
    sizes: tuple[int, ...] = (24, 50, 100)
    price: float = 10.0
    paths: int = 2
    slack: float = 1.15
    closed: float = 4.0
    attempts: int = 4
    seed: int = 0


# --- mining one problem -------------------------------------------------------------------------


def mine(
    grid: Bytes, start: Ints, goal: Ints, mining: Mining = Mining(), seed: int = 0
) -> tuple[Floats, Floats]:
    """Return the targets of one problem, (k, 2) points each, in the order of `MINED_TARGETS`.

    Both are empty without a path. A bottleneck of several sparse roadmaps or paths is listed as
    often.

    Args:
        grid: (H, W), 0 free and 1 occupied.
        start: (2,), cell.
        goal: (2,), cell.
        mining: how experience is gathered.
        seed: seed of this problem.

    Raises:
        ValueError: a start or goal outside the map or on an occupied cell.
    """
    no_points = np.empty((0, 2))
    paths = near_optimal_paths(grid, start, goal, mining, seed)
    if not paths:
        return no_points, no_points
    targets = [no_points]
    for k, path in enumerate(paths):
        for size in mining.sizes:
            sparse = halton(grid, size // 2, seed + 1009 * (k + 1) + size)
            targets.append(bottlenecks(grid, path, sparse, size, mining.price))
    inner_points = paths[0][1:-1]
    return np.concatenate(targets), inner_points


def near_optimal_paths(
    grid: Bytes, start: Ints, goal: Ints, mining: Mining, seed: int
) -> list[Floats]:
    """Return up to ``mining.paths`` paths on the dense roadmap, (k, 2) points with both ends.

    The shortest path comes first.
    """
    rng = np.random.default_rng([mining.seed, seed])
    samples = halton(grid, mining.dense, int(rng.integers(2**31)))
    roadmap = roadmap_between(grid, start, goal, samples)
    prices = np.ones(len(roadmap.points))
    shortest, path = roadmap.priced_path(prices)
    if len(path) == 0:
        return []
    paths = [roadmap.points[path]]
    for _ in range(mining.attempts):
        inner_points = paths[-1][1:-1]
        if len(paths) == mining.paths or len(inner_points) == 0:
            break
        middle = inner_points[rng.integers(len(inner_points))]
        closed = np.linalg.norm(roadmap.points - middle, axis=1) < mining.closed
        closed[:2] = False  # start and goal stay open
        prices_with_closed = np.where(closed, np.inf, prices)
        length, path = roadmap.priced_path(prices_with_closed)
        if length <= mining.slack * shortest:
            prices = prices_with_closed
            paths.append(roadmap.points[path])
    return paths


def bottlenecks(grid: Bytes, path: Floats, sparse: Floats, size: int, price: float) -> Floats:
    """Return the inner points of ``path`` that the cheapest path uses, however dear they are.

    The roadmap is that of ``sparse`` and the path together, with edges as long as in a roadmap of
    ``size`` vertices. As in the authors' code (Bottleneck_Node/extract_bottleneck.py of
    https://github.com/personalrobotics/lego), all edges of the path's points are dear, those of
    start and goal included, and their price grows by a fifth until the cheapest path costs
    ``price`` lengths of the path. The last prices decide; they differ from problem to problem, and
    are never below ``price``.

    Args:
        grid: (H, W), 0 free and 1 occupied.
        path: (k, 2) points, both ends included.
        sparse: (n, 2) points whose edges cost their length.
        size: number of vertices of the roadmap that the sampler is for.
        price: cost of the cheapest path at the end, in lengths of the path; at least 1.
    """
    points = np.concatenate([path[[0, -1]], path[1:-1], sparse])
    roadmap = build_roadmap(grid, points, connection_radius(size, grid.shape))
    on_path = np.arange(len(points)) < len(path)  # start and goal, 0 and 1, included
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    # The path itself is in the roadmap, so with prices below ``price`` it would be cheap enough.
    prices = np.where(on_path, price, 1.0)
    cost, vertices = roadmap.priced_path(prices)
    while cost < price * length:
        prices[on_path] *= 1.2
        cost, vertices = roadmap.priced_path(prices)
    is_inner = vertices >= 2
    return points[vertices[is_inner & on_path[vertices]]]


# --- the bank -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Bank:
    """The targets of N problems, by their number in the dataset.

    Attributes:
        identity: SHA-256 over the problems and how they were mined.
        arrays: the arrays of the file, by name.

    - ``problem``: (N,) int64, numbers of the problems, ascending.
    - ``ends``: (N, 4) int64, rows and columns of start and goal.
    - ``lego_points``, ``shortest_path_points``: (M, 2) float32, the points of all problems, one
      problem after another; the centre of a cell is its row and column plus 0.5.
    - ``lego_counts``, ``shortest_path_counts``: (N,) int64, how many points each problem has.
    """

    identity: str
    arrays: dict[str, Array]

    @staticmethod
    def read_or_mine(
        dataset: Dataset[Sample],
        folder: str | os.PathLike[str],
        mining: Mining = Mining(),
        workers: int | None = None,
    ) -> Bank:
        """Return the bank of all problems of a dataset: read from ``folder``, or mined and written.

        Args:
            dataset: a dataset with `BANK_FIELDS`, whose problems do not change from epoch to epoch.
            folder: folder of the banks, made if missing; the file is named by the identity.
            mining: how experience is gathered.
            workers: number of threads; one for each core by default.

        Raises:
            ValueError: a missing field, or a file that is no bank.
        """
        grids, starts, goals, numbers = _all_problems(dataset)
        identity = _identity(mining, grids, starts, goals, numbers)
        file = Path(folder) / f"{identity[:16]}.npz"
        if file.exists():
            return Bank.read(file, identity)
        mined = thread_map(
            mine,
            grids,
            starts,
            goals,
            repeat(mining, len(grids)),  # with a length, which the progress bar needs
            numbers.tolist(),
            max_workers=workers or os.cpu_count(),
            desc="experience",
            unit=" problems",
        )
        arrays = {"problem": numbers, "ends": np.column_stack([starts, goals])}
        for k, name in enumerate(MINED_TARGETS):
            points = [targets[k] for targets in mined]
            arrays[f"{name}_points"] = np.concatenate(points).astype(np.float32)
            arrays[f"{name}_counts"] = np.array([len(p) for p in points])
        bank = Bank(identity, arrays)
        bank.write(file)
        return bank

    def write(self, file: Path) -> None:
        """Write the bank as an .npz file, as a whole or not at all."""
        buffer = BytesIO()
        np.savez(buffer, identity=self.identity, **self.arrays)  # type: ignore[arg-type]
        file.parent.mkdir(parents=True, exist_ok=True)
        write_output(file, buffer.getvalue())

    @staticmethod
    def read(file: Path, identity: str) -> Bank:
        """Return the bank in a file.

        Raises:
            ValueError: the file is no bank, or has another identity.
        """
        try:
            with np.load(file) as saved:
                arrays = dict(saved)
            if arrays.pop("identity").item() != identity:
                raise ValueError(f"of other problems, expected {identity[:16]}")
            return Bank(identity, arrays)
        except Exception as error:  # which errors the readers of numpy and zip raise is unknown
            raise ValueError(f"{file}: no bank of experience ({error}): remove it") from None

    def targets(
        self, name: str, problems: ArrayLike, ends: ArrayLike | None = None
    ) -> tuple[Floats, Ints]:
        """Return the points of problems, one problem after another, and the points of each.

        Args:
            name: one of `MINED_TARGETS`.
            problems: (B,) numbers in the dataset, as in the field ``problem`` of a batch.
            ends: (B, 4) rows and columns of start and goal, to check that these are the problems of
                the bank; without them numbers alone are checked.

        Returns:
            Points (M, 2), and the number of points of each problem, (B,), whose sum is M.

        Raises:
            ValueError: an unknown name, a number that is not in the bank, or other ends than those
                in the bank.
        """
        check_choice("targets", name, MINED_TARGETS)
        numbers = np.asarray(problems, np.int64)
        rows = pd.Index(self.arrays["problem"]).get_indexer(pd.Index(numbers))
        is_known = rows >= 0  # -1 is no row
        if ends is not None:
            is_known &= (self.arrays["ends"][rows] == np.asarray(ends)).all(axis=1)
        if not is_known.all():
            unknown = numbers[np.argmin(is_known)]
            raise ValueError(
                f"problem {unknown} is not in the bank, or another one: its dataset must keep its "
                "problems"
            )
        points = self.arrays[f"{name}_points"]
        counts = self.arrays[f"{name}_counts"]
        stops = counts.cumsum()
        starts = stops - counts
        parts = [points[starts[row] : stops[row]] for row in rows]
        return np.concatenate(parts).astype(np.float64), counts[rows]


def _all_problems(dataset: Dataset[Sample]) -> tuple[Bytes, Ints, Ints, Ints]:
    """Return maps (N, H, W), starts, goals (N, 2) and numbers (N,) of all problems, by number."""
    batch = dataset[:]
    if missing := set(BANK_FIELDS) - set(batch._fields):
        raise ValueError(
            f"fields: the dataset has no {', '.join(sorted(missing))}, which a bank needs"
        )
    maps, starts, goals, numbers = (getattr(batch, name).numpy() for name in BANK_FIELDS)
    order = np.argsort(numbers)
    return maps[order, 0], starts[order], goals[order], numbers[order]


def _identity(mining: Mining, grids: Bytes, starts: Ints, goals: Ints, numbers: Ints) -> str:
    """Return the identity of a bank."""
    digest = hashlib.sha256(canonical_json({"version": VERSION, "mining": asdict(mining)}).encode())
    digest.update(np.packbits(grids, axis=-1).tobytes())
    for array in (starts, goals, numbers):
        digest.update(array.astype("<i8").tobytes())
    return digest.hexdigest()


# --- data that keep their problems --------------------------------------------------------------


class FixedProblems(MapDataModule):
    """A `MapDataModule` whose problems are those of epoch 0 in every epoch, with their bank.

    ``setup("fit")`` mines the bank of the training problems, or reads it. The 12,000 problems of
    64 x 64 cells from which the pretrained weights were trained take ten minutes of one core, once.

    Args:
        root, build, batch_size, num_workers, fields, problems, movement, sampling_seed, radius: as
            in `MapDataModule`.
        experience: folder of the bank; None for data without a bank, which is enough for a sampler
            with ``targets="path"``.
        mining: how experience is gathered.

    Attributes:
        bank: the bank of the training problems, or None before ``setup`` and without a folder.

    Raises:
        ValueError: arguments that do not fit, or that would do nothing.
    """

    def __init__(
        self,
        root: str | Path | Sequence[str] | None = "data/maps",
        *,
        build: str | dict[str, Any] | None = None,
        batch_size: int = 256,
        num_workers: int = 0,
        fields: Sequence[str] = BANK_FIELDS,
        problems: str | Route | Pairs | Random | dict[str, Any] = "route",
        movement: Movement | tuple[int, bool, float] | None = None,
        sampling_seed: int = 0,
        radius: float = 0.0,
        experience: str | None = "runs/experience",
        mining: Mining = Mining(),
    ) -> None:
        """Keep the arguments; nothing is read, built or mined yet."""
        super().__init__(
            root,
            build=build,
            batch_size=batch_size,
            num_workers=num_workers,
            fields=fields,
            problems=problems,
            movement=movement,
            sampling_seed=sampling_seed,
            radius=radius,
        )
        self.experience = experience
        self.mining = mining
        self.bank: Bank | None = None

    def setup(self, stage: str | None = None) -> None:
        """Open the datasets of ``stage``; for training, mine or read the bank.

        Raises:
            ValueError: maps with terrain.
        """
        super().setup(stage)
        check_no_terrain(self)
        if self.experience is not None and self.bank is None and "train" in self.datasets:
            self.bank = Bank.read_or_mine(self.datasets["train"], self.experience, self.mining)

    def train_dataloader(self) -> DataLoader[Sample]:
        """Return the loader of the training split, in an order of its own each epoch."""
        loader = super().train_dataloader()
        dataset = _FirstEpoch(loader.dataset, range(len(self.datasets["train"])))
        return LateLoader(
            dataset,
            self.batch_size,
            sampler=loader.sampler,
            drop_last=loader.drop_last,
            **self.loader_options,
        )


def check_no_terrain(data: MapDataModule) -> None:
    """Check that the datasets of a data module, which are open, have no terrain.

    Raises:
        ValueError: one of them has it.
    """
    if any(dataset.has_terrain for dataset in data.datasets.values()):
        raise ValueError(NO_ROADMAPS_ON_TERRAIN)


class _FirstEpoch(Subset[Sample]):
    """A dataset that gives samples of epoch 0, whichever epoch its sampler asks for."""

    def __getitems__(self, indices: Sequence[int]) -> Any:
        dataset: Any = self.dataset
        # The sampler asks for index + epoch * len(dataset).
        return dataset.__getitems__(np.asarray(indices) % len(self))
