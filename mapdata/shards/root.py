"""`Root`: a dataset in a folder, at a URL or in several of them, read a shard at a time.

The files of a dataset at a URL are fetched to a local cache and checked against their hashes. A
shard is fetched only once.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mapdata.hashing import json_hash, parsed_json, sha256_hex
from mapdata.limits import Size
from mapdata.movement import Movement
from mapdata.search.labels import Labels
from mapdata.shards.arrays import Shard, decode
from mapdata.shards.errors import REPAIRS, ShardError
from mapdata.shards.files import StrPath, file_size, sweep_temporaries
from mapdata.shards.manifest import (
    MANIFEST,
    MAX_MANIFEST_BYTES,
    PROVENANCE,
    Entry,
    Manifest,
    parse_manifest,
    path_in,
    read_manifest,
)
from mapdata.shards.reader import has_hash, open_shard
from mapdata.shards.remote import cache_folder, fetch, is_url, write_to_cache
from mapdata.shards.workers import bar

Locations = StrPath | Sequence[StrPath]
"""Where a dataset is: a folder, a URL, or several of them."""


class RootShard(NamedTuple):
    """A shard of a `Root`.

    Attributes:
        location: index of its folder or URL in ``Root.locations``.
        first_map: number of maps in the locations before it. Map i of its own location is map
            ``first_map + i`` of the root.
        entry: the shard's entry in the manifest of its location.
    """

    location: int
    first_map: int
    entry: Entry


@dataclass(frozen=True)
class Root:
    """The dataset in a folder or at a URL, or the concatenated datasets of several of them.

    Attributes:
        locations: the folders and URLs.
        manifests: the manifest of each location.
        map_size: (rows, columns) of all maps.
        movement: rule of movement of all stored paths.
        shards: the finished shards in the order of their maps.
        maps: number of maps when all shards are finished.
    """

    locations: tuple[str, ...]
    manifests: tuple[Manifest, ...]
    map_size: Size
    movement: Movement
    shards: tuple[RootShard, ...]
    maps: int

    @staticmethod
    def open(source: Locations, *, complete: bool = False) -> Root:
        """Return the dataset in ``source``; no shard is opened yet.

        Args:
            source: a folder, a URL, or several of them, whose maps have one size and one movement.
            complete: refuse a dataset that is not finished.

        Raises:
            DatasetNotFoundError: there is no dataset.
            ConnectionError: a URL cannot be reached, and its manifest is not in the cache.
            ShardError: a manifest is damaged.
            ValueError: ``source`` is empty; its datasets differ in map size or movement; a dataset
                is not finished; a URL needs a package that is not installed (the message names
                it).
        """
        names = locations(source)
        manifests = tuple(load_manifest(name) for name in names)
        for name, manifest in zip(names, manifests, strict=True):
            _check_same_maps(names[0], manifests[0], name, manifest)
            if complete and not manifest.complete:
                raise ValueError(
                    f"root: {name} is not finished: run the command that makes it once more"
                )
        shards = []
        map_count = 0
        for index, manifest in enumerate(manifests):
            shards += [RootShard(index, map_count, entry) for entry in manifest.shards]
            map_count += manifest.maps
        return Root(
            locations=names,
            manifests=manifests,
            map_size=manifests[0].map_size,
            movement=manifests[0].movement,
            shards=tuple(shards),
            maps=map_count,
        )

    @property
    def resolution(self) -> float:
        """Metres per cell of all maps.

        Raises:
            ValueError: the datasets of several locations have different ones.
        """
        first = self.manifests[0].resolution
        for manifest in self.manifests:
            if manifest.resolution != first:
                raise ValueError(
                    f"root: {self} have resolutions {first} and {manifest.resolution}; take those "
                    "of one alone"
                )
        return first

    def check_begun(self) -> None:
        """Refuse a dataset without any finished shard, such as a failed build leaves behind.

        Raises:
            ValueError: the message names the location, and says what to do.
        """
        for location, manifest in zip(self.locations, self.manifests, strict=True):
            if not manifest.shards:
                raise ValueError(
                    f"root: {location} holds none of its {manifest.maps} maps yet: no shard is "
                    "finished. Wait for the build that runs, or run the command that makes it once "
                    "more: it goes on, or says what stops it"
                )

    def __repr__(self) -> str:
        return f"Root({', '.join(map(repr, (*self.locations, *self.manifests)))})"

    def __str__(self) -> str:
        """Return the folders and URLs."""
        return ", ".join(self.locations)

    def open_shard(self, k: int) -> Shard:
        """Return shard ``k``, checked; a shard at a URL is fetched first.

        Raises:
            ShardError: it is missing, damaged, or holds other maps than the manifest says.
            DatasetNotFoundError: its URL has no such file.
            ConnectionError: its URL cannot be reached.
        """
        root_shard = self.shards[k]
        entry = root_shard.entry
        location = self.locations[root_shard.location]
        manifest = self.manifests[root_shard.location]
        path = local_shard_path(location, entry)
        try:
            shard = open_shard(path, entry.bytes, entry.sha256)
        except FileNotFoundError:
            raise ShardError(
                f"{path}: missing; 'mapdata verify {location}' tells what else is"
            ) from None
        has_header = shard.header == manifest.header(*entry.limits)
        if not has_header or shard.content_hash != entry.content_hash:
            raise ShardError(f"{path}: holds other maps than the manifest says; {REPAIRS}")
        return shard

    def shard_labels(self, k: int) -> Labels:
        """Return the maps of shard ``k`` with their labels; map numbers are those of the root.

        Raises:
            ShardError, DatasetNotFoundError, ConnectionError: as `open_shard`.
        """
        labels = decode(self.open_shard(k))
        index = labels.maps.index + self.shards[k].first_map
        return replace(labels, maps=replace(labels.maps, index=index))

    def labels(self, *, progress: bool = False) -> Iterator[Labels]:
        """Yield the maps with their labels, a shard at a time.

        Map numbers are consecutive over several locations: the first map of the second location
        has the number of maps that the first location has when it is finished.

        Raises:
            ShardError, DatasetNotFoundError, ConnectionError: as `open_shard`.
            ValueError: as `check_begun`.
        """
        self.check_begun()
        with bar(progress, sum(manifest.done for manifest in self.manifests)) as advance:
            for k, shard in enumerate(self.shards):
                yield self.shard_labels(k)
                advance(shard.entry.maps)

    def locate(self, index: int) -> tuple[Labels, int]:
        """Return the labels of the shard that holds map ``index``, and the row of the map in them.

        Raises:
            ValueError: the dataset has no such map, or as `check_begun`.
        """
        self.check_begun()
        for k, shard in enumerate(self.shards):
            local_index = index - shard.first_map  # number of the map in its own location
            if shard.entry.start <= local_index < shard.entry.stop:
                return self.shard_labels(k), local_index - shard.entry.start
        raise ValueError(f"index: got {index}, {self} holds maps 0 to {self.maps - 1}")


def _check_same_maps(
    first_location: str, first: Manifest, location: str, manifest: Manifest
) -> None:
    """Refuse a dataset whose map size or movement differs from that of the first location."""
    for name in ("map_size", "movement"):
        expected = getattr(first, name)
        actual = getattr(manifest, name)
        if actual != expected:
            raise ValueError(
                f"root: {location} has {name} {actual}, {first_location} has {expected}; the roots "
                "of one dataset must have one"
            )


def locations(source: Locations) -> tuple[str, ...]:
    """Return the folders and URLs in ``source`` as texts without a slash at the end.

    Raises:
        ValueError: there is none.
    """
    paths = [source] if isinstance(source, (str, os.PathLike)) else source
    if not paths:
        raise ValueError("root: got an empty list, expected at least one dataset")
    texts = [os.fspath(path) for path in paths]
    return tuple(text.rstrip("/") if is_url(text) else str(Path(text)) for text in texts)


def local_path(location: StrPath) -> Path:
    """Return the path of a file or folder, which may not exist.

    Raises:
        ValueError: it is a URL, which as a path would name a folder ``http:``.
    """
    if is_url(os.fspath(location)):
        raise ValueError(f"{location}: a URL, expected a file or folder of this machine")
    return Path(location)


def target_folder(location: StrPath) -> Path:
    """Return the path of a folder that a dataset is written to; it may not exist yet.

    Raises:
        ValueError: it is a URL or a file.
    """
    if is_url(os.fspath(location)):
        raise ValueError(f"root: {location} is a URL, which can only be read; expected a folder")
    folder = Path(location)
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"root: {folder} is a file, expected a folder")
    return folder


def load_manifest(location: str) -> Manifest:
    """Return the manifest of a dataset, read from its folder or fetched from its URL.

    Raises:
        DatasetNotFoundError: there is no dataset.
        ShardError: it is damaged.
        ConnectionError: as `read_dataset_file`.
    """
    if not is_url(location):
        return read_manifest(Path(location))
    return parse_manifest(read_dataset_file(location, MANIFEST), f"{location}/{MANIFEST}")


def read_dataset_file(location: str, name: str) -> bytes:
    """Return the content of a small file of a dataset, such as the manifest.

    If a URL cannot be reached, return the content of the last time that it was fetched.

    Raises:
        FileNotFoundError: there is no such file.
        ConnectionError: the URL cannot be reached, and the file is not in the cache.
        ShardError: it is a link that leads out of the folder, or a file at a URL that is longer
            than `MAX_MANIFEST_BYTES`.
    """
    if not is_url(location):
        return path_in(Path(location), name).read_bytes()
    cached_path = cache_folder(location) / name
    try:
        content = fetch(location, name, MAX_MANIFEST_BYTES)
    except ConnectionError as error:
        if not cached_path.exists():
            raise
        warnings.warn(f"{error}. Going on with what was fetched before", stacklevel=2)
        return cached_path.read_bytes()
    with suppress(OSError):  # The cache may be read-only.
        write_to_cache(cached_path, content)
        sweep_temporaries(cached_path.parent)
    return content


def read_provenance(location: str) -> dict[str, Any]:
    """Return the content of an imported dataset's ``import.json``, without its hash.

    Raises:
        FileNotFoundError: there is no such file.
        ConnectionError: as `read_dataset_file`.
        ValueError: it is damaged.
    """
    path = f"{location}/{PROVENANCE}"
    provenance = parsed_json(path, read_dataset_file(location, PROVENANCE))
    with suppress(RecursionError):  # Deeply nested lists cannot be hashed.
        if isinstance(provenance, dict):
            stated_hash = provenance.pop("hash", None)
            if stated_hash == json_hash(provenance):
                return provenance
    raise ValueError(f"{path}: damaged (its hash does not fit)")


def local_shard_path(location: str, entry: Entry) -> Path:
    """Return the path of a shard; a shard at a URL is fetched to the cache and checked.

    Raises:
        DatasetNotFoundError: the URL has no such file.
        ConnectionError: the URL cannot be reached.
        ShardError: the fetched file does not have the hash that the manifest states; the file is a
            link that leads out of the folder.
    """
    if not is_url(location):
        return path_in(Path(location), entry.name)
    # The name in the cache contains the hash, so a shard that was replaced at the URL has another.
    path = cache_folder(location) / f"{entry.sha256[:16]}-{entry.name}"
    if not _is_cached(path, entry):
        content = fetch(location, entry.name, max_bytes=entry.bytes, min_bytes=entry.bytes)
        if sha256_hex(content) != entry.sha256:
            raise ShardError(
                f"{location}/{entry.name}: what was fetched is damaged (its file hash does not fit)"
            )
        write_to_cache(path, content)
    return path


def _is_cached(path: Path, entry: Entry) -> bool:
    """Return whether a file of the cache has the size and hash of the shard of ``entry``."""
    if file_size(path) != entry.bytes:
        return False
    return has_hash(np.memmap(path, np.uint8, "r"), path.stat(), entry.sha256)


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file as 64 hexadecimal digits."""
    return sha256_hex(path.read_bytes())
