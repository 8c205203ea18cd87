"""The manifest of a dataset: the list of its shards, and the properties that they share.

Everything in it is derived from the shards, so it can be rebuilt.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mapdata.arrays import Flags, Ints
from mapdata.checks import check_count, check_integers, check_number, check_seed
from mapdata.generators.stored_families import stored_generator, unknown_family
from mapdata.hashing import is_sha256_hex, json_hash, sha256_hex
from mapdata.limits import SPLITS, TERRAIN_VERSION
from mapdata.movement import Movement
from mapdata.search.labels import Labels
from mapdata.shards.content import combine
from mapdata.shards.errors import LINK_REMEDY, UNSOUND, DatasetNotFoundError, LinkError, ShardError
from mapdata.shards.files import leads_out
from mapdata.shards.header import Header, MapRange, Origin, Span, check_version

MANIFEST = "manifest.json"

PROVENANCE = "import.json"
"""File beside the manifest that says where each map came from."""

MAX_MANIFEST_BYTES = 2**27
"""Largest manifest that is read: one that lists `MAX_SHARDS` shards has some 80 MB."""

_MAX_SUBFOLDERS = 8
"""How many datasets in subfolders an error message names, at most."""

MAX_SHARDS = 100_000
"""Largest number of shards of a dataset."""

SPLIT_COUNTS = ("maps", "route", "route_unsolvable", "rooms", "rooms_unsolvable")
"""Names of the counts that `counts_of` returns for each split."""

_SHARD_COUNTS = ("segments", "drawn", "reachable", "all_connected", "most_rooms")
"""Names of the counts that `counts_of` returns for a whole shard."""


@dataclass(frozen=True)
class Entry(MapRange):
    """One shard in a manifest.

    Attributes:
        name: file name inside the root.
        start, stop: its maps are start <= i < stop.
        bytes: size of the file.
        sha256: hash of the file, which detects damage.
        content_hash: content hash of its maps.
        counts: what `counts_of` returns for its maps.
    """

    name: str
    start: int
    stop: int
    bytes: int
    sha256: str
    content_hash: str
    counts: dict[str, Any]


@dataclass(frozen=True)
class Manifest(Origin):
    """All shards of a dataset.

    Attributes:
        maps: number of maps of the finished dataset.
        shard_size: maps per shard.
        shards: finished shards in the order of their maps.

    Raises:
        ValueError: more than `MOST_SHARDS` shards.
    """

    maps: int
    shard_size: int
    shards: tuple[Entry, ...] = ()

    def __post_init__(self) -> None:
        """Refuse a dataset with too many files."""
        super().__post_init__()
        if self.maps > MAX_SHARDS * self.shard_size:
            raise ValueError(
                f"maps: {self.maps} in shards of {self.shard_size} are over {MAX_SHARDS} files; "
                "take larger shards"
            )

    @property
    def content_hash(self) -> str:
        """The content hash of all maps in the finished shards."""
        return combine([entry.content_hash for entry in self.shards])

    @property
    def done(self) -> int:
        """Number of maps in the finished shards."""
        return sum(entry.maps for entry in self.shards)

    @property
    def complete(self) -> bool:
        """Whether all shards are finished."""
        return self.done == self.maps

    @property
    def plan(self) -> list[Span]:
        """(start, stop) of every shard of the finished dataset."""
        starts = range(0, self.maps, self.shard_size)
        return [(start, min(start + self.shard_size, self.maps)) for start in starts]

    @property
    def max_seed_points(self) -> int:
        """The largest number of seed points that a map can have."""
        if self.generator is not None and unknown_family(self.generator) is None:
            return self.generator.max_seed_points
        return max((entry.counts["most_rooms"] for entry in self.shards), default=1)

    def __repr__(self) -> str:
        return (
            f"Manifest({self.maps} maps, map_size={self.map_size}, seed={self.seed}, "
            f"identity={self.identity}, content_hash={self.content_hash}, "
            f"{len(self.shards)} shards)"
        )

    def header(self, start: int, stop: int) -> Header:
        """Return the header of the shard of maps start <= i < stop."""
        return Header(**self.origin(), start=start, stop=stop)

    def total(self, name: str) -> int:
        """Return the sum over all shards of the count ``name``, which is not one of a split."""
        return sum(entry.counts[name] for entry in self.shards)

    def to_json(self) -> str:
        """Return the text of ``manifest.json``."""
        properties = {
            **self.recipe_properties(self.content_hash),
            "maps": self.maps,
            "shard_size": self.shard_size,
            **self.map_properties(),
            "shards": [vars(entry) for entry in self.shards],
        }
        properties["manifest_hash"] = json_hash(properties)
        return json.dumps(properties, indent=1) + "\n"

    def recipe(self) -> str:
        """Return the few lines of JSON from which the dataset can be built again.

        Raises:
            ValueError: imported maps have no recipe.
        """
        if self.generator is None:
            raise ValueError("imported maps have no recipe: share their files and content hash")
        recipe = {
            "format_version": self.format_version,
            "spec": self.generator.to_dict(),
            "seed": self.seed,
            "maps": self.maps,
            "identity": self.identity,
        }
        if self.complete:
            recipe["content_hash"] = self.content_hash
        # Each entry has one line; with an indent, json.dumps would also break lists into lines.
        lines = (f" {json.dumps(name)}: {json.dumps(value)}" for name, value in recipe.items())
        return "{\n" + ",\n".join(lines) + "\n}"


def path_in(root: Path, name: str, follow_links: bool = False) -> Path:
    """Return the path of a file of a root; the file may be missing.

    Args:
        root: folder of the dataset.
        name: of the file.
        follow_links: accept a link that leads out of the root.

    Raises:
        LinkError: it is a link that leads out of the root.
        ShardError: it is a link to a missing file, a pipe or a folder.
    """
    path = root / name
    if leads_out(path, root) and not follow_links:
        raise LinkError(f"{path}: a link out of its folder, expected a plain file; {LINK_REMEDY}")
    if os.path.islink(path) and not os.path.exists(path):
        raise ShardError(
            f"{path}: a link to {os.readlink(path)}, where there is no file, expected a plain file"
        )
    if os.path.lexists(path) and not os.path.isfile(path):
        raise ShardError(f"{path}: a pipe or a folder, expected a plain file")
    return path


def entry_of(header: Header, content: str, labels: Labels, image: bytes) -> Entry:
    """Return the manifest's entry for a shard.

    Args:
        header: of the shard.
        content: content hash of the labels.
        labels: the maps of the shard with their labels.
        image: the bytes of its file.
    """
    return Entry(
        name=header.file_name,
        start=header.start,
        stop=header.stop,
        bytes=len(image),
        sha256=sha256_hex(image),
        content_hash=content,
        counts=counts_of(labels),
    )


def read_manifest(root: Path, follow_links: bool = False) -> Manifest:
    """Return the manifest of a root.

    Args:
        root: folder of the dataset.
        follow_links: as in `path_in`.

    Raises:
        DatasetNotFoundError: there is none.
        ShardError: it is damaged, or of another format version (both are named), or no plain file.
    """
    path = path_in(root, MANIFEST, follow_links)
    try:
        if path.stat().st_size > MAX_MANIFEST_BYTES:
            raise ShardError(f"{path}: larger than {MAX_MANIFEST_BYTES} bytes")
        return parse_manifest(path.read_bytes(), str(path))
    except (FileNotFoundError, NotADirectoryError):
        if root.is_file():
            is_in_dataset = (root.parent / MANIFEST).is_file()
            if is_in_dataset:
                hint = f"Give its folder: {root.parent}"
            elif root.suffix.lower() in (".npz", ".scen"):
                hint = "Give the folder of a dataset"
            else:
                hint = (
                    "Give the folder of a dataset; 'mapdata import FILE ROOT' makes one of a map, "
                    "a picture or a folder of them"
                )
            raise DatasetNotFoundError(root, "it is a file", hint) from None
        if (root / "export.json").is_file():
            why = "export.json there says that it is an export of training problems"
            hint = (
                "datasets.load_dataset opens parquet, numpy.load opens arrays, and "
                "docs/howto/coming_from.md shows the other formats; a dataset is what 'mapdata "
                "build' or 'mapdata import' wrote"
            )
            raise DatasetNotFoundError(root, why, hint) from None
        why = f"no {MANIFEST} there" if root.is_dir() else "it does not exist"
        if not root.is_absolute():  # a program may have changed its working folder
            why += f" (that is {root.absolute()})"
        raise DatasetNotFoundError(root, why, _folder_hint(root)) from None


def _folder_hint(root: Path) -> str:
    """Return the end of an error message for a folder ``root`` that holds something else.

    It names the datasets in subfolders, which an import of maps of several sizes makes. Nobody is
    told to build a dataset into a folder of other files, such as an export. The text is empty if
    there is nothing in the folder.
    """
    folders = sorted(str(path.parent) for path in root.glob(f"*/{MANIFEST}"))
    if not folders:
        if not any(root.glob("*")):
            return ""
        return (
            "The folder holds other files: name the folder of a dataset, or make one in a new "
            "folder with 'mapdata build FOLDER'"
        )
    names = ", ".join(folders[:_MAX_SUBFOLDERS])
    if len(folders) > _MAX_SUBFOLDERS:
        names += f" and {len(folders) - _MAX_SUBFOLDERS} more"
    return f"Its subfolders are datasets, give one of them: {names}"


def parse_manifest(text: str | bytes, path: str) -> Manifest:
    """Return the manifest that is stored as ``text``; ``path`` names it in errors.

    Raises:
        ShardError: it is damaged, or of another format version.
    """
    try:
        stored = json.loads(text)
        if stored["format"] != "mapdata":
            raise ShardError(f"{path}: not a manifest of mapdata")
        check_version(stored["format_version"], f"{path}: ")
        if stored.pop("manifest_hash") != json_hash(stored):
            raise ShardError(f"{path}: damaged (its hash does not fit)")
        spec = stored["spec"]
        has_terrain = stored["format_version"] == TERRAIN_VERSION
        manifest = Manifest(
            generator=None if spec is None else stored_generator(json.dumps(spec), has_terrain),
            seed=None if stored["seed"] is None else check_seed(stored["seed"]),
            maps=check_count("maps", stored["maps"]),
            shard_size=check_count("shard_size", stored["shard_size"]),
            map_size=check_integers("map_size", stored["map_size"]),
            movement=Movement(**stored["movement"]),
            resolution=check_number("resolution", stored["resolution"]),
            has_terrain=has_terrain,
            shards=tuple(_parse_entry(entry, path) for entry in stored["shards"]),
        )
        _check_order(manifest, path)
        stated = (stored["format_version"], stored["identity"], stored["content_hash"])
        if stated != (manifest.format_version, manifest.identity, manifest.content_hash):
            raise ShardError(
                f"{path}: damaged (its version, identity or content hash is not what its values "
                "give)"
            )
        return manifest
    except ShardError:
        raise
    except UNSOUND as error:
        raise ShardError(f"{path}: damaged ({type(error).__name__}: {error})") from None


def _check_order(manifest: Manifest, path: str) -> None:
    """Refuse shards that are not in the order of their maps, or do not fit the shard size.

    A shard begins at a multiple of the shard size. It may be shorter than that, since the last
    shard of a dataset is short until the dataset is extended, and shards of an unfinished build may
    be missing.
    """
    previous_start = -1
    for entry in manifest.shards:
        max_stop = min(entry.start + manifest.shard_size, manifest.maps)
        is_aligned = entry.start % manifest.shard_size == 0
        if not (is_aligned and previous_start < entry.start < entry.stop <= max_stop):
            raise ShardError(f"{path}: damaged ({entry.name} is out of order or of the plan)")
        previous_start = entry.start


def _parse_entry(stored: dict[str, Any], path: str) -> Entry:
    """Return one entry of the manifest at ``path``, checked.

    Raises:
        ShardError: its name or a hash cannot be right.
        ValueError: a number in it cannot be right.
    """
    entry = Entry(**stored)
    if entry.name != entry.file_name:
        raise ShardError(
            f"{path}: {entry.name!r} is not the name of a shard, or not of maps {entry.start} to "
            f"{entry.stop}"
        )
    check_count("bytes", entry.bytes)
    if not (is_sha256_hex(entry.sha256) and is_sha256_hex(entry.content_hash)):
        raise ShardError(f"{path}: {entry.name} has no hashes")
    for name in _SHARD_COUNTS:
        check_count(name, entry.counts[name], 0)
    for split in SPLITS:
        for name in SPLIT_COUNTS:
            check_count(name, entry.counts[split][name], 0)
    return entry


class _Problems(NamedTuple):
    """The P problems of one kind on N maps, in the order of the maps.

    Attributes:
        per_map: (N,) int64, number of problems of each map.
        has_path: (P,) bool.
        moves: (P,) int64, moves of the shortest path; any number without a path.
    """

    per_map: Ints
    has_path: Flags
    moves: Ints


def counts_of(labels: Labels) -> dict[str, Any]:
    """Return the counts of a shard that the manifest states.

    For the whole shard they are the numbers of segments, drawn passages, reachable segments and
    fully connected maps, and the largest number of rooms of a map. For each split they are the
    number of maps, and of the problems of two kinds, segments ("route") and pairs of rooms
    ("rooms"): the problems with a path that leads to another cell, and the problems without a path
    ("unsolvable"). Paths are those of the stored movement.
    """
    maps = labels.maps
    passages = maps.rooms - 1
    counts: dict[str, Any] = {
        "segments": int(passages.sum()),
        "drawn": int(maps.connected.sum()),  # padding counts as not connected
        "reachable": int(labels.reachable.sum()),
        "all_connected": int(labels.all_connected.sum()),
        "most_rooms": int(maps.rooms.max(initial=0)),
    }
    # (P, 2): straight and diagonal moves, or their costs on terrain; -1, 0 without a path
    pair_costs = labels.astar.costs
    routes = _Problems(
        per_map=passages, has_path=labels.reachable, moves=np.diff(labels.astar.offsets)
    )
    rooms = _Problems(
        per_map=np.diff(maps.pair_offsets),
        has_path=pair_costs[:, 0] >= 0,
        moves=pair_costs.sum(axis=1),
    )
    for code, split in enumerate(SPLITS):
        is_in_split = maps.split == code
        split_counts = {"maps": int(is_in_split.sum())}
        for name, problems in (("route", routes), ("rooms", rooms)):
            is_counted = np.repeat(is_in_split, problems.per_map)
            solvable = is_counted & problems.has_path & (problems.moves > 0)
            unsolvable = is_counted & ~problems.has_path
            split_counts[name] = int(solvable.sum())
            split_counts[f"{name}_unsolvable"] = int(unsolvable.sum())
        counts[split] = split_counts
    return counts


def provenance_text(origin: dict[str, Any]) -> str:
    """Return the text of ``import.json``: ``origin``, and its hash."""
    return json.dumps({**origin, "hash": json_hash(origin)}, indent=1) + "\n"
