"""What all command lines share: the parser, exit codes, and the summary of a dataset."""

from __future__ import annotations

import argparse
import os
import re
import shlex
import sys
import threading
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Literal, NoReturn, TextIO, get_args, get_origin

from mapdata.interrupts import EXIT_CODE, STOPPED, THREADS, leave, stoppable

if TYPE_CHECKING:
    from mapdata.options import Option
    from mapdata.shards import Manifest

Command = Callable[..., None]
"""What a command line calls: its signature and docstring are the flags and the help."""


class DisagreeError(Exception):
    """The data are damaged or are not what they should be: exit code 1."""


def summary(root: str, manifest: Manifest, seconds: float | None = None) -> str:
    """Return the short summary of a dataset, one fact to a line."""
    from mapdata.describe.dataset_card import counted

    done = manifest.done
    size = sum(entry.bytes for entry in manifest.shards)
    segments = max(manifest.total("segments"), 1)
    rows, columns = manifest.map_size
    shards = counted(len(manifest.shards), "shard")
    unfinished = "" if manifest.complete else f" (of {manifest.maps:,}: not finished)"
    drawn = manifest.total("drawn")  # none where maps have no rooms: mazes, imports
    shown = min(7, max(done - 1, 0))
    lines = {
        "maps": f"{done:,} of {rows} x {columns} cells in {shards}{unfinished}",
        **({} if manifest.spec is not None else _of_import(root, manifest)),
        "rate": "" if seconds is None else f"{seconds:.1f} s, {done / seconds:,.0f} maps/s",
        "size": f"{size / 1e6:,.1f} MB, {size / max(done, 1):.0f} bytes a map",
        "drawn passages": f"{drawn / segments:.1%}" if drawn else "",
        "reachable segments": f"{manifest.total('reachable') / segments:.1%}",
        "fully connected maps": f"{manifest.total('all_connected') / max(done, 1):.1%}",
        "identity": manifest.identity or "none (imported)",
        "content hash": manifest.content_hash,
        "look": f"mapdata show {shlex.quote(root)} --index {shown} -o map.png",
    }
    return "\n".join(f"{name + ':':22}{text}" for name, text in lines.items() if text)


def _of_import(root: str, manifest: Manifest) -> dict[str, str]:
    """Return the lines of `summary` that say what no recipe of imported maps says."""
    from mapdata.describe.dataset_card import movement_text
    from mapdata.limits import SPLITS
    from mapdata.shards.dataset_files import read_provenance

    counts = {
        split: sum(entry.counts[split]["maps"] for entry in manifest.shards) for split in SPLITS
    }
    lines = {
        "splits": ", ".join(f"{split} {count:,}" for split, count in counts.items()),
        "movement": movement_text(manifest.movement),
    }
    with suppress(OSError, ValueError, TypeError, KeyError):  # older, missing or damaged
        values = read_provenance(root)
        lines["free cells"] = f"{values['free']:.1%}"
        distinct = values["distinct"]
        if manifest.done > 1:
            by_split = ", ".join(f"{split} {distinct[split]:,}" for split in SPLITS)
            symmetric = values["distinct_up_to_symmetry"]["all"]
            lines["distinct maps"] = (
                f"{distinct['all']:,} of {manifest.done:,} ({symmetric:,} up to symmetry): "
                f"{by_split}"
            )
        source = f"{values['source']}, format {values['format']}"
        lines["source"] = "".join(letter if letter.isprintable() else "?" for letter in source)
    return lines


def run(command: Command, *, modules: Sequence[str] = (), **values: object) -> None:
    """Import ``modules``, call ``command`` and exit with 0, 1, 2 or, after Ctrl-C, 130.

    What a user can put right is one clear line instead of a traceback.
    """
    try:
        with stoppable(), warnings.catch_warnings():
            warnings.showwarning = _print_warning
            # When all tries have failed, the error says how many there were.
            warnings.filterwarnings("ignore", r".*\. Trying again in ")
            for module in modules:
                import_named(module)
            command(**values)
            print(end="", flush=True)  # so that a reader that is gone is noticed here, not at exit
    except BrokenPipeError:  # as in: mapdata info ROOT | head -1
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left to print
        sys.exit(141)  # as a shell says it
    except KeyboardInterrupt:  # in a process without `exit_on_interrupt`
        if any(thread.name.startswith(THREADS) for thread in threading.enumerate()):
            leave()
        sys.exit(complain(STOPPED, EXIT_CODE))
    except (DisagreeError, ValueError, OSError) as error:
        from mapdata.shards import ShardError  # late: the list of verbs needs nothing of it

        sys.exit(complain(error, 1 if isinstance(error, (DisagreeError, ShardError)) else 2))


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Refuse an unknown flag by naming the nearest, before anything else is missed."""
        from mapdata.checks import did_you_mean

        given = sys.argv[1:] if args is None else args
        for text in given:
            flag = text.partition("=")[0]
            if flag == "--":  # what follows are names, whatever they begin with
                break
            if flag.startswith("--") and flag not in self._option_string_actions:
                hint = did_you_mean(flag, self._option_string_actions)
                self.error(f"unknown flag {flag}{hint}")
        return super().parse_known_args(given, namespace)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse what is not one of the choices by naming the nearest, too."""
        from mapdata.checks import did_you_mean

        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as error:
            error.message += did_you_mean(value, map(str, action.choices or ()))
            raise

    def error(self, message: str) -> NoReturn:
        """Exit with code 2."""
        sys.exit(complain(f"{message} ({self.prog} --help says more)", 2))


def parser_of(command: Command, prog: str | None = None, **defaults: object) -> Parser:
    """Return the parser of a function, made of its signature and its docstring.

    Parameters without a default are positional, keyword-only ones are flags. ``defaults`` are those
    of positional ones that may be left out.
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
        nargs = "+" if get_origin(option.kind) is list else None
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
    """Add the flag of a keyword-only parameter."""
    short = ["-o"] if name == "output" else []
    flag = f"--{name.replace('_', '-')}"
    kind = option.kind
    origin = get_origin(kind)
    metavar = {int: "N", float: "X"}.get(kind, name.rpartition(".")[2].upper())
    how: dict[str, Any] = {"type": whole_number if kind is int else kind, "metavar": metavar}
    if kind is bool:
        how = {"action": "store_true"}
    elif kind == Literal[True]:  # or a text: its value may be left out
        how = {"nargs": "?", "const": True, "metavar": metavar}
    elif origin is list:
        how = {"nargs": "+", "type": whole_number, "metavar": "N"}
    elif origin is Literal:
        choices = get_args(kind)
        how = {"type": type(choices[0]), "choices": choices}
    elif origin is tuple:
        how = {"type": _size, "metavar": "HxW"}
    text = option.help.removesuffix(".").replace("%", "%%")
    if option.default is not None and option.default is not False:
        text += f" (default: {option.default})"
    parser.add_argument(*short, flag, dest=name, default=default, help=text, **how)


def add_import_flag(parser: argparse.ArgumentParser) -> None:
    """Add ``--import MODULE``, which may be given several times; `run` takes it as ``modules``."""
    parser.add_argument(
        "--import",
        dest="modules",
        action="append",
        default=[],
        metavar="MODULE",
        help="import a module first, such as one with a family of maps of your own; it is also "
        "looked for in the working folder, as by python -m",
    )


def import_named(name: str) -> None:
    """Import a module, which may lie in the working folder.

    Raises:
        ValueError: there is none of this name, or running it failed; on one line.
    """
    import importlib

    is_name = all(part.isidentifier() for part in name.split("."))
    if not is_name or name.endswith(".py"):
        stem = os.path.basename(name).removesuffix(".py")
        hint = f", as in --import {stem}" if stem.isidentifier() else ""
        raise ValueError(f"--import: got {name!r}, expected the name of a module{hint}")
    folder = os.getcwd()
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{name}.".startswith(f"{error.name}."):
            raise ValueError(f"--import: {name}: {type(error).__name__}: {error}") from error
        raise ValueError(
            f"--import: there is no module {name!r}, neither in the working folder {folder} nor "
            "among the installed packages"
        ) from error
    except (Exception, SystemExit) as error:  # whatever the code of others raises
        raise ValueError(f"--import: {name}: {type(error).__name__}: {error}") from error


def path_name(text: str) -> str:
    """Return the name of a file or folder; an empty one, the working folder, is refused."""
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
        whole, fraction, exponent = match[1], (match[2] or "").rstrip("0"), int(match[3])
        if len(fraction) <= exponent:
            return int(whole + fraction.ljust(exponent, "0"))
    raise argparse.ArgumentTypeError(f"got {text!r}, expected a whole number such as 10000 or 1e4")


def unused_name(name: str) -> str:
    """Return a name of a file that does not exist: ``map.png``, else ``map-2.png`` and so on."""
    stem, ending = os.path.splitext(name)
    number = 2
    while os.path.lexists(name):
        name = f"{stem}-{number}{ending}"
        number += 1
    return name


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([1-9]\d{0,4})[xX]([1-9]\d{0,4})", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected ROWSxCOLUMNS as in 64x64")
    return int(match[1]), int(match[2])


def run_parsed(command: Command, arguments: list[str] | None = None, **defaults: object) -> None:
    """Be the command line of a script: `run` a function with the arguments that it was given."""
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
    """Print a warning as one line, without the line of Python that it comes from."""
    complain(f"warning: {message}", 0)


def complain(error: object, code: int) -> int:
    """Print an error as one line; return the exit code."""
    print(f"mapdata: {' '.join(str(error).split())}", file=sys.stderr)
    return code
