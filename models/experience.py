"""A bank of experience: what a sampler of roadmaps should have sampled, for each problem of a
dataset.

Two kinds of targets. "shortest_path" (Ichter, Harrison, Pavone, ICRA 2018): the vertices of the
shortest path on a dense roadmap. "lego" (Kumar, Mandalika, Choudhury, Srinivasa, IROS 2019): of
those, the bottlenecks, which a sparse roadmap cannot do without even when edges to them cost ten
times their length; and likewise of further near-optimal paths, which are left when an adversary
closes a stretch of the ones found.

    from models.experience import Bank, FixedProblems

    data = FixedProblems(None, build="dungeon", problems="random", movement=(8, False, 2**0.5))
    data.setup("fit")
    bank = Bank.of(data.datasets["train"], "runs/experience")  # mined once, read the next time
    points, counts = bank.targets("lego", [0, 1, 2])
"""

from __future__ import annotations

import hashlib
import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt
from torch.utils.data import Dataset
from tqdm import tqdm

from mapdata.arrays import Bytes, Floats, Ints
from mapdata.datasets import MapDataModule, Sample
from mapdata.shards import write_file
from mapdata.spec import canonical_json
from models.roadmap import Roadmap, between, build_roadmap, halton, radius

KINDS = ("lego", "shortest_path")
"""Targets."""

VERSION = 1
"""Goes up whenever the same mining would give other bytes."""


_PIECE = 100


@dataclass(frozen=True)
class Mining:
    """How experience is gathered.

    Attributes:
        dense: vertices of the roadmap that knows the way.
        sizes: vertices of the roadmaps that the sampler is for; half of them are there already, by
            Halton.
        price: what an edge to a vertex of the path costs, in lengths.
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
    """Return the targets of one problem, (k, 2) points each: "lego" and "shortest_path", empty
    without a path.

    A bottleneck of several sparse roadmaps or paths is there as often.

    Args:
        grid: (H, W), 0 free and 1 occupied.
        start: its cell.
        goal: its cell.
        mining: how.
        seed: of this problem.

    Raises:
        ValueError: a start or goal outside the map or on an occupied cell.
    """
    paths = near_optimal_paths(grid, start, goal, mining, seed)
    found = [
        bottlenecks(
            grid, path, halton(grid, size // 2, seed + 1009 * (k + 1) + size), size, mining.price
        )
        for k, path in enumerate(paths)
        for size in mining.sizes
    ]
    none = np.empty((0, 2))
    return np.concatenate([none, *found]), paths[0][1:-1] if paths else none


def near_optimal_paths(
    grid: Bytes, start: Ints, goal: Ints, mining: Mining, seed: int
) -> list[Floats]:
    """Return up to ``mining.paths`` paths on the dense roadmap, (k, 2) points with both ends, the
    shortest first.
    """
    source = np.random.default_rng([mining.seed, seed])
    dense = between(grid, start, goal, halton(grid, mining.dense, int(source.integers(2**31))))
    prices = np.ones(len(dense.points))
    shortest, path = dense.priced_path(prices)
    paths = [dense.points[path]] if len(path) else []
    for _ in range(mining.attempts if paths else 0):
        if len(paths) == mining.paths or len(paths[-1]) <= 2:
            break
        inner = paths[-1][1:-1]
        about = np.linalg.norm(dense.points - inner[source.integers(len(inner))], axis=1)
        shut = about < mining.closed
        shut[:2] = False
        harder = np.where(shut, np.inf, prices)
        length, path = dense.priced_path(harder)
        if length <= mining.slack * shortest:
            prices = harder
            paths.append(dense.points[path])
    return paths


def bottlenecks(grid: Bytes, path: Floats, sparse: Floats, size: int, price: float) -> Floats:
    """Return the inner points of ``path`` that the cheapest way still uses when edges to them cost
    ``price`` lengths.

    The way is one on the roadmap of ``sparse`` and the path together, which reaches as ``size``
    vertices do. The original raises the prices step by step until the path gives its vertices up.
    The length that a cheapest way keeps on the path never grows with the price, so that the last
    step alone decides.

    Args:
        grid: (H, W), 0 free and 1 occupied.
        path: (k, 2) points, both ends included.
        sparse: (n, 2) points that are there at no extra cost.
        size: vertices of the roadmap that it is to become.
        price: at least 1.
    """
    points = np.concatenate([path[[0, -1]], path[1:-1], sparse])
    roadmap: Roadmap = build_roadmap(grid, points, radius(size, grid.shape))
    prices = np.ones(len(points))
    prices[2 : len(path)] = price
    _, way = roadmap.priced_path(prices)
    return points[way[(way >= 2) & (way < len(path))]]


# --- the bank -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Bank:
    """The targets of N problems, by their number in the dataset.

    Attributes:
        identity: SHA-256 over the problems and how they were mined.
        problem: (N,) int64, ascending.
        ends: (N, 4) int64, start and goal.
        points: of each kind all points, (M, 2) float32.
        offsets: of each kind (N + 1,) int64: those of row i are ``points[offsets[i]:offsets[i +
            1]]``.
    """

    identity: str
    problem: Ints
    ends: Ints
    points: dict[str, npt.NDArray[np.float32]]
    offsets: dict[str, Ints]

    @staticmethod
    def of(
        dataset: Dataset[Sample],
        folder: str | os.PathLike[str],
        mining: Mining = Mining(),
        workers: int | None = None,
    ) -> Bank:
        """Return the bank of all problems of a dataset: read from ``folder`` if it is there, else
        mined and written.

        Args:
            dataset: with the fields ``map``, ``start``, ``goal`` and ``problem``; its samples must
                not change.
            folder: made if missing; the file's name is the bank's identity.
            mining: how.
            workers: processes; default one a core. 0 mines in this one. A script that starts some
                needs the usual ``if __name__ == "__main__":``.

        Raises:
            ValueError: a missing field, or a file that is no bank.
        """
        grids, starts, goals, problem = _all_problems(dataset)
        name = _identity(mining, grids, starts, goals, problem)
        file = Path(folder) / f"{name[:16]}.h5"
        if not file.exists():
            mined = _mine_all(grids, starts, goals, problem, mining, workers)
            ends = np.concatenate([starts, goals], axis=1)
            file.parent.mkdir(parents=True, exist_ok=True)
            _from_rows(name, problem, ends, mined).write(file, mining)
        bank = Bank.read(file)
        if bank.identity != name:
            raise ValueError(
                f"{file}: holds the bank {bank.identity[:16]}, expected {name[:16]}: remove it"
            )
        return bank

    def write(self, file: str | os.PathLike[str], mining: Mining) -> None:
        """Write the bank as one HDF5 file, at once or not at all."""
        buffer = BytesIO()
        with h5py.File(buffer, "w") as h5:
            h5.attrs.update(
                {"format": "mapdata experience", "version": VERSION, "identity": self.identity}
            )
            h5.attrs["mining"] = canonical_json(asdict(mining))
            _dataset(h5, "problem", self.problem, "number of the problem in its dataset")
            _dataset(h5, "ends", self.ends, "start row, start column, goal row, goal column; cells")
            for kind in KINDS:
                _dataset(
                    h5,
                    f"{kind}_offsets",
                    self.offsets[kind],
                    "first point of each problem, N + 1 offsets",
                )
                _dataset(
                    h5,
                    f"{kind}_points",
                    self.points[kind],
                    "(row, col) in cells; a cell's centre is at + 0.5",
                )
        write_file(Path(file), buffer.getvalue())

    @staticmethod
    def read(file: str | os.PathLike[str]) -> Bank:
        """Return the bank in a file.

        Raises:
            ValueError: it is no bank of this version.
        """
        try:
            with h5py.File(file, "r") as h5:
                if (h5.attrs["format"], int(h5.attrs["version"])) != (
                    "mapdata experience",
                    VERSION,
                ):
                    raise ValueError("of another format or version")
                points = {kind: h5[f"{kind}_points"][...] for kind in KINDS}
                offsets = {kind: h5[f"{kind}_offsets"][...] for kind in KINDS}
                return Bank(
                    str(h5.attrs["identity"]), h5["problem"][...], h5["ends"][...], points, offsets
                )
        except (OSError, KeyError, ValueError) as error:
            raise ValueError(
                f"{os.fspath(file)}: no bank of experience ({error}): remove it"
            ) from None

    def targets(
        self, kind: str, problems: Any, ends: npt.ArrayLike | None = None
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
        if kind not in KINDS:
            raise ValueError(f"kind: got {kind!r}, expected one of {', '.join(KINDS)}")
        indices = np.asarray(problems, np.int64)
        rows = np.minimum(np.searchsorted(self.problem, indices), len(self.problem) - 1)
        known = self.problem[rows] == indices
        if ends is not None:
            known &= (self.ends[rows] == np.asarray(ends)).all(axis=1)
        if not known.all():
            wrong = indices[np.argmin(known)]
            raise ValueError(
                f"problem {wrong} is not in the bank, or another one: its dataset must keep its "
                "problems"
            )
        first, counts = self.offsets[kind][rows], np.diff(self.offsets[kind])[rows]
        inside = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        return self.points[kind][np.repeat(first, counts) + inside].astype(np.float64), counts


def _all_problems(dataset: Dataset[Sample]) -> tuple[Bytes, Ints, Ints, Ints]:
    found: list[list[npt.NDArray[Any]]] = []
    for k in range(0, len(dataset), 1000):  # type: ignore[arg-type]
        batch = dataset[k : k + 1000]
        values = dict(zip(batch._fields, batch, strict=True))
        if missing := {"map", "start", "goal", "problem"} - set(values):
            raise ValueError(
                f"fields: the dataset has no {', '.join(sorted(missing))}, which a bank needs"
            )
        found.append([values[name].numpy() for name in ("map", "start", "goal", "problem")])
    maps, starts, goals, problem = (np.concatenate(each) for each in zip(*found, strict=True))
    order = np.argsort(problem)
    return maps[order, 0], starts[order], goals[order], problem[order]


def _identity(mining: Mining, grids: Bytes, starts: Ints, goals: Ints, problem: Ints) -> str:
    digest = hashlib.sha256(canonical_json({"version": VERSION, "mining": asdict(mining)}).encode())
    digest.update(np.packbits(grids, axis=-1).tobytes())
    for array in (starts, goals, problem):
        digest.update(array.astype("<i8").tobytes())
    return digest.hexdigest()


Rows = list[tuple[Floats, Floats]]


def _mine_piece(piece: tuple[Bytes, Ints, Ints, Ints, Mining]) -> Rows:
    *problems, mining = piece
    return [
        mine(grid, start, goal, mining, int(number))
        for grid, start, goal, number in zip(*problems, strict=True)
    ]


def _mine_all(
    grids: Bytes, starts: Ints, goals: Ints, problem: Ints, mining: Mining, workers: int | None
) -> Rows:
    """Mine all problems, piece by piece, with a progress bar; the rows do not depend on the
    workers.
    """
    cuts = [slice(k, k + _PIECE) for k in range(0, len(grids), _PIECE)]
    pieces = [(grids[cut], starts[cut], goals[cut], problem[cut], mining) for cut in cuts]
    rows: Rows = []
    with tqdm(total=len(grids), desc="experience", unit=" problems") as bar:
        for each in _in_processes(pieces, (os.cpu_count() or 1) if workers is None else workers):
            rows += each
            bar.update(len(each))
    return rows


def _in_processes(
    pieces: Sequence[tuple[Bytes, Ints, Ints, Ints, Mining]], workers: int
) -> Iterator[Rows]:
    if workers == 0:
        yield from map(_mine_piece, pieces)
        return
    # torch and numba have threads by now, which a fork would not survive
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(_mine_piece, pieces)


def _from_rows(name: str, problem: Ints, ends: Ints, rows: Rows) -> Bank:
    points, offsets = {}, {}
    for k, kind in enumerate(KINDS):
        each = [row[k] for row in rows]
        points[kind] = np.concatenate([np.empty((0, 2)), *each]).astype(np.float32)
        offsets[kind] = np.cumsum([0, *map(len, each)])
    return Bank(name, problem, ends, points, offsets)


def _dataset(h5: h5py.File, name: str, values: npt.NDArray[Any], description: str) -> None:
    h5.create_dataset(name, data=values).attrs["description"] = description


# --- data that keep their problems --------------------------------------------------------------


class FixedProblems(MapDataModule):
    """A `MapDataModule` whose problems are those of epoch 0 in every epoch: those of a bank."""

    def setup(self, stage: str | None = None) -> None:
        """Open the datasets."""
        super().setup(stage)
        for split, dataset in self.datasets.items():
            if not isinstance(dataset, _FirstEpoch):
                self.datasets[split] = _FirstEpoch(dataset)  # type: ignore[assignment]

    def mine(self, folder: str) -> Bank:
        """Return the bank of the training problems, as `Bank.of` does."""
        return Bank.of(self.datasets["train"], folder)


class _FirstEpoch(Dataset[Sample]):
    """A dataset whose sampler may ask for any epoch, and gets epoch 0."""

    def __init__(self, dataset: Any) -> None:
        self.dataset = dataset

    def __len__(self) -> int:
        return len(self.dataset)

    def __getitem__(self, index: Any) -> Sample:
        sample: Sample = self.dataset[index]
        return sample

    def __getitems__(self, indices: Sequence[int]) -> Any:
        return self.dataset.__getitems__(np.asarray(indices) % len(self.dataset))
