"""Loading batches beside what people do otherwise: python -m benchmarks loading.

Everything is measured in one run, on one thread. Readers that stand beside ours must first give
equal batches; those whose package is not installed are left out.
"""

from __future__ import annotations

import ast
import csv
import io
import logging
import pickle
import statistics
import tarfile
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import numpy.typing as npt
import pytorch_lightning as pl
import torch
from PIL import Image
from torch.utils.data import DataLoader, Dataset, IterableDataset, TensorDataset

from benchmarks.measure import Peer, Row, interleaved, median_ratio, to_text
from mapdata import (
    MapDataModule,
    MapDataset,
    MapSpec,
    Movement,
    OnlineMapDataset,
    Random,
    Sample,
    build,
)

PACKAGES = ("mapdata-torch", "torch", "pytorch-lightning", "numpy", "numba", "h5py", "pillow")
ARROW = Peer("HF datasets", "datasets", "datasets", 'load_from_disk(path).with_format("torch")[i]')
TAR = Peer("webdataset", "webdataset", "webdataset", "WebDataset(path).decode().to_tuple(...)")
ZARR = Peer("zarr", "zarr", "zarr", "array.oindex[indices], or array[i]")
LITDATA = Peer("litdata", "litdata", "litdata", "StreamingDataLoader(StreamingDataset(path))")
PEERS = (
    Peer("in-RAM tensors", "torch", "torch", "tensor[idx]"),
    Peer(
        "TensorDataset", "torch", "torch", "DataLoader(TensorDataset(*tensors), batch_sampler=...)"
    ),
    Peer("naive h5py", "h5py", "h5py", "h5py.File(path)[name][i]"),
    Peer("npz", "numpy", "numpy", "np.load(path)[name], then array[i]"),
    Peer("PNG + CSV", "pillow", "PIL", "Image.open(png), ast.literal_eval(cell of the csv)"),
    ARROW,
    TAR,
    ZARR,
    LITDATA,
)
SPEC = MapSpec.preset("paper")
BATCH = 256
MASKED = ("map", "start", "goal", "path_mask")
IN_RAM = 40_000
"""Samples that readers in RAM hold at most (8 kB each): fewer than ours serve, which is to their
advantage.
"""

Tensors = Sequence[torch.Tensor]


class Reader(NamedTuple):
    """A contestant: gives ``samples`` samples a call, or equal ones to check, and what to say about
    it.
    """

    name: str
    run: Callable[[], object]
    samples: int
    note: str = ""
    target: str = ""


# --- data ---------------------------------------------------------------------------------------


def orders(length: int, batches: int) -> list[list[int]]:
    """Return random batches of numbers below ``length``, as torch's samplers make them."""
    drawn = np.random.default_rng(0).integers(length, size=(batches, BATCH))
    lists: list[list[int]] = drawn.tolist()
    return lists


def drain(batches: Iterable[object]) -> None:
    """Use each batch up."""
    for _ in batches:
        pass


def loader_of(dataset: Dataset[Any], length: int, batches: int) -> DataLoader[Any]:
    """Return a plain DataLoader in the process itself, in random order."""
    return DataLoader(dataset, batch_sampler=orders(length, batches))


def in_ram(root: Path, count: int) -> list[torch.Tensor]:
    """Return the first samples of a dataset as four tensors, uint8 and int64."""
    dataset = MapDataset(root, fields=MASKED)
    parts = [dataset[k : min(k + 4096, count)] for k in range(0, count, 4096)]
    return [torch.cat([getattr(part, name) for part in parts]) for name in MASKED]


# --- what people do otherwise -------------------------------------------------------------------


class NaiveH5(Dataset[Any]):
    """One h5py read a field and sample."""

    def __init__(self, path: Path, tensors: Tensors) -> None:
        """Write the file with h5py's defaults, and open it."""
        with h5py.File(path, "w") as file:
            for name, tensor in zip(MASKED, tensors, strict=True):
                file[name] = tensor.numpy()
        self.file, self.length = h5py.File(path, "r"), len(tensors[0])

    def __len__(self) -> int:
        """Return the number of samples."""
        return self.length

    def __getitem__(self, i: int) -> tuple[torch.Tensor, ...]:
        return tuple(torch.from_numpy(np.asarray(self.file[name][i])) for name in MASKED)


class Npz(Dataset[Any]):
    """An npz file read into RAM, one sample a call."""

    def __init__(self, path: Path, tensors: Tensors) -> None:
        """Write the file and read it."""
        arrays = {name: tensor.numpy() for name, tensor in zip(MASKED, tensors, strict=True)}
        np.savez(path, **arrays)  # type: ignore[arg-type]
        with np.load(path) as file:
            self.arrays = [file[name] for name in MASKED]

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.arrays[0])

    def __getitem__(self, i: int) -> tuple[torch.Tensor, ...]:
        return tuple(torch.as_tensor(array[i]) for array in self.arrays)


class Pictures(Dataset[Any]):
    """The paper's release: a PNG a map and one CSV with paths as lists of rows and of columns."""

    def __init__(self, folder: Path, tensors: Tensors) -> None:
        """Write the files, and read the CSV."""
        folder.mkdir()
        self.folder = folder
        with (folder / "maps.csv").open("w", newline="") as file:
            writer = csv.writer(file)
            for k, (grid, start, goal, mask) in enumerate(zip(*tensors, strict=True)):
                Image.fromarray(255 - 255 * grid[0].numpy()).save(folder / f"map{k}.png")
                rows, columns = torch.nonzero(mask[0], as_tuple=True)
                writer.writerow([start.tolist(), goal.tolist(), rows.tolist(), columns.tolist()])
        with (folder / "maps.csv").open(newline="") as file:
            self.rows = list(csv.reader(file))

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.rows)

    def __getitem__(self, i: int) -> tuple[torch.Tensor, ...]:
        with Image.open(self.folder / f"map{i}.png") as picture:
            grid = torch.from_numpy((np.asarray(picture) == 0).astype(np.uint8))[None]
        start, goal, rows, columns = (torch.tensor(ast.literal_eval(text)) for text in self.rows[i])
        mask = torch.zeros_like(grid)
        mask[0, rows, columns] = 1
        return grid, start, goal, mask


def hugging_face(folder: Path, tensors: Tensors) -> Dataset[Any]:
    """Return the samples as an Arrow file of Hugging Face's `datasets`, in torch's format."""
    datasets = ARROW.load()
    datasets.disable_progress_bars()
    size = tuple(tensors[0].shape[1:])
    picture, cell = (
        datasets.Array3D(size, "uint8"),
        datasets.Sequence(datasets.Value("int64"), length=2),
    )
    features = datasets.Features(dict(zip(MASKED, (picture, cell, cell, picture), strict=True)))
    columns = {name: list(tensor.numpy()) for name, tensor in zip(MASKED, tensors, strict=True)}
    datasets.Dataset.from_dict(columns, features=features).save_to_disk(folder)
    arrow: Dataset[Any] = datasets.load_from_disk(str(folder)).with_format("torch")
    return arrow


def web_dataset(path: Path, tensors: Tensors) -> Iterable[Any]:
    """Return the samples as a tar file of `webdataset`, in its order."""
    webdataset = TAR.load()
    with tarfile.open(path, "w") as tar:
        for k, values in enumerate(zip(*tensors, strict=True)):
            for name, value in zip(MASKED, values, strict=True):
                data = io.BytesIO()
                np.save(data, value.numpy())
                entry = tarfile.TarInfo(f"{k:08d}.{name}.npy")
                entry.size = data.tell()
                data.seek(0)
                tar.addfile(entry, data)
    names = [f"{name}.npy" for name in MASKED]
    pipeline: Iterable[Any] = (
        webdataset.WebDataset(str(path), shardshuffle=False).decode().to_tuple(*names)
    )
    return pipeline


class ZarrArrays(Dataset[Any]):
    """An array a field, in chunks of 64 samples, with zarr's default compression."""

    def __init__(self, folder: Path, tensors: Tensors) -> None:
        """Write the arrays, and open them."""
        zarr = ZARR.load()
        group = zarr.open_group(str(folder), mode="w")
        for name, tensor in zip(MASKED, tensors, strict=True):
            group.create_array(name, data=tensor.numpy(), chunks=(64, *tensor.shape[1:]))
        read = zarr.open_group(str(folder), mode="r")
        self.arrays = [read[name] for name in MASKED]

    def __len__(self) -> int:
        """Return the number of samples."""
        return int(self.arrays[0].shape[0])

    def __getitem__(self, i: int) -> tuple[torch.Tensor, ...]:
        return tuple(torch.as_tensor(np.asarray(array[i])) for array in self.arrays)

    def batch(self, indices: list[int]) -> list[torch.Tensor]:
        """Return these samples, by one call a field."""
        return [torch.from_numpy(array.oindex[indices]) for array in self.arrays]


def lit_data(folder: Path, tensors: Tensors, *, shuffle: bool) -> Iterable[Any]:
    """Return batches of the samples from the chunks of `litdata`, in order or as it shuffles."""
    litdata = LITDATA.load()
    if not folder.exists():
        writer_module = import_module("litdata.streaming.writer")
        writer = writer_module.BinaryWriter(str(folder), chunk_bytes="64MB")
        for k, values in enumerate(zip(*tensors, strict=True)):
            writer[k] = dict(zip(MASKED, values, strict=True))
        writer.done()
        writer.merge(1)
    dataset = litdata.StreamingDataset(str(folder), shuffle=shuffle)
    batches: Iterable[Any] = litdata.StreamingDataLoader(dataset, batch_size=BATCH, shuffle=shuffle)
    return batches


def memory_maps(folder: Path, tensors: Tensors) -> list[npt.NDArray[Any]]:
    """Return the tensors as mapped npy files."""
    files = []
    for name, tensor in zip(MASKED, tensors, strict=True):
        np.save(folder / f"{name}.npy", tensor.numpy())
        files.append(np.load(folder / f"{name}.npy", mmap_mode="r"))
    return files


def peers(folder: Path, root: Path, few: int) -> list[Reader]:
    """Return the other readers, each on ``few`` samples or on as many as fit into RAM."""
    tensors = in_ram(root, min(IN_RAM, len(MapDataset(root))))
    length = len(tensors[0])
    small = [tensor[:few] for tensor in tensors]
    order = [torch.tensor(batch) for batch in orders(length, 20)]
    targets = [torch.empty((BATCH, *tensor.shape[1:]), dtype=tensor.dtype) for tensor in tensors]
    files = memory_maps(folder, tensors)
    outputs = [np.empty((BATCH, *tensor.shape[1:]), tensor.numpy().dtype) for tensor in tensors]
    ram, naive, npz = (
        TensorDataset(*tensors),
        NaiveH5(folder / "naive.h5", small),
        Npz(folder / "maps.npz", small),
    )
    pictures = Pictures(folder / "pictures", [tensor[:BATCH] for tensor in tensors])
    for dataset in (ram, naive, npz, pictures):
        check(next(iter(DataLoader(dataset, 8))), tensors, type(dataset).__name__)
    check([torch.from_numpy(file[:8]) for file in files], tensors, "np.memmap")

    def index() -> None:
        for batch in order:
            [tensor[batch] for tensor in tensors]

    def index_into() -> None:
        for batch in order:
            for tensor, target in zip(tensors, targets, strict=True):
                torch.index_select(tensor, 0, batch, out=target)

    def index_files() -> None:
        for batch in order:
            [torch.from_numpy(file[batch.numpy()]) for file in files]

    def fill() -> None:
        for _ in range(20):
            for output in outputs:
                output.fill(1)

    found = [
        Reader(
            "in-RAM tensors, tensor[idx], no DataLoader",
            index,
            20 * BATCH,
            f"uint8, {length:,} samples",
            "5x",
        ),
        Reader(
            "index_select(out=)",
            index_into,
            20 * BATCH,
            "in-RAM tensors, into the same memory again and again",
        ),
        Reader("np.memmap[idx]", index_files, 20 * BATCH, "npy files, one a field, page cache"),
        Reader(
            "TensorDataset, DataLoader",
            lambda: drain(loader_of(ram, length, 2)),
            2 * BATCH,
            "default collate",
        ),
        Reader(
            "naive h5py, DataLoader",
            lambda: drain(loader_of(naive, few, 1)),
            BATCH,
            f"contiguous uint8, {few:,} samples",
            "300x",
        ),
        Reader(
            "npz in RAM, DataLoader",
            lambda: drain(loader_of(npz, few, 2)),
            2 * BATCH,
            f"{few:,} samples",
        ),
        Reader(
            "PNG + CSV, DataLoader",
            lambda: drain(loader_of(pictures, BATCH, 1)),
            BATCH,
            "the paper's release",
        ),
        Reader(
            "memset of the same bytes",
            fill,
            20 * BATCH,
            "writes only; the same memory again and again",
        ),
    ]
    if not ARROW.absence:
        arrow = hugging_face(folder / "arrow", small)
        batch = next(iter(DataLoader(arrow, 8)))
        check([batch[name] for name in MASKED], tensors, "datasets")
        found.append(
            Reader(
                "HF datasets, DataLoader",
                lambda: drain(loader_of(arrow, few, 1)),
                BATCH,
                "torch format",
            )
        )
    if not TAR.absence:
        web = web_dataset(folder / "maps.tar", small[:512])
        check([torch.from_numpy(value)[None] for value in next(iter(web))], tensors, "webdataset")
        found.append(
            Reader(
                "webdataset, in order", lambda: drain(web), len(small[0]), "tar of npy, no batches"
            )
        )
    return found + zarr_readers(folder, small) + litdata_readers(folder, small)


def zarr_readers(folder: Path, tensors: Tensors) -> list[Reader]:
    """Return the readers by `zarr`, none if it is missing: a call a batch, and a call a sample."""
    if ZARR.absence:
        return []
    arrays = ZarrArrays(folder / "maps.zarr", tensors)
    check(arrays.batch([*range(8)]), tensors, "zarr")
    check(next(iter(DataLoader(arrays, 8))), tensors, "zarr, DataLoader")
    length = len(arrays)
    size = f"chunks of 64, {length:,} samples"

    def by_batch() -> None:
        for indices in orders(length, 2):
            arrays.batch(indices)

    def by_sample() -> None:
        drain(loader_of(arrays, length, 1))

    return [
        Reader("zarr, a call a batch", by_batch, 2 * BATCH, size),
        Reader("zarr, DataLoader", by_sample, BATCH, size),
    ]


def litdata_readers(folder: Path, tensors: Tensors) -> list[Reader]:
    """Return the readers by `litdata`, none if it is missing: in order, and shuffled."""
    if LITDATA.absence:
        return []
    found = []
    for name, shuffle in (("in order", False), ("shuffled", True)):
        batches = lit_data(folder / "litdata", tensors, shuffle=shuffle)
        shown = [[batch[field] for field in MASKED] for batch in batches]
        read = [torch.cat(parts) for parts in zip(*shown, strict=True)]
        check_in_any_order(read, tensors, f"litdata, {name}")
        samples = len(tensors[0])
        found.append(
            Reader(
                f"litdata, {name}",
                partial(drain, batches),
                samples,
                f"chunks of 64 MB, {samples:,} samples",
            )
        )
    return found


def check(batch: Sequence[torch.Tensor], tensors: Tensors, name: str) -> None:
    """Stop if another reader's first batch is not ours."""
    for field, value, truth in zip(MASKED, batch, tensors, strict=True):
        if not torch.equal(value, truth[: len(value)]):
            raise SystemExit(f"mapdata and {name} differ in {field}: nothing was measured")


def check_in_any_order(read: Tensors, tensors: Tensors, name: str) -> None:
    """Stop if all samples of another reader, in whatever order they come, are not ours."""

    def sorted_bytes(fields: Tensors) -> list[bytes]:
        samples = zip(*fields, strict=True)
        return sorted(b"".join(value.numpy().tobytes() for value in sample) for sample in samples)

    if sorted_bytes(read) != sorted_bytes(tensors):
        raise SystemExit(f"mapdata and {name} differ: nothing was measured")


# --- rows ---------------------------------------------------------------------------------------


def rate(times: list[float], samples: int) -> str:
    """Return samples a second, by the median."""
    return f"{samples / statistics.median(times):,.0f} samples/s"


def reader_rows(
    folder: Path, maps: int, rounds: int, *, ram_target: str, only_ram: bool
) -> list[Row]:
    """Return the rows of our readers and of the others, at one number of maps."""
    one, hundred = folder / "one", folder / "hundred"
    build(one, SPEC, maps=maps, shard_size=maps)
    build(hundred, SPEC, maps=maps, shard_size=maps // 100)
    batches = 40

    def ours(root: Path, fields: tuple[str, ...]) -> Callable[[], None]:
        dataset = MapDataset(root, fields=fields)
        loader = loader_of(dataset, len(dataset), batches)
        return lambda: drain(loader)

    made = OnlineMapDataset(SPEC, 0, maps, fields=MASKED)
    online = loader_of(made, maps, batches)
    readers = {
        "masked": Reader(", ".join(MASKED), ours(one, MASKED), batches * BATCH),
        "default": Reader(
            "the four default fields", ours(one, ("map", "start", "goal", "path")), batches * BATCH
        ),
        "moves": Reader(
            "map, goal, optimal_moves", ours(one, ("map", "goal", "optimal_moves")), batches * BATCH
        ),
        "hundred": Reader("100 shards", ours(hundred, MASKED), batches * BATCH),
        "online": Reader("online: made and solved", lambda: drain(online), batches * BATCH),
    }
    others = peers(folder, one, 2000)
    others = others[:1] if only_ram else others
    times = interleaved(
        {key: reader.run for key, reader in readers.items()} | {o.name: o.run for o in others},
        rounds,
    )
    base = times["masked"]
    size = f"{maps:,} maps"

    def beside(key: str, other: str, target: str) -> Row:
        mine, theirs = readers[key], readers[other]
        return Row(
            f"{size}: {mine.name}",
            rate(times[key], mine.samples),
            rate(times[other], theirs.samples),
            f"{median_ratio(times[other], times[key]):.2f}x",
            target,
            "beside mapdata's "
            f"{'default fields' if other == 'default' else 'masked fields of one shard'}",
        )

    ratios = {
        other: median_ratio(times[other.name], base) * batches * BATCH / other.samples
        for other in others
    }
    rows = []
    # The readers that beat ours come first.
    for other, ratio in sorted(ratios.items(), key=lambda item: item[1]):
        target = ram_target if other.name.startswith("in-RAM") else other.target
        text = f"{ratio:,.0f}x" if ratio >= 100 else f"{ratio:.2f}x"
        mine, theirs = rate(base, batches * BATCH), rate(times[other.name], other.samples)
        rows.append(
            Row(
                f"{size}: {', '.join(MASKED)}",
                mine,
                theirs,
                text,
                target,
                f"{other.name}: {other.note}",
            )
        )
    if only_ram:
        return rows
    rows += [
        beside("default", "masked", "0.8x"),
        beside("moves", "masked", ""),
        beside("hundred", "masked", "0.85x"),
        beside("online", "masked", ""),
    ]
    return rows


def hard_rows(folder: Path, rounds: int) -> list[Row]:
    """Return the rows of a loop over hard problems with masks, beside copies of what it serves.

    The loop draws its problems and computes its fields anew in each epoch. The others read problems
    that were served once, from RAM by `torch.index_select` and from a file by `numpy.memmap`, in
    random order.
    """
    root = folder / "readme"
    build(root, "paper", maps=2_000, shard_size=2_000)
    module = MapDataModule(
        root,
        problems=Random(hardness=(1.05, None)),
        movement=Movement(8),
        fields=("map", "start_mask", "goal_mask", "optimal_mask"),
        batch_size=64,
        dtype=torch.float32,
    )
    loader = module.train_dataloader()
    batches = list(loader)[:-1]  # the last one is smaller
    samples = 64 * len(batches)
    stored = [torch.cat([batch[k] for batch in batches]) for k in range(4)]
    files = []
    for k, tensor in enumerate(stored):
        np.save(folder / f"readme-{k}.npy", tensor.numpy())
        files.append(np.load(folder / f"readme-{k}.npy", mmap_mode="r"))
    order = torch.randperm(samples, generator=torch.Generator().manual_seed(0)).split(64)

    def from_ram() -> None:
        for chosen in order:
            for tensor in stored:
                tensor.index_select(0, chosen)

    def from_file() -> None:
        for chosen in order:
            for file in files:
                torch.from_numpy(file[chosen.numpy()])

    times = interleaved({"loop": lambda: drain(loader), "RAM": from_ram, "file": from_file}, rounds)
    work = "hard problems and masks anew, float32, batches of 64"
    ours = rate(times["loop"], samples)
    return [
        Row(
            work,
            ours,
            rate(times[name], samples),
            f"{median_ratio(times[name], times['loop']):.2f}x",
            note=note,
        )
        for name, note in (
            ("RAM", "torch.index_select of problems stored once, in RAM"),
            ("file", "numpy.memmap of problems stored once, in the page cache"),
        )
    ]


def field_rows(folder: Path, rounds: int) -> list[Row]:
    """Return the rows of what planners train on: goal fields, random problems, symmetries."""
    moves = ("map", "goal", "optimal_moves")
    predictor = ("map", "start", "goal", "optimal_moves", "heuristic_ratio")
    runs: dict[str, Callable[[], object]] = {}
    targets = {}
    for preset, movement, fields_target, random_target in (
        ("paper", Movement(), "", ""),
        ("dungeon", Movement(8), "30,000 samples/s", "25,000 samples/s"),
    ):
        root = folder / preset
        # Built under the movement that is served, so that default fields are read, not searched.
        generator = replace(MapSpec.preset(preset), movement=movement)
        build(root, generator, maps=4_000, shard_size=4_000)
        kind = f"{preset}, {movement.connectivity}-connected"
        serve = partial(MapDataset, root, "train")
        datasets = {
            f"{kind}: {', '.join(moves)}": (serve(moves), fields_target),
            f"{kind}: map, goal, cost_to_go": (serve(("map", "goal", "cost_to_go")), ""),
            f"{kind}: random problems, {', '.join(moves)}": (
                serve(moves, problems="random"),
                random_target,
            ),
            f"{kind}: augmented random problems, {', '.join(predictor)}": (
                serve(predictor, problems="random", augment=True),
                "",
            ),
            f"{kind}: default fields, augmented": (
                serve(("map", "start", "goal", "path"), augment=True),
                "500,000 samples/s",
            ),
        }
        for name, (dataset, target) in datasets.items():
            loader = loader_of(dataset, len(dataset), 10)
            runs[name] = partial(drain, loader)
            targets[name] = target
    times = interleaved(runs, rounds)
    return [Row(name, rate(times[name], 10 * BATCH), target=targets[name]) for name in runs]


def band_rows(folder: Path, rounds: int) -> list[Row]:
    """Return the rows of random problems under conditions, beside those without."""
    bands = {
        "distance >= 10": Random(distance=(10, None)),
        "hardness >= 1.05": Random(hardness=(1.05, None)),
    }
    rows = []
    movement = Movement(8)
    for preset in ("paper", "dungeon"):
        root = folder / f"{preset}{movement.connectivity}"
        generator = replace(MapSpec.preset(preset), movement=movement)
        build(root, generator, maps=4_000, shard_size=4_000)
        runs = {}
        for name, problems in {"any": Random(), **bands}.items():
            dataset = MapDataset(root, "train", problems=problems)
            runs[name] = partial(drain, loader_of(dataset, len(dataset), 10))
        times = interleaved(runs, rounds)
        fields = ("cost", "length", "hardness", "iterations")
        drawn = MapDataset(root, "train", fields, problems="random")[:]
        values = torch.stack([drawn.cost, drawn.hardness, drawn.length])  # as `Random.bands`
        meeting = {}
        for name, problems in bands.items():
            lowest, highest = torch.tensor(problems.bands).T[:, :, None]
            meeting[name] = ((values >= lowest) & (values <= highest)).all(dim=0)
        expansions = drawn.iterations.float()
        for name, meets in meeting.items():
            effort = expansions[meets].mean() / expansions.mean()
            row = Row(
                f"{preset}, {movement.connectivity}-connected: random problems, {name}",
                rate(times[name], 10 * BATCH),
                rate(times["any"], 10 * BATCH),
                f"{median_ratio(times['any'], times[name]):.2f}x",
                "",
                "default fields; beside random problems without conditions, of which "
                f"{meets.float().mean():.0%} meet it, with {effort:.1f} times the expansions",
            )
            rows.append(row)
    return rows


def opening_rows(folder: Path, rounds: int) -> list[Row]:
    """Return the rows of opening 100 shards, of pickling, and of what a worker holds."""
    root = folder / "hundred"
    opened = [MapDataset(root) for _ in range(1)]

    def touch() -> None:
        dataset = MapDataset(root)
        dataset[[int(first) for first in dataset.reader.offsets[:-1]]]
        opened[0] = dataset

    times = interleaved({"touch": touch}, rounds)["touch"]
    size = len(pickle.dumps(opened[0]))
    rows = [
        Row(
            "open 100 shards and read from each",
            f"{statistics.median(times) * 1e3:.0f} ms",
            target="200 ms",
        ),
        Row("pickle of a used dataset", f"{size:,} bytes", target="10,000 bytes"),
    ]
    if Path("/proc/self/status").exists():
        held = worker_memory(root)
        note = "private memory of a persistent worker, third epoch less first (fork)"
        growth = f"{(held[2] - held[0]) / 1e3:+.1f} MB"
        rows.append(Row("growth of a worker's memory", growth, target="0 MB", note=note))
    return rows


def worker_memory(root: Path) -> list[int]:
    """Return the private memory of a loader's worker after each of three epochs, in kB."""
    dataset = MapDataset(root, "val", MASKED)
    loader = DataLoader(
        dataset, BATCH, num_workers=1, persistent_workers=True, multiprocessing_context="fork"
    )
    held = []
    for _ in range(3):
        drain(loader)
        status = Path(f"/proc/{loader._iterator._workers[0].pid}/status").read_text()  # type: ignore[union-attr]
        held.append(int(status.split("RssAnon:")[1].split()[0]))
    return held


class Nothing(pl.LightningModule):
    """An empty model that times its epochs."""

    def __init__(self) -> None:
        """Keep no parameters."""
        super().__init__()
        self.automatic_optimization = False
        self.seconds = 0.0
        self._began = 0.0

    def training_step(self, batch: Sample, _: int) -> None:
        """Learn nothing."""

    def configure_optimizers(self) -> None:
        """Have no optimizer."""

    def on_train_epoch_start(self) -> None:
        """Start the clock."""
        self._began = time.perf_counter()

    def on_train_epoch_end(self) -> None:
        """Stop it."""
        self.seconds = time.perf_counter() - self._began


class Ready(IterableDataset[Sample]):
    """One batch, again and again."""

    def __init__(self, batch: Sample, count: int) -> None:
        """Keep the batch."""
        self.batch, self.count = batch, count

    def __iter__(self) -> Iterator[Sample]:
        return (self.batch for _ in range(self.count))


class ReadyModule(MapDataModule):
    """A data module whose training loader gives one batch, again and again."""

    def __init__(self, root: str, ready: DataLoader[Sample]) -> None:
        """Keep the loader."""
        super().__init__(root, fields=MASKED)
        self.ready = ready

    def train_dataloader(self) -> DataLoader[Sample]:
        """Return the loader."""
        return self.ready


def trainer_rows(folder: Path, rounds: int, batches: int) -> list[Row]:
    """Return the rows of a Lightning Trainer with an empty model."""
    root = folder / "one"
    dataset = MapDataset(root, "train", MASKED)
    ready = DataLoader(Ready(dataset[:BATCH], batches), batch_size=None)
    ways: dict[str, dict[str, Any]] = {
        "ready": {"train_dataloaders": ready},
        "plain": {"train_dataloaders": DataLoader(dataset, BATCH, shuffle=True)},
        "ready, cast": {"datamodule": ReadyModule(str(root), ready)},
        "module": {"datamodule": MapDataModule(str(root), fields=MASKED)},
    }
    times: dict[str, list[float]] = {name: [] for name in ways}
    for name in [*ways] * (rounds + 1):
        model = Nothing()
        run = pl.Trainer(
            max_epochs=1,
            accelerator="cpu",
            logger=False,
            enable_checkpointing=False,
            enable_progress_bar=False,
            enable_model_summary=False,
            limit_train_batches=batches,
            limit_val_batches=0,
        )
        run.fit(model, **ways[name])
        times[name].append(model.seconds)
    times = {name: values[1:] for name, values in times.items()}  # the first round warms up
    pairs = (
        (
            "plain",
            "ready",
            "MapDataset in a DataLoader, uint8; beside one ready batch in the same Trainer",
        ),
        (
            "module",
            "ready, cast",
            "MapDataModule; beside one ready batch, both cast to float32 by the module",
        ),
        (
            "module",
            "ready",
            "MapDataModule, cast to float32; beside one ready batch that is not cast",
        ),
    )
    return [
        Row(
            "Lightning Trainer, empty model",
            rate(times[name], batches * BATCH),
            rate(times[other], batches * BATCH),
            f"{median_ratio(times[other], times[name]):.2f}x",
            note=note,
        )
        for name, other, note in pairs
    ]


def table(quick: bool, parent: str | None = None) -> str:
    """Measure, and return the table; datasets are written below ``parent``, or the temporary
    folder.
    """
    rounds = 3 if quick else 9
    logging.getLogger("pytorch_lightning").setLevel(logging.ERROR)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    with warnings.catch_warnings(), tempfile.TemporaryDirectory(dir=parent) as name:
        warnings.filterwarnings("ignore", module="pytorch_lightning")
        warnings.filterwarnings(
            "ignore", message=".*does not have many workers|.*configure_optimizers.*returned `None`"
        )
        folder = Path(name) / "10k"
        folder.mkdir()
        rows = hard_rows(folder, rounds)
        rows += reader_rows(folder, 10_000, rounds, ram_target="", only_ram=False)
        rows += field_rows(folder, rounds)
        rows += band_rows(folder, rounds)
        rows += trainer_rows(folder, rounds, 60 if quick else 120)
        rows += opening_rows(folder, rounds)
        if not quick:
            folder = Path(name) / "100k"
            folder.mkdir()
            rows += reader_rows(folder, 100_000, rounds, ram_target="", only_ram=True)
    torch.set_num_threads(threads)
    notes = (
        f"{rounds} repeats",
        f"preset paper (64 x 64), batches of {BATCH} in random order, num_workers=0, files in the "
        "page cache",
    )
    return to_text("Loading", rows, packages=PACKAGES, notes=notes, peers=PEERS)
