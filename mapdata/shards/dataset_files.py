"""Files of a dataset, read from its folder or fetched from its URL.

The files of a dataset at a URL are fetched to a local cache and checked against their hashes. A
shard is fetched only once.
"""

from __future__ import annotations

import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from mapdata.hashing import json_hash, parsed_json, sha256_hex
from mapdata.shards.errors import ShardError
from mapdata.shards.files import file_size, sweep_temporaries
from mapdata.shards.locations import is_url
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
from mapdata.shards.reader import has_hash
from mapdata.shards.remote import cache_folder, fetch, write_to_cache


def load_manifest(location: str, follow_links: bool = False) -> Manifest:
    """Return the manifest of a dataset, read from its folder or fetched from its URL.

    Args:
        location: the folder or URL.
        follow_links: read links that lead out of the folder.

    Raises:
        DatasetNotFoundError: there is no dataset.
        ShardError: it is damaged.
        ConnectionError: as `read_dataset_file`.
    """
    if not is_url(location):
        return read_manifest(Path(location), follow_links)
    return parse_manifest(read_dataset_file(location, MANIFEST), f"{location}/{MANIFEST}")


def read_dataset_file(location: str, name: str, follow_links: bool = False) -> bytes:
    """Return the content of a small file of a dataset, such as the manifest.

    If a URL cannot be reached, return the content of the last time that it was fetched.

    Args:
        location: the folder or URL of the dataset.
        name: of the file.
        follow_links: read a link that leads out of the folder.

    Raises:
        FileNotFoundError: there is no such file.
        ConnectionError: the URL cannot be reached, and the file is not in the cache.
        ShardError: it is a link that leads out of the folder, or a file at a URL that is longer
            than `MAX_MANIFEST_BYTES`.
    """
    if not is_url(location):
        return path_in(Path(location), name, follow_links).read_bytes()
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


def read_provenance(location: str, follow_links: bool = False) -> dict[str, Any]:
    """Return the content of an imported dataset's ``import.json``, without its hash.

    Args:
        location: the folder or URL of the dataset.
        follow_links: read a link that leads out of the folder.

    Raises:
        FileNotFoundError: there is no such file.
        ConnectionError: as `read_dataset_file`.
        ValueError: it is damaged.
    """
    path = f"{location}/{PROVENANCE}"
    provenance = parsed_json(path, read_dataset_file(location, PROVENANCE, follow_links))
    with suppress(RecursionError):  # Deeply nested lists cannot be hashed.
        if isinstance(provenance, dict):
            stated_hash = provenance.pop("hash", None)
            if stated_hash == json_hash(provenance):
                return provenance
    raise ValueError(f"{path}: damaged (its hash does not fit)")


def local_shard_path(location: str, entry: Entry, follow_links: bool = False) -> Path:
    """Return the path of a shard; a shard at a URL is fetched to the cache and checked.

    Args:
        location: the folder or URL of the dataset.
        entry: of the shard.
        follow_links: accept a link that leads out of the folder.

    Raises:
        DatasetNotFoundError: the URL has no such file.
        ConnectionError: the URL cannot be reached.
        ShardError: the fetched file does not have the hash that the manifest states; the file is a
            link that leads out of the folder.
    """
    if not is_url(location):
        return path_in(Path(location), entry.name, follow_links)
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
