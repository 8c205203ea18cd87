"""What is wrong with a dataset on disk, and how to mend it: a shard that is damaged or gone is made again from the
recipe, a manifest from the shards.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from mapdata.shards.builder import headers, make_shard
from mapdata.shards.content import content_hash
from mapdata.shards.manifest import (
    MANIFEST,
    MOST_SHARDS,
    PROVENANCE,
    DatasetNotFoundError,
    Entry,
    Manifest,
    counts_of,
    is_shard_name,
    load_shard,
    merge,
    provenance_text,
    read_manifest,
    shard_name,
)
from mapdata.shards.reader import open_shard
from mapdata.shards.shard import Header, ShardError, decode, write_file
from mapdata.shards.workers import CORES, bar, finished, threads


@dataclass(frozen=True)
class Corruption:
    """One file that is not what it should be.

    Attributes:
        path: the file.
        what: what is wrong with it.
        header: of the shard that belongs there; None if it is no shard, or belongs nowhere.
    """

    path: Path
    what: str
    header: Header | None = None

    def __str__(self) -> str:
        """Return one line."""
        return self.what if str(self.path) in self.what else f"{self.path}: {self.what}"


@dataclass(frozen=True)
class Inspection:
    """What is wrong with a dataset.

    Attributes:
        manifest: what its manifest says, or, where that is damaged, what its sound shards say; None if there is none.
        faults: in the order of the maps.
    """

    manifest: Manifest | None
    faults: tuple[Corruption, ...]


def verify(root: str | os.PathLike[str], *, progress: bool = False) -> list[str]:
    """Return what is wrong with a dataset, a line each; an empty list when all is well.

    Every file is hashed before HDF5 opens it, then guarded, and its content hash is computed again.

    Raises:
        DatasetNotFoundError: there is no dataset under ``root``.
    """
    return [str(fault) for fault in inspect(root, progress=progress).faults]


def repair(root: str | os.PathLike[str], *, progress: bool = False) -> list[str]:
    """Make again what `verify` finds damaged or missing, and nothing else; return what is wrong still, a line each.

    Imported maps have no recipe, so their shards cannot be made again.

    Raises:
        DatasetNotFoundError: there is no dataset under ``root``.
        OSError: the disk is full or may not be written to.
    """
    return [str(fault) for fault in repair_found(root, inspect(root, progress=progress), progress=progress)]


def inspect(root: str | os.PathLike[str], *, progress: bool = False) -> Inspection:
    """Check every file of a dataset.

    Raises:
        DatasetNotFoundError: there is no dataset under ``root``.
    """
    root = Path(root)
    faults: list[Corruption] = []
    listed = True
    try:
        manifest: Manifest | None = read_manifest(root)
        text = (root / MANIFEST).read_text(encoding="utf-8")
        if text != json.dumps(json.loads(text), indent=1) + "\n":
            faults.append(Corruption(root / MANIFEST, "damaged (its text is not as it was written)"))
    except (ShardError, DatasetNotFoundError) as error:
        shards = [path for path in sorted(root.glob("maps-*.h5")) if is_shard_name(path.name)]
        if not shards and isinstance(error, DatasetNotFoundError):
            raise
        faults.append(Corruption(root / MANIFEST, "missing" if isinstance(error, DatasetNotFoundError) else str(error)))
        manifest, listed = _gather(root, shards), False
    if manifest is None:
        faults += [Corruption(path, "damaged, or its place is lost") for path in shards]
        return Inspection(None, tuple(faults))
    if manifest.spec is None:
        faults += _provenance(root / PROVENANCE)
    manifest, wrong = (_check_listed if listed else _check_unlisted)(root, manifest, progress)
    return Inspection(manifest, (*faults, *wrong))


def repair_found(root: str | os.PathLike[str], findings: Inspection, *, progress: bool = False) -> list[Corruption]:
    """Make again what can be; return what is wrong still.

    Raises:
        OSError: the disk is full or may not be written to.
    """
    root, manifest, left = Path(root), findings.manifest, []
    if manifest is None:
        why = "no sound shard says what it was: delete it and run the same build again"
        return [replace(fault, what=f"{fault.what}; {why}") for fault in findings.faults]
    again: list[Header] = []
    for fault in findings.faults:
        if fault.header is not None and fault.header.spec is not None:
            again.append(fault.header)
        elif fault.path.name != MANIFEST:
            why = "imported maps have no recipe: delete it and import again" if manifest.spec is None else ""
            left.append(replace(fault, what=f"{fault.what}; it cannot be made again{why and ', '}{why}"))
    said = {entry.name: entry.content_hash for entry in manifest.shards}
    made = []
    with bar(progress, sum(header.stop - header.start for header in again)) as advance, threads() as pool:
        for header, entry in finished(pool, partial(make_shard, root, anew=True), again, 2 * CORES):
            made.append(entry)
            if said.get(entry.name, entry.content_hash) != entry.content_hash:
                what = f"made again with content hash {entry.content_hash}, the manifest said {said[entry.name]}"
                left.append(Corruption(root / entry.name, what, header))
            advance(header.stop - header.start)
    mended = replace(manifest, shards=(*manifest.shards, *made))
    if findings.faults and findings.faults[0].path.name == MANIFEST:
        shards = {entry.start: entry for entry in mended.shards}
        mended = replace(mended, shards=tuple(shards[start] for start in sorted(shards)))
        write_file(root / MANIFEST, mended.to_json().encode())
    elif made:
        merge(root, mended)
    return left


def _check_listed(root: Path, manifest: Manifest, progress: bool) -> tuple[Manifest, list[Corruption]]:
    """Check the shards that a manifest lists, and which it should list."""
    planned = {(header.start, header.stop): header for header in headers(manifest)}
    tasks: list[tuple[Entry, Header | None]] = []
    for entry in manifest.shards:
        header = planned.pop((entry.start, entry.stop), None) or _partial(entry, planned.values())
        tasks.append((entry, header))
    faults = []
    with bar(progress, sum(entry.stop - entry.start for entry in manifest.shards)) as advance, threads() as pool:
        for (entry, header), what in finished(pool, partial(_fault, root), tasks, 2 * CORES):
            if what:
                faults.append(Corruption(root / entry.name, what, header))
            advance(entry.stop - entry.start)
    faults.sort(key=lambda fault: fault.path)
    for missing, header in planned.items():
        faults.append(Corruption(root / shard_name(*missing), "missing (the build did not finish)", header))
    return manifest, faults


def _check_unlisted(root: Path, manifest: Manifest, progress: bool) -> tuple[Manifest, list[Corruption]]:
    """Check shards by what they say of themselves, where the manifest is gone; list the sound ones."""
    found, wrong = [], []
    with bar(progress, manifest.maps) as advance, threads() as pool:
        for header, entry in finished(pool, partial(load_shard, root), headers(manifest), 2 * CORES):
            if entry is not None:
                found.append(entry)
            else:
                path = root / shard_name(header.start, header.stop)
                wrong.append(Corruption(path, "damaged" if path.exists() else "missing", header))
            advance(header.stop - header.start)
    found.sort(key=lambda entry: entry.start)
    wrong.sort(key=lambda fault: fault.path)
    return replace(manifest, shards=tuple(found)), wrong


def _gather(root: Path, shards: Sequence[Path]) -> Manifest | None:
    """Return what most shards say they are a part of, none listed yet; None if none can be read."""
    said: Counter[Header] = Counter()
    for path in shards:
        try:
            said[replace(open_shard(path).header, start=0, stop=0)] += 1
        except (OSError, ShardError):
            continue
    if not said:
        return None
    ((header, _),) = said.most_common(1)
    limits = [tuple(map(int, path.stem.split("-")[1:])) for path in shards]
    maps, largest = max(stop for _, stop in limits), max(stop - start for start, stop in limits)
    text = (root / MANIFEST).read_bytes() if (root / MANIFEST).exists() else b""
    stated = re.search(rb'"shard_size": (\d{1,9})\b', text)  # believed where it fits: a last shard may be a smaller one
    sizes = [int(stated[1]), largest] if stated else [largest]
    fits = [size for size in sizes if size >= largest and not any(start % size for start, _ in limits)]
    if not fits or maps > MOST_SHARDS * fits[0]:
        return None
    return Manifest(
        spec=header.spec,
        seed=header.seed,
        maps=maps,
        shard_size=fits[0],
        map_size=header.map_size,
        movement=header.movement,
        resolution=header.resolution,
    )


def _provenance(path: Path) -> list[Corruption]:
    """Check the file that says where imported maps came from."""
    try:
        text = path.read_text(encoding="utf-8")
        values = json.loads(text)
        del values["hash"]
        return [] if text == provenance_text(values) else [Corruption(path, "damaged (its hash does not fit)")]
    except FileNotFoundError:
        return [Corruption(path, "missing")]
    except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
        return [Corruption(path, f"damaged ({error})")]


def _partial(entry: Entry, planned: Iterable[Header]) -> Header | None:
    """Return the header of a partial last shard that an extension has not replaced yet."""
    for header in planned:
        if header.start == entry.start and entry.stop < header.stop:
            return replace(header, stop=entry.stop)
    return None


def _fault(root: Path, task: tuple[Entry, Header | None]) -> str | None:
    """Return what is wrong with one shard file, or None."""
    entry, header = task
    path = root / entry.name
    if header is None:
        return "not a shard of this dataset"
    try:
        if (size := path.stat().st_size) != entry.bytes:
            return f"has {size} bytes, the manifest says {entry.bytes}"
        if _file_hash(path) != entry.sha256:
            return "damaged (its file hash does not fit)"
        shard = open_shard(path, entry.bytes)
    except FileNotFoundError:
        return "missing"
    except OSError as error:
        return f"cannot be read ({error})"
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


def _file_hash(path: Path) -> str:
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        for block in iter(partial(file.read, 2**20), b""):
            digest.update(block)
    return digest.hexdigest()
