"""Building a dataset, shard by shard, and going on where a build stopped."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable, Generator, Sequence, Set
from concurrent.futures import BrokenExecutor, Executor
from contextlib import closing, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path

from mapdata.checks import check_count, check_integers
from mapdata.generators.recipe import Recipe, RecipeLike, as_recipe, generate
from mapdata.search.labels import label
from mapdata.shards.errors import ShardError
from mapdata.shards.files import StrPath, file_size, make_folder, write_file
from mapdata.shards.header import Header, Span
from mapdata.shards.image import shard_image
from mapdata.shards.manifest import MANIFEST, Entry, Manifest, entry_of, path_in, read_manifest
from mapdata.shards.merging import check_names, load_shard, merge, sweep, union
from mapdata.shards.reader import map_shard
from mapdata.shards.root import file_hash, folder_of
from mapdata.shards.workers import FEW, Advance, bar, finished, no_bar, threads

_MERGE_EVERY = 2.0
"""Least seconds between two writes of the manifest while shards are made."""

_MERGE_SHARE = 20
"""A pause lasts this many times as long as the last write, which takes longer with more shards."""

_UNDER_WAY = 10_000
"""Most shards that an executor is given at once: enough to keep a large cluster busy."""


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

    A build that stopped goes on, and a dataset with fewer maps is extended. The content does not
    depend on workers, order or interruptions; the bytes of the files depend on the version of h5py.

    Args:
        root: folder, made if missing.
        recipe: which maps: a preset's name, a recipe file, its JSON text or mapping, a
            `MapGenerator` or a `Recipe`. A content hash that it states is compared with that of
            the complete dataset, unless ``maps`` or ``seed`` changes the recipe.
        maps: number of maps; the recipe's by default, 10,000 for a preset or generator.
        seed: 64-bit seed; the recipe's by default, 0 for a preset or generator.
        shard_size: maps per shard.
        workers: threads (the kernels hold no GIL); default all cores.
        executor: builds the shards instead of threads; anything with ``submit``. When one of its
            workers dies and breaks it, as in a process pool, threads of this process go on.
        part: (k, n): make only every n-th shard, from shard k on; the n parts, in any order, at
            once or one by one, on one machine or many that share the folder, make the whole.
        progress: show a progress bar.

    Returns:
        The manifest; it lists what is there when other parts are not finished.

    Raises:
        ShardError: the recipe states another content hash.
        ValueError: bad arguments; the root is a URL, a file or holds something else; another spec,
            seed, shard size, or more maps.
        OSError: the disk is full or may not be written to.
    """
    recipe = as_recipe(recipe, maps=maps, seed=seed)
    manifest = _build_shards(
        folder_of(root),
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
    """Build what is missing of the shards of a recipe; the arguments are those of `build`."""
    spec = recipe.spec
    if workers is not None:
        if executor is not None:
            raise ValueError("workers: would do nothing beside an executor")
        check_count("workers", workers)
    wanted = Manifest(
        spec=spec,
        seed=recipe.seed,
        maps=recipe.maps,
        shard_size=check_count("shard_size", shard_size),
        map_size=spec.map_size,
        movement=spec.movement,
        resolution=spec.resolution,
    )
    k, n = check_integers("part", part)
    if not 0 <= k < n:
        raise ValueError(f"part: got {part!r}, expected (k, n) with 0 <= k < n")
    mine = headers(wanted)[k::n]
    have, damaged = _prepare(root, wanted, {header.limits for header in mine}, progress)
    present = replace(wanted, shards=tuple(have.values()))
    todo = [header for header in mine if header.limits not in have]
    if os.access(root, os.W_OK):
        sweep(root, present)
    elif todo:
        raise PermissionError(f"root: no permission to write in {root}")
    if not todo:
        # a root that may only be read will do where there is nothing to write
        is_done = present.complete or not os.access(root, os.W_OK)
        return present if is_done else _list_finished(root, present)
    if executor is not None:
        # kernels are compiled here, once, rather than in each process of the executor at once
        shard_image(label(generate(spec, recipe.seed, [0])), replace(todo[0], start=0, stop=1))
    shards = list(present.shards)
    wait = True
    total = sum(header.maps for header in mine)
    left = sum(header.maps for header in todo)
    with (
        bar(progress, total, total - left) as advance,
        threads(workers) if executor is None else nullcontext(executor) as pool,
    ):
        make = partial(
            make_shard,
            root.absolute(),
            damaged=damaged,
            # Threads move the bar themselves, within a shard; processes cannot reach it.
            advance=no_bar if executor else advance,
        )
        most = FEW if executor is None else _UNDER_WAY
        with closing(_made(pool, make, todo, most)) as made:
            due = time.monotonic() + _MERGE_EVERY
            try:
                for entry in made:
                    if executor is not None:
                        if file_size(root / entry.name) != entry.bytes:
                            raise OSError(
                                f"root: a worker wrote {entry.name} elsewhere: it must share the "
                                f"folder {root}"
                            )
                        advance(entry.maps)
                    shards.append(entry)
                    began = time.monotonic()
                    if began > due:
                        # without waiting for another builder: the entries stay for next time
                        merge(root, replace(wanted, shards=tuple(shards)), wait=False)
                        ended = time.monotonic()
                        due = ended + max(_MERGE_EVERY, _MERGE_SHARE * (ended - began))
            except KeyboardInterrupt:
                wait = False  # the next build adopts the shards that the manifest does not list
                raise
            finally:
                manifest = merge(root, replace(wanted, shards=tuple(shards)), wait=wait)
    return _list_finished(root, manifest)


def _list_finished(root: Path, manifest: Manifest) -> Manifest:
    """List what other builders finished, once all shards are there; return the manifest.

    Where there are no locks, two merges at once lose the entries of one of them. So whoever sees
    that all shards are there stays until the manifest on disk lists them. No merge follows that of
    the last builder to see it, so when all builders have ended, the manifest is complete.
    """
    known = {entry.name: entry for entry in manifest.shards}
    while True:
        listed = read_manifest(root)
        names = {entry.name for entry in listed.shards}
        missing = [header for header in headers(listed) if header.file_name not in names]
        if not missing or not all((root / header.file_name).exists() for header in missing):
            return union(manifest, listed)
        for header in missing:
            entry = known.get(header.file_name) or load_shard(root, header)
            if entry is None:  # damaged: the next build makes it again
                return union(manifest, listed)
            known[entry.name] = entry
        manifest = merge(root, replace(listed, shards=tuple(known.values())))


def headers(manifest: Manifest) -> list[Header]:
    """Return the header of every shard that ``manifest`` plans."""
    return [manifest.header(*limits) for limits in manifest.plan]


def make_shard(
    root: Path, header: Header, *, damaged: Set[Span] = frozenset(), advance: Advance = no_bar
) -> Entry:
    """Write a shard and return its entry; a sound one that is there and not ``damaged`` is kept.

    ``advance`` is called with numbers of maps as they are done.
    """
    if header.limits not in damaged:
        found = load_shard(root, header)
        if found is not None:
            advance(header.maps)
            return found
    if header.spec is None or header.seed is None:
        raise ValueError("imported maps cannot be made again: they have no recipe")
    maps = generate(header.spec, header.seed, range(header.start, header.stop))
    labels = label(maps, advance)
    image, content = shard_image(labels, header)
    write_file(root / header.file_name, image)
    return entry_of(header, content, labels, image)


def _made(
    pool: Executor, make: Callable[[Header], Entry], todo: Sequence[Header], most: int
) -> Generator[Entry, None, None]:
    """Yield the entry of each shard when it is finished."""
    left = dict.fromkeys(todo)
    try:
        for header, entry in finished(pool, make, todo, most):
            del left[header]
            yield entry
    except BrokenExecutor as error:
        warnings.warn(
            f"executor: {error} Threads of this process make the other shards.", stacklevel=3
        )
        with threads() as spare:
            for _, entry in finished(spare, make, left):
                yield entry


def _prepare(
    root: Path, wanted: Manifest, mine: Set[Span], progress: bool
) -> tuple[dict[Span, Entry], Set[Span]]:
    """Make sure that the root is of the wanted dataset; make it if it is missing.

    Returns:
        By (start, stop), the entries of the shards that are there, and which are there with other
            bytes than the manifest states. Those of ``mine`` were hashed, of others only the size
            is compared.

    Raises:
        ValueError: it holds something else, or links to files elsewhere.
        PermissionError: it may not be written to, or a shard may not be read.
    """
    make_folder(root)
    if (root / MANIFEST).exists():
        found = read_manifest(root)
    else:
        _check_unlisted(root, wanted)
        # The manifest comes before the first shard: whoever finds the root knows what it is for.
        found = merge(root, wanted)
    _check_same(root, wanted, found)
    plan = set(wanted.plan)
    have = {}
    damaged = set()
    # A partial last shard is not in the plan of a larger dataset.
    listed = [entry for entry in found.shards if entry.limits in plan]
    total = sum(entry.maps for entry in listed)
    with bar(progress, total, unit=" maps checked") as advance:
        for entry in listed:
            limits = entry.limits
            path = path_in(root, entry.name)
            size = file_size(path)
            if size == entry.bytes and (limits not in mine or file_hash(path) == entry.sha256):
                have[limits] = entry
            elif size is not None:
                damaged.add(limits)
            advance(entry.maps)
    return have, damaged


def _check_unlisted(root: Path, wanted: Manifest) -> None:
    """Refuse a folder without a manifest that holds anything but shards of the wanted dataset."""
    check_names(root)
    if not os.access(root, os.W_OK):
        raise PermissionError(f"root: no permission to write in {root}")
    largest = 0
    for path in sorted(root.glob("maps-*.h5")):
        try:
            header = map_shard(path_in(root, path.name)).shard.header
        except ShardError:
            continue  # a corrupt shard is made again
        largest = max(largest, header.maps)  # the last shard may have fewer
        fits = header.start % wanted.shard_size == 0 and header.maps <= wanted.shard_size
        size = wanted.shard_size if fits else largest
        found = replace(
            wanted, spec=header.spec, seed=header.seed, maps=header.stop, shard_size=size
        )
        _check_same(root, wanted, found)


def _check_same(where: Path, wanted: Manifest, found: Manifest) -> None:
    """Refuse what is found if it is of another dataset than the wanted one; say what differs."""
    mine = _facts(wanted)
    theirs = _facts(found)
    names = [name for name in mine if name in theirs and mine[name] != theirs[name]]
    if names:
        there = ", ".join(f"{name} {theirs[name]}" for name in names)
        here = ", ".join(f"{name} {mine[name]}" for name in names)
        raise ValueError(f"root: {where} is of a dataset with {there}, asked for {here}")
    if wanted.maps < found.maps:
        raise ValueError(
            f"root: {where} holds {found.maps} maps, asked for {wanted.maps}: a dataset only grows"
        )


def _facts(manifest: Manifest) -> dict[str, object]:
    """Return by name what tells a dataset from others."""
    spec = manifest.spec
    facts = {"generator": spec.name, **spec.to_dict()} if spec else {"generator": "none: imported"}
    return {"seed": manifest.seed, "shard_size": manifest.shard_size, **facts}
