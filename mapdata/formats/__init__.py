"""Foreign formats, one file each, and how one is recognised.

`read_any` reads what somebody brings, `export` writes what somebody takes away; docs/formats.md describes each format.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

from mapdata.formats import huggingface, images, movingai, paper, planning, ros
from mapdata.formats.collection import Collection, ForeignMap
from mapdata.formats.files import FormatError, Limits, empty_target, walk
from mapdata.formats.importing import import_maps
from mapdata.formats.stored import Stored

__all__ = [
    "READERS",
    "WRITERS",
    "Collection",
    "ForeignMap",
    "FormatError",
    "Limits",
    "export",
    "import_maps",
    "read_any",
    "recognise",
]

READERS: dict[str, Callable[..., Collection]] = {
    "paper": paper.read,
    "movingai": movingai.read,
    "ros": ros.read,
    "planning-datasets": planning.read,
    "images": images.read,
}
"""Formats that can be read; each takes a path and `Limits`, and its own options by name."""

WRITERS: dict[str, Callable[..., list[str]]] = {
    "paper": paper.write,
    "movingai": movingai.write,
    "ros": ros.write,
    "planning-datasets": planning.write,
    "huggingface": huggingface.write,
}
"""Formats that can be written; each takes a target, a `Stored` and its own options by name."""

OPTIONS = {
    "movingai": ("scen", "maps"),
    "ros": ("unknown",),
    "images": ("threshold", "invert", "size", "fit"),
}
"""Options of the readers."""


def recognise(source: str | os.PathLike[str]) -> str:
    """Return the name of the format of a file or folder.

    Raises:
        FormatError: nothing there, or no known format, or files of more than one; the message says what was found.
    """
    source = Path(source)
    if not source.exists():
        raise FormatError(f"{source}: no such file or folder")
    if paper.is_release(source):
        return "paper"
    endings = {
        **dict.fromkeys((".map", ".scen"), "movingai"),
        **dict.fromkeys((".yaml", ".yml"), "ros"),
        **dict.fromkeys((*images.PICTURES, *images.ARRAYS), "images"),
    }
    paths = walk(source, tuple(endings)) if source.is_dir() else [source]
    known = [path for path in paths if path.suffix.lower() in endings]
    found = {"planning-datasets" if planning.is_planning(path) else endings[path.suffix.lower()] for path in known}
    if "ros" in found:
        found -= {"images"}  # the pictures that the .yaml files name
    if len(found) != 1:
        what = f"files of {' and '.join(sorted(found))}" if found else "no file of a known format"
        raise FormatError(f"{source}: holds {what}; --format says which to read ({', '.join(READERS)})")
    if found == {"images"} and source.is_dir() and any(path.suffix.lower() == ".csv" for path in source.iterdir()):
        # perhaps a release with other headers: its pictures have the other polarity
        advice = "--format paper says what is missing, --format images reads the pictures alone"
        raise FormatError(f"{source}: holds a .csv without the paper's columns; {advice}")
    return found.pop()


def read_any(
    source: str | os.PathLike[str], kind: str | None = None, limits: Limits = Limits(), **options: object
) -> Collection:
    """Read a file or folder of a foreign format.

    Args:
        source: file or folder.
        kind: one of ``READERS``; default what `recognise` says.
        limits: of what is read.
        options: those of the format's ``read``; None is as if not given.

    Raises:
        FormatError: what cannot be read.
        ValueError: an unknown format, or an option that the format does not have.
    """
    source = Path(source)
    name = kind or recognise(source)
    if name not in READERS:
        raise ValueError(f"format: got {name!r}, expected one of {', '.join(READERS)}")
    given = {key: value for key, value in options.items() if value is not None}
    for key in given:
        if key not in OPTIONS.get(name, ()):
            raise ValueError(f"--{key}: does nothing for format {name}")
    found = READERS[name](source, limits, **given)
    if not found.maps and not found.left_out:
        raise FormatError(f"{source}: holds no map of format {name}")
    return found


def export(
    root: str | os.PathLike[str],
    target: str | os.PathLike[str],
    kind: str,
    *,
    image: str | None = None,
    progress: bool = False,
) -> list[str]:
    """Write a dataset in a foreign format; ``target`` appears when it is complete.

    Args:
        root: folder of the dataset.
        target: new name, or an empty folder; for planning-datasets a name that ends with .npz.
        kind: one of ``WRITERS``.
        image: "pgm", "png" or "bmp", for ros.
        progress: show a progress bar.

    Returns:
        Notes for the user.

    Raises:
        DatasetNotFoundError: there is no dataset under ``root``.
        ShardError: it is damaged.
        ValueError: an unknown format, or what it cannot hold.
        OSError: the disk is full or may not be written to.
    """
    target = Path(target)
    if kind not in WRITERS:
        raise ValueError(f"format: got {kind!r}, expected one of {', '.join(WRITERS)}")
    if image is not None and kind != "ros":
        raise ValueError(f"--image: does nothing for format {kind}")
    if kind == "planning-datasets" and target.suffix != ".npz":
        raise ValueError(f"{target}: expected a name that ends with .npz")
    source = Stored.open(Path(root), progress=progress)
    empty_target(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{os.getpid()}-{target.name}")
    try:
        notes = WRITERS[kind](temporary, source, **({} if image is None else {"image": image}))
        if target.is_dir():
            target.rmdir()
        os.replace(temporary, target)
    finally:
        if temporary.is_dir():
            shutil.rmtree(temporary, ignore_errors=True)
        else:
            temporary.unlink(missing_ok=True)
    return notes
