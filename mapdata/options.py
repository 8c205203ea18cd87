"""The parameters of a function as options: type, default and help from signature and docstring.

The command line makes its flags from them, and the foreign formats the options of their functions.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from inspect import Parameter
from types import NoneType
from typing import Any, NamedTuple, get_args, get_type_hints


class Option(NamedTuple):
    """A parameter of a function.

    Attributes:
        annotation: its type; without None where that is the alternative, as in ``int | None``.
        default: its default, ``Parameter.empty`` without one.
        help: its description in the docstring, on one line.
    """

    annotation: Any
    default: object
    help: str


def options_of(
    function: Callable[..., object], parameter_kind: Any = Parameter.KEYWORD_ONLY
) -> dict[str, Option]:
    """Return the parameters of a function by name, their help from its Google-style docstring.

    Args:
        function: any function with type hints.
        parameter_kind: only parameters of this kind, as `inspect.Parameter.kind` has them.
    """
    docstring = inspect.getdoc(function) or ""
    _, _, after_heading = docstring.partition("\nArgs:\n")
    section, _, _ = after_heading.partition("\n\n")
    # "    name: text", whose further lines are indented by eight spaces
    descriptions = dict(re.findall(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", section, re.MULTILINE))
    hints = get_type_hints(function)
    options = {}
    for name, parameter in inspect.signature(function).parameters.items():
        if parameter.kind is not parameter_kind:
            continue
        annotation = hints[name]
        if NoneType in get_args(annotation):
            annotation = get_args(annotation)[0]
        words = descriptions.get(name, "").split()
        options[name] = Option(annotation, parameter.default, " ".join(words))
    return options


def summary_line(function: Callable[..., object]) -> str:
    """Return the first line of a docstring."""
    return (function.__doc__ or "").partition("\n")[0]
