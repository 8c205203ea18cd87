"""Importing grids from elsewhere as a dataset: drawing seed points, labelling, writing shards.

The content is a function of (grids, seed, seed points per map, movement) alone: docs/format.md
lists the draws of stream 5. An imported dataset has no recipe, so its identity is its content hash.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.checks import check_count, check_resolution, check_seed, check_sides
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.leaks import Separated, separate
from mapdata.generators.maps import Maps, pack
from mapdata.generators.points import check_seed_points, draw_points, largest_component
from mapdata.generators.splits import draw_splits, split_thresholds
from mapdata.limits import MAX_ROOMS, MAX_SIDE, Size
from mapdata.movement import Movement
from mapdata.search.api import why_not_free
from mapdata.search.labels import label
from mapdata.search.lattice import rule_of
from mapdata.shards.builder import planned_headers
from mapdata.shards.files import StrPath, file_hash, make_folder, write_file
from mapdata.shards.header import Header
from mapdata.shards.image import shard_image
from mapdata.shards.locations import target_folder
from mapdata.shards.manifest import (
    MANIFEST,
    PROVENANCE,
    Manifest,
    entry_of,
    path_in,
    provenance_text,
    read_manifest,
)
from mapdata.shards.merging import check_names, locked, merge_locked
from mapdata.shards.workers import Advance, bar, thread_pool

RESOLUTION = 0.1
"""Metres per cell where the source does not say."""

_CELLS_A_SHARD = MAX_SIDE**2
"""Most cells of a shard where its size is not given, so that large maps fit in memory."""

Group = tuple[Size, float]
"""Size and resolution: all that maps of one dataset must share."""


class Draws(NamedTuple):
    """What is drawn for maps whose source does not say it.

    Attributes:
        seed_points: seed points of a map.
        seed: 64-bit seed.
    """

    seed_points: int
    seed: int


@dataclass(frozen=True)
class Imported:
    """One dataset that an import made.

    Attributes:
        root: its folder.
        manifest: its manifest.
        checked: how many maps came with labels, which were compared with ours.
        disagreements: by label, how many of those maps say otherwise.
    """

    root: Path
    manifest: Manifest
    checked: int
    disagreements: dict[str, int]


def import_maps(
    root: StrPath,
    source: Collection,
    *,
    seed_points: int = 5,
    seed: int = 0,
    movement: Movement | None = None,
    resolution: float | None = None,
    splits: tuple[float, float, float] = (0.8, 0.1, 0.1),
    tile: Size | None = None,
    shard_size: int | None = None,
    drop_leaks: bool = False,
    progress: bool = False,
) -> list[Imported]:
    """Make a dataset of the grids of ``source`` under ``root``.

    When the grids differ in size or resolution, each kind becomes a dataset below ``root``
    (``root/64x64``, ...). What cannot be used is added to ``source.left_out``.

    Args:
        root: folder, made if missing; empty, or made by the same import before (then only what is
            missing is made).
        source: what a format read.
        seed_points: how many each map has, drawn without repetition in its largest free component;
            less where that has fewer cells.
        seed: 64-bit seed of these draws and of the splits.
        movement: how the stored paths move; default the rule of the format, else 4-connected.
        resolution: metres per cell, whatever the source says; default the source's, else 0.1. A
            robot's map (ros) is resampled to it by the command; from Python `read_any` does it.
        splits: fractions of train, val and test, for maps whose split the source does not say.
        tile: cut every grid into tiles of (rows, columns) from the upper left; what is left at the
            edges is dropped.
        shard_size: maps per shard; default 1000, less for large maps.
        drop_leaks: leave out maps that stand in a later split too, turned or not.
        progress: show a progress bar.

    Raises:
        ValueError: bad arguments, no usable map, or a root that holds something else.
        OSError: the disk is full or may not be written to.
    """
    root = target_folder(root)
    check_seed(seed)
    thresholds = split_thresholds(tuple(splits))
    check_seed_points("seed_points", seed_points)
    if shard_size is not None:
        check_count("shard_size", shard_size)
    if resolution is not None:
        check_resolution("resolution", resolution)
    movement = movement or source.movement or Movement()
    groups: dict[Group, list[ForeignMap]] = {}
    with bar(progress, len(source.maps), unit=" maps checked") as advance:
        for one in _tiles(source, tile):
            with source.leaving_out(one.name):
                _check_usable(one, movement)
                metres = resolution or one.resolution or RESOLUTION
                metres = check_resolution("resolution", metres)
                groups.setdefault((one.shape, metres), []).append(one)
            advance(1)
    if not groups:
        reasons = [f": {name}: {why}" for name, why in source.left_out[:1]]
        raise ValueError("no map to import" + "".join(reasons))
    folders = _folders(root, list(groups))
    draws = Draws(seed_points, seed)
    made = []
    with bar(progress, sum(map(len, groups.values()))) as advance, thread_pool(1) as pool:
        for (size, metres), found in groups.items():
            ordered = _ordered(found, source)
            codes = draw_splits(np.uint64(seed), np.arange(len(ordered)), thresholds)
            for k, one in enumerate(ordered):
                if one.split is not None:
                    codes[k] = one.split
            # All keep their splits: were they drawn anew, other copies might be parted.
            separated = separate(ordered, codes, drop_leaks, source.notes)
            maps = [ordered[k] for k in separated.kept]
            advance(len(ordered) - len(maps))
            origin = _origin(source, maps, separated, draws)
            wanted = Manifest(
                spec=None,
                seed=None,
                maps=len(maps),
                shard_size=shard_size or min(1000, _CELLS_A_SHARD // prod(size)),
                map_size=size,
                movement=movement,
                resolution=metres,
            )
            folder = folders[size, metres]
            make_folder(folder)
            # two imports of other maps would take each other's shards away
            with locked(folder, wait=False) as is_free:
                if not is_free:
                    raise ValueError(f"root: another process writes to {folder}; wait for its end")
                splits_kept = codes[separated.kept]
                made.append(_write(folder, wanted, maps, splits_kept, draws, origin, advance, pool))
    return made


def _tiles(source: Collection, tile: Size | None) -> Iterator[ForeignMap]:
    """Yield the maps, or their tiles if they are to be cut."""
    if tile is None:
        yield from source.maps
        return
    rows, columns = check_sides("tile", tile)
    for one in source.maps:
        grid = one.grid
        height, width = one.shape
        if height < rows or width < columns:
            why = f"{height} x {width} cells, smaller than a tile of {rows} x {columns}"
            source.left_out.append((one.name, why))
        for row in range(0, height - rows + 1, rows):
            for column in range(0, width - columns + 1, columns):
                name = f"{one.name} rows {row}.. columns {column}.."
                part = grid[row : row + rows, column : column + columns]
                yield ForeignMap(name, part, one.split, one.resolution)


def _check_usable(one: ForeignMap, movement: Movement) -> None:
    """Refuse a map that cannot be in a dataset.

    Raises:
        ValueError: the message says why.
    """
    grid = one.grid
    rows, columns = one.shape
    if not 1 <= min(one.shape) <= max(one.shape) <= MAX_SIDE:
        raise ValueError(
            f"{rows} x {columns} cells, expected 1 to {MAX_SIDE} rows and columns; --tile cuts it"
        )
    for cell in one.seed_points:
        why = why_not_free(grid, cell)
        if why:
            raise ValueError(f"seed point {why}")
    rooms = len(one.seed_points)
    if rooms > MAX_ROOMS or (one.rooms_known and rooms < 1):
        raise ValueError(f"{rooms} rooms, expected 1 to {MAX_ROOMS}")
    if not one.rooms_known and len(largest_component(grid, rule_of(movement)[0])) < 2:
        raise ValueError(f"has no two connected free cells ({(grid == 0).sum()} free in all)")


def _folders(root: Path, groups: Sequence[Group]) -> dict[Group, Path]:
    """Return the folder of each dataset.

    Raises:
        ValueError: something else stands where they are to be written.
    """
    folders = dict.fromkeys(groups, root)
    if len(groups) > 1:
        sizes = Counter(size for size, _ in groups)
        for size, metres in groups:
            name = f"{size[0]}x{size[1]}"
            if sizes[size] > 1:
                name += f"-{metres:g}m"
            folders[size, metres] = root / name
        check_names(root, {folder.name for folder in folders.values()}.__contains__)
    for folder in folders.values():
        check_names(folder)
    return folders


def _ordered(maps: list[ForeignMap], source: Collection) -> list[ForeignMap]:
    """Return the maps in the order of their numbers if those are 0 to N - 1, else as they came."""
    numbers = [one.number for one in maps if one.number is not None]
    if sorted(numbers) == list(range(len(maps))):
        return sorted(maps, key=lambda one: one.number or 0)
    if numbers:
        source.notes.append("maps are numbered anew: the source's own numbers are not 0 to N - 1")
    return maps


def _origin(
    source: Collection, maps: list[ForeignMap], separated: Separated, draws: Draws
) -> dict[str, Any]:
    """Return what ``import.json`` says of a dataset: what the shards do not say."""
    cells = len(maps) * prod(maps[0].shape)
    occupied = sum(int(np.count_nonzero(foreign_map.grid)) for foreign_map in maps)
    origin: dict[str, Any] = {
        "free": 1 - occupied / cells,
        "distinct": separated.distinct,
        "distinct_up_to_symmetry": separated.symmetric,
        "seeds": draws.seed_points,
        "seed": draws.seed,
        "sources": [foreign_map.name for foreign_map in maps],
    }
    if source.format is not None:
        origin = {"format": source.format, "source": source.source, **origin}
    return origin


def _write(
    folder: Path,
    wanted: Manifest,
    maps: list[ForeignMap],
    splits: Bytes,
    draws: Draws,
    origin: dict[str, Any],
    advance: Advance,
    pool: Executor,
) -> Imported:
    """Write one dataset, shard by shard, while nobody else does; keep the shards that are there."""
    other = ValueError(f"root: {folder} holds another dataset, expected an empty folder")
    if (folder / MANIFEST).exists() and replace(read_manifest(folder), shards=()) != wanted:
        raise other
    # The plan comes first: who goes on with an import that was stopped knows it by this.
    manifest = merge_locked(folder, wanted)
    have = {entry.name: entry for entry in manifest.shards}
    checked = 0
    disagreements: Counter[str] = Counter()
    for header in planned_headers(wanted):
        span = slice(*header.limits)
        batch = maps[span]
        # in a thread, so that Ctrl-C need not wait for it
        labels = pool.submit(label, to_maps(batch, splits[span], header, draws)).result()
        for k, one in enumerate(batch):
            if one.check is not None:
                checked += 1
                disagreements.update(one.check(labels, k))
        image, content = shard_image(labels, header)
        entry = entry_of(header, content, labels, image)
        path = path_in(folder, entry.name)
        old = have.get(entry.name)
        if old is not None and old.content_hash != content:
            raise other
        if old is None or not path.exists() or file_hash(path) != old.sha256:
            write_file(path, image)
            # of two entries for the same maps, the later one counts
            manifest = merge_locked(folder, replace(wanted, shards=(*manifest.shards, entry)))
        advance(len(batch))
    write_file(folder / PROVENANCE, provenance_text(origin).encode())
    return Imported(folder, manifest, checked, dict(disagreements))


def to_maps(batch: Sequence[ForeignMap], splits: Bytes, header: Header, draws: Draws) -> Maps:
    """Return foreign maps of one size as `Maps`; draw the seed points that they lack.

    Args:
        batch: the maps ``header.start`` to ``header.stop`` - 1.
        splits: (N,) their splits.
        header: their numbers, size and movement.
        draws: how many seed points, and how they are drawn.
    """
    points = [_seed_points(one, header, draws, header.start + k) for k, one in enumerate(batch)]
    most = max(2, *map(len, points))
    indices = np.arange(*header.limits)
    maps = Maps.empty(header.movement, header.map_size, indices, most)
    maps.split[:] = splits
    maps.packed[:] = pack(np.stack([one.grid for one in batch]))
    for k, (one, cells) in enumerate(zip(batch, points, strict=True)):
        maps.rooms[k] = len(cells)
        maps.passage_width[k] = one.passage_width
        maps.seed_points[k, : len(cells)] = cells
        maps.sizes[k, : len(one.sizes)] = one.sizes
        maps.directions[k, : len(one.directions)] = one.directions
    return maps


def _seed_points(one: ForeignMap, header: Header, draws: Draws, index: int) -> Ints:
    """Return the seed points of map ``index``, (k, 2): its own, then those drawn to fill up."""
    missing = draws.seed_points - len(one.seed_points)
    if one.rooms_known or missing <= 0:
        return one.seed_points
    _, columns = one.shape
    given = one.seed_points @ (columns, 1)
    cells = np.setdiff1d(largest_component(one.grid, rule_of(header.movement)[0]), given)
    drawn = draw_points(cells, np.uint64(draws.seed), np.uint64(index), min(missing, len(cells)))
    rows_and_columns = np.divmod(np.concatenate((given, drawn)), columns)
    return np.column_stack(rows_and_columns)
