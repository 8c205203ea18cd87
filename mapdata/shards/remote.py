"""Roots that are URLs: manifest and shards are fetched once to a local cache and checked against their hashes."""

from __future__ import annotations

import hashlib
from pathlib import Path

from mapdata.jit import cache_home
from mapdata.shards.manifest import MANIFEST, MOST_BYTES, DatasetNotFoundError, Entry, parse_manifest
from mapdata.shards.shard import ShardError, write_file


def is_url(root: str) -> bool:
    """Return whether ``root`` is a URL rather than a folder."""
    return "://" in root


def local_root(root: str) -> Path:
    """Return the folder of a root; for a URL that of its cache, with the present manifest in it.

    Raises:
        DatasetNotFoundError: no dataset there.
        ValueError: the URL needs a package that is not installed (the message names it).
        ShardError: the manifest is damaged.
    """
    if not is_url(root):
        return Path(root)
    folder = _cache(root)
    text = _fetch(f"{root.rstrip('/')}/{MANIFEST}", root, MOST_BYTES)
    parse_manifest(text.decode(errors="replace"), root)
    folder.mkdir(parents=True, exist_ok=True)
    write_file(folder / MANIFEST, text)
    return folder


def local_file(root: str, entry: Entry) -> Path:
    """Return the local file of a shard, fetched and checked if need be.

    Raises:
        ShardError: what was fetched does not have the hash that the manifest states.
    """
    if not is_url(root):
        return Path(root) / entry.name
    path = _cache(root) / f"{entry.sha256[:16]}-{entry.name}"
    if not path.exists() or path.stat().st_size != entry.bytes:
        data = _fetch(f"{root.rstrip('/')}/{entry.name}", root, entry.bytes)
        if hashlib.sha256(data).hexdigest() != entry.sha256:
            raise ShardError(f"{root}/{entry.name}: what was fetched is damaged (its file hash does not fit)")
        write_file(path, data)
    return path


def _cache(root: str) -> Path:
    """Return the cache folder of a URL."""
    return cache_home() / "mapdata" / "remote" / hashlib.sha256(root.rstrip("/").encode()).hexdigest()[:24]


def _fetch(url: str, root: str, most: int) -> bytes:
    """Return the content of a URL, and no more of it than one byte above ``most``."""
    import fsspec

    try:
        with fsspec.open(url, "rb") as file:
            return bytes(file.read(most + 1))
    except ImportError as error:
        raise ValueError(f"root: {root} needs another package: {error}") from None
    except ValueError as error:  # a protocol that fsspec does not know
        raise ValueError(f"root: {root}: {error}") from None
    except Exception as error:  # each file system has its own errors, and what went wrong may lie behind one of them
        cause = error.__cause__ or error
        missing = isinstance(cause, FileNotFoundError) or getattr(cause, "status", None) == 404
        why = "was not found" if missing else f"could not be read: {cause}"
        raise DatasetNotFoundError(root, f"{url} {why}") from error
