"""Importing grids from elsewhere as a dataset: drawing seed points, labelling, writing shards.

The content is a function of (grids, seed, seed points per map, movement, splits) alone:
docs/format.md lists the draws of streams 2 and 5. An imported dataset has no recipe and no
identity: compare content hash, resolution and movement instead.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mapdata.arrays import Bytes, Ints
from mapdata.checks import check_count, check_fractions, check_resolution, check_seed, check_sides
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.leaks import Separated, separate
from mapdata.formats.shrinking import FreeSpace
from mapdata.generators.maps import Maps, pack
from mapdata.generators.points import check_seed_points, draw_points, largest_component
from mapdata.limits import MAX_ROOMS, MAX_SIDE, SPLITS, Size
from mapdata.movement import Movement
from mapdata.rng import SPLIT, block, threshold
from mapdata.search.arguments import why_not_free
from mapdata.search.labels import HighCostError, label
from mapdata.search.lattice import move_rule
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
from mapdata.shards.merging import announced, check_names, locked, merge_locked
from mapdata.shards.workers import Advance, bar, thread_pool

RESOLUTION = 0.1
"""Metres per cell where the source does not say."""

_MAX_CELLS_PER_SHARD = MAX_SIDE**2
"""Bounds the default size of a shard, so that large maps fit in memory."""

Group = tuple[Size, float]
"""Size in cells and resolution in metres per cell, which all maps of a dataset share."""


class Draws(NamedTuple):
    """How seed points are drawn for maps whose source has too few.

    Attributes:
        seed_points: number of seed points of a map.
        seed: 64-bit seed.
    """

    seed_points: int
    seed: int


@dataclass(frozen=True)
class Imported:
    """A dataset that an import has written.

    Attributes:
        root: its folder.
        manifest: its manifest.
        checked: number of maps whose source has labels, which were compared with ours.
        disagreements: number of those maps that disagree, by the name of the label.
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

    When the grids differ in size or resolution, those of each size and resolution become a dataset
    below ``root`` (``root/64x64``, ...). Maps that cannot be used are added to ``source.left_out``.
    Maps whose cells have costs become a dataset with terrain.

    Args:
        root: folder, created if missing; empty, or written by the same import before (then only
            missing shards are written).
        source: the maps that a format has read.
        seed_points: number of seed points of each map. Those that the source does not state are
            drawn from the largest free component, each cell at most once.
        seed: 64-bit seed of the drawn seed points and splits.
        movement: how the stored paths move; default the rule of the format, else 4-connected.
        resolution: metres per cell, in place of that of the source (default: that of the source, or
            0.1). The command resamples a robot's map (ros) to it; in Python, `read_any` does.
        splits: fractions of train, val and test, for maps whose split the source does not say. Of
            each dataset these maps are divided exactly, in a random order; from three such maps on,
            each split with a fraction above 0 has at least one of them.
        tile: cut every grid into tiles of (rows, columns), from the upper left corner on; what
            remains at the edges is dropped.
        shard_size: number of maps per shard (default: 1000, or fewer for large maps).
        drop_leaks: leave out maps that are also in a later split, as they are, mirrored or rotated.
        progress: show a progress bar.

    Raises:
        TypeError: ``source`` is no `Collection`, but a file, for example.
        ValueError: bad arguments, no usable map, maps with and without terrain, or a root that
            holds something else.
        OSError: the disk is full or may not be written to.
    """
    if not isinstance(source, Collection):
        raise TypeError(
            f"source: got {type(source).__name__}, expected a Collection: "
            "mapdata.formats.read_any(file) reads one, with the options of its format"
        )
    root = target_folder(root)
    check_seed(seed)
    fractions = check_fractions(splits)
    check_seed_points("seed_points", seed_points)
    if shard_size is not None:
        check_count("shard_size", shard_size)
    if resolution is not None:
        check_resolution("resolution", resolution)
    movement = movement or source.movement or Movement()
    has_terrain = _has_terrain(source)
    groups: dict[Group, list[ForeignMap]] = {}
    free_space = FreeSpace()
    with bar(progress, len(source.maps), unit=" maps checked") as advance:
        for foreign_map in _tiles(source, tile, free_space):
            with source.leaving_out(foreign_map.name):
                _check_usable(foreign_map, movement)
                metres = resolution or foreign_map.resolution or RESOLUTION
                metres = check_resolution("resolution", metres)
                groups.setdefault((foreign_map.shape, metres), []).append(foreign_map)
            advance(1)
    if not groups:
        message = "no map to import"
        if source.left_out:
            name, reason = source.left_out[0]
            message += f": {name}: {reason}"
        raise ValueError(message)
    if tile is not None:
        action = f"cut into tiles of {tile[0]} x {tile[1]} cells"
        source.notes += free_space.notes(action, "another --tile drops less at the edges")
    _note_costs(groups.values(), source.notes)
    folders = _dataset_folders(root, list(groups))
    draws = Draws(seed_points, seed)
    datasets = []
    with bar(progress, sum(map(len, groups.values()))) as advance, thread_pool(1) as pool:
        for group, group_maps in groups.items():
            size, metres = group
            numbered = _numbered(group_maps, source)
            split_codes = divided_splits(numbered, seed, fractions)
            _note_empty_splits(numbered, split_codes, fractions, source.notes)
            # Maps keep their splits when copies are dropped. If the splits were drawn again for
            # the remaining maps, other copies might end up in different splits.
            separated = separate(numbered, split_codes, drop_leaks, source.notes)
            kept_maps = [numbered[k] for k in separated.kept]
            advance(len(numbered) - len(kept_maps))
            is_stated = resolution is not None or all(kept.resolution for kept in kept_maps)
            origin = _origin(source, kept_maps, separated, draws, is_stated)
            plan = Manifest(
                generator=None,
                seed=None,
                maps=len(kept_maps),
                shard_size=shard_size or min(1000, _MAX_CELLS_PER_SHARD // prod(size)),
                map_size=size,
                movement=movement,
                resolution=metres,
                has_terrain=has_terrain,
            )
            folder = folders[group]
            make_folder(folder)
            # Two imports of different maps at once would replace each other's shards.
            with locked(folder, wait=False) as is_free:
                if not is_free:
                    raise ValueError(f"root: another process writes to {folder}; wait for its end")
                with announced(folder):
                    dataset = _write(
                        folder,
                        plan,
                        maps=kept_maps,
                        splits=split_codes[separated.kept],
                        draws=draws,
                        origin=origin,
                        advance=advance,
                        pool=pool,
                    )
            datasets.append(dataset)
    return datasets


def divided_splits(maps: Sequence[ForeignMap], seed: int, fractions: Sequence[float]) -> Bytes:
    """Return the splits of the maps of a dataset, (N,): 0 train, 1 val, 2 test.

    A map has the split that its source states. The other maps are ordered by a random number each;
    the first of them are train, the next val, and the last test.

    Args:
        maps: of a dataset, in the order of their numbers.
        seed: 64-bit seed of the random numbers.
        fractions: of train, val and test; they add up to 1.
    """
    unstated = [k for k, foreign_map in enumerate(maps) if foreign_map.split is None]
    words = [block(np.uint64(seed), np.uint64(k), 0, SPLIT, 0)[0] for k in unstated]
    # The sort is stable: of maps with equal words, the one with the lower number comes first.
    order = np.argsort(np.array(words, np.uint64), kind="stable")
    codes = np.array([foreign_map.split or 0 for foreign_map in maps], np.uint8)
    sizes = split_sizes(len(unstated), fractions)
    codes[np.array(unstated, np.int64)[order]] = np.repeat(np.arange(len(SPLITS)), sizes)
    return codes


def split_sizes(count: int, fractions: Sequence[float]) -> list[int]:
    """Return how many of ``count`` maps are train, val and test, by the largest remainder.

    Each split gets its share of the maps, rounded down. The maps that are left go to the splits
    with the largest remainders, one each. From three maps on, a split that has a share but no map
    gets one from the largest split. Of equal splits the first one counts.

    Args:
        count: number of maps.
        fractions: of train, val and test; they add up to 1.

    >>> [split_sizes(count, (0.8, 0.1, 0.1)) for count in (2, 3, 10, 25)]
    [[2, 0, 0], [1, 1, 1], [8, 1, 1], [20, 3, 2]]
    """
    # The shares are whole numbers of 2**-32, so that all remainders are exact.
    shares = [threshold(fraction) for fraction in fractions]
    sizes = [count * share // 2**32 for share in shares]
    remainders = [count * share % 2**32 for share in shares]
    codes = range(len(SPLITS))
    by_remainder = sorted(codes, key=lambda code: -remainders[code])
    for code in by_remainder[: count - sum(sizes)]:
        sizes[code] += 1
    if count >= len(SPLITS):
        for code in codes:
            if sizes[code] == 0 and shares[code] > 0:
                sizes[sizes.index(max(sizes))] -= 1
                sizes[code] = 1
    return sizes


def _note_empty_splits(
    maps: list[ForeignMap],
    split_codes: Bytes,
    fractions: Sequence[float],
    notes: list[str],
) -> None:
    """Add a note if a split that should have some of the divided maps has none.

    Three maps and more are enough for all splits.

    Args:
        maps: of a dataset.
        split_codes: (N,) their splits.
        fractions: of train, val and test, for maps whose split the source does not say.
        notes: for the user.
    """
    drawn_count = sum(foreign_map.split is None for foreign_map in maps)
    counts = np.bincount(split_codes, minlength=len(SPLITS)).tolist()
    empty_names = [
        name
        for name, count, fraction in zip(SPLITS, counts, fractions, strict=True)
        if count == 0 and fraction > 0
    ]
    if drawn_count and empty_names:
        maps_are = "1 map is" if drawn_count == 1 else f"{drawn_count} maps are"
        notes.append(
            f"no map is in {' and '.join(empty_names)}: {maps_are} too few to divide; three maps "
            "(--tile cuts large ones), or folders train, val and test in the source, change that"
        )


def _note_costs(groups: Iterable[list[ForeignMap]], notes: list[str]) -> None:
    """Add to ``notes`` from which to which cost the free cells of maps with terrain have."""
    terrains = [
        foreign_map.terrain
        for group_maps in groups
        for foreign_map in group_maps
        if foreign_map.terrain is not None
    ]
    if terrains:
        lowest = min(int(terrain[terrain > 0].min()) for terrain in terrains)
        highest = max(int(terrain.max()) for terrain in terrains)
        notes.append(f"the costs of free cells are {lowest} to {highest}")


def _has_terrain(source: Collection) -> bool:
    """Return whether the maps of ``source`` have terrain.

    Raises:
        ValueError: only some of them have it.
    """
    terrain_count = sum(foreign_map.terrain is not None for foreign_map in source.maps)
    if 0 < terrain_count < len(source.maps):
        raise ValueError(
            f"{terrain_count} of {len(source.maps)} maps have terrain: import them separately"
        )
    return terrain_count > 0


def _tiles(source: Collection, tile: Size | None, free_space: FreeSpace) -> Iterator[ForeignMap]:
    """Yield the maps of ``source``, cut into tiles of (rows, columns) unless ``tile`` is None.

    Maps that are smaller than a tile are added to ``source.left_out``. The others are counted in
    ``free_space``, before and after they are cut.
    """
    if tile is None:
        yield from source.maps
        return
    rows, columns = check_sides("tile", tile)
    for foreign_map in source.maps:
        grid = foreign_map.grid
        height, width = foreign_map.shape
        if height < rows or width < columns:
            reason = f"{height} x {width} cells, smaller than a tile of {rows} x {columns}"
            source.left_out.append((foreign_map.name, reason))
        corners = [
            (top, left)
            for top in range(0, height - rows + 1, rows)
            for left in range(0, width - columns + 1, columns)
        ]
        windows = [np.s_[top : top + rows, left : left + columns] for top, left in corners]
        if corners and (height, width) != (rows, columns):
            free_space.add(grid, [grid[window] for window in windows])
        for (top, left), window in zip(corners, windows, strict=True):
            terrain = foreign_map.terrain
            yield ForeignMap(
                f"{foreign_map.name} rows {top}.. columns {left}..",
                grid[window],
                foreign_map.split,
                foreign_map.resolution,
                terrain=None if terrain is None else terrain[window],
            )


def _check_usable(foreign_map: ForeignMap, movement: Movement) -> None:
    """Check that a map can be part of a dataset.

    Raises:
        ValueError: it cannot; the message says why.
    """
    grid = foreign_map.grid
    rows, columns = foreign_map.shape
    if not 1 <= min(rows, columns) <= max(rows, columns) <= MAX_SIDE:
        raise ValueError(
            f"{rows} x {columns} cells, expected 1 to {MAX_SIDE} rows and columns; --tile cuts it"
        )
    for cell in foreign_map.seed_points:
        reason = why_not_free(grid, cell)
        if reason:
            raise ValueError(f"seed point {reason}")
    rooms = len(foreign_map.seed_points)
    if rooms > MAX_ROOMS or (foreign_map.rooms_known and rooms < 1):
        raise ValueError(f"{rooms} rooms, expected 1 to {MAX_ROOMS}")
    if not foreign_map.rooms_known:
        diagonals, _ = move_rule(movement)
        if len(largest_component(grid, diagonals)) < 2:
            free_cells = np.count_nonzero(grid == 0)
            raise ValueError(f"has no two connected free cells ({free_cells} free in all)")


def _dataset_folders(root: Path, groups: Sequence[Group]) -> dict[Group, Path]:
    """Return the folder of each group's dataset: ``root``, or folders below it for several groups.

    Raises:
        ValueError: a folder holds files that are not of a dataset.
    """
    folders = dict.fromkeys(groups, root)
    if len(groups) > 1:
        sizes = Counter(size for size, _ in groups)
        for size, metres in groups:
            name = f"{size[0]}x{size[1]}"
            if sizes[size] > 1:
                name += f"-{metres:g}m"
            folders[size, metres] = root / name
        folder_names = {folder.name for folder in folders.values()}
        check_names(root, folder_names.__contains__)
    for folder in folders.values():
        check_names(folder)
    return folders


def _numbered(maps: list[ForeignMap], source: Collection) -> list[ForeignMap]:
    """Return the maps in the order in which the dataset numbers them.

    That is the order of the source's own numbers if those are 0 to N - 1. If they are not, the
    order stays, and ``source`` gets a note.
    """
    map_by_number = {
        foreign_map.number: foreign_map for foreign_map in maps if foreign_map.number is not None
    }
    if map_by_number.keys() == set(range(len(maps))):
        return [map_by_number[number] for number in range(len(maps))]
    if map_by_number:
        source.notes.append("maps are numbered anew: the source's own numbers are not 0 to N - 1")
    return maps


def _origin(
    source: Collection,
    maps: list[ForeignMap],
    separated: Separated,
    draws: Draws,
    resolution_is_stated: bool,
) -> dict[str, Any]:
    """Return the content of ``import.json``: facts of a dataset that its shards do not hold."""
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
    if not resolution_is_stated:
        origin["resolution_assumed"] = True
    if source.format is not None:
        origin = {"format": source.format, "source": source.source, **origin}
    return origin


def _write(
    folder: Path,
    plan: Manifest,
    *,
    maps: list[ForeignMap],
    splits: Bytes,
    draws: Draws,
    origin: dict[str, Any],
    advance: Advance,
    pool: Executor,
) -> Imported:
    """Write a dataset shard by shard; shards that are there already and undamaged are kept.

    The caller holds the lock of ``folder``.

    Args:
        folder: of the dataset.
        plan: its manifest, without shards.
        maps: in the order of their numbers.
        splits: (N,) their splits.
        draws: how missing seed points are drawn.
        origin: content of ``import.json``.
        advance: called with the number of maps that were written.
        pool: labels the maps.

    Raises:
        ValueError: ``folder`` holds another dataset; terrain whose costs are too high to be exact.
    """
    another_dataset = ValueError(f"root: {folder} holds another dataset, expected an empty folder")
    if (folder / MANIFEST).exists() and replace(read_manifest(folder), shards=()) != plan:
        raise another_dataset
    # The plan is written before the first shard, so that an import that was stopped can be
    # recognised and completed.
    manifest = merge_locked(folder, plan)
    old_entries = {entry.name: entry for entry in manifest.shards}
    checked = 0
    disagreements: Counter[str] = Counter()
    for header in planned_headers(plan):
        shard_maps = maps[header.start : header.stop]
        shard_splits = splits[header.start : header.stop]
        unlabelled = to_maps(shard_maps, shard_splits, header, draws)
        # A kernel in the main thread could not be interrupted, so Ctrl-C would wait for its end.
        try:
            labels = pool.submit(label, unlabelled).result()
        except HighCostError as error:
            # The number of the map in the dataset would say nothing to the user.
            raise ValueError(f"{maps[error.map_number].name}: {error.complaint}") from None
        for k, foreign_map in enumerate(shard_maps):
            if foreign_map.check is not None:
                checked += 1
                disagreements.update(foreign_map.check(labels, k))
        image, content_hash = shard_image(labels, header)
        entry = entry_of(header, content_hash, labels, image)
        path = path_in(folder, entry.name)
        old_entry = old_entries.get(entry.name)
        if old_entry is not None and old_entry.content_hash != content_hash:
            raise another_dataset
        is_sound = old_entry is not None and path.exists() and file_hash(path) == old_entry.sha256
        if not is_sound:
            write_file(path, image)
            # If two entries are for the same maps, the later one counts.
            manifest = merge_locked(folder, replace(plan, shards=(*manifest.shards, entry)))
        advance(len(shard_maps))
    write_file(folder / PROVENANCE, provenance_text(origin).encode())
    return Imported(folder, manifest, checked, dict(disagreements))


def to_maps(
    foreign_maps: Sequence[ForeignMap], splits: Bytes, header: Header, draws: Draws
) -> Maps:
    """Return foreign maps of one size as `Maps`; draw the seed points that they lack.

    Args:
        foreign_maps: the maps ``header.start`` to ``header.stop`` - 1 of the dataset.
        splits: (N,) their splits.
        header: their numbers, size and movement.
        draws: how many seed points, and how they are drawn.
    """
    indices = np.arange(header.start, header.stop)
    seed_points = [
        _seed_points(foreign_map, header, draws, index)
        for foreign_map, index in zip(foreign_maps, indices.tolist(), strict=True)
    ]
    max_rooms = max(2, *map(len, seed_points))
    maps = Maps.empty(header.movement, header.map_size, indices, max_rooms)
    maps.split[:] = splits
    maps.packed[:] = pack(np.stack([foreign_map.grid for foreign_map in foreign_maps]))
    for k, (foreign_map, cells) in enumerate(zip(foreign_maps, seed_points, strict=True)):
        maps.rooms[k] = len(cells)
        maps.passage_width[k] = foreign_map.passage_width
        maps.seed_points[k, : len(cells)] = cells
        maps.sizes[k, : len(foreign_map.sizes)] = foreign_map.sizes
        maps.directions[k, : len(foreign_map.directions)] = foreign_map.directions
    if not header.has_terrain:
        return maps
    terrains = [
        foreign_map.terrain for foreign_map in foreign_maps if foreign_map.terrain is not None
    ]
    return replace(maps, terrain=np.stack(terrains))


def _seed_points(foreign_map: ForeignMap, header: Header, draws: Draws, index: int) -> Ints:
    """Return the seed points of map ``index``, (k, 2): those of its source, then those drawn."""
    missing = draws.seed_points - len(foreign_map.seed_points)
    if foreign_map.rooms_known or missing <= 0:
        return foreign_map.seed_points
    _, columns = foreign_map.shape
    # Cells are drawn by their numbers in reading order, row * columns + column.
    own_cells = foreign_map.seed_points[:, 0] * columns + foreign_map.seed_points[:, 1]
    diagonals, _ = move_rule(header.movement)
    candidates = np.setdiff1d(largest_component(foreign_map.grid, diagonals), own_cells)
    count = min(missing, len(candidates))
    drawn = draw_points(candidates, np.uint64(draws.seed), np.uint64(index), count)
    cell_numbers = np.concatenate((own_cells, drawn))
    return np.column_stack(np.divmod(cell_numbers, columns))
