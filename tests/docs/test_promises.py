"""docs/promises.md names tests that exist, and a test for each promise."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
PAGE = (TESTS.parent / "docs" / "promises.md").read_text(encoding="utf-8")
NAMED = re.compile(r"`([\w/]+\.py)::(\w+)`")


@cache
def functions(file: str) -> set[str]:
    """Return the names of the test functions of a file."""
    tree = ast.parse((TESTS / file).read_text(encoding="utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


@pytest.mark.slow
def test_every_named_test_exists() -> None:
    """The page names each test as ``file::function``."""
    named = NAMED.findall(PAGE)
    assert len(named) > 50
    assert PAGE.count("::") == len(named)
    assert [f"{file}::{name}" for file, name in named if name not in functions(file)] == []


def test_every_promise_has_a_test() -> None:
    """Each bold line before the last section is followed by one."""
    promises = PAGE.split("## What is not promised")[0].split("\n- **")[1:]
    assert len(promises) > 20
    assert [promise.split("**")[0] for promise in promises if not NAMED.search(promise)] == []


def test_the_lowest_versions_were_tried() -> None:
    """The first row of tested versions has the lowest that pyproject.toml allows."""
    allowed = (TESTS.parent / "pyproject.toml").read_text(encoding="utf-8")
    versions = (TESTS.parent / "docs" / "install.md").read_text(encoding="utf-8")
    row = next(line for line in versions.splitlines() if line.startswith("| lowest |"))
    row = re.sub(r" \(HDF5 .*?\)", "", row.replace("| lowest |", "python"))
    tried = re.findall(r"([\w-]+) (\d[\d.]+\d)", row)
    assert len(tried) == 17
    for name, version in tried:
        bound = re.search(rf'"?(?:requires-)?{name}(?:\[\w+\])?(?: = ")?>=([\d.]+)', allowed)
        assert bound, name
        assert f"{version}.".startswith(f"{bound[1]}."), (name, version, bound[1])
