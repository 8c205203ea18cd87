"""``export.json``, which says what an export holds, and the comparison of an export with it.

These entries cover every file of the folder but ``export.json`` itself and ``README.md``, which a
user may edit:

- ``files``: of each array its dtype, shape and the SHA-256 of its numbers; of another file of
  problems the SHA-256 of the file. ``ARCHIVE.npz/NAME`` is an array of an archive.
- ``header_hashes``: of each ``.npy`` file the SHA-256 of the bytes before its numbers.
- ``file_hashes``: of each other file the SHA-256.
- ``content_hash``: the hash of ``files``, and ``hash`` that of all other entries.

``format_version`` is 2. Exports of mapdata 0.2 have neither this entry, nor hashes of headers,
other files and ``export.json``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mapdata.hashing import json_hash, parsed_json, sha256_hex
from mapdata.npy import Npz, open_npy
from mapdata.shards.files import StrPath, file_hash
from mapdata.shards.manifest import path_in, provenance_text

ABOUT = "export.json"
"""The file beside the data that says what they are and where they come from."""

CARD = "README.md"

FORMAT_VERSION = 2

_NEW_ENTRIES = ("format_version", "header_hashes", "file_hashes", "hash")
"""The entries that exports of mapdata 0.2 do not have."""

_NOT_OURS = "no file of this export: keep it elsewhere"


def write_about(folder: Path, about: dict[str, Any]) -> None:
    """Write ``export.json``, with the hashes of the files of a finished export.

    Args:
        folder: of the export.
        about: the other entries; among them ``files``.
    """
    header_hashes = {}
    file_hashes = {}
    for path in _files(folder):
        name = path.relative_to(folder).as_posix()
        if name not in about["files"]:
            file_hashes[name] = file_hash(path)
        elif path.suffix == ".npy":
            header_hashes[name] = _header_hash(path, _header_size(path))
    entries = {
        "format_version": FORMAT_VERSION,
        **about,
        "header_hashes": header_hashes,
        "file_hashes": file_hashes,
    }
    (folder / ABOUT).write_text(provenance_text(entries), encoding="utf-8")


def verify_export(folder: StrPath) -> list[str]:
    """Return what is wrong with an export, one line for each file, or an empty list.

    Every file but the card, ``README.md``, is compared with the hashes in ``export.json``. They
    cover each bit, except in exports of mapdata 0.2, which state fewer hashes: of these the content
    of all arrays, tables and lines of problems is compared.

    Args:
        folder: the folder that `export_problems` wrote.

    Raises:
        FileNotFoundError: it has no ``export.json``.
    """
    folder = Path(folder)
    path = folder / ABOUT
    text = path.read_bytes()
    faults = []
    try:
        about = parsed_json(str(path), text)
        # Damage to the number itself must not make an export pass for one of mapdata 0.2.
        is_first = about.keys().isdisjoint(_NEW_ENTRIES)
        version = about.get("format_version", FORMAT_VERSION)
        if not is_first and version != FORMAT_VERSION:
            return [
                f"{path}: has format_version {version!r}, expected 1 to {FORMAT_VERSION}: install "
                "a newer version of mapdata"
            ]
        if not is_first:
            entries = {name: entry for name, entry in about.items() if name != "hash"}
            if text != provenance_text(entries).encode():
                return [f"{path}: damaged (its hash does not fit)"]
        if about["content_hash"] != json_hash(about["files"]):
            faults.append(f"{path}: damaged (its content hash does not fit)")
        header_hashes = about.get("header_hashes", {})
        file_hashes = about.get("file_hashes", {})
        for name, stated in about["files"].items():
            # The hash of an archive covers its arrays.
            if name.rpartition("/")[0] not in file_hashes:
                faults += _faults(folder, name, _content_fault, stated, header_hashes.get(name))
        for name, stated in file_hashes.items():
            faults += _faults(folder, name, _file_fault, stated)
        if not is_first:
            known = {*about["files"], *file_hashes}
            faults += [
                f"{path}: {_NOT_OURS}"
                for path in _files(folder)
                if path.relative_to(folder).as_posix() not in known
            ]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        faults.append(f"{path}: damaged ({type(error).__name__}: {error})")
    return faults


def _files(folder: Path) -> list[Path]:
    """Return the files that an export of ``folder`` consists of, except for its JSON and card.

    Hidden files and folders are those of other programs.
    """
    paths = []
    for path in sorted(folder.rglob("*")):
        parts = path.relative_to(folder).parts
        is_hidden = any(part.startswith(".") for part in parts)
        if not path.is_dir() and not is_hidden and parts not in ((ABOUT,), (CARD,)):
            paths.append(path)
    return paths


def _faults(folder: Path, name: str, find: Callable[..., str | None], *stated: object) -> list[str]:
    """Return the fault of a file, if any, that ``find(folder, name, *stated)`` tells, as a line."""
    path = folder / name
    try:
        if ".." in Path(name).parts or Path(name).is_absolute():
            return [f"{folder / ABOUT}: damaged (it names the file {name!r})"]
        description = find(folder, name, *stated)
    except FileNotFoundError:
        description = "missing"
    except (OSError, ValueError) as error:
        description = str(error).removeprefix(f"{path}: ")
    return [] if description is None else [f"{path}: {description}"]


def _content_fault(
    folder: Path, name: str, stated: dict[str, Any], header_hash: str | None
) -> str | None:
    """Return what is wrong with an array, or with another file of problems."""
    archive, separator, member = name.rpartition(".npz/")
    if separator:
        path = path_in(folder, f"{archive}.npz")
        if not path.is_file():
            return "missing"
        (array,) = Npz(path, sys.maxsize).arrays(member)
    elif name.endswith(".npy"):
        path = path_in(folder, name)
        if not path.is_file():
            return "missing"
        array = open_npy(path)
    else:
        return _file_fault(folder, name, stated["sha256"])
    shape = list(array.shape)
    if array.dtype.name != stated["dtype"] or shape != stated["shape"] or array.is_fortran:
        return (
            f"holds {array.dtype.name} of shape {shape}, {ABOUT} says {stated['dtype']} of shape "
            f"{stated['shape']}"
        )
    if header_hash is not None and _header_hash(array.path, array.offset) != header_hash:
        return "damaged (the hash of its header does not fit)"
    if array.sha256() != stated["sha256"]:
        return f"damaged (the hash in {ABOUT} does not fit)"
    return None


def _file_fault(folder: Path, name: str, stated: str) -> str | None:
    """Return what is wrong with a file whose hash is stated."""
    fits = file_hash(path_in(folder, name)) == stated
    return None if fits else f"damaged (the hash in {ABOUT} does not fit)"


def _header_hash(path: Path, size: int) -> str:
    """Return the SHA-256 of the bytes of an ``.npy`` file before its numbers."""
    with open(path, "rb") as file:
        return sha256_hex(file.read(size))


def _header_size(path: Path) -> int:
    """Return the number of bytes before the numbers of an ``.npy`` file that was just written.

    They are 6 bytes of a name, 2 of a version, the length of a text, and the text. The length has 2
    bytes in version 1 and 4 bytes in later ones.

    Source: https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html.
    """
    with open(path, "rb") as file:
        version = file.read(8)[6]
        length_size = 2 if version == 1 else 4
        length = int.from_bytes(file.read(length_size), "little")
    return 8 + length_size + length
