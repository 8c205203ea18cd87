"""The manifest of a dataset: which shards it has, and what opening them needs.

All of it is derived from the shards, so it can be rebuilt.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mapdata.checks import check_count, check_integers, check_number, check_seed
from mapdata.generators.generator import UnknownFamily, stored_generator
from mapdata.hashing import hash_of, sha256_of
from mapdata.limits import SPLITS
from mapdata.movement import Movement
from mapdata.search.labels import Labels
from mapdata.shards.content import combine
from mapdata.shards.errors import DatasetNotFoundError, ShardError
from mapdata.shards.header import Header, MapRange, Origin, Span, check_version
from mapdata.shards.reader import UNSOUND, is_hash

MANIFEST = "manifest.json"

PROVENANCE = "import.json"
"""File beside the manifest that says where each map came from."""

MOST_BYTES = 2**27
"""Largest manifest that is read: one that lists `MOST_SHARDS` has some 80 MB."""

MOST_SHARDS = 100_000
"""Most files of a dataset."""

COUNTS = ("maps", "route", "route_unsolvable", "rooms", "rooms_unsolvable")
"""What `counts_of` counts in each split."""


@dataclass(frozen=True)
class Entry(MapRange):
    """What the manifest says of one shard.

    Attributes:
        name: file name inside the root.
        start, stop: its maps are start <= i < stop.
        bytes: size of the file.
        sha256: file hash, for damage.
        content_hash: content hash of its maps.
        counts: what `counts_of` counts.
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
        maps: how many maps the dataset shall have.
        shard_size: maps per shard.
        shards: finished shards in the order of their maps.

    Raises:
        ValueError: more than `MOST_SHARDS` shards.
    """

    maps: int
    shard_size: int
    shards: tuple[Entry, ...] = ()

    def __post_init__(self) -> None:
        """Check how many files are planned."""
        if self.maps > MOST_SHARDS * self.shard_size:
            raise ValueError(
                f"maps: {self.maps} in shards of {self.shard_size} are over {MOST_SHARDS} files; "
                "take larger shards"
            )

    @property
    def content_hash(self) -> str:
        """The content hash of all maps in the finished shards."""
        return combine([entry.content_hash for entry in self.shards])

    @property
    def done(self) -> int:
        """How many maps are there."""
        return sum(entry.maps for entry in self.shards)

    @property
    def complete(self) -> bool:
        """Whether all maps are there."""
        return self.done == self.maps

    @property
    def plan(self) -> list[Span]:
        """(start, stop) of every shard that the dataset shall have."""
        starts = range(0, self.maps, self.shard_size)
        return [(start, min(start + self.shard_size, self.maps)) for start in starts]

    @property
    def most_seed_points(self) -> int:
        """The largest number of seed points that a map can have."""
        if self.spec is not None and not isinstance(self.spec, UnknownFamily):
            return self.spec.most_seed_points
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
        """Return the sum of one of the counts over all shards."""
        return sum(entry.counts[name] for entry in self.shards)

    def to_json(self) -> str:
        """Return the text of ``manifest.json``."""
        values = self.stated(self.content_hash, maps=self.maps, shard_size=self.shard_size)
        values["shards"] = [vars(entry) for entry in self.shards]
        values["manifest_hash"] = hash_of(values)
        return json.dumps(values, indent=1) + "\n"

    def recipe(self) -> str:
        """Return the few lines of JSON from which the dataset can be built again.

        Raises:
            ValueError: imported maps have no recipe.
        """
        if self.spec is None:
            raise ValueError("imported maps have no recipe: their identity is the content hash")
        values = {
            "format_version": self.format_version,
            "spec": self.spec.to_dict(),
            "seed": self.seed,
            "maps": self.maps,
            "identity": self.identity,
        }
        if self.complete:
            values["content_hash"] = self.content_hash
        # a line for each value, however deep: json.dumps would break lists into lines too
        lines = (f" {json.dumps(name)}: {json.dumps(value)}" for name, value in values.items())
        return "{\n" + ",\n".join(lines) + "\n}"


def path_in(root: Path, name: str) -> Path:
    """Return the path of a file of a root, which may be missing.

    Raises:
        ShardError: it is a link that leads out of the root, a pipe or a folder.
    """
    path = root / name
    # unlike `Path.resolve`, `realpath` does not fail on links in a circle
    leads_out = path.is_symlink() and not Path(os.path.realpath(path)).is_relative_to(
        os.path.realpath(root)
    )
    if leads_out or (os.path.lexists(path) and not path.is_file()):
        raise ShardError(
            f"{path}: a link out of its folder, a pipe or a folder, expected a plain file"
        )
    return path


def entry_of(header: Header, content: str, labels: Labels, image: bytes) -> Entry:
    """Return the entry of a shard that holds ``labels`` of the hash ``content`` as ``image``."""
    return Entry(
        name=header.file_name,
        start=header.start,
        stop=header.stop,
        bytes=len(image),
        sha256=sha256_of(image),
        content_hash=content,
        counts=counts_of(labels),
    )


def read_manifest(root: Path) -> Manifest:
    """Return the manifest of a root.

    Raises:
        DatasetNotFoundError: there is none.
        ShardError: it is damaged, or of another format version (both are named), or no plain file.
    """
    path = path_in(root, MANIFEST)
    try:
        if path.stat().st_size > MOST_BYTES:
            raise ShardError(f"{path}: larger than {MOST_BYTES} bytes")
        return parse_manifest(path.read_bytes(), str(path))
    except (FileNotFoundError, NotADirectoryError):
        if root.is_file():
            is_inside = (root.parent / MANIFEST).is_file()
            folder = f"its folder: {root.parent}" if is_inside else "the folder of a dataset"
            raise DatasetNotFoundError(root, "it is a file", f"Give {folder}") from None
        why = f"no {MANIFEST} there" if root.is_dir() else "it does not exist"
        raise DatasetNotFoundError(root, why) from None


def parse_manifest(text: str | bytes, path: str) -> Manifest:
    """Return the manifest that ``text`` states; ``path`` names it in errors."""
    try:
        values = json.loads(text)
        if values["format"] != "mapdata":
            raise ShardError(f"{path}: not a manifest of mapdata")
        check_version(values["format_version"], f"{path}: ")
        if values.pop("manifest_hash") != hash_of(values):
            raise ShardError(f"{path}: damaged (its hash does not fit)")
        spec = values["spec"]
        entries = tuple(_entry(entry, path) for entry in values["shards"])
        manifest = Manifest(
            spec=None if spec is None else stored_generator(json.dumps(spec)),
            seed=None if values["seed"] is None else check_seed(values["seed"]),
            maps=check_count("maps", values["maps"]),
            shard_size=check_count("shard_size", values["shard_size"]),
            map_size=check_integers("map_size", values["map_size"]),
            movement=Movement(**values["movement"]),
            resolution=check_number("resolution", values["resolution"]),
            shards=entries,
        )
        # Shards begin at multiples of their size; of an unfinished build some are missing or short.
        before = -1
        for entry in entries:
            whole = min(entry.start + manifest.shard_size, manifest.maps)
            if entry.start % manifest.shard_size or not before < entry.start < entry.stop <= whole:
                raise ShardError(f"{path}: damaged ({entry.name} is out of order or of the plan)")
            before = entry.start
        stated = (values["format_version"], values["identity"], values["content_hash"])
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


def _entry(values: dict[str, Any], path: str) -> Entry:
    """Return one entry of the manifest at ``path``, checked."""
    entry = Entry(**values)
    if entry.name != entry.file_name:
        raise ShardError(
            f"{path}: {entry.name!r} is not the name of a shard, or not of maps {entry.start} to "
            f"{entry.stop}"
        )
    check_count("bytes", entry.bytes)
    if not (is_hash(entry.sha256) and is_hash(entry.content_hash)):
        raise ShardError(f"{path}: {entry.name} has no hashes")
    for name in ("segments", "drawn", "reachable", "all_connected", "most_rooms"):
        check_count(name, entry.counts[name], 0)
    for split in SPLITS:
        for name in COUNTS:
            check_count(name, entry.counts[split][name], 0)
    return entry


def counts_of(labels: Labels) -> dict[str, Any]:
    """Return what the manifest counts in a shard.

    That is segments, drawn passages, reachable segments, fully connected maps and the most rooms
    of a map; and for each split the maps, the segments ("route") and pairs of rooms ("rooms") that
    are problems, which lead to another cell, and those without a path ("unsolvable"). Paths are
    those of the stored movement.
    """
    maps = labels.maps
    passages = maps.rooms - 1
    counts: dict[str, Any] = {
        "segments": int(passages.sum()),
        "drawn": int(maps.connected.sum()),  # False where arrays are padded
        "reachable": int(labels.reachable.sum()),
        "all_connected": int(labels.all_connected.sum()),
        "most_rooms": int(maps.rooms.max(initial=0)),
    }
    costs = labels.astar.costs  # straight and diagonal moves of each pair, -1 without a path
    # of each kind: its problems per map; for each problem, whether it has a path, and its moves
    kinds = {
        "route": (passages, labels.reachable, np.diff(labels.astar.offsets)),
        "rooms": (np.diff(maps.pair_offsets), costs[:, 0] >= 0, costs.sum(axis=1)),
    }
    for code, split in enumerate(SPLITS):
        is_in_split = maps.split == code
        row = {"maps": int(is_in_split.sum())}
        for name, (problems, has_path, moves) in kinds.items():
            inside = np.repeat(is_in_split, problems)
            row[name] = int((inside & has_path & (moves > 0)).sum())
            row[f"{name}_unsolvable"] = int((inside & ~has_path).sum())
        counts[split] = row
    return counts


def provenance_text(origin: dict[str, Any]) -> str:
    """Return the text of ``import.json``, with a hash of what it says."""
    return json.dumps({**origin, "hash": hash_of(origin)}, indent=1) + "\n"
