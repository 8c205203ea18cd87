"""Functions for all command lines: the parser, exit codes, and the summary of a dataset."""

from __future__ import annotations

import argparse
import errno
import io
import os
import re
import shlex
import sys
import threading
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, NoReturn, TextIO, get_args, get_origin

from mapdata.interrupts import EXIT_CODE, STOPPED, THREADS, leave, stoppable

if TYPE_CHECKING:
    from mapdata.options import Option
    from mapdata.shards import Manifest

Command = Callable[..., None]
"""A function that a command line calls: flags and help come from its signature and docstring."""


_DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of a full disk, of a quota that is used up, and of a file beyond a limit."""

_DISK_ADVICE = "; free some room or choose another disk, and run the same command again"

_INPUT_ARGUMENTS = ("root", "src", "source", "file")
"""The arguments of commands that name what they read or build; a command has one of them."""

_MEMORY_ADVICE = {
    "build_command": "take fewer --workers or a smaller --shard-size, ",
    "import_command": "take a smaller --shard-size, import fewer files at once, ",
    "report_command": "take fewer --maps, ",
    "evaluate_command": "take fewer --maps, ",
    "evaluate_planners": "take fewer --maps, ",
    "evaluate_samplers": "take fewer --maps, ",
}
"""What needs less memory, by the name of the function of a command."""


class DisagreeError(Exception):
    """The data are damaged or are not what they should be: exit code 1."""


def summary(
    root: str, manifest: Manifest, seconds: float | None = None, follow_links: bool = False
) -> str:
    """Return the short summary of a dataset, one fact to a line.

    Args:
        root: folder or URL of the dataset.
        manifest: of the dataset.
        seconds: that it took to build; None if it was not built now.
        follow_links: read the record of an import through a link out of the folder.
    """
    from mapdata.describe.dataset_card import (
        TERRAIN_RULE,
        counted,
        generator_text,
        identity_text,
        movement_text,
    )

    done = manifest.done
    size = sum(entry.bytes for entry in manifest.shards)
    segments = max(manifest.total("segments"), 1)
    rows, columns = manifest.map_size
    shards = counted(len(manifest.shards), "shard")
    unfinished = "" if manifest.complete else f" (of {manifest.maps:,}: not finished)"
    lines = {"maps": f"{done:,} of {rows} x {columns} cells in {shards}{unfinished}"}
    if manifest.generator is None:
        lines["splits"] = _split_text(manifest)
    else:
        lines["generator"] = generator_text(manifest.generator)
        lines["seed"] = str(manifest.seed)
    lines["movement"] = movement_text(manifest.movement, manifest.has_terrain)
    lines["resolution"] = _resolution_text(root, manifest, follow_links)
    if manifest.generator is None:
        lines |= _import_summary(root, manifest, follow_links)
    if manifest.has_terrain:
        lines["terrain"] = TERRAIN_RULE
    if seconds is not None:
        lines["rate"] = f"{seconds:.1f} s, {done / seconds:,.0f} maps/s"
    lines["size"] = f"{size / 1e6:,.1f} MB, {size / max(done, 1):.0f} bytes per map"
    drawn = manifest.total("drawn")
    if drawn:  # mazes and imported maps have no passages
        lines["drawn passages"] = f"{drawn / segments:.1%}"
    lines["reachable segments"] = f"{manifest.total('reachable') / segments:.1%}"
    lines["fully connected maps"] = f"{manifest.total('all_connected') / max(done, 1):.1%}"
    lines["identity"] = identity_text(manifest)
    lines["content hash"] = (
        manifest.content_hash
        if manifest.complete
        else f"of the finished dataset only; these {done:,} maps: {manifest.content_hash}"
    )
    example = min(7, max(done - 1, 0))
    flag = " --follow-links" if follow_links else ""
    lines["look"] = f"mapdata show {shlex.quote(root)} --index {example} -o map.png{flag}"
    return "\n".join(f"{name + ':':22}{text}" for name, text in lines.items() if text)


def one_line(root: str, manifest: Manifest) -> str:
    """Return the facts about one of several datasets that an import has made, on one line."""
    from mapdata.describe.dataset_card import counted

    rows, columns = manifest.map_size
    return (
        f"{root}: {counted(manifest.done, 'map')} of {rows} x {columns} cells, "
        f"{_resolution_text(root, manifest)}; {_split_text(manifest)}"
    )


def _resolution_text(root: str, manifest: Manifest, follow_links: bool = False) -> str:
    """Return the metres per cell, and whether an import has assumed them."""
    from mapdata.shards.dataset_files import read_provenance

    text = f"{manifest.resolution:g} m per cell"
    if manifest.generator is None:
        with suppress(OSError, ValueError, TypeError, KeyError):  # as in `_import_summary`
            if read_provenance(root, follow_links).get("resolution_assumed"):
                text += " assumed; import with --resolution to state it"
    return text


def _split_text(manifest: Manifest) -> str:
    """Return the number of maps of each split."""
    from mapdata.limits import SPLITS

    counts = {
        split: sum(entry.counts[split]["maps"] for entry in manifest.shards) for split in SPLITS
    }
    return ", ".join(f"{split} {count:,}" for split, count in counts.items())


def _import_summary(root: str, manifest: Manifest, follow_links: bool) -> dict[str, str]:
    """Return the lines of `summary` that the record of an import gives."""
    from mapdata.checks import printable
    from mapdata.limits import SPLITS
    from mapdata.shards.dataset_files import read_provenance

    lines = {}
    # The file of provenance may be missing, damaged or of an older version, without some entries.
    with suppress(OSError, ValueError, TypeError, KeyError):
        provenance = read_provenance(root, follow_links)
        lines["free cells"] = f"{provenance['free']:.1%}"
        distinct = provenance["distinct"]
        if manifest.done > 1:
            by_split = ", ".join(f"{split} {distinct[split]:,}" for split in SPLITS)
            symmetric = provenance["distinct_up_to_symmetry"]["all"]
            lines["distinct maps"] = (
                f"{distinct['all']:,} of {manifest.done:,} ({symmetric:,} up to symmetry): "
                f"{by_split}"
            )
        lines["source"] = printable(f"{provenance['source']}, format {provenance['format']}")
    return lines


def run(command: Command, *, modules: Sequence[str] = (), **arguments: object) -> None:
    """Import ``modules``, call ``command`` and exit with 0, 1, 2 or, after Ctrl-C, 130.

    An error that a user can correct is printed as one line instead of a traceback. So is a lack of
    memory or of room on the disk; the line says what to do.
    """
    print_all_letters()
    try:
        with stoppable(), warnings.catch_warnings():
            warnings.showwarning = _print_warning
            # No warning for each failed attempt: the final error says how many there were.
            warnings.filterwarnings("ignore", r".*\. Trying again in ")
            for module in modules:
                import_named(module)
            command(**arguments)
            # The output is flushed here, so that a closed pipe is noticed now and not at exit.
            print(end="", flush=True)
    except BrokenPipeError:  # as in: mapdata info ROOT | head -1
        # Python prints the remaining output at exit; it must go nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)  # 128 + SIGPIPE, the code that a shell reports
    except KeyboardInterrupt:  # in a process without `exit_on_interrupt`
        if any(thread.name.startswith(THREADS) for thread in threading.enumerate()):
            leave()
        sys.exit(complain(STOPPED, EXIT_CODE))
    except MemoryError as error:
        sys.exit(complain(_memory_complaint(error, command, arguments), 2))
    except (DisagreeError, ValueError, OSError) as error:
        from mapdata.shards import ShardError  # slow to import, and only needed here

        code = 1 if isinstance(error, (DisagreeError, ShardError)) else 2
        is_disk_full = isinstance(error, OSError) and error.errno in _DISK_FULL
        sys.exit(complain(f"{error}{_DISK_ADVICE if is_disk_full else ''}", code))


def print_all_letters() -> None:
    r"""Let both streams print letters that their encoding lacks, as in ``plans-\u010d``.

    Otherwise such a letter in the path of a file would end a command with an error after its work
    is done: where the output is a file or a pipe, the encoding may be an old one, as on Windows.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # programs such as Jupyter have other streams
            stream.reconfigure(errors="backslashreplace")


def _memory_complaint(error: MemoryError, command: Command, arguments: Mapping[str, object]) -> str:
    """Return what the memory did not suffice for, and what to do."""
    subject = ""
    for name in _INPUT_ARGUMENTS:
        files = arguments.get(name)
        if files:
            subject = f"{', '.join(files) if isinstance(files, list) else files}: "
            break
    reason = f" ({error})" if str(error) else ""
    advice = _MEMORY_ADVICE.get(getattr(command, "__name__", ""), "")
    return (
        f"{subject}the memory does not suffice{reason}; {advice}end other programs, or take a "
        "machine with more memory"
    )


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse the arguments; an unknown flag is refused first, with a similar flag as a hint.

        So is a flag that takes one value and is given twice: argparse would drop the first value.
        """
        from mapdata.checks import did_you_mean

        arguments = sys.argv[1:] if args is None else args
        given = set()
        for argument in arguments:
            flag = argument.partition("=")[0]
            if flag == "--":  # all arguments after it are names, even with dashes
                break
            if not flag.startswith("--"):
                flag = flag[:2]  # -oFILE is the flag -o with its value
            action = self._option_string_actions.get(flag)
            if action is None and flag.startswith("--"):
                hint = did_you_mean(flag, self._option_string_actions)
                self.error(f"unknown flag {flag}{hint}")
            if isinstance(action, argparse._StoreAction):
                if action.dest in given:
                    self.error(f"{flag}: given twice, expected once; leave out one of its values")
                given.add(action.dest)
        return super().parse_known_args(arguments, namespace)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Check that a value is one of the choices; the error names a similar choice as a hint."""
        from mapdata.checks import did_you_mean

        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as error:
            error.message += did_you_mean(value, map(str, action.choices or ()))
            raise

    def error(self, message: str) -> NoReturn:
        """Print an error as one line and exit with code 2."""
        sys.exit(complain(f"{message} ({self.prog} --help says more)", 2))


def parser_of(command: Command, prog: str | None = None, **defaults: object) -> Parser:
    """Return a parser for the arguments of a function, from its signature and docstring.

    Positional parameters become positional arguments, and keyword-only parameters become flags.

    Args:
        command: the function.
        prog: name of the program in help and errors; by default that of the process.
        **defaults: default values, by name, of positional parameters; the user may omit these.
    """
    import inspect

    from mapdata.options import options_of

    text = (inspect.getdoc(command) or "").partition("\nArgs:\n")[0]
    summary, _, examples = text.partition("\n\n")
    parser = Parser(
        prog=prog,
        description=summary,
        epilog=examples.strip(),
        formatter_class=argparse.RawDescriptionHelpFormatter,  # the examples keep their lines
        allow_abbrev=False,
    )
    for name, option in options_of(command, inspect.Parameter.POSITIONAL_OR_KEYWORD).items():
        nargs = "+" if get_origin(option.annotation) is list else None
        if name in defaults:
            nargs = "*" if nargs else "?"
        parser.add_argument(
            name,
            nargs=nargs,
            default=defaults.get(name),
            type=path_name,
            metavar=name.upper(),
            help=option.help,
        )
    for name, option in options_of(command).items():
        add_flag(parser, name, option, option.default)
    return parser


def add_flag(
    parser: argparse._ActionsContainer, name: str, option: Option, default: object
) -> None:
    """Add the flag of a keyword-only parameter.

    Args:
        parser: of the command, or a group of its flags.
        name: of the parameter.
        option: its type, default and help.
        default: what the parser returns without the flag.
    """
    flags = [f"--{name.replace('_', '-')}"]
    if name == "output":
        flags.insert(0, "-o")
    annotation = option.annotation
    origin = get_origin(annotation)
    upper_name = name.rpartition(".")[2].upper()
    settings: dict[str, Any]
    if annotation is bool:
        settings = {"action": "store_true"}
    elif annotation is int:
        settings = {"type": whole_number, "metavar": "N"}
    elif annotation is float:
        settings = {"type": float, "metavar": "X"}
    elif float in get_args(annotation):  # of float | Literal["local"]: a number or a word
        settings = {"type": _number_or_word(annotation), "metavar": "X"}
    elif annotation == Literal[True]:  # of Literal[True] | str: the text may be omitted
        settings = {"nargs": "?", "const": True, "metavar": upper_name}
    elif annotation == list[str]:  # one value each time, so that names may follow the flag
        settings = {"action": "append", "metavar": upper_name}
    elif origin is list:
        settings = {"action": "extend", "nargs": "+", "type": whole_number, "metavar": "N"}
    elif origin is Literal:
        choices = get_args(annotation)
        settings = {"type": type(choices[0]), "choices": choices}
    elif origin is dict:
        settings = {"type": _json_object, "metavar": "JSON"}
    elif origin is tuple:
        settings = {"type": _map_size, "metavar": "HxW"}
    else:
        settings = {"type": annotation, "metavar": upper_name}
    text = option.help.removesuffix(".").replace("%", "%%")
    if "{presets}" in text:
        from mapdata.generators import PRESETS

        *first, last = PRESETS
        text = text.replace("{presets}", f"{', '.join(first)} or {last}")
    if option.default is not None and option.default is not False:
        text += f" (default: {option.default})"
    parser.add_argument(*flags, dest=name, default=default, help=text, **settings)


def add_import_flag(parser: argparse.ArgumentParser) -> None:
    """Add the flag ``--import MODULE``, which may be repeated and becomes ``modules`` of `run`."""
    parser.add_argument(
        "--import",
        dest="modules",
        action="append",
        default=[],
        metavar="MODULE",
        help="first import a Python module, such as one that defines your own family of maps; it "
        "may be a file in the working folder",
    )


def import_named(name: str, flag: str = "--import") -> ModuleType:
    """Import a module, which may lie in the working folder, and return it.

    ``flag`` is the flag that named it, for messages.

    Raises:
        ValueError: there is no module of this name, or it raised an error.
    """
    import importlib

    is_name = all(part.isidentifier() for part in name.split("."))
    if not is_name or name.endswith(".py"):
        stem = os.path.basename(name).removesuffix(".py")
        hint = f", as in {flag} {stem}" if stem.isidentifier() else ""
        raise ValueError(f"{flag}: got {name!r}, expected the name of a module{hint}")
    folder = os.getcwd()
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        # The missing module may also be another one, which the module imports.
        is_named_module = error.name is not None and f"{name}.".startswith(f"{error.name}.")
        if not is_named_module:
            raise ValueError(f"{flag}: {name}: {type(error).__name__}: {error}") from error
        raise ValueError(
            f"{flag}: there is no module {name!r}, neither in the working folder {folder} nor "
            "among the installed packages"
        ) from error
    except (Exception, SystemExit) as error:  # the code of a user may raise anything
        raise ValueError(f"{flag}: {name}: {type(error).__name__}: {error}") from error


def path_name(text: str) -> str:
    """Return the name of a file or folder; an empty name, the working folder, is refused."""
    if not text:
        raise argparse.ArgumentTypeError("got an empty name")
    return text


def whole_number(text: str) -> int:
    """Return an integer, which may be written as 10000, 10_000 or 1e4."""
    try:
        return int(text)
    except ValueError:
        pass
    match = re.fullmatch(r"(\d{1,19})(?:\.(\d{1,19}))?[eE]\+?(\d{1,2})", text)
    if match is not None:
        # Digits are shifted as text, since a float holds large numbers only approximately.
        digits = match[1]
        decimals = (match[2] or "").rstrip("0")
        exponent = int(match[3])
        if len(decimals) <= exponent:
            return int(digits + decimals.ljust(exponent, "0"))
    raise argparse.ArgumentTypeError(f"got {text!r}, expected a whole number such as 10000 or 1e4")


def output_path(name: str) -> Path:
    """Return the path of a file to write, checked before the work that makes its content.

    Raises:
        ValueError: it is a URL or a folder, its folder does not exist, or it is ``-``.
    """
    from mapdata.shards.locations import local_path

    path = local_path(name)
    if name == "-":
        raise ValueError("-: cannot be written to the standard output, expected the name of a file")
    if path.is_dir():
        raise ValueError(f"{path}: is a folder, expected the name of a file")
    if not path.parent.is_dir():
        raise ValueError(f"{path}: cannot be written, the folder {path.parent} does not exist")
    return path


def check_picture_ending(name: str) -> None:
    """Refuse, before the work, a file of a figure whose ending names no format of pictures.

    Raises:
        ValueError: matplotlib writes no such files.
    """
    from matplotlib.figure import Figure

    endings = Figure().canvas.get_supported_filetypes()
    ending = Path(name).suffix[1:].lower()
    if ending and ending not in endings:
        raise ValueError(f"{name}: expected one of the endings {', '.join(sorted(endings))}")


def unused_name(name: str) -> str:
    """Return ``map.png``, or ``map-2.png`` if that exists, and so on: the name of no file."""
    stem, ending = os.path.splitext(name)
    number = 2
    while os.path.lexists(name):
        name = f"{stem}-{number}{ending}"
        number += 1
    return name


def _number_or_word(annotation: Any) -> Callable[[str], float | str]:
    """Return what converts the text of a flag to a number or one of the words of a type."""
    words = [word for member in get_args(annotation) for word in get_args(member)]

    def converted(text: str) -> float | str:
        if text in words:
            return text
        try:
            return float(text)
        except ValueError:
            raise argparse.ArgumentTypeError(
                f"got {text!r}, expected a number or {' or '.join(words)}"
            ) from None

    return converted


def _map_size(text: str) -> tuple[int, int]:
    """Return the rows and columns of a text such as 64x64."""
    match = re.fullmatch(r"([1-9]\d{0,4})[xX]([1-9]\d{0,4})", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected ROWSxCOLUMNS as in 64x64")
    return int(match[1]), int(match[2])


def _json_object(text: str) -> dict[str, Any]:
    """Return the mapping of a text such as {"S": 3}."""
    import json

    try:
        mapping = json.loads(text)
    except ValueError:
        mapping = None
    if not isinstance(mapping, dict):
        raise argparse.ArgumentTypeError(f"got {text!r}, expected JSON such as '{{\"S\": 3}}'")
    return mapping


def run_parsed(command: Command, arguments: list[str] | None = None, **defaults: object) -> None:
    """Run a function as the command line of a script.

    Args:
        command: the function.
        arguments: of the command line; by default those of the process.
        **defaults: default values of positional parameters, as in `parser_of`.
    """
    parser = parser_of(command, None, **defaults)
    add_import_flag(parser)
    run(command, **vars(parser.parse_args(arguments)))


def _print_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Print a warning as one line, without the source line that issued it."""
    complain(f"warning: {message}", 0)


def complain(error: object, code: int) -> int:
    """Print an error as one line; return the exit code."""
    print(f"mapdata: {' '.join(str(error).split())}", file=sys.stderr)
    return code
