"""The house: which folder may import which, faces that say what is public, and a test for every
module.
"""

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

GROUND = ("_version", "arrays", "jit", "options", "rng", "spec")
FOLDERS = (
    "generators",
    "search",
    "shards",
    "problems",
    "formats",
    "datasets",
    "evaluation",
    "plotting",
    "cli",
)
"""Each imports only from the ground files and from the folders before it."""

NOT_FROM = {"evaluation": {"datasets"}}
"""Two that stand beside each other."""

TESTED_IN = {
    "mapdata/__main__.py": ("cli/test_app.py",),
    "mapdata/cli/common.py": ("cli/test_app.py",),
    "mapdata/cli/convert.py": ("cli/test_app.py", "formats/test_registry.py"),
    "mapdata/cli/problems.py": ("evaluation/test_metrics.py",),
    "mapdata/datasets/field_kernels.py": ("datasets/test_fields.py",),
    "mapdata/datasets/online.py": ("datasets/test_dataset.py",),
    "mapdata/datasets/sampler.py": ("datasets/test_datamodule.py",),
    "mapdata/datasets/arguments.py": ("datasets/test_dataset.py", "datasets/test_datamodule.py"),
    "mapdata/formats/collection.py": ("formats/test_importing.py",),
    "mapdata/formats/files.py": ("formats/test_images.py", "formats/test_planning.py"),
    "mapdata/formats/images.py": ("formats/test_images.py", "formats/test_ros.py"),
    "mapdata/formats/movingai.py": ("formats/test_movingai.py", "formats/test_fuzz.py"),
    "mapdata/formats/paper.py": ("formats/test_paper.py", "formats/test_registry.py"),
    "mapdata/plotting/figures.py": ("plotting/test_figures.py", "shards/test_root.py"),
    "mapdata/problems/sources.py": ("problems/test_sources.py", "datasets/test_datamodule.py"),
    "mapdata/problems/symmetry.py": ("datasets/test_dataset.py", "problems/test_symmetry.py"),
    "mapdata/search/kernels.py": (
        "search/test_api.py",
        "search/test_labels.py",
        "search/test_bitboard.py",
    ),
    "mapdata/search/lattice.py": (
        "search/test_lattice.py",
        "search/test_labels.py",
        "search/test_bitboard.py",
        "problems/test_sampling.py",
    ),
    "mapdata/shards/builder.py": (
        "shards/test_builder.py",
        "shards/test_faults.py",
        "shards/test_manifest.py",
    ),
    "mapdata/shards/corruption.py": ("shards/test_corruption.py", "shards/test_root.py"),
    "mapdata/shards/manifest.py": (
        "shards/test_manifest.py",
        "shards/test_builder.py",
        "shards/test_faults.py",
    ),
    "mapdata/shards/recipe.py": ("shards/test_builder.py", "cli/test_app.py"),
    "mapdata/shards/shard.py": (
        "shards/test_shard.py",
        "shards/test_hdf5.py",
        "shards/test_faults.py",
        "datasets/test_batches.py",
    ),
    "mapdata/shards/table.py": (
        "datasets/test_dataset.py",
        "formats/test_huggingface.py",
        "formats/test_paper.py",
    ),
    "models/model.py": ("models/test_model.py", "shards/test_hostile.py"),
    "models/geometry.py": ("models/test_path_predictor.py", "models/test_neural_astar.py"),
    "models/lego/cvae.py": ("models/lego/test_sampler.py",),
    "models/lego/experience.py": ("models/lego/test_sampler.py",),
    "models/learned_planners.py": ("models/test_path_predictor.py",),
    "models/lego/comparison.py": ("models/lego/test_sampler.py",),
    "models/training.py": ("models/test_path_predictor.py",),
}
"""Modules without a test file of their name, and those that others reach into too."""

PRIVATE = {
    "tests/helpers/fuzzing.py": {
        "mapdata.datasets.dataset",
        "mapdata.formats.movingai",
        "mapdata.shards.shard",
    },
}
"""What helpers need of the inside."""


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


def imports(source: str) -> Iterator[Import]:
    """Yield what Python text imports, those for type checkers too."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (Import(alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (Import(node.module or "", alias.name) for alias in node.names)


@cache
def imports_of(path: Path) -> tuple[Import, ...]:
    """Return what a file imports."""
    return tuple(imports(path.read_text(encoding="utf-8")))


def python_files(*folders: str) -> list[str]:
    """Return all files of Python below these folders, as names from the checkout."""
    return sorted(
        str(path.relative_to(ROOT)) for folder in folders for path in (ROOT / folder).rglob("*.py")
    )


MODULES = [
    name
    for name in python_files("mapdata", "models")
    if Path(name).stem not in ("__init__", "_version")
]
"""All but those that have nothing to test: faces and the version."""


def mirror(module: str) -> str:
    """Return the test file of a module, below tests/."""
    path = Path(module.removeprefix("mapdata/"))
    return str(path.with_name(f"test_{path.name}"))


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
    """Models, scripts, benchmarks and tests; a test reaches into the modules that it tests."""
    wrong = {}
    for file in python_files("models", "scripts", "benchmarks", "tests"):
        allowed = set(PRIVATE.get(file, ()))
        for module in MODULES:
            if file.removeprefix("tests/") in (mirror(module), *TESTED_IN.get(module, ())):
                allowed.add(module.removesuffix(".py").replace("/", "."))
        if (
            reached := {inside for one in imports_of(ROOT / file) if (inside := one.inside())}
            - allowed
        ):
            wrong[file] = reached
    assert wrong == {}, (
        "take it from mapdata.<folder>, or add the test to its module's line in TESTED_IN"
    )


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


def test_no_test_imports_another() -> None:
    """What they share is in tests/helpers."""
    for file in python_files("tests"):
        found = {
            part for one in imports_of(ROOT / file) for part in (*one.module.split("."), one.name)
        }
        assert not [part for part in found if part.startswith("test_")], file


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
        assert module == "mapdata.spec" or name in import_module(module).__all__, (
            f"{name} is not in {module}.__all__"
        )


def test_every_module_has_a_test() -> None:
    """A file of its name, or a line of `TESTED_IN`; and the table says nothing that is not so."""
    for module in MODULES:
        files = TESTED_IN.get(module) or (mirror(module),)
        missing = [file for file in files if not (ROOT / "tests" / file).is_file()]
        assert not missing, (
            f"{module}: no tests/{missing[0]}, and no line in TESTED_IN that names another"
        )
    assert set(TESTED_IN) <= set(MODULES)


def test_test_files_say_what_they_test() -> None:
    """A file in the folder of a module bears its name, or is one of these, which test something
    else.
    """
    others = {
        "datasets/test_radius.py": "a robot of a size, in all datasets and problems",
        "shards/test_faults.py": "kills and full disks",
        "shards/test_format.py": "docs/format.md",
        "shards/test_fuzzing.py": "random changes of files",
        "shards/test_hostile.py": "hostile files to all loaders",
        "shards/test_long_life.py": "kept datasets",
        "formats/test_registry.py": "the registry, mapdata/formats/__init__.py",
        "formats/test_fuzz.py": "random files of all formats",
        "test_house.py": "this",
    }
    known = {mirror(module) for module in MODULES} | set(others)
    files = {str(path.relative_to(ROOT / "tests")) for path in (ROOT / "tests").rglob("test_*.py")}
    assert {
        file for file in files if not file.startswith(("docs/", "benchmarks/"))
    } - known == set()
