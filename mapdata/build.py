"""Many shards: build them, go on where a build stopped, verify them."""

from __future__ import annotations

import hashlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

from tqdm import tqdm

from mapdata.content import content_hash
from mapdata.dungeon import generate
from mapdata.labels import label
from mapdata.manifest import (
    LOCK,
    MANIFEST,
    Entry,
    Manifest,
    counts_of,
    entry_of,
    is_shard_name,
    load_shard,
    merge,
    read_manifest,
    shard_name,
    sweep,
)
from mapdata.shard import Header, Shard, ShardError, decode, open_shard, shard_image, write_file
from mapdata.spec import FORMAT_VERSION, PRESETS, MapSpec, check_count, check_seed, identity

MOST_SHARDS = 10**7
"""Most files of a dataset."""

_MERGE_EVERY = 2.0
"""Seconds between two writes of the manifest."""


@dataclass(frozen=True)
class Recipe:
    """What a dataset is made of, in a few lines: all that is needed to build it again bit for bit.

    Attributes:
        spec: the distribution of maps.
        seed: 64-bit seed.
        maps: how many.
        content_hash: what the result must hash to, if known.
    """

    spec: MapSpec
    seed: int = 0
    maps: int = 10_000
    content_hash: str | None = None

    @staticmethod
    def load(text: str) -> Recipe:
        """Return the recipe that ``text`` names: a preset, a file of JSON, or JSON text.

        Raises:
            ValueError: none of these, or a recipe that states what cannot be.
        """
        if text in PRESETS:
            return Recipe(PRESETS[text])
        if not text.lstrip().startswith("{"):
            if not Path(text).is_file():
                raise ValueError(f"recipe: {text!r} is no preset ({', '.join(PRESETS)}), no file and no JSON text")
            text = Path(text).read_text(encoding="utf-8")
        try:
            values = json.loads(text)
        except (json.JSONDecodeError, RecursionError) as error:
            raise ValueError(f"recipe: not JSON ({error})") from None
        known = {"format_version", "spec", "seed", "maps", "identity", "content_hash"}
        if not isinstance(values, dict) or not set(values) <= known:
            raise ValueError(f"recipe: expected an object with {', '.join(sorted(known))}")
        if values.get("format_version", FORMAT_VERSION) != FORMAT_VERSION:
            raise ValueError(f"recipe: format version {values['format_version']}, this mapdata makes {FORMAT_VERSION}")
        recipe = Recipe(
            spec=MapSpec.from_dict(values.get("spec", {})),
            seed=check_seed(values.get("seed", 0)),
            maps=check_count("maps", values.get("maps", Recipe.maps)),
            content_hash=values.get("content_hash"),
        )
        if values.get("identity") not in (None, identity(recipe.spec, recipe.seed)):
            raise ValueError(f"recipe: its identity {values['identity']} is not that of its spec and seed")
        return recipe


def build(
    root: str | os.PathLike[str],
    spec: MapSpec,
    *,
    maps: int = 10_000,
    seed: int = 0,
    shard_size: int = 1000,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: bool = False,
) -> Manifest:
    """Make maps 0 to ``maps`` - 1 of (spec, seed) with all labels as shards under ``root``; go on where a build
    stopped.

    More maps than the root has extend it. The bytes do not depend on workers, order or interruptions.

    Args:
        root: folder, made if missing.
        spec: the distribution of maps.
        maps: how many maps the dataset shall have.
        seed: 64-bit seed.
        shard_size: maps a shard.
        workers: threads (the kernels hold no GIL); default all cores.
        executor: runs the shards instead of threads; anything with ``submit``.
        progress: show a progress bar.

    Returns:
        The manifest of the finished dataset.

    Raises:
        ValueError: bad arguments; the root is a file or holds something else; another spec, seed, shard size, or more
            maps.
        OSError: the disk is full or may not be written to.
    """
    root = Path(root)
    if not isinstance(spec, MapSpec):
        raise ValueError(f"spec: got {spec!r}, expected a MapSpec")
    if workers is not None and executor is not None:
        raise ValueError("workers: would do nothing beside an executor")
    check_count("workers", 1 if workers is None else workers)
    wanted = Manifest(
        spec=spec,
        seed=check_seed(seed),
        maps=check_count("maps", maps),
        shard_size=check_count("shard_size", shard_size),
        map_size=spec.map_size,
        movement=spec.movement,
        resolution=spec.resolution,
    )
    if maps > MOST_SHARDS * shard_size:
        raise ValueError(f"maps: {maps} in shards of {shard_size} are over {MOST_SHARDS} files; take larger shards")
    have = _prepare(root, wanted)
    todo = [header for header in headers(wanted) if (header.start, header.stop) not in have]
    if not todo:  # nothing to write, so a root that may only be read will do
        return replace(wanted, shards=tuple(have.values()))
    sweep(root)
    manifest = replace(wanted, shards=tuple(have.values()))
    with _bar(progress, total=maps, initial=_count(manifest.shards), unit=" maps") as advance:
        pool = executor or ThreadPoolExecutor(workers or os.cpu_count() or 1, thread_name_prefix="mapdata")
        try:
            written = time.monotonic()
            for entry in _run(pool, root, todo):
                advance(entry.stop - entry.start)
                manifest = replace(manifest, shards=(*manifest.shards, entry))
                if time.monotonic() - written > _MERGE_EVERY:
                    merge(root, manifest)
                    written = time.monotonic()
        finally:
            if executor is None:
                pool.shutdown(wait=True, cancel_futures=True)
            manifest = merge(root, manifest)
    return manifest


def headers(manifest: Manifest) -> Iterator[Header]:
    """Yield the header of every shard that ``manifest`` plans."""
    for start, stop in manifest.plan:
        yield Header(
            spec=manifest.spec,
            seed=manifest.seed,
            start=start,
            stop=stop,
            map_size=manifest.map_size,
            movement=manifest.movement,
            resolution=manifest.resolution,
        )


def make_shard(root: Path, header: Header) -> Entry:
    """Make one shard, unless a sound one stands under its name already; return its entry."""
    if found := load_shard(root, header):
        return found
    if header.spec is None or header.seed is None:
        raise ValueError("imported maps cannot be made again: they have no recipe")
    labels = label(generate(header.spec, header.seed, range(header.start, header.stop)))
    image, content = shard_image(labels, header)
    path = root / shard_name(header.start, header.stop)
    write_file(path, image)
    return entry_of(Shard(path, header, content, {}), labels, image)


def _run(pool: Executor, root: Path, todo: Iterable[Header]) -> Iterator[Entry]:
    """Yield entries as shards are finished, with few shards under way so that a stop is quick."""
    under_way: set[Future[Entry]] = set()
    waiting = iter(todo)
    try:
        while True:
            for header in waiting:
                under_way.add(pool.submit(make_shard, root, header))
                if len(under_way) >= 4 * (os.cpu_count() or 1):
                    break
            if not under_way:
                return
            done, under_way = wait(under_way, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()
    finally:
        for future in under_way:
            future.cancel()


def _prepare(root: Path, wanted: Manifest) -> dict[tuple[int, int], Entry]:
    """Make the root if it is missing; return what it has of the wanted dataset, or refuse it."""
    if root.exists() and not root.is_dir():
        raise ValueError(f"root: {root} is a file, expected a folder")
    root.mkdir(parents=True, exist_ok=True)
    if not (root / MANIFEST).exists():
        others = [path.name for path in root.iterdir() if not _ours(path.name)]
        if others:
            raise ValueError(f"root: {root} holds something else ({sorted(others)[0]!r}), expected an empty folder")
        if not os.access(root, os.W_OK):
            raise PermissionError(f"root: no permission to write in {root}")
        for path in root.glob("maps-*.h5"):
            _check_owner(path, wanted)
        # The manifest comes first: it says what the root is for, to whoever finds it before it is complete.
        found = merge(root, wanted)
    else:
        found = read_manifest(root)
    for name, mine, theirs in (
        ("spec", wanted.spec, found.spec),
        ("seed", wanted.seed, found.seed),
        ("shard size", wanted.shard_size, found.shard_size),
    ):
        if mine != theirs:
            raise ValueError(f"root: {root} holds a dataset with {name} {theirs}, asked for {name} {mine}")
    if wanted.maps < found.maps:
        raise ValueError(f"root: {root} holds {found.maps} maps, asked for {wanted.maps}: a dataset only grows")
    plan, have = set(wanted.plan), {}
    for entry in found.shards:
        if _size(root / entry.name) != entry.bytes:
            (root / entry.name).unlink(missing_ok=True)  # damaged: it is made again
        elif (entry.start, entry.stop) in plan:
            have[entry.start, entry.stop] = entry
    return have


@contextmanager
def _bar(shown: bool, **arguments: Any) -> Iterator[Callable[[int], object]]:  # noqa: ANN401  (tqdm's own)
    """Yield what advances a progress bar; a bar that is not shown is not made, since tqdm takes a lock and a thread."""
    if shown:
        with tqdm(**arguments) as bar:
            yield bar.update
    else:
        yield lambda _: None


def _check_owner(path: Path, wanted: Manifest) -> None:
    """Refuse a root without a manifest whose shards are of another dataset; damaged ones are made again."""
    try:
        header = open_shard(path).header
    except ShardError:
        return
    for name, mine, theirs in (("spec", wanted.spec, header.spec), ("seed", wanted.seed, header.seed)):
        if mine != theirs:
            raise ValueError(f"root: {path} is of a dataset with {name} {theirs}, asked for {name} {mine}")


def _ours(name: str) -> bool:
    return is_shard_name(name) or name in (LOCK, MANIFEST) or (name.startswith(".") and name.endswith(".tmp"))


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return -1


def _count(shards: Iterable[Entry]) -> int:
    return sum(entry.stop - entry.start for entry in shards)


def verify(root: str | os.PathLike[str], *, progress: bool = False) -> list[str]:
    """Return what is wrong with a dataset, a line each; an empty list when all is well.

    Every file is hashed before HDF5 opens it, then guarded, and its content hash is computed again.

    Raises:
        DatasetNotFoundError: there is no dataset under ``root``.
    """
    root = Path(root)
    try:
        manifest = read_manifest(root)
    except ShardError as error:
        return [str(error)]
    problems = []
    text = (root / MANIFEST).read_text(encoding="utf-8")
    if text != json.dumps(json.loads(text), indent=1) + "\n":
        problems.append(f"{root / MANIFEST}: damaged (its text is not as it was written)")
    planned = {(header.start, header.stop): header for header in headers(manifest)}
    with _bar(progress, total=len(manifest.shards), unit=" shards") as advance:
        for entry in manifest.shards:
            header = planned.pop((entry.start, entry.stop), None) or _partial(entry, planned.values())
            problem = "not a shard of this dataset" if header is None else _problem(root / entry.name, entry, header)
            if problem:
                problems.append(problem if str(root) in problem else f"{root / entry.name}: {problem}")
            advance(1)
    problems += [f"{root / shard_name(*missing)}: missing (the build did not finish)" for missing in planned]
    return problems


def _partial(entry: Entry, planned: Iterable[Header]) -> Header | None:
    """Return the header of a partial last shard that an extension has not replaced yet."""
    for header in planned:
        if header.start == entry.start and entry.stop < header.stop:
            return replace(header, stop=entry.stop)
    return None


def _problem(path: Path, entry: Entry, header: Header) -> str | None:
    """Return what is wrong with one shard file, or None."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return "missing"
    except OSError as error:
        return f"cannot be read ({error})"
    if len(data) != entry.bytes:
        return f"has {len(data)} bytes, the manifest says {entry.bytes}"
    if hashlib.sha256(data).hexdigest() != entry.sha256:
        return "damaged (its file hash does not fit)"
    try:
        shard = open_shard(path, entry.bytes)
    except ShardError as error:
        return str(error)
    if shard.header != header:
        return "holds other maps than the manifest says"
    labels = decode(shard)
    if not content_hash(labels) == shard.content_hash == entry.content_hash:
        return "damaged (its content hash does not fit)"
    if counts_of(labels) != entry.counts:
        return "the manifest counts other problems than it holds"
    return None


class _Module(ModuleType):
    """``mapdata.build`` is this module once it is imported, and the public function before: calling either is the
    same.
    """

    __call__ = staticmethod(build)


sys.modules[__name__].__class__ = _Module
