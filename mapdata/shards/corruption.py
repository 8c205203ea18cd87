"""Finding damaged and missing files of a dataset, and repairing them.

A shard is built again from the recipe of its dataset, a manifest from the shards.
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

from mapdata.generators.generator import MapGenerator
from mapdata.generators.stored_families import unknown_family, why_not_drawn
from mapdata.shards.arrays import decode
from mapdata.shards.builder import build_shard, planned_headers
from mapdata.shards.content import content_hash
from mapdata.shards.dataset_files import load_manifest, local_shard_path, read_dataset_file
from mapdata.shards.errors import (
    LINK_REMEDY,
    REPAIRS,
    UNSOUND,
    DatasetNotFoundError,
    LinkError,
    ShardError,
)
from mapdata.shards.files import StrPath, file_hash, write_file
from mapdata.shards.header import Header, Span, is_shard_name, limits_of
from mapdata.shards.image import shard_image
from mapdata.shards.locations import Locations, is_url, locations, target_folder
from mapdata.shards.manifest import (
    MANIFEST,
    MAX_SHARDS,
    PROVENANCE,
    Entry,
    Manifest,
    counts_of,
    entry_of,
    path_in,
    provenance_text,
)
from mapdata.shards.merging import (
    checked_entry,
    is_growing,
    is_known,
    load_shard,
    merge,
    sweep,
    union,
)
from mapdata.shards.reader import check_terrain, map_shard, sound_labels
from mapdata.shards.workers import bar, completed, thread_pool

_NOT_OURS = "no file of this dataset: keep it elsewhere"

_NOT_FINISHED = "missing (the build did not finish)"

_REPLACED = "replaced by a shard of more maps: the next build or repair removes it"


def _unlisted_text(generator: MapGenerator | None) -> str:
    """Return the description of a sound shard that a build or import left before it was listed."""
    command = "import" if generator is None else "build"
    return f"finished, not listed yet: {command} again"


@dataclass(frozen=True)
class Corruption:
    """One file that is not as it should be.

    Attributes:
        path: the file, or its URL.
        description: what is wrong with it.
        header: header of the shard that the file should be; None if it should be no shard.
    """

    path: str
    description: str
    header: Header | None = None

    def __str__(self) -> str:
        """Return one line."""
        if self.path in self.description:
            return self.description
        return f"{self.path}: {self.description}"


@dataclass(frozen=True)
class Inspection:
    """What is wrong with one dataset.

    Attributes:
        location: its folder or URL.
        manifest: its manifest. If that is damaged, a manifest that was gathered from the sound
            shards; None if there is none.
        faults: in the order of the maps. While a process adds shards, those that it has not listed
            or not finished yet are no faults.
        growing: what a running build or import has finished so far, on one line; None if none runs.
        follow_links: whether files were read that are links out of the folder.
    """

    location: str
    manifest: Manifest | None
    faults: tuple[Corruption, ...]
    growing: str | None = None
    follow_links: bool = False

    @property
    def unchecked(self) -> str | None:
        """What could not be checked, and why, on one line; None if everything was checked."""
        unknown = None if self.manifest is None else unknown_family(self.manifest.generator)
        if unknown is None:
            return None
        return (
            f"{self.location}: the parameters of its recipe were not checked, since "
            f"{why_not_drawn(unknown)}"
        )

    @property
    def notes(self) -> list[str]:
        """What a user should know although it is no fault, a line each."""
        return [note for note in (self.unchecked, self.growing) if note is not None]


def verify(root: Locations, *, follow_links: bool = False, progress: bool = False) -> list[str]:
    """Return what is wrong with a dataset, one line per fault; an empty list if nothing is.

    Every file is checked and hashed, and its content hash is computed again. If the maps are of a
    family whose module is not imported, all is checked but the family's own parameters, and a
    warning says so. While a build or import of the dataset is running, what it has finished is
    checked, and a warning says how much that is.

    Args:
        root: folder or URL of a dataset, or several.
        follow_links: read files that are links out of their folder.
        progress: show a progress bar.

    Raises:
        DatasetNotFoundError: there is no dataset under ``root``.
    """
    faults = []
    for location in locations(root):
        inspection = inspect(location, follow_links=follow_links, progress=progress)
        faults += [str(fault) for fault in inspection.faults]
        for note in inspection.notes:
            warnings.warn(note, stacklevel=2)
    return faults


def repair(root: Locations, *, follow_links: bool = False, progress: bool = False) -> list[str]:
    """Repair what `verify` finds damaged or missing; return the faults that remain.

    Temporary files of killed writers, and shards that were replaced by longer ones, are removed.
    Imported maps have no recipe, so their shards cannot be built again. Maps of a family can be
    built again if its module is imported.

    Args:
        root: folder of a dataset, or several.
        follow_links: read files that are links out of their folder. The link of a file that is
            repaired, and of the manifest, is replaced by a file; what it leads to stays as it is.
        progress: show a progress bar.

    Raises:
        DatasetNotFoundError: there is no dataset under ``root``.
        ValueError: it lies at a URL.
        OSError: the disk is full, or the folder may not be written to.
    """
    # All locations are checked first, so that a URL is refused before anything is repaired.
    folders = [target_folder(location) for location in locations(root)]
    remaining = []
    for folder in folders:
        inspection = inspect(folder, follow_links=follow_links, progress=progress)
        remaining += [str(fault) for fault in repair_faults(inspection, progress=progress)]
    return remaining


def inspect(location: StrPath, *, follow_links: bool = False, progress: bool = False) -> Inspection:
    """Check every file of the dataset of one folder or URL.

    Args:
        location: the folder or URL.
        follow_links: read files that are links out of the folder.
        progress: show a progress bar.

    Raises:
        DatasetNotFoundError: there is no dataset.
    """
    (location,) = locations(location)
    was_growing = not is_url(location) and is_growing(Path(location))
    inspection = _inspect(location, follow_links, progress)
    # A build may have begun, or ended, during the inspection.
    if was_growing or (not is_url(location) and is_growing(Path(location))):
        return _without_unfinished(inspection)
    return inspection


def _without_unfinished(inspection: Inspection) -> Inspection:
    """Return an inspection without the faults that the end of a running build or import mends.

    Shards that were finished or replaced meanwhile are no faults either.
    """
    location = inspection.location
    manifest = inspection.manifest
    if manifest is None:
        return inspection
    with suppress(ShardError, DatasetNotFoundError):  # It stays a fault.
        manifest = load_manifest(location, inspection.follow_links)
    stop_by_start = {entry.start: entry.stop for entry in manifest.shards}

    def is_replaced(header: Header | None) -> bool:
        return header is not None and stop_by_start.get(header.start, 0) > header.stop

    passing = (_NOT_FINISHED, _REPLACED, _unlisted_text(manifest.generator))
    faults = tuple(
        fault
        for fault in inspection.faults
        if fault.description not in passing and not is_replaced(fault.header)
    )
    planned = planned_headers(manifest)
    finished = sum((Path(location) / header.file_name).exists() for header in planned)
    growing = (
        f"{location}: a build or import is running, {finished:,} of {len(planned):,} shards are "
        "finished; verify again when it has ended"
    )
    return replace(inspection, manifest=manifest, faults=faults, growing=growing)


def _inspect(location: str, follow_links: bool, progress: bool) -> Inspection:
    """Check every file of a dataset, as if nothing else were running; see `inspect`."""
    try:
        manifest = load_manifest(location, follow_links)
    except LinkError as error:
        # The shards are probably links as well. Sound shards in the folder say what it was.
        inspection = _inspect_without_manifest(location, error, follow_links, progress)
        if inspection.manifest is not None:
            return inspection
        fault = Corruption(f"{location}/{MANIFEST}", str(error))
        return Inspection(location, None, (fault,))
    except (ShardError, DatasetNotFoundError) as error:
        return _inspect_without_manifest(location, error, follow_links, progress)
    faults = []
    # The hash inside the manifest covers its values but not their layout, so the text is compared.
    text = read_dataset_file(location, MANIFEST, follow_links)
    if text != f"{json.dumps(json.loads(text), indent=1)}\n".encode():
        description = "damaged (its text is not as it was written)"
        faults.append(Corruption(f"{location}/{MANIFEST}", description))
    faults += _check_files(
        location, manifest, is_listed=True, follow_links=follow_links, progress=progress
    )
    return Inspection(location, manifest, tuple(faults), follow_links=follow_links)


def _inspect_without_manifest(
    location: str, error: OSError | ShardError, follow_links: bool, progress: bool
) -> Inspection:
    """Check a dataset by its shards alone, because reading its manifest raised ``error``.

    Raises:
        DatasetNotFoundError: it has no manifest and no shards.
    """
    paths = [path for path in sorted(Path(location).glob("maps-*.h5")) if is_shard_name(path.name)]
    is_missing = isinstance(error, DatasetNotFoundError)
    if is_missing and not paths:
        raise error
    faults = [Corruption(f"{location}/{MANIFEST}", "missing" if is_missing else str(error))]
    manifest = _gather_manifest(Path(location), paths, follow_links, progress)
    if manifest is None:
        faults += [Corruption(str(path), "damaged, or its place is lost") for path in paths]
    else:
        faults += _check_files(
            location, manifest, is_listed=False, follow_links=follow_links, progress=progress
        )
    return Inspection(location, manifest, tuple(faults), follow_links=follow_links)


def repair_faults(inspection: Inspection, *, progress: bool = False) -> list[Corruption]:
    """Repair the files that can be repaired; return the faults that remain.

    What killed writers left is removed, also if nothing has a fault.

    Raises:
        ValueError: the dataset lies at a URL.
        OSError: the disk is full, or the folder may not be written to.
    """
    root = target_folder(inspection.location)
    manifest = inspection.manifest
    if manifest is None and all(LINK_REMEDY in fault.description for fault in inspection.faults):
        return list(inspection.faults)
    if manifest is None:
        hint = "no sound shard says what it was: delete it and run the same build again"
        return [
            replace(fault, description=f"{fault.description}; {hint}")
            for fault in inspection.faults
        ]
    remaining = []
    repairable: dict[Header, Corruption] = {}
    manifest_is_damaged = False
    for fault in inspection.faults:
        unknown = None if fault.header is None else unknown_family(fault.header.generator)
        if unknown is not None:
            hint = f"it cannot be made again: {why_not_drawn(unknown)}"
            remaining.append(replace(fault, description=f"{fault.description}; {hint}"))
        elif fault.header is not None:
            repairable[fault.header] = fault
        elif fault.path.endswith(MANIFEST):
            manifest_is_damaged = True
        elif fault.path.endswith(PROVENANCE):
            remaining.append(_ask_for_import(fault))
        elif fault.description == _REPLACED:
            continue  # `sweep` removes it.
        else:
            remaining.append(fault)
    follow_links = inspection.follow_links
    repaired_entries, shard_faults = _repair_shards(
        root, manifest, repairable, follow_links, progress
    )
    remaining += shard_faults
    # The manifest keeps the entries of the shards that were not repaired.
    repaired = replace(manifest, shards=tuple(repaired_entries))
    if manifest_is_damaged:
        # This is not merged, since the manifest on disk cannot be read.
        write_file(root / MANIFEST, union(repaired, manifest).to_json().encode())
    elif repaired_entries:
        merge(root, repaired, follow_links=follow_links)
    if os.access(root, os.W_OK):
        # A shard is removed only if the longer one that replaces it is sound.
        unsound = {fault.path for fault in remaining}
        sound = tuple(entry for entry in manifest.shards if str(root / entry.name) not in unsound)
        sweep(root, replace(manifest, shards=sound))
    return remaining


def _repair_shards(
    root: Path,
    manifest: Manifest,
    faults: Mapping[Header, Corruption],
    follow_links: bool,
    progress: bool,
) -> tuple[list[Entry], list[Corruption]]:
    """Replace the shards that have ``faults``.

    Returns:
        The entries of the repaired shards, and the faults that remain.
    """
    stated_hashes = {entry.name: entry.content_hash for entry in manifest.shards}
    unlisted = _unlisted_text(manifest.generator)
    # The file of a shard that is only not listed is sound, and is kept.
    damaged = {header.limits for header, fault in faults.items() if fault.description != unlisted}
    entries = []
    remaining = []
    map_count = sum(header.maps for header in faults)
    with bar(progress, map_count) as advance, thread_pool() as pool:
        repair_header = partial(_repair_shard, root, stated_hashes, damaged, follow_links)
        for header, entry in completed(pool, repair_header, faults):
            if entry is None:
                remaining.append(_ask_for_import(faults[header]))
                continue
            stated_hash = stated_hashes.get(entry.name, entry.content_hash)
            if entry.content_hash == stated_hash:
                entries.append(entry)
            else:
                description = (
                    f"made again with content hash {entry.content_hash}, the manifest said "
                    f"{stated_hash}"
                )
                remaining.append(Corruption(str(root / entry.name), description, header))
            advance(header.maps)
    return entries, remaining


def _repair_shard(
    root: Path,
    stated_hashes: Mapping[str, str],
    damaged: Set[Span],
    follow_links: bool,
    header: Header,
) -> Entry | None:
    """Build a shard from its recipe, or rewrite imported maps if the file still holds them.

    The manifest states the content hashes, by name; the files of ``damaged`` shards may not be kept
    as they are. Return the entry of the new shard, or None if imported maps are lost.
    """
    if header.generator is not None:
        return build_shard(root, header, damaged=damaged, follow_links=follow_links)
    if header.limits not in damaged:
        return load_shard(root, header, follow_links)
    try:
        path = path_in(root, header.file_name, follow_links)
        shard = map_shard(path).shard
        labels = sound_labels(shard)
    except (OSError, ShardError):
        return None
    expected_hash = stated_hashes.get(header.file_name, shard.content_hash)
    if shard.header != header or shard.content_hash != expected_hash:
        return None
    image, content = shard_image(labels, header)
    write_file(path, image)
    return entry_of(header, content, labels, image)


def _ask_for_import(fault: Corruption) -> Corruption:
    """Return the fault of a file of imported maps with the advice to import the maps again."""
    description = fault.description.removesuffix(f"; {REPAIRS}")
    hint = "it cannot be made again, imported maps have no recipe: delete it and import again"
    return replace(fault, description=f"{description}; {hint}")


def _check_files(
    location: str, manifest: Manifest, *, is_listed: bool, follow_links: bool, progress: bool
) -> list[Corruption]:
    """Return the faults of all files of a dataset but its manifest.

    Unless ``manifest`` ``is_listed``, on disk, it was gathered from the sound shards, which does
    not tell a lost shard from one that was never built.
    """
    faults = _check_provenance(location, follow_links) if manifest.generator is None else []
    faults += _check_listed_shards(location, manifest, follow_links, progress)
    faults += _check_planned_shards(location, manifest, is_listed, follow_links)
    if not is_url(location):
        faults += _check_folder(Path(location), manifest, follow_links)
    return faults


def _check_listed_shards(
    location: str, manifest: Manifest, follow_links: bool, progress: bool
) -> list[Corruption]:
    """Return the faults of the shards that the manifest lists, in the order of their maps."""
    faults = []
    with bar(progress, manifest.done) as advance, thread_pool() as pool:
        check = partial(_shard_fault, location, manifest, follow_links)
        for entry, description in completed(pool, check, manifest.shards):
            if description:
                header = manifest.header(*entry.limits)
                faults.append(Corruption(f"{location}/{entry.name}", description, header))
            advance(entry.maps)
    return sorted(faults, key=lambda fault: fault.path)


def _check_planned_shards(
    location: str, manifest: Manifest, is_listed: bool, follow_links: bool
) -> list[Corruption]:
    """Return a fault for each shard that is planned but not listed; as `_check_files`."""
    listed_names = {entry.name for entry in manifest.shards}
    missing = _NOT_FINISHED if is_listed else "missing"
    faults = []
    for header in planned_headers(manifest):
        name = header.file_name
        if name not in listed_names:
            has_file = not is_url(location) and os.path.lexists(Path(location) / name)
            description = missing
            if has_file:
                description = _why_unlisted(Path(location), header, follow_links)
            faults.append(Corruption(f"{location}/{name}", description, header))
    return faults


def _check_folder(folder: Path, manifest: Manifest, follow_links: bool) -> list[Corruption]:
    """Return the files of a folder that do not belong to the dataset.

    Hidden files are those of other programs, and folders may be other datasets: both are skipped.
    """
    shard_names = {entry.name for entry in manifest.shards}
    shard_names |= {header.file_name for header in planned_headers(manifest)}
    faults = []
    for path in sorted(folder.iterdir()):
        name = path.name
        is_hidden = name.startswith(".") and not name.endswith(".tmp")
        belongs = name in shard_names or (is_known(name) and not is_shard_name(name))
        if not (is_hidden or belongs or path.is_dir()):
            faults.append(Corruption(str(path), _why_unplanned(manifest, path, follow_links)))
    return faults


def _why_unlisted(root: Path, header: Header, follow_links: bool) -> str:
    """Return why the manifest does not list the shard of ``header``, although its file exists."""
    try:
        checked_entry(root, header, follow_links)
    except (OSError, ShardError) as error:
        return str(error)
    return _unlisted_text(header.generator)


def _why_unplanned(manifest: Manifest, path: Path, follow_links: bool) -> str:
    """Return the description of a file that the manifest of its dataset does not plan."""
    if is_shard_name(path.name):
        start, stop = limits_of(path)
        fits_plan = start % manifest.shard_size == 0 and 0 < stop - start <= manifest.shard_size
        # A build that extends the dataset lists its shards only after it has built some.
        header = manifest.header(start, stop)
        if fits_plan and load_shard(path.parent, header, follow_links) is not None:
            is_replaced = any(
                entry.start == start and stop < entry.stop for entry in manifest.shards
            )
            return _REPLACED if is_replaced else _unlisted_text(manifest.generator)
    return _NOT_OURS


def _gather_manifest(
    root: Path, paths: Sequence[Path], follow_links: bool, progress: bool
) -> Manifest | None:
    """Return a manifest of the sound shards among ``paths``.

    The dataset is the one that most shards belong to. Return None if no header can be read, or if
    the names of the files fit no shard size.
    """
    entries: dict[Header, Entry | None] = {}  # None where the arrays are damaged
    with bar(progress, len(paths), unit=" shards") as advance:
        for path in paths:
            with suppress(OSError, ShardError):
                header = map_shard(path_in(root, path.name, follow_links)).shard.header
                entries[header] = load_shard(root, header, follow_links)
            advance(1)
    if not entries:
        return None
    # All shards of a dataset have the same header, except for their limits.
    votes = Counter(replace(header, start=0, stop=0) for header in entries)
    ((common_header, _),) = votes.most_common(1)
    spans = [limits_of(path) for path in paths]
    maps = max(stop for _, stop in spans)
    # A build takes shards of 1,000 maps by default. An import takes smaller ones for large maps,
    # so its only shard is assumed to be a whole one.
    default_size = maps if common_header.generator is None else 1000
    shard_size = _guess_shard_size(root, spans, default_size, follow_links)
    if shard_size is None or maps > MAX_SHARDS * shard_size:
        return None
    manifest = Manifest(**common_header.origin(), maps=maps, shard_size=shard_size)
    planned_entries = [entries.get(header) for header in planned_headers(manifest)]
    sound_entries = tuple(entry for entry in planned_entries if entry is not None)
    return replace(manifest, shards=sound_entries)


def _guess_shard_size(
    root: Path, spans: Sequence[Span], default: int, follow_links: bool
) -> int | None:
    """Return the shard size of a dataset with shards of these sorted spans, or None if none fits.

    ``default`` is assumed if the only shard may be a partial one.
    """
    largest = max(stop - start for start, stop in spans)
    candidates = []
    with (
        suppress(OSError, ShardError),
        open(path_in(root, MANIFEST, follow_links), "rb") as file,
    ):
        # A damaged manifest may still state the size, which stands before the list of shards.
        stated = re.search(rb'"shard_size": (\d{1,9})\b', file.read(2**20))
        if stated:
            candidates.append(int(stated[1]))
    if list(spans) == [(0, largest)]:
        candidates.append(default)
    candidates.append(largest)
    for size in candidates:
        if size >= largest and all(start % size == 0 for start, _ in spans):
            return size
    return None


def _check_provenance(location: str, follow_links: bool) -> list[Corruption]:
    """Return the fault, if any, of the file that says where imported maps came from."""
    try:
        text = read_dataset_file(location, PROVENANCE, follow_links).decode()
        origin = json.loads(text)
        del origin["hash"]
        if text == provenance_text(origin):
            return []
        description = "damaged (its hash does not fit)"
    except FileNotFoundError:
        description = "missing"
    except LinkError as error:
        description = str(error)
    except (PermissionError, *UNSOUND) as error:
        description = f"damaged ({error})"
    return [Corruption(f"{location}/{PROVENANCE}", description)]


def _shard_fault(location: str, manifest: Manifest, follow_links: bool, entry: Entry) -> str | None:
    """Return what is wrong with the file of one listed shard, or None."""
    try:
        path = local_shard_path(location, entry, follow_links)
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
    # The header is that of the entry and not of the plan: a partial last shard may still be there
    # when the plan has a longer one.
    if shard.header != manifest.header(*entry.limits):
        return "holds other maps than the manifest says"
    labels = decode(shard)
    if not content_hash(labels) == shard.content_hash == entry.content_hash:
        return "damaged (its content hash does not fit)"
    try:
        check_terrain(labels.maps, str(path))
    except ShardError as error:
        return str(error)
    if counts_of(labels) != entry.counts:
        return "the manifest counts other problems than it holds"
    return None
