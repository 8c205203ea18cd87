"""What is wrong with a dataset, and how to repair it: a shard that is damaged or gone is made again
from the recipe, a manifest from the shards.
"""

from __future__ import annotations

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
    shard_name,
)
from mapdata.shards.reader import open_shard
from mapdata.shards.root import (
    Places,
    file_hash,
    folder_of,
    local_file,
    manifest_at,
    places,
    read_file,
)
from mapdata.shards.shard import Header, ShardError, decode, write_file
from mapdata.shards.workers import CORES, bar, finished, threads


@dataclass(frozen=True)
class Corruption:
    """One file that is not what it should be.

    Attributes:
        path: the file, or its URL.
        what: what is wrong with it.
        header: of the shard that belongs there; None if it is no shard, or belongs nowhere.
    """

    path: str
    what: str
    header: Header | None = None

    def __str__(self) -> str:
        """Return one line."""
        return self.what if self.path in self.what else f"{self.path}: {self.what}"


@dataclass(frozen=True)
class Inspection:
    """What is wrong with one dataset.

    Attributes:
        place: its folder or URL.
        manifest: what its manifest says, or, where that is damaged, what its sound shards say; None
            if there is none.
        faults: in the order of the maps.
    """

    place: str
    manifest: Manifest | None
    faults: tuple[Corruption, ...]


def verify(root: Places, *, progress: bool = False) -> list[str]:
    """Return what is wrong with a dataset, a line each; an empty list when all is well.

    Every file is hashed before HDF5 opens it, then checked, and its content hash is computed again.

    Args:
        root: folder or URL of a dataset, or several.
        progress: show a progress bar.

    Raises:
        DatasetNotFoundError: there is no dataset under ``root``.
    """
    return [
        str(fault) for place in places(root) for fault in inspect(place, progress=progress).faults
    ]


def repair(root: Places, *, progress: bool = False) -> list[str]:
    """Make again what `verify` finds damaged or missing, and nothing else; return what is wrong
    still, a line each.

    Imported maps have no recipe, so their shards cannot be made again.

    Args:
        root: folder of a dataset, or several.
        progress: show a progress bar.

    Raises:
        DatasetNotFoundError: there is no dataset under ``root``.
        ValueError: it lies at a URL.
        OSError: the disk is full or may not be written to.
    """
    left: list[Corruption] = []
    for folder in list(map(folder_of, places(root))):  # all of them before anything is made
        left += repair_found(inspect(folder, progress=progress), progress=progress)
    return [str(fault) for fault in left]


def inspect(place: str | os.PathLike[str], *, progress: bool = False) -> Inspection:
    """Check every file of the dataset of one folder or URL.

    Raises:
        DatasetNotFoundError: there is no dataset.
    """
    (place,) = places(place)
    faults: list[Corruption] = []
    listed = True
    at = f"{place}/{MANIFEST}"
    try:
        manifest: Manifest | None = manifest_at(place)
        text = read_file(place, MANIFEST).decode()
        if text != json.dumps(json.loads(text), indent=1) + "\n":
            faults.append(Corruption(at, "damaged (its text is not as it was written)"))
    except (ShardError, DatasetNotFoundError) as error:
        shards = [
            path for path in sorted(Path(place).glob("maps-*.h5")) if is_shard_name(path.name)
        ]
        missing = isinstance(error, DatasetNotFoundError)
        if missing and not shards:
            raise
        faults.append(Corruption(at, "missing" if missing else str(error)))
        manifest, listed = _gather(Path(place), shards), False
    if manifest is None:
        faults += [Corruption(str(path), "damaged, or its place is lost") for path in shards]
        return Inspection(place, None, tuple(faults))
    if manifest.spec is None:
        faults += _provenance(place)
    faults += _check_shards(place, manifest, listed, progress)
    return Inspection(place, manifest, tuple(faults))


def repair_found(findings: Inspection, *, progress: bool = False) -> list[Corruption]:
    """Make again what can be; return what is wrong still.

    Raises:
        ValueError: the dataset lies at a URL.
        OSError: the disk is full or may not be written to.
    """
    root = folder_of(findings.place)
    manifest = findings.manifest
    if manifest is None:
        why = "no sound shard says what it was: delete it and run the same build again"
        return [replace(fault, what=f"{fault.what}; {why}") for fault in findings.faults]
    left: list[Corruption] = []
    again: list[Header] = []
    relisted = False
    for fault in findings.faults:
        if fault.header is not None and fault.header.spec is not None:
            again.append(fault.header)
        elif fault.path.endswith(MANIFEST):
            relisted = True
        else:
            why = (
                ", imported maps have no recipe: delete it and import again"
                if manifest.spec is None
                else ""
            )
            left.append(replace(fault, what=f"{fault.what}; it cannot be made again{why}"))
    said = {entry.name: entry.content_hash for entry in manifest.shards}
    made = []
    with (
        bar(progress, sum(header.stop - header.start for header in again)) as advance,
        threads() as pool,
    ):
        for header, entry in finished(pool, partial(make_shard, root, anew=True), again, 2 * CORES):
            made.append(entry)
            if said.get(entry.name, entry.content_hash) != entry.content_hash:
                before = said[entry.name]
                what = (
                    f"made again with content hash {entry.content_hash}, the manifest said {before}"
                )
                left.append(Corruption(str(root / entry.name), what, header))
            advance(header.stop - header.start)
    repaired = replace(manifest, shards=(*manifest.shards, *made))
    if relisted:
        shards = {entry.start: entry for entry in repaired.shards}
        repaired = replace(repaired, shards=tuple(shards[start] for start in sorted(shards)))
        write_file(root / MANIFEST, repaired.to_json().encode())
    elif made:
        merge(root, repaired)
    return left


def _check_shards(place: str, manifest: Manifest, listed: bool, progress: bool) -> list[Corruption]:
    """Check the shards that a manifest lists, and which it should list; without ``listed`` it lists
    the sound ones.
    """
    planned = {(header.start, header.stop): header for header in headers(manifest)}
    tasks: list[tuple[Entry, Header | None]] = []
    for entry in manifest.shards:
        header = planned.pop((entry.start, entry.stop), None) or _partial(entry, planned.values())
        tasks.append((entry, header))
    faults = []
    with (
        bar(progress, sum(entry.stop - entry.start for entry in manifest.shards)) as advance,
        threads() as pool,
    ):
        for (entry, header), what in finished(pool, partial(_fault, place), tasks, 2 * CORES):
            if what:
                faults.append(Corruption(f"{place}/{entry.name}", what, header))
            advance(entry.stop - entry.start)
    faults.sort(key=lambda fault: fault.path)
    for limits, header in planned.items():
        path = f"{place}/{shard_name(*limits)}"
        unlisted = "damaged" if os.path.exists(path) else "missing"
        faults.append(
            Corruption(path, "missing (the build did not finish)" if listed else unlisted, header)
        )
    return faults


def _gather(root: Path, shards: Sequence[Path]) -> Manifest | None:
    """Return what most shards say they are a part of, with the sound ones; None if none can be
    read.
    """
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
    stated = re.search(
        rb'"shard_size": (\d{1,9})\b', text
    )  # believed where it fits: a last shard may be a smaller one
    sizes = [int(stated[1]), largest] if stated else [largest]
    fits = [
        size for size in sizes if size >= largest and not any(start % size for start, _ in limits)
    ]
    if not fits or maps > MOST_SHARDS * fits[0]:
        return None
    manifest = Manifest(**header.origin(), maps=maps, shard_size=fits[0])
    return replace(
        manifest, shards=tuple(filter(None, (load_shard(root, one) for one in headers(manifest))))
    )


def _provenance(place: str) -> list[Corruption]:
    """Check the file that says where imported maps came from."""
    path = f"{place}/{PROVENANCE}"
    try:
        text = read_file(place, PROVENANCE).decode()
        values = json.loads(text)
        del values["hash"]
        return (
            []
            if text == provenance_text(values)
            else [Corruption(path, "damaged (its hash does not fit)")]
        )
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


def _fault(place: str, task: tuple[Entry, Header | None]) -> str | None:
    """Return what is wrong with one shard file, or None."""
    entry, header = task
    if header is None:
        return "not a shard of this dataset"
    try:
        path = local_file(place, entry)
        if (size := path.stat().st_size) != entry.bytes:
            return f"has {size} bytes, the manifest says {entry.bytes}"
        if file_hash(path) != entry.sha256:
            return "damaged (its file hash does not fit)"
        shard = open_shard(path, entry.bytes)
    except DatasetNotFoundError as error:
        return error.why
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
