"""A bank of experience: where a sampler of roadmaps should have sampled, problem by problem.

Two kinds of targets. "shortest_path" (Ichter, Harrison, Pavone, ICRA 2018): the vertices of the
shortest path on a dense roadmap. "lego" (Kumar, Mandalika, Choudhury, Srinivasa, IROS 2019): of
those, the bottlenecks, which a sparse roadmap cannot do without even when edges to them are so dear
that the cheapest way costs ten times the path; and likewise of further near-optimal paths, which
are left when an adversary closes a stretch of the ones found.

Of the original, the sparse roadmap is one of 200 vertices, whatever the size of those to come.

    from models.lego.experience import FixedProblems

    data = FixedProblems(None, build={"spec": "dungeon", "maps": 100}, problems="random",
        movement=(8, False, 2**0.5), fields=("map", "start", "goal", "problem"))
    data.setup("fit")
    bank = data.mine("runs/experience")  # mined once, read the next time
    points, counts = bank.targets("lego", [0, 1, 2])
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
from mapdata.shards import write_output
from models.lego.roadmap import between, build_roadmap, halton, radius

KINDS = ("lego", "shortest_path")
"""Targets."""

VERSION = 2
"""Goes up whenever the same mining would give other points."""


@dataclass(frozen=True)
class Mining:
    """How experience is gathered.

    Attributes:
        dense: vertices of the roadmap that knows the way.
        sizes: vertices of the roadmaps that the sampler is for; half of them are there already, by
            Halton.
        price: what the cheapest way must cost in the end, in lengths of the path.
        paths: most paths a problem.
        slack: longest path that is near-optimal, in lengths of the shortest.
        closed: radius of the stretch that the adversary closes, in cells.
        attempts: how often it tries; a stretch that leaves no near-optimal path is opened again.
        seed: of all that is drawn.
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
    """Return the targets of one problem, (k, 2) points each, in the order of `KINDS`.

    Both are empty without a path. A bottleneck of several sparse roadmaps or paths is there as
    often.

    Args:
        grid: (H, W), 0 free and 1 occupied.
        start: its cell.
        goal: its cell.
        mining: how.
        seed: of this problem.

    Raises:
        ValueError: a start or goal outside the map or on an occupied cell.
    """
    none = np.empty((0, 2))
    paths = near_optimal_paths(grid, start, goal, mining, seed)
    needed = [none]
    for k, path in enumerate(paths):
        for size in mining.sizes:
            sparse = halton(grid, size // 2, seed + 1009 * (k + 1) + size)
            needed.append(bottlenecks(grid, path, sparse, size, mining.price))
    return np.concatenate(needed), paths[0][1:-1] if paths else none


def near_optimal_paths(
    grid: Bytes, start: Ints, goal: Ints, mining: Mining, seed: int
) -> list[Floats]:
    """Return up to ``mining.paths`` paths on the dense roadmap, (k, 2) points with both ends.

    The shortest comes first.
    """
    source = np.random.default_rng([mining.seed, seed])
    dense = between(grid, start, goal, halton(grid, mining.dense, int(source.integers(2**31))))
    prices = np.ones(len(dense.points))
    shortest, path = dense.priced_path(prices)
    if len(path) == 0:
        return []
    paths = [dense.points[path]]
    for _ in range(mining.attempts):
        if len(paths) == mining.paths or len(paths[-1]) <= 2:
            break
        inner = paths[-1][1:-1]
        middle = inner[source.integers(len(inner))]
        closed = np.linalg.norm(dense.points - middle, axis=1) < mining.closed
        closed[:2] = False  # start and goal stay open
        harder = np.where(closed, np.inf, prices)
        length, path = dense.priced_path(harder)
        if length <= mining.slack * shortest:
            prices = harder
            paths.append(dense.points[path])
    return paths


def bottlenecks(grid: Bytes, path: Floats, sparse: Floats, size: int, price: float) -> Floats:
    """Return the inner points of ``path`` that the cheapest way uses however dear they are.

    On the roadmap of ``sparse`` and the path together, which reaches as ``size`` vertices do. As in
    the authors' code (Bottleneck_Node/extract_bottleneck.py of
    https://github.com/personalrobotics/lego), all edges of the path's points are dear, those of
    start and goal too, and grow by a fifth until the cheapest way costs ``price`` paths; that one
    decides. The last factor differs from problem to problem, and is never below ``price``.

    Args:
        grid: (H, W), 0 free and 1 occupied.
        path: (k, 2) points, both ends included.
        sparse: (n, 2) points that are there at no extra cost.
        size: vertices of the roadmap that it is to become.
        price: at least 1.
    """
    points = np.concatenate([path[[0, -1]], path[1:-1], sparse])
    roadmap = build_roadmap(grid, points, radius(size, grid.shape))
    on_path = np.arange(len(points)) < len(path)  # start and goal, 0 and 1, included
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    # below ``price`` the path itself is too cheap
    prices = np.where(on_path, price, 1.0)
    cost, way = roadmap.priced_path(prices)
    while cost < price * length:
        prices[on_path] *= 1.2
        cost, way = roadmap.priced_path(prices)
    return points[way[(way >= 2) & on_path[way]]]


# --- the bank -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Bank:
    """The targets of N problems, by their number in the dataset.

    Attributes:
        identity: SHA-256 over the problems and how they were mined.
        arrays: by their names in the file.

    - ``problem``: (N,) int64, ascending.
    - ``ends``: (N, 4) int64, start and goal.
    - ``<kind>_points``: of each kind all points, (M, 2) float32; a cell's centre is at + 0.5.
    - ``<kind>_counts``: of each kind (N,) int64, how many of them belong to each problem.
    """

    identity: str
    arrays: dict[str, Array]

    @staticmethod
    def of(
        dataset: Dataset[Sample],
        folder: str | os.PathLike[str],
        mining: Mining = Mining(),
        workers: int | None = None,
    ) -> Bank:
        """Return the bank of all problems of a dataset: read from ``folder``, or mined and written.

        Args:
            dataset: with the fields ``map``, ``start``, ``goal`` and ``problem``; its samples must
                not change.
            folder: made if missing; the file's name is the bank's identity.
            mining: how.
            workers: threads; default one a core.

        Raises:
            ValueError: a missing field, or a file that is no bank.
        """
        grids, starts, goals, problem = _all_problems(dataset)
        name = _identity(mining, grids, starts, goals, problem)
        file = Path(folder) / f"{name[:16]}.npz"
        if file.exists():
            return Bank.read(file, name)
        mined = thread_map(
            mine,
            grids,
            starts,
            goals,
            repeat(mining, len(grids)),  # a length for the bar
            problem.tolist(),
            max_workers=workers or os.cpu_count(),
            desc="experience",
            unit=" problems",
        )
        arrays = {"problem": problem, "ends": np.column_stack([starts, goals])}
        for kind, each in zip(KINDS, zip(*mined, strict=True), strict=True):
            arrays[f"{kind}_points"] = np.concatenate(each).astype(np.float32)
            arrays[f"{kind}_counts"] = np.array([len(some) for some in each])
        bank = Bank(name, arrays)
        bank.write(file)
        return bank

    def write(self, file: Path) -> None:
        """Write the bank as one file of numpy's, at once or not at all."""
        buffer = BytesIO()
        np.savez(buffer, identity=self.identity, **self.arrays)  # type: ignore[arg-type]
        file.parent.mkdir(parents=True, exist_ok=True)
        write_output(file, buffer.getvalue())

    @staticmethod
    def read(file: Path, identity: str) -> Bank:
        """Return the bank in a file.

        Raises:
            ValueError: it is no bank, or has another identity.
        """
        try:
            with np.load(file) as saved:
                arrays = dict(saved)
            if arrays.pop("identity").item() != identity:
                raise ValueError(f"of other problems, expected {identity[:16]}")
            return Bank(identity, arrays)
        except Exception as error:  # what numpy's and zip's readers raise is not documented
            raise ValueError(f"{file}: no bank of experience ({error}): remove it") from None

    def targets(
        self, kind: str, problems: Any, ends: ArrayLike | None = None
    ) -> tuple[Floats, Ints]:
        """Return the points of each problem one after another, (M, 2), and how many each has, (B,).

        Args:
            kind: one of `KINDS`.
            problems: (B,) numbers in the dataset, as a batch's field ``problem`` has them.
            ends: (B, 4) start and goal; where they are not the bank's, the bank is not of these
                problems.

        Raises:
            ValueError: an unknown kind, or a problem that the bank does not know or knows
                otherwise.
        """
        check_choice("kind", kind, KINDS)
        numbers = np.asarray(problems, np.int64)
        rows = pd.Index(self.arrays["problem"]).get_indexer(pd.Index(numbers))  # -1: not there
        known = rows >= 0
        if ends is not None:
            known &= (self.arrays["ends"][rows] == np.asarray(ends)).all(axis=1)
        if not known.all():
            wrong = numbers[np.argmin(known)]
            raise ValueError(
                f"problem {wrong} is not in the bank, or another one: its dataset must keep its "
                "problems"
            )
        points = self.arrays[f"{kind}_points"]
        counts = self.arrays[f"{kind}_counts"]
        last = counts.cumsum()
        found = [points[last[row] - counts[row] : last[row]] for row in rows]
        return np.concatenate(found).astype(np.float64), counts[rows]


def _all_problems(dataset: Dataset[Sample]) -> list[Array]:
    """Return maps (N, H, W), starts, goals and numbers of all problems, by their number."""
    names = ("map", "start", "goal", "problem")
    batch = dataset[:]
    if missing := set(names) - set(batch._fields):
        raise ValueError(
            f"fields: the dataset has no {', '.join(sorted(missing))}, which a bank needs"
        )
    maps, starts, goals, problem = (getattr(batch, name).numpy() for name in names)
    order = np.argsort(problem)
    return [maps[order, 0], starts[order], goals[order], problem[order]]


def _identity(mining: Mining, grids: Bytes, *numbers: Ints) -> str:
    """Return the identity of a bank: of starts, goals and numbers of its problems."""
    digest = hashlib.sha256(canonical_json({"version": VERSION, "mining": asdict(mining)}).encode())
    digest.update(np.packbits(grids, axis=-1).tobytes())
    for array in numbers:
        digest.update(array.astype("<i8").tobytes())
    return digest.hexdigest()


# --- data that keep their problems --------------------------------------------------------------


class FixedProblems(MapDataModule):
    """A `MapDataModule` whose problems are those of epoch 0 in every epoch: those of a bank."""

    def train_dataloader(self) -> DataLoader[Sample]:
        """Return the loader of the training split, in an order of its own each epoch."""
        loader = super().train_dataloader()
        fixed = _FirstEpoch(loader.dataset, range(len(self.datasets["train"])))
        return LateLoader(fixed, self.batch_size, sampler=loader.sampler, **self.loading)

    def mine(self, folder: str) -> Bank:
        """Return the bank of the training problems, as `Bank.of` does."""
        return Bank.of(self.datasets["train"], folder)


class _FirstEpoch(Subset[Sample]):
    """A dataset whose sampler may ask for any epoch, and gets epoch 0."""

    def __getitems__(self, indices: Sequence[int]) -> Any:
        first: Any = self.dataset
        return first.__getitems__(np.asarray(indices) % len(self))
