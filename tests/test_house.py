"""Which folder may import which, and that each folder's ``__init__.py`` names what is public."""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from inspect import isclass, isfunction
from pathlib import Path
from typing import NamedTuple

import pytest
from helpers.pages import DOCS, ROOT, blocks

import mapdata

GROUND = (
    "_version",
    "aliases",
    "arrays",
    "checks",
    "hashing",
    "hints",
    "interrupts",
    "jit",
    "limits",
    "movement",
    "npy",
    "options",
    "rng",
)
FOLDERS = (
    "generators",
    "search",
    "shards",
    "describe",
    "problems",
    "plotting",
    "formats",
    "costmaps",
    "datasets",
    "export",
    "evaluation",
    "roadmaps",
    "cli",
)
"""Each imports only from the ground files and from the folders before it."""

NOT_FROM = {"problems": {"describe"}, "evaluation": {"datasets", "export"}}
"""Folders that stand beside each other: neither imports the other."""


class Import(NamedTuple):
    """One name that a file imports, or a module (``name`` is empty)."""

    module: str
    name: str

    def folder(self) -> str:
        """Return the folder or ground file of mapdata that it comes from; nothing for other
        packages.
        """
        parts = self.module.split(".")
        return parts[1] if parts[0] == "mapdata" and len(parts) > 1 else ""

    def inside(self) -> str | None:
        """Return the module behind a face that it reaches into, if any."""
        folder = self.folder()
        if folder not in FOLDERS:
            return None
        path = ROOT / "mapdata" / folder / f"{self.name}.py"
        return (
            f"mapdata.{folder}.{self.name}"
            if path.is_file()
            else self.module
            if self.module.count(".") > 1
            else None
        )


def imports(source: str, package: str = "") -> Iterator[Import]:
    """Yield what Python text imports, those for type checkers too.

    Relative imports are those of a module of ``package``.
    """
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (Import(alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parts = [node.module] if node.module else []
            if node.level:  # one dot is the package itself, each further one the package around it
                parts = [*package.split(".")[: 1 - node.level or None], *parts]
            yield from (Import(".".join(parts), alias.name) for alias in node.names)


@cache
def imports_of(path: Path) -> tuple[Import, ...]:
    """Return what a file imports."""
    package = ".".join(path.relative_to(ROOT).parent.parts)
    return tuple(imports(path.read_text(encoding="utf-8"), package))


def python_files(*folders: str) -> list[str]:
    """Return all files of Python below these folders, as names from the checkout."""
    return sorted(
        str(path.relative_to(ROOT)) for folder in folders for path in (ROOT / folder).rglob("*.py")
    )


@pytest.mark.parametrize("folder", FOLDERS)
def test_folders_import_only_from_those_before_them(folder: str) -> None:
    """And from the ground; none takes its own face, or that of the package."""
    allowed = {*GROUND, *FOLDERS[: FOLDERS.index(folder) + 1]} - NOT_FROM.get(folder, set())
    for path in sorted((ROOT / "mapdata" / folder).glob("*.py")):
        for one in imports_of(path):
            where = f"{path.relative_to(ROOT)} imports {one.name} from {one.module}"
            assert one.module != "mapdata", f"{where}: name the folder"
            assert one.module.split(".")[0] not in ("models", "scripts", "tests", "benchmarks"), (
                where
            )
            if one.folder():
                assert one.folder() in allowed, where


def test_ground_files_import_only_one_another() -> None:
    """They know nothing of maps."""
    for name in GROUND:
        found = {one.folder() for one in imports_of(ROOT / "mapdata" / f"{name}.py")} - {""}
        assert found <= set(GROUND), name


def test_nothing_in_mapdata_imports_the_models() -> None:
    """The models use mapdata; nothing in it needs them, not even inside a function."""
    # The models are a folder of mapdata in released sources, and a link in git.
    names = [name for name in python_files("mapdata") if not name.startswith("mapdata/models/")]
    for name in names:
        for one in imports_of(ROOT / name):
            assert f"{one.module}.{one.name}.".find("mapdata.models.") == -1, name
            assert one.module.split(".")[0] != "models", name


def test_models_import_one_another_by_relative_names() -> None:
    """None is imported twice. The samples import as users do, so that copies of them work."""
    names = python_files("models")
    samples = {"models/path_predictor.py", "models/lego_sampler.py"}
    assert samples <= {*names} or not (ROOT / "models").exists()
    for name in names:
        for one in imports((ROOT / name).read_text(encoding="utf-8")):
            if name in samples:
                assert not one.module.startswith((".", "mapdata.models.")), name
            else:
                assert not one.module.startswith("mapdata.models"), name


def test_no_module_imports_itself_round_a_corner() -> None:
    """No circles."""
    files = {
        name.removesuffix(".py").replace("/", "."): ROOT / name
        for name in python_files("mapdata", "models")
    }
    arrows = {
        name: {
            target
            for one in imports_of(path)
            for target in (one.module, f"{one.module}.{one.name}")
        }
        & set(files)
        for name, path in files.items()
    }
    while leaves := [name for name, targets in arrows.items() if not targets & set(arrows)]:
        for name in leaves:
            del arrows[name]
    assert arrows == {}


def test_users_come_in_by_the_face() -> None:
    """Models, scripts and benchmarks import only what users can; tests may reach inside."""
    wrong = {}
    for file in python_files("models", "scripts", "benchmarks"):
        modules = {module for one in imports_of(ROOT / file) if (module := one.inside())}
        if modules:
            wrong[file] = modules
    assert wrong == {}, "take it from mapdata.<folder>"


def test_pages_come_in_by_the_face() -> None:
    """README, docs and the notebook."""
    pages = {
        page: blocks(page)
        for page in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *DOCS.rglob("*.md"))
    }
    texts = [
        (page.name, block.text)
        for page, found in pages.items()
        for block in found
        if block.language == "python"
    ]
    for cell in json.loads((DOCS / "first_look.ipynb").read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            texts.append(("first_look.ipynb", "".join(cell["source"])))
    assert len(texts) > 20
    for name, text in texts:
        for one in imports(text):
            assert one.inside() is None, f"{name}: {one}"


@pytest.mark.slow
def test_no_test_imports_another() -> None:
    """What they share is in tests/helpers."""
    for file in python_files("tests"):
        found = {
            part for one in imports_of(ROOT / file) for part in (*one.module.split("."), one.name)
        }
        assert not [part for part in found if part.startswith("test_")], file


def is_check(statement: ast.AST) -> bool:
    """Return whether a statement can fail a test: assert, raises, warns, or an assert function."""
    if isinstance(statement, ast.With):
        managers = [ast.unparse(item.context_expr) for item in statement.items]
        return any(name.startswith(("pytest.raises(", "pytest.warns(")) for name in managers)
    if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Call):
        name = ast.unparse(statement.value.func).split(".")[-1]
        return name.startswith(("assert", "check"))
    return isinstance(statement, ast.Assert)


def always_checks(body: list[ast.stmt]) -> bool:
    """Return whether statements check something whatever the conditions in them are."""
    for statement in body:
        if is_check(statement):
            return True
        branches: tuple[list[ast.stmt], ...] = ([],)
        if isinstance(statement, ast.For | ast.While | ast.With | ast.Try):
            branches = (statement.body,)
        elif isinstance(statement, ast.If):
            branches = (statement.body, statement.orelse)
        if all(map(always_checks, branches)):
            return True
    return False


def conditional_tests(source: str) -> list[str]:
    """Return the names of the tests that check something, but only below an ``if``."""
    tests = [
        node
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    ]
    return [
        test.name
        for test in tests
        if any(map(is_check, ast.walk(test))) and not always_checks(test.body)
    ]


@pytest.mark.slow
def test_no_test_checks_only_below_an_if() -> None:
    """Where the condition does not hold, such a test passes and has seen nothing."""
    for file in python_files("tests"):
        assert not conditional_tests((ROOT / file).read_text(encoding="utf-8")), file


@pytest.mark.parametrize(
    ("body", "is_conditional"),
    [
        ("if a:\n        assert b", True),
        ("for a in b:\n        if a:\n            check_all(a)", True),
        ("if a:\n        with pytest.raises(ValueError):\n            b()", True),
        ("if a:\n        assert b\n    else:\n        c()", True),
        ("if a:\n        assert b\n    else:\n        assert not b", False),
        ("if a:\n        b()\n    assert c", False),
        ("with pytest.raises(ValueError):\n        if a:\n            b()", False),
        ("run(a)", False),
    ],
)
def test_tests_that_check_only_below_an_if_are_found(body: str, is_conditional: bool) -> None:
    """By the statements of each."""
    found = conditional_tests(f"def test_it():\n    {body}\n")
    assert found == ["test_it"] * is_conditional


@pytest.mark.parametrize("folder", FOLDERS)
def test_a_face_names_what_is_there(folder: str) -> None:
    """``__all__`` in order, each name there, none that of a module: ``mapdata.shards.repair`` is
    the function.
    """
    face = import_module(f"mapdata.{folder}")
    assert len(face.__all__) == len(set(face.__all__))
    modules = {path.stem for path in (ROOT / "mapdata" / folder).glob("*.py")}
    for name in face.__all__:
        value = getattr(face, name)
        assert name not in modules, f"mapdata/{folder}/{name}.py hides what the face exports"
        assert not (isclass(value) or isfunction(value)) or value.__doc__, name


def test_the_top_face_agrees_with_the_folders() -> None:
    """What is imported on first use is what type checkers see, and each folder gives it."""
    tree = ast.parse((ROOT / "mapdata" / "__init__.py").read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    seen = {one.name: one.module for one in imports(ast.unparse(block))}
    assert seen == {
        name: f"mapdata.{folder}" for folder, names in mapdata._FACES.items() for name in names
    }
    assert set(mapdata.__all__) == {*seen, "__version__"}
    for name, module in seen.items():
        assert getattr(mapdata, name) is getattr(import_module(module), name)
        assert module == "mapdata.movement" or name in import_module(module).__all__, (
            f"{name} is not in {module}.__all__"
        )


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        (
            "read_problems",
            "; the names of its folders are in docs/reference, such as mapdata.models",
        ),
        ("__wrapped__", "$"),
    ],
)
def test_a_name_of_a_folder_is_not_one_of_mapdata(name: str, hint: str) -> None:
    """The error says where others are; what Python looks for in modules needs no hint."""
    with pytest.raises(AttributeError, match=f"module 'mapdata' has no attribute '{name}'{hint}"):
        getattr(mapdata, name)
