"""What signatures and docstrings say of parameters."""

from __future__ import annotations

from inspect import Parameter
from typing import Literal

from mapdata.checks import did_you_mean
from mapdata.options import Option, options_of, summary_line


def example(  # noqa: D417  (one is undocumented)
    first: list[str],
    second: str = "two",
    *,
    size: tuple[int, int] | None = None,
    kind: Literal["a", "b"] = "a",
    undocumented: bool = False,
) -> None:
    """Show a summary.

    Args:
        first: names
        second: another
        size: (rows, columns) of
            what is shown.
        kind: of letter: a or b

    Returns:
        undocumented: nothing
    """


def test_keyword_only_parameters_are_options() -> None:
    """The type of an optional parameter is that without None, and the help is on one line."""
    assert options_of(example) == {
        "size": Option(tuple[int, int], None, "(rows, columns) of what is shown."),
        "kind": Option(Literal["a", "b"], "a", "of letter: a or b"),
        "undocumented": Option(bool, False, ""),
    }


def test_positional_parameters_are_options_on_request() -> None:
    """Positional parameters with and without a default are returned if their kind is named."""
    assert options_of(example, Parameter.POSITIONAL_OR_KEYWORD) == {
        "first": Option(list[str], Parameter.empty, "names"),
        "second": Option(str, "two", "another"),
    }
    assert summary_line(example) == "Show a summary."
    assert summary_line(lambda: None) == ""


def test_a_name_in_other_letters_is_meant() -> None:
    """Capitals alone make no other name."""
    assert did_you_mean("HRM", ["arrays", "hrm"]) == "; did you mean hrm?"
    assert did_you_mean("mapspec", ["MapSpec", "Maze"]) == "; did you mean MapSpec?"
    assert did_you_mean("xyz", ["MapSpec", "Maze"]) == ""
