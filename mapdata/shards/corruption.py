"""Finding corrupt files of a dataset, and repairing them.

A shard that is damaged or missing is made again from the recipe, a manifest from the shards.
"""

from __future__ import annotations

import json
import os
import re
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from mapdata.generators.generator import MapGenerator, UnknownFamily, why_unknown
from mapdata.shards.arrays import decode
from mapdata.shards.builder import headers, make_shard
from mapdata.shards.content import content_hash
from mapdata.shards.errors import REPAIRS, DatasetNotFoundError, ShardError
from mapdata.shards.files import StrPath, write_file
from mapdata.shards.header import Header, Span, is_shard_name, limits_of
from mapdata.shards.image import shard_image
from mapdata.shards.manifest import (
    MANIFEST,
    MOST_SHARDS,
    PROVENANCE,
    Entry,
    Manifest,
    counts_of,
    entry_of,
    path_in,
    provenance_text,
)
from mapdata.shards.merging import checked_entry, is_known, load_shard, merge, union
from mapdata.shards.reader import UNSOUND, map_shard, sound_labels
from mapdata.shards.remote import is_url
from mapdata.shards.root import (
    Places,
    file_hash,
    folder_of,
    local_file,
    manifest_at,
    places,
    read_file,
)
from mapdata.shards.workers import bar, finished, threads

_STRANGE = "no file of this dataset: keep it elsewhere"

_REPLACED = "replaced by a shard of more maps: the next build removes it"


def _unlisted(spec: MapGenerator | None) -> str:
    """Return what is said of a sound shard that a build or import left before it was listed."""
    command = "import" if spec is None else "build"
    return f"finished, not listed yet: {command} again"


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

    @property
    def unchecked(self) -> str | None:
        """What could not be checked, and why, on one line; None if all was."""
        spec = None if self.manifest is None else self.manifest.spec
        if not isinstance(spec, UnknownFamily):
            return None
        return (
            f"{self.place}: the parameters of its recipe were not checked, since "
            f"{why_unknown(spec.name)}"
        )


def verify(root: Places, *, progress: bool = False) -> list[str]:
    """Return what is wrong with a dataset, one line per fault; an empty list if nothing is.

    Every file is checked and hashed, and its content hash is computed again. Of a family of maps
    whose module is not imported all is checked but the family's own parameters, and a warning says
    so.

    Args:
        root: folder or URL of a dataset, or several.
        progress: show a progress bar.

    Raises:
        DatasetNotFoundError: there is no dataset under ``root``.
    """
    faults = []
    for place in places(root):
        findings = inspect(place, progress=progress)
        faults += [str(fault) for fault in findings.faults]
        if findings.unchecked:
            warnings.warn(findings.unchecked, stacklevel=2)
    return faults


def repair(root: Places, *, progress: bool = False) -> list[str]:
    """Make again what `verify` finds damaged or missing; return the faults that are left.

    Imported maps have no recipe, so their shards cannot be made again; those of a family can where
    its module is imported.

    Args:
        root: folder of a dataset, or several.
        progress: show a progress bar.

    Raises:
        DatasetNotFoundError: there is no dataset under ``root``.
        ValueError: it lies at a URL.
        OSError: the disk is full or may not be written to.
    """
    folders = [folder_of(place) for place in places(root)]  # a URL is refused before any repair
    return [
        str(fault)
        for folder in folders
        for fault in repair_found(inspect(folder, progress=progress), progress=progress)
    ]


def inspect(place: StrPath, *, progress: bool = False) -> Inspection:
    """Check every file of the dataset of one folder or URL.

    Raises:
        DatasetNotFoundError: there is no dataset.
    """
    (place,) = places(place)
    try:
        manifest = manifest_at(place)
    except (ShardError, DatasetNotFoundError) as error:
        return _inspect_unlisted(place, error, progress)
    faults = []
    # the hash inside the manifest is of its values, so its text is checked too
    text = read_file(place, MANIFEST)
    if text != f"{json.dumps(json.loads(text), indent=1)}\n".encode():
        what = "damaged (its text is not as it was written)"
        faults.append(Corruption(f"{place}/{MANIFEST}", what))
    faults += _check_files(place, manifest, True, progress)
    return Inspection(place, manifest, tuple(faults))


def _inspect_unlisted(place: str, error: OSError | ShardError, progress: bool) -> Inspection:
    """Check a dataset whose manifest could not be read, which ``error`` says, by its shards alone.

    Raises:
        DatasetNotFoundError: it has no manifest and no shards.
    """
    shards = [path for path in sorted(Path(place).glob("maps-*.h5")) if is_shard_name(path.name)]
    missing = isinstance(error, DatasetNotFoundError)
    if missing and not shards:
        raise error
    faults = [Corruption(f"{place}/{MANIFEST}", "missing" if missing else str(error))]
    manifest = _gather(Path(place), shards, progress)
    if manifest is None:
        faults += [Corruption(str(path), "damaged, or its place is lost") for path in shards]
    else:
        faults += _check_files(place, manifest, False, progress)
    return Inspection(place, manifest, tuple(faults))


def repair_found(findings: Inspection, *, progress: bool = False) -> list[Corruption]:
    """Make again what can be made; return what is still wrong.

    Raises:
        ValueError: the dataset lies at a URL.
        OSError: the disk is full or may not be written to.
    """
    root = folder_of(findings.place)
    manifest = findings.manifest
    if manifest is None:
        why = "no sound shard says what it was: delete it and run the same build again"
        return [replace(fault, what=f"{fault.what}; {why}") for fault in findings.faults]
    left = []
    again = {}  # faults of shards by header
    relisted = False
    for fault in findings.faults:
        spec = None if fault.header is None else fault.header.spec
        if isinstance(spec, UnknownFamily):
            what = f"{fault.what}; it cannot be made again: {why_unknown(spec.name)}"
            left.append(replace(fault, what=what))
        elif fault.header is not None:
            again[fault.header] = fault
        elif fault.path.endswith(MANIFEST):
            relisted = True
        elif fault.path.endswith(PROVENANCE):
            left.append(_import_again(fault))
        else:
            left.append(fault)
    stated = {entry.name: entry.content_hash for entry in manifest.shards}
    unlisted = _unlisted(manifest.spec)
    damaged = {header.limits for header, fault in again.items() if fault.what != unlisted}
    made = []
    with bar(progress, sum(header.maps for header in again)) as advance, threads() as pool:
        make = partial(_make_again, root, stated, damaged)
        for header, entry in finished(pool, make, again):
            if entry is None:
                left.append(_import_again(again[header]))
                continue
            before = stated.get(entry.name, entry.content_hash)
            if entry.content_hash != before:
                what = (
                    f"made again with content hash {entry.content_hash}, the manifest said {before}"
                )
                left.append(Corruption(str(root / entry.name), what, header))
            else:  # the manifest keeps what it said of the others
                made.append(entry)
            advance(header.maps)
    repaired = replace(manifest, shards=tuple(made))
    if relisted:
        # not merged, since the manifest on disk cannot be read
        write_file(root / MANIFEST, union(repaired, manifest).to_json().encode())
    elif made:
        merge(root, repaired)
    return left


def _make_again(
    root: Path, stated: Mapping[str, str], damaged: Set[Span], header: Header
) -> Entry | None:
    """Make a shard from its recipe, or write imported maps anew where the file still holds them.

    Args:
        root: folder of the dataset.
        stated: content hash of the shards that the manifest lists, by name.
        damaged: (start, stop) of the shards that may not be kept as they are.
        header: of the shard.

    Returns:
        The entry of the new shard; None if imported maps are lost.
    """
    if header.spec is not None:
        return make_shard(root, header, damaged=damaged)
    if header.limits not in damaged:
        return load_shard(root, header)
    try:
        path = path_in(root, header.file_name)
        shard = map_shard(path).shard
        labels = sound_labels(shard)
    except (OSError, ShardError):
        return None
    expected = stated.get(header.file_name, shard.content_hash)
    if (shard.header, shard.content_hash) != (header, expected):
        return None
    image, content = shard_image(labels, header)
    write_file(path, image)
    return entry_of(header, content, labels, image)


def _import_again(fault: Corruption) -> Corruption:
    """Return the fault of a file of imported maps that is left after a repair."""
    what = fault.what.removesuffix(f"; {REPAIRS}")
    why = "it cannot be made again, imported maps have no recipe: delete it and import again"
    return replace(fault, what=f"{what}; {why}")


def _check_files(place: str, manifest: Manifest, listed: bool, progress: bool) -> list[Corruption]:
    """Check the shards that a manifest lists, name those that it should list, check an import.

    Without ``listed`` the manifest was gathered from the sound shards.
    """
    faults = _check_provenance(place) if manifest.spec is None else []
    with bar(progress, manifest.done) as advance, threads() as pool:
        check = partial(_fault, place, manifest)
        for entry, what in finished(pool, check, manifest.shards):
            if what:
                header = manifest.header(*entry.limits)
                faults.append(Corruption(f"{place}/{entry.name}", what, header))
            advance(entry.maps)
    faults.sort(key=lambda fault: fault.path)
    names = {entry.name for entry in manifest.shards}
    for header in headers(manifest):
        name = header.file_name
        if name not in names:
            names.add(name)
            what = "missing (the build did not finish)" if listed else "missing"
            if not is_url(place) and os.path.lexists(Path(place) / name):
                what = _why_unlisted(Path(place), header)
            faults.append(Corruption(f"{place}/{name}", what, header))
    if not is_url(place):
        # what hides is other programs'; folders may be other datasets
        for path in sorted(Path(place).iterdir()):
            name = path.name
            is_hidden = name.startswith(".") and not name.endswith(".tmp")
            is_listed = name in names or (is_known(name) and not is_shard_name(name))
            if not (is_hidden or is_listed or path.is_dir()):
                faults.append(Corruption(str(path), _why_strange(manifest, path)))
    return faults


def _why_unlisted(root: Path, header: Header) -> str:
    """Return why the shard of ``header``, whose file is there, is not listed."""
    try:
        checked_entry(root, header)
    except (OSError, ShardError) as error:
        return str(error)
    return _unlisted(header.spec)


def _why_strange(manifest: Manifest, path: Path) -> str:
    """Return what is said of a file that the plan of a dataset does not name."""
    if is_shard_name(path.name):
        start, stop = limits_of(path)
        fits = start % manifest.shard_size == 0 and 0 < stop - start <= manifest.shard_size
        # A build that makes the dataset larger lists its shards after it has made some.
        if fits and load_shard(path.parent, manifest.header(start, stop)) is not None:
            longer = any(entry.start == start and stop < entry.stop for entry in manifest.shards)
            return _REPLACED if longer else _unlisted(manifest.spec)
    return _STRANGE


def _gather(root: Path, shards: Sequence[Path], progress: bool) -> Manifest | None:
    """Return the manifest of the dataset that most shards are of, with the sound ones; or None."""
    found = {}
    with bar(progress, len(shards), unit=" shards") as advance:
        for path in shards:
            with suppress(OSError, ShardError):
                header = map_shard(path_in(root, path.name)).shard.header
                found[header] = load_shard(root, header)
            advance(1)
    if not found:
        return None
    # all shards of a dataset have one header but for their limits
    votes = Counter(replace(header, start=0, stop=0) for header in found)
    ((header, _),) = votes.most_common(1)
    limits = [limits_of(path) for path in shards]
    maps = max(stop for _, stop in limits)
    # A build takes 1,000 maps by default. An import takes less of large ones: its shard that is
    # alone is taken for a whole one.
    size = _shard_size(root, limits, 1000 if header.spec else maps)
    if size is None or maps > MOST_SHARDS * size:
        return None
    manifest = Manifest(**header.origin(), maps=maps, shard_size=size)
    sound = filter(None, map(found.get, headers(manifest)))
    return replace(manifest, shards=tuple(sound))


def _shard_size(root: Path, limits: Sequence[Span], default: int) -> int | None:
    """Return the shard size of a dataset with shards of these limits, or None if none fits."""
    sizes = [max(stop - start for start, stop in limits)]
    if limits == [(0, sizes[0])]:
        sizes.insert(0, default)  # a shard that is alone may be a partial one
    # what a damaged manifest still says comes first
    with suppress(OSError, ShardError), open(path_in(root, MANIFEST), "rb") as file:
        # it stands before the list of shards
        stated = re.search(rb'"shard_size": (\d{1,9})\b', file.read(2**20))
        if stated:
            sizes.insert(0, int(stated[1]))
    for size in sizes:
        if size >= sizes[-1] and all(start % size == 0 for start, _ in limits):
            return size
    return None


def _check_provenance(place: str) -> list[Corruption]:
    """Check the file that says where imported maps came from."""
    try:
        text = read_file(place, PROVENANCE).decode()
        values = json.loads(text)
        del values["hash"]
        if text == provenance_text(values):
            return []
        what = "damaged (its hash does not fit)"
    except FileNotFoundError:
        what = "missing"
    except (PermissionError, *UNSOUND) as error:
        what = f"damaged ({error})"
    return [Corruption(f"{place}/{PROVENANCE}", what)]


def _fault(place: str, manifest: Manifest, entry: Entry) -> str | None:
    """Return what is wrong with one shard file, or None."""
    try:
        path = local_file(place, entry)
        shard = map_shard(path, entry.bytes).shard
        if file_hash(path) != entry.sha256:
            return "damaged (its file hash does not fit)"
    except DatasetNotFoundError as error:
        return error.why
    except FileNotFoundError:
        return "missing"
    except PermissionError as error:
        return f"cannot be read ({error})"
    except ShardError as error:
        return str(error)
    # a partial last shard may not be replaced by the planned one yet
    if shard.header != manifest.header(*entry.limits):
        return "holds other maps than the manifest says"
    labels = decode(shard)
    if not content_hash(labels) == shard.content_hash == entry.content_hash:
        return "damaged (its content hash does not fit)"
    if counts_of(labels) != entry.counts:
        return "the manifest counts other problems than it holds"
    return None
