"""What the signature and the docstring of a function say of its parameters.

Flags of the command line and options of foreign formats are made of it.
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
        kind: its type; of a union, the first.
        default: its default, ``Parameter.empty`` without one.
        help: what the docstring says of it.
    """

    kind: Any
    default: object
    help: str


def options_of(
    function: Callable[..., object], which: Any = Parameter.KEYWORD_ONLY
) -> dict[str, Option]:
    """Return the parameters of one kind by name, keyword-only ones by default.

    Their help is what the ``Args`` of a Google-style docstring say.
    """
    documented = (inspect.getdoc(function) or "").partition("\nArgs:\n")[2].partition("\n\n")[0]
    texts = dict(re.findall(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", documented, re.MULTILINE))
    hints = get_type_hints(function)
    options = {}
    for name, parameter in inspect.signature(function).parameters.items():
        if parameter.kind is which:
            hint = hints[name]
            kind = get_args(hint)[0] if NoneType in get_args(hint) else hint
            options[name] = Option(kind, parameter.default, " ".join(texts.get(name, "").split()))
    return options


def summary_line(function: Callable[..., object]) -> str:
    """Return the first line of a docstring."""
    return (function.__doc__ or "").partition("\n")[0]
