"""`Format`, the table of all formats, and reading and writing any of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from mapdata.checks import check_choice, did_you_mean
from mapdata.formats.collection import Collection
from mapdata.formats.files import LIMITS, Limits, files_with_endings
from mapdata.npy import FormatError
from mapdata.options import options_of
from mapdata.problems.problem_set import ProblemSet
from mapdata.shards.files import StrPath, new_output
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
        problems: called with a path and `Limits`, returns the `ProblemSet` of a file or folder;
            None if it has none.
        recognises: called with a path with one of the endings; returns whether the file is of this
            format.
        companion_endings: endings of files that belong to this format where they lie in the folder
            of one of its files, such as the pictures of a ROS map.
        target_ending: the ending of the one file that it writes; empty if it writes a folder.
        why_unread: of a format that is recognised and not read, what to do instead.
    """

    name: str
    endings: tuple[str, ...] = ()
    read: Callable[..., Collection] | None = None
    write: Callable[..., list[str]] | None = None
    problems: Callable[..., ProblemSet] | None = None
    recognises: Callable[[Path], bool] = Path.is_file
    companion_endings: tuple[str, ...] = ()
    target_ending: str = ""
    why_unread: str = ""


Operation = Literal["read", "write", "problems"]
"""The names of the functions that a format may have."""

FORMATS: dict[str, Format] = {}
"""All formats by name. If several formats recognise a file, it belongs to the last of them."""


def register(new_format: Format) -> None:
    """Make a format known.

    Raises:
        ValueError: its name is taken.
    """
    if FORMATS.setdefault(new_format.name, new_format) != new_format:
        raise ValueError(f"{new_format.name!r} is the name of another format")


def functions_by_format(operation: Operation) -> dict[str, Callable[..., Any]]:
    """Return the functions that read, write or give problems, by the name of their format.

    Formats without such a function are absent.
    """
    functions = {}
    for name, known_format in FORMATS.items():
        function = getattr(known_format, operation)
        if function is not None:
            functions[name] = function
    return functions


def recognise(source: StrPath, limits: Limits = LIMITS) -> str:
    """Return the name of the format of a file or folder.

    Args:
        source: file or folder.
        limits: of the number of files; they also say whether links are followed.

    Raises:
        FormatError: there is no such file or folder, or it holds no file of a known format, or
            files of several formats; the message names them.
        ValueError: a URL.
    """
    source = local_path(source)
    all_endings = tuple(
        ending for known_format in FORMATS.values() for ending in known_format.endings
    )
    format_by_path: dict[Path, Format] = {}
    unrecognised: list[Path] = []
    collection = Collection()
    for path in files_with_endings(
        source, all_endings, replace(limits, progress=False), collection
    ):
        for known_format in FORMATS.values():
            has_ending = path.suffix.lower() in known_format.endings
            if has_ending and path.is_file() and known_format.recognises(path):
                format_by_path[path] = known_format  # the last format that recognises it stays
        if path not in format_by_path:
            unrecognised.append(path)
    # The pictures of a ROS map do not make its folder a folder of images too.
    companion_endings = {
        ending
        for known_format in format_by_path.values()
        for ending in known_format.companion_endings
    }
    names = {
        known_format.name
        for path, known_format in format_by_path.items()
        if path.suffix.lower() not in companion_endings
    }
    if not names and collection.left_out:
        raise FormatError(_no_map_message(source, "known", collection))
    if not names:
        raise FormatError(
            f"{source}: holds no file of a known format{_advice(source, unrecognised, limits)}"
        )
    if len(names) > 1:
        raise FormatError(
            f"{source}: holds files of {' and '.join(sorted(names))}; --format says which to read"
        )
    return names.pop()


def _advice(source: Path, unrecognised: list[Path], limits: Limits) -> str:
    """Return the end of the error that no file is of a known format: what can be done.

    No format recognises the files ``unrecognised``, which have a known ending.
    """
    if _has_pointers_of_dvc(source, limits):
        return "; its .dvc files are pointers of DVC to other files: dvc pull fetches them"
    known_formats = [known_format for known_format in FORMATS.values() if known_format.read]
    for path in unrecognised:
        ending = path.suffix.lower()
        for known_format in known_formats:
            if ending in known_format.endings and known_format.read:
                try:
                    collection = known_format.read(path, replace(limits, progress=False))
                    reasons = [reason for _, reason in collection.left_out]
                except ValueError as error:
                    reasons = [str(error).removeprefix(f"{path}: ")]
                if reasons:
                    return f"; --format {known_format.name} refuses {path.name}: {reasons[0]}"
                return (
                    f"; {path.name} has the ending of {known_format.name}: --format "
                    f"{known_format.name} reads it"
                )
    endings = sorted({ending for each in known_formats for ending in each.endings})
    return f"; expected files that end with {', '.join(endings)}"


def _has_pointers_of_dvc(source: Path, limits: Limits) -> bool:
    """Return whether a file is a pointer of DVC, or whether one is below a folder."""
    paths = files_with_endings(source, (".dvc",), replace(limits, progress=False), Collection())
    return any(path.suffix == ".dvc" for path in paths)


def read_any(
    source: StrPath,
    format_name: str | None = None,
    limits: Limits = LIMITS,
    *,
    follow_links: bool = False,
    **options: object,
) -> Collection:
    """Read a file or folder of a foreign format.

    Args:
        source: file or folder.
        format_name: name of a format that can be read; by default `recognise` finds it.
        limits: of what is read, and whether a progress bar shows it.
        follow_links: read files and folders that are links out of the folder, as
            ``Limits(follow_links=True)`` does. Only for folders of your own: a stranger's may have
            links to any file of this machine.
        options: those of the format's ``read``.

    Returns:
        The maps, at least one, with the names and reasons of those that were left out.

    Raises:
        FormatError: what cannot be read; no map is left, and the message says why.
        ValueError: a URL, an unknown format, or an option that the format does not have.
    """
    source = local_path(source)
    limits = replace(limits, follow_links=follow_links or limits.follow_links)
    name = format_name or recognise(source, limits)
    read = checked_function("read", name, options)
    collection: Collection = read(source, limits, **options)
    if not collection.maps:
        raise FormatError(_no_map_message(source, name, collection))
    collection.format = name
    collection.source = str(source)
    return collection


def _no_map_message(source: Path, format_name: str, collection: Collection) -> str:
    """Return why a file or folder gave no map: the first three reasons."""
    if not collection.left_out:
        return f"{source}: holds no map of format {format_name}"
    reasons = [f"{name}: {reason}" for name, reason in collection.left_out[:3]]
    message = "; ".join(reasons)
    if len(collection.left_out) > len(reasons):
        message += f"; and {len(collection.left_out) - len(reasons)} more"
    return f"no map can be used: {message}"


def read_problems(
    source: StrPath, limits: Limits = LIMITS, *, follow_links: bool = False, **options: object
) -> ProblemSet:
    """Read the problems of a file or folder, to compare planners on or to train on.

    That is a MovingAI .scen, an .npz of planning-datasets or of tile-based sets, a folder of
    TransPath or of Warcraft sets, or an .npz that `ProblemSet.save` wrote.
    `mapdata.ProblemSetDataset` serves them as torch samples.

    Args:
        source: the file or folder.
        limits: of what is read, and whether a progress bar shows it.
        follow_links: as in `read_any`.
        options: those of the format's ``problems``: ``count`` and ``maps`` of a .scen, ``seed`` of
            planning-datasets, ``split`` and ``count`` of TransPath, and these and ``unit`` of
            Warcraft and tile-based sets.

    Raises:
        ValueError: no such file, no problems in it, or bad ones; the message names the file.
    """
    limits = replace(limits, follow_links=follow_links or limits.follow_links)
    name = recognise(source, limits)
    if name in functions_by_format("problems"):
        read = checked_function("problems", name, options)
        problems: ProblemSet = read(Path(source), limits, **options)
        return problems
    if Path(source).suffix.lower() != ".npz":
        raise FormatError(
            f"{source}: holds maps of format {name}, without problems; expected a .scen, an .npz "
            "of problems, or a folder of TransPath or Warcraft (read_any reads maps)"
        )
    if options:
        raise ValueError(f"{', '.join(options)}: would do nothing beside a saved set of problems")
    return ProblemSet.load(source)


def export(
    root: Locations,
    target: StrPath,
    format_name: str,
    *,
    follow_links: bool = False,
    progress: bool = False,
    **options: object,
) -> list[str]:
    """Write a dataset in a foreign format; ``target`` appears when it is complete.

    Temporary files that killed exports left in the folder of ``target`` are removed.

    Args:
        root: folder or URL of the dataset, or several.
        target: new name, or an empty folder; for planning-datasets a name that ends with .npz.
        format_name: name of a format that can be written.
        follow_links: read files of the dataset that are links out of their folder.
        progress: show a progress bar.
        options: those of the format's ``write``.

    Returns:
        Notes for the user.

    Raises:
        DatasetNotFoundError: there is no dataset under ``root``.
        ShardError: it is damaged.
        ValueError: a target that is a URL, an unknown format or option, or what the format cannot
            hold: no format has a place for the costs of terrain.
        OSError: the disk is full or may not be written to.
    """
    target = local_path(target)
    write = checked_function("write", format_name, options)
    ending = FORMATS[format_name].target_ending
    if not target.name.endswith(ending):
        raise ValueError(f"{target}: expected a name that ends with {ending}")
    source = Root.open(root, complete=True, follow_links=follow_links)
    if source.has_terrain:
        raise ValueError(
            f"root: {source} has maps with terrain, but {format_name} has no costs of cells; "
            "expected one of the formats arrays, parquet and warcraft"
        )
    with new_output(target) as unfinished:
        notes: list[str] = write(unfinished, source, progress, **options)
    return notes


def checked_function(
    operation: Operation, format_name: str, options: dict[str, object]
) -> Callable[..., Any]:
    """Return the function of a format, after checking that it accepts the options.

    Raises:
        ValueError: no such format, or an option that it does not have, or a bad choice; or the
            format is recognised and not read.
    """
    functions = functions_by_format(operation)
    known_format = FORMATS.get(format_name)
    if operation == "read" and known_format is not None and known_format.why_unread:
        raise FormatError(f"{format_name}: {known_format.why_unread}")
    check_choice("format", format_name, functions)
    function = functions[format_name]
    accepted = options_of(function)
    for name, value in options.items():
        if name not in accepted:
            raise ValueError(
                f"{name}: does nothing for format {format_name}{did_you_mean(name, accepted)}"
            )
        option = accepted[name]
        if get_origin(option.annotation) is Literal and value is not option.default:
            check_choice(name, value, get_args(option.annotation))
    return function
