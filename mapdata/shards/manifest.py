"""The manifest of a root: which shards there are, and what opening them needs. Derived from the
shards, so it can be
rebuilt.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import socket
import stat
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

if sys.platform != "win32":
    import fcntl

from mapdata._version import __version__
from mapdata.generators.generator import Generator
from mapdata.search.labels import Labels
from mapdata.shards.content import combine, content_hash
from mapdata.shards.reader import is_hash, open_shard
from mapdata.shards.shard import (
    Header,
    Origin,
    Shard,
    ShardError,
    check_version,
    decode,
    write_file,
)
from mapdata.spec import SPLITS, Movement, canonical_json, check_count, check_seed

MANIFEST = "manifest.json"
LOCK = ".lock"
PROVENANCE = "import.json"
"""File beside the manifest that says where each map came from."""

MOST_SHARDS = 10**7
"""Most files of a dataset."""

MOST_BYTES = 2**28
"""Largest manifest that is read: room for some 300,000 shards."""

_A_DAY = 86_400
_TEMPORARY = re.compile(
    r"\.(?:maps-\d+-\d+\.h5|manifest\.json)(?:-\d+)?\.(?P<host>.+)\.(?P<pid>\d+)\.tmp"
)


class DatasetNotFoundError(FileNotFoundError):
    """There is no dataset where one was looked for; the message says where, and which command makes
    one.
    """

    def __init__(self, root: object, why: str = "it does not exist") -> None:
        """Say what was looked for under ``root`` and what to do."""
        self.root, self.why = root, why
        how = (
            f"Make one with 'mapdata build {root}', with "
            f"mapdata.build({str(root)!r}, MapSpec()), or with MapDataModule({str(root)!r}, "
            "build='paper')"
        )
        if "://" in str(root):
            how = "Make one in a folder with 'mapdata build FOLDER', and serve that folder"
        super().__init__(f"no dataset at {root}: {why}. {how}")

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as arguments: an exception of a worker says the same in its parent."""
        return DatasetNotFoundError, (self.root, self.why)

    def __str__(self) -> str:
        """Return the message alone (an OSError would show its arguments as a tuple)."""
        return str(self.args[0])


@dataclass(frozen=True)
class Entry:
    """What the manifest says of one shard.

    Attributes:
        name: file name inside the root.
        start, stop: its maps are start <= i < stop.
        bytes: size of the file.
        sha256: file hash, for damage.
        content_hash: content hash of its maps.
        counts: how many segments, drawn passages, reachable segments and fully connected maps it
            holds, and per split the number of maps, of route problems with and without a path, and
            of room pairs with and without one.
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
        shard_size: maps a shard.
        shards: finished shards in the order of their maps.
    """

    maps: int
    shard_size: int
    shards: tuple[Entry, ...] = ()

    @property
    def content_hash(self) -> str:
        """The content hash of all maps in the finished shards."""
        return combine([entry.content_hash for entry in self.shards])

    @property
    def complete(self) -> bool:
        """Whether all maps are there."""
        return sum(entry.stop - entry.start for entry in self.shards) == self.maps

    @property
    def plan(self) -> list[tuple[int, int]]:
        """(start, stop) of every shard that the dataset shall have."""
        return [
            (k, min(k + self.shard_size, self.maps)) for k in range(0, self.maps, self.shard_size)
        ]

    @property
    def most_seed_points(self) -> int:
        """The largest number of seed points that a map can have."""
        return (
            self.spec.most_seed_points
            if self.spec
            else max(int(entry.counts["most_rooms"]) for entry in self.shards)
        )

    def total(self, name: str) -> int:
        """Return the sum of one of the counts over all shards."""
        return sum(int(entry.counts[name]) for entry in self.shards)

    def to_json(self) -> str:
        """Return the text of ``manifest.json``."""
        values = {
            "format": "mapdata",
            "format_version": self.format_version,
            "library_version": __version__,
            "identity": self.identity,
            "content_hash": self.content_hash,
            "spec": self.spec.to_dict() if self.spec else None,
            "seed": self.seed,
            "maps": self.maps,
            "shard_size": self.shard_size,
            "map_size": list(self.map_size),
            "movement": asdict(self.movement),
            "resolution": self.resolution,
            "shards": [vars(entry) for entry in self.shards],
        }
        values["manifest_hash"] = _hash(values)
        return json.dumps(values, indent=1) + "\n"

    def recipe(self) -> str:
        """Return the few lines of JSON that are the dataset.

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
        lines = (f" {json.dumps(name)}: {json.dumps(value)}" for name, value in values.items())
        return "{\n" + ",\n".join(lines) + "\n}"


def shard_name(start: int, stop: int) -> str:
    """Return the file name of the shard of maps start <= i < stop."""
    return f"maps-{start:012d}-{stop:012d}.h5"


def is_shard_name(name: str) -> bool:
    """Return whether ``name`` is what `shard_name` gives: nothing else of a manifest is ever
    opened.
    """
    return re.fullmatch(r"maps-\d{12,}-\d{12,}\.h5", name) is not None


def entry_of(shard: Shard, labels: Labels, image: bytes) -> Entry:
    """Return the entry of a shard with this content and these bytes."""
    return Entry(
        name=shard.path.name,
        start=shard.header.start,
        stop=shard.header.stop,
        bytes=len(image),
        sha256=hashlib.sha256(image).hexdigest(),
        content_hash=shard.content_hash,
        counts=counts_of(labels),
    )


def read_manifest(root: Path) -> Manifest:
    """Return the manifest of a root.

    Raises:
        DatasetNotFoundError: there is none.
        ShardError: it is damaged, or of another format version (both are named).
    """
    path = root / MANIFEST
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode) or status.st_size > MOST_BYTES:
            raise ShardError(f"{path}: not a file, or larger than {MOST_BYTES} bytes")
        text = path.read_bytes().decode()
    except (FileNotFoundError, NotADirectoryError):
        raise DatasetNotFoundError(
            root, f"no {MANIFEST} there" if root.is_dir() else "it does not exist"
        ) from None
    except UnicodeDecodeError as error:
        raise ShardError(f"{path}: damaged ({error})") from None
    return parse_manifest(text, str(path))


def parse_manifest(text: str, path: str) -> Manifest:
    """Return the manifest that ``text`` states; ``path`` names it in errors."""
    try:
        values = json.loads(text)
        if values["format"] != "mapdata":
            raise ShardError(f"{path}: not a manifest of mapdata")
        check_version(values["format_version"], f"{path}: ")
        if values.pop("manifest_hash") != _hash(values):
            raise ShardError(f"{path}: damaged (its hash does not fit)")
        spec = values["spec"]
        entries = tuple(_entry(entry, path) for entry in values["shards"])
        manifest = Manifest(
            spec=None if spec is None else Generator.from_dict(spec),
            seed=None if values["seed"] is None else check_seed(values["seed"]),
            maps=check_count("maps", values["maps"]),
            shard_size=check_count("shard_size", values["shard_size"]),
            map_size=(values["map_size"][0], values["map_size"][1]),
            movement=Movement(**values["movement"]),
            resolution=values["resolution"],
            shards=entries,
        )
        if manifest.maps > MOST_SHARDS * manifest.shard_size:
            raise ShardError(f"{path}: damaged (plans over {MOST_SHARDS} files)")
        stated = (values["format_version"], values["identity"], values["content_hash"])
        if stated != (manifest.format_version, manifest.identity, manifest.content_hash):
            raise ShardError(
                f"{path}: damaged (its version, identity or content hash is not what its values "
                "give)"
            )
        return manifest
    except ShardError:
        raise
    except (
        ValueError,
        KeyError,
        TypeError,
        IndexError,
        AttributeError,
        RecursionError,
        ArithmeticError,
    ) as error:
        raise ShardError(f"{path}: damaged ({type(error).__name__}: {error})") from None


def _entry(values: dict[str, Any], path: str) -> Entry:
    """Return one entry of the manifest at ``path``, checked."""
    entry = Entry(**values)
    if not is_shard_name(entry.name) or entry.name != shard_name(entry.start, entry.stop):
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
        for name in ("maps", "route", "route_unsolvable", "rooms", "rooms_unsolvable"):
            check_count(name, entry.counts[split][name], 0)
    return entry


@contextmanager
def _locked(root: Path, wait: bool) -> Iterator[bool]:
    """Hold the lock of a root and yield True; yield False when another holds it and ``wait`` is
    False.

    A file system without locks (or Windows) yields True: two merges at once may then lose entries,
    never shards, and the next build adopts those.
    """
    with open(root / LOCK, "ab") as file:
        if sys.platform == "win32":
            yield True
            return
        try:
            fcntl.flock(file, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
            return
        except OSError:
            yield True
            return
        try:
            yield True
        finally:
            fcntl.flock(file, fcntl.LOCK_UN)  # closing would not do where a fork shares the file


def merge(root: Path, mine: Manifest, *, wait: bool = True) -> Manifest:
    """Write the union of ``mine`` and the manifest on disk, remove shards that larger ones
    replaced; return the union. While another builder merges, wait for it, or without ``wait`` do
    nothing and return ``mine``.
    """
    with _locked(root, wait) as free:
        if not free:
            return mine
        theirs = read_manifest(root) if (root / MANIFEST).exists() else mine
        union = _union(mine, theirs)
        write_file(root / MANIFEST, union.to_json().encode())
        kept = {entry.name for entry in union.shards}
        for name in {entry.name for entry in (*mine.shards, *theirs.shards)} - kept:
            (root / name).unlink(missing_ok=True)
        return union


def _union(mine: Manifest, theirs: Manifest) -> Manifest:
    if (mine.identity, mine.shard_size) != (theirs.identity, theirs.shard_size):
        raise ValueError("another dataset appeared under the same root while this one was built")
    union = replace(mine, maps=max(mine.maps, theirs.maps))
    plan = set(union.plan)
    known = {(entry.start, entry.stop): entry for entry in (*theirs.shards, *mine.shards)}
    whole = {start for start, stop in known if (start, stop) in plan}
    # A partial last shard stays until the larger one that takes its place is there.
    kept = (known[key] for key in sorted(known) if key in plan or key[0] not in whole)
    return replace(union, shards=tuple(kept))


def sweep(root: Path, manifest: Manifest) -> None:
    """Remove what dead builders left behind: temporary files, and shards that larger ones
    replaced.
    """
    for path in root.glob(".*.tmp"):
        match = _TEMPORARY.fullmatch(path.name)
        if match and (
            _old(path) if match["host"] != socket.gethostname() else not _alive(int(match["pid"]))
        ):
            path.unlink(missing_ok=True)
    plan = set(manifest.plan)
    whole = {
        entry.start: entry.stop for entry in manifest.shards if (entry.start, entry.stop) in plan
    }
    for path in root.glob("maps-*.h5"):
        if is_shard_name(path.name):
            start, stop = map(int, path.stem.split("-")[1:])
            if stop < whole.get(start, 0):
                path.unlink(missing_ok=True)


def _old(path: Path) -> bool:
    """Return whether a file was last written so long ago that no builder is still at it."""
    try:
        return time.time() - path.stat().st_mtime > _A_DAY
    except FileNotFoundError:
        return False


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True
    return True


def load_shard(root: Path, header: Header) -> Entry | None:
    """Return the entry of the shard of ``header`` if a sound one stands under its name, else
    None.
    """
    path = root / shard_name(header.start, header.stop)
    try:
        shard = open_shard(path)
        labels = decode(shard)
    except (FileNotFoundError, ShardError):
        return None
    if shard.header != header or content_hash(labels) != shard.content_hash:
        return None
    return entry_of(shard, labels, path.read_bytes())


def _hash(values: dict[str, Any]) -> str:
    return hashlib.sha256(canonical_json(values).encode()).hexdigest()


def counts_of(labels: Labels) -> dict[str, Any]:
    """Count what the summary states and what a dataset needs to number its problems."""
    maps = labels.maps
    used = np.arange(maps.directions.shape[1]) < (maps.rooms - 1)[:, None]
    ways = {"route": np.diff(labels.astar.offsets), "rooms": labels.astar.costs.sum(axis=1)}
    paths = {"route": labels.reachable, "rooms": labels.astar.costs[:, 0] >= 0}
    owner = {"route": maps.rooms - 1, "rooms": np.diff(maps.pair_offsets)}
    counts: dict[str, Any] = {
        "segments": int((maps.rooms - 1).sum()),
        "drawn": int((maps.connected & used).sum()),
        "reachable": int(labels.reachable.sum()),
        "all_connected": int(labels.all_connected.sum()),
        "most_rooms": int(maps.rooms.max(initial=0)),
    }
    for code, split in enumerate(SPLITS):
        row = {"maps": int((maps.split == code).sum())}
        for name in ("route", "rooms"):
            inside = np.repeat(maps.split == code, owner[name])
            row[name] = int((inside & paths[name] & (ways[name] > 0)).sum())
            row[f"{name}_unsolvable"] = int((inside & ~paths[name]).sum())
        counts[split] = row
    return counts


def provenance_text(origin: dict[str, Any]) -> str:
    """Return the text of ``import.json``, with a hash of what it says."""
    stated = hashlib.sha256(canonical_json(origin).encode()).hexdigest()
    return json.dumps({**origin, "hash": stated}, indent=1) + "\n"
