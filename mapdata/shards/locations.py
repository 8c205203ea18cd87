"""Locations of datasets: folders and URLs, as texts and as paths."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from mapdata.shards.files import StrPath

Locations = StrPath | Sequence[StrPath]
"""Where a dataset is: a folder, a URL, or several of them."""


def is_url(location: str) -> bool:
    """Return whether the location of a dataset is a URL rather than a folder."""
    return "://" in location


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
