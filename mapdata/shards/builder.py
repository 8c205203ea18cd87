"""Building a dataset shard by shard, and continuing a build that stopped."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence, Set
from concurrent.futures import BrokenExecutor, Executor
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mapdata.checks import check_count, check_integers
from mapdata.generators.generator import check_plain
from mapdata.generators.recipe import (
    Recipe,
    RecipeLike,
    as_recipe,
    check_reproducible,
    generate,
    is_pinned,
    is_same_map,
)
from mapdata.generators.stored_families import unknown_family, why_not_drawn
from mapdata.hashing import canonical_json
from mapdata.search.labels import label
from mapdata.shards.costly_maps import costly_rows, label_exactly
from mapdata.shards.errors import ShardError
from mapdata.shards.files import StrPath, file_hash, file_size, make_folder, write_file
from mapdata.shards.header import Header, Span
from mapdata.shards.image import shard_image
from mapdata.shards.locations import target_folder
from mapdata.shards.manifest import MANIFEST, Entry, Manifest, entry_of, path_in, read_manifest
from mapdata.shards.merging import announced, check_names, load_shard, merge, sweep, union
from mapdata.shards.reader import map_shard, open_shard, sound_labels
from mapdata.shards.workers import (
    MAX_PENDING_IN_THREADS,
    Advance,
    bar,
    completed,
    no_bar,
    thread_pool,
)

_MIN_MERGE_PAUSE = 2.0
"""Seconds between two writes of the manifest while shards are built, at least."""

_PAUSE_PER_MERGE_TIME = 20
"""A pause also lasts this many times as long as the last write, which grows with the manifest."""

_FIRST_MAPS = 8
"""How many maps with terrain are labelled before a build, to see whether costs are too high."""

_MAX_PENDING_IN_EXECUTOR = 10_000
"""How many shards an executor holds at once, at most: enough to keep a large cluster busy."""


def build(
    root: StrPath,
    recipe: RecipeLike,
    *,
    maps: int | None = None,
    seed: int | None = None,
    shard_size: int = 1000,
    workers: int | None = None,
    executor: Executor | None = None,
    part: tuple[int, int] = (0, 1),
    progress: bool = False,
) -> Manifest:
    """Build the maps of a recipe with all labels as shards under ``root``.

    A build that stopped is continued, and a dataset with fewer maps is extended. The content does
    not depend on workers, order or interruptions; the bytes of the files depend on the version of
    h5py.

    Args:
        root: folder of the dataset; it is created if it is missing.
        recipe: which maps: a preset's name, a recipe file, its JSON text or mapping, a
            `MapGenerator` or a `Recipe`. A content hash that it states is compared with that of
            the complete dataset, unless ``maps`` or ``seed`` changes the recipe.
        maps: number of maps of the finished dataset; the recipe's by default, 10,000 for a preset
            or generator.
        seed: 64-bit seed; the recipe's by default, 0 for a preset or generator.
        shard_size: maps per shard.
        workers: number of threads (the kernels release the GIL); default all cores.
        executor: builds the shards instead of threads; anything with ``submit``. When one of its
            workers dies and breaks it, as in a process pool, threads of this process continue.
        part: (k, n): build only every n-th shard, starting with shard k. The n parts together are
            the whole dataset. They may be built in any order or at the same time, on one machine
            or on several that share the folder.
        progress: show a progress bar.

    Returns:
        The manifest; while other parts are unfinished it lists the shards that exist so far.

    Raises:
        ShardError: the recipe states another content hash.
        ValueError: an argument is invalid; the root is a URL or a file, or holds other files; it
            holds a dataset of another recipe or shard size, or one with more maps; the family of a
            user does not draw the same map twice; the costs of most maps are too high to be exact
            (a single map whose costs are too high is stored without problems, and a warning names
            it).
        OSError: the disk is full, or the folder may not be written to.
    """
    recipe = as_recipe(recipe, maps=maps, seed=seed)
    manifest = _build_shards(
        target_folder(root),
        recipe,
        shard_size=shard_size,
        workers=workers,
        executor=executor,
        part=part,
        progress=progress,
    )
    expected_hash = recipe.content_hash
    if manifest.complete and expected_hash not in (None, manifest.content_hash):
        raise ShardError(f"content hash {manifest.content_hash}, the recipe says {expected_hash}")
    return manifest


def _build_shards(
    root: Path,
    recipe: Recipe,
    *,
    shard_size: int,
    workers: int | None,
    executor: Executor | None,
    part: tuple[int, int],
    progress: bool,
) -> Manifest:
    """Build the missing shards of a recipe; the arguments are those of `build`."""
    _check_workers(workers, executor)
    generator = recipe.generator
    planned = Manifest(
        generator=generator,
        seed=recipe.seed,
        maps=recipe.maps,
        shard_size=check_count("shard_size", shard_size),
        map_size=generator.map_size,
        movement=generator.movement,
        resolution=generator.resolution,
    )
    assigned = _assigned_headers(planned, part)
    check_plain(generator)
    check_reproducible(recipe)
    if not (root / MANIFEST).exists():
        _check_first_costs(recipe)
    existing = _create_root(root, planned)
    present = _check_present(
        root, planned, existing, {header.limits for header in assigned}, progress
    )
    manifest = replace(planned, shards=tuple(present.entries.values()))
    missing = [header for header in assigned if header.limits not in present.entries]
    is_writable = os.access(root, os.W_OK)
    if is_writable:
        sweep(root, manifest)
    elif missing:
        raise PermissionError(f"root: no permission to write in {root}")
    if not missing:
        # Nothing has to be built, so a root that is read-only is returned as it is.
        if manifest.complete or not is_writable:
            return manifest
        return _list_finished(root, manifest)
    _check_drawn_as_stored(root, existing, recipe)
    if executor is not None:
        _compile_kernels(missing[0])
    map_count = sum(header.maps for header in assigned)
    missing_count = sum(header.maps for header in missing)
    with (
        announced(root),
        bar(progress, map_count, initial=map_count - missing_count) as advance,
        _shard_pool(workers, executor) as pool,
    ):
        build_entry = partial(
            build_shard,
            root.absolute(),
            damaged=present.damaged,
            # Threads advance the bar themselves, within a shard; processes cannot reach it.
            advance=advance if executor is None else no_bar,
        )
        max_pending = MAX_PENDING_IN_THREADS if executor is None else _MAX_PENDING_IN_EXECUTOR
        with closing(_built_entries(pool, build_entry, missing, max_pending)) as built:
            entries = built if executor is None else _check_shared_folder(root, built, advance)
            manifest = _merge_while_building(root, manifest, entries)
        return _list_finished(root, manifest)


def _check_workers(workers: int | None, executor: Executor | None) -> None:
    """Refuse a number of threads that is not positive, or that an executor makes meaningless."""
    if workers is not None:
        if executor is not None:
            raise ValueError("workers: would do nothing beside an executor")
        check_count("workers", workers)


def _assigned_headers(planned: Manifest, part: tuple[int, int]) -> list[Header]:
    """Return the headers of the planned shards that belong to ``part`` = (k, n)."""
    part_index, part_count = check_integers("part", part)
    if not 0 <= part_index < part_count:
        raise ValueError(f"part: got {part!r}, expected (k, n) with 0 <= k < n")
    return planned_headers(planned)[part_index::part_count]


def _compile_kernels(header: Header) -> None:
    """Build one map of a shard and drop it, so that all kernels are compiled and cached.

    The processes of an executor then load them from the cache. Without this, every process would
    compile them at the same time.
    """
    if header.generator is not None and header.seed is not None:
        labels = label(generate(header.generator, header.seed, [0]))
        shard_image(labels, replace(header, start=0, stop=1))


def _shard_pool(workers: int | None, executor: Executor | None) -> AbstractContextManager[Executor]:
    """Return the caller's executor, which stays open, or else a pool of threads."""
    return thread_pool(workers) if executor is None else nullcontext(executor)


class MergePacer:
    """Lists finished shards in the manifest on disk, but not so often that it slows the build."""

    def __init__(self, root: Path, manifest: Manifest) -> None:
        """Begin with the shards that ``manifest`` lists already."""
        self.root = root
        self._dataset = manifest
        self._entries = list(manifest.shards)
        self._due = time.monotonic() + _MIN_MERGE_PAUSE

    @property
    def manifest(self) -> Manifest:
        """The manifest with all shards that were added."""
        return replace(self._dataset, shards=tuple(self._entries))

    def add(self, entry: Entry) -> None:
        """Add a finished shard; write the manifest if the pause since the last write is over."""
        self._entries.append(entry)
        start = time.monotonic()
        if start > self._due:
            # Nothing is written while another builder holds the lock; a later merge lists it.
            merge(self.root, self.manifest, wait=False)
            end = time.monotonic()
            self._due = end + max(_MIN_MERGE_PAUSE, _PAUSE_PER_MERGE_TIME * (end - start))

    def finish(self, *, wait: bool) -> Manifest:
        """Write the manifest a last time and return it, with the shards of other builders."""
        return merge(self.root, self.manifest, wait=wait)


def _merge_while_building(root: Path, manifest: Manifest, entries: Iterable[Entry]) -> Manifest:
    """Consume the entries of finished shards and list them on disk; return the last manifest.

    After an error, the shards that were finished are still listed. After Ctrl-C this does not wait
    while another builder holds the lock: the next build adopts the shards that are not listed.
    """
    pacer = MergePacer(root, manifest)
    wait = True
    try:
        for entry in entries:
            pacer.add(entry)
    except KeyboardInterrupt:
        wait = False
        raise
    finally:
        merged = pacer.finish(wait=wait)
    return merged


def _check_shared_folder(root: Path, entries: Iterable[Entry], advance: Advance) -> Iterator[Entry]:
    """Yield the entries of shards that other processes built, after seeing the files in ``root``.

    Raises:
        OSError: a worker wrote its shard to a folder that this process does not share.
    """
    for entry in entries:
        if file_size(root / entry.name) != entry.bytes:
            raise OSError(
                f"root: a worker wrote {entry.name} elsewhere: it must share the folder {root}"
            )
        advance(entry.maps)
        yield entry


def _list_finished(root: Path, manifest: Manifest) -> Manifest:
    """List the shards of other builders, once all shards exist; return the manifest.

    Where there are no locks, two merges at the same time lose the entries of one of them. So a
    builder that sees all shards stays until the manifest on disk lists them. The last builder to
    see them merges last, so when all builders have ended, the manifest is complete.
    """
    entries = {entry.name: entry for entry in manifest.shards}
    while True:
        listed = read_manifest(root)
        listed_names = {entry.name for entry in listed.shards}
        unlisted = [
            header for header in planned_headers(listed) if header.file_name not in listed_names
        ]
        if not unlisted or not all((root / header.file_name).exists() for header in unlisted):
            return union(manifest, listed)
        for header in unlisted:
            entry = entries.get(header.file_name) or load_shard(root, header)
            if entry is None:  # The file is damaged: the next build replaces it.
                return union(manifest, listed)
            entries[entry.name] = entry
        manifest = merge(root, replace(listed, shards=tuple(entries.values())))


def planned_headers(manifest: Manifest) -> list[Header]:
    """Return the header of every shard that ``manifest`` plans."""
    return [manifest.header(start, stop) for start, stop in manifest.plan]


def build_shard(
    root: Path,
    header: Header,
    *,
    damaged: Set[Span] = frozenset(),
    follow_links: bool = False,
    advance: Advance = no_bar,
) -> Entry:
    """Return the entry of a shard, which is built unless a sound file of it exists.

    Args:
        root: folder of the dataset.
        header: of the shard.
        damaged: (start, stop) of the shards whose files are replaced without looking at them.
        follow_links: read a file that is a link out of the folder.
        advance: called with the number of maps that were finished since its last call.

    Raises:
        ValueError: the shard holds imported maps, which cannot be generated.
        OSError: the disk is full, or the folder may not be written to.
    """
    if header.limits not in damaged:
        entry = load_shard(root, header, follow_links)
        if entry is not None:
            advance(header.maps)
            return entry
    if header.generator is None or header.seed is None:
        raise ValueError("imported maps cannot be made again: they have no recipe")
    maps = generate(header.generator, header.seed, range(header.start, header.stop))
    labels = label_exactly(maps, advance)
    image, content = shard_image(labels, header)
    write_file(root / header.file_name, image)
    return entry_of(header, content, labels, image)


def _built_entries(
    pool: Executor,
    build_entry: Callable[[Header], Entry],
    headers: Sequence[Header],
    max_pending: int,
) -> Generator[Entry, None, None]:
    """Yield the entry of each shard when it is finished.

    If the executor breaks, threads of this process build the shards that it did not finish.
    """
    unfinished = dict.fromkeys(headers)
    try:
        for header, entry in completed(pool, build_entry, headers, max_pending):
            del unfinished[header]
            yield entry
    except BrokenExecutor as error:
        warnings.warn(
            f"executor: {error} Threads of this process make the other shards.", stacklevel=5
        )
        with thread_pool() as threads:
            for _, entry in completed(threads, build_entry, unfinished):
                yield entry


def _create_root(root: Path, planned: Manifest) -> Manifest:
    """Create the folder and the manifest of a dataset, or check that they are of ``planned``.

    Returns the manifest on disk.

    The manifest is written before the first shard, so that every reader of the folder can see
    which dataset it is for.

    Raises:
        ValueError: the folder holds something else.
        PermissionError: it may not be written to.
    """
    make_folder(root)
    if (root / MANIFEST).exists():
        existing = read_manifest(root)
    else:
        _check_unlisted_shards(root, planned)
        existing = merge(root, planned)
    _check_same_dataset(root, planned, existing)
    return existing


class _PresentShards(NamedTuple):
    """The shards that the manifest lists and whose files exist, by (start, stop).

    Attributes:
        entries: those whose files are as the manifest says.
        damaged: those whose files have other bytes.
    """

    entries: dict[Span, Entry]
    damaged: set[Span]


def _check_present(
    root: Path, planned: Manifest, existing: Manifest, assigned: Set[Span], progress: bool
) -> _PresentShards:
    """Compare the files of planned shards with ``existing``, the manifest on disk.

    The shards in ``assigned`` are hashed; of the shards of other parts only the size is compared.

    Raises:
        ValueError: a file links out of the folder.
        PermissionError: a shard may not be read.
    """
    plan = set(planned.plan)
    present = _PresentShards({}, set())
    # The last shard of a dataset may be partial; a larger dataset does not plan it.
    listed = [entry for entry in existing.shards if entry.limits in plan]
    map_count = sum(entry.maps for entry in listed)
    with bar(progress, map_count, unit=" maps checked") as advance:
        for entry in listed:
            path = path_in(root, entry.name)
            size = file_size(path)
            is_assigned = entry.limits in assigned
            if size == entry.bytes and (not is_assigned or file_hash(path) == entry.sha256):
                present.entries[entry.limits] = entry
            elif size is not None:
                present.damaged.add(entry.limits)
            advance(entry.maps)
    return present


def _check_unlisted_shards(root: Path, planned: Manifest) -> None:
    """Refuse a folder without a manifest that holds anything but shards of the planned dataset."""
    check_names(root)
    if not os.access(root, os.W_OK):
        raise PermissionError(f"root: no permission to write in {root}")
    max_maps = 0
    for path in sorted(root.glob("maps-*.h5")):
        try:
            header = map_shard(path_in(root, path.name)).shard.header
        except ShardError:
            continue  # The build replaces a damaged shard.
        # The last shard may hold fewer maps, so the largest so far tells the shard size.
        max_maps = max(max_maps, header.maps)
        fits_plan = header.start % planned.shard_size == 0 and header.maps <= planned.shard_size
        existing = replace(
            planned,
            generator=header.generator,
            seed=header.seed,
            has_terrain=header.has_terrain,
            maps=header.stop,
            shard_size=planned.shard_size if fits_plan else max_maps,
        )
        _check_same_dataset(root, planned, existing)


def _check_same_dataset(root: Path, planned: Manifest, existing: Manifest) -> None:
    """Refuse a folder that holds another dataset than the planned one; the message says how.

    Raises:
        ValueError: the datasets differ, or the existing one has more maps.
    """
    planned_facts = _facts(planned)
    existing_facts = _facts(existing)
    differing = [
        name
        for name, fact in planned_facts.items()
        # Lists and tuples are equal as JSON.
        if name in existing_facts and canonical_json(existing_facts[name]) != canonical_json(fact)
    ]
    if differing and existing.generator is None:
        raise ValueError(
            f"root: {root} holds maps that were imported, and no recipe makes more of them: choose "
            "another folder, or leave out the recipe (build= of MapDataModule) to train on it"
        )
    if differing:
        existing_text = ", ".join(f"{name} {existing_facts[name]}" for name in differing)
        planned_text = ", ".join(f"{name} {planned_facts[name]}" for name in differing)
        raise ValueError(
            f"root: {root} is of a dataset with {existing_text}, asked for {planned_text}: choose "
            "another folder, or ask for the same to continue it"
        )
    unknown = unknown_family(existing.generator)
    if unknown is not None:
        raise ValueError(f"root: {root} cannot be continued: {why_not_drawn(unknown)}")
    if planned.maps < existing.maps:
        raise ValueError(
            f"root: {root} holds {existing.maps} maps, asked for {planned.maps}: a dataset only "
            "grows"
        )


def _check_drawn_as_stored(root: Path, existing: Manifest, recipe: Recipe) -> None:
    """Refuse to add maps to a dataset if its family, one of a user, now draws other maps.

    A ``draw`` that was edited has the same parameters. The dataset would become a mixture, and the
    last shard, if it is partial, would be replaced by other maps. The first map of the last sound
    shard is drawn again and compared.

    Raises:
        ValueError: the two differ.
    """
    if is_pinned(recipe.generator):
        return
    for entry in reversed(existing.shards):
        try:
            stored = sound_labels(open_shard(path_in(root, entry.name))).maps
        except (ShardError, FileNotFoundError):
            continue  # The build replaces a damaged shard.
        drawn_rows = np.flatnonzero(stored.rooms > 1)  # Costly maps are not stored as drawn.
        if len(drawn_rows) == 0:
            continue
        k = int(drawn_rows[0])
        number = int(stored.index[k])
        if not is_same_map(stored, k, generate(recipe, indices=[number]), 0):
            raise ValueError(
                f"root: {root} cannot be continued: {recipe.generator.name} draws another map "
                f"{number} than the stored one, so its draw has changed since; build into another "
                "folder, or register the changed family under another name"
            )
        return


def _check_first_costs(recipe: Recipe) -> None:
    """Refuse a generator whose costs are often too high, before anything is built.

    The first maps are labelled. Where few maps are so, the build goes on without their problems.

    Raises:
        ValueError: half of these maps, or more, have a cost that is too high to be exact.
    """
    if not recipe.generator.has_terrain:
        return
    maps = generate(recipe, indices=range(min(recipe.maps, _FIRST_MAPS)))
    costly = costly_rows(maps)
    if 2 * len(costly) >= len(maps):
        row, error = next(iter(costly.items()))
        raise ValueError(
            f"{recipe.generator.name}: {len(costly)} of the first {len(maps)} maps have costs that "
            f"are too high: map {maps.index[row]}: {error.complaint}"
        )


def _facts(manifest: Manifest) -> dict[str, object]:
    """Return, by name, the parameters that tell a dataset from others."""
    generator = manifest.generator
    if generator is None:
        parameters: dict[str, object] = {"generator": "none: imported"}
    else:
        parameters = {"generator": generator.name, **generator.to_dict()}
    return {"seed": manifest.seed, "shard_size": manifest.shard_size, **parameters}
