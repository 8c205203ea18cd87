"""`Format`, the table of all formats, and reading and writing any of them."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from mapdata.checks import check_choice
from mapdata.formats.collection import Collection
from mapdata.formats.files import LIMITS, Limits, files_of
from mapdata.npy import FormatError
from mapdata.options import options_of
from mapdata.problems.problem_set import ProblemSet
from mapdata.shards.files import StrPath, make_folder, sweep_temporaries, temporary_folder
from mapdata.shards.locations import Locations, local_path
from mapdata.shards.root import Root


@dataclass(frozen=True)
class Format:
    """A foreign format. The keyword-only parameters of ``read`` and ``write`` are its options.

    Attributes:
        name: as ``--format`` takes it.
        endings: of its files, in lower case.
        read: called with a path and `Limits`, returns a `Collection`; None if it can only be
            written.
        write: called with a target, a `Root` and whether to show a progress bar, returns notes for
            the user; None if it can only be read.
        problems: called with a path and `Limits`, returns the `ProblemSet` of a file; None if
            it has none.
        is_mine: whether a file with one of the endings is of this format.
        beside: endings of files that belong to it where they lie beside its own: the pictures of a
            ROS map.
        target_ending: the ending of the one file that it writes; empty if it writes a folder.
    """

    name: str
    endings: tuple[str, ...] = ()
    read: Callable[..., Collection] | None = None
    write: Callable[..., list[str]] | None = None
    problems: Callable[..., ProblemSet] | None = None
    is_mine: Callable[[Path], bool] = Path.is_file
    beside: tuple[str, ...] = ()
    target_ending: str = ""


What = Literal["read", "write", "problems"]
"""The functions that a format may have."""

FORMATS: dict[str, Format] = {}
"""All formats by name. Where several know a file as theirs, the last one has it."""


def register(one: Format) -> None:
    """Make a format known.

    Raises:
        ValueError: its name is taken.
    """
    if FORMATS.setdefault(one.name, one) != one:
        raise ValueError(f"{one.name!r} is the name of another format")


def functions(what: What) -> dict[str, Callable[..., Any]]:
    """Return what reads, what writes, or what gives problems, by the name of the format."""
    return {name: getattr(one, what) for name, one in FORMATS.items() if getattr(one, what)}


def recognise(source: StrPath) -> str:
    """Return the name of the format of a file or folder.

    Raises:
        FormatError: nothing there, or no known format, or files of more than one; the message says
            what was found.
        ValueError: a URL.
    """
    source = local_path(source)
    endings = tuple(ending for one in FORMATS.values() for ending in one.endings)
    owners = {}
    for path in files_of(source, endings, LIMITS, Collection()):
        for one in FORMATS.values():
            if path.suffix.lower() in one.endings and path.is_file() and one.is_mine(path):
                owners[path] = one
    # the pictures of a ROS map do not make its folder one of images too
    beside = {ending for one in owners.values() for ending in one.beside}
    found = {one.name for path, one in owners.items() if path.suffix.lower() not in beside}
    if len(found) != 1:
        what = f"files of {' and '.join(sorted(found))}" if found else "no file of a known format"
        raise FormatError(
            f"{source}: holds {what}; --format says which to read ({', '.join(functions('read'))})"
        )
    return found.pop()


def read_any(
    source: StrPath,
    kind: str | None = None,
    limits: Limits = LIMITS,
    **options: object,
) -> Collection:
    """Read a file or folder of a foreign format.

    Args:
        source: file or folder.
        kind: name of a format that can be read; default what `recognise` says.
        limits: of what is read, and whether a progress bar shows it.
        options: those of the format's ``read``.

    Raises:
        FormatError: what cannot be read.
        ValueError: a URL, an unknown format, or an option that the format does not have.
    """
    source = local_path(source)
    name = kind or recognise(source)
    found: Collection = _checked("read", name, options)(source, limits, **options)
    if not found.maps and not found.left_out:
        raise FormatError(f"{source}: holds no map of format {name}")
    found.format = name
    found.source = str(source)
    return found


def read_problems(source: StrPath, limits: Limits = LIMITS, **options: object) -> ProblemSet:
    """Read the problems of a file, to compare planners on.

    That is a MovingAI .scen, an .npz of planning-datasets, or one that `ProblemSet.save` wrote.

    Args:
        source: the file.
        limits: of what is read, and whether a progress bar shows it.
        options: those of the format's ``problems``, such as ``count``.

    Raises:
        ValueError: no such file, no problems in it, or bad ones; the message names the file.
    """
    name = recognise(source)
    if name in functions("problems"):
        found: ProblemSet = _checked("problems", name, options)(Path(source), limits, **options)
        return found
    if options:
        raise ValueError(f"{', '.join(options)}: would do nothing beside a saved set of problems")
    return ProblemSet.load(source)


def export(
    root: Locations,
    target: StrPath,
    kind: str,
    *,
    progress: bool = False,
    **options: object,
) -> list[str]:
    """Write a dataset in a foreign format; ``target`` appears when it is complete.

    What exports left beside it that were killed is removed.

    Args:
        root: folder or URL of the dataset, or several.
        target: new name, or an empty folder; for planning-datasets a name that ends with .npz.
        kind: name of a format that can be written.
        progress: show a progress bar.
        options: those of the format's ``write``.

    Returns:
        Notes for the user.

    Raises:
        DatasetNotFoundError: there is no dataset under ``root``.
        ShardError: it is damaged.
        ValueError: a target that is a URL, an unknown format or option, or what the format cannot
            hold.
        OSError: the disk is full or may not be written to.
    """
    target = local_path(target)
    write = _checked("write", kind, options)
    ending = FORMATS[kind].target_ending
    if not target.name.endswith(ending):
        raise ValueError(f"{target}: expected a name that ends with {ending}")
    if target.name in ("", ".."):
        raise FormatError(f"{target}: expected the name of the file or folder to write")
    source = Root.open(root, complete=True)
    is_empty = target.is_dir() and not any(target.iterdir())
    if target.exists() and not is_empty:
        raise FormatError(f"{target}: exists already, expected a new name or an empty folder")
    make_folder(target.parent)
    sweep_temporaries(target.parent)
    with temporary_folder(target) as folder:
        temporary = folder / "export"
        notes: list[str] = write(temporary, source, progress, **options)
        if target.is_dir():
            target.rmdir()  # it is empty; a file cannot replace a folder
        os.replace(temporary, target)
    return notes


def _checked(what: What, name: str, options: dict[str, object]) -> Callable[..., Any]:
    """Return what reads or writes a format, after checking the name and the options.

    Raises:
        ValueError: no such format, or an option or value that it does not have.
    """
    known = functions(what)
    check_choice("format", name, known)
    accepted = options_of(known[name])
    for key, value in options.items():
        if key not in accepted:
            raise ValueError(f"{key}: does nothing for format {name}")
        kind, default, _ = accepted[key]
        if get_origin(kind) is Literal and value is not default:
            check_choice(key, value, get_args(kind))
    return known[name]
