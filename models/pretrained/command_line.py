"""What the command lines of the models share: the first word says what to run."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping

from mapdata.checks import check_choice
from mapdata.cli import complain

Command = Callable[[list[str] | None], object]
"""A command, called with the arguments after its name; None takes those of the process."""


def run_named_command(
    program: str,
    commands: Mapping[str, Command],
    description: str | None,
    arguments: list[str] | None,
) -> None:
    """Run the command that the first argument names, or exit with one line.

    Args:
        program: what one types before the name, for the help.
        commands: the commands, by name.
        description: what ``--help`` prints.
        arguments: the arguments; None takes those of the process.
    """
    name, *remaining = (sys.argv[1:] if arguments is None else arguments) or [""]
    description = description or ""
    if name in ("", "-h", "--help"):
        print(description.strip())
        sys.exit(0 if name else 2)
    try:
        check_choice("the first argument", name, commands)
    except ValueError as error:
        sys.exit(complain(error, 2))
    if arguments is None:
        # LightningCLI warns of arguments that are not those of the process.
        sys.argv[:] = [f"{program} {name}", *remaining]
    try:
        commands[name](None if arguments is None else remaining)
    except ModuleNotFoundError as error:
        if error.name != "scipy":
            raise
        sys.exit(complain(error, 2))  # the samplers need it, and their error says so
    except (OSError, ValueError) as error:  # what a user can put right
        sys.exit(complain(error, 2))
    except KeyError as error:
        if error.args != ("pytorch-lightning_version",):
            raise
        sys.exit(complain("--ckpt_path: the file is not a checkpoint of a training run", 2))
