"""`Root`: the dataset of a folder, of a URL or of several, read a shard at a time.

What lies at a URL is fetched to a local cache, shards once, and checked against its hashes.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mapdata.hashing import hash_of, parsed_json, sha256_of
from mapdata.limits import Size
from mapdata.movement import Movement
from mapdata.search.labels import Labels
from mapdata.shards.arrays import Shard, decode
from mapdata.shards.errors import REPAIRS, ShardError
from mapdata.shards.files import StrPath, file_size, sweep_temporaries
from mapdata.shards.manifest import (
    MANIFEST,
    MOST_BYTES,
    PROVENANCE,
    Entry,
    Manifest,
    parse_manifest,
    path_in,
    read_manifest,
)
from mapdata.shards.reader import has_hash, open_shard
from mapdata.shards.remote import _cache, _fetch, _keep, is_url
from mapdata.shards.workers import bar

Places = StrPath | Sequence[StrPath]
"""What names a dataset: a folder, a URL, or several of them."""


@dataclass(frozen=True)
class Root:
    """The dataset of a folder or URL, or those of several, one after another.

    Attributes:
        places: the folders and URLs.
        manifests: one a place.
        map_size, movement: of all maps.
        shards: the finished shards in the order of their maps: number of the place, how many maps
            the places before it have, entry in its manifest.
        maps: how many maps there are when all is finished.
    """

    places: tuple[str, ...]
    manifests: tuple[Manifest, ...]
    map_size: Size
    movement: Movement
    shards: tuple[tuple[int, int, Entry], ...]
    maps: int

    @staticmethod
    def open(source: Places, *, complete: bool = False) -> Root:
        """Return the dataset that ``source`` names; no shard is opened yet.

        Args:
            source: a folder, a URL, or several of them, whose maps have one size and one movement.
            complete: refuse a dataset that is not finished.

        Raises:
            DatasetNotFoundError: there is no dataset.
            ConnectionError: a URL cannot be reached, and never was.
            ShardError: a manifest is damaged.
            ValueError: no place; places that do not fit together; an unfinished dataset; a URL
                that needs a package that is not installed (the message names it).
        """
        where = places(source)
        manifests = tuple(manifest_at(place) for place in where)
        shards = []
        maps = 0
        for number, (place, manifest) in enumerate(zip(where, manifests, strict=True)):
            for name in ("map_size", "movement"):
                value = getattr(manifest, name)
                first = getattr(manifests[0], name)
                if value != first:
                    raise ValueError(
                        f"root: {place} has {name} {value}, {where[0]} has {first}; "
                        f"the roots of one dataset must have one"
                    )
            if complete and not manifest.complete:
                raise ValueError(
                    f"root: {place} is not finished: run the command that makes it once more"
                )
            shards.extend([(number, maps, entry) for entry in manifest.shards])
            maps += manifest.maps
        return Root(
            places=where,
            manifests=manifests,
            map_size=manifests[0].map_size,
            movement=manifests[0].movement,
            shards=tuple(shards),
            maps=maps,
        )

    @property
    def resolution(self) -> float:
        """Metres per cell of all maps.

        Raises:
            ValueError: those of several places differ.
        """
        first, *others = {manifest.resolution for manifest in self.manifests}
        if others:
            raise ValueError(
                f"root: {self} have resolutions {first} and {others[0]}; take those of one alone"
            )
        return first

    def check_begun(self) -> None:
        """Refuse a dataset of which no map is there yet, such as what a build leaves that failed.

        Raises:
            ValueError: the message names the place, and what to do.
        """
        for place, manifest in zip(self.places, self.manifests, strict=True):
            if not manifest.shards:
                raise ValueError(
                    f"root: {place} holds none of its {manifest.maps} maps yet: no shard is "
                    "finished. Wait for the build that runs, or run the command that makes it once "
                    "more: it goes on, or says what stops it"
                )

    def __repr__(self) -> str:
        return f"Root({', '.join(map(repr, (*self.places, *self.manifests)))})"

    def __str__(self) -> str:
        """Return the places."""
        return ", ".join(self.places)

    def open_shard(self, k: int) -> Shard:
        """Return shard ``k``, fetched if it lies at a URL, and checked.

        Raises:
            ShardError: it is missing, damaged, or not what the manifest says.
            DatasetNotFoundError: it lies at a URL, and is not there.
            ConnectionError: it lies at a URL that cannot be reached.
        """
        number, _, entry = self.shards[k]
        place = self.places[number]
        path = local_file(place, entry)
        try:
            shard = open_shard(path, entry.bytes, entry.sha256)
        except FileNotFoundError:
            raise ShardError(
                f"{path}: missing; 'mapdata verify {place}' tells what else is"
            ) from None
        expected = (self.manifests[number].header(*entry.limits), entry.content_hash)
        if (shard.header, shard.content_hash) != expected:
            raise ShardError(f"{path}: holds other maps than the manifest says; {REPAIRS}")
        return shard

    def shard_labels(self, k: int) -> Labels:
        """Return the maps of shard ``k`` with their labels, numbered as by `labels`.

        Raises:
            ShardError, DatasetNotFoundError, ConnectionError: as `open_shard`.
        """
        _, first, _ = self.shards[k]
        labels = decode(self.open_shard(k))
        maps = replace(labels.maps, index=labels.maps.index + first)
        return replace(labels, maps=maps)

    def labels(self, *, progress: bool = False) -> Iterator[Labels]:
        """Yield the maps with their labels, a shard at a time.

        The numbers of the maps go on from one place to the next: those of the second begin at the
        number of maps that the first one has when it is finished.

        Raises:
            ShardError, DatasetNotFoundError, ConnectionError: as `open_shard`.
            ValueError: as `check_begun`.
        """
        self.check_begun()
        with bar(progress, sum(manifest.done for manifest in self.manifests)) as advance:
            for k, (_, _, entry) in enumerate(self.shards):
                yield self.shard_labels(k)
                advance(entry.maps)

    def map(self, index: int) -> tuple[Labels, int]:
        """Return the shard that holds map ``index``, and the place of the map in it.

        Raises:
            ValueError: the dataset has no such map, or as `check_begun`.
        """
        self.check_begun()
        for k, (_, first, entry) in enumerate(self.shards):
            number = index - first  # of the map in its own place
            if entry.start <= number < entry.stop:
                return self.shard_labels(k), number - entry.start
        raise ValueError(f"index: got {index}, {self} holds maps 0 to {self.maps - 1}")


def places(source: Places) -> tuple[str, ...]:
    """Return the folders and URLs that ``source`` names, without a slash at the end.

    Raises:
        ValueError: there is none.
    """
    names = [source] if isinstance(source, (str, os.PathLike)) else source
    if not names:
        raise ValueError("root: got an empty list, expected at least one dataset")
    texts = [os.fspath(name) for name in names]
    return tuple(text.rstrip("/") if is_url(text) else str(Path(text)) for text in texts)


def local_path(place: StrPath) -> Path:
    """Return a place as a path: without this, a URL would name a folder ``http:``.

    Raises:
        ValueError: it is a URL.
    """
    if is_url(os.fspath(place)):
        raise ValueError(f"{place}: a URL, expected a file or folder of this machine")
    return Path(place)


def folder_of(place: StrPath) -> Path:
    """Return a place to write to as a path; there may be nothing yet.

    Raises:
        ValueError: it is a URL or a file.
    """
    if is_url(os.fspath(place)):
        raise ValueError(f"root: {place} is a URL, which can only be read; expected a folder")
    folder = Path(place)
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"root: {folder} is a file, expected a folder")
    return folder


def manifest_at(place: str) -> Manifest:
    """Return the manifest of a place, which is read or fetched anew.

    Raises:
        DatasetNotFoundError: no dataset there.
        ShardError: it is damaged.
        ConnectionError: as `read_file`.
    """
    if not is_url(place):
        return read_manifest(Path(place))
    return parse_manifest(read_file(place, MANIFEST), f"{place}/{MANIFEST}")


def read_file(place: str, name: str) -> bytes:
    """Return a file of a place; where a URL cannot be reached, as it was when fetched last.

    Raises:
        FileNotFoundError: there is none.
        ConnectionError: the URL cannot be reached, and the file was never fetched.
        ShardError: it is a link that leads out of the folder, or longer than `MOST_BYTES` at a URL.
    """
    if not is_url(place):
        return path_in(Path(place), name).read_bytes()
    kept = _cache(place) / name
    try:
        data = _fetch(place, name, MOST_BYTES)
    except ConnectionError as error:
        if not kept.exists():
            raise
        warnings.warn(f"{error}. Going on with what was fetched before", stacklevel=2)
        return kept.read_bytes()
    with suppress(OSError):  # a cache that may only be read
        _keep(kept, data)
        sweep_temporaries(kept.parent)
    return data


def read_provenance(place: str) -> dict[str, Any]:
    """Return what ``import.json`` says of an imported dataset, without its hash.

    Raises:
        FileNotFoundError: there is none.
        ConnectionError: as `read_file`.
        ValueError: it is damaged.
    """
    values = parsed_json(f"{place}/{PROVENANCE}", read_file(place, PROVENANCE))
    with suppress(RecursionError):  # of what is nested a thousand times
        if isinstance(values, dict) and values.pop("hash", None) == hash_of(values):
            return values
    raise ValueError(f"{place}/{PROVENANCE}: damaged (its hash does not fit)")


def local_file(place: str, entry: Entry) -> Path:
    """Return the local file of a shard; one at a URL is fetched to the cache and checked.

    Raises:
        DatasetNotFoundError: it is not there.
        ConnectionError: the URL cannot be reached.
        ShardError: what was fetched does not have the hash that the manifest states, or the file
            is a link that leads out of the folder.
    """
    if not is_url(place):
        return path_in(Path(place), entry.name)
    # with the hash in its name, a shard that was replaced at the URL is another file here
    path = _cache(place) / f"{entry.sha256[:16]}-{entry.name}"
    cached = file_size(path) == entry.bytes
    if not cached or not has_hash(np.memmap(path, np.uint8, "r"), path.stat(), entry.sha256):
        data = _fetch(place, entry.name, entry.bytes, entry.bytes)
        if sha256_of(data) != entry.sha256:
            raise ShardError(
                f"{place}/{entry.name}: what was fetched is damaged (its file hash does not fit)"
            )
        _keep(path, data)
    return path


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file."""
    return sha256_of(path.read_bytes())
